"""What of a run moves in its view: frames as columns of plain numbers.

They travel to another process when the view is live.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.record.times import shared_frames
from testbed.state import (
    AirData,
    Array,
    Event,
    FbwaCommand,
    FormationState,
    Frame,
    LinkCounts,
    Surfaces,
    Truths,
    VehicleState,
)


class Source(Protocol):
    """A frame, or the frames of a log stacked: their arrays then have K frames in front."""

    @property
    def time_s(self) -> Any: ...  # noqa: ANN401, D102 - a number, or (K,)
    @property
    def truth(self) -> VehicleState: ...  # noqa: D102
    @property
    def estimate(self) -> VehicleState: ...  # noqa: D102
    @property
    def air(self) -> AirData: ...  # noqa: D102
    @property
    def command(self) -> FbwaCommand: ...  # noqa: D102
    @property
    def surfaces(self) -> Surfaces: ...  # noqa: D102
    @property
    def formation(self) -> FormationState: ...  # noqa: D102
    @property
    def links(self) -> LinkCounts: ...  # noqa: D102
    @property
    def lost(self) -> Truths: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Batch:
    """Consecutive frames as columns; m of them, of N aircraft and n followers."""

    time: Array  # (m,) s
    position: Array  # (m, N, 3) m NED
    velocity: Array  # (m, N, 3) m/s NED
    euler: Array  # (m, N, 3) rad
    believed: Array  # (m, N, 3) m NED, where its own estimate says it is
    wind: Array  # (m, N, 3) m/s NED
    aileron: Array  # (m, N) -1..1
    elevator: Array  # (m, N) -1..1
    rudder: Array  # (m, N) -1..1
    throttle: Array  # (m, N) commanded, 0..1
    lost: Array  # (m, N) 1: lost
    slot: Array  # (m, n, 3) m NED
    error: Array  # (m, n, 3) m NED
    speed_desired: Array  # (m, n) m/s
    course_desired: Array  # (m, n) rad
    climb_desired: Array  # (m, n) rad, flight-path angle
    age: Array  # (m, n, N) s, of what a follower used of each aircraft; nan: of none
    sent: Array  # (m, n, N) messages since the start
    delivered: Array  # (m, n, N) of these, those that arrive
    events: tuple[Event, ...] = ()

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.time)

    def rows(self, chosen: slice | NDArray[np.intp]) -> Batch:
        """Some of its frames, without the events."""
        return _of({name: getattr(self, name)[chosen] for name in COLUMNS})


# Where each column comes from, for one frame and for stacked ones alike.
COLUMNS: Mapping[str, Callable[[Source], Any]] = {
    "time": lambda source: source.time_s,
    "position": lambda source: source.truth.position_ned,
    "velocity": lambda source: source.truth.velocity_ned,
    "euler": lambda source: source.truth.euler,
    "believed": lambda source: source.estimate.position_ned,
    "wind": lambda source: source.air.wind_ned,
    "aileron": lambda source: source.surfaces.aileron,
    "elevator": lambda source: source.surfaces.elevator,
    "rudder": lambda source: source.surfaces.rudder,
    "throttle": lambda source: source.command.throttle,
    "lost": lambda source: source.lost,
    "slot": lambda source: source.formation.slot_ned,
    "error": lambda source: source.formation.error_ned,
    "speed_desired": lambda source: source.formation.speed_desired,
    "course_desired": lambda source: source.formation.course_desired,
    "climb_desired": lambda source: source.formation.flight_path_angle_desired,
    "age": lambda source: source.formation.age_s,
    "sent": lambda source: source.links.sent,
    "delivered": lambda source: source.links.delivered,
}
assert tuple(COLUMNS) == tuple(each.name for each in fields(Batch) if each.name != "events")
TABLES = {"age": np.nan, "sent": 0.0, "delivered": 0.0}  # of links, and where there is none


class Collector:
    """Copies frames into columns.

    A frame is copied at once and not kept: it may be changed after the observer returns.
    """

    def __init__(self, capacity: int) -> None:
        """Make room for `capacity` frames when the first tells how large they are."""
        self._columns: tuple[Array, ...] = tuple(np.empty(0) for _ in COLUMNS)
        self._events: list[Event] = []
        self._capacity = capacity
        self._filled = 0

    @property
    def full(self) -> bool:
        """Whether there is no room for another frame."""
        return self._filled == self._capacity

    def add(self, frame: Frame) -> None:
        """Copy one frame."""
        if not self._columns[0].size:
            shapes = (np.shape(take(frame)) for take in COLUMNS.values())
            self._columns = tuple(np.empty((self._capacity, *shape)) for shape in shapes)
        for column, take in zip(self._columns, COLUMNS.values(), strict=True):
            column[self._filled] = take(frame)
        if frame.events:
            self._events.extend(frame.events)
        self._filled += 1

    def add_events(self, events: Sequence[Event]) -> None:
        """Add what happened after the last frame."""
        self._events.extend(events)

    def take(self) -> Batch:
        """What was collected, and start again."""
        filled = (each[: self._filled].copy() for each in self._columns)
        batch = _of(dict(zip(COLUMNS, filled, strict=True)), self._events)
        self._filled, self._events = 0, []
        return batch


def whole(frames: Source, events: Sequence[Event]) -> Batch:
    """The stacked frames of a log as one batch."""
    return _of(
        {name: np.asarray(take(frames), dtype=np.float64) for name, take in COLUMNS.items()}, events
    )


def parts(batch: Batch, size: int) -> Iterator[Batch]:
    """A long batch in pieces of up to `size` frames, its events in the last."""
    for begin in range(0, len(batch), size):
        piece = batch.rows(slice(begin, begin + size))
        yield replace(piece, events=batch.events) if begin + size >= len(batch) else piece


def joined(first: Batch, second: Batch) -> Batch:
    """The frames of two batches one after the other, without events."""
    return _of(
        {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in COLUMNS}
    )


def beside(first: Batch, second: Batch, labels: tuple[str, str]) -> Batch:
    """Two runs in one: the frames of the times that both have, aircraft one after the other."""
    mine, other = shared_frames(first.time, second.time)
    one, two = first.rows(mine), second.rows(other)
    columns = {
        name: np.concatenate([getattr(one, name), getattr(two, name)], axis=1)
        for name in COLUMNS
        if name not in ("time", *TABLES)
    }
    columns["time"] = one.time
    for name, nothing in TABLES.items():
        columns[name] = _apart(getattr(one, name), getattr(two, name), nothing)
    events = [
        replace(event, source=f"{label}.{event.source}")
        for label, each in zip(labels, (first, second), strict=True)
        for event in each.events
    ]
    return _of(columns, sorted(events, key=lambda event: event.time_s))


def _of(columns: Mapping[str, Any], events: Sequence[Event] = ()) -> Batch:
    return Batch(**columns, events=tuple(events))


def _apart(one: Array, two: Array, nothing: float) -> Array:
    """Two tables of links (m, n, N) as one in which neither run hears the other."""
    m, n, count = one.shape
    out: Array = np.full((m, n + two.shape[1], count + two.shape[2]), nothing)
    out[:, :n, :count] = one
    out[:, n:, count:] = two
    return out
