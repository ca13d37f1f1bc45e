"""The observer that measures a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.metrics import estimates
from testbed.metrics import tally as tallying
from testbed.metrics.block import Block, Ticks
from testbed.metrics.summary import summarise
from testbed.metrics.tally import BLOCK, Windows
from testbed.state import Array, Event, Frame, RunInfo, Truths


class MetricsObserver:
    """Measure a run while it flies; `summary` may be asked for at any moment.

    Args:
        portions: Window (start, end) in s by name; start inside, end outside. Default: those of
            the run it is given.
        published: The numbers somebody else reached on this scenario, handed through to the
            summary: `source`, `rms_m`, `mean_rms_m` and `percent_error` by portion.
    """

    borrows = True  # what is measured is copied at once

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
        aircraft, followers = len(info.names), len(info.names) - 1
        self._tally = tallying.empty(len(spans), followers)
        self._events = []
        self._tick = np.zeros(BLOCK, dtype=np.int64)
        self._rows = np.empty((BLOCK, 12 * aircraft + 9 * followers))
        # what the estimates add to these rows, in those of them whose estimates err
        self._beliefs = np.zeros((BLOCK, estimates.COLUMNS * aircraft + 3 * followers))
        self._errs = np.zeros(BLOCK, dtype=np.bool_)
        self._filled = 0

    def observe(self, frame: Frame) -> None:
        """Copy what is measured into a row; fold the block when it is full."""
        formation = frame.formation
        row = self._filled
        np.concatenate(
            (
                frame.truth.position_ned,
                frame.truth.euler,
                formation.error_ned,
                formation.slot_ned,
                formation.guards,
                formation.saturations,
                frame.air.wind_ned,
                frame.air.roll_coefficient,
                frame.command.throttle,
                frame.lost,
                formation.place,
            ),
            axis=None,
            out=self._rows[row],
        )
        if frame.estimate is not frame.truth:
            self._errs[row] = True
            believed = (*estimates.errors(frame), formation.believed_ned)
            np.concatenate(believed, axis=None, out=self._beliefs[row])
        self._tick[row] = frame.tick
        self._filled = row + 1
        if frame.events:
            self._events.extend(frame.events)
        if self._filled == BLOCK:
            self._tally = self._folded()
            self._filled = 0
            self._errs[:] = False

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
        filled = slice(self._filled)
        aircraft, errs = len(self._info.names), self._errs[filled]
        block = _block(self._rows[filled], self._tick[filled], aircraft)
        if errs.any():
            block = _with_estimates(block, self._beliefs[filled], errs)
        return tallying.fold(
            self._tally,
            block,
            windows=self._windows,
            base_rate_hz=self._info.base_rate_hz,
            medium_ned=np.array(self._info.bounded_in_ned),
        )


def _block(rows: Array, tick: Ticks, aircraft: int) -> Block:
    """Give the columns of rows (K, columns) their names and shapes; estimates are exact."""
    frames, followers = len(rows), aircraft - 1
    widths = [3 * aircraft, 3 * aircraft, 3 * followers, 3 * followers, followers, followers]
    widths += [3 * aircraft, aircraft, aircraft, aircraft]
    position, euler, error, slot, guards, saturations, wind, roll, throttle, lost, place = np.split(
        rows, np.cumsum(widths), axis=1
    )
    error_ned = error.reshape(frames, followers, 3)
    return Block(
        tick=tick,
        position_ned=position.reshape(frames, aircraft, 3),
        bank=euler[:, 0],
        error_ned=error_ned,
        slot_ned=slot.reshape(frames, followers, 3),
        place=place,
        guards=guards.astype(np.int64),
        saturations=saturations.astype(np.int64),
        wind_ned=wind.reshape(frames, aircraft, 3),
        roll_coefficient=roll,
        throttle=throttle,
        lost=lost.astype(np.bool_),
        believed_ned=error_ned,
        off=(),
    )


def _with_estimates(block: Block, beliefs: Array, errs: Truths) -> Block:
    """The block with what the estimates add in the rows (K,) whose estimates err."""
    frames, aircraft = block.lost.shape
    beliefs = np.where(errs[:, None], beliefs, 0.0)
    widths = np.array([3, 3, 3, 1]) * aircraft
    position, velocity, euler, airspeed, believed = np.split(beliefs, np.cumsum(widths), axis=1)
    vectors = (each.reshape(frames, aircraft, 3) for each in (position, velocity, euler))
    return replace(
        block,
        believed_ned=np.where(
            errs[:, None, None], believed.reshape(block.error_ned.shape), block.error_ned
        ),
        off=(*vectors, airspeed),
    )
