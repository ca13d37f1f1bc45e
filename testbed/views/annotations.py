"""What is drawn between the aircraft: links and their losses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.views.batch import Batch
from testbed.views.scene import Scene

# entities in the frame of the formation
ANNOTATIONS = ("links", "wind", "estimates")
MAX_LINKS = 120  # at once; of more only those with old data or losses are drawn
FLASH_S = 0.3  # duration of the mark of a lost message
STALE_S = 0.5  # age of data from which a link is drawn as stale
NORMAL, STALE, LOST = (96, 112, 136), (240, 200, 60), (255, 60, 40)
THIN, BROAD = 0.6, 2.0  # points


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
        self._rows = np.array(scene.followers, dtype=np.intp)
        self._missing = np.zeros(shape)  # sent and not delivered
        self._lost_at = np.full(shape, -np.inf)  # s
        self._used = np.zeros(shape, dtype=bool)

    def lines(self, batch: Batch, position: Array) -> LinkLines:
        """Compute the lines of a batch, which must not be empty, between positions (m, N, 3)."""
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
