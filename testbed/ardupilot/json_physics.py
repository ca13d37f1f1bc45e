"""Packets of ArduPlane's JSON physics link, and their pulses.

ArduPlane sends servo pulses and waits for a line of JSON with the state one time step later. Its
parser finds a key by its first occurrence in the line, so that a key must come before those that
start with the same letters, and numbers must follow their colon without a blank.
https://github.com/ArduPilot/ardupilot/tree/master/libraries/SITL/examples/JSON

Control surfaces have a total travel of 1000 µs, as in the virtual autopilot. ArduPlane scales each
side of SERVOn_TRIM by itself; full output on either side is half of SERVOn_MIN to SERVOn_MAX.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from math import cos, isnan, sin
from typing import NamedTuple

from testbed.core.compile import entry
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, FbwaCommand, Indices, Records
from testbed.mavlink.rc_channels import PwmRange, RcScaling, rc_scaling

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
def pack_motion(rows: Indices, aircraft: Records, numbers: Array, which: Indices) -> None:
    """Write the motion of some aircraft in the order of a line of JSON.

    The specific force of accelerometers is R_NB^T (a − g), by three plane rotations.

    Args:
        rows: (M,) of `numbers` among the aircraft.
        aircraft: (N,) of AIRCRAFT.
        numbers: (M, 15) rates rad/s, specific force m/s², position m, attitude rad, velocity m/s.
        which: (K,) rows of `numbers` to write.
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
    """Format the part of the line of JSON that changes at every tick.

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


RC_MAPS = tuple(f"RCMAP_{stick}" for stick in ("ROLL", "PITCH", "THROTTLE", "YAW"))
LIMITS = ("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG", "MIXING_GAIN")
_OUTPUTS = range(1, 17)
SERVO_FUNCTIONS = tuple(f"SERVO{number}_FUNCTION" for number in _OUTPUTS)
_RANGE = ("MIN", "TRIM", "MAX", "REVERSED")
AILERON, ELEVATOR, RUDDER, THROTTLE = 4, 19, 21, 70
ELEVON_LEFT, ELEVON_RIGHT, VTAIL_LEFT, VTAIL_RIGHT = 77, 78, 79, 80
_USED = {AILERON, ELEVATOR, RUDDER, THROTTLE, ELEVON_LEFT, ELEVON_RIGHT, VTAIL_LEFT, VTAIL_RIGHT}
_TRAVEL_US = 1000.0  # of a surface
_NEUTRAL_US = 1500

Parameters = Mapping[str, float]


class ChannelError(InputError):
    """ArduPlane parameters that this aircraft cannot be flown with."""


class RcChannels(NamedTuple):
    """The RC channels of fly-by-wire A: channel numbers, ranges and limits."""

    numbers: tuple[int, int, int, int]  # channels of roll, pitch, throttle, yaw
    scaling: RcScaling
    yaw: PwmRange

    def pulses(self, command: FbwaCommand[float]) -> tuple[int, ...]:
        """Convert a command to the pulses of channels 1 to the last one mapped.

        Returns:
            Whole µs, channel 1 first; unmapped channels are at 1500.
        """
        pulses = (*self.scaling.pulses(command), self.yaw.pwm_from_signed(0.0))
        by_channel = dict(zip(self.numbers, map(round, pulses), strict=True))
        channels = range(1, max(self.numbers) + 1)
        return tuple(by_channel.get(number, _NEUTRAL_US) for number in channels)


class ServoOutputs(NamedTuple):
    """The servo outputs of an ArduPlane, by function."""

    outputs: Mapping[int, tuple[int, PwmRange]]  # SERVOn_FUNCTION: its first output, and range
    elevon_mixing: float  # of the airframe: share of an elevon's travel for full elevator
    tail_mixing: float  # MIXING_GAIN

    def surfaces(self, pulses: Sequence[int]) -> tuple[float, float, float, float]:
        """Convert pulses, µs, to aileron, elevator, rudder and throttle of `ActuatorCommand`."""

        def deflection(function: int) -> float:
            if function not in self.outputs:
                return 0.0
            number, pwm_range = self.outputs[function]
            return _deflection(pulses[number - 1], pwm_range)

        aileron, elevator, rudder = map(deflection, (AILERON, ELEVATOR, RUDDER))
        if ELEVON_LEFT in self.outputs:
            left, right = deflection(ELEVON_LEFT), deflection(ELEVON_RIGHT)
            aileron = (right - left) / (2.0 * self.elevon_mixing)
            elevator = (right + left) / (2.0 * self.elevon_mixing)
        if VTAIL_LEFT in self.outputs:
            left, right = deflection(VTAIL_LEFT), deflection(VTAIL_RIGHT)
            rudder = (left - right) / (2.0 * self.tail_mixing)
            elevator = (left + right) / (2.0 * self.tail_mixing)
        number, motor = self.outputs[THROTTLE]
        pulse = pulses[number - 1]
        return (
            max(-1.0, min(aileron, 1.0)),
            max(-1.0, min(elevator, 1.0)),
            max(-1.0, min(rudder, 1.0)),
            motor.unsigned_from_pwm(pulse) if pulse else 0.0,
        )


def _deflection(pulse: int, pwm_range: PwmRange) -> float:
    """Convert a pulse to a share of a surface's travel; 0 without pulses."""
    if not pulse:
        return 0.0
    return pwm_range.signed_from_pwm(pulse) * (pwm_range.max - pwm_range.min) / _TRAVEL_US


