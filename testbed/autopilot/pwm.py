"""Pulses of an ArduPlane: to its RC channels, and from its servo outputs.

Control surfaces have a total travel of 1000 µs, as in the virtual autopilot. ArduPlane scales each
side of SERVOn_TRIM by itself; full output on either side is half of SERVOn_MIN to SERVOn_MAX.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from testbed.autopilot.json_physics import MAX_CHANNELS
from testbed.core.errors import InputError
from testbed.mavlink.rc_channels import AngleLimits, PwmRange, RcScaling

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

    def pulses(self, roll: float, pitch: float, throttle: float) -> tuple[int, ...]:
        """Convert a command to the pulses of channels 1 to the last one mapped.

        Args:
            roll: rad.
            pitch: rad.
            throttle: 0..1.

        Returns:
            Whole µs, channel 1 first; unmapped channels are at 1500.
        """
        pulses = (*self.scaling.pulses(roll, pitch, throttle), self.yaw.pwm_from_signed(0.0))
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
    limits = AngleLimits(
        roll=math.radians(limit),
        pitch_max=math.radians(parameters["PTCH_LIM_MAX_DEG"]),
        pitch_min=math.radians(parameters["PTCH_LIM_MIN_DEG"]),
    )
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
