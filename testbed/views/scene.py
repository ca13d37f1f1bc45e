"""What of a run is drawn, as plain numbers: the still part, and frames in columns.

Both travel to another process when the view is live, so they hold arrays, numbers and text only.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, Event, Frame, RunInfo

Colour = tuple[int, int, int]

LEADER: Colour = (240, 240, 240)
# Okabe and Ito's palette, told apart by colour-blind readers too; its black is the background here.
FOLLOWERS: tuple[Colour, ...] = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (240, 228, 66),
    (213, 94, 0),
    (0, 114, 178),
)
GRID_STEP = 100.0  # m
POSTS = 40  # at most, along the path: they show its height
GRID_MARGIN = 150.0  # m of grid beyond the path


@dataclass(frozen=True, slots=True)
class Scene:
    """The part of a view that stands still."""

    title: str
    recording_id: str
    names: tuple[str, ...]  # N, the leader first
    airframes: tuple[str, ...]  # N
    wingspan: tuple[float, ...]  # N, m
    path: Array  # (k, 3) m, may be empty
    speed_bounds: Array  # (n, 2) m/s
    roll_limit: Array  # (n,) rad
    frame_rate_hz: int


def scene_of(info: RunInfo) -> Scene:
    """The still part of the view of a run."""
    run = f" {info.directory.name}" if info.directory else ""
    return Scene(
        title=info.scenario_name + run,
        # Of its own each time: a replay must not be added to the live recording of the same run.
        recording_id=uuid.uuid4().hex,
        names=tuple(info.names),
        airframes=tuple(info.aircraft),
        wingspan=tuple(info.wingspan_m),
        path=np.asarray(info.leader_path_ned, dtype=np.float64).reshape(-1, 3),
        speed_bounds=np.asarray(info.speed_bounds_mps, dtype=np.float64).reshape(-1, 2),
        roll_limit=np.asarray(info.roll_limit_rad, dtype=np.float64),
        frame_rate_hz=info.frame_rate_hz,
    )


def colour(index: int) -> Colour:
    """The colour of aircraft `index`; the leader is 0. After seven followers it starts again."""
    return LEADER if index == 0 else FOLLOWERS[(index - 1) % len(FOLLOWERS)]


def trim(index: int) -> Colour:
    """The second colour of aircraft `index`: light, but dark on the white leader."""
    return (105, 115, 130) if index == 0 else (235, 235, 230)


@dataclass(frozen=True, slots=True)
class Ground:
    """A grid on the ground with its scale."""

    lines: tuple[Array, ...]  # (k, 3) m each
    path: Array  # (k, 3) m, with a point every few metres
    posts: Array  # (p, 2, 3) m, from the ground up to the path
    label_positions: Array  # (l, 3) m
    labels: tuple[str, ...]
    low: Array  # (2,) north, east, m
    high: Array  # (2,) north, east, m


def ground(path: Array) -> Ground:
    """The grid under a path (k, 3): whole steps around it, or around the origin without a path."""
    flat = path[:, :2] if len(path) else np.array([[-300.0, -300.0], [300.0, 300.0]])
    low = np.floor((flat.min(axis=0) - GRID_MARGIN) / GRID_STEP) * GRID_STEP
    high = np.ceil((flat.max(axis=0) + GRID_MARGIN) / GRID_STEP) * GRID_STEP
    north = np.arange(low[0], high[0] + 1.0, GRID_STEP)
    east = np.arange(low[1], high[1] + 1.0, GRID_STEP)
    across = [np.array([[n, low[1], 0.0], [n, high[1], 0.0]]) for n in north]
    along = [np.array([[low[0], e, 0.0], [high[0], e, 0.0]]) for e in east]
    # Every second line is labelled, on the two edges nearest to the overview's eye.
    marks = [(n, low[1] - 40.0, f"{n:.0f} m N") for n in north[::2]]
    marks += [(low[0] - 40.0, e, f"{e:.0f} m E") for e in east[::2]]
    tops = path[np.unique(np.linspace(0, len(path) - 1, POSTS).astype(int))] if len(path) else path
    return Ground(
        lines=tuple(finely(line) for line in across + along),
        path=finely(path),
        posts=np.stack([tops, tops * [1.0, 1.0, 0.0]], axis=1),
        label_positions=np.array([[n, e, 0.0] for n, e, _ in marks]),
        labels=tuple(text for _, _, text in marks),
        low=low,
        high=high,
    )


def finely(line: Array, step: float = 25.0) -> Array:
    """A line (k, 3) with a point at least every `step` m.

    A viewer gives each point of a line one width: a long segment that passes the camera would be
    drawn as a broad band.
    """
    if len(line) < 2:
        return line
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=-1))])
    even = np.linspace(0.0, length[-1], int(length[-1] / step) + 2)
    where = np.union1d(length, even)
    return np.stack([np.interp(where, length, line[:, axis]) for axis in range(3)], axis=-1)


@dataclass(frozen=True, slots=True)
class Batch:
    """Consecutive frames as columns; m of them."""

    time: Array  # (m,) s
    position: Array  # (m, N, 3) m NED
    velocity: Array  # (m, N, 3) m/s NED
    euler: Array  # (m, N, 3) rad
    throttle: Array  # (m, N) commanded, 0..1
    slot: Array  # (m, n, 3) m NED
    error: Array  # (m, n, 3) m NED
    events: tuple[Event, ...] = ()

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.time)


class Collector:
    """Copies frames into columns.

    A frame is copied at once and not kept: it may be changed after the observer returns.
    """

    def __init__(self, aircraft: int, capacity: int) -> None:
        """Make room for `capacity` frames of `aircraft` aircraft."""
        n, f = aircraft, aircraft - 1
        self._columns: tuple[NDArray[np.float64], ...] = tuple(
            np.empty((capacity, *shape))
            for shape in ((), (n, 3), (n, 3), (n, 3), (n,), (f, 3), (f, 3))
        )
        self._events: list[Event] = []
        self._capacity = capacity
        self._filled = 0

    @property
    def full(self) -> bool:
        """Whether there is no room for another frame."""
        return self._filled == self._capacity

    def add(self, frame: Frame) -> None:
        """Copy one frame."""
        time, position, velocity, euler, throttle, slot, error = self._columns
        row = self._filled
        time[row] = frame.time_s
        position[row] = frame.truth.position_ned
        velocity[row] = frame.truth.velocity_ned
        euler[row] = frame.truth.euler
        throttle[row] = frame.command.throttle
        slot[row] = frame.formation.slot_ned
        error[row] = frame.formation.error_ned
        if frame.events:
            self._events.extend(frame.events)
        self._filled = row + 1

    def add_events(self, events: Sequence[Event]) -> None:
        """Add what happened after the last frame."""
        self._events.extend(events)

    def take(self) -> Batch:
        """What was collected, and start again."""
        time, position, velocity, euler, throttle, slot, error = (
            column[: self._filled].copy() for column in self._columns
        )
        events = tuple(self._events)
        self._filled, self._events = 0, []
        return Batch(time, position, velocity, euler, throttle, slot, error, events)
