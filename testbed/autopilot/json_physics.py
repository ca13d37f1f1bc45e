"""Packets of ArduPlane's JSON physics link: servo pulses from it, the aircraft's state to it.

ArduPlane sends servo pulses and waits for a line of JSON with the state one time step later. Its
parser finds a key by its first occurrence in the line, so that a key must come before those that
start with the same letters, and numbers must follow their colon without a blank.
https://github.com/ArduPilot/ardupilot/tree/master/libraries/SITL/examples/JSON
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, rotation_ned_body
from testbed.core.records import Array, VehicleState

MAGIC: dict[int, int] = {18458: 16, 29569: 32}  # magic: outputs; 32 with SERVO_32_ENABLE
MAX_CHANNELS = 12  # RC channels in the line of JSON
_HEAD = struct.Struct("<HHI")
_GRAVITY_NED = np.array([0.0, 0.0, GRAVITY])
_STATE = (
    '\n{"timestamp":%r,"imu":{"gyro":[%r,%r,%r],"accel_body":[%r,%r,%r]},"position":[%r,%r,%r],'
    '"attitude":[%r,%r,%r],"velocity":[%r,%r,%r],"velocity_wind":[%r,%r,%r],"airspeed":%r'
)
# Added to pulses, because ArduPlane's drivers may truncate them, and single precision may be just
# below a whole number.
_RC_OFFSET_US = 0.25


class PacketError(InputError):
    """A packet that is not from ArduPlane's JSON link."""


class ServoPacket(NamedTuple):
    """A packet from ArduPlane to the physics."""

    frame_rate_hz: int  # expected time steps per second
    frame_count: int  # packets since its start
    pulses: tuple[int, ...]  # (16 or 32) µs, output 1 first; 0: none


def read_servos(data: bytes) -> ServoPacket:
    """Parse a packet of servo pulses.

    Raises:
        PacketError: it is not from ArduPlane's JSON link.
    """
    if len(data) < _HEAD.size:
        raise PacketError(f"{len(data)} bytes are no packet of ArduPlane's JSON link")
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


def specific_force(state: VehicleState) -> Array:
    """Compute the specific force of accelerometers, (N, 3) m/s², body axes: R_NB^T (a − g)."""
    specific = state.acceleration_ned - _GRAVITY_NED
    force: Array = np.einsum("nij,ni->nj", rotation_ned_body(state.euler), specific)
    return force


def state_columns(state: VehicleState, wind_ned: Array, pitot: Array) -> Array:
    """Collect the state of N aircraft in the order of a line, (N, 19).

    Args:
        state: the truth.
        wind_ned: (N, 3) m/s, velocity of the air.
        pitot: (N,) m/s, measured equivalent airspeed, for ArduPlane's simulated pitot tube.
    """
    return np.concatenate(
        (
            state.rates_body,
            specific_force(state),
            state.position_ned,
            state.euler,
            state.velocity_ned,
            wind_ned,
            pitot[:, np.newaxis],
        ),
        axis=1,
    )


def state_line(
    time_s: float, columns: Sequence[float], voltage: float, pulses: Sequence[int]
) -> bytes:
    """Format the line of JSON for one aircraft.

    Args:
        time_s: of the physics; must increase from line to line.
        columns: a row of `state_columns`.
        voltage: of the battery, V; NaN where there is none. Its current is not modelled: 0 A.
        pulses: of the RC channels, µs, channel 1 first, at most MAX_CHANNELS.
    """
    text = _STATE % (time_s, *columns)
    if not math.isnan(voltage):
        text += f',"battery":{{"voltage":{voltage!r},"current":0.0}}'
    rc = (f'"rc_{number}":{pulse + _RC_OFFSET_US}' for number, pulse in enumerate(pulses, start=1))
    return f'{text},"rc":{{{",".join(rc)}}}}}\n'.encode()
