"""Replay fly-by-wire commands from a CSV with one aircraft, and write its response.

The output has the columns of a flight recorded from ArduPlane, with a row at the time of each
command, so that a recording and its replay can be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.autopilot.fbwa import GAINS, fly_by_wire_a, settled_autopilots
from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains, read_params
from testbed.commissioning.command_files import (
    RESPONSES,
    Commands,
    CommandsError,
    read_commands,
    rows_flown,
    write_response,
)
from testbed.compiled.compiled_fleet import make_compiled_fleet
from testbed.core.call_list import Call, StepList
from testbed.core.files import check_writable
from testbed.core.records import (
    ActuatorCommand,
    Array,
    FbwaCommand,
    NedOrigin,
    Records,
    VehicleState,
    air_data,
    allocate,
    fields_of,
)
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.fleet import FlightModels, JsbsimFleet, Move
from testbed.vehicle.jsbsim_adapter import modes_of_aircraft
from testbed.vehicle.step_size import check_fixed_step
from testbed.vehicle.trim import InitialState, TrimPoint

BASE_RATE_HZ = 200
_PITCH, _AIRSPEED = RESPONSES.index("theta_rad"), RESPONSES.index("airspeed_mps")
_HEIGHT = RESPONSES.index("altitude_m")
# µs: the pulse of no deflection or throttle, and what one of 1 adds
_PULSES = {
    RESPONSES.index("pwm_ail"): (1500.0, 500.0),
    RESPONSES.index("pwm_ele"): (1500.0, -500.0),
    RESPONSES.index("pwm_thr"): (1000.0, 1000.0),
    RESPONSES.index("pwm_rud"): (1500.0, -500.0),
}


class AircraftLost(RuntimeError):
    """The aircraft was lost; earlier rows are written."""


@dataclass(frozen=True, slots=True)
class ReplaySetup:
    """How commands are replayed.

    Attributes:
        params: of the autopilot.
        airspeed: true, m/s, at the start; None: the first row's `airspeed_mps`, or 22.
        altitude: m above the origin at the start; None: the first row's `altitude_m`, or 100.
        origin_elevation: m above sea level of the origin and the terrain.
        timing: delays of the autopilot; for a recording of SITL with its gyro filter.
        integrators: of the flight model.

    Raises:
        CommandsError: the autopilot's rate does not divide that of the physics.
    """

    params: FbwaParams
    airspeed: float | None = None
    altitude: float | None = None
    origin_elevation: float = 300.0
    timing: AutopilotTiming = AutopilotTiming()
    integrators: Integrators = INTEGRATORS

    def __post_init__(self) -> None:
        """Check the rate of the autopilot."""
        rate = self.params.sched_loop_rate
        if BASE_RATE_HZ % rate:
            raise CommandsError(f"SCHED_LOOP_RATE {rate:g} must divide {BASE_RATE_HZ} Hz")

    @property
    def period(self) -> int:
        """Period of the autopilot in steps of the physics."""
        return int(BASE_RATE_HZ / self.params.sched_loop_rate)

    def start(self, commands: Commands) -> InitialState:
        """Return the trimmed flight in which a replay begins."""
        given = commands.start
        altitude = given["altitude_m"] if self.altitude is None else self.altitude
        return InitialState(
            position_ned=(0.0, 0.0, -altitude),
            course=given["psi_rad"],
            airspeed=given["airspeed_mps"] if self.airspeed is None else self.airspeed,
        )


class ReplayedAircraft(NamedTuple):
    """An aircraft to replay commands with."""

    folder: Path
    latency: float  # s, of the commands
    airspeed: float  # m/s, true, at the start
    pitch_offset: float = 0.0  # rad, of the pitch as recorded and as the autopilot has it
    airspeed_offset: float = 0.0  # m/s, the same of the airspeed


def replay(
    candidates: Sequence[ReplayedAircraft],
    commands: Commands,
    setup: ReplaySetup,
    *,
    engine: str = "jsbsim",
) -> Array:
    """Fly the commands with each of N aircraft from trim in still air.

    A command holds from its row to the next one. The flight starts at the first row, in level trim,
    with the heading `psi_rad` of that row if there is one.

    Args:
        candidates: N, in place of airspeed and latency of `setup`.
        commands: K rows.
        setup: of all of them.
        engine: of the flight models: jsbsim, or auto for compiled ones where they can be.

    Returns:
        (N, K, 15) the columns of RESPONSES at the rows: s, rad, m, µs, none rounded. Rows at and
        after a loss are NaN.

    Raises:
        AircraftError, TrimError: of an aircraft and its start.
    """
    origin = NedOrigin(elevation_m=setup.origin_elevation)
    folders = [each.folder for each in candidates]
    starts = [replace(setup.start(commands), airspeed=each.airspeed) for each in candidates]
    if setup.integrators != INTEGRATORS:
        engine = "jsbsim"  # compiled models have the default ones
    compiled, _ = make_compiled_fleet(folders, starts, origin, BASE_RATE_HZ, engine)
    fleet = compiled or JsbsimFleet(folders, starts, origin, BASE_RATE_HZ, setup.integrators)
    gains = allocate(GAINS, len(candidates))
    for k, each in enumerate(candidates):
        timing = replace(setup.timing, command_latency=each.latency)
        gains[k] = make_gains([setup.params], setup.period / BASE_RATE_HZ, timing)[0]
    offsets = np.array([(each.pitch_offset, each.airspeed_offset) for each in candidates])
    return _fly(fleet, commands, setup.period, gains, offsets.T)


def replay_one(
    aircraft_folder: Path,
    commands: Commands,
    setup: ReplaySetup,
    warn: Callable[[str], None] = lambda text: None,
) -> Array:
    """Replay commands with one aircraft, after a look at its start and its modes.

    Args:
        aircraft_folder: the aircraft.
        commands: K rows.
        setup: of the replay.
        warn: receives a line if the airspeed of the recording changes quickly after its first row,
            and the flight starts with that of this row; and one if the flight model is too fast for
            the steps of 1/200 s.

    Returns:
        (K, 15) as of `replay`.

    Raises:
        AircraftError, TrimError: of the aircraft and its start.
        InputError: the flight model diverges with steps of 1/200 s.
    """
    if setup.airspeed is None and commands.later_airspeed is not None:
        later, speed = commands.later_airspeed
        warn(
            f"{commands.path}: airspeed_mps is {commands.start['airspeed_mps']:.1f} in the first "
            f"row, where the replay starts in trim, and {speed:.1f} after {later:.1f} s: they "
            "differ at first (cut the file where it is steady, or write --airspeed)"
        )
    start, folder = setup.start(commands), Path(aircraft_folder)
    origin = NedOrigin(elevation_m=setup.origin_elevation)
    altitude = setup.origin_elevation - start.position_ned[2]
    modes = modes_of_aircraft(folder, TrimPoint(start.airspeed, altitude=altitude), origin)
    check_fixed_step(folder.name, start.airspeed, modes, BASE_RATE_HZ, warn)
    alone = ReplayedAircraft(folder, setup.timing.command_latency, start.airspeed)
    response: Array = replay([alone], commands, setup)[0]
    return response


def respond(
    aircraft_folder: Path,
    commands_csv: Path,
    out_csv: Path,
    *,
    param: Path | None = None,
    airspeed: float | None = None,
    altitude: float | None = None,
    timing: AutopilotTiming | None = None,
    integrators: Integrators = INTEGRATORS,
    warn: Callable[[str], None] = lambda text: None,
) -> int:
    """Replay the commands of a CSV and write the response.

    Args:
        aircraft_folder: the aircraft.
        commands_csv: columns t_s, theta_cmd_rad, phi_cmd_rad, throttle_cmd; others are allowed.
        out_csv: output, as of `write_response`.
        param: the tune; default `recorded.param` of the aircraft.
        airspeed: see `ReplaySetup`, as the next three.
        altitude: m.
        timing: None: that of an aircraft.
        integrators: of the flight model.
        warn: see `replay_one`.

    Returns:
        The number of rows written.

    Raises:
        CommandsError: the commands are invalid; the message names file, line and column.
        ParamError: of the tune.
        InputError: as of `replay_one`.
        AircraftLost: the aircraft was lost.
        OSError: the response cannot be written.
    """
    check_writable(Path(out_csv))
    commands = read_commands(commands_csv)
    params = read_params(param or Path(aircraft_folder) / "recorded.param")
    setup = ReplaySetup(
        params, airspeed, altitude, timing=timing or AutopilotTiming(), integrators=integrators
    )
    response = replay_one(aircraft_folder, commands, setup, warn)
    write_response(Path(out_csv), commands, response)
    check_flown(commands, response)
    return len(response)


def check_flown(commands: Commands, response: Array) -> None:
    """Check that the aircraft has flown all rows of a response (K, 15).

    Raises:
        AircraftLost: it was lost.
    """
    if (flown := rows_flown(response)) < len(response):
        raise AircraftLost(
            f"{commands.path}: the aircraft was lost at {commands.time_s[flown]:.2f} s"
        )


def _fly(
    fleet: FlightModels, commands: Commands, period: int, gains: Records, offsets: Array
) -> Array:
    """Return rows of RESPONSES (N, K, 15) at the commands; NaN from a loss on.

    Args:
        fleet: N aircraft.
        commands: K rows.
        period: of the autopilots, in steps of the physics.
        gains: (N,) of the autopilots.
        offsets: (2, N) of the estimated pitch, rad, and airspeed, m/s.
    """
    ticks = np.rint(commands.time_s * BASE_RATE_HZ).astype(int).tolist()
    rows = np.full((len(gains), len(ticks), len(RESPONSES)), np.nan)
    autopilots = settled_autopilots(gains, fleet.trimmed)
    aircraft, lost = fleet.aircraft, np.zeros(len(gains), dtype=bool)
    state, estimate = fields_of(VehicleState, aircraft["truth"]), aircraft["estimate"]
    command = fields_of(FbwaCommand, aircraft["command"])
    estimated = fields_of(VehicleState, estimate)
    responses = _responses(aircraft)
    pitch_offset, airspeed_offset = offsets
    fly = Call(fly_by_wire_a, fleet.all_rows, *autopilots, aircraft)
    to_next = Move(np.zeros(1, dtype=np.intp), ~lost)
    control = StepList((fly, fleet.write_surfaces))
    read_air, move = StepList(fleet.air_steps), StepList(fleet.move_steps(to_next))
    tick = ticks[0] // period * period
    row = 0
    while row < len(ticks):
        if tick % period == 0:
            lost |= fleet.lost(state)
            if lost.all():
                break
            if lost.any():
                fleet.remove(lost)
            now = commands.values[row if ticks[row] <= tick else max(0, row - 1)]
            command.pitch[:], command.roll[:], command.throttle[:] = now[1:]
            estimate[...] = aircraft["truth"]
            estimated.euler[:, 1] += pitch_offset
            estimated.airspeed[:] += airspeed_offset
            estimated.equivalent_airspeed[:] += airspeed_offset
            control.run(0.0)
        if ticks[row] <= tick:
            read_air.run(0.0)
            first = row
            for k, column in enumerate(responses):
                rows[:, first, k] = column
            rows[lost, first] = np.nan
            while row < len(ticks) and ticks[row] <= tick:
                rows[:, row] = rows[:, first]
                row += 1
        following = tick // period * period + period
        if row < len(ticks):
            following = min(following, ticks[row])
        to_next.steps[0] = following - tick
        move.run(0.0)
        tick = following
    rows[:, :, _HEIGHT] *= -1.0
    rows[:, :, _PITCH] += pitch_offset[:, np.newaxis]
    rows[:, :, _AIRSPEED] += airspeed_offset[:, np.newaxis]
    for k, (middle, scale) in _PULSES.items():
        rows[:, :, k] = middle + scale * rows[:, :, k]
    return rows


def _responses(aircraft: Records) -> tuple[Array, ...]:
    """View the columns of RESPONSES (N,) in records (N,) of AIRCRAFT: down, and no pulses yet."""
    state, air = fields_of(VehicleState, aircraft["truth"]), air_data(aircraft)
    surfaces = fields_of(ActuatorCommand, aircraft["surfaces"])
    return (
        *state.euler.T,
        *state.rates_body.T,
        state.airspeed,
        state.position_ned[:, 2],
        state.velocity_ned[:, 2],
        air.beta,
        air.alpha,
        *(surfaces.aileron, surfaces.elevator, surfaces.throttle, surfaces.rudder),
    )
