"""Texts, links and marks over a picture of the formation.

Texts are placed in pixels, so that none covers another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.views.cameras import HALF_HEIGHT, CameraTrack, flying_aircraft
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import MAX_SINGLE, Scene

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
        shape = (len(scene.followers), len(scene.names))
        self._rows = np.array(scene.followers, dtype=np.intp)
        self._missing = np.zeros(shape)  # sent and not delivered
        self._lost_at = np.full(shape, -np.inf)  # s
        self._used = np.zeros(shape, dtype=bool)

    def lines(self, batch: ViewBatch, position: Array) -> LinkLines:
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

    def _loss_times(self, batch: ViewBatch) -> Array:
        """Time of each link's last lost message (m, n, N), s; minus infinity: none yet."""
        missing = batch.sent - batch.delivered
        lost = np.diff(missing, axis=0, prepend=self._missing[None]) > 0
        when = np.where(lost, batch.time[:, None, None], -np.inf)
        when[0] = np.maximum(when[0], self._lost_at)
        last: Array = np.maximum.accumulate(when, axis=0)
        self._missing, self._lost_at = missing[-1], last[-1]
        return last


MAX_ERROR_LABELS = 3  # followers of a large formation that are named, with their errors
TIE_PX = 20.0  # between an aircraft and its name, from which a line joins them
EDGE_PX = 26.0  # from the edge of the picture to the arrow of an aircraft out of view
BAR_SHARE = 0.22  # of the picture's width, at most, for the scale bar


@dataclass(frozen=True, slots=True)
class Canvas:
    """The size of a picture and of its texts, pixels."""

    width: float
    height: float
    letter: float = 7.2  # average width of a letter
    line: float = 17.0  # height of a text with its background

    def to_pixels(self, screen: Array) -> Array:
        """Convert `CameraTrack.project` (..., 2) into pixels right and down of the corner."""
        half = 0.5 * self.height
        return np.array([0.5 * self.width, half]) + screen * [half, -half]

    def to_screen(self, pixels: Array) -> Array:
        """Invert `to_pixels`."""
        half = 0.5 * self.height
        screen: Array = (pixels - [0.5 * self.width, half]) / [half, -half]
        return screen

    def text_size(self, texts: Sequence[str]) -> Array:
        """Estimate width and height (k, 2) of texts."""
        size = [[self.letter * len(text) + 8.0, self.line] for text in texts]
        return np.array(size).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Names:
    """k texts in one picture."""

    rows: NDArray[np.intp]  # (k,) of the aircraft
    texts: list[str]  # k
    middle: Array  # (k, 2) pixels
    depth: Array  # (k,) m, of the aircraft
    ties: Array  # (t, 2, 2) pixels, lines from aircraft to names that are not beside them
    tied: NDArray[np.intp]  # (t,) rows of these aircraft
    tied_depth: Array  # (t,) m


@dataclass(frozen=True, slots=True)
class EdgeArrows:
    """k arrows at the edge of a picture towards aircraft outside it."""

    rows: NDArray[np.intp]  # (k,) of the aircraft
    texts: list[str]  # k names and distances
    tip: Array  # (k, 2) pixels
    direction: Array  # (k, 2) unit, right and down
    middle: Array  # (k, 2) pixels, of the texts


@dataclass(frozen=True, slots=True)
class ScaleBar:
    """A horizontal line of a round length, true at the middle of the formation."""

    length: float  # m
    pixels: float


