"""The two packets of ArduPlane's JSON physics link: pulses to the servos in, the motion out.

ArduPlane sends pulses and waits for a line of JSON with the motion a time step later. It finds each
key by the first place in the line that spells it, so that a key must stand before those that begin
with the same letters, and numbers must follow their colon without a blank.
https://github.com/ArduPilot/ardupilot/tree/master/libraries/SITL/examples/JSON
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY, rotation_ned_body
from testbed.state import Array, VehicleState

MAGIC: dict[int, int] = {18458: 16, 29569: 32}  # magic: outputs; 32 with SERVO_32_ENABLE
MOST_CHANNELS = 12  # of a receiver, in the line of JSON
_HEAD = struct.Struct("<HHI")
_GRAVITY_NED = np.array([0.0, 0.0, GRAVITY])
_MOTION = (
    '\n{"timestamp":%r,"imu":{"gyro":[%r,%r,%r],"accel_body":[%r,%r,%r]},"position":[%r,%r,%r],'
    '"attitude":[%r,%r,%r],"velocity":[%r,%r,%r],"velocity_wind":[%r,%r,%r],"airspeed":%r'
)
# Its drivers may cut off what is behind the point, and single precision may put a whole number just
# below itself.
_ABOVE = 0.25  # µs


class PacketError(InputError):
    """A packet that no ArduPlane sends."""


class ServoPacket(NamedTuple):
    """What ArduPlane sends to the physics."""

    frame_rate_hz: int  # of the time steps it expects
    frame_count: int  # of the packets since its start
    pulses: tuple[int, ...]  # (16 or 32) µs, output 1 first; 0: none


def read_servos(data: bytes) -> ServoPacket:
    """Take a packet of pulses apart.

    Raises:
        PacketError: it is none.
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
    """What accelerometers feel (N, 3) m/s², body axes: R_NB^T (a − g)."""
    felt = state.acceleration_ned - _GRAVITY_NED
    force: Array = np.einsum("nij,ni->nj", rotation_ned_body(state.euler), felt)
    return force


def motion_columns(state: VehicleState, wind_ned: Array, pitot: Array) -> Array:
    """What a line says of the motion of N aircraft (N, 19), in its order.

    Args:
        state: the truth.
        wind_ned: (N, 3) m/s, velocity of the air.
        pitot: (N,) m/s, equivalent airspeed as measured: ArduPlane has its pitot tube feel it.
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


def motion_line(
    time_s: float, columns: Sequence[float], voltage: float, pulses: Sequence[int]
) -> bytes:
    """The line of JSON for one aircraft.

    Args:
        time_s: of the physics; it must grow, whatever happens.
        columns: a row of `motion_columns`.
        voltage: of the battery, V; not a number where there is none. Its current is not modelled
            and is said to be 0 A.
        pulses: of the receiver, µs, channel 1 first, at most MOST_CHANNELS.
    """
    text = _MOTION % (time_s, *columns)
    if voltage == voltage:
        text += f',"battery":{{"voltage":{voltage!r},"current":0.0}}'
    said = (f'"rc_{number}":{pulse + _ABOVE}' for number, pulse in enumerate(pulses, start=1))
    return f'{text},"rc":{{{",".join(said)}}}}}\n'.encode()
