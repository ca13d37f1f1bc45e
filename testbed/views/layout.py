"""Positions of the cameras, and the number of samples to draw, for any number of aircraft."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.views.annotations import round_down
from testbed.views.cameras import ABOVE, BEHIND, MIN_SPANS, Lens
from testbed.views.panels import Colour
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import SKY, SOIL, Scene, ground

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
LABEL_ROWS_PER_S = 5.0
MIN_SIZE = 0.13  # of a drawn wingspan, relative to the distance of the camera
MAX_SIZE = 1.2  # of a drawn wingspan, relative to the smallest distance between slots
UNITS = 100.0  # of a camera's frame, from the camera to the middle of the formation

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
    background: Colour


@dataclass(frozen=True, slots=True)
class Framing:
    """The camera of the whole flight, and scales that suit a formation."""

    overview: Camera
    size: float  # aircraft and slots are drawn larger by this factor
    wind: float  # m, length of the arrow of 1 m/s


def fit_formation(scene: Scene, first: ViewBatch) -> Framing:
    """Choose scales for the slots of the first sample; unknown positions are left out."""
    slots = first.slot[0, : scene.camera_followers]
    points = np.concatenate([first.position[0, :1], slots])
    points = points[np.isfinite(points).all(axis=-1)]
    offsets = points - points.mean(axis=0) if len(points) else np.zeros((1, 3))
    span = max(scene.wingspan)
    needed = float(BEHIND.distance(offsets[None], span)[0])
    distance = max(needed, MIN_SPANS * span)
    size = MIN_SIZE * distance / span
    if len(points) > 1:  # aircraft must not overlap
        between = np.linalg.norm(points[:, None] - points, axis=-1)
        between[np.diag_indices(len(points))] = np.inf
        size = min(size, MAX_SIZE * float(between.min()) / span)
    if scene.follow is not None:  # from near by
        size = 1.0
    return Framing(
        overview=overview_camera(scene),
        size=max(1.0, math.floor(2.0 * size + 0.5) / 2.0),
        wind=round_down(0.05 * distance),
    )


def views_3d(scene: Scene, framing: Framing) -> tuple[View3D, View3D, View3D]:
    """Define the views of the formation from behind, from above, and of the whole flight."""
    drawn = tuple(f"world/aircraft/{name}/drawn/**" for name in scene.names)
    posts = ("world/paths/posts", "world/paths/shadow")
    legend = [f"arrows: wind, {framing.wind:g} m per m/s"]
    legend += ["dots: own estimates"] if scene.estimated else []
    legend += [f"aircraft {framing.size:g} x as large"] if framing.size > 1.0 else []
    first = "Formation" if scene.follow is None else f"Following {scene.names[scene.follow]}"
    return (
        View3D(
            f"{' · '.join([first, *scene.runs])} ({'; '.join(legend)})",
            "world/behind",
            ("world/ground/scale", "world/above/**", *posts),
            eye(BEHIND),
            CHASE_TRAIL_S,
            SKY,
        ),
        View3D(
            "From above",
            "world/above",
            ("world/ground/**", "world/behind/**", *posts),
            eye(ABOVE),
            CHASE_TRAIL_S,
            SOIL,
        ),
        View3D(
            "Flight",
            "world",
            ("world/slots/**", "world/chase/**", "world/behind/**", "world/above/**", *drawn),
            framing.overview,
            OVERVIEW_TRAIL_S,
            SKY,
        ),
    )


def eye(lens: Lens) -> Camera:
    """Place a camera in its frame, whose unit is a share of the distance."""
    position, target = (UNITS * np.array(each) for each in (lens.eye, lens.target))
    return Camera(tuple(position.tolist()), tuple(target.tolist()), lens.up)


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