def name_aircraft(
    scene: Scene,
    batch: ViewBatch,
    track: CameraTrack,
    canvas: Canvas,
    size: float,
) -> tuple[Names, EdgeArrows]:
    """Place names beside the aircraft of one sample, those with the largest errors first.

    Aircraft outside the picture get an arrow at its edge.

    Args:
        scene: of N aircraft.
        batch: one sample.
        track: of the camera, one row.
        canvas: the picture.
        size: factor by which aircraft are drawn larger.
    """
    screen, depth = track.project(batch.position)
    pixels, flying = canvas.to_pixels(screen[0]), flying_aircraft(batch)[0]
    ahead = depth[0] > 0.0
    inside = flying & ahead & (np.abs(screen[0]) <= [canvas.width / canvas.height, 1.0]).all(-1)
    outside = np.flatnonzero(flying & ~inside)
    arrows = _edge_arrows(scene, batch, track, canvas, outside)
    order, texts = _texts(scene, batch, inside)
    sizes = canvas.text_size(texts)
    taken = text_boxes(arrows.middle, canvas.text_size(arrows.texts))
    wing = 0.5 * np.array(scene.wingspan) * size * 0.5 * canvas.height / HALF_HEIGHT / depth[0]
    gaps = _GAP + wing[order, None] * _BESIDE_WING
    frame = canvas.width, canvas.height
    middle = place(pixels[order], sizes, gaps, taken, pixels[inside], frame)
    fits = np.isfinite(middle[:, 0])
    chosen = order[fits]
    shown = [text for text, fit in zip(texts, fits, strict=True) if fit]
    ends = np.stack([pixels[chosen], _nearest_edge(pixels[chosen], middle[fits], sizes[fits])], 1)
    away = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) - wing[chosen] > TIE_PX
    named = Names(
        chosen, shown, middle[fits], depth[0, chosen], ends[away], chosen[away],
        depth[0, chosen[away]],
    )  # fmt: skip
    return named, arrows


def place(
    anchors: Array,
    sizes: Array,
    gaps: Array,
    taken: Array,
    avoided: Array,
    frame: tuple[float, float],
) -> Array:
    """Place texts near their anchors so that none covers another one.

    Args:
        anchors: (k, 2) pixels, in order of priority.
        sizes: (k, 2) of the texts.
        gaps: (k, 2) from the anchors to the nearest edges of the texts.
        taken: (b, 4) boxes left, top, right, bottom of other texts.
        avoided: (a, 2) points that are covered only where there is no other place.
        frame: width and height of the picture.

    Returns:
        The middles (k, 2) of the texts; NaN: there is no room. Of equal places the nearest one is
        taken, or one on the outer side of the avoided points.
    """
    boxes, middles = list(taken), np.full((len(anchors), 2), np.nan)
    outward = anchors - (avoided.mean(axis=0) if len(avoided) else 0.5 * np.array(frame))
    outward /= np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1.0)
    for k, (anchor, size, gap) in enumerate(zip(anchors, sizes, gaps, strict=True)):
        candidates = anchor + _AROUND * (0.5 * size + gap) + _FARTHER
        corners = text_boxes(candidates, np.broadcast_to(size, candidates.shape))
        free = (corners[:, :2] >= 0.0).all(-1) & (corners[:, 2:] <= frame).all(-1)
        if boxes:
            other = np.array(boxes)
            apart = (corners[:, None, :2] >= other[:, 2:]) | (corners[:, None, 2:] <= other[:, :2])
            free &= apart.any(-1).all(-1)
        if not free.any():
            continue
        within = (avoided >= corners[:, None, :2]) & (avoided <= corners[:, None, 2:])
        covered = np.where(free, within.all(-1).sum(-1), len(avoided) + 1)
        offset = _nearest_edge(np.broadcast_to(anchor, candidates.shape), candidates, size) - anchor
        cost = np.linalg.norm(offset, axis=-1) - _OUTWARD_PX * _AROUND @ outward[k]
        best = int(np.lexsort((cost, covered))[0])
        middles[k] = candidates[best]
        boxes.append(corners[best])
    return middles


# Places around an anchor: below, above, beside, diagonal; and the same up to 26 pixels farther.
_EIGHT = np.array([[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, 1], [1, -1], [-1, -1]], float)
_AROUND = np.tile(_EIGHT, (3, 1))
_FARTHER = _AROUND * np.repeat([0.0, 13.0, 26.0], len(_EIGHT))[:, None]
_OUTWARD_PX = 8.0  # for which a place on the outer side of the formation may be farther away
_GAP = np.array([5.0, 5.0])  # pixels between an aircraft and its text
_BESIDE_WING = np.array([1.0, 0.45])  # of half a wingspan: an aircraft is longer than high