def range_names(parameters: Parameters) -> tuple[str, ...]:
    """Return the names of the range parameters of all used channels and outputs.

    Args:
        parameters: RC_MAPS and SERVO_FUNCTIONS.
    """
    channels = [f"RC{int(parameters[name])}" for name in RC_MAPS]
    outputs = [f"SERVO{number}" for number in _OUTPUTS if _function(parameters, number) in _USED]
    return tuple(f"{each}_{end}" for each in (*channels, *outputs) for end in _RANGE)


def make_rc_channels(parameters: Parameters) -> RcChannels:
    """Make the RC channels of an ArduPlane.

    Args:
        parameters: RC_MAPS, LIMITS and `range_names`.

    Raises:
        ChannelError: fly-by-wire A cannot be commanded through them.
    """
    roll, pitch, throttle, yaw = numbers = [int(parameters[name]) for name in RC_MAPS]
    if len(set(numbers)) < len(numbers) or not all(1 <= n <= MAX_CHANNELS for n in numbers):
        raise ChannelError(
            f"{', '.join(RC_MAPS)} are {', '.join(map(str, numbers))}; write four different "
            f"channels of 1 to {MAX_CHANNELS}"
        )
    ranges = (_pwm_range(parameters, f"RC{number}") for number in numbers)
    roll_range, pitch_range, throttle_range, yaw_range = ranges
    limit = parameters["ROLL_LIMIT_DEG"]
    if not limit > 0.0:
        raise ChannelError(f"ROLL_LIMIT_DEG is {limit:g}; write a limit above 0")
    limits = rc_scaling(parameters).limits
    scaling = RcScaling(roll_range, pitch_range, throttle_range, limits)
    return RcChannels((roll, pitch, throttle, yaw), scaling, yaw_range)


def make_servo_outputs(parameters: Parameters, elevon_mixing: float) -> ServoOutputs:
    """Make the servo outputs of an ArduPlane.

    Args:
        parameters: SERVO_FUNCTIONS, LIMITS and `range_names`.
        elevon_mixing: of the airframe; NaN where it has none.

    Raises:
        ChannelError: aileron, elevator or throttle has no output, or an output is unusable.
    """
    found: dict[int, tuple[int, PwmRange]] = {}
    for number in _OUTPUTS:
        function = _function(parameters, number)
        if function in _USED and function not in found:
            found[function] = (number, _pwm_range(parameters, f"SERVO{number}"))
    pairs = ((ELEVON_LEFT, ELEVON_RIGHT), (VTAIL_LEFT, VTAIL_RIGHT))
    for left, right in pairs:
        if (left in found) != (right in found):
            raise ChannelError(
                f"a SERVOn_FUNCTION is {left if left in found else right} and none is its pair; "
                f"write {left} for one output and {right} for another"
            )
    gain = parameters["MIXING_GAIN"]
    mixed = found.keys() & {ELEVON_LEFT, VTAIL_LEFT}
    if mixed and not gain > 0.0:
        raise ChannelError(f"MIXING_GAIN is {gain:g}; write a gain above 0")
    for surface, functions in (
        ("aileron", (AILERON, ELEVON_LEFT)),
        ("elevator", (ELEVATOR, ELEVON_LEFT, VTAIL_LEFT)),
        ("throttle", (THROTTLE,)),
    ):
        if not found.keys() & set(functions):
            raise ChannelError(
                f"no output moves the {surface}; write SERVOn_FUNCTION {functions[0]}"
            )
    mixing = gain if math.isnan(elevon_mixing) else elevon_mixing
    return ServoOutputs(found, mixing, gain)


def _function(parameters: Parameters, number: int) -> int:
    return int(parameters[f"SERVO{number}_FUNCTION"])


def _pwm_range(parameters: Parameters, name: str) -> PwmRange:
    low, trim, high, turned = (parameters[f"{name}_{end}"] for end in _RANGE)
    if not low < high:
        raise ChannelError(f"{name}_MIN is {low:g} and {name}_MAX {high:g}; write a range")
    return PwmRange(low, min(max(trim, low), high), high, bool(turned))
