"""Pulses: from sticks to a receiver's channels, and from servo outputs to surfaces.

In fly-by-wire A ArduPlane takes roll and pitch as parts of their limits, and throttle as a part of
its channel's range; dead zones (RCn_DZ) play no part there. Surfaces have 1000 µs of whole travel,
as the virtual autopilot has it; at SERVOn_TRIM a linkage is neutral.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from testbed.ardupilot.packets import MOST_CHANNELS
from testbed.errors import InputError

MAPS = tuple(f"RCMAP_{stick}" for stick in ("ROLL", "PITCH", "THROTTLE", "YAW"))
LIMITS = ("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG", "MIXING_GAIN")
_OUTPUTS = range(1, 17)
FUNCTIONS = tuple(f"SERVO{number}_FUNCTION" for number in _OUTPUTS)
_RANGE = ("MIN", "TRIM", "MAX", "REVERSED")
AILERON, ELEVATOR, RUDDER, THROTTLE = 4, 19, 21, 70
ELEVON_LEFT, ELEVON_RIGHT, VTAIL_LEFT, VTAIL_RIGHT = 77, 78, 79, 80
_USED = {AILERON, ELEVATOR, RUDDER, THROTTLE, ELEVON_LEFT, ELEVON_RIGHT, VTAIL_LEFT, VTAIL_RIGHT}
_HALF_TRAVEL = 500.0  # µs from neutral to a full deflection

Parameters = Mapping[str, float]


class ChannelError(InputError):
    """Parameters of ArduPlane's with which this aircraft cannot be flown."""


@dataclass(frozen=True, slots=True)
class Channel:
    """The range of a channel or output, µs."""

    number: int
    least: float
    trim: float
    most: float
    reversed: bool

    def stick(self, part: float) -> int:
        """The pulse that ArduPlane reads as this part, -1..1, of what is on each side of trim."""
        part = -part if self.reversed else part
        side = self.most - self.trim if part > 0.0 else self.trim - self.least
        return round(self.trim + max(-1.0, min(part, 1.0)) * side)

    def lever(self, part: float) -> int:
        """The pulse that it reads as this part, 0..1, of the whole range."""
        part = max(0.0, min(part, 1.0))
        return round(self.least + (1.0 - part if self.reversed else part) * self.travel)

    def opened(self, pulse: int) -> float:
        """The part 0..1 of the whole range that is meant by a pulse; none is 0."""
        if pulse == 0:
            return 0.0
        part = max(0.0, min((pulse - self.least) / self.travel, 1.0))
        return 1.0 - part if self.reversed else part

    def deflection(self, pulse: int) -> float:
        """How far a servo turns, as a part of a surface's travel; without pulses not at all."""
        turned = (pulse - self.trim) / _HALF_TRAVEL if pulse else 0.0
        return -turned if self.reversed else turned

    @property
    def travel(self) -> float:
        """From end to end, µs."""
        return self.most - self.least


class Sticks(NamedTuple):
    """How fly-by-wire A is told what to do."""

    roll: Channel
    pitch: Channel
    throttle: Channel
    yaw: Channel
    roll_limit: float  # rad
    pitch_up: float  # rad
    pitch_down: float  # rad, positive

    def pulses(self, roll: float, pitch: float, throttle: float) -> tuple[int, ...]:
        """Pulses of channels 1 to the last one mapped, µs; roll, pitch in rad, throttle 0..1."""
        limit = self.pitch_up if pitch > 0.0 else self.pitch_down
        told = {
            self.roll.number: self.roll.stick(roll / self.roll_limit),
            self.pitch.number: self.pitch.stick(pitch / limit if limit > 0.0 else 0.0),
            self.throttle.number: self.throttle.lever(throttle),
            self.yaw.number: self.yaw.stick(0.0),
        }
        return tuple(told.get(number, 1500) for number in range(1, max(told) + 1))