def scale_bar(track: CameraTrack, canvas: Canvas) -> ScaleBar:
    """Choose the scale bar of one picture; `track` has one row."""
    depth = float(track.distance[0] * -np.dot(track.lens.axes[2], track.lens.eye))
    metre = 0.5 * canvas.height / (HALF_HEIGHT * depth)  # pixels
    length = round_down(BAR_SHARE * canvas.width / metre)
    return ScaleBar(length, length * metre)


def round_down(length: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length))


def _texts(scene: Scene, batch: ViewBatch, inside: Array) -> tuple[NDArray[np.intp], list[str]]:
    """Order the aircraft inside the picture by error, and write their labels.

    Of a large formation, the leader and the followers with the largest errors have labels.
    """
    rows = np.array(scene.followers, dtype=np.intp)
    error = np.full(len(scene.names), -1.0)
    error[rows] = np.nan_to_num(np.linalg.norm(batch.error[0], axis=-1), nan=-1.0)
    order = np.argsort(np.where(inside, -error, np.inf), kind="stable")[: inside.sum()]
    leader, followers = order[order == 0], order[order != 0]
    if len(scene.names) <= MAX_SINGLE:
        return np.concatenate([leader, followers]), [scene.names[k] for k in (*leader, *followers)]
    largest = followers[error[followers] >= 0.0][:MAX_ERROR_LABELS]
    texts = [
        *(scene.names[k] for k in leader),
        *(f"{scene.names[k]} {error[k]:.1f} m" for k in largest),
    ]
    return np.concatenate([leader, largest]), texts


def _edge_arrows(
    scene: Scene, batch: ViewBatch, track: CameraTrack, canvas: Canvas, rows: NDArray[np.intp]
) -> EdgeArrows:
    """Point from the edge of the picture at aircraft outside it, the nearest first."""
    offset = batch.position[0, rows] - track.centre[0]
    distance = np.linalg.norm(offset, axis=-1)
    order = np.argsort(distance, kind="stable")
    rows, distance = rows[order], distance[order]
    right, up, _ = np.moveaxis(
        track.to_frame(batch.position[:, rows])[0] @ track.lens.axes.T, -1, 0
    )
    direction = np.stack([right, -up], axis=-1)
    direction /= np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-9)
    half = 0.5 * np.array([canvas.width, canvas.height])
    with np.errstate(divide="ignore"):
        reach = np.min((half - EDGE_PX) / np.abs(direction), axis=-1)
    tip = half + direction * reach[:, None]
    texts = [f"{scene.names[k]} {d:.0f} m" for k, d in zip(rows, distance, strict=True)]
    sizes = canvas.text_size(texts)
    inward = tip - direction * 14.0
    gaps = np.broadcast_to(_GAP, sizes.shape)
    frame = canvas.width, canvas.height
    middle = place(inward, sizes, gaps, np.empty((0, 4)), tip, frame)
    fits = np.isfinite(middle[:, 0])
    return EdgeArrows(
        rows[fits], [t for t, fit in zip(texts, fits, strict=True) if fit], tip[fits],
        direction[fits], middle[fits],
    )  # fmt: skip


def text_boxes(middle: Array, size: Array) -> Array:
    """Compute left, top, right, bottom (k, 4) of boxes."""
    return np.concatenate([middle - 0.5 * size, middle + 0.5 * size], axis=-1)


def _nearest_edge(point: Array, middle: Array, size: Array) -> Array:
    """Find the points (k, 2) of boxes that are nearest to points (k, 2)."""
    nearest: Array = np.clip(point, middle - 0.5 * size, middle + 0.5 * size)
    return nearest
