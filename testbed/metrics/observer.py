"""The observer that measures a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from testbed.metrics import tally as tallying
from testbed.metrics.block import Block
from testbed.metrics.summary import summarise
from testbed.metrics.tally import BLOCK, Windows
from testbed.rows import Columns, Rows
from testbed.state import Array, Event, Frame, RunInfo

_MEASURED = (
    "truth.position_ned",
    "truth.euler",
    "formation.error_ned",
    "formation.slot_ned",
    "formation.guards",
    "formation.saturations",
    "air.wind_ned",
    "air.roll_coefficient",
    "command.throttle",
    "lost",
    "formation.place",
)
_ESTIMATED = ("position_ned", "velocity_ned", "euler", "airspeed")
_BELIEVED = "formation.believed_ned"
_COMPARED = (f"{who}.{kept}" for who in ("estimate", "truth") for kept in _ESTIMATED)
_SOURCES = tuple(dict.fromkeys((*_MEASURED, *_COMPARED, _BELIEVED)))


class MetricsObserver:
    """Measure a run while it flies; `summary` may be asked for at any moment.

    Args:
        portions: Window (start, end) in s by name; start inside, end outside. Default: those of
            the run it is given.
        published: The numbers somebody else reached on this scenario, handed through to the
            summary: `source`, `rms_m`, `mean_rms_m` and `percent_error` by portion.
    """

    borrows = True  # keeps no array of a frame

    def __init__(
        self,
        portions: Mapping[str, tuple[float, float]] | None = None,
        published: Mapping[str, Any] | None = None,
    ) -> None:
        """See the class."""
        self._portions = portions
        self._published = published
        self._info: RunInfo | None = None
        self._events: list[Event] = []

    def begin(self, info: RunInfo) -> None:
        """Make room for the rows of one block."""
        self._info = info
        spans = dict(info.portions if self._portions is None else self._portions)
        self._windows = Windows(
            names=tuple(spans),
            start_s=np.array([start for start, _ in spans.values()], dtype=np.float64),
            end_s=np.array([end for _, end in spans.values()], dtype=np.float64),
        )
        self._tally = tallying.empty(len(spans), len(info.names) - 1)
        self._events = []
        self._kept = Rows(_SOURCES, attrgetter(*_SOURCES), room=BLOCK)

    def observe(self, frame: Frame) -> None:
        """Copy what is measured; fold the block when it is full."""
        kept = self._kept
        kept.append(frame)
        if frame.events:
            self._events.extend(frame.events)
        if len(kept.tick) == BLOCK:
            self._tally = self._folded()
            kept.clear()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Nothing is left to do: `summary` counts the rows of an open block too."""

    def summary(self, after: Sequence[Event] = ()) -> dict[str, Any]:
        """The numbers of the frames seen so far, ready for JSON; changes nothing.

        Args:
            after: what has happened since the last frame.

        Raises:
            RuntimeError: No run has begun.
        """
        if self._info is None:
            raise RuntimeError("there is nothing to sum up: begin() was not called")
        return summarise(
            self._folded(),
            windows=self._windows,
            info=self._info,
            events=[*self._events, *after],
            published=self._published,
        )

    def _folded(self) -> tallying.Tally:
        assert self._info is not None
        kept = self._kept
        if not kept.tick:
            return self._tally
        columns = kept.columns()
        block = _block(kept.tick, columns)
        if kept.erring:
            block = _with_estimates(block, kept.erring, columns)
        return tallying.fold(
            self._tally,
            block,
            windows=self._windows,
            base_rate_hz=self._info.base_rate_hz,
            medium_ned=np.array(self._info.bounded_in_ned),
        )


def _block(tick: list[int], columns: Columns) -> Block:
    """The frames of which these are the ticks and the `_MEASURED`; estimates are exact."""
    measured = {source: np.ascontiguousarray(columns[source]) for source in _MEASURED}
    error_ned = measured["formation.error_ned"]
    return Block(
        tick=np.array(tick, dtype=np.int64),
        position_ned=measured["truth.position_ned"],
        bank=measured["truth.euler"][:, 0, 0],
        error_ned=error_ned,
        slot_ned=measured["formation.slot_ned"],
        place=measured["formation.place"],
        guards=measured["formation.guards"].astype(np.int64),
        saturations=measured["formation.saturations"].astype(np.int64),
        wind_ned=measured["air.wind_ned"],
        roll_coefficient=measured["air.roll_coefficient"],
        throttle=measured["command.throttle"],
        lost=measured["lost"],
        believed_ned=error_ned,
        off=(),
    )


def _with_estimates(block: Block, rows: list[int], columns: Columns) -> Block:
    """The block with what the estimates add, which err in these of its rows."""
    exact = np.ones(len(block.tick), dtype=bool)
    exact[rows] = False
    believed_ned = columns[_BELIEVED].copy()
    believed_ned[exact] = block.error_ned[exact]

    def off(kept: str) -> Array:
        with np.errstate(invalid="ignore"):  # of an aircraft that left its model's range
            out: Array = columns[f"estimate.{kept}"] - columns[f"truth.{kept}"]
        out[exact] = 0.0
        return out

    return replace(block, believed_ned=believed_ned, off=tuple(map(off, _ESTIMATED)))