class Outputs(NamedTuple):
    """What moves when ArduPlane sends pulses; an output is there or None."""

    by_function: Mapping[int, Channel]  # SERVOn_FUNCTION: the first output that has it
    elevon_mixing: float  # of the airframe: part of an elevon's travel that full elevator takes
    tail_mixing: float  # MIXING_GAIN

    def surfaces(self, pulses: Sequence[int]) -> tuple[float, float, float, float]:
        """Aileron, elevator, rudder and throttle as in `state.Surfaces`."""

        def turned(function: int) -> float:
            channel = self.by_function.get(function)
            return channel.deflection(pulses[channel.number - 1]) if channel else 0.0

        aileron, elevator, rudder = turned(AILERON), turned(ELEVATOR), turned(RUDDER)
        if ELEVON_LEFT in self.by_function:
            left, right = turned(ELEVON_LEFT), turned(ELEVON_RIGHT)
            aileron = (right - left) / (2.0 * self.elevon_mixing)
            elevator = (right + left) / (2.0 * self.elevon_mixing)
        if VTAIL_LEFT in self.by_function:
            left, right = turned(VTAIL_LEFT), turned(VTAIL_RIGHT)
            rudder = (left - right) / (2.0 * self.tail_mixing)
            elevator = (left + right) / (2.0 * self.tail_mixing)
        motor = self.by_function[THROTTLE]
        return (
            max(-1.0, min(aileron, 1.0)),
            max(-1.0, min(elevator, 1.0)),
            max(-1.0, min(rudder, 1.0)),
            motor.opened(pulses[motor.number - 1]),
        )


def ranges_needed(known: Parameters) -> tuple[str, ...]:
    """The parameters of ranges, once MAPS and FUNCTIONS are known."""
    channels = [f"RC{int(known[name])}" for name in MAPS]
    outputs = [f"SERVO{number}" for number in _OUTPUTS if _function(known, number) in _USED]
    return tuple(f"{each}_{end}" for each in (*channels, *outputs) for end in _RANGE)


def make_sticks(known: Parameters) -> Sticks:
    """The sticks of an ArduPlane with these parameters.

    Raises:
        ChannelError: fly-by-wire A cannot be told through them.
    """
    numbers = [int(known[name]) for name in MAPS]
    if len(set(numbers)) < len(numbers) or not all(1 <= n <= MOST_CHANNELS for n in numbers):
        raise ChannelError(
            f"{', '.join(MAPS)} are {', '.join(map(str, numbers))}; write four different channels "
            f"of 1 to {MOST_CHANNELS}"
        )
    roll, pitch, throttle, yaw = (_channel(known, f"RC{number}", number) for number in numbers)
    limit = known["ROLL_LIMIT_DEG"]
    if not limit > 0.0:
        raise ChannelError(f"ROLL_LIMIT_DEG is {limit:g}; write a limit above 0")
    return Sticks(
        roll,
        pitch,
        throttle,
        yaw,
        roll_limit=math.radians(limit),
        pitch_up=math.radians(known["PTCH_LIM_MAX_DEG"]),
        pitch_down=-math.radians(known["PTCH_LIM_MIN_DEG"]),
    )


def make_outputs(known: Parameters, elevon_mixing: float) -> Outputs:
    """The outputs of an ArduPlane with these parameters.

    Args:
        known: FUNCTIONS, LIMITS and `ranges_needed`.
        elevon_mixing: of the airframe; not a number where it has none.

    Raises:
        ChannelError: something that is needed to fly moves with none of them.
    """
    found: dict[int, Channel] = {}
    for number in _OUTPUTS:
        function = _function(known, number)
        if function in _USED and function not in found:
            found[function] = _channel(known, f"SERVO{number}", number)
    pairs = ((ELEVON_LEFT, ELEVON_RIGHT), (VTAIL_LEFT, VTAIL_RIGHT))
    for left, right in pairs:
        if (left in found) != (right in found):
            raise ChannelError(
                f"a SERVOn_FUNCTION is {left if left in found else right} and none is its pair; "
                f"write {left} for one output and {right} for another"
            )
    gain = known["MIXING_GAIN"]
    mixed = found.keys() & {ELEVON_LEFT, VTAIL_LEFT}
    if mixed and not gain > 0.0:
        raise ChannelError(f"MIXING_GAIN is {gain:g}; write a gain above 0")
    for what, ways in (
        ("aileron", (AILERON, ELEVON_LEFT)),
        ("elevator", (ELEVATOR, ELEVON_LEFT, VTAIL_LEFT)),
        ("throttle", (THROTTLE,)),
    ):
        if not found.keys() & set(ways):
            raise ChannelError(f"no output moves the {what}; write SERVOn_FUNCTION {ways[0]}")
    mixing = elevon_mixing if elevon_mixing == elevon_mixing else gain
    return Outputs(found, mixing, gain)


def _function(known: Parameters, number: int) -> int:
    return int(known[f"SERVO{number}_FUNCTION"])


def _channel(known: Parameters, name: str, number: int) -> Channel:
    least, trim, most, turned = (known[f"{name}_{end}"] for end in _RANGE)
    if not least < most:
        raise ChannelError(f"{name}_MIN is {least:g} and {name}_MAX {most:g}; write a range")
    return Channel(number, least, min(max(trim, least), most), most, bool(turned))
