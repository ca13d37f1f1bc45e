"""Packets of ArduPlane's JSON physics link: servo pulses from it, the aircraft's state to it.

ArduPlane sends servo pulses and waits for a line of JSON with the state one time step later. Its
parser finds a key by its first occurrence in the line, so that a key must come before those that
start with the same letters, and numbers must follow their colon without a blank.
https://github.com/ArduPilot/ardupilot/tree/master/libraries/SITL/examples/JSON
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import cos, isnan, sin
from typing import NamedTuple

from testbed.core.compile import entry
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, Indices, Records

MAGIC: dict[int, int] = {18458: 16, 29569: 32}  # magic: outputs; 32 with SERVO_32_ENABLE
MAX_CHANNELS = 12  # RC channels in the line of JSON
_HEAD = struct.Struct("<HHI")
# Nanometres and nanoradians: finer than ArduPlane's single precision, and a third of the time of
# the shortest exact text.
_MOTION = (
    '\n{"timestamp":%.9f,"imu":{"gyro":[%.9f,%.9f,%.9f],"accel_body":[%.9f,%.9f,%.9f]},'
    '"position":[%.9f,%.9f,%.9f],"attitude":[%.9f,%.9f,%.9f],"velocity":[%.9f,%.9f,%.9f]'
)
MOTION_NUMBERS = 15  # of `pack_motion`
# Added to pulses, because ArduPlane's drivers may truncate them, and single precision may be just
# below a whole number.
_RC_OFFSET_US = 0.25


class PacketError(InputError):
    """A packet that is not from ArduPlane's JSON link."""


class ServoPacket(NamedTuple):
    """A packet from ArduPlane to the physics."""

    sample_rate_hz: int  # expected time steps per second
    frame_count: int  # packets since its start
    pulses: tuple[int, ...]  # (16 or 32) µs, output 1 first; 0: none


def read_servos(data: bytes) -> ServoPacket:
    """Parse a packet of servo pulses.

    Raises:
        PacketError: it is not from ArduPlane's JSON link.
    """
    if len(data) < _HEAD.size:
        raise PacketError(f"{len(data)} bytes are not a packet of ArduPlane's JSON link")
    magic, rate, count = _HEAD.unpack_from(data)
    outputs = MAGIC.get(magic)
    if outputs is None:
        known = " or ".join(map(str, MAGIC))
        raise PacketError(f"magic {magic}, where ArduPlane's JSON link has {known}")
    if len(data) != _HEAD.size + 2 * outputs:
        raise PacketError(
            f"{len(data)} bytes with magic {magic}, where ArduPlane's JSON link has "
            f"{_HEAD.size + 2 * outputs}"
        )
    return ServoPacket(rate, count, struct.unpack_from(f"<{outputs}H", data, _HEAD.size))


@entry
def pack_motion(which: Indices, rows: Indices, aircraft: Records, numbers: Array) -> None:
    """Write the motion of some aircraft in the order of a line of JSON.

    The specific force of accelerometers is R_NB^T (a − g), by three plane rotations.

    Args:
        which: (K,) rows of `numbers`.
        rows: (M,) of these among the aircraft.
        aircraft: (N,) of AIRCRAFT.
        numbers: (M, 15) rates rad/s, specific force m/s², position m, attitude rad, velocity m/s.
    """
    for k in which:
        t, x = aircraft[rows[k]].truth, numbers[k]
        phi, theta, psi = t.euler[0], t.euler[1], t.euler[2]
        north, east = t.acceleration_ned[0], t.acceleration_ned[1]
        down = t.acceleration_ned[2] - GRAVITY
        ahead, y = cos(psi) * north + sin(psi) * east, cos(psi) * east - sin(psi) * north
        below = sin(theta) * ahead + cos(theta) * down
        x[3] = cos(theta) * ahead - sin(theta) * down
        x[4] = cos(phi) * y + sin(phi) * below
        x[5] = cos(phi) * below - sin(phi) * y
        for axis in range(3):
            x[axis], x[6 + axis] = t.rates_body[axis], t.position_ned[axis]
            x[9 + axis], x[12 + axis] = t.euler[axis], t.velocity_ned[axis]


def motion_text(time_s: float, numbers: Sequence[float]) -> str:
    """Format the first part of the line of JSON for one aircraft, which changes at every tick.

    Args:
        time_s: of the physics; must increase from line to line.
        numbers: a row of `pack_motion`.
    """
    return _MOTION % (time_s, *numbers)


def inputs_text(
    wind_ned: Sequence[float], pitot: float, voltage: float, pulses: Sequence[int]
) -> str:
    """Format the rest of the line of JSON for one aircraft.

    Args:
        wind_ned: (3,) m/s, velocity of the air.
        pitot: m/s, measured equivalent airspeed, for ArduPlane's simulated pitot tube.
        voltage: of the battery, V; NaN where there is none. Its current is not modelled: 0 A.
        pulses: of the RC channels, µs, channel 1 first, at most MAX_CHANNELS.
    """
    text = ',"velocity_wind":[%.9f,%.9f,%.9f],"airspeed":%.9f' % (*wind_ned, pitot)
    if not isnan(voltage):
        text += f',"battery":{{"voltage":{voltage:.9f},"current":0.0}}'
    rc = (f'"rc_{number}":{pulse + _RC_OFFSET_US}' for number, pulse in enumerate(pulses, start=1))
    return f'{text},"rc":{{{",".join(rc)}}}}}\n'
