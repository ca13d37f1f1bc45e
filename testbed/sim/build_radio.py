"""Build the radio network of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from testbed.core.records import Array, BoolArray, Origin, VehicleState
from testbed.mavlink.follow_target import FollowTarget
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.fading import Curves, fading, make_curves
from testbed.network.links import Numbers
from testbed.network.outages import Outages, make_outages, scripted_outcomes
from testbed.network.radio import ExtraLosses, Radio
from testbed.network.trace import make_replays, replayed_delays
from testbed.scenario import Scenario
from testbed.sim.build_control import build_gains


def build_radio(scenario: Scenario) -> tuple[Radio, Outages]:
    """Build the radio of a scenario, and its scripted outages.

    Raises:
        InputError: a file of delays or a trace cannot be used.
    """
    names, network, seed = scenario.aircraft_names, scenario.network, scenario.scenario.seed
    outages = make_outages(names, network)
    replays, curves = make_replays(names, network, seed), make_curves(names, network)
    scripted = outages.windows or len(outages.dropped)
    losses = ExtraLosses(
        outages=partial(scripted_outcomes, outages) if scripted else None,
        trace=partial(replayed_delays, replays) if replays else None,
        fading=partial(_fading, curves) if curves else None,
    )
    clocks = make_clocks(names, network.clocks) if network.clocks else None
    encoding = None
    if network.encoding == "follow-target":
        encoding = FollowTarget(Origin(**scenario.scenario.origin.model_dump()))
    channel = make_channel(names, network, seed, _subscriptions(scenario))
    return Radio(channel, losses, encoding, clocks), outages


def _subscriptions(scenario: Scenario) -> BoolArray | None:
    """Return whose messages (n, N) followers use: the leader's and neighbours'; None: all."""
    if scenario.network.receive == "all":
        return None
    subscribed: BoolArray = np.any(build_gains(scenario) != 0.0, axis=2)
    subscribed[:, 0] = True
    return subscribed


def transmit_times(scenario: Scenario) -> dict[int, tuple[float | None, float | None]]:
    """Return period and phase, s, by row, of aircraft that transmit independently of the ticks."""
    names: Sequence[str] = scenario.aircraft_names
    return {
        names.index(name): (times.period_s, times.phase_s)
        for name, times in scenario.network.broadcast.items()
    }


def _fading(curves: Curves, truth: VehicleState, rows: Numbers) -> Array:
    probability: Array = fading(truth.position_ned, truth.euler, curves)[:, rows]
    return probability
