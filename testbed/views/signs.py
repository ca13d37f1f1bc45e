"""What is drawn between the aircraft: links with their losses, and where the chase camera is.

Places are in the frame of the chase camera, where they change slowly: so they may be drawn less
often than the aircraft fly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.frames import course
from testbed.state import Array
from testbed.views.batch import Batch
from testbed.views.scene import Scene

SIGNS = ("links", "wind", "believed", "worst")  # entities in the frame of the chase camera
MOST_LINKS = 120  # at once; of more only those that fail are drawn
FLASH_S = 0.3  # after a message that was lost
STALE_S = 0.5  # news older than this is drawn as such
FRESH, STALE, LOST = (96, 112, 136), (240, 200, 60), (255, 60, 40)
THIN, BROAD = 0.6, 2.0  # points
WORST = 3  # of many, so many are named


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines from senders to receivers, those of one frame after those of another; S in all."""

    time: Array  # (m,) s
    counts: NDArray[np.intp]  # (m,) lines of each frame
    strips: Array  # (S, 2, 3) m
    colours: NDArray[np.uint8]  # (S, 3)
    radii: Array  # (S,) points


class Links:
    """The links that followers use, and those on which messages were lost a moment ago.

    Remembers from batch to batch when that was, and which links were ever used.
    """

    def __init__(self, still: Scene) -> None:
        """Nothing was heard yet, and nothing lost."""
        shape = (len(still.followers), len(still.names))
        self._still, self._rows = still, np.array(still.followers, dtype=np.intp)
        self._missed = np.zeros(shape)
        self._lost_at = np.full(shape, -np.inf)  # s
        self._heeded = np.zeros(shape, dtype=bool)

    def lines(self, batch: Batch) -> Lines:
        """What is drawn of the frames of a batch, which is not empty."""
        age = batch.age
        used = np.isfinite(age)
        heeded = np.logical_or.accumulate(used, axis=0) | self._heeded
        self._heeded = heeded[-1]
        recent = batch.time[:, None, None] - self._losses(batch) <= FLASH_S
        flash, stale = recent & heeded, age > STALE_S
        shown = used | flash
        crowded = shown.sum(axis=(1, 2)) > MOST_LINKS
        shown[crowded] &= (flash | stale)[crowded]
        frame, i, j = np.nonzero(shown)
        place = to_chase(self._still, batch, batch.position)
        colours = np.full((frame.size, 3), FRESH, np.uint8)
        colours[stale[frame, i, j]] = STALE
        colours[flash[frame, i, j]] = LOST
        return Lines(
            time=batch.time,
            counts=shown.sum(axis=(1, 2)),
            strips=np.stack([place[frame, j], place[frame, self._rows[i]]], axis=1),
            colours=colours,
            radii=np.where((flash | stale)[frame, i, j], BROAD, THIN),
        )

    def _losses(self, batch: Batch) -> Array:
        """When a message was last lost (m, n, N), s; minus infinity: never."""
        missed = batch.sent - batch.delivered
        lost = np.diff(missed, axis=0, prepend=self._missed[None]) > 0
        when = np.where(lost, batch.time[:, None, None], -np.inf)
        when[0] = np.maximum(when[0], self._lost_at)
        last: Array = np.maximum.accumulate(when, axis=0)
        self._missed, self._lost_at = missed[-1], last[-1]
        return last


@dataclass(frozen=True, slots=True)
class Labels:
    """Names at places, those of one frame after those of another; S in all."""

    counts: NDArray[np.intp]  # (m,) of each frame
    rows: NDArray[np.intp]  # (S,) of the aircraft
    places: Array  # (S, 3) m
    texts: list[str]  # S


def worst(still: Scene, batch: Batch) -> Labels:
    """Who is furthest from its slot, of those that are not lost, and how far."""
    rows = np.array(still.followers, dtype=np.intp)
    error = np.linalg.norm(batch.error, axis=-1)
    error[~np.isfinite(error) | (batch.lost[:, rows] > 0.0)] = -1.0
    order = np.argsort(-error, axis=1, kind="stable")[:, :WORST]
    far = np.take_along_axis(error, order, axis=1)
    shown = far >= 0.0
    chosen = rows[order][shown]
    frame = np.nonzero(shown)[0]
    texts = [f"{still.names[k]} {e:.1f} m" for k, e in zip(chosen, far[shown], strict=True)]
    place = to_chase(still, batch, batch.position)
    return Labels(shown.sum(axis=1), chosen, place[frame, chosen], texts)


def to_chase(still: Scene, batch: Batch, place: Array) -> Array:
    """Places (m, N, 3) in the frame of the chase camera."""
    return turned(place - centre(still, batch)[:, None], course(batch.velocity[:, 0]))


def turned(vectors: Array, heading: Array) -> Array:
    """NED vectors (m, N, 3) resolved forward, right and down of headings (m,)."""
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    north, east, down = np.moveaxis(vectors, -1, 0)
    return np.stack([c * north + s * east, c * east - s * north, down], axis=-1)


def centre(still: Scene, batch: Batch) -> Array:
    """What the chase camera looks at (m, 3): the middle of the leader and the slots.

    Slots rather than aircraft: the picture stays steady when one of them strays.
    """
    placed = np.concatenate([batch.position[:, :1], batch.slot[:, : still.chased]], axis=1)
    known = np.isfinite(placed).all(axis=-1, keepdims=True)  # (m, n + 1, 1)
    middle: Array = np.where(known, placed, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return middle
