"""Stick pulses and what fly-by-wire A makes of them, as ArduPlane has it.

A pulse is a share of its stick's way from RCn_TRIM to RCn_MIN or RCn_MAX; that share of the limit
is the angle: ROLL_LIMIT_DEG to both sides, PTCH_LIM_MAX_DEG up, PTCH_LIM_MIN_DEG down. Throttle
goes from RCn_MIN to RCn_MAX. There is no dead zone in this mode. Pulses are in µs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

ROLL, PITCH, THROTTLE, YAW = 1, 2, 3, 4  # channels, by ArduPlane's RCMAP_ defaults
LEAST_US, TRIM_US, MOST_US = 1000.0, 1500.0, 2000.0  # of every channel unless told otherwise


class Range(NamedTuple):
    """The pulses of one stick, µs."""

    least: float = LEAST_US
    trim: float = TRIM_US
    most: float = MOST_US


class Limits(NamedTuple):
    """Of the angles that sticks ask for, rad; down is negative. Defaults are ArduPlane's."""

    roll: float = math.radians(45.0)
    up: float = math.radians(20.0)
    down: float = math.radians(-25.0)


class Scales(NamedTuple):
    """What pulses mean to one aircraft now."""

    roll: Range
    pitch: Range
    throttle: Range
    limits: Limits


def scales(parameters: Mapping[str, float]) -> Scales:
    """From parameters by ArduPlane's names; its defaults stand for what is not there."""

    def stick(channel: int) -> Range:
        names = (f"RC{channel}_MIN", f"RC{channel}_TRIM", f"RC{channel}_MAX")
        return Range(
            *(parameters.get(name, usual) for name, usual in zip(names, Range(), strict=True))
        )

    names = ("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG")
    limits = Limits(
        *(
            math.radians(parameters[name]) if name in parameters else usual
            for name, usual in zip(names, Limits(), strict=True)
        )
    )
    return Scales(stick(ROLL), stick(PITCH), stick(THROTTLE), limits)


def share(pulse_us: float, stick: Range) -> float:
    """How far a pulse is from its trim, −1..1 of the way to the end."""
    way = stick.most - stick.trim if pulse_us >= stick.trim else stick.trim - stick.least
    return 0.0 if way <= 0.0 else min(max((pulse_us - stick.trim) / way, -1.0), 1.0)


def pulse(part: float, stick: Range) -> float:
    """The pulse that is this share −1..1 of the way: the inverse of `share`."""
    way = stick.most - stick.trim if part >= 0.0 else stick.trim - stick.least
    return stick.trim + min(max(part, -1.0), 1.0) * way


def roll_of(pulse_us: float, scale: Scales) -> float:
    """The bank that a pulse asks for, rad."""
    return share(pulse_us, scale.roll) * scale.limits.roll


def pitch_of(pulse_us: float, scale: Scales) -> float:
    """The pitch that a pulse asks for, rad; a long pulse is nose up."""
    part = share(pulse_us, scale.pitch)
    return part * scale.limits.up if part > 0.0 else -part * scale.limits.down


def throttle_of(pulse_us: float, scale: Scales) -> float:
    """The throttle that a pulse asks for, 0..1."""
    stick = scale.throttle
    way = stick.most - stick.least
    return 0.0 if way <= 0.0 else min(max((pulse_us - stick.least) / way, 0.0), 1.0)


def pulses(roll: float, pitch: float, throttle: float, scale: Scales) -> tuple[float, float, float]:
    """The pulses that ask for a command, µs; what is beyond the limits is at the stick's end."""
    limits = scale.limits
    pitch_limit = limits.up if pitch > 0.0 else -limits.down
    stick = scale.throttle
    return (
        pulse(_part(roll, limits.roll), scale.roll),
        pulse(_part(pitch, pitch_limit), scale.pitch),
        stick.least + min(max(throttle, 0.0), 1.0) * (stick.most - stick.least),
    )


def within(roll: float, pitch: float, limits: Limits) -> tuple[float, float]:
    """Angles no larger than sticks can ask for, rad."""
    return (
        min(max(roll, -limits.roll), limits.roll),
        min(max(pitch, limits.down), limits.up),
    )


def _part(angle: float, limit: float) -> float:
    return angle / limit if limit > 0.0 else 0.0
