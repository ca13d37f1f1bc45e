"""One of the pictures of a video frame: its camera, its canvas and its backdrop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.views.annotations import Canvas
from testbed.views.cameras import CameraTrack
from testbed.views.landscape import LINE, backdrop_rows, eye_of, grid_lines, grid_step
from testbed.views.panels import Colour
from testbed.views.pillow_backend import FINER, Drawing

NEAR = 1.0  # m, from the camera to the nearest point that is drawn


@dataclass(frozen=True, slots=True)
class VideoView:
    """One of the pictures of a frame."""

    track: CameraTrack  # one row for each frame
    canvas: Canvas
    rows: NDArray[np.uint8]  # (FINER * height, 3) colours of sky and ground
    step: float  # m, between the lines on the ground

    @classmethod
    def of(cls, track: CameraTrack, canvas: Canvas) -> VideoView:
        """Make the picture of a camera."""
        height = -np.median(track.centre[:, 2] + track.distance * track.lens.eye[2])
        rows = backdrop_rows(track.lens, canvas, FINER)
        return cls(track, canvas, rows, grid_step(float(height)))

    def pixels(self, frame: int, position: Array) -> tuple[Array, Array]:
        """Project positions (k, 3): pixels (k, 2), and depths (k,), m."""
        at = self.track.rows(slice(frame, frame + 1))
        screen, depth = at.project(position[None])
        return self.canvas.to_pixels(screen[0]), depth[0]

    def begin(self, frame: int) -> Drawing:
        """Start a picture with sky, ground and its grid."""
        drawing = Drawing(int(self.canvas.width), int(self.canvas.height), self.rows)
        lines = grid_lines(eye_of(self.track.rows(slice(frame, frame + 1))), self.step)
        pixels, depth = self.pixels(frame, lines.ends.reshape(-1, 3))
        pixels, depth = pixels.reshape(-1, 2, 2), depth.reshape(-1, 2)
        size = np.array([self.canvas.width, self.canvas.height])
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        seen = (depth > NEAR).all(-1) & (high > 0.0).all(-1) & (low < size).all(-1)
        pixels, strength, broad = pixels[seen], lines.strength[seen], lines.broad[seen]
        row = FINER * pixels[..., 1].mean(axis=1).clip(0.0, self.canvas.height - 1.0)
        ground = self.rows[row.astype(int)].astype(np.float64)
        colours = ground + strength[:, None] * (np.array(LINE) - ground)
        drawing.segments(pixels, colours.astype(np.uint8), np.where(broad, 1.1, 0.6))
        return drawing

    def polyline(
        self, drawing: Drawing, frame: int, points: Array, colour: Colour, width: float = 1.0
    ) -> None:
        """Draw the parts of a line (k, 3) that are before the camera and near the picture."""
        pixels, depth = self.pixels(frame, points)
        reach = 4.0 * max(self.canvas.width, self.canvas.height)
        with np.errstate(invalid="ignore"):
            good = (depth > NEAR) & (np.abs(pixels) < reach).all(axis=-1)
        ends = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]])))
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            if end - begin > 1:
                drawing.line(pixels[begin:end], colour, width)
