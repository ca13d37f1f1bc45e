"""The whole state of one aircraft with its autopilot as one block of bytes.

Compiled functions of `aircraft_functions` read and write a block in place. A copy of the bytes is a
copy of the flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from testbed.autopilot.fbwa import GAINS, MEMORY, settled_autopilots
from testbed.autopilot.parameters import FbwaParams, make_gains
from testbed.compiled.compiled_aircraft import CompiledAircraft
from testbed.compiled.compiled_fleet import place_row
from testbed.core.errors import InputError
from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    FbwaCommand,
    NedOrigin,
    Record,
    allocate,
    write_fields,
)
from testbed.vehicle.fleet import lowest_height
from testbed.vehicle.jsbsim_io import MOTION_PROPERTIES
from testbed.vehicle.jsbsim_model import INTEGRATOR_STEPS
from testbed.vehicle.trim import InitialState, TrimError

AUTOPILOT_HZ = 50  # as of `testbed.Aircraft`

# Where and how a flight begins: parameters of an FMU.
START = np.dtype(
    [
        ("airspeed", "f8"),  # true, m/s
        ("position_ned", "f8", (3,)),  # m
        ("course", "f8"),  # over the ground, rad
    ],
    align=True,
)
# The trimmed flight that a row was made for, and of which rows for other starts are made.
PLACING = np.dtype(
    [
        ("position_ned", "f8", (3,)),  # m
        ("roll", "f8"),  # rad
        ("pitch", "f8"),  # rad
        ("yaw", "f8"),  # rad, for a course of zero through the air
        ("level_speed", "f8"),  # horizontal part of the airspeed, m/s
        ("velocity_body", "f8", (3,)),  # through the air, m/s
        ("rates_body", "f8", (3,)),  # rad/s
    ],
    align=True,
)


class StartPoint(NamedTuple):
    """Where trimmed flights begin."""

    height: float  # above the origin, m
    origin: NedOrigin = NedOrigin()


def block_type(columns: int, periods: int) -> np.dtype[Any]:
    """Return the fields of a block, aligned as in C.

    Args:
        columns: of a row of the compiled aircraft.
        periods: of the autopilot's delay line.
    """
    return np.dtype(
        [
            ("aircraft", AIRCRAFT),
            ("row", "f8", (columns,)),
            ("wind_numbers", "f8", (7,)),  # of `pack_wind`
            ("controls", "f8", (4,)),  # of `pack_surfaces`
            ("lead", "f8", (4,)),  # of `lead_controls`, as the next two
            ("last_controls", "f8", (4,)),
            ("first_controls", "f8", (4,)),
            ("numbers", "f8", (len(MOTION_PROPERTIES),)),  # of `write_motion`
            ("air_columns", "i8", (5,)),  # of `write_air`, as the next
            ("air_numbers", "f8", (5,)),
            ("gains", GAINS),
            ("memory", MEMORY),
            ("delay_line", "f8", (periods, 3)),
            ("start", START),
            ("placing", PLACING),
            ("lowest_m", "f8"),  # above the origin, where the ground may touch the aircraft
            ("only", "i8"),  # number of the only aircraft, 0
            ("steps", "i8"),  # of the flight model in a period of the autopilot
            ("placing_steps", "i8", (2,)),  # of an evaluation, and of the integrators' memories
            ("changed", "?", (2,)),  # of `run_rows`, as the next
            ("status", "u1"),
        ],
        align=True,
    )


def make_block(
    aircraft: CompiledAircraft,
    params: FbwaParams,
    airspeed: float,
    start: StartPoint,
    physics_hz: int,
) -> Record:
    """Return the block of an aircraft in trim, north over the origin, in still air.

    Args:
        aircraft: the flight model.
        params: of the autopilot.
        airspeed: true, m/s.
        start: height and origin.
        physics_hz: steps of the flight model per second, a multiple of AUTOPILOT_HZ.

    Raises:
        InputError: there is no level flight at this airspeed.
        NotTranslated: the start cannot be compiled.
    """
    at = InitialState((0.0, 0.0, -start.height), airspeed=airspeed)
    try:
        placed = place_row(aircraft.folder, at, start.origin, physics_hz)
    except TrimError as error:
        reason = str(error).rpartition("no steady flight; ")[2]
        raise InputError(f"airspeed {airspeed:g} m/s: no level flight: {reason}") from None
    gains = make_gains([params], 1.0 / AUTOPILOT_HZ)
    trim, controls = placed.trim, placed.trim.controls
    surfaces = ActuatorCommand(
        *(np.array([value]) for value in (controls.aileron, controls.elevator)),
        *(np.array([value]) for value in (controls.rudder, controls.throttle)),
    )
    autopilots = settled_autopilots(gains, surfaces)
    block = allocate(block_type(len(placed.row), autopilots.delay_line.shape[1]), 1)
    own = block["aircraft"]
    write_fields(own["surfaces"], surfaces)
    placement = trim.placement
    command = FbwaCommand(placement.pitch, placement.roll, controls.throttle)
    write_fields(own["command"], command)
    block["row"], block["lead"] = placed.row, placed.leads
    signed = controls.aileron, -controls.elevator, -controls.rudder, controls.throttle
    for name in ("controls", "last_controls", "first_controls"):
        block[name] = signed
    block["air_columns"] = aircraft.air_columns
    block["gains"], block["memory"] = autopilots.gains, autopilots.memory
    block["delay_line"] = autopilots.delay_line
    block["steps"] = physics_hz // AUTOPILOT_HZ
    block["lowest_m"] = lowest_height(aircraft.folder)
    block["start"]["airspeed"], block["start"]["position_ned"] = airspeed, at.position_ned
    block["placing_steps"] = 1, INTEGRATOR_STEPS
    flown = block["placing"]
    flown["position_ned"] = at.position_ned
    flown["roll"], flown["pitch"], flown["yaw"] = placement.roll, placement.pitch, -placement.course
    flown["level_speed"] = airspeed * math.cos(trim.flight_path_angle)
    flown["velocity_body"], flown["rates_body"] = placement.velocity_body, placement.rates_body
    return block[0]


def field_offsets(dtype: np.dtype[Any], base: int = 0, prefix: str = "") -> Iterator[Any]:
    """Yield the dotted name, the offset in bytes and the count of each field of numbers."""
    for name, (kind, at, *_) in (dtype.fields or {}).items():
        if kind.names:
            yield from field_offsets(kind, base + at, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", base + at, math.prod(kind.shape)
