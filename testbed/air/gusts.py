"""Discrete gusts: everywhere at a time, or behind a front at a place; several add up.

Each is the 1 - cos of MIL-F-8785C 3.7.1.3 in a depth x that is a time or a distance,

    0 for x <= 0,   (A/2) (1 - cos(π x/d)) for 0 <= x <= d,   A beyond,

which here is called a ramp; a pulse follows the cosine on to 0 at 2 d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.air.mean import MeanWind
from testbed.state import Array, Truths

Vector = tuple[float, float, float]


class TimedGust(NamedTuple):
    """A gust that begins everywhere at once."""

    velocity_ned: Vector  # A, m/s
    start: float  # s
    ramp: float  # d, s
    pulse: bool


class PlacedGust(NamedTuple):
    """A gust behind a plane upright front."""

    velocity_ned: Vector  # A, m/s
    place: tuple[float, float]  # north, east, m: a point of the front at its start
    towards: float  # rad clockwise from north, where the front faces and moves to
    start: float  # s
    length: float  # d, m
    speed: float | None  # m/s over the ground; none: the mean wind carries it
    pulse: bool


@dataclass(frozen=True, slots=True)
class Gusts:
    """G gusts; x = rate · time + offset + carried · displacement − normal · point."""

    velocity: Array  # (G, 3) A, m/s NED
    rate: Array  # (G,) of x with time: 1, or the front's speed in m/s
    offset: Array  # (G,) s or m
    carried: Array  # (G, 3) unit vectors along which the mean wind carries fronts, or zero
    normal: Array  # (G, 3) unit vectors out of fronts, or zero
    rise: Array  # (G,) d, s or m
    end: Array  # (G,) the x/d at which nothing changes any more: 1, or 2 of a pulse

    def velocity_ned(self, time: float, points: Array, displacement: Array) -> Array:
        """What they add to the wind (..., 3) m/s.

        Args:
            time: s.
            points: (..., 3) m NED.
            displacement: (3,) m NED, path of the mean wind since time 0.
        """
        depth = np.clip(self._depth(time, points, displacement), 0.0, self.end)
        velocity: Array = (0.5 - 0.5 * np.cos(np.pi * depth)) @ self.velocity
        return velocity

    def inside(self, time: float, position_ned: Array, displacement: Array) -> Truths:
        """Which of N aircraft (N, 3) m feel which gust (G, N); a ramp has no end."""
        depth = self._depth(time, position_ned, displacement)
        felt: Truths = (depth > 0.0) & ((depth < 2.0) | (self.end == 1.0))
        return felt.T

    def _depth(self, time: float, points: Array, displacement: Array) -> Array:
        """x/d (..., G)."""
        front = self.rate * time + self.offset + self.carried @ displacement
        depth: Array = (front - points @ self.normal.T) / self.rise
        return depth


def make_gusts(gusts: Sequence[TimedGust | PlacedGust], wind: MeanWind) -> Gusts:
    """The gusts, with the mean wind that carries the fronts without a speed of their own."""
    count = len(gusts)
    rate, offset = np.zeros(count), np.zeros(count)
    carried, normal = np.zeros((count, 3)), np.zeros((count, 3))
    for g, gust in enumerate(gusts):
        if isinstance(gust, TimedGust):
            rate[g], offset[g] = 1.0, -gust.start
            continue
        normal[g, :2] = np.cos(gust.towards), np.sin(gust.towards)
        offset[g] = normal[g, :2] @ np.array(gust.place)
        if gust.speed is None:
            carried[g] = normal[g]
            offset[g] -= normal[g] @ wind.displacement_ned(gust.start)
        else:
            rate[g] = gust.speed
            offset[g] -= gust.speed * gust.start
    return Gusts(
        velocity=np.array([gust.velocity_ned for gust in gusts]).reshape(count, 3),
        rate=rate,
        offset=offset,
        carried=carried,
        normal=normal,
        rise=np.array(
            [gust.ramp if isinstance(gust, TimedGust) else gust.length for gust in gusts]
        ),
        end=np.array([2.0 if gust.pulse else 1.0 for gust in gusts]),
    )
