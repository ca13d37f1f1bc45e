"""Servo outputs in the columns of a recording: 1000 to 2000 µs, and one sense for every airframe.

In those columns aileron high rolls right, elevator low pitches up, rudder low yaws right. Which
output moves what, and which way, is in ArduPlane's SERVOn_ parameters: there, not reversed, a
larger output rolls right, pitches up, yaws right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from testbed.mavlink.logged import Draw, Log, Series, entry

_OUTPUTS = range(1, 17)
_CENTRE, _HALF = 1500.0, 500.0  # µs
_LEAST, _MOST = 1100.0, 1900.0  # µs, ArduPlane's defaults of SERVOn_MIN and _MAX
_FULL = 4500.0  # of AETR
_MIRROR = 2.0 * _CENTRE

Name = Callable[[int], str]  # of the field of an output


@dataclass(frozen=True, slots=True)
class Control:
    """What a column stands for in ArduPlane."""

    function: int  # SERVOn_FUNCTION
    output: int  # that has it by default
    reversed: int  # the SERVOn_REVERSED in which the column is
    demand: str  # in AETR


CONTROLS: Mapping[str, Control] = {
    "pwm_ail": Control(4, 1, 0, "Ail"),
    "pwm_ele": Control(19, 2, 1, "Elev"),
    "pwm_thr": Control(70, 3, 0, "Thr"),
    "pwm_rud": Control(21, 4, 1, "Rudd"),
}


def output(message: str, name: Name, column: str) -> Draw:
    """Draw a column from the servo output that moves it; none does if outputs are mixed."""
    control = CONTROLS[column]

    def draw(log: Log) -> Series | None:
        number = _output(log, control)
        pulses = number and _pulses(log, message, name(number))
        if not pulses:
            return None
        turned = log.params.get(f"SERVO{number}_REVERSED", control.reversed) != control.reversed
        if not turned:
            return pulses
        return Series(f"3000 − {pulses.source}", pulses.time, _MIRROR - pulses.values, held=True)

    return draw


def demand(column: str) -> Draw:
    """Draw a column from what ArduPlane asked of a surface before outputs were mixed.

    The travel is that of the output which has the surface by default.
    """
    control = CONTROLS[column]
    sign = -1.0 if control.reversed else 1.0

    def draw(log: Log) -> Series | None:
        series = entry("AETR", control.demand, held=True)(log)
        if series is None:
            return None
        if column == "pwm_thr":
            values = 2.0 * _HALF + 2.0 * _HALF * np.clip(series.values / 100.0, 0.0, 1.0)
        else:
            least, most = _ends(log, control.output)
            values = _CENTRE + sign * 0.5 * (most - least) * series.values / _FULL
        return Series(series.source, series.time, values, held=True)

    return draw


def throttle(message: str, name: Name) -> Draw:
    """Draw the throttle, 0 to 1, from its servo output, if the log tells that output's ends."""
    control = CONTROLS["pwm_thr"]

    def draw(log: Log) -> Series | None:
        number = _output(log, control)
        if not number or f"SERVO{number}_MIN" not in log.params:
            return None
        pulses = _pulses(log, message, name(number))
        if pulses is None:
            return None
        least, most = _ends(log, number)
        part = (pulses.values - least) / (most - least)
        if log.params.get(f"SERVO{number}_REVERSED"):
            part = 1.0 - part
        return Series(pulses.source, pulses.time, part, held=True)

    return draw


def stick(message: str, name: Name) -> Draw:
    """Draw the throttle, 0 to 1, from the pilot's stick."""

    def draw(log: Log) -> Series | None:
        channel = int(log.params.get("RCMAP_THROTTLE", 3))
        pulses = _pulses(log, message, name(channel))
        if pulses is None:
            return None
        least = log.params.get(f"RC{channel}_MIN", _LEAST)
        most = log.params.get(f"RC{channel}_MAX", _MOST)
        return Series(pulses.source, pulses.time, (pulses.values - least) / (most - least), True)

    return draw


def _output(log: Log, control: Control) -> int | None:
    """Which output has this function."""
    functions = {n: log.params.get(f"SERVO{n}_FUNCTION") for n in _OUTPUTS}
    if all(function is None for function in functions.values()):
        return control.output
    return next((n for n, function in functions.items() if function == control.function), None)


def _ends(log: Log, number: int) -> tuple[float, float]:
    least = log.params.get(f"SERVO{number}_MIN", _LEAST)
    most = log.params.get(f"SERVO{number}_MAX", _MOST)
    return (least, most) if least < most else (_LEAST, _MOST)


def _pulses(log: Log, message: str, name: str) -> Series | None:
    """Pulses, µs, without the zeros of an output that is off and the 65535 of an unused one."""
    series = entry(message, name, held=True)(log)
    if series is None:
        return None
    on = (series.values > 0.0) & (series.values < 65535.0)
    if not on.any():
        return None
    return Series(series.source, series.time[on], series.values[on], held=True)
