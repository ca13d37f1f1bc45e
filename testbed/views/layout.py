"""Where the cameras stand and what is plotted, for any number of aircraft: arithmetic only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.state import Array
from testbed.views.scene import Batch, Scene, ground

CHASE_TRAIL_S = 4.0
OVERVIEW_TRAIL_S = 60.0
PLOT_WINDOW_S = 180.0
TRAIL_ROWS_PER_S = 100.0  # over all aircraft: what a viewer draws without stuttering


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera in the frame of its view, m."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Plot:
    """A quantity over time, a series for each of some aircraft."""

    name: str
    title: str
    aircraft: tuple[int, ...]
    values: Callable[[Batch], Array]  # (m, len(aircraft))
    range: tuple[float, float]
    limits: tuple[float, ...] = ()


def plots(still: Scene) -> tuple[Plot, ...]:
    """What is plotted of a run: errors only where there are followers."""
    everyone = tuple(range(len(still.names)))
    speeds = tuple(sorted({float(v) for v in still.speed_bounds.ravel()}))
    banks = tuple(sorted({s * float(v) for v in np.degrees(still.roll_limit) for s in (-1, 1)}))
    low, high = (speeds[0] - 2.0, speeds[-1] + 2.0) if speeds else (10.0, 35.0)
    bank = 1.2 * banks[-1] if banks else 60.0
    error = Plot(
        "error",
        "Position error, m",
        everyone[1:],
        lambda batch: np.linalg.norm(batch.error, axis=-1),
        (0.0, 6.0),
    )
    shared = (
        Plot(
            "speed",
            "Ground speed and bounds, m/s",
            everyone,
            lambda batch: np.linalg.norm(batch.velocity, axis=-1),
            (low, high),
            speeds,
        ),
        Plot(
            "bank",
            "Bank and command limits, deg",
            everyone,
            lambda batch: np.degrees(batch.euler[..., 0]),
            (-bank, bank),
            banks,
        ),
        Plot("throttle", "Throttle", everyone, lambda batch: batch.throttle, (0.0, 1.0)),
    )
    return (error, *shared) if len(everyone) > 1 else shared


def trail_stride(still: Scene) -> int:
    """Frames per stretch of trail."""
    rows_per_s = min(TRAIL_ROWS_PER_S / len(still.names), 12.5)
    return max(1, round(still.frame_rate_hz / rows_per_s))


def chase_centre(batch: Batch) -> Array:
    """What the chase camera looks at (m, 3): the middle of the leader and the slots.

    Slots rather than aircraft: the picture stays steady when one of them strays.
    """
    middle: Array = np.concatenate([batch.position[:, :1], batch.slot], axis=1).mean(axis=1)
    return middle


def chase_eye(still: Scene, first: Batch) -> Eye:
    """A camera behind, above and right of the formation, as near as shows all of it."""
    placed = np.concatenate([first.position[0, :1], first.slot[0]])
    spread = placed - placed.mean(axis=0)
    radius = float(np.linalg.norm(spread, axis=-1).max())
    tall = float(np.abs(spread[:, 2]).max())
    # pictures are wider than high, so that a tall formation needs more room
    distance = max(1.25 * radius + 1.5 * max(still.wingspan), 3.6 * tall)
    # Aimed below the formation: it sits in the upper half, the ground it flies over in the lower.
    target = (0.0, 0.0, 0.10 * distance)
    return Eye((-0.86 * distance, 0.36 * distance, -0.40 * distance), target)


def overview_eye(still: Scene) -> Eye:
    """A camera high in the south-west that sees the whole path and its ground."""
    area = ground(still.path)
    middle = 0.5 * (area.low + area.high)
    size = float(np.max(area.high - area.low))
    height = float(-still.path[:, 2].mean()) if len(still.path) else 0.0
    # Aimed short of the middle: near ground takes more of the picture than far ground.
    target = (float(middle[0]) - 0.17 * size, float(middle[1]), -0.5 * height)
    return Eye((target[0] - 0.47 * size, target[1] - 0.22 * size, -0.46 * size), target)
