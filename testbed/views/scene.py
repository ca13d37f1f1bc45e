"""The static part of a view: names, colours, paths, limits and the ground grid, as plain numbers.

A scene is pickled for another process when the view is live: it holds arrays, numbers and text
only.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, RunInfo
from testbed.formation.barrier import LoggedBarrier, logged_barriers
from testbed.views.panels import ON_DARK, Colour, rgb

BACKDROP: Colour = (22, 26, 33)
SKY: Colour = (52, 66, 86)  # of a view that has one colour for it
HAZE: Colour = (66, 78, 80)  # of the ground at the horizon
SOIL: Colour = (27, 37, 33)  # of the ground straight below
LEADER: Colour = (240, 240, 240)
PATH_COLOUR: Colour = (165, 165, 170)
WIND_COLOUR: Colour = (255, 150, 190)  # no colour of an aircraft
GRID_COLOUR: Colour = (84, 94, 110)
TEXT_COLOUR: Colour = (200, 205, 212)
TYRE: Colour = (45, 50, 58)  # and other dark parts
FOLLOWERS: tuple[Colour, ...] = tuple(rgb(each) for each in ON_DARK)
GRID_STEP = 100.0  # m
FINE_PER_STEP = 5  # fine lines of the grid in a step, if it has no more than MAX_FINE_STEPS
MAX_FINE_STEPS = 30
MAX_SINGLE = 12  # aircraft with colours and names of their own
RAMP: tuple[Colour, Colour] = (rgb("#56b4e9"), rgb("#f0a020"))  # of more, by their order
MAX_LABELS = 6  # on an edge of the grid
MAX_POSTS = 40  # vertical lines along the path that show its height
GRID_MARGIN = 150.0  # m of grid beyond the path


@dataclass(frozen=True, slots=True)
class Scene:
    """The static part of a view of N aircraft, n of which are followers."""

    scenario: str
    title: str
    recording_id: str
    names: tuple[str, ...]  # N, a leader first
    airframes: tuple[str, ...]  # N
    wingspan: tuple[float, ...]  # N, m
    colours: tuple[Colour, ...]  # N
    followers: tuple[int, ...]  # n, rows of the N that have a slot
    camera_followers: int  # how many of the n the cameras keep in sight, from the first on
    paths: tuple[Array, ...]  # (k, 3) m each, may be empty
    speed_bounds: Array  # (n, 2) m/s
    bounds_wind: Array  # (N, 3) m/s, of the air that bounded speeds are relative to; zero: ground
    barriers: tuple[LoggedBarrier | None, ...]  # n; None: unknown, or none
    estimated: bool  # whether any aircraft flies by estimates that differ from the truth
    roll_limit: Array  # (n,) rad
    sample_rate_hz: float  # of the samples that are shown
    follow: int | None = None  # row of the aircraft that the first camera stays near
    runs: tuple[str, ...] = ()  # of two runs in one view: label, colour and name of each
    # rows of real aircraft beside simulated ones, drawn translucent and without slots
    ghosts: tuple[int, ...] = ()


def scene_of(info: RunInfo, follow: str | None = None) -> Scene:
    """Make the scene of a run, with the name of an aircraft that a camera stays near."""
    run = f" {info.directory.name}" if info.directory else ""
    n = len(info.names) - 1
    return Scene(
        scenario=info.scenario_name,
        title=info.scenario_name + run,
        # a new one each time: a replay must not be added to the live recording of the same run
        recording_id=uuid.uuid4().hex,
        names=tuple(info.names),
        airframes=tuple(info.aircraft),
        wingspan=tuple(info.wingspan_m),
        colours=fleet_colours(n + 1),
        followers=tuple(range(1, n + 1)),
        camera_followers=n,
        paths=tuple(p for p in [np.asarray(info.leader_path_ned, dtype=np.float64)] if p.size),
        speed_bounds=np.asarray(info.speed_bounds_mps, dtype=np.float64).reshape(-1, 2),
        bounds_wind=np.tile(np.asarray(info.bounded_in_ned, dtype=np.float64), (n + 1, 1)),
        barriers=tuple(logged_barriers(info)),
        estimated=info.estimated,
        roll_limit=np.asarray(info.roll_limit_rad, dtype=np.float64),
        sample_rate_hz=info.sample_rate_hz,
        follow=None if follow is None else info.names.index(follow),
    )


def overlay_scenes(
    first: Scene,
    second: Scene,
    labels: tuple[str, str],
    recorded: tuple[bool, bool] = (False, False),
) -> Scene:
    """Combine the scenes of two runs, distinct by colour; the cameras follow the first.

    Args:
        first: of the run whose formation the cameras follow.
        second: of the other run.
        labels: short names of the two, put before the names of aircraft.
        recorded: whether each is a recorded flight; one beside a simulated one becomes ghosts.
    """
    count = len(first.names)
    shades = (FOLLOWERS[0], FOLLOWERS[1])  # blue and orange
    colours = [
        tuple(shade_in_run(shade, row, len(each.names)) for row in range(len(each.names)))
        for shade, each in zip(shades, (first, second), strict=True)
    ]
    names = [
        tuple(f"{label}.{name}" for name in each.names)
        for label, each in zip(labels, (first, second), strict=True)
    ]
    runs = [each.scenario for each in (first, second)]
    if runs[0] == runs[1]:
        runs = [each.title for each in (first, second)]
    runs = [f"{run}, recorded" if real else run for run, real in zip(runs, recorded, strict=True)]
    rows = range(count), range(count, count + len(second.names))
    ghosts = [row for k in range(2) if recorded[k] and not recorded[1 - k] for row in rows[k]]
    same_paths = len(first.paths) == len(second.paths) and all(
        np.array_equal(*pair) for pair in zip(first.paths, second.paths, strict=True)
    )
    return replace(
        first,
        title=f"{first.title} | {second.title}",
        recording_id=uuid.uuid4().hex,
        names=names[0] + names[1],
        airframes=first.airframes + second.airframes,
        wingspan=first.wingspan + second.wingspan,
        colours=colours[0] + colours[1],
        followers=first.followers + tuple(count + row for row in second.followers),
        paths=first.paths if same_paths else first.paths + second.paths,
        speed_bounds=np.concatenate([first.speed_bounds, second.speed_bounds]),
        bounds_wind=np.concatenate([first.bounds_wind, second.bounds_wind]),
        barriers=first.barriers + second.barriers,
        roll_limit=np.concatenate([first.roll_limit, second.roll_limit]),
        estimated=first.estimated or second.estimated,
        runs=tuple(
            f"{label}, {shade}: {run}"
            for label, shade, run in zip(labels, ("blue", "orange"), runs, strict=True)
        ),
        ghosts=tuple(ghosts),
    )


def fleet_colours(count: int) -> tuple[Colour, ...]:
    """Choose the colours of a leader and its followers; of a large formation one scale by order."""
    if count <= MAX_SINGLE:
        return LEADER, *FOLLOWERS[: count - 1]
    shares = np.linspace(0.0, 1.0, count - 1).tolist()
    return LEADER, *(mix(*RAMP, share) for share in shares)


def shade_in_run(shade: Colour, row: int, count: int) -> Colour:
    """Lighten the colour of a run for one of its aircraft; the leader is nearly white."""
    share = 0.75 if row == 0 else 0.45 * (row - 1) / max(count - 2, 1)
    return mix(shade, (255, 255, 255), share)


def mix(one: Colour, other: Colour, share: float) -> Colour:
    """Interpolate between one colour (0) and another (1)."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
    return red, green, blue


