"""Reference for mean wind, gusts and turbulence field over airframes: equations in numpy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reference.frames import rotation_ned_body
from testbed.atmosphere.airframe_wind import AHEAD, BEHIND, MEAN, RIGHT, SLOPE, WING
from testbed.atmosphere.gusts import UniformGust
from testbed.atmosphere.mean_wind import LOGARITHMIC
from testbed.atmosphere.turbulence_field import NODES, OVERLAP, FieldGrid
from testbed.core.records import Array, BoolArray


def profile_factor(profile, height: Array) -> Array:
    """Part (...,) of the speed at heights (...,) m."""
    if profile is None:
        return np.ones_like(height)
    if profile.kind == LOGARITHMIC:
        scale = 1.0 / math.log(profile.height / profile.parameter)
        roughness = profile.parameter
        return scale * np.log(np.maximum(height, roughness) / roughness)
    return (np.maximum(height, 0.0) / profile.height) ** profile.parameter


@dataclass(frozen=True, slots=True)
class MeanWind:
    """A wind in M rows, linear between them; the profile scales its horizontal part."""

    time: Array  # (M,) s, increasing from 0; one row is a steady wind
    velocity: Array  # (M, 3) m/s NED, at the profile's height
    slope: Array  # (max(M - 1, 1), 3) m/s² from each row to the next
    path: Array  # (M, 3) m NED, of the air at the advection height since time 0
    advection: Array  # (3,) factors of `velocity` at the advection height
    profile: object  # none: the same at all heights

    @property
    def steady(self) -> bool:
        """True if it is the same at all times."""
        return len(self.time) == 1

    @property
    def uniform(self) -> bool:
        """True if it is the same at all heights."""
        return self.profile is None

    def velocity_ned(self, time: float, height: Array) -> Array:
        """Velocity (..., 3) m/s at one time, s, and heights (...,) m."""
        row = self._row(time)
        out = np.empty((*np.shape(height), 3))
        out[...] = self.velocity[row] + (time - self.time[row]) * self.slope[row]
        if self.profile is not None:
            out[..., :2] *= np.expand_dims(profile_factor(self.profile, height), -1)
        return out

    def displacement_ned(self, time: float) -> Array:
        """Path (3,) m of the air at the advection height from time 0 to this one, s."""
        if self.steady:
            return time * (self.advection * self.velocity[0])
        row = self._row(time)
        since = time - self.time[row]
        mean = self.velocity[row] + 0.5 * since * self.slope[row]
        return self.path[row] + since * self.advection * mean

    def _row(self, time: float) -> int:
        """The row at the beginning of the interval that holds this time."""
        if self.steady:
            return 0
        return int(self.time[1:-1].searchsorted(time))


def make_mean_wind(
    time: Array, velocity: Array, *, profile=None, advection_height: float = 0.0
) -> MeanWind:
    """A wind from its rows.

    Args:
        time: (M,) s, increasing from 0; (1,) for a steady wind.
        velocity: (M, 3) m/s NED, at the profile's height.
        profile: over height; none is the same at all heights.
        advection_height: m, whose wind moves the frozen field and the fronts of gusts.
    """
    advection = np.ones(3)
    if profile is not None:
        advection[:2] = profile_factor(profile, np.array(advection_height))
    steady = len(time) == 1
    width = np.diff(time)[:, np.newaxis]
    path = np.zeros_like(velocity)
    path[1:] = advection * np.cumsum(width * 0.5 * (velocity[1:] + velocity[:-1]), axis=0)
    return MeanWind(
        time=time,
        velocity=velocity,
        slope=np.zeros((1, 3)) if steady else np.diff(velocity, axis=0) / width,
        path=path,
        advection=advection,
        profile=profile,
    )


@dataclass(frozen=True, slots=True)
class Gusts:
    """G gusts; x = rate · time + offset + advection · displacement − normal · point."""

    velocity: Array  # (G, 3) A, m/s NED
    rate: Array  # (G,) of x with time: 1, or the front's speed in m/s
    offset: Array  # (G,) s or m
    advection: Array  # (G, 3) unit vectors along which the mean wind moves fronts, or zero
    normal: Array  # (G, 3) unit vectors out of fronts, or zero
    rise: Array  # (G,) d, s or m
    end: Array  # (G,) the x/d at which nothing changes any more: 1, or 2 of a pulse

    def velocity_ned(self, time: float, points: Array, displacement: Array) -> Array:
        """Velocity (..., 3) m/s of all gusts.

        Args:
            time: s.
            points: (..., 3) m NED.
            displacement: (3,) m NED, path of the mean wind since time 0.
        """
        depth = np.clip(self._depth(time, points, displacement), 0.0, self.end)
        velocity: Array = (0.5 - 0.5 * np.cos(np.pi * depth)) @ self.velocity
        return velocity

    def active(self, time: float, position_ned: Array, displacement: Array) -> BoolArray:
        """Which gust reaches which of N aircraft at (N, 3) m: (G, N); a ramp has no end."""
        depth = self._depth(time, position_ned, displacement)
        return ((depth > 0.0) & ((depth < 2.0) | (self.end == 1.0))).T

    def _depth(self, time: float, points: Array, displacement: Array) -> Array:
        """x/d (..., G)."""
        front = self.rate * time + self.offset + self.advection @ displacement
        depth: Array = (front - points @ self.normal.T) / self.rise
        return depth


def make_gusts(gusts: list, wind: MeanWind) -> Gusts:
    """The gusts, with the mean wind that moves the fronts without a speed of their own."""
    count = len(gusts)
    rate, offset = np.zeros(count), np.zeros(count)
    advection, normal = np.zeros((count, 3)), np.zeros((count, 3))
    for g, gust in enumerate(gusts):
        if isinstance(gust, UniformGust):
            rate[g], offset[g] = 1.0, -gust.start
            continue
        normal[g, :2] = np.cos(gust.direction), np.sin(gust.direction)
        offset[g] = normal[g, :2] @ np.array(gust.point)
        if gust.speed is None:
            advection[g] = normal[g]
            offset[g] -= normal[g] @ wind.displacement_ned(gust.start)
        else:
            rate[g] = gust.speed
            offset[g] -= gust.speed * gust.start
    return Gusts(
        velocity=np.array([gust.velocity_ned for gust in gusts]).reshape(count, 3),
        rate=rate,
        offset=offset,
        advection=advection,
        normal=normal,
        rise=np.array(
            [gust.ramp if isinstance(gust, UniformGust) else gust.length for gust in gusts]
        ),
        end=np.array([2.0 if gust.pulse else 1.0 for gust in gusts]),
    )


def sample_points(position_ned: Array, euler: Array, body: Array) -> Array:
    """The points (N, 5, 3) NED, m, of airframes at positions (N, 3) with attitudes (N, 3)."""
    out: Array = position_ned[:, np.newaxis, :] + body @ rotation_ned_body(euler).swapaxes(1, 2)
    return out


def mean_and_gradient(velocity_ned: Array, euler: Array, body: Array) -> tuple[Array, Array]:
    """Average (N, 3) NED and rates about body axes (N, 3) of a wind at the points (N, 5, 3).

    The average is that over the wing. The rates are those of air rotating as a rigid body:
    p = ∂w/∂y along the wing, q = −∂w/∂x and r = ∂v/∂x from ahead to behind.
    """
    wing = velocity_ned[:, : len(WING)]
    wind = (MEAN[:, np.newaxis] * wing).sum(axis=1)
    rotation = rotation_ned_body(euler)
    slope = (SLOPE[:, np.newaxis] * wing).sum(axis=1) / body[:, RIGHT, 1, np.newaxis] * WING[RIGHT]
    along = velocity_ned[:, AHEAD] - velocity_ned[:, BEHIND]
    along = along / (body[:, AHEAD, 0] - body[:, BEHIND, 0])[:, np.newaxis]
    rates = np.empty_like(wind)
    rates[:, 0] = (slope * rotation[:, :, 2]).sum(axis=1)
    rates[:, 1] = -(along * rotation[:, :, 2]).sum(axis=1)
    rates[:, 2] = (along * rotation[:, :, 1]).sum(axis=1)
    return wind, rates


def sample_field(grid: FieldGrid, centre: Array, points: Array) -> Array:
    """Velocities (N, K, 3) of the air, m/s NED, at K points of each of N airframes.

    Coarse levels are sampled at an airframe's centre, with their gradient, and are linear from
    there to its points. Positions are in the frame of the air.

    Args:
        grid: of the field.
        centre: (N, 3) m, NED.
        points: (N, K, 3) m, NED.
    """
    out = np.zeros(points.shape)
    arms = points - centre[:, np.newaxis, :]
    for level in grid.levels:
        axes = level["axes"]
        if level["at_points"]:
            out += _look_up(grid.values, level, points @ axes.T)[..., 0, :]
        else:
            found = _look_up(grid.values, level, centre @ axes.T)
            out += found[:, np.newaxis, 0, :] + arms @ axes.T @ found[:, 1:, :]
    return out


def _look_up(values, level, cells: Array) -> Array:
    """Velocity and its derivatives by the three cell coordinates (..., 4, 3) at those (..., 3)."""
    base = np.floor(cells)
    weights, slopes = _spline(cells - base)
    count = level["count"]
    lowest = (base.astype(np.int64)[..., np.newaxis] - 1) % count
    nodes = lowest + np.arange(NODES)
    across = nodes[..., :2, :] % count
    row = across[..., 0, :, np.newaxis] * count + across[..., 1, np.newaxis, :]
    row = row[..., np.newaxis] * (count + OVERLAP) + nodes[..., 2, np.newaxis, np.newaxis, :]
    found = values[level["first"] + row].astype(np.float64)
    terms = np.stack([weights, weights, weights, weights], axis=-2)  # (..., axis, term, 4)
    for axis in range(3):
        terms[..., axis, axis + 1, :] = slopes[..., axis, :]
    out: Array = np.einsum(
        "...ti,...tj,...tk,...ijkc->...tc",
        *(terms[..., axis, :, :] for axis in range(3)),
        found,
        optimize=True,
    )
    return out


def _spline(part: Array) -> tuple[Array, Array]:
    """Weights (..., 4) of the four nodes about a place, and their derivatives, at 0..1 (...)."""
    t, u = part, 1.0 - part
    weights = np.stack(
        [u**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * u**2 + 3.0 * u**3, t**3], axis=-1
    )
    slopes = np.stack([-(u**2), 3.0 * t**2 - 4.0 * t, 4.0 * u - 3.0 * u**2, t**2], axis=-1)
    return weights / 6.0, slopes / 2.0


def sample_ambient_wind(
    wind: MeanWind,
    grid: FieldGrid,
    gusts: Gusts,
    position: Array,
    euler: Array,
    body: Array,
    mean: Array,
    displacement: Array,
    ambient: Array,
    velocity: Array,
    rates: Array,
    time: float,
) -> None:
    """Write mean wind, turbulence field and gusts over N airframes.

    Args:
        wind: the mean wind, which moves field and gusts.
        grid: of the turbulence field; it may have no levels.
        gusts: none or more.
        position: (N, 3) m, NED.
        euler: (N, 3) rad.
        body: (N, 5, 3) m, the sample points.
        mean: (N, 3) m/s; written: the mean wind at the centres.
        displacement: (3,) m; written: the path of the air since time 0.
        ambient: (N, 3) m/s; written: mean wind and gusts.
        velocity: (N, 3) m/s; written: of the air, averaged over the wing.
        rates: (N, 3) rad/s; written: gradients about body axes.
        time: s.
    """
    mean[:] = wind.velocity_ned(time, -position[:, 2])
    displacement[:] = wind.displacement_ned(time)
    ambient[:], velocity[:], rates[:] = mean, mean, 0.0
    if len(grid.levels):
        in_air = position - displacement
        turbulent = sample_field(grid, in_air, sample_points(in_air, euler, body))
        for written, each in zip(
            (velocity, rates), mean_and_gradient(turbulent, euler, body), strict=True
        ):
            written += each
    if len(gusts.rate) or not wind.uniform:
        # what differs from point to point of an airframe
        points = sample_points(position, euler, body)
        relative = wind.velocity_ned(time, -points[:, :, 2]) - mean[:, np.newaxis]
        relative += gusts.velocity_ned(time, points, displacement)
        added, gradient = mean_and_gradient(relative, euler, body)
        ambient += added
        velocity += added
        rates += gradient
