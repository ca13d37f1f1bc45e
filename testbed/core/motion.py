"""Kinematics of one aircraft: rotation matrix, attitude rates, copies."""

from __future__ import annotations

from math import cos, sin
from typing import TypeAlias

import numpy as np

from testbed.core.compile import jitable, kernel
from testbed.core.records import Array, Record, Values, Vector

Scalars: TypeAlias = "float | Array"


@kernel
def rotation_ned_body(euler: Vector) -> Values:
    """Return R_NB, row by row, of roll, pitch and yaw, rad."""
    phi, theta, psi = euler[0], euler[1], euler[2]
    cf, sf, ct, st, cp, sp = cos(phi), sin(phi), cos(theta), sin(theta), cos(psi), sin(psi)
    return (
        (ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp),
        (ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp),
        (-st, sf * ct, cf * ct),
    )


@kernel
def copy_motion(source: Record, out: Record) -> None:
    """Copy a record of MOTION to another one."""
    for axis in range(3):
        out.position_ned[axis] = source.position_ned[axis]
        out.velocity_ned[axis] = source.velocity_ned[axis]
        out.acceleration_ned[axis] = source.acceleration_ned[axis]
        out.euler[axis] = source.euler[axis]
        out.rates_body[axis] = source.rates_body[axis]
    out.airspeed, out.equivalent_airspeed = source.airspeed, source.equivalent_airspeed


@jitable
def attitude_rates(
    roll: Scalars, pitch: Scalars, p: Scalars, q: Scalars, r: Scalars
) -> tuple[Scalars, Scalars, Scalars]:
    """Time derivatives of roll, pitch, yaw, rad/s, from body rates; numbers or arrays alike.

    Singular at a pitch of ±90°, where yaw is undefined.
    """
    yaw_rate = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    return p + yaw_rate * np.sin(pitch), q * np.cos(roll) - r * np.sin(roll), yaw_rate


def euler_rates(euler: Array, rates_body: Array) -> Array:
    """Time derivatives of roll, pitch, yaw (..., 3) rad/s from body rates p, q, r (..., 3)."""
    p, q, r = np.moveaxis(rates_body, -1, 0)
    return np.stack(attitude_rates(euler[..., 0], euler[..., 1], p, q, r), axis=-1)
