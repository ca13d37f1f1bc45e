"""Positions of the cameras, and the number of samples to draw, for any number of aircraft."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.views.annotations import MAX_ERROR_LABELS
from testbed.views.batch import Batch
from testbed.views.scene import Scene, ground

CHASE_TRAIL_S = 4.0
OVERVIEW_TRAIL_S = 60.0
PLOT_WINDOW_S = 60.0  # before the cursor
PLOT_AHEAD_S = 2.0  # after it
MIN_PLOTTED_S = 10.0
# What a viewer draws without stuttering, over all aircraft:
TRAIL_ROWS_PER_S = 100.0
POSE_ROWS_PER_S = 500.0
PLOT_ROWS_PER_S = 200.0
MAX_MOVING_SURFACES = 8  # aircraft: of more, control surfaces do not move
MAX_NAMED = 12  # aircraft: of more, only the largest errors are labelled
MIN_SIZE = 0.13  # of a drawn wingspan, relative to the distance of the chase camera

TimeSpan = tuple[float, float]  # s


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera in the frame of its view, m."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True)
class View3D:
    """A three-dimensional view of the world without some entities."""

    name: str
    origin: str
    excluded: tuple[str, ...]
    camera: Camera
    trail_s: float
    grid: float | None = None  # m, between the lines of a grid through the origin


@dataclass(frozen=True, slots=True)
class Framing:
    """The cameras and scales that fit a formation into its views."""

    chase: Camera
    above: Camera
    overview: Camera
    size: float  # aircraft and slots are drawn larger by this factor
    grid: float  # m, between the lines of the view from above
    wind: float  # m, length of the arrow of 1 m/s


def fit_formation(scene: Scene, first: Batch) -> Framing:
    """Place the cameras for the slots of the first sample; unknown positions are left out."""
    slots = first.slot[0, : scene.camera_followers]
    points = np.concatenate([first.position[0, :1], slots])
    points = points[np.isfinite(points).all(axis=-1)]
    offsets = points - points.mean(axis=0) if len(points) else np.zeros((1, 3))
    radius = float(np.linalg.norm(offsets, axis=-1).max())
    height = float(np.abs(offsets[:, 2]).max())
    span = max(scene.wingspan)
    # views are wider than high, so that a tall formation needs more distance
    distance = max(1.5 * radius + 1.2 * span, 3.6 * height, 4.0 * span)
    size = max(1.0, math.floor(2.0 * MIN_SIZE * distance / span + 0.5) / 2.0)
    above = 1.15 * radius + 2.2 * size * span
    return Framing(
        chase=Camera(
            (-0.86 * distance, 0.36 * distance, -0.40 * distance),
            # below the formation, which is then in the upper half, above the ground
            (0.0, 0.0, 0.10 * distance),
        ),
        above=Camera((-0.001 * above, 0.0, -1.7 * above), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        overview=overview_camera(scene),
        size=size,
        grid=_round_down(0.25 * above),
        wind=_round_down(0.05 * distance),
    )


def views_3d(scene: Scene, framing: Framing) -> tuple[View3D, View3D, View3D]:
    """Define the views of the formation from behind, from above, and of the whole flight."""
    names = tuple(f"world/aircraft/{name}/name" for name in scene.names)
    markers = tuple(f"world/aircraft/{name}/marker" for name in scene.names)
    drawn = tuple(f"world/aircraft/{name}/drawn/**" for name in scene.names)
    posts = ("world/paths/posts", "world/paths/shadow")
    legend = [f"arrows: wind, {framing.wind:g} m per m/s"]
    legend += ["dots: own estimates"] if scene.estimated else []
    legend += [f"aircraft {framing.size:g} x as large"] if framing.size > 1.0 else []
    crowded = len(names) > MAX_NAMED
    named = f"; named: the {MAX_ERROR_LABELS} largest errors" if crowded else ""
    return (
        View3D(
            f"{' · '.join(['Formation', *scene.runs])} ({'; '.join(legend)})",
            "world/chase",
            ("world/ground/scale", "world/chase/largest_errors", *posts, *markers, *names),
            framing.chase,
            CHASE_TRAIL_S,
        ),
        View3D(
            f"From above (grid {framing.grid:g} m{named})",
            "world/chase",
            ("world/ground/**", *posts, *markers, *(names if crowded else ())),
            framing.above,
            CHASE_TRAIL_S,
            framing.grid,
        ),
        View3D(
            "Flight",
            "world",
            ("world/slots/**", "world/chase/**", *drawn, *names),
            framing.overview,
            OVERVIEW_TRAIL_S,
        ),
    )


def plot_span(at_s: float, begin_s: float) -> TimeSpan:
    """Compute the time that plots show in a picture at `at_s` of a run that begins at `begin_s`."""
    begin = max(begin_s, at_s - PLOT_WINDOW_S)
    end = max(at_s, begin + MIN_PLOTTED_S)
    return begin, end + PLOT_AHEAD_S / PLOT_WINDOW_S * (end - begin)


def overview_camera(scene: Scene) -> Camera:
    """Place a camera high in the south-west that sees the whole path and its ground."""
    area = ground(scene.paths)
    middle = 0.5 * (area.low + area.high)
    size = float(np.max(area.high - area.low))
    height = float(-np.concatenate(scene.paths)[:, 2].mean()) if scene.paths else 0.0
    # aimed south of the middle, because near ground fills more of the view than far ground
    target = (float(middle[0]) - 0.17 * size, float(middle[1]), -0.5 * height)
    return Camera((target[0] - 0.62 * size, target[1] - 0.29 * size, -0.62 * size), target)


def stride(scene: Scene, rows_per_s: float, max_hz: float = math.inf) -> int:
    """Compute the step between drawn samples, for so many rows per second over all aircraft."""
    wanted_hz = min(rows_per_s / len(scene.names), max_hz)
    return max(1, round(scene.sample_rate_hz / wanted_hz))


def _round_down(length: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)
