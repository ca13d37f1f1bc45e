"""Files of fly-by-wire commands, with what was recorded of the flight, and of responses to them."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from testbed.core.csv_table import read_rows
from testbed.core.errors import InputError
from testbed.core.files import write_text_file
from testbed.core.input_files import (
    MAX_TABLE_BYTES,
    parse_json_map,
    quote_word,
    read_bounded_text,
)
from testbed.core.numbers import parse_number
from testbed.core.ranges import RECORDED
from testbed.core.records import Array

COMMANDS = ("t_s", "theta_cmd_rad", "phi_cmd_rad", "throttle_cmd")
RESPONSES = (
    "phi_rad",
    "theta_rad",
    "psi_rad",
    "p_radps",
    "q_radps",
    "r_radps",
    "airspeed_mps",
    "altitude_m",
    "v_down_mps",
    "beta_rad",
    "alpha_rad",
    "pwm_ail",
    "pwm_ele",
    "pwm_thr",
    "pwm_rud",
)
WIND = ("wind_north_mps", "wind_east_mps")  # an autopilot's estimate
_SOURCES = ".sources.json"
_PULSES = [k for k, name in enumerate(RESPONSES) if name.startswith("pwm")]
_STARTS = {"airspeed_mps": 22.0, "altitude_m": 100.0, "psi_rad": 0.0}
_MAX_DURATION_S = 86400.0
_STEADY_S, _STEADY_MPS = 2.0, 2.0  # a larger change of airspeed in this time is no steady start


class CommandsError(InputError):
    """A file of commands that cannot be flown; the message names file, line and column."""


@dataclass(frozen=True, slots=True)
class Commands:
    """The rows of a command file."""

    path: Path
    text: tuple[tuple[str, ...], ...]  # (rows) of COMMANDS as in the file
    values: Array  # (rows, 4)
    recorded: dict[str, Array]  # (rows) of those of RESPONSES that the file has
    start: dict[str, float]  # state of the aircraft in the first row: keys of _STARTS
    later_airspeed: tuple[float, float] | None  # s and m/s of a row that shows an unsteady start
    rates_hz: Mapping[str, float] = field(default_factory=dict)  # of `read_rates`
    wind_mps: Array | None = None  # (rows, 2) estimated, to the north and east

    @property
    def time_s(self) -> Array:
        """Time of each row (rows), s."""
        return self.values[:, 0]


def write_response(path: Path, commands: Commands, response: Array) -> None:
    """Write the commands and the columns of RESPONSES up to a loss of the aircraft, as CSV.

    PWM is 1000 to 2000 µs for the whole travel, as ArduPlane sends it: aileron high rolls right,
    elevator low pitches up, rudder low yaws right; whole µs.

    Args:
        path: the file.
        commands: K rows.
        response: (K, 15) of `respond`.

    Raises:
        OSError: it cannot be written.
    """
    flown = response[: rows_flown(response)].copy()
    flown[:, _PULSES] = np.rint(flown[:, _PULSES])
    with write_text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COMMANDS + RESPONSES)
        for text, row in zip(commands.text, flown.tolist(), strict=False):
            writer.writerow([*text, *(f"{value:.6g}" for value in row)])


def rows_flown(response: Array) -> int:
    """Return how many rows of a response (K, 15) come before a loss of the aircraft."""
    return int(np.count_nonzero(np.isfinite(response[:, 0])))


def read_commands(path: Path) -> Commands:
    """Read and check a file of commands.

    Raises:
        CommandsError: the file is invalid; the message names file, line and column.
    """
    try:
        lines = [row for _, row in read_rows(Path(path))]
    except InputError as error:
        raise CommandsError(str(error)) from error
    header = [name.strip() for name in lines[0]] if lines else []
    for name in COMMANDS:
        if header.count(name) != 1:
            raise CommandsError(
                f"{path}:1: column {name}: expected once in the header, found "
                f"{header.count(name)} times; needed are {', '.join(COMMANDS)}"
            )
    columns = [header.index(name) for name in COMMANDS]
    optional = (*RESPONSES, *WIND)
    known = {name: header.index(name) for name in optional if header.count(name) == 1}
    recorded: list[list[float]] = []
    text: list[tuple[str, ...]] = []
    values: list[list[float]] = []
    start = dict(_STARTS)
    speed_column = header.index("airspeed_mps") if "airspeed_mps" in header else None
    later: tuple[float, float] | None = None
    for number, line in enumerate(lines[1:], start=2):
        if not line:
            continue
        if len(line) != len(header):
            raise CommandsError(
                f"{path}:{number}: column {min(len(line), len(header)) + 1}: expected "
                f"{len(header)} values, as in the header, found {len(line)}"
            )
        row = [
            _cell(path, number, name, line[i]) for name, i in zip(COMMANDS, columns, strict=True)
        ]
        if values and row[0] <= values[-1][0]:
            raise CommandsError(
                f"{path}:{number}: column t_s: {row[0]:g} is not later than the row before"
            )
        if not values:
            for name in start.keys() & set(header):
                start[name] = _cell(path, number, name, line[header.index(name)])
        since = row[0] - (values or [row])[0][0]
        if speed_column is not None and later is None and since <= _STEADY_S:
            speed = parse_number(line[speed_column].strip())
            if speed is not None and abs(speed - start["airspeed_mps"]) > _STEADY_MPS:
                later = since, speed
        if since > _MAX_DURATION_S:
            raise CommandsError(
                f"{path}:{number}: column t_s: {row[0]:g} is more than a day after the first row"
            )
        values.append(row)
        recorded.append([_cell(path, number, name, line[i]) for name, i in known.items()])
        text.append(tuple(line[i].strip() for i in columns))
    if not values:
        raise CommandsError(f"{path}:2: column t_s: no rows; at least one command is needed")
    found = dict(zip(known, np.array(recorded).T, strict=True))
    wind = [found.pop(name) for name in WIND if name in found]
    return Commands(
        Path(path),
        tuple(text),
        np.array(values),
        found,
        start,
        later,
        read_rates(Path(path)),
        np.stack(wind, axis=-1) if len(wind) == len(WIND) else None,
    )


def sources_file(recording: Path) -> Path:
    """Return the file beside a recording with the sources and rates of its columns."""
    return recording.with_name(f"{recording.stem}{_SOURCES}")


def write_sources(
    recording: Path, log: str, sources: Mapping[str, str], rates_hz: Mapping[str, float]
) -> None:
    """Write where the columns of a recording come from, beside it.

    Args:
        recording: its file.
        log: name of the file that it was made of.
        sources: message and field, by column.
        rates_hz: messages per second, by column.

    Raises:
        OSError: it cannot be written.
    """
    columns = {
        name: {"source": source}
        | ({"rate_hz": float(f"{rates_hz[name]:.4g}")} if name in rates_hz else {})
        for name, source in sources.items()
    }
    with write_text_file(sources_file(recording)) as file:
        json.dump({"log": log, "columns": columns}, file, indent=1, ensure_ascii=False)
        file.write("\n")


def read_rates(recording: Path) -> dict[str, float]:
    """Read messages per second by column, from the file beside a recording; empty: there is none.

    Raises:
        CommandsError: the file is not one of `write_sources`.
    """
    path = sources_file(recording)
    if not path.is_file():
        return {}
    try:
        columns = parse_json_map(read_bounded_text(path, MAX_TABLE_BYTES))["columns"]
        rates = {name: each["rate_hz"] for name, each in columns.items() if "rate_hz" in each}
        found = {name: float(each) for name, each in rates.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CommandsError(
            f"{path}: is not the sources of a recording ({error}); import the log again, or remove "
            "it"
        ) from None
    if not all(0.0 < each < math.inf for each in found.values()):
        raise CommandsError(f"{path}: rate_hz must be above 0; import the log again, or remove it")
    return found


def _cell(path: Path, number: int, name: str, text: str) -> float:
    value = parse_number(text.strip())
    if value is None:
        raise CommandsError(
            f"{path}:{number}: column {name}: {quote_word(text)} is not a finite number"
        )
    limits = RECORDED[name]
    if not limits.low - limits.slack <= value <= limits.high + limits.slack:
        raise CommandsError(f"{path}:{number}: column {limits.problem(name, value)}")
    return min(max(value, limits.low), limits.high)
