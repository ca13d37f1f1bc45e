"""Build the radio network of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array, NedOrigin, Records, VehicleState
from testbed.mavlink.follow_target import FollowTarget
from testbed.network.channel import make_channel
from testbed.network.clocks import make_clocks
from testbed.network.fading import Curves, fading, make_curves
from testbed.network.links import Numbers, resolve_links
from testbed.network.outages import Outages, make_outages, scripted_outcomes
from testbed.network.payload import KEPT
from testbed.network.radio import ExtraLosses, Radio
from testbed.network.trace import make_replays, replayed_delays
from testbed.plan.fleet import FormationPlan
from testbed.scenario.network import Network


def build_radio(
    names: Sequence[str],
    network: Network,
    weights: Array,
    origin: NedOrigin,
    seed: int,
    links: Records | None = None,
    payload: int = 0,
) -> tuple[Radio, Outages]:
    """Build the radio of N aircraft, and its scripted outages.

    Args:
        names: N, the leader first, which does not receive.
        network: the section of the scenario.
        weights: β (n, N, 3): a follower may receive only those for which it has some.
        origin: of the local frame.
        seed: of the run.
        links: (n, N) of LINK, of zeros, to be used; None: new ones.
        payload: numbers of a law's own in each message of a follower.

    Raises:
        InputError: a file of delays or a trace cannot be used.
    """
    pairs = resolve_links(names, network)
    outages, replays, curves = make_outages(pairs), make_replays(pairs, seed), make_curves(pairs)
    scripted = outages.windows or len(outages.dropped)
    losses = ExtraLosses(
        outages=partial(scripted_outcomes, outages) if scripted else None,
        trace=partial(replayed_delays, replays) if replays else None,
        fading=partial(_fading, curves) if curves else None,
    )
    clocks = make_clocks(names, network.clocks) if network.clocks else None
    codec, encoding = FollowTarget(origin, payload), None
    if network.encoding == "follow-target":
        encoding = codec
    subscribed = None
    if network.receive == "neighbours":
        subscribed = np.any(weights != 0.0, axis=2)
        subscribed[:, 0] = True
    channel = make_channel(pairs, seed, subscribed, codec.payload_bytes if payload else 0)
    return Radio(channel, losses, encoding, clocks, links, payload), outages


def check_payload(names: Sequence[str], network: Network, rate_hz: float) -> None:
    """Check that the numbers of a law's own are kept until their messages arrive.

    Raises:
        InputError: the delay of a link is too long.
    """
    links = resolve_links(names, network).distinct
    longest = max((each.delay_s or 0.0 for each in links), default=0.0)
    if longest * rate_hz > KEPT:
        raise InputError(
            f"network.delay_s: {longest:g} s is too long for a law that sends numbers of its own "
            f"{rate_hz:g} times a second (write {KEPT / rate_hz:g} s at most)"
        )


def received_weights(fleet: FormationPlan, network: Network) -> Array:
    """Return β (n, N, 3), which decides what followers receive with `receive: neighbours`."""
    return fleet.weights if network.receive == "neighbours" else fleet.all_weights


def transmit_times(
    names: Sequence[str], network: Network
) -> dict[int, tuple[float | None, float | None]]:
    """Return period and phase, s, by row, of aircraft that transmit independently of the ticks."""
    return {
        names.index(name): (times.period_s, times.phase_s)
        for name, times in network.broadcast.items()
    }


def _fading(curves: Curves, truth: VehicleState, rows: Numbers) -> Array:
    probability: Array = fading(truth.position_ned, truth.euler, curves)[:, rows]
    return probability
