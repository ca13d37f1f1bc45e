"""Copy records inside kernels, field by field: numba copies no record within another one."""

from __future__ import annotations

from testbed.core.compile import kernel
from testbed.core.records import Record


@kernel
def copy_kinematics(source: Record, out: Record) -> None:
    """Copy position, velocity, acceleration and attitude between records that have them."""
    for axis in range(3):
        out.position_ned[axis] = source.position_ned[axis]
        out.velocity_ned[axis] = source.velocity_ned[axis]
        out.acceleration_ned[axis] = source.acceleration_ned[axis]
        out.euler[axis] = source.euler[axis]


@kernel
def copy_motion(source: Record, out: Record) -> None:
    """Copy a record of MOTION to another one."""
    copy_kinematics(source, out)
    for axis in range(3):
        out.rates_body[axis] = source.rates_body[axis]
    out.airspeed, out.equivalent_airspeed = source.airspeed, source.equivalent_airspeed


@kernel
def copy_content(message: Record, out: Record) -> None:
    """Copy the content of a message, without its stamp, between records that have it."""
    copy_kinematics(message, out)
    for axis in range(3):
        out.euler_rates[axis] = message.euler_rates[axis]


@kernel
def copy_command(source: Record, out: Record) -> None:
    """Copy a record of COMMAND to another one."""
    out.pitch, out.roll, out.throttle = source.pitch, source.roll, source.throttle
