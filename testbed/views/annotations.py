"""What is drawn between the aircraft: links and their losses, labels, the chase camera's frame.

Positions are in the frame of the chase camera, where they change slowly, so that they need fewer
updates than the aircraft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import course
from testbed.core.records import Array
from testbed.views.batch import Batch
from testbed.views.scene import Scene

# entities in the chase camera's frame
ANNOTATIONS = ("links", "wind", "estimates", "largest_errors")
MAX_LINKS = 120  # at once; of more only those with old data or losses are drawn
FLASH_S = 0.3  # duration of the mark of a lost message
STALE_S = 0.5  # age of data from which a link is drawn as stale
NORMAL, STALE, LOST = (96, 112, 136), (240, 200, 60), (255, 60, 40)
THIN, BROAD = 0.6, 2.0  # points
MAX_ERROR_LABELS = 3


@dataclass(frozen=True, slots=True)
class LinkLines:
    """S lines from senders to receivers, ordered by sample."""

    time: Array  # (m,) s
    counts: NDArray[np.intp]  # (m,) lines of each sample
    strips: Array  # (S, 2, 3) m
    colours: NDArray[np.uint8]  # (S, 3)
    radii: Array  # (S,) points


class Links:
    """Select the links to draw: those whose data a follower uses, and recent losses on them.

    Keeps from batch to batch when each link last lost a message and whether it was ever used.
    """

    def __init__(self, scene: Scene) -> None:
        """Start without losses and used links."""
        shape = (len(scene.followers), len(scene.names))
        self._scene, self._rows = scene, np.array(scene.followers, dtype=np.intp)
        self._missing = np.zeros(shape)  # sent and not delivered
        self._lost_at = np.full(shape, -np.inf)  # s
        self._used = np.zeros(shape, dtype=bool)

    def lines(self, batch: Batch) -> LinkLines:
        """Compute the lines of a batch, which must not be empty."""
        age = batch.age
        used_now = np.isfinite(age)
        used = np.logical_or.accumulate(used_now, axis=0) | self._used
        self._used = used[-1]
        recent = batch.time[:, None, None] - self._loss_times(batch) <= FLASH_S
        flash, stale = recent & used, age > STALE_S
        shown = used_now | flash
        crowded = shown.sum(axis=(1, 2)) > MAX_LINKS
        shown[crowded] &= (flash | stale)[crowded]
        sample, i, j = np.nonzero(shown)
        position = to_chase_frame(self._scene, batch, batch.position)
        colours = np.full((sample.size, 3), NORMAL, np.uint8)
        colours[stale[sample, i, j]] = STALE
        colours[flash[sample, i, j]] = LOST
        return LinkLines(
            time=batch.time,
            counts=shown.sum(axis=(1, 2)),
            strips=np.stack([position[sample, j], position[sample, self._rows[i]]], axis=1),
            colours=colours,
            radii=np.where((flash | stale)[sample, i, j], BROAD, THIN),
        )

    def _loss_times(self, batch: Batch) -> Array:
        """Time of each link's last lost message (m, n, N), s; minus infinity: none yet."""
        missing = batch.sent - batch.delivered
        lost = np.diff(missing, axis=0, prepend=self._missing[None]) > 0
        when = np.where(lost, batch.time[:, None, None], -np.inf)
        when[0] = np.maximum(when[0], self._lost_at)
        last: Array = np.maximum.accumulate(when, axis=0)
        self._missing, self._lost_at = missing[-1], last[-1]
        return last


@dataclass(frozen=True, slots=True)
class Labels:
    """S texts at positions, ordered by sample."""

    counts: NDArray[np.intp]  # (m,) labels of each sample
    rows: NDArray[np.intp]  # (S,) of the aircraft
    positions: Array  # (S, 3) m
    texts: list[str]  # S


def largest_errors(scene: Scene, batch: Batch) -> Labels:
    """Label the followers farthest from their slots with the distance, without lost ones."""
    rows = np.array(scene.followers, dtype=np.intp)
    error = np.linalg.norm(batch.error, axis=-1)
    error[~np.isfinite(error) | (batch.lost[:, rows] > 0.0)] = -1.0
    order = np.argsort(-error, axis=1, kind="stable")[:, :MAX_ERROR_LABELS]
    largest = np.take_along_axis(error, order, axis=1)
    shown = largest >= 0.0
    chosen = rows[order][shown]
    sample = np.nonzero(shown)[0]
    texts = [f"{scene.names[k]} {e:.1f} m" for k, e in zip(chosen, largest[shown], strict=True)]
    position = to_chase_frame(scene, batch, batch.position)
    return Labels(shown.sum(axis=1), chosen, position[sample, chosen], texts)


def to_chase_frame(scene: Scene, batch: Batch, position: Array) -> Array:
    """Transform NED positions (m, N, 3) into the frame of the chase camera."""
    relative = position - formation_centre(scene, batch)[:, None]
    return rotate_to_heading(relative, course(batch.velocity[:, 0]))


def rotate_to_heading(vectors: Array, heading: Array) -> Array:
    """Resolve NED vectors (m, N, 3) forward, right and down of headings (m,)."""
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    north, east, down = np.moveaxis(vectors, -1, 0)
    return np.stack([c * north + s * east, c * east - s * north, down], axis=-1)


def formation_centre(scene: Scene, batch: Batch) -> Array:
    """Compute the point the chase camera looks at (m, 3): the mean of the leader and the slots.

    Slots, not aircraft: the picture stays steady when an aircraft leaves the formation.
    """
    slots = batch.slot[:, : scene.camera_followers]
    points = np.concatenate([batch.position[:, :1], slots], axis=1)
    known = np.isfinite(points).all(axis=-1, keepdims=True)  # (m, n + 1, 1)
    centre: Array = np.where(known, points, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return centre
