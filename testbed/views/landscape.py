"""Sky, horizon and ground of a picture, and the grid on the ground that shows speed and height.

A camera never rolls, and its direction relative to the horizontal does not change: the horizon is a
fixed row of its picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.views.annotations import Canvas, round_down
from testbed.views.cameras import HALF_HEIGHT, CameraTrack, Lens
from testbed.views.panels import Colour
from testbed.views.scene import HAZE, SOIL

ZENITH: Colour = (17, 24, 40)
HORIZON: Colour = (86, 104, 126)
LINE: Colour = (92, 112, 102)  # of the grid
SKY_REACH, GROUND_REACH = 0.45, 0.60  # sine of the angle from the horizon to ZENITH and SOIL
BROAD_EVERY = 5  # every fifth line of the grid is broad
STEPS_BELOW = 5.0  # the height of the camera in steps of the grid, at most 2.5 times as many
NEAR_STEPS, FAR_STEPS = 16, 100  # from the camera to the last fine and broad lines
FADED_STEPS = 40.0  # over which broad lines fade to a third
TONES = 24  # of the sky, and of the ground: those of pictures with few colours


@dataclass(frozen=True, slots=True)
class GridLines:
    """k pieces of the lines on the ground."""

    ends: Array  # (k, 2, 3) m NED
    strength: Array  # (k,) 0: as the ground, 1: LINE
    broad: NDArray[np.bool_]  # (k,)


def backdrop_rows(lens: Lens, canvas: Canvas, finer: int) -> NDArray[np.uint8]:
    """Compute the colours (rows, 3) of the rows of a picture, top first.

    Args:
        lens: of the camera; its picture is `canvas`.
        canvas: the picture.
        finer: rows per pixel.
    """
    rows = (np.arange(round(finer * canvas.height)) + 0.5) / finer
    up = canvas.to_screen(np.stack([np.zeros_like(rows), rows], axis=-1))[:, 1]
    _, upward, forward = lens.axes
    ray = forward + HALF_HEIGHT * up[:, None] * upward
    return landscape_colours(ray[:, 2] / np.linalg.norm(ray, axis=-1))


def landscape_colours(down: Array) -> NDArray[np.uint8]:
    """Return the colours (k, 3) in directions whose sines of the angle below the horizon are (k,).

    There are `TONES` of the sky and as many of the ground.
    """
    sky = _steps(np.sqrt(np.clip(-down / SKY_REACH, 0.0, 1.0)))
    soil = _steps(np.sqrt(np.clip(down / GROUND_REACH, 0.0, 1.0)))
    colours = np.where(
        (down < 0.0)[:, None], _between(HORIZON, ZENITH, sky), _between(HAZE, SOIL, soil)
    )
    return colours.astype(np.uint8)


def landscape_palette() -> list[Colour]:
    """List the colours of sky and ground, and of fainter and stronger lines on it."""
    share = np.linspace(0.0, 1.0, TONES)
    ground = _between(HAZE, SOIL, share)
    lines = [ground + at * (np.array(LINE) - ground) for at in (0.4, 0.8)]
    rows = np.concatenate(
        [_between(HORIZON, ZENITH, share), ground, *(each[::3] for each in lines)]
    )
    return [(int(red), int(green), int(blue)) for red, green, blue in rows]


def grid_step(height: float) -> float:
    """Choose the distance of the lines on the ground for a height of the camera, m."""
    return round_down(max(height, 1.0) / STEPS_BELOW)


def grid_lines(eye: Array, step: float) -> GridLines:
    """Lay out the grid around the point below a camera at `eye` (3,), in pieces.

    Its lines stand still on the ground, at multiples of `step` m north and east of the origin.
    """
    broad_step = BROAD_EVERY * step
    fine = _square(eye, step, NEAR_STEPS)
    fine = fine[(np.abs(_across(fine) / broad_step % 1.0 - 0.5) < 0.5 - 1e-6)]
    broad = _square(eye, broad_step, FAR_STEPS // BROAD_EVERY)
    ends = np.concatenate([fine, broad])
    is_broad = np.arange(len(ends)) >= len(fine)
    away = np.linalg.norm(ends.mean(axis=1)[:, :2] - eye[:2], axis=-1) / step
    near = np.clip(1.0 - away / NEAR_STEPS, 0.0, 1.0) * 0.55
    far = np.clip(1.0 - away / FAR_STEPS, 0.0, 1.0) / (1.0 + 2.0 * away / FADED_STEPS)
    strength = np.where(is_broad, far, near)
    drawn = strength > 0.02
    return GridLines(ends[drawn], strength[drawn], is_broad[drawn])


def eye_of(track: CameraTrack) -> Array:
    """Compute the position (3,) of a camera, m NED; `track` has one row."""
    ahead, right, down = track.distance[0] * np.array(track.lens.eye)
    c, s = np.cos(track.heading[0]), np.sin(track.heading[0])
    position: Array = track.centre[0] + [c * ahead - s * right, s * ahead + c * right, down]
    return position


def _square(eye: Array, step: float, steps: int) -> Array:
    """Lay out lines at multiples of a step around a point, in pieces of that length (k, 2, 3)."""
    north, east = (
        step * (np.round(each / step) + np.arange(-steps, steps + 1)) for each in eye[:2]
    )
    pieces = []
    for k, (lines, along) in enumerate(((north, east), (east, north))):
        at, begin = (each.ravel() for each in np.meshgrid(lines, along[:-1], indexing="ij"))
        ends = np.zeros((len(at), 2, 3))
        ends[:, :, k] = at[:, None]
        ends[:, 0, 1 - k], ends[:, 1, 1 - k] = begin, begin + step
        pieces.append(ends)
    return np.concatenate(pieces)


def _across(pieces: Array) -> Array:
    """Return the coordinate (k,) that is the same at both ends of pieces (k, 2, 3)."""
    same = pieces[:, 0, 0] == pieces[:, 1, 0]
    found: Array = np.where(same, pieces[:, 0, 0], pieces[:, 0, 1])
    return found


def _steps(share: Array) -> Array:
    return np.round(share * (TONES - 1)) / (TONES - 1)


def _between(one: Colour, other: Colour, share: Array) -> Array:
    """Interpolate (k, 3) between two colours."""
    mixed: Array = np.array(one) + share[:, None] * (np.array(other, np.float64) - np.array(one))
    return mixed
