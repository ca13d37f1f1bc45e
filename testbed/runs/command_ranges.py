"""Ranges of the fly-by-wire-A commands that Python gives."""

from __future__ import annotations

import itertools
import math
import numbers
from collections.abc import Iterable, Mapping

from testbed.commands.autopilot_session import MANUAL_ANGLE_LIMIT
from testbed.core.errors import InputError
from testbed.core.records import FbwaCommand
from testbed.scenario.validate import shown_value

_ANGLES = -MANUAL_ANGLE_LIMIT, MANUAL_ANGLE_LIMIT
# Smallest and largest value of each part: rad, rad, and a share.
RANGES: Mapping[str, tuple[float, float]] = {
    "pitch": _ANGLES,
    "roll": _ANGLES,
    "throttle": (0.0, 1.0),
}


def check_command(
    name: str, command: FbwaCommand[float] | tuple[float, float, float]
) -> FbwaCommand[float]:
    """Return a command as numbers.

    Args:
        name: of the aircraft.
        command: pitch and roll, rad, and throttle, 0..1.

    Raises:
        InputError: it does not have three numbers, or one is out of range.
    """
    try:
        pitch, roll, throttle = command
        low, high = _ANGLES
        if low <= pitch <= high and low <= roll <= high and 0.0 <= throttle <= 1.0:
            return FbwaCommand(float(pitch), float(roll), float(throttle))
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name}: {_wrong_command(command)}")


def wrong_part(part: str, value: object) -> str:
    """Describe a part of a command that is out of its range, and what to write instead.

    Args:
        part: a key of `RANGES`.
        value: as given.
    """
    low, high = RANGES[part]
    number = _real(value)
    what = f"{part}: is {shown_value(value)}"
    if not math.isfinite(number):
        return f"{what} (write a finite number)"
    if part == "throttle":
        hint = f"; {number:g} % is {number / 100:g}" if 1.0 < number <= 100.0 else ""
        return f"{what} (write a number from 0 to 1{hint})"
    hint = f"; {number:g}° is {math.radians(number):.3g} rad" if abs(number) <= 180.0 else ""
    return f"{what} (write rad from {low:.4g} to {high:.4g}, {math.degrees(high):g}°{hint})"


def _wrong_command(command: object) -> str:
    if not isinstance(command, Iterable) or isinstance(command, str | bytes | Mapping):
        command = ()
    values = list(itertools.islice(command, len(RANGES) + 1))
    if len(values) != len(RANGES):
        return "write three numbers: pitch and roll in rad, throttle from 0 to 1"
    wrong = (
        wrong_part(part, value)
        for (part, (low, high)), value in zip(RANGES.items(), values, strict=True)
        if not low <= _real(value) <= high
    )
    return next(wrong, f"is {shown_value(command)} (write three numbers)")


def _real(value: object) -> float:
    """Return a value as a number; NaN: it is none."""
    try:
        return float(value) if isinstance(value, numbers.Real) else math.nan
    except OverflowError:
        return math.inf
