"""The page's network as a radio."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from testbed.mavlink.follow_target import FollowTarget
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.fading import Curves, fading, make_curves
from testbed.network.post import Numbers
from testbed.network.radio import Conditions, Radio
from testbed.network.scripts import Scripts, blocked, make_scripts
from testbed.network.trace import make_replays, replayed
from testbed.scenario import Scenario
from testbed.sim.teams import make_gains
from testbed.state import Array, Origin, Truths, VehicleState


def make_radio(page: Scenario) -> tuple[Radio, Scripts]:
    """The radio of a page, and what is written down to go wrong on it.

    Raises:
        InputError: a file of delays or a trace cannot be used.
    """
    names, network, seed = page.aircraft_names, page.network, page.scenario.seed
    scripts = make_scripts(names, network)
    replays, curves = make_replays(names, network, seed), make_curves(names, network)
    conditions = Conditions(
        script=partial(blocked, scripts) if scripts.windows or len(scripts.listed) else None,
        trace=partial(replayed, replays) if replays else None,
        fading=partial(_faded, curves) if curves else None,
        clocks=make_clocks(names, network.clocks) if network.clocks else None,
    )
    encoding = None
    if network.encoding == "follow-target":
        encoding = FollowTarget(Origin(**page.scenario.origin.model_dump()))
    channel = make_channel(names, network, seed, _heeded(page))
    return Radio(channel, conditions, encoding), scripts


def _heeded(page: Scenario) -> Truths | None:
    """Whom (n, N) followers listen to: the leader, and those they have a gain for; None: all."""
    if page.network.hears == "all":
        return None
    heeded: Truths = np.any(make_gains(page) != 0.0, axis=2)
    heeded[:, 0] = True
    return heeded


def beats(page: Scenario) -> dict[int, tuple[float | None, float | None]]:
    """Period and phase, s, of the aircraft (by row) that send at moments of their own."""
    names: Sequence[str] = page.aircraft_names
    return {
        names.index(name): (beat.period_s, beat.phase_s)
        for name, beat in page.network.broadcast.items()
    }


def _faded(curves: Curves, truth: VehicleState, rows: Numbers) -> Array:
    lost: Array = fading(truth.position_ned, truth.euler, curves)[:, rows]
    return lost.copy()
