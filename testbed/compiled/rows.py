"""What is read from rows of states, and written to them, for all compiled aircraft alike."""

from __future__ import annotations

from math import nan

from testbed.compiled.columns import START
from testbed.compiled.frame import (
    difference,
    earth_fixed,
    earth_rates,
    earth_velocity,
    equivalent_airspeed,
    euler_angles,
    geodetic,
    local_axes,
    matrix_of,
    multiply_transposed,
    quaternion_of,
    rotate,
    rotate_back,
)
from testbed.core.compile import entry
from testbed.core.records import Array, Indices

_POSITION, _VELOCITY, _ATTITUDE = START["position"], START["velocity"], START["attitude"]
_RATES, _EARTH_ANGLE, _UVW_DOT = START["rates"], START["earth_angle"], START["uvw_dot"]
_VT, _QBAR = START["vt"], START["qbar"]


@entry
def write_motion(state: Array, which: Indices, numbers: Array) -> None:
    """Write the values of MOTION_PROPERTIES, in JSBSim's units.

    Args:
        state: (M, S) rows.
        which: (K,) of the M rows.
        numbers: (M, 17), written.
    """
    for i in which:
        s, out = state[i], numbers[i]
        position = s[_POSITION], s[_POSITION + 1], s[_POSITION + 2]
        velocity = s[_VELOCITY], s[_VELOCITY + 1], s[_VELOCITY + 2]
        attitude = s[_ATTITUDE], s[_ATTITUDE + 1], s[_ATTITUDE + 2], s[_ATTITUDE + 3]
        angle = s[_EARTH_ANGLE]
        place = earth_fixed(angle, position)
        out[0], out[1], out[2] = geodetic(place)
        t_bi = matrix_of(attitude)
        t_bl = multiply_transposed(t_bi, local_axes(angle, place))
        uvw = rotate(t_bi, earth_velocity(position, velocity))
        out[3], out[4], out[5] = rotate_back(t_bl, uvw)
        for axis in range(3):
            out[6 + axis] = s[_UVW_DOT + axis]
        out[9], out[10], out[11] = euler_angles(t_bl)
        rates = s[_RATES], s[_RATES + 1], s[_RATES + 2]
        out[12], out[13], out[14] = difference(rates, earth_rates(t_bi))
        out[15], out[16] = s[_VT], equivalent_airspeed(s[_QBAR])


@entry
def write_air(state: Array, which: Indices, columns: Indices, numbers: Array) -> None:
    """Write the values of AIR_PROPERTIES and BATTERY_PROPERTIES, in JSBSim's units.

    Args:
        state: (M, S) rows.
        which: (K,) of the M rows.
        columns: (5,) of the properties in the rows; -1: the aircraft has none, NaN is written.
        numbers: (M, 5), written.
    """
    for i in which:
        for k in range(len(columns)):
            numbers[i, k] = state[i, columns[k]] if columns[k] >= 0 else nan


@entry
def write_attitude(state: Array, row: int, euler: Array) -> None:
    """Write the quaternion of the attitude, I to B, of an initial condition.

    Args:
        state: (M, S) rows, whose positions are set.
        row: of the state.
        euler: (4,) quaternion of roll, pitch and yaw, L to B.
    """
    s = state[row]
    position = s[_POSITION], s[_POSITION + 1], s[_POSITION + 2]
    place = earth_fixed(s[_EARTH_ANGLE], position)
    a = quaternion_of(local_axes(s[_EARTH_ANGLE], place))
    s[_ATTITUDE] = a[0] * euler[0] - a[1] * euler[1] - a[2] * euler[2] - a[3] * euler[3]
    s[_ATTITUDE + 1] = a[0] * euler[1] + a[1] * euler[0] + a[2] * euler[3] - a[3] * euler[2]
    s[_ATTITUDE + 2] = a[0] * euler[2] - a[1] * euler[3] + a[2] * euler[0] + a[3] * euler[1]
    s[_ATTITUDE + 3] = a[0] * euler[3] + a[1] * euler[2] - a[2] * euler[1] + a[3] * euler[0]
