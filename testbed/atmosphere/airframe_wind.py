"""The ambient wind over each airframe: mean wind, turbulence field and gusts, all but wakes.

It is sampled at five points of an airframe: three along the wing, one ahead of and one behind the
centre of gravity. On the wing they are the nodes of the Gauss-Chebyshev rule of the second kind,
whose weight √(1 − η²) is the loading of an elliptic wing: by the reverse-flow theorem lift and
rolling moment of such a wing are those of the wind averaged with that loading, and with it times
η.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.atmosphere.gusts import gust_factor
from testbed.atmosphere.mean_wind import UNIFORM, profile_factor, reference_wind, write_displacement
from testbed.atmosphere.turbulence_field import Coefficients, sample_field
from testbed.core.compile import entry, kernel
from testbed.core.frames import rotation_rows
from testbed.core.records import Airframe, Array, Records, Values, Vector, allocate

_ANGLES = np.pi * np.array([3.0, 2.0, 1.0]) / 4.0
WING = np.cos(_ANGLES)  # η, left to right
_LOADS = np.sin(_ANGLES) ** 2
MEAN = _LOADS / _LOADS.sum()  # weights of the average over the wing
SLOPE = _LOADS * WING / (_LOADS * WING**2).sum()  # weights of the slope along η
RIGHT, AHEAD, BEHIND = 2, 3, 4  # the right point on the wing, and the two off it
POINTS = 5

# The wind about one aircraft: where it is sampled, and its parts that other models need.
LOCAL_WIND = np.dtype(
    [
        ("sample_points", "f8", (POINTS, 3)),  # m from the centre of gravity, along body axes
        ("mean_wind", "f8", 3),  # m/s NED, at the centre of gravity
        ("ambient_wind", "f8", 3),  # m/s NED, mean wind and gusts, averaged over the wing
    ],
    align=True,
)


def make_local_wind(airframes: Sequence[Airframe]) -> Records:
    """Return the records (N,) of LOCAL_WIND of N airframes."""
    records = allocate(LOCAL_WIND, len(airframes))
    for points, airframe in zip(records["sample_points"], airframes, strict=True):
        points[: len(WING), 1] = 0.5 * airframe.span * WING
        points[AHEAD, 0], points[BEHIND, 0] = airframe.arm, -airframe.arm
    return records


@entry
def sample_ambient_wind(
    rows: Records,
    profile: Records,
    gusts: Records,
    values: Coefficients,
    levels: Records,
    local: Records,
    aircraft: Records,
    time: float,
) -> None:
    """Sample mean wind, turbulence field and gusts over each airframe.

    Args:
        rows: (M,) of WIND_ROW, the mean wind, which moves field and gusts.
        profile: (1,) of PROFILE.
        gusts: (G,) of GUST; may be empty.
        values: of `turbulence_field.FieldGrid`.
        levels: (L,) of GRID_LEVEL; empty without a field.
        local: (N,) of LOCAL_WIND; mean_wind and ambient_wind are written.
        aircraft: (N,) of AIRCRAFT; truth is read, wind_ned and wind_gradient_rates are written.
        time: s.
    """
    displacement, average, rates = np.empty(3), np.empty(3), np.empty(3)
    position, points, air = np.empty(3), np.empty((POINTS, 3)), np.empty((POINTS, 3))
    north, east, down = reference_wind(rows, time)
    write_displacement(rows, profile[0], time, displacement)
    varies = len(gusts) > 0 or profile[0].kind != UNIFORM
    for i in range(len(aircraft)):
        motion, wind = aircraft[i].truth, aircraft[i].wind
        body, mean = local[i].sample_points, local[i].mean_wind
        factor = profile_factor(profile[0], -motion.position_ned[2])
        mean[0], mean[1], mean[2] = north * factor, east * factor, down
        for axis in range(3):
            local[i].ambient_wind[axis] = wind.wind_ned[axis] = mean[axis]
            wind.wind_gradient_rates[axis] = 0.0
        if not (varies or len(levels)):
            continue
        rotation = rotation_rows(motion.euler)
        if len(levels):
            for axis in range(3):
                position[axis] = motion.position_ned[axis] - displacement[axis]
            write_sample_points(position, rotation, body, points)
            sample_field(values, levels, position, points, air)
            mean_and_gradient(air, rotation, body, average, rates)
            for axis in range(3):
                wind.wind_ned[axis] += average[axis]
                wind.wind_gradient_rates[axis] += rates[axis]
        if varies:
            write_sample_points(motion.position_ned, rotation, body, points)
            for k in range(POINTS):
                factor = profile_factor(profile[0], -points[k, 2])
                air[k, 0] = north * factor - mean[0]
                air[k, 1] = east * factor - mean[1]
                air[k, 2] = down - mean[2]
                for g in range(len(gusts)):
                    part = gust_factor(gusts[g], time, displacement, points[k])
                    for axis in range(3):
                        air[k, axis] += part * gusts[g].velocity[axis]
            mean_and_gradient(air, rotation, body, average, rates)
            for axis in range(3):
                local[i].ambient_wind[axis] += average[axis]
                wind.wind_ned[axis] += average[axis]
                wind.wind_gradient_rates[axis] += rates[axis]


@kernel
def write_sample_points(position: Vector, rotation: Values, body: Array, points: Array) -> None:
    """Write the sample points (5, 3) m NED of an airframe.

    Args:
        position: (3,) m NED.
        rotation: R_NB.
        body: (5, 3) m from the centre of gravity, along body axes.
        points: (5, 3); written.
    """
    for k in range(POINTS):
        x, y, z = body[k, 0], body[k, 1], body[k, 2]
        for axis in range(3):
            row = rotation[axis]
            points[k, axis] = position[axis] + row[0] * x + row[1] * y + row[2] * z


@kernel
def mean_and_gradient(
    air: Array, rotation: Values, body: Array, average: Array, rates: Array
) -> None:
    """Write the average of the wind over the wing, and its gradients as angular rates.

    The rates are those of air that rotates as a rigid body: p = ∂w/∂y along the wing, q = −∂w/∂x
    and r = ∂v/∂x from ahead to behind.

    Args:
        air: (5, 3) m/s NED, velocity of the air at the sample points.
        rotation: R_NB.
        body: (5, 3) m, the sample points along body axes.
        average: (3,) m/s NED; written.
        rates: (3,) rad/s, about body axes; written.
    """
    length = body[AHEAD, 0] - body[BEHIND, 0]
    p = q = r = 0.0
    for axis in range(3):
        mean = slope = 0.0
        for k in range(AHEAD):
            mean += MEAN[k] * air[k, axis]
            slope += SLOPE[k] * air[k, axis]
        slope = slope / body[RIGHT, 1] * WING[RIGHT]
        along = (air[AHEAD, axis] - air[BEHIND, axis]) / length
        p += slope * rotation[axis][2]
        q -= along * rotation[axis][2]
        r += along * rotation[axis][1]
        average[axis] = mean
    rates[0], rates[1], rates[2] = p, q, r
