"""Measured traces: losses and delays of messages in the past, replayed by transmission time.

A message has the delay of the row nearest to it in time. So a trace that is replayed at its own
rate gives its own outcomes, each once, even if the rate was not quite even. The links of a file
share its time: links that failed together fail together.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.csv_table import CsvTable, read_table
from testbed.core.random import named_stream
from testbed.core.ranges import CLOCK, DELAY, Range
from testbed.core.records import Array
from testbed.network.links import PairLinks
from testbed.scenario.references import find_data

ENDS = ("source", "destination")
COLUMNS: Mapping[str, Range] = {"sent_s": CLOCK, "received_s": CLOCK}  # less each other: `DELAY`


class LinkTrace(NamedTuple):
    """K messages over one link, repeated after the span; times are those of the file."""

    sent_s: Array  # (K,)
    delay_s: Array  # (K,); infinite: lost
    earliest_s: float  # of all rows of the file
    span_s: float  # of its longest link, and that link's median interval to the first row again
    from_s: float  # from when the first row is nearer than the last of the previous repetition
    until_s: Array  # (K,) until when each row is nearer than the next


class Replays(NamedTuple):
    """The links between N aircraft and n followers that replay a trace."""

    traces: tuple[LinkTrace, ...]
    trace_index: NDArray[np.int64]  # (n, N) into `traces`, -1: none
    begin_s: Array  # (n, N) time of the file at the start of the run


def make_replays(pairs: PairLinks, seed: int) -> Replays | None:
    """Make the traces that the links of a scenario replay; None if no link does.

    Args:
        pairs: the links of N aircraft.
        seed: of the run; with the names of a link it gives the random start of a trace.

    Raises:
        InputError: a file is not a trace of the links it is for.
    """
    names, index = pairs.names, np.full(pairs.numbers.shape, -1)
    begin = np.zeros(index.shape)
    files: dict[str, TraceFile] = {}
    traces: dict[tuple[str, ...], LinkTrace] = {}  # by file and link
    for i, m, link in pairs.pairs():
        chosen, source, destination = link.trace, names[m], names[i + 1]
        if chosen is None:
            continue
        if chosen.file not in files:
            files[chosen.file] = TraceFile(find_data(chosen.file))
        file = files[chosen.file]
        key = chosen.file, *file.link(source, destination)
        trace = traces.setdefault(key, file.trace(source, destination))
        index[i, m] = list(traces).index(key)
        begin[i, m] = trace.earliest_s if chosen.begin_s is None else chosen.begin_s
        if chosen.random_start:
            draw = named_stream(seed, f"network/{source}>{destination}/trace").random()
            begin[i, m] += draw * trace.span_s
    return Replays(tuple(traces.values()), index, begin) if traces else None


def trace_delay(trace: LinkTrace, time_s: Array) -> Array:
    """Return the delay of messages by their times (…) of the file, s.

    Infinite: lost.
    """
    moment = trace.from_s + np.mod(time_s - trace.from_s, trace.span_s)
    near = np.searchsorted(trace.until_s, moment, side="right")
    return trace.delay_s[np.minimum(near, len(trace.delay_s) - 1)]


def replayed_delays(replays: Replays, sent_s: Array, rows: NDArray[np.int64]) -> Array:
    """Return the delays (n, S) s of messages to n followers.

    Infinite: lost; NaN: no trace.

    Args:
        replays: of all links.
        sent_s: (S,) s, transmission times.
        rows: (S,) of the senders.
    """
    index, time_s = replays.trace_index[:, rows], sent_s + replays.begin_s[:, rows]
    out = np.full(index.shape, np.nan)
    for number in np.unique(index[index >= 0]):
        links = index == number
        out[links] = trace_delay(replays.traces[number], time_s[links])
    return out


class TraceFile:
    """A file of traces, read once for all of its links.

    It has columns sent_s and received_s, whose empty cells are losses; with several links also
    source and destination. Other columns are ignored.

    Raises:
        InputError: with file, line and remedy, if it is not a trace.
    """

    def __init__(self, path: Path) -> None:
        table = read_table(path)
        table.numbers({})  # every row is as long as the header
        missing = [name for name in COLUMNS if name not in table.header]
        if missing:
            raise table.error_at(
                0, f"missing column {', '.join(missing)}; write sent_s and received_s in the header"
            )
        ends = [name for name in ENDS if name in table.header]
        if len(ends) == 1:
            raise table.error_at(
                0, f"{ends[0]} without the other end; write both {' and '.join(ENDS)}, or neither"
            )
        links: dict[tuple[str, ...], list[int]] = {}
        pairs = zip(*map(table.column, ends), strict=True) if ends else [()] * len(table.rows)
        for k, pair in enumerate(pairs):
            links.setdefault(pair, []).append(k)
        self._table, self._links, self._one_link = table, links, not ends

    def link(self, source: str, destination: str) -> tuple[str, ...]:
        """Return the ends of a link in the file; none if it has one link."""
        return () if self._one_link else (source, destination)

    def trace(self, source: str, destination: str) -> LinkTrace:
        """Return the trace from one aircraft to another.

        Raises:
            InputError: the file has none.
        """
        pair = self.link(source, destination)
        if pair in self._links:
            return self._traces[pair]
        if self._one_link:
            raise self._table.error_at(0, "no rows; a trace needs two, to have a rate")
        known = ", ".join(f"{a} to {b}" for a, b in self._links)
        raise self._table.error_at(
            0,
            f"no row is from {source} to {destination}; it has {known or 'no rows'} (rename "
            "these, or give this link another trace)",
        )

    @cached_property
    def _traces(self) -> dict[tuple[str, ...], LinkTrace]:
        """Return the traces by source and destination; of a file of one link by ()."""
        each = {pair: _messages(self._table.select(rows)) for pair, rows in self._links.items()}
        times = [sent for sent, _ in each.values()]
        earliest, latest = min(sent[0] for sent in times), max(sent[-1] for sent in times)
        lap = max(np.ptp(sent) + np.median(np.diff(sent)) for sent in times)
        span = float(max(lap, latest - earliest))
        return {pair: _trace(*messages, float(earliest), span) for pair, messages in each.items()}


def _messages(table: CsvTable) -> tuple[Array, Array]:
    """Return transmission times (K,) and delays (K,) of a table of one link, s."""
    sent_column, received_column = ({name: limits} for name, limits in COLUMNS.items())
    sent = table.numbers(sent_column)[:, 0]
    if len(sent) < 2:
        raise table.error_at(0, "fewer than two rows; a trace needs two, to have a rate")
    arrived = [k for k, text in enumerate(table.column("received_s")) if text]
    delay = np.full(len(sent), np.inf)
    delay[arrived] = table.select(arrived).numbers(received_column)[:, 0] - sent[arrived]
    steps = np.diff(sent)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise table.error_at(
            k + 2,
            f"sent_s goes from {sent[k]:.12g} to {sent[k + 1]:.12g} after line "
            f"{table.lines[k + 1]}; sort the rows by sent_s, or name source and destination if "
            "they are of several links",
        )
    if (delay < 0.0).any():
        k = int(np.argmax(delay < 0.0))
        raise table.error_at(
            k + 1,
            f"received {-delay[k]:.6g} s before it was sent; correct received_s by the difference "
            "of the clocks",
        )
    late = np.isfinite(delay) & DELAY.outside(delay)
    if late.any():
        k = int(np.argmax(late))
        raise table.error_at(
            k + 1,
            f"received {delay[k]:.12g} s after it was sent, and {DELAY.key} allows up to "
            f"{DELAY.high:g} s: correct received_s by the difference of the clocks of sender and "
            "receiver, or leave it empty: the message is lost",
        )
    return sent, delay


def _trace(sent: Array, delay: Array, earliest: float, span: float) -> LinkTrace:
    until = 0.5 * (sent + np.append(sent[1:], sent[0] + span))
    return LinkTrace(sent, delay, earliest, span, float(until[-1]) - span, until)
