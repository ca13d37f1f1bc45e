"""Measured traces: what a link did to messages sent in the past, replayed by the time of sending.

A message meets what the row nearest to it in time met. So a trace that is replayed at the pace it
was sent at gives its own fates, each once, even if that pace was not quite even. The links of a
file share its time: what failed together fails together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.csv_table import Table, read_table
from testbed.scenario.network import Network
from testbed.scenario.resolve import find_data
from testbed.state import Array
from testbed.streams import stream

ENDS = ("source", "destination")


class Trace(NamedTuple):
    """K messages over one link, and over again after the span; times are the file's."""

    sent_s: Array  # (K,)
    delay_s: Array  # (K,); infinite: lost
    earliest_s: float  # row of the file, of any link
    span_s: float  # of its longest link, and that link's median interval to the first row again
    from_s: float  # since when the first row is nearer than the last of the lap before
    until_s: Array  # (K,) up to when each row is nearer than the next


class Replays(NamedTuple):
    """The links between N aircraft and n followers that replay a trace."""

    traces: tuple[Trace, ...]
    which: NDArray[np.int64]  # (n, N) number of the trace, -1: none
    begin_s: Array  # (n, N) time of the file at the start of the run


def make_replays(names: Sequence[str], network: Network, seed: int) -> Replays | None:
    """What the links of a page replay; none if no link does.

    Args:
        names: N, the leader first, who does not listen.
        network: the section of the page.
        seed: of the run; with the names of a link it gives the moment where a shifted trace begins.

    Raises:
        InputError: a file is not a trace of the links it is for.
    """
    which = np.full((len(names) - 1, len(names)), -1)
    begin = np.zeros(which.shape)
    files: dict[str, _File] = {}
    known: dict[int, int] = {}  # numbers of traces by their identity
    traces: list[Trace] = []
    for i, destination in enumerate(names[1:]):
        for m, source in enumerate(names):
            chosen = None if source == destination else network.link(source, destination).trace
            if chosen is None:
                continue
            if chosen.file not in files:
                files[chosen.file] = _File(find_data(chosen.file))
            trace = files[chosen.file].trace(source, destination)
            which[i, m] = known.setdefault(id(trace), len(traces))
            if which[i, m] == len(traces):
                traces.append(trace)
            begin[i, m] = trace.earliest_s if chosen.begin_s is None else chosen.begin_s
            if chosen.shifted:
                draw = stream(seed, f"network/{source}>{destination}/trace").random()
                begin[i, m] += draw * trace.span_s
    return Replays(tuple(traces), which, begin) if traces else None


def read_trace(path: Path, source: str, destination: str) -> Trace:
    """Read what happened to messages from one aircraft to another.

    The file has columns sent_s and received_s, whose empty cells are losses; and source and
    destination, if it has several links. Other columns are ignored.

    Raises:
        InputError: with file, line and remedy, if it is not a trace of this link.
    """
    return _File(path).trace(source, destination)


def looked_up(trace: Trace, time_s: Array) -> Array:
    """Delay of messages sent at these times (…) of the file or of laps of it, s; infinite: lost."""
    moment = trace.from_s + np.mod(time_s - trace.from_s, trace.span_s)
    near = np.searchsorted(trace.until_s, moment, side="right")
    return trace.delay_s[np.minimum(near, len(trace.delay_s) - 1)]


def replayed(replays: Replays, sent_s: Array, rows: NDArray[np.int64]) -> Array:
    """Delay (n, S) s of messages sent at `sent_s` (S,) by the aircraft `rows` (S,) to n followers.

    Infinite: lost; nan: the link replays no trace.
    """
    which, time_s = replays.which[:, rows], sent_s + replays.begin_s[:, rows]
    out = np.full(which.shape, np.nan)
    for number in np.unique(which[which >= 0]):
        links = which == number
        out[links] = looked_up(replays.traces[number], time_s[links])
    return out


class _File:
    """A file of traces, read once for all of its links."""

    def __init__(self, path: Path) -> None:
        table = read_table(path)
        table.numbers(())  # every row is as long as the header
        if "sent_s" not in table.header or "received_s" not in table.header:
            missing = [name for name in ("sent_s", "received_s") if name not in table.header]
            raise table.refusal(
                0, f"missing column {', '.join(missing)}; write sent_s and received_s in the header"
            )
        told = [name for name in ENDS if name in table.header]
        if len(told) == 1:
            raise table.refusal(
                0, f"{told[0]} without the other end; write both {' and '.join(ENDS)}, or neither"
            )
        links: dict[tuple[str, ...], list[int]] = {}
        ends = zip(*map(table.column, told), strict=True) if told else [()] * len(table.rows)
        for k, pair in enumerate(ends):
            links.setdefault(pair, []).append(k)
        self._table, self._links, self._one_link = table, links, not told

    def trace(self, source: str, destination: str) -> Trace:
        """What happened from one aircraft to another."""
        pair = () if self._one_link else (source, destination)
        if pair in self._links:
            return self._traces[pair]
        if self._one_link:
            raise self._table.refusal(0, "no rows; a trace needs two, to have a pace")
        known = ", ".join(f"{a} to {b}" for a, b in self._links)
        raise self._table.refusal(
            0,
            f"no row is from {source} to {destination}; it has {known or 'no rows'} (rename "
            "these, or give this link another trace)",
        )

    @cached_property
    def _traces(self) -> dict[tuple[str, ...], Trace]:
        """By ends of a link; of a file of one link, by nothing."""
        each = {pair: _messages(_picked(self._table, rows)) for pair, rows in self._links.items()}
        times = [sent for sent, _ in each.values()]
        earliest, latest = min(sent[0] for sent in times), max(sent[-1] for sent in times)
        lap = max(np.ptp(sent) + np.median(np.diff(sent)) for sent in times)
        span = float(max(lap, latest - earliest))
        return {pair: _trace(*messages, float(earliest), span) for pair, messages in each.items()}


def _picked(table: Table, rows: Sequence[int]) -> Table:
    return replace(
        table,
        rows=tuple(table.rows[k] for k in rows),
        lines=(table.lines[0], *(table.lines[k + 1] for k in rows)),
    )


def _messages(table: Table) -> tuple[Array, Array]:
    """When messages (K,) of a table of one link were sent, s, and their delays."""
    sent = table.numbers(["sent_s"])[:, 0]
    if len(sent) < 2:
        raise table.refusal(0, "fewer than two rows; a trace needs two, to have a pace")
    arrived = [k for k, text in enumerate(table.column("received_s")) if text]
    delay = np.full(len(sent), np.inf)
    delay[arrived] = _picked(table, arrived).numbers(["received_s"])[:, 0] - sent[arrived]
    steps = np.diff(sent)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise table.refusal(
            k + 2,
            f"sent_s goes from {sent[k]:.12g} to {sent[k + 1]:.12g} after line "
            f"{table.lines[k + 1]}; sort the rows by sent_s, or name source and destination if "
            "they are of several links",
        )
    if (delay < 0.0).any():
        k = int(np.argmax(delay < 0.0))
        raise table.refusal(
            k + 1,
            f"received {-delay[k]:.6g} s before it was sent; correct received_s by the difference "
            "of the clocks",
        )
    return sent, delay


def _trace(sent: Array, delay: Array, earliest: float, span: float) -> Trace:
    until = 0.5 * (sent + np.append(sent[1:], sent[0] + span))
    return Trace(sent, delay, earliest, span, float(until[-1]) - span, until)
