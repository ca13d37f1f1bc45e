"""Discrete gusts, everywhere at a time or behind a moving front.

Each is the 1 - cos of MIL-F-8785C 3.7.1.3 in a depth x that is a time or a distance,

    0 for x <= 0,   (A/2) (1 - cos(π x/d)) for 0 <= x <= d,   A beyond,

which here is called a ramp; a pulse follows the cosine back to 0 at 2 d.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi
from typing import NamedTuple

import numpy as np

from testbed.atmosphere.mean_wind import MeanWind, write_displacement
from testbed.core.compile import entry, kernel
from testbed.core.records import Array, BoolArray, Record, Records, Vector, allocate

# One gust: x = rate · time + offset + advection · displacement − normal · point.
GUST = np.dtype(
    [
        ("velocity", "f8", 3),  # A, m/s NED
        ("rate", "f8"),  # of x with time: 1, or the front's speed in m/s
        ("offset", "f8"),  # s or m
        ("advection", "f8", 3),  # unit vector along which the mean wind moves the front, or zero
        ("normal", "f8", 3),  # unit vector out of the front, or zero
        ("rise", "f8"),  # d, s or m
        ("end", "f8"),  # the x/d from which on nothing changes: 1, or 2 of a pulse
    ],
    align=True,
)


class UniformGust(NamedTuple):
    """A gust that begins everywhere at once."""

    velocity_ned: tuple[float, float, float]  # A, m/s
    start: float  # s
    ramp: float  # d, s
    pulse: bool


class PlaneFrontGust(NamedTuple):
    """A gust behind a plane, vertical front."""

    velocity_ned: tuple[float, float, float]  # A, m/s
    point: tuple[float, float]  # north, east, m: a point of the front at its start
    direction: float  # rad clockwise from north, where the front faces and moves to
    start: float  # s
    length: float  # d, m
    speed: float | None  # m/s over the ground; None: the mean wind moves it
    pulse: bool


def make_gusts(gusts: Sequence[UniformGust | PlaneFrontGust], wind: MeanWind) -> Records:
    """Return the gusts (G,) of GUST.

    The mean wind moves fronts without a speed of their own.
    """
    records = allocate(GUST, len(gusts))
    for g, gust in enumerate(gusts):
        records["velocity"][g] = gust.velocity_ned
        records["end"][g] = 2.0 if gust.pulse else 1.0
        if isinstance(gust, UniformGust):
            records["rate"][g], records["offset"][g] = 1.0, -gust.start
            records["rise"][g] = gust.ramp
            continue
        normal = np.zeros(3)
        normal[:2] = np.cos(gust.direction), np.sin(gust.direction)
        offset = normal[:2] @ np.array(gust.point)
        if gust.speed is None:
            records["advection"][g] = normal
            offset -= normal @ wind.displacement_ned(gust.start)
        else:
            records["rate"][g] = gust.speed
            offset -= gust.speed * gust.start
        records["normal"][g], records["offset"][g] = normal, offset
        records["rise"][g] = gust.length
    return records


@kernel
def gust_depth(gust: Record, time: float, displacement: Array, point: Vector) -> float:
    """Return x/d of a gust.

    Args:
        gust: record of GUST.
        time: s.
        displacement: (3,) m NED, path of the mean wind since time 0.
        point: (3,) m NED.
    """
    front = gust.rate * time + gust.offset
    for axis in range(3):
        front += gust.advection[axis] * displacement[axis]
    along = 0.0
    for axis in range(3):
        along += point[axis] * gust.normal[axis]
    return float((front - along) / gust.rise)


@kernel
def gust_factor(gust: Record, time: float, displacement: Array, point: Vector) -> float:
    """Return the part of a gust's velocity at a time and a point.

    Arguments are those of `gust_depth`.
    """
    depth = min(max(gust_depth(gust, time, displacement, point), 0.0), gust.end)
    return 0.5 - 0.5 * cos(pi * depth)


@entry
def write_active_gusts(
    gusts: Records, rows: Records, profile: Records, aircraft: Records, time: float, out: BoolArray
) -> None:
    """Write which gusts reach which aircraft; a ramp has no end.

    Args:
        gusts: (G,) of GUST.
        rows: (M,) of WIND_ROW.
        profile: (1,) of PROFILE.
        aircraft: (N,) of AIRCRAFT.
        time: s.
        out: (G, N); written.
    """
    displacement = np.empty(3)
    write_displacement(rows, profile[0], time, displacement)
    for g in range(len(gusts)):
        for i in range(len(aircraft)):
            depth = gust_depth(gusts[g], time, displacement, aircraft[i].truth.position_ned)
            out[g, i] = depth > 0.0 and (depth < 2.0 or gusts[g].end == 1.0)
