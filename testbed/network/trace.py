"""Measured traces: what a link did to messages sent in the past, replayed by the time of sending.

A message meets what the row nearest to it in time met. So a trace that is replayed at the pace it
was sent at gives its own fates, each once, even if that pace was not quite even.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
    """K messages over one link, and over again after the span."""

    sent_s: Array  # (K,) after the first was sent
    delay_s: Array  # (K,); infinite: lost
    span_s: float  # from the first row to the last, and the median interval to the first again
    until_s: Array  # (K,) up to when each row is nearer than the next


class Replays(NamedTuple):
    """The links between N aircraft and n followers that replay a trace."""

    traces: tuple[Trace, ...]
    which: NDArray[np.int64]  # (n, N) number of the trace, -1: none
    begin_s: Array  # (n, N) moment of the trace at the start of the run


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
    traces: list[Trace] = []
    files: dict[str, _File] = {}
    for i, destination in enumerate(names[1:]):
        for m, source in enumerate(names):
            chosen = None if source == destination else network.link(source, destination).trace
            if chosen is None:
                continue
            if chosen.file not in files:
                files[chosen.file] = _File(find_data(chosen.file))
            trace = files[chosen.file].trace(source, destination)
            which[i, m] = len(traces)
            traces.append(trace)
            if chosen.shifted:
                draw = stream(seed, f"network/{source}>{destination}/trace").random()
                begin[i, m] = draw * trace.span_s
    return Replays(tuple(traces), which, begin) if traces else None


def read_trace(path: Path, source: str, destination: str) -> Trace:
    """Read what happened to messages from one aircraft to another.

    The file has columns sent_s and received_s, whose empty cells are losses; and source and
    destination, if it has several links. Other columns are ignored.

    Raises:
        InputError: with file, line and remedy, if it is not a trace of this link.
    """
    return _File(path).trace(source, destination)


def looked_up(trace: Trace, sent_s: Array, begin_s: float = 0.0) -> Array:
    """Delay of messages sent at these times (…) of the run, s; infinite: lost.

    Args:
        trace: to be replayed, its first row at the start of the run.
        sent_s: times (…).
        begin_s: moment of the trace at the start of the run, in place of that.
    """
    moment = np.mod(sent_s + begin_s, trace.span_s)
    near = np.searchsorted(trace.until_s, moment, side="right")
    return trace.delay_s[near % len(trace.delay_s)]


def replayed(replays: Replays, sent_s: Array, rows: NDArray[np.int64]) -> Array:
    """Delay (n, S) s of messages sent at `sent_s` (S,) by the aircraft `rows` (S,) to n followers.

    Infinite: lost; nan: the link replays no trace.
    """
    which, begin = replays.which[:, rows], replays.begin_s[:, rows]
    out = np.full(which.shape, np.nan)
    for i, s in zip(*np.nonzero(which >= 0), strict=True):
        out[i, s] = looked_up(replays.traces[which[i, s]], sent_s[s], begin[i, s])
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
        self._table = table
        self._rows: dict[tuple[str, str], list[int]] = {}
        for k, ends in enumerate(zip(*map(table.column, told), strict=True)):
            self._rows.setdefault(ends, []).append(k)
        self._one_link = not told

    def trace(self, source: str, destination: str) -> Trace:
        """What happened from one aircraft to another."""
        if self._one_link:
            return _trace(self._table)
        rows = self._rows.get((source, destination))
        if rows is None:
            known = ", ".join(f"{a} to {b}" for a, b in self._rows)
            raise self._table.refusal(
                0,
                f"no row is from {source} to {destination}; it has {known or 'no rows'} (rename "
                "these, or give this link another trace)",
            )
        return _trace(_picked(self._table, rows))


def _picked(table: Table, rows: Sequence[int]) -> Table:
    return replace(
        table,
        rows=tuple(table.rows[k] for k in rows),
        lines=(table.lines[0], *(table.lines[k + 1] for k in rows)),
    )


def _trace(table: Table) -> Trace:
    """The trace of a table (K rows) of one link."""
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
    sent -= sent[0]
    span = float(sent[-1] + np.median(steps))
    return Trace(sent, delay, span, 0.5 * (sent + np.append(sent[1:], span)))
