"""Replay fly-by-wire commands from a CSV with one aircraft, and write its response.

The output has the columns of a flight recorded from ArduPlane, with a row at the time of each
command, so that a recording and its replay can be compared.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.autopilot.fbwa import settled_autopilots, step_autopilots
from testbed.autopilot.parameters import AutopilotTiming, make_gains, read_params
from testbed.core.csv_table import read_rows
from testbed.core.errors import InputError
from testbed.core.files import check_writable, write_text_file
from testbed.core.input_files import quote_word
from testbed.core.numbers import parse_number
from testbed.core.records import ActuatorCommand, Array, FbwaCommand, NedOrigin, Records
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import modes_of_aircraft
from testbed.vehicle.step_size import check_fixed_step
from testbed.vehicle.trim import InitialState

BASE_RATE_HZ = 200
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
_ALLOWED = {
    "theta_cmd_rad": (-math.pi / 2, math.pi / 2, "radians between -1.57 and 1.57"),
    "phi_cmd_rad": (-math.pi, math.pi, "radians between -3.14 and 3.14"),
    "throttle_cmd": (0.0, 1.0, "a share of full throttle between 0 and 1"),
}
_STARTS = {"airspeed_mps": 22.0, "altitude_m": 100.0, "psi_rad": 0.0}
_MAX_DURATION_S = 86400.0
_STEADY_S, _STEADY_MPS = 2.0, 2.0  # a larger change of airspeed in this time is no steady start


class CommandsError(InputError):
    """A file of commands that cannot be flown; the message names file, line and column."""


class AircraftLost(RuntimeError):
    """The aircraft was lost; earlier rows are written."""


@dataclass(frozen=True, slots=True)
class Commands:
    """The rows of a command file."""

    text: tuple[tuple[str, ...], ...]  # (rows) of COMMANDS as in the file
    values: Array  # (rows, 4)
    start: dict[str, float]  # state of the aircraft in the first row: keys of _STARTS
    later_airspeed: tuple[float, float] | None  # s and m/s of a row that shows an unsteady start


def respond(
    aircraft_folder: Path,
    commands_csv: Path,
    out_csv: Path,
    *,
    param: Path | None = None,
    airspeed: float | None = None,
    altitude: float | None = None,
    origin_elevation: float = 300.0,
    timing: AutopilotTiming | None = None,
    integrators: Integrators = INTEGRATORS,
    warn: Callable[[str], None] = lambda text: None,
) -> int:
    """Fly the commands of a CSV from trim in still air and write the response.

    A command holds from its row to the next one. The flight starts at the first row, in level trim,
    with the heading `psi_rad` of that row if there is one.

    Args:
        aircraft_folder: the aircraft.
        commands_csv: columns t_s, theta_cmd_rad, phi_cmd_rad, throttle_cmd; others are allowed.
        out_csv: output: the commands and the fifteen columns of RESPONSES; PWM is 1000 to 2000 µs
            for the whole travel, as ArduPlane sends it: aileron high rolls right, elevator low
            pitches up, rudder low yaws right.
        param: the tune; default `recorded.param` of the aircraft.
        airspeed: true, m/s, at the start; default the first row's `airspeed_mps`, or 22.
        altitude: m above the origin at the start; default the first row's `altitude_m`, or 100.
        origin_elevation: m above sea level of the origin and the terrain.
        timing: delays of the autopilot; for a recording of SITL with its gyro filter.
        integrators: of the flight model.
        warn: receives a line if the airspeed of the recording changes quickly after its first row,
            and the flight starts with that of this row; and one if the flight model is too fast for
            the steps of 1/200 s.

    Returns:
        The number of rows written.

    Raises:
        CommandsError: the commands are invalid; the message names file, line and column.
        ParamError, AircraftError, TrimError: of the tune, the aircraft and its start.
        InputError: the flight model diverges with steps of 1/200 s.
        AircraftLost: the aircraft was lost.
        OSError: the response cannot be written.
    """
    check_writable(Path(out_csv))
    commands = read_commands(commands_csv)
    if airspeed is None and commands.later_airspeed is not None:
        later, speed = commands.later_airspeed
        warn(
            f"{commands_csv}: airspeed_mps is {commands.start['airspeed_mps']:.1f} in the first "
            f"row, where the replay starts in trim, and {speed:.1f} after {later:.1f} s: they "
            "differ at first (cut the file where it is steady, or write --airspeed)"
        )
    params = read_params(param or Path(aircraft_folder) / "recorded.param")
    period = BASE_RATE_HZ / params.sched_loop_rate
    if period != int(period):
        raise CommandsError(
            f"SCHED_LOOP_RATE {params.sched_loop_rate:g} must divide {BASE_RATE_HZ} Hz"
        )
    start = InitialState(
        position_ned=(0.0, 0.0, -(commands.start["altitude_m"] if altitude is None else altitude)),
        course=commands.start["psi_rad"],
        airspeed=commands.start["airspeed_mps"] if airspeed is None else airspeed,
    )
    origin = NedOrigin(elevation_m=origin_elevation)
    fleet = JsbsimFleet([aircraft_folder], [start], origin, BASE_RATE_HZ, integrators)
    point, folder = fleet.trims[0].point, Path(aircraft_folder)
    modes = modes_of_aircraft(folder, point, origin)
    check_fixed_step(folder.name, point.airspeed, modes, BASE_RATE_HZ, warn)
    gains = make_gains([params], int(period) / BASE_RATE_HZ, timing)
    ticks = np.rint(commands.values[:, 0] * BASE_RATE_HZ).astype(int)
    rows, lost_at = _fly(fleet, commands.values, ticks, int(period), gains)
    with write_text_file(Path(out_csv)) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COMMANDS + RESPONSES)
        for text, row in zip(commands.text, rows, strict=False):
            writer.writerow([*text, *(f"{value:.6g}" for value in row)])
    if lost_at is not None:
        raise AircraftLost(f"{commands_csv}: the aircraft was lost at {lost_at:.2f} s")
    return len(rows)


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
        text.append(tuple(line[i].strip() for i in columns))
    if not values:
        raise CommandsError(f"{path}:2: column t_s: no rows; at least one command is needed")
    return Commands(tuple(text), np.array(values), start, later)


def _cell(path: Path, number: int, name: str, text: str) -> float:
    value = parse_number(text.strip())
    if value is None:
        raise CommandsError(
            f"{path}:{number}: column {name}: {quote_word(text)} is not a finite number"
        )
    low, high, words = _ALLOWED.get(name, (-math.inf, math.inf, ""))
    if not low <= value <= high:
        raise CommandsError(f"{path}:{number}: column {name}: {value:g} should be {words}")
    return value


def _fly(
    fleet: JsbsimFleet, commands: Array, ticks: Array, period: int, gains: Records
) -> tuple[list[list[float]], float | None]:
    """Return rows of RESPONSES at the commands, and the time of a loss."""
    autopilots = settled_autopilots(gains, fleet.trimmed)
    surfaces = fleet.trimmed
    rows: list[list[float]] = []
    tick = int(ticks[0]) // period * period
    row = 0
    while row < len(ticks):
        state, air = fleet.read(), fleet.air()
        if tick % period == 0:
            if fleet.lost(state)[0]:
                return rows, tick / BASE_RATE_HZ
            _, pitch, roll, throttle = commands[row if ticks[row] <= tick else max(0, row - 1)]
            command = FbwaCommand(
                pitch=np.array([pitch]), roll=np.array([roll]), throttle=np.array([throttle])
            )
            surfaces = step_autopilots(autopilots, state, command)
        while row < len(ticks) and ticks[row] <= tick:
            rows.append(
                [
                    *state.euler[0],
                    *state.rates_body[0],
                    state.airspeed[0],
                    -state.position_ned[0, 2],
                    state.velocity_ned[0, 2],
                    air.beta[0],
                    air.alpha[0],
                    *_pwm(surfaces),
                ]
            )
            row += 1
        following = tick // period * period + period
        if row < len(ticks):
            following = min(following, int(ticks[row]))
        fleet.step(surfaces, following - tick)
        tick = following
    return rows, None


def _pwm(surfaces: ActuatorCommand) -> tuple[float, float, float, float]:
    """Return aileron, elevator, throttle and rudder in whole µs."""
    return (
        float(np.rint(1500.0 + 500.0 * surfaces.aileron[0])),
        float(np.rint(1500.0 - 500.0 * surfaces.elevator[0])),
        float(np.rint(1000.0 + 1000.0 * surfaces.throttle[0])),
        float(np.rint(1500.0 - 500.0 * surfaces.rudder[0])),
    )
