"""The frame of a camera, and the texts and marks over its picture, as columns.

The unit of the frame is a share of the camera's distance, so that the viewer's camera, which stands
still in it, moves away as the formation spreads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
import rerun as rr

from testbed.core.records import Array
from testbed.views.annotations import Canvas, name_aircraft, scale_bar
from testbed.views.cameras import CameraTrack
from testbed.views.layout import UNITS
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import TEXT_COLOUR, Scene

Columns = Iterator[tuple[str, rr.ComponentColumnList]]  # entity below the camera's, and its columns

ARROW_PX = 22.0
GRID_LINES = 12  # on each side of the middle
BAR_PX = (18.0, 24.0)  # of the scale bar from the left and the lower edge
TEXT_PX = 14.0  # from a point up to the middle of its text in the viewer
LETTER_PX, LINE_PX = 7.6, 22.0  # of the viewer's texts
# The views in a window of 1600 x 900; in a larger one texts have more room.
BEHIND_CANVAS = Canvas(990.0, 430.0, LETTER_PX, LINE_PX)
ABOVE_CANVAS = Canvas(495.0, 340.0, LETTER_PX, LINE_PX)


def camera_frame(track: CameraTrack) -> rr.ComponentColumnList:
    """Make the poses and scales of a camera's frame."""
    return rr.Transform3D.columns(
        translation=track.centre,
        quaternion=track.quaternion,
        scale=np.repeat(track.distance[:, None] / UNITS, 3, axis=1),
    )


def overlay(
    scene: Scene, batch: ViewBatch, track: CameraTrack, canvas: Canvas, size: float, *, grid: bool
) -> Columns:
    """Make names, arrows towards aircraft out of view, and the scale, for each sample.

    Args:
        scene: of N aircraft.
        batch: m samples.
        track: of the camera, m rows.
        canvas: the size of the view.
        size: factor by which aircraft are drawn larger.
        grid: whether to draw a grid through the middle, with the scale bar's length as step.
    """
    colours = np.array(scene.colours, np.uint8)
    positions, labels, paints, ties, tie_paints = [], [], [], [], []
    tails, vectors, arrow_paints, bars, lines = [], [], [], [], []
    for k in range(len(batch)):
        one, at = batch.rows(slice(k, k + 1)), track.rows(slice(k, k + 1))
        label, edge = name_aircraft(scene, one, at, canvas, size)
        # arrows carry their texts themselves
        points = _in_frame(at, canvas, label.middle - [0.0, TEXT_PX], label.depth)
        texts = _in_frame(at, canvas, edge.middle - [0.0, TEXT_PX])
        positions.append(np.concatenate([points, texts]))
        labels.append(label.texts + edge.texts)
        paints.append(colours[np.concatenate([label.rows, edge.rows])])
        ends = _in_frame(at, canvas, label.ties.reshape(-1, 2), np.repeat(label.tied_depth, 2))
        ties.append(ends.reshape(-1, 2, 3))
        tie_paints.append(colours[label.tied])
        tail = _in_frame(at, canvas, edge.tip - ARROW_PX * edge.direction)
        tails.append(tail)
        vectors.append(_in_frame(at, canvas, edge.tip) - tail)
        arrow_paints.append(colours[edge.rows])
        bar = scale_bar(at, canvas)
        left = np.array([BAR_PX[0], canvas.height - BAR_PX[1]])
        ends = _in_frame(at, canvas, np.stack([left, left + [bar.pixels, 0.0]]))
        bars.append((ends, f"{bar.length:g} m"))
        lines.append(_grid(bar.length * UNITS / float(at.distance[0])))
    yield "names", _joined(rr.Points3D, positions=positions, labels=labels, colors=paints)
    if any(map(len, ties)):
        yield "ties", _joined(rr.LineStrips3D, strips=ties, colors=tie_paints)
    if any(map(len, tails)):
        yield (
            "out_of_view",
            _joined(rr.Arrows3D, origins=tails, vectors=vectors, colors=arrow_paints),
        )
    yield (
        "scale",
        rr.LineStrips3D.columns(
            strips=np.array([ends for ends, _ in bars], np.float32),
            labels=[text for _, text in bars],
            colors=[TEXT_COLOUR] * len(bars),
        ),
    )
    if grid:
        yield "grid", _joined(rr.LineStrips3D, strips=lines)


def _joined(archetype: Any, **of_samples: Sequence[Any]) -> rr.ComponentColumnList:  # noqa: ANN401
    """Make columns of an archetype from the elements of each sample."""
    counts = list(map(len, next(iter(of_samples.values()))))
    joined: dict[str, Any] = {
        name: list(chain.from_iterable(each)) if name == "labels" else np.concatenate(each)
        for name, each in of_samples.items()
    }
    if "strips" in joined:
        joined["strips"] = joined["strips"].astype(np.float32)
    columns: rr.ComponentColumnList = archetype.columns(**joined).partition(counts)
    return columns


def _in_frame(
    track: CameraTrack, canvas: Canvas, pixels: Array, depth: Array | None = None
) -> Array:
    """Convert pixels (k, 2) into positions (k, 3) in a camera's frame; `track` has one row.

    Without depths (k,), m, the positions are in the plane through the middle of the formation.
    """
    if depth is None:
        middle = -float(track.distance[0]) * float(np.dot(track.lens.axes[2], track.lens.eye))
        depth = np.full(len(pixels), middle)
    position = track.unproject(canvas.to_screen(pixels)[None], depth[None])[0]
    in_units: Array = position * UNITS / track.distance[0]
    return in_units


def _grid(step: float) -> Array:
    """Lay out the lines (l, 2, 3) of a horizontal grid through the origin."""
    at = step * np.arange(-GRID_LINES, GRID_LINES + 1.0)
    end, zero = np.full_like(at, at[-1]), np.zeros_like(at)
    across = np.stack([np.stack([at, -end, zero], -1), np.stack([at, end, zero], -1)], axis=1)
    return np.concatenate([across, across[..., [1, 0, 2]]])
