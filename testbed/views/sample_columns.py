"""The moving part of a view: consecutive samples as columns of plain numbers.

Batches are pickled for another process when the view is live.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, Event, Sample

if TYPE_CHECKING:  # the process that feeds a viewer needs no reader of logs
    from testbed.logs.read import RunLog


def _column(source: str) -> Any:  # noqa: ANN401 - a field of a dataclass
    """Declare a column with its source, a path from a sample and from a log alike."""
    return field(metadata={"source": source})


@dataclass(frozen=True, slots=True)
class ViewBatch:
    """Columns of m consecutive samples of N aircraft and n followers."""

    time: Array = _column("time_s")  # (m,) s
    position: Array = _column("truth.position_ned")  # (m, N, 3) m NED
    velocity: Array = _column("truth.velocity_ned")  # (m, N, 3) m/s NED
    euler: Array = _column("truth.euler")  # (m, N, 3) rad
    estimated_position: Array = _column("estimate.position_ned")  # (m, N, 3) m NED
    wind: Array = _column("air.wind_ned")  # (m, N, 3) m/s NED
    aileron: Array = _column("surfaces.aileron")  # (m, N) -1..1
    elevator: Array = _column("surfaces.elevator")  # (m, N) -1..1
    rudder: Array = _column("surfaces.rudder")  # (m, N) -1..1
    throttle: Array = _column("command.throttle")  # (m, N) commanded, 0..1
    lost: Array = _column("lost")  # (m, N) 1: lost
    slot: Array = _column("formation.slot_ned")  # (m, n, 3) m NED
    error: Array = _column("formation.error_ned")  # (m, n, 3) m NED
    speed_desired: Array = _column("formation.speed_desired")  # (m, n) m/s
    course_desired: Array = _column("formation.course_desired")  # (m, n) rad
    flight_path_angle_desired: Array = _column("formation.flight_path_angle_desired")  # (m, n) rad
    # (m, n, N) s, of the data that a follower used of each aircraft; NaN: unused
    age: Array = _column("formation.age_s")
    sent: Array = _column("links.sent")  # (m, n, N) messages since the start
    delivered: Array = _column("links.delivered")  # (m, n, N) of these, the ones that arrive
    events: tuple[Event, ...] = ()

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.time)

    def rows(self, chosen: slice | NDArray[np.intp]) -> ViewBatch:
        """Select samples, without the events."""
        return _batch({name: getattr(self, name)[chosen] for name in COLUMNS})


COLUMNS: Mapping[str, Callable[[Sample | RunLog], Any]] = {
    each.name: attrgetter(each.metadata["source"]) for each in fields(ViewBatch) if each.metadata
}
LINK_COLUMNS = {"age": np.nan, "sent": 0.0, "delivered": 0.0}  # with the values of absent links


class Collector:
    """Copy samples into columns; a sample may change after it was added."""

    def __init__(self, capacity: int) -> None:
        """Allocate for `capacity` samples when the first one shows its shapes."""
        self._columns: tuple[Array, ...] = tuple(np.empty(0) for _ in COLUMNS)
        self._events: list[Event] = []
        self._capacity = capacity
        self._size = 0

    @property
    def full(self) -> bool:
        """Whether the capacity is used up."""
        return self._size == self._capacity

    def add(self, sample: Sample) -> None:
        """Copy one sample."""
        if not self._columns[0].size:
            shapes = (np.shape(get(sample)) for get in COLUMNS.values())
            self._columns = tuple(np.empty((self._capacity, *shape)) for shape in shapes)
        for column, get in zip(self._columns, COLUMNS.values(), strict=True):
            column[self._size] = get(sample)
        if sample.events:
            self._events.extend(sample.events)
        self._size += 1

    def add_events(self, events: Sequence[Event]) -> None:
        """Add events without a sample."""
        self._events.extend(events)

    def take(self) -> ViewBatch:
        """Return the collected samples and start again."""
        columns = (each[: self._size].copy() for each in self._columns)
        batch = _batch(dict(zip(COLUMNS, columns, strict=True)), self._events)
        self._size, self._events = 0, []
        return batch


def batch_of(log: RunLog, events: Sequence[Event]) -> ViewBatch:
    """Make one batch of all samples of a log."""
    return _batch(
        {name: np.asarray(get(log), dtype=np.float64) for name, get in COLUMNS.items()}, events
    )


def split(batch: ViewBatch, size: int) -> Iterator[ViewBatch]:
    """Split a batch into pieces of at most `size` samples; the events go with the last."""
    for begin in range(0, len(batch), size):
        piece = batch.rows(slice(begin, begin + size))
        yield replace(piece, events=batch.events) if begin + size >= len(batch) else piece


def concat(first: ViewBatch, second: ViewBatch) -> ViewBatch:
    """Append the samples of one batch to another, without events."""
    return _batch(
        {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in COLUMNS}
    )


def overlay(first: ViewBatch, second: ViewBatch, labels: tuple[str, str]) -> ViewBatch:
    """Combine two runs at the times that both have, the aircraft of the first run first."""
    # no tolerance: times are ticks over the base rate, equal ones are equal to the bit
    found: Any = np.intersect1d(first.time, second.time, return_indices=True)
    one, two = first.rows(found[1]), second.rows(found[2])
    columns = {
        name: np.concatenate([getattr(one, name), getattr(two, name)], axis=1)
        for name in COLUMNS
        if name not in ("time", *LINK_COLUMNS)
    }
    columns["time"] = one.time
    for name, absent in LINK_COLUMNS.items():
        columns[name] = _block_diagonal(getattr(one, name), getattr(two, name), absent)
    events = [
        replace(event, source=f"{label}.{event.source}")
        for label, each in zip(labels, (first, second), strict=True)
        for event in each.events
    ]
    return _batch(columns, sorted(events, key=lambda event: event.time_s))


def _batch(columns: Mapping[str, Any], events: Sequence[Event] = ()) -> ViewBatch:
    return ViewBatch(**columns, events=tuple(events))


def _block_diagonal(one: Array, two: Array, absent: float) -> Array:
    """Combine two tables of links (m, n, N) without links between the two runs."""
    m, n, count = one.shape
    out: Array = np.full((m, n + two.shape[1], count + two.shape[2]), absent)
    out[:, :n, :count] = one
    out[:, n:, count:] = two
    return out
