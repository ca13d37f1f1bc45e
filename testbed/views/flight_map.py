"""The small picture of a video frame with the whole flight: where, how high, on which path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.views.annotations import LOST, Canvas
from testbed.views.cameras import CameraTrack, Lens, flying_aircraft
from testbed.views.landscape import LINE, landscape_colours
from testbed.views.layout import OVERVIEW_TRAIL_S, overview_camera
from testbed.views.pillow_backend import FINER, Drawing
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import PATH_COLOUR, TEXT_COLOUR, Scene, ground, mix
from testbed.views.video_view import NEAR, VideoView

SOIL_SINE = 0.7  # of the angle below the horizon whose colour the ground has
TRAIL_POINTS = 120
PATH_POINTS = 400
LABELLED_PX = 300.0  # width from which the grid has its scale
LABEL_PX = 11.0  # size of these texts


class FlightMap:
    """The whole flight from high in the south-west, at each frame."""

    def __init__(
        self, scene: Scene, batch: ViewBatch, rows: NDArray[np.intp], canvas: Canvas
    ) -> None:
        """Prepare the camera.

        Args:
            scene: of N aircraft. Where it has no path, that which the leader flew is drawn.
            batch: all samples.
            rows: of the samples that are drawn.
            canvas: the picture.
        """
        paths = scene.paths or _flown(batch)
        self._scene, self._batch, self._rows = replace(scene, paths=paths), batch, rows
        self._area = ground(paths)
        camera = overview_camera(self._scene)
        offset = np.subtract(camera.position, camera.target)
        distance = float(np.linalg.norm(offset))
        lens = Lens(tuple((offset / distance).tolist()), (0.0, 0.0, 0.0), camera.up, 1.0)
        track = CameraTrack(lens, np.array([camera.target]), np.zeros(1), np.full(1, distance))
        (soil,) = landscape_colours(np.array([SOIL_SINE]))
        background = np.tile(soil, (round(FINER * canvas.height), 1))
        self._view = VideoView(track, canvas, background, 0.0)
        self._line = mix(tuple(soil.tolist()), LINE, 0.5)

    def draw(self, number: int) -> Drawing:
        """Draw a frame by its number."""
        view, canvas, area = self._view, self._view.canvas, self._area
        drawing = Drawing(int(canvas.width), int(canvas.height), view.rows)
        for line in area.lines:
            view.polyline(drawing, 0, line, self._line, 0.6)
        for path in area.paths:
            view.polyline(drawing, 0, path * [1.0, 1.0, 0.0], self._line, 1.0)
        for post in area.posts:
            view.polyline(drawing, 0, post, self._line, 0.6)
        for path in area.paths:
            view.polyline(drawing, 0, path, PATH_COLOUR, 0.9)
        row = int(self._rows[number])
        flying = flying_aircraft(self._batch.rows(slice(row, row + 1)))[0]
        for k in np.flatnonzero(flying).tolist():
            view.polyline(drawing, 0, self._trail(row, k), self._scene.colours[k], 1.4)
        for k in np.flatnonzero(flying)[::-1].tolist():
            at = self._batch.position[row, k]
            view.polyline(drawing, 0, np.stack([at, at * [1.0, 1.0, 0.0]]), TEXT_COLOUR, 0.6)
            self._dot(drawing, at, self._scene.colours[k])
        for k in np.flatnonzero(self._batch.lost[row]).tolist():
            self._dot(drawing, self._batch.position[row, k], LOST)
        drawing.finish()
        if canvas.width >= LABELLED_PX:
            pixels, _ = view.pixels(0, area.label_positions)
            for middle, text in zip(pixels, area.labels, strict=True):
                if (middle > 24.0).all() and (
                    middle < [canvas.width - 24.0, canvas.height - 8.0]
                ).all():
                    drawing.text(middle, text, PATH_COLOUR, size=LABEL_PX, boxed=False)
        return drawing

    def _dot(self, drawing: Drawing, position: Array, colour: tuple[int, int, int]) -> None:
        at, depth = self._view.pixels(0, position[None])
        if depth[0] > NEAR:
            drawing.dot(at[0], colour, 2.8)

    def _trail(self, row: int, k: int) -> Array:
        time = self._batch.time
        first = int(np.searchsorted(time, time[row] - OVERVIEW_TRAIL_S))
        rows = np.unique(np.linspace(first, row, TRAIL_POINTS).astype(int))
        trail: Array = self._batch.position[rows, k]
        return trail


def _flown(batch: ViewBatch) -> tuple[Array, ...]:
    """Return the path (k, 3) that the first aircraft flew, or none."""
    rows = np.unique(np.linspace(0, len(batch) - 1, PATH_POINTS).astype(int))
    path = batch.position[rows, 0]
    path = path[np.isfinite(path).all(axis=-1)]
    return (path,) if len(path) > 1 else ()
