"""Cameras that keep every flying aircraft in sight, and where they show a point.

A camera looks along a fixed direction of a frame that follows the formation and turns with the
leader's course. Its distance is the smallest at which everything fits: it grows at once and
shrinks slowly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import course, quaternion_xyzw
from testbed.core.records import Array, BoolArray
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import Scene

HALF_HEIGHT = math.tan(math.radians(55.0) / 2.0)  # of a picture at distance 1, as in Rerun's eye
USED = 0.86  # share of the picture that aircraft may use; the rest is for their names
CENTRE_S = 1.5  # time constant of the centre: a jump, as at a loss, becomes a pan
APPROACH_S = 6.0  # time constant of a distance that shrinks
MIN_SPANS = 4.0  # smallest distance, in wingspans
FOLLOW_SPANS = 9.0  # distance from a followed aircraft, in drawn wingspans


@dataclass(frozen=True, slots=True)
class Lens:
    """A direction of view, in distances from the centre: forward, right, down."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    aspect: float  # width by height of the narrowest picture that shows everything

    @property
    def axes(self) -> Array:
        """Unit vectors right, up and forward of the picture (3, 3)."""
        forward = np.subtract(self.target, self.eye)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        axes: Array = np.stack([right, np.cross(right, forward), forward])
        return axes

    def distance(self, points: Array, radius: float) -> Array:
        """Compute from where spheres around points (m, k, 3) are inside the picture, (m,) m.

        Points that are NaN are left out; minus infinity: there are none.
        """
        right, up, forward = self.axes
        height = USED * HALF_HEIGHT
        sides = [(right, self.aspect * height), (-right, self.aspect * height)]
        planes = np.stack([a - b * forward for a, b in (*sides, (up, height), (-up, height))])
        reach = points @ planes.T + radius * np.linalg.norm(planes, axis=-1)
        needed = np.where(np.isnan(reach), -np.inf, reach / (planes @ self.eye))
        distance: Array = needed.max(axis=(1, 2), initial=-np.inf)
        return distance


# From behind, 19° down: the horizon is in the upper sixth of the picture, above the formation.
BEHIND = Lens((-0.90, 0.33, -0.30), (0.0, 0.0, 0.03), (0.0, 0.0, -1.0), aspect=1.6)
ABOVE = Lens((-0.001, 0.0, -1.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), aspect=1.25)


