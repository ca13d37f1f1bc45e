"""Outages that a scenario scripts: blackouts, partitions, transmitters off, dropped packets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, BoolArray, Event
from testbed.network.links import Outcomes, PacketOutcome, PairLinks
from testbed.network.packet_outcomes import SIMULTANEOUS_S
from testbed.scenario.network import Network, Window

LINK_STRIDE = 1 << 40  # in a number of link and packet; more packets than any run sends
MAX_SENDERS = 3  # whose names an event has


class Outage(NamedTuple):
    """An outage of some links for a while."""

    begin_s: float  # of transmission times, from here
    end_s: float  # to before here
    outcome: int  # PacketOutcome
    links: BoolArray  # (n, N)
    source: str  # of its events: "run", or the aircraft whose transmitter is off
    begins: str  # text of the event
    ends: str


class Outages(NamedTuple):
    """All outages of the links between N aircraft and n followers."""

    windows: tuple[Outage, ...]  # where several overlap, the first decides
    dropped: NDArray[np.int64]  # sorted: sequence number + LINK_STRIDE times number of the link
    shape: tuple[int, int]  # (n, N)


def make_outages(pairs: PairLinks) -> Outages:
    """Make the outages of a scenario's network.

    Args:
        pairs: the links of N aircraft.
    """
    names, network = pairs.names, pairs.network
    windows = (
        *_transmitters_off(names, network),
        *_partitions(names, network),
        *_blackouts(names, pairs),
    )
    shape = (len(names) - 1, len(names))
    dropped = [
        LINK_STRIDE * (i * len(names) + m) + number
        for i, m, link in pairs.pairs()
        for number in link.drop or ()
        if number < LINK_STRIDE
    ]
    return Outages(windows, np.unique(np.array(dropped, dtype=np.int64)), shape)


def scripted_outcomes(
    outages: Outages, sent_s: Array, rows: NDArray[np.int64], numbers: NDArray[np.int64]
) -> Outcomes:
    """Return the PacketOutcome (n, S) by outages of messages of S aircraft; 0: none.

    Args:
        outages: of all links.
        sent_s: (S,) s, transmission times.
        rows: (S,) of the senders.
        numbers: (S,) sequence numbers, from 0.
    """
    n, aircraft = outages.shape
    out = np.zeros((n, len(rows)), dtype=np.uint8)
    if outages.dropped.size:
        link = aircraft * np.arange(n)[:, None] + rows
        wanted = LINK_STRIDE * link + numbers
        near = np.minimum(np.searchsorted(outages.dropped, wanted), outages.dropped.size - 1)
        out[outages.dropped[near] == wanted] = PacketOutcome.LISTED
    at = sent_s + SIMULTANEOUS_S
    first, last = at.min(), at.max()
    for each in reversed(outages.windows):
        if each.begin_s <= last and first < each.end_s:
            now = (each.begin_s <= at) & (at < each.end_s)
            out[each.links[:, rows] & now] = each.outcome
    return out


class OutageEvents:
    """Report outages as they begin and end."""

    def __init__(self, outages: Outages) -> None:
        lines = [(each.begin_s, each.source, each.begins) for each in outages.windows]
        lines += [(each.end_s, each.source, each.ends) for each in outages.windows]
        self._lines = sorted(lines, key=lambda line: line[0], reverse=True)
        self._next = self._lines[-1][0] if lines else np.inf

    def changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each outage that began or ended since the last call."""
        while self._next <= now + SIMULTANEOUS_S:
            _, source, text = self._lines.pop()
            self._next = self._lines[-1][0] if self._lines else np.inf
            yield Event(now, "info", source, text)


def _transmitters_off(names: Sequence[str], network: Network) -> Iterator[Outage]:
    for name, windows in network.transmitter_off_s.items():
        of_sender = np.array(names) == name
        links = of_sender & ~of_sender[1:, np.newaxis]  # none from an aircraft to itself
        begins, ends = "transmitter off", "transmitter on again"
        for begin, end in windows:
            yield Outage(begin, end, PacketOutcome.MUTED, links, name, begins, ends)


def _partitions(names: Sequence[str], network: Network) -> Iterator[Outage]:
    for partition in network.partitions:
        named = [name for group in partition.groups for name in group]
        rest = tuple(name for name in names if name not in named)
        groups = [*partition.groups, rest] if rest else [*partition.groups]
        group_of = {name: number for number, group in enumerate(groups) for name in group}
        numbers = np.array([group_of[name] for name in names])
        links = numbers != numbers[1:, np.newaxis]
        text = f"partition {' | '.join(' '.join(group) for group in groups)}"
        begins, ends = f"{text} begins", f"{text} ends"
        yield Outage(*partition.window_s, PacketOutcome.PARTITION, links, "run", begins, ends)


def _blackouts(names: Sequence[str], pairs: PairLinks) -> Iterator[Outage]:
    """Yield one outage for all links with a blackout of the same times."""
    links_of: dict[Window, BoolArray] = {}
    for i, m, link in pairs.pairs():
        for window in link.blackout_s or ():
            links_of.setdefault(window, np.zeros(pairs.numbers.shape, bool))[i, m] = True
    for (begin, end), links in links_of.items():
        text = f"blackout {_describe(names, links)}"
        begins, ends = f"{text} begins", f"{text} ends"
        yield Outage(begin, end, PacketOutcome.BLACKOUT, links, "run", begins, ends)


def _describe(names: Sequence[str], links: BoolArray) -> str:
    if links.sum() == (len(names) - 1) ** 2:  # each follower receives from all but itself
        return "on all links"
    senders = np.flatnonzero(links.any(axis=0)).tolist()
    if len(senders) > MAX_SENDERS:
        return f"on {links.sum()} links of {len(senders)} aircraft"
    parts = []
    for m in senders:
        receivers = [names[i + 1] for i in np.flatnonzero(links[:, m]).tolist()]
        to_all = len(receivers) == len(names) - 1 - (m > 0)
        parts.append(f"from {names[m]} to {'all' if to_all else ' and '.join(receivers)}")
    return ", ".join(parts)