def secondary_colour(paint: Colour) -> Colour:
    """Choose the second colour of an aircraft: light, but dark on one that is nearly white."""
    return (105, 115, 130) if min(paint) > 180 else (235, 235, 230)


def paint_colours(paint: Colour, trim: Colour) -> NDArray[np.uint8]:
    """Return the colours (3, 3) of an aircraft by the paints of `meshes`."""
    return np.array([paint, trim, TYRE], np.uint8)


@dataclass(frozen=True, slots=True)
class Ground:
    """A grid on the ground with its scale, and the paths above it."""

    lines: tuple[Array, ...]  # (k, 3) m each
    fine: tuple[Array, ...]  # (k, 3) m each, between the lines; none of a large area
    paths: tuple[Array, ...]  # (k, 3) m each, with a point every few metres
    posts: Array  # (p, 2, 3) m, from the ground up to the path
    label_positions: Array  # (l, 3) m
    labels: tuple[str, ...]
    low: Array  # (2,) north, east, m
    high: Array  # (2,) north, east, m


def ground(paths: Sequence[Array]) -> Ground:
    """Lay out the grid under paths (k, 3), or around the origin if there are none."""
    path = np.concatenate([np.empty((0, 3)), *paths])
    flat = path[:, :2] if len(path) else np.array([[-300.0, -300.0], [300.0, 300.0]])
    low = np.floor((flat.min(axis=0) - GRID_MARGIN) / GRID_STEP) * GRID_STEP
    high = np.ceil((flat.max(axis=0) + GRID_MARGIN) / GRID_STEP) * GRID_STEP
    north = np.arange(low[0], high[0] + 1.0, GRID_STEP)
    east = np.arange(low[1], high[1] + 1.0, GRID_STEP)
    fine: tuple[Array, ...] = ()
    if max(len(north), len(east)) <= MAX_FINE_STEPS:
        inside = GRID_STEP / FINE_PER_STEP * np.arange(1, FINE_PER_STEP)
        between_north, between_east = ((at[:-1, None] + inside).ravel() for at in (north, east))
        fine = _grid(between_north, between_east, low, high)
    # labels on the two edges nearest to the overview camera, of every second line or fewer
    step = max(2, -(-max(len(north), len(east)) // MAX_LABELS))
    aside = 0.03 * float(np.max(high - low))
    marks = [(n, low[1] - aside, f"{n:.0f} m N") for n in north[::step]]
    marks += [(low[0] - aside, e, f"{e:.0f} m E") for e in east[::step]]
    posts = np.unique(np.linspace(0, len(path) - 1, MAX_POSTS).astype(int))
    tops = path[posts] if len(path) else path
    return Ground(
        lines=_grid(north, east, low, high),
        fine=fine,
        paths=tuple(subdivide(each) for each in paths),
        posts=np.stack([tops, tops * [1.0, 1.0, 0.0]], axis=1),
        label_positions=np.array([[n, e, 0.0] for n, e, _ in marks]),
        labels=tuple(text for _, _, text in marks),
        low=low,
        high=high,
    )


def _grid(north: Array, east: Array, low: Array, high: Array) -> tuple[Array, ...]:
    """Lay out lines across an area at distances north (k,) and east (l,), m."""
    across = [np.array([[n, low[1], 0.0], [n, high[1], 0.0]]) for n in north]
    along = [np.array([[low[0], e, 0.0], [high[0], e, 0.0]]) for e in east]
    return tuple(subdivide(line) for line in across + along)


def subdivide(line: Array, step: float = 25.0) -> Array:
    """Add points to a line (k, 3), at least one every `step` m.

    Rerun gives each point of a line one width: a long segment that passes the camera would be
    drawn as a broad band.
    """
    if len(line) < 2:
        return line
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=-1))])
    even = np.linspace(0.0, length[-1], int(length[-1] / step) + 2)
    where = np.union1d(length, even)
    return np.stack([np.interp(where, length, line[:, axis]) for axis in range(3)], axis=-1)
