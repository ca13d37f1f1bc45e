"""Columns of servo pulses from flight logs, with one sign for all airframes.

Pulses are 1000 to 2000 µs; long pulses of the aileron roll right, of the elevator pitch down, and
of the rudder yaw left. Functions and signs of outputs are ArduPlane's SERVOn_ parameters: not
reversed, a longer pulse rolls right, pitches up, yaws right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from testbed.flight_logs.flight_log import (
    ColumnSource,
    FlightLog,
    LogSeries,
    Unavailable,
    field_source,
)

_OUTPUTS = range(1, 17)
_CENTRE, _HALF = 1500.0, 500.0  # µs
_MIN, _MAX = 1100.0, 1900.0  # µs, ArduPlane's defaults of SERVOn_MIN and _MAX
_FULL = 4500.0  # of AETR
_MIRROR = 2.0 * _CENTRE

FieldName = Callable[[int], str]  # of the field of an output or channel


@dataclass(frozen=True, slots=True)
class ServoColumn:
    """ArduPlane's numbers and names for one column."""

    function: int  # SERVOn_FUNCTION
    output: int  # default output of the function
    reversed: int  # SERVOn_REVERSED that has the sign of the column
    demand: str  # field of AETR


SERVO_COLUMNS: Mapping[str, ServoColumn] = {
    "pwm_ail": ServoColumn(4, 1, 0, "Ail"),
    "pwm_ele": ServoColumn(19, 2, 1, "Elev"),
    "pwm_thr": ServoColumn(70, 3, 0, "Thr"),
    "pwm_rud": ServoColumn(21, 4, 1, "Rudd"),
}


def output_source(message: str, name: FieldName, column: str) -> ColumnSource:
    """Make a source that reads the servo output with the column's function.

    Mixed outputs, of elevons and V-tails, have no such output.
    """
    servo = SERVO_COLUMNS[column]

    def source(log: FlightLog) -> LogSeries:
        number = _output(log, servo)
        pulses = _pulses(log, message, name(number))
        if log.params.get(f"SERVO{number}_REVERSED", servo.reversed) == servo.reversed:
            return pulses
        return LogSeries(f"3000 − {pulses.source}", pulses.time, _MIRROR - pulses.values, held=True)

    return source


def demand_source(column: str) -> ColumnSource:
    """Make a source that reads ArduPlane's demand before outputs are mixed.

    The travel is that of the function's default output.
    """
    servo = SERVO_COLUMNS[column]
    sign = -1.0 if servo.reversed else 1.0

    def source(log: FlightLog) -> LogSeries:
        series = field_source("AETR", servo.demand, held=True)(log)
        if column == "pwm_thr":
            values = 2.0 * _HALF + 2.0 * _HALF * np.clip(series.values / 100.0, 0.0, 1.0)
        else:
            low, high = _servo_range(log, servo.output)
            values = _CENTRE + sign * 0.5 * (high - low) * series.values / _FULL
        return LogSeries(series.source, series.time, values, held=True)

    return source


def throttle_output_source(message: str, name: FieldName) -> ColumnSource:
    """Make a source of throttle, 0 to 1, from its servo output.

    The log must have the range of the output.
    """
    servo = SERVO_COLUMNS["pwm_thr"]

    def source(log: FlightLog) -> LogSeries:
        number = _output(log, servo)
        pulses = _pulses(log, message, name(number))
        if f"SERVO{number}_MIN" not in log.params:
            raise Unavailable(f"no parameter SERVO{number}_MIN, which {pulses.source} needs")
        low, high = _servo_range(log, number)
        share = (pulses.values - low) / (high - low)
        if log.params.get(f"SERVO{number}_REVERSED"):
            share = 1.0 - share
        return LogSeries(pulses.source, pulses.time, share, held=True)

    return source


def throttle_stick_source(message: str, name: FieldName) -> ColumnSource:
    """Make a source of throttle, 0 to 1, from the pilot's stick."""

    def source(log: FlightLog) -> LogSeries:
        channel = int(log.params.get("RCMAP_THROTTLE", 3))
        pulses = _pulses(log, message, name(channel))
        low = log.params.get(f"RC{channel}_MIN", _MIN)
        high = log.params.get(f"RC{channel}_MAX", _MAX)
        return LogSeries(pulses.source, pulses.time, (pulses.values - low) / (high - low), True)

    return source


def _output(log: FlightLog, servo: ServoColumn) -> int:
    """Return the output with the column's function; without parameters its default."""
    functions = {n: log.params.get(f"SERVO{n}_FUNCTION") for n in _OUTPUTS}
    if all(function is None for function in functions.values()):
        return servo.output
    for number, function in functions.items():
        if function == servo.function:
            return number
    raise Unavailable(f"no output has SERVOn_FUNCTION {servo.function}")


def _servo_range(log: FlightLog, number: int) -> tuple[float, float]:
    low = log.params.get(f"SERVO{number}_MIN", _MIN)
    high = log.params.get(f"SERVO{number}_MAX", _MAX)
    return (low, high) if low < high else (_MIN, _MAX)


def _pulses(log: FlightLog, message: str, name: str) -> LogSeries:
    """Read pulses, µs, without the 0 of disabled and the 65535 of unused outputs."""
    series = field_source(message, name, held=True)(log)
    valid = (series.values > 0.0) & (series.values < 65535.0)
    if not valid.any():
        raise Unavailable(f"{message}.{name} is never a pulse")
    return LogSeries(series.source, series.time[valid], series.values[valid], held=True)
