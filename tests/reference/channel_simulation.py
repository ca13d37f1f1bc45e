"""Send messages over a channel without aircraft, one broadcast after another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry
from testbed.core.records import MESSAGE, Array, BoolArray, Records, allocate
from testbed.network.channel import Channel, initial_departures, initial_links, initial_transmitters
from testbed.network.links import Outcomes
from testbed.network.packet_outcomes import transmit_broadcast


class ChannelRun(NamedTuple):
    """K messages of each of N aircraft to each of n followers; row k has sequence number k."""

    sent_s: Array  # (K, N)
    received_s: Array  # (K, n, N) of the first copy received; nan: none
    second_s: Array  # (K, n, N) of the second copy; nan: none
    outcome: Outcomes  # (K, n, N) of PacketOutcome
    copies: Outcomes  # (K, n, N) received copies


def transmit(
    channel: Channel,
    *,
    packets: int,
    period_s: float | Array,
    phase_s: float | Array = 0.0,
    fading: Array | None = None,
    scripted: Outcomes | None = None,
    trace_delay_s: Array | None = None,
) -> ChannelRun:
    """Send K messages on every link at equal intervals.

    Args:
        channel: between N aircraft and n followers.
        packets: K.
        period_s: s, of each aircraft (N,) or of all.
        phase_s: s, of each aircraft (N,) or of all: time of the first message.
        fading: (n, N) probability of a loss to distance and airframes.
        scripted: (K,) of PacketOutcome on all links, 0: none.
        trace_delay_s: (K,) s on all links; infinite: lost, nan: no trace.
    """
    _, aircraft = channel.links.shape
    period, phase = np.broadcast_to(period_s, aircraft), np.broadcast_to(phase_s, aircraft)
    sent_s = phase + np.arange(packets)[:, None] * period
    return transmit_at(
        channel, sent_s, fading=fading, scripted=scripted, trace_delay_s=trace_delay_s
    )


def transmit_at(
    channel: Channel,
    sent_s: Array,
    *,
    fading: Array | None = None,
    scripted: Outcomes | None = None,
    trace_delay_s: Array | None = None,
) -> ChannelRun:
    """Send messages on every link at these times (K, N), s; see `transmit`."""
    packets, aircraft = sent_s.shape
    links = initial_links(channel)
    if fading is not None:
        links["packet"]["fading"] = fading
    if scripted is None:
        scripted = np.zeros(packets, np.uint8)
    if trace_delay_s is None:
        trace_delay_s = np.full(packets, np.nan)
    arrivals_s = np.empty((packets, *channel.links.shape, 2))
    outcome = np.empty((packets, *channel.links.shape), np.uint8)
    _transmit_all(
        links,
        initial_departures(channel),
        channel.tables,
        initial_transmitters(aircraft),
        np.ones(aircraft, dtype=bool),
        np.zeros(aircraft, dtype=bool),
        np.ascontiguousarray(sent_s),
        allocate(MESSAGE, aircraft),
        scripted,
        trace_delay_s,
        arrivals_s,
        outcome,
    )
    arrivals_s.sort(axis=-1)
    arrivals_s[np.isinf(arrivals_s)] = np.nan
    copies = np.isfinite(arrivals_s).sum(axis=-1).astype(np.uint8)
    return ChannelRun(sent_s, arrivals_s[..., 0], arrivals_s[..., 1], outcome, copies)


@entry
def _transmit_all(
    links: Records,
    departures_s: Array,
    tables: Records,
    transmitters: Records,
    senders: BoolArray,
    muted: BoolArray,
    sent_s: Array,
    messages: Records,
    scripted: Outcomes,
    trace_delay_s: Array,
    arrivals_s: Array,
    outcome: Outcomes,
) -> None:
    """Send K broadcasts; see `transmit_broadcast`, and `ChannelRun` for what is written."""
    for k in range(len(sent_s)):
        for i in range(len(links)):
            for m in range(len(senders)):
                links[i, m].packet.scripted = scripted[k]
                links[i, m].packet.trace_delay_s = trace_delay_s[k]
        transmit_broadcast(
            links, departures_s, tables, transmitters, senders, muted, sent_s[k], messages
        )
        for i in range(len(links)):
            for m in range(len(senders)):
                packet = links[i, m].packet
                outcome[k, i, m] = packet.outcome
                for copy in range(2):
                    arrivals_s[k, i, m, copy] = packet.arrival_s[copy]