@dataclass(frozen=True, slots=True)
class CameraTrack:
    """The frame and the distance of a camera at m times."""

    lens: Lens
    centre: Array  # (m, 3) m NED
    heading: Array  # (m,) rad
    distance: Array  # (m,) m

    def rows(self, chosen: slice | NDArray[np.intp]) -> CameraTrack:
        """Select times."""
        return CameraTrack(
            self.lens, self.centre[chosen], self.heading[chosen], self.distance[chosen]
        )

    @property
    def euler(self) -> Array:
        """Roll, pitch and yaw (m, 3) of the frame, rad."""
        level = np.zeros((len(self.heading), 3))
        level[:, 2] = self.heading
        return level

    @property
    def quaternion(self) -> Array:
        """Rotation (m, 4) of the frame: x, y, z, w."""
        return quaternion_xyzw(self.euler)

    def to_frame(self, position: Array) -> Array:
        """Transform NED positions (m, k, 3) into forward, right and down of the centre."""
        return rotate_to_heading(position - self.centre[:, None], self.heading)

    def project(self, position: Array) -> tuple[Array, Array]:
        """Project NED positions (m, k, 3).

        Returns:
            Right and up (m, k, 2) from the middle of the picture, in halves of its height, and the
            depth (m, k), m, which is negative behind the camera.
        """
        eye = self.distance[:, None, None] * np.array(self.lens.eye)
        right, up, depth = np.moveaxis((self.to_frame(position) - eye) @ self.lens.axes.T, -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([right, up], axis=-1) / (HALF_HEIGHT * depth[..., None]), depth

    def unproject(self, screen: Array, depth: Array) -> Array:
        """Invert `project`, into the frame: forward, right and down (m, k, 3) of the centre, m."""
        eye = self.distance[:, None, None] * np.array(self.lens.eye)
        seen = np.concatenate([HALF_HEIGHT * screen, np.ones_like(screen[..., :1])], axis=-1)
        position: Array = eye + (depth[..., None] * seen) @ self.lens.axes
        return position


class FormationCameras:
    """Follow a formation with one camera for each lens; keeps its state from batch to batch."""

    def __init__(self, scene: Scene, lenses: Sequence[Lens], size: float) -> None:
        """Prepare for the first batch.

        Args:
            scene: of which the first run's aircraft are kept in sight.
            lenses: of the cameras. Where the scene has an aircraft to follow, the first camera
                stays near that one instead.
            size: factor by which aircraft are drawn larger.
        """
        self._scene, self._lenses, self._span = scene, lenses, max(scene.wingspan)
        self._radius = 0.5 * size * self._span
        self._dt = 1.0 / scene.sample_rate_hz
        self._time: float | None = None  # s, of the last sample
        self._travelled = np.zeros(3)  # m NED, of the mean of all flying aircraft
        self._smooth = np.zeros(3)  # m, of the centre
        self._log_distance = np.full(len(lenses), -np.inf)

    def track(self, batch: ViewBatch) -> tuple[CameraTrack, ...]:
        """Compute the cameras for a batch, which must not be empty."""
        scene, count = self._scene, 1 + self._scene.camera_followers
        flying = flying_aircraft(batch)[:, :count]
        heading = self._heading(batch, flying)
        shown = np.where(flying[..., None], batch.position[:, :count], np.nan)
        slots = np.where(flying[:, 1:, None], batch.slot[:, : scene.camera_followers], np.nan)
        points = np.concatenate([shown, slots], axis=1)
        centre = self._centre(batch, flying, points, heading)
        around = rotate_to_heading(points - centre[:, None], heading)
        elapsed = batch.time - (batch.time[0] if self._time is None else self._time)
        self._time = float(batch.time[-1])
        tracks = []
        for k, lens in enumerate(self._lenses):
            if k == 0 and scene.follow is not None:
                tracks.append(self._following(batch, lens, scene.follow))
                continue
            needed = np.maximum(lens.distance(around, self._radius), MIN_SPANS * self._span)
            rising = np.log(needed) + elapsed / APPROACH_S
            rising[0] = max(rising[0], self._log_distance[k])
            log_distance = np.maximum.accumulate(rising) - elapsed / APPROACH_S
            self._log_distance[k] = log_distance[-1]
            tracks.append(CameraTrack(lens, centre, heading, np.exp(log_distance)))
        return tuple(tracks)

    def _heading(self, batch: ViewBatch, flying: BoolArray) -> Array:
        """Compute the course of the leader, or of the others' mean once it is lost, (m,) rad."""
        others = _mean(batch.velocity[:, : flying.shape[1]], flying)
        return course(np.where(flying[:, :1], batch.velocity[:, 0], others))

    def _centre(self, batch: ViewBatch, flying: BoolArray, points: Array, heading: Array) -> Array:
        """Compute the smoothed middle of points (m, k, 3), (m, 3) m NED."""
        velocity = _mean(batch.velocity[:, : flying.shape[1]], flying)
        travelled = self._travelled + np.cumsum(velocity, axis=0) * self._dt
        ahead = rotate_to_heading(points, heading)
        none = np.isnan(ahead).all(axis=(1, 2))
        ahead[none] = rotate_to_heading(self._last_known(batch), heading)[none]
        box = 0.5 * (np.nanmax(ahead, axis=1) + np.nanmin(ahead, axis=1))
        moving = rotate_to_heading(box[:, None], -heading)[:, 0] - travelled
        share = 1.0 - math.exp(-self._dt / CENTRE_S)
        if self._time is None:
            self._smooth = moving[0]
        smooth = np.empty_like(moving)
        for k, each in enumerate(moving):
            # a filter of SciPy has the same numbers, but to import it takes longer than all else
            self._smooth = smooth[k] = (1.0 - share) * self._smooth + share * each
        self._travelled = travelled[-1]
        centre: Array = travelled + smooth
        return centre

    def _last_known(self, batch: ViewBatch) -> Array:
        """Return positions to look at when no aircraft flies: where they were lost."""
        count = 1 + 2 * self._scene.camera_followers
        known = np.nan_to_num(batch.position[:, :1])
        return np.broadcast_to(known, (len(batch), count, 3))

    def _following(self, batch: ViewBatch, lens: Lens, row: int) -> CameraTrack:
        distance = FOLLOW_SPANS * 2.0 * self._radius
        heading = course(batch.velocity[:, row])
        return CameraTrack(lens, batch.position[:, row], heading, np.full(len(batch), distance))


def flying_aircraft(batch: ViewBatch) -> BoolArray:
    """Find the aircraft that are not lost and have a position (m, N)."""
    flying: BoolArray = (batch.lost == 0.0) & np.isfinite(batch.position).all(axis=-1)
    return flying


def leader_track(batch: ViewBatch) -> CameraTrack:
    """Return the frame at the leader that turns with its course; held where they are not finite."""
    centre = hold_finite(batch.position[:, 0])
    heading = hold_finite(course(batch.velocity[:, 0]))
    return CameraTrack(BEHIND, centre, heading, np.zeros(len(centre)))


def hold_finite(values: Array) -> Array:
    """Replace values (K, ...) that are not finite by the last finite ones before them, or zero."""
    known = np.isfinite(values)
    if known.all():
        return values
    rows = np.arange(len(values)).reshape(-1, *[1] * (values.ndim - 1))
    last = np.maximum.accumulate(np.where(known, rows, -1), axis=0)
    held = np.take_along_axis(values, np.maximum(last, 0), axis=0)
    return np.where(last < 0, 0.0, held)


def rotate_to_heading(vectors: Array, heading: Array) -> Array:
    """Resolve NED vectors (m, N, 3) forward, right and down of headings (m,)."""
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    north, east, down = np.moveaxis(vectors, -1, 0)
    return np.stack([c * north + s * east, c * east - s * north, down], axis=-1)


def _mean(vectors: Array, chosen: BoolArray) -> Array:
    """Average vectors (m, k, 3) over the chosen ones (m, k); zero where there are none."""
    count = np.maximum(chosen.sum(axis=1, keepdims=True), 1)
    mean: Array = np.where(chosen[..., None], vectors, 0.0).sum(axis=1) / count
    return mean
