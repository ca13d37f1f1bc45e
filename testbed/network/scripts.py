"""What is written down to go wrong: blackouts, partitions, mute aircraft, packets that are lost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.network.links import Fate, Fates
from testbed.network.slots import SIMULTANEOUS_S
from testbed.scenario.link import Window
from testbed.scenario.network import Network
from testbed.state import Array, Event, Truths

NUMBERS = 1 << 40  # of packets that a link can have; no run sends so many
MOST_SENDERS = 3  # that a line of the log names


class Script(NamedTuple):
    """What holds on some links for a while."""

    begin_s: float  # of sending, from here
    end_s: float  # to before here
    fate: int  # one of Fate
    hit: Truths  # (n, N) which links
    source: str  # of its events: "run", or who is mute
    begins: str  # what the log says
    ends: str


class Scripts(NamedTuple):
    """All that is written down for the links between N aircraft and n followers."""

    windows: tuple[Script, ...]  # where several hold, the first decides
    listed: NDArray[np.int64]  # sorted: number of a packet that is lost, + NUMBERS times its link's
    shape: tuple[int, int]  # (n, N)


def make_scripts(names: Sequence[str], network: Network) -> Scripts:
    """What a page's network has written down.

    Args:
        names: N, the leader first, who does not listen.
        network: the section of the page.
    """
    windows = (*_mute(names, network), *_divided(names, network), *_dark(names, network))
    shape = (len(names) - 1, len(names))
    listed = [
        NUMBERS * (i * len(names) + m) + number
        for i, m in _links(names)
        for number in network.link(names[m], names[i + 1]).drop or ()
        if number < NUMBERS
    ]
    return Scripts(windows, np.unique(np.array(listed, dtype=np.int64)), shape)


def blocked(
    scripts: Scripts,
    sent_s: Array,
    rows: NDArray[np.int64],
    sequence: NDArray[np.int64],
) -> Fates:
    """What the scripts have for messages of S aircraft to n followers: one of Fate, 0: nothing.

    Args:
        scripts: of all links.
        sent_s: (S,) when.
        rows: (S,) who sends.
        sequence: (S,) numbers of their messages, from 0.

    Returns:
        (n, S).
    """
    n, aircraft = scripts.shape
    out = np.zeros((n, len(rows)), dtype=np.uint8)
    if scripts.listed.size:
        link = aircraft * np.arange(n)[:, None] + rows
        wanted = NUMBERS * link + sequence
        near = np.minimum(np.searchsorted(scripts.listed, wanted), scripts.listed.size - 1)
        out[scripts.listed[near] == wanted] = Fate.LISTED
    at = sent_s + SIMULTANEOUS_S
    first, last = at.min(), at.max()
    for each in reversed(scripts.windows):
        if each.begin_s <= last and first < each.end_s:
            now = (each.begin_s <= at) & (at < each.end_s)
            out[each.hit[:, rows] & now] = each.fate
    return out


class Calendar:
    """Tells of scripts as they begin and end."""

    def __init__(self, scripts: Scripts) -> None:
        """Nothing was told yet."""
        lines = [(each.begin_s, each.source, each.begins) for each in scripts.windows]
        lines += [(each.end_s, each.source, each.ends) for each in scripts.windows]
        self._lines = sorted(lines, key=lambda line: line[0], reverse=True)
        self._next = self._lines[-1][0] if lines else np.inf

    def changes(self, now: float) -> Iterator[Event]:
        """An event for each script that began or ended since the last call."""
        while self._next <= now + SIMULTANEOUS_S:
            _, source, text = self._lines.pop()
            self._next = self._lines[-1][0] if self._lines else np.inf
            yield Event(now, "info", source, text)


def _links(names: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Row and column of every link but those from an aircraft to itself."""
    for i in range(len(names) - 1):
        for m in range(len(names)):
            if m != i + 1:
                yield i, m


def _nowhere(names: Sequence[str]) -> Truths:
    return np.zeros((len(names) - 1, len(names)), dtype=bool)


def _mute(names: Sequence[str], network: Network) -> Iterator[Script]:
    for name, windows in network.mute_s.items():
        hit = _nowhere(names)
        for i, m in _links(names):
            hit[i, m] = names[m] == name
        for begin, end in windows:
            yield Script(begin, end, Fate.MUTE, hit, name, "is mute", "is no longer mute")


def _divided(names: Sequence[str], network: Network) -> Iterator[Script]:
    for partition in network.partitions:
        named = [name for group in partition.groups for name in group]
        rest = tuple(name for name in names if name not in named)
        groups = [*partition.groups, rest] if rest else [*partition.groups]
        home = {name: number for number, group in enumerate(groups) for name in group}
        hit = _nowhere(names)
        for i, m in _links(names):
            hit[i, m] = home[names[m]] != home[names[i + 1]]
        words = " | ".join(" ".join(group) for group in groups)
        begins, ends = f"the network is divided: {words}", f"no longer divided: {words}"
        yield Script(*partition.window_s, Fate.PARTITION, hit, "run", begins, ends)


def _dark(names: Sequence[str], network: Network) -> Iterator[Script]:
    """One script for all links that have a blackout of the same times."""
    hits: dict[Window, Truths] = {}
    for i, m in _links(names):
        for window in network.link(names[m], names[i + 1]).blackout_s or ():
            hits.setdefault(window, _nowhere(names))[i, m] = True
    for (begin, end), hit in hits.items():
        words = f"blackout {_where(names, hit)}"
        yield Script(begin, end, Fate.BLACKOUT, hit, "run", f"{words} begins", f"{words} ends")


def _where(names: Sequence[str], hit: Truths) -> str:
    """Links in words."""
    if hit.sum() == sum(1 for _ in _links(names)):
        return "on all links"
    senders = np.flatnonzero(hit.any(axis=0)).tolist()
    if len(senders) > MOST_SENDERS:
        return f"on {hit.sum()} links of {len(senders)} aircraft"
    parts = []
    for m in senders:
        heard = [names[i + 1] for i in np.flatnonzero(hit[:, m]).tolist()]
        everyone = len(heard) == len(names) - 1 - (m > 0)
        parts.append(f"from {names[m]} to {'everyone' if everyone else ' and '.join(heard)}")
    return ", ".join(parts)
