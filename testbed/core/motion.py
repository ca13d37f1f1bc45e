"""Kernels on the motion of one aircraft: rotation matrices and copies."""

from __future__ import annotations

from math import cos, sin

from testbed.core.compile import kernel
from testbed.core.records import Record, Values, Vector


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
