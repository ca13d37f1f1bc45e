"""The mean wind: steady or recorded, its profile over height, and how far it has carried the air.

It is the same at all places of one height. Heights are above the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.state import Array

EVEN, LOG, POWER = range(3)  # kinds of profiles


def blowing_from(speed: Array | float, direction: Array | float) -> Array:
    """Velocity (..., 3) m/s of winds (...,) by speed, m/s, and where they blow from, rad."""
    towards = np.asarray(direction) + np.pi
    speed = np.asarray(speed, dtype=np.float64)
    horizontal = [speed * np.cos(towards), speed * np.sin(towards)]
    return np.stack([*horizontal, np.zeros_like(horizontal[0])], axis=-1) + 0.0  # no -0 in a calm


@dataclass(frozen=True, slots=True)
class LogProfile:
    """ln(h/z₀) / ln(h_r/z₀), nothing below z₀; MIL-F-8785C 3.7.3.2 has h_r = 20 ft."""

    height: float  # h_r, m, where the wind has its speed
    roughness: float  # z₀, m, below h_r

    @property
    def numbers(self) -> tuple[int, float, float]:
        """Kind, height, roughness."""
        return LOG, self.height, self.roughness

    def factor(self, height: Array) -> Array:
        """Part (...,) of the speed at heights (...,) m."""
        scale = 1.0 / math.log(self.height / self.roughness)
        part: Array = scale * np.log(np.maximum(height, self.roughness) / self.roughness)
        return part


@dataclass(frozen=True, slots=True)
class PowerProfile:
    """(h/h_r)^a, nothing below the ground."""

    height: float  # h_r, m, where the wind has its speed
    exponent: float  # a

    @property
    def numbers(self) -> tuple[int, float, float]:
        """Kind, height, exponent."""
        return POWER, self.height, self.exponent

    def factor(self, height: Array) -> Array:
        """Part (...,) of the speed at heights (...,) m."""
        part: Array = (np.maximum(height, 0.0) / self.height) ** self.exponent
        return part


Profile = LogProfile | PowerProfile


@dataclass(frozen=True, slots=True)
class MeanWind:
    """A wind in M rows, linear between them; the profile scales its horizontal part."""

    time: Array  # (M,) s, increasing from 0; one row is a steady wind
    velocity: Array  # (M, 3) m/s NED, at the profile's height
    slope: Array  # (max(M - 1, 1), 3) m/s² from each row to the next
    path: Array  # (M, 3) m NED, of the air at the carrying height since time 0
    carried: Array  # (3,) part of `velocity` with which the air moves at the carrying height
    profile: Profile | None  # none: the same at all heights

    @property
    def steady(self) -> bool:
        """True if it is the same at all times."""
        return len(self.time) == 1

    @property
    def uniform(self) -> bool:
        """True if it is the same at all heights."""
        return self.profile is None

    @property
    def numbers(self) -> tuple[int, float, float]:
        """Of the profile."""
        return (EVEN, 0.0, 0.0) if self.profile is None else self.profile.numbers

    def velocity_ned(self, time: float, height: Array) -> Array:
        """Velocity (..., 3) m/s at one time, s, and heights (...,) m."""
        row = self._row(time)
        out = np.empty((*np.shape(height), 3))
        out[...] = self.velocity[row] + (time - self.time[row]) * self.slope[row]
        if self.profile is not None:
            out[..., :2] *= np.expand_dims(self.profile.factor(height), -1)
        return out

    def displacement_ned(self, time: float) -> Array:
        """Path (3,) m of the air at the carrying height from time 0 to this one, s."""
        if self.steady:
            blown: Array = time * (self.carried * self.velocity[0])
            return blown
        row = self._row(time)
        since = time - self.time[row]
        mean = self.velocity[row] + 0.5 * since * self.slope[row]
        moved: Array = self.path[row] + since * self.carried * mean
        return moved

    def _row(self, time: float) -> int:
        """The row whose slope leads on to this time."""
        if self.steady:
            return 0
        return int(self.time[1:-1].searchsorted(time))


def make_mean_wind(
    time: Array, velocity: Array, *, profile: Profile | None = None, carrying_height: float = 0.0
) -> MeanWind:
    """A wind from its rows.

    Args:
        time: (M,) s, increasing from 0; (1,) for a steady wind.
        velocity: (M, 3) m/s NED, at the profile's height.
        profile: over height; none is the same at all heights.
        carrying_height: m, at which the air carries a frozen field and the fronts of gusts.
    """
    carried = np.ones(3)
    if profile is not None:
        carried[:2] = profile.factor(np.array(carrying_height))
    steady = len(time) == 1
    width = np.diff(time)[:, np.newaxis]
    path = np.zeros_like(velocity)
    path[1:] = carried * np.cumsum(width * 0.5 * (velocity[1:] + velocity[:-1]), axis=0)
    return MeanWind(
        time=time,
        velocity=velocity,
        slope=np.zeros((1, 3)) if steady else np.diff(velocity, axis=0) / width,
        path=path,
        carried=carried,
        profile=profile,
    )
