"""Where the cameras stand and how much is drawn, for any number of aircraft: arithmetic only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.views import signs
from testbed.views.batch import Batch
from testbed.views.scene import Scene, ground

CHASE_TRAIL_S = 4.0
OVERVIEW_TRAIL_S = 60.0
PLOT_WINDOW_S = 60.0  # before the cursor
PLOT_AHEAD_S = 2.0  # after it
LEAST_PLOTTED_S = 10.0
# What a viewer draws without stuttering, over all aircraft:
TRAIL_ROWS_PER_S = 100.0
POSE_ROWS_PER_S = 500.0
PLOT_ROWS_PER_S = 200.0
MOST_MOVING = 8  # aircraft whose control surfaces move
MOST_NAMED = 12  # aircraft with their names beside them
SMALLEST = 0.13  # of the distance to the chase camera: aircraft are drawn no smaller


Span = tuple[float, float]  # s


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera in the frame of its view, m."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True)
class Picture:
    """A view of the world, less some entities."""

    name: str
    origin: str
    without: tuple[str, ...]
    eye: Eye
    trail_s: float
    grid: float | None = None  # m, between the lines of a grid through the origin


@dataclass(frozen=True, slots=True)
class Framing:
    """How the formation fills its pictures."""

    chase: Eye
    above: Eye
    overview: Eye
    size: float  # aircraft and slots are drawn this much larger than they are
    grid: float  # m, between the lines of the view from above
    wind: float  # m, length of the arrow of 1 m/s


def framing(still: Scene, first: Batch) -> Framing:
    """The cameras for a formation as its slots stand in the first frame, as far as it tells."""
    slots = first.slot[0, : still.chased]
    placed = np.concatenate([first.position[0, :1], slots])
    placed = placed[np.isfinite(placed).all(axis=-1)]
    spread = placed - placed.mean(axis=0) if len(placed) else np.zeros((1, 3))
    radius = float(np.linalg.norm(spread, axis=-1).max())
    tall = float(np.abs(spread[:, 2]).max())
    span = max(still.wingspan)
    # pictures are wider than high, so that a tall formation needs more room
    distance = max(1.5 * radius + 1.2 * span, 3.6 * tall, 4.0 * span)
    size = max(1.0, math.floor(2.0 * SMALLEST * distance / span + 0.5) / 2.0)
    high = 1.15 * radius + 2.2 * size * span
    return Framing(
        chase=Eye(
            (-0.86 * distance, 0.36 * distance, -0.40 * distance),
            # Below the formation: it sits in the upper half, its ground in the lower.
            (0.0, 0.0, 0.10 * distance),
        ),
        above=Eye((-0.001 * high, 0.0, -1.7 * high), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        overview=overview_eye(still),
        size=size,
        grid=_round(0.25 * high),
        wind=_round(0.05 * distance),
    )


def pictures(still: Scene, frame: Framing) -> tuple[Picture, Picture, Picture]:
    """The formation from behind, from above, and the whole flight."""
    names = tuple(f"world/aircraft/{name}/name" for name in still.names)
    markers = tuple(f"world/aircraft/{name}/marker" for name in still.names)
    drawn = tuple(f"world/aircraft/{name}/drawn/**" for name in still.names)
    upright = ("world/paths/posts", "world/paths/shadow")
    legend = [f"arrows: wind, {frame.wind:g} m per m/s"]
    legend += ["dots: own estimates"] if still.estimated else []
    legend += [f"aircraft {frame.size:g} x as large"] if frame.size > 1.0 else []
    crowd = len(names) > MOST_NAMED
    named = f"; named: the {signs.WORST} furthest from their slots" if crowd else ""
    return (
        Picture(
            f"{' · '.join(['Formation', *still.runs])} ({'; '.join(legend)})",
            "world/chase",
            ("world/ground/scale", "world/chase/worst", *upright, *markers, *names),
            frame.chase,
            CHASE_TRAIL_S,
        ),
        Picture(
            f"From above (grid {frame.grid:g} m{named})",
            "world/chase",
            ("world/ground/**", *upright, *markers, *(names if crowd else ())),
            frame.above,
            CHASE_TRAIL_S,
            frame.grid,
        ),
        Picture(
            "Flight",
            "world",
            ("world/slots/**", "world/chase/**", *drawn, *names),
            frame.overview,
            OVERVIEW_TRAIL_S,
        ),
    )


def span_of(at_s: float, begin_s: float) -> Span:
    """What plots show of a run that begins at `begin_s` and is looked at at `at_s`, s."""
    begin = max(begin_s, at_s - PLOT_WINDOW_S)
    end = max(at_s, begin + LEAST_PLOTTED_S)
    return begin, end + PLOT_AHEAD_S / PLOT_WINDOW_S * (end - begin)


def overview_eye(still: Scene) -> Eye:
    """A camera high in the south-west that sees the whole path and its ground."""
    area = ground(still.paths)
    middle = 0.5 * (area.low + area.high)
    size = float(np.max(area.high - area.low))
    height = float(-np.concatenate(still.paths)[:, 2].mean()) if still.paths else 0.0
    # Aimed short of the middle: near ground takes more of the picture than far ground.
    target = (float(middle[0]) - 0.17 * size, float(middle[1]), -0.5 * height)
    return Eye((target[0] - 0.62 * size, target[1] - 0.29 * size, -0.62 * size), target)


def stride(still: Scene, rows_per_s: float, fastest: float = math.inf) -> int:
    """Every how manieth frame is drawn, so that all aircraft together need that many rows."""
    wanted = min(rows_per_s / len(still.names), fastest)
    return max(1, round(still.frame_rate_hz / wanted))


def _round(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)
