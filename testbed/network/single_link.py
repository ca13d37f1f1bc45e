"""Packets over one link, without a scenario, a clock or aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import MESSAGE, Array, allocate, join_names
from testbed.network.channel import (
    initial_departures,
    initial_links,
    initial_transmitters,
    make_channel,
)
from testbed.network.links import Outcomes, resolve_links
from testbed.network.outages import make_outages, scripted_outcomes
from testbed.network.packet_outcomes import transmit_broadcast
from testbed.network.trace import make_replays, replayed_delays
from testbed.scenario.network import Link, Network

_NAMES = ("sender", "receiver")  # of the random streams; also of the columns of a trace
# Keys of a link that act without positions of aircraft.
KEYS = (*sorted(Link.model_fields.keys() - {"range_loss", "shadowing"}), "message_bytes")


class SentPackets(NamedTuple):
    """K packets over one link; row k has sequence number k."""

    sent_s: Array  # (K,)
    received_s: Array  # (K,) of the first copy that arrives; NaN: none
    second_s: Array  # (K,) of a second copy; NaN: none
    outcome: Outcomes  # (K,) of PacketOutcome


def send_packets(
    sent_s: Sequence[float] | Array,
    *,
    seed: int = 0,
    **keys: Any,  # noqa: ANN401 - as of a scenario
) -> SentPackets:
    """Send packets over one link, and return when each arrives.

    The random numbers of a packet depend on the seed and its sequence number only.

    Args:
        sent_s: (K,) transmission times, s, which do not decrease.
        seed: of the random numbers.
        keys: of `KEYS`, as in the section `network` of a scenario: `delay_s=0.1`,
            `jitter={"spread_s": 0.02}`, `loss=0.05`, `rate={"bit_per_s": 57600}`. A link without
            keys delivers each packet at once.

    Raises:
        InputError: a key is not of `KEYS`, there are no times, they decrease or are not finite, or
            a file of delays or a trace cannot be used.
        pydantic.ValidationError: the value of a key is out of range.
    """
    if unknown := sorted(keys.keys() - set(KEYS)):
        raise InputError(f"a link alone has no {join_names(unknown)} (write {', '.join(KEYS)})")
    times_s = np.array(sent_s, dtype=np.float64)
    if not times_s.size or not np.isfinite(times_s).all() or (np.diff(times_s) < 0.0).any():
        raise InputError("sent_s: write one or more finite times, s, that do not decrease")
    pairs = resolve_links(_NAMES, Network.model_validate(keys))
    channel, count = make_channel(pairs, seed), len(times_s)
    links, departures_s = initial_links(channel), initial_departures(channel)
    transmitters, messages = initial_transmitters(len(_NAMES)), allocate(MESSAGE, len(_NAMES))
    rows = np.zeros(count, dtype=np.int64)
    scripted = scripted_outcomes(make_outages(pairs), times_s, rows, np.arange(count))[0]
    replays = make_replays(pairs, seed)
    trace_s = np.full(count, np.nan)
    if replays is not None:
        trace_s = replayed_delays(replays, times_s, rows)[0]
    senders, muted = np.array([True, False]), np.zeros(len(_NAMES), dtype=bool)
    arrivals_s, outcome = np.empty((count, 2)), np.empty(count, dtype=np.uint8)
    now_s, packet = np.zeros(len(_NAMES)), links["packet"][0, 0]
    for k in range(count):
        now_s[0], packet["scripted"], packet["trace_delay_s"] = times_s[k], scripted[k], trace_s[k]
        transmit_broadcast(
            links, departures_s, channel.tables, transmitters, senders, muted, now_s, messages
        )
        arrivals_s[k], outcome[k] = packet["arrival_s"], packet["outcome"]
    arrivals_s.sort(axis=1)
    arrivals_s[np.isinf(arrivals_s)] = np.nan
    return SentPackets(times_s, arrivals_s[:, 0], arrivals_s[:, 1], outcome)
