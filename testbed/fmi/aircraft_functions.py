"""The compiled functions of a block: place the aircraft, fly a period of its autopilot.

Both take a pointer to a block of `aircraft_block` and return a status: 0, or why the aircraft is
not flown on.
"""

from __future__ import annotations

from collections.abc import Callable
from math import asin, cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import carray, types
from numba.extending import intrinsic

from testbed.autopilot.fbwa import GAINS, MEMORY, fly_by_wire_a
from testbed.compiled.columns import START as COLUMN
from testbed.compiled.compiled_aircraft import CompiledAircraft
from testbed.compiled.frame import (
    EARTH_RATE,
    SEMI_MAJOR,
    SEMI_MINOR,
    add,
    attitude_rate,
    earth_rates,
    matrix_of,
    rotate_back,
)
from testbed.compiled.rows import write_air as write_air_numbers
from testbed.compiled.rows import write_attitude, write_motion
from testbed.core.compile import kernel
from testbed.core.copies import copy_motion
from testbed.core.frames import FOOT, rotation_rows
from testbed.core.geodetic import RADIANS, LocalFrame, local_frame, to_geodetic
from testbed.core.records import AIRCRAFT, Array, NedOrigin, Record, Values
from testbed.fmi.aircraft_block import PLACING, START
from testbed.vehicle.jsbsim_io import (
    lead_controls,
    pack_surfaces,
    pack_wind,
    write_air,
    write_truth,
)
from testbed.vehicle.jsbsim_model import NO_TIME

# Status of a block, behind those of `model_limits`.
GROUND = 3  # so low that the ground may touch the aircraft
STRONG_WIND = 4  # at the start: no course through the air gives that over the ground

_pointer: Any = types.voidptr
_intrinsic: Any = intrinsic
_POSITION, _VELOCITY, _ATTITUDE = COLUMN["position"], COLUMN["velocity"], COLUMN["attitude"]
_RATES, _WIND, _EARTH_ANGLE = COLUMN["rates"], COLUMN["wind"], COLUMN["earth_angle"]
_RATIO_2 = (SEMI_MINOR / SEMI_MAJOR) ** 2
_RATES_DOT, _UVW_DOT = COLUMN["rates_dot"], COLUMN["uvw_dot"]


class BlockFunctions(NamedTuple):
    """Functions of a block, in Python, for numba."""

    place: Callable[[Any], int]
    fly: Callable[[Any], int]


@_intrinsic
def _at(typing: Any, block: Any, offset: Any) -> Any:  # noqa: ANN401 - numba's
    """Point to the byte of a block at an offset."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        return builder.gep(args[0], [args[1]], inbounds=True)

    return _pointer(_pointer, types.intp), make


def make_functions(
    aircraft: CompiledAircraft, block: np.dtype[Any], origin: NedOrigin, physics_hz: int
) -> BlockFunctions:
    """Return the functions of the blocks of an aircraft.

    Args:
        aircraft: the flight model.
        block: type of its blocks.
        origin: of the local frame.
        physics_hz: steps of the flight model per second.
    """
    at = {name: (block.fields or {})[name][1] for name in block.names or ()}
    aircraft_at, row_at, wind_at = at["aircraft"], at["row"], at["wind_numbers"]
    controls_at, lead_at, last_at = at["controls"], at["lead"], at["last_controls"]
    first_at, numbers_at, air_at = at["first_controls"], at["numbers"], at["air_numbers"]
    columns_at, gains_at, memory_at = at["air_columns"], at["gains"], at["memory"]
    delay_at, start_at, placing_at = at["delay_line"], at["start"], at["placing"]
    only_at, steps_at, placing_steps_at = at["only"], at["steps"], at["placing_steps"]
    changed_at, status_at, lowest_at = at["changed"], at["status"], at["lowest_m"]
    columns, periods = block["row"].shape[0], block["delay_line"].shape[0]
    run_rows, dt = aircraft.run_rows, 1.0 / physics_hz
    frame = tuple(local_frame(origin, RADIANS))
    newest, older, attitude_older = _memory_columns(aircraft)
    remembered, turned = len(newest), len(attitude_older)

    def place(block: Any) -> int:  # noqa: ANN401 - an address
        own = carray(_at(block, aircraft_at), (1,), AIRCRAFT)
        row = carray(_at(block, row_at), (1, columns), np.float64)
        wind = carray(_at(block, wind_at), (1, 7), np.float64)
        controls = carray(_at(block, controls_at), (1, 4), np.float64)
        first = carray(_at(block, first_at), (1, 4), np.float64)
        numbers = carray(_at(block, numbers_at), (1, 17), np.float64)
        air_columns = carray(_at(block, columns_at), (5,), np.intp)
        air = carray(_at(block, air_at), (1, 5), np.float64)
        start = carray(_at(block, start_at), (1,), START)
        placing = carray(_at(block, placing_at), (1,), PLACING)
        lowest = carray(_at(block, lowest_at), (1,), np.float64)
        only = carray(_at(block, only_at), (1,), np.intp)
        once = carray(_at(block, placing_steps_at), (1,), np.intp)
        settle = carray(_at(block, placing_steps_at + 8), (1,), np.intp)
        changed = carray(_at(block, changed_at), (2,), np.bool_)
        status = carray(_at(block, status_at), (1,), np.uint8)
        s, q, p = start[0], row[0], placing[0]
        w = own[0].wind.wind_ned
        windy = w[0] != 0.0 or w[1] != 0.0 or w[2] != 0.0
        moved = s.course != 0.0
        for axis in range(3):
            moved = moved or s.position_ned[axis] != p.position_ned[axis]
        if not -s.position_ned[2] >= lowest[0]:
            return GROUND
        if moved or windy:
            across = w[1] * cos(s.course) - w[0] * sin(s.course)
            along = w[0] * cos(s.course) + w[1] * sin(s.course)
            square = p.level_speed * p.level_speed - across * across
            if not square > 0.0 or along + sqrt(square) <= 0.0:
                return STRONG_WIND
            yaw = s.course - asin(across / p.level_speed) + p.yaw
            _write_start(row, s, p, w, yaw, frame, numbers[0])
            run_rows(row, wind, controls, first, changed, 0.0, once, only, status)
            for k in range(remembered):
                q[older[k]] = q[newest[k]]
            d = attitude_rate(
                (q[_ATTITUDE], q[_ATTITUDE + 1], q[_ATTITUDE + 2], q[_ATTITUDE + 3]),
                (q[_RATES], q[_RATES + 1], q[_RATES + 2]),
            )
            for k in range(turned):
                q[attitude_older[k]] = d[k % 4]
            run_rows(row, wind, controls, first, changed, 0.0, once, only, status)
            for axis in range(3):
                q[_WIND + axis] = w[axis] / FOOT
            if windy:
                run_rows(row, wind, controls, first, changed, NO_TIME, settle, only, status)
            if status[0] != 0:
                return int(status[0])
        _write_outputs(row, only, numbers, frame, own, air_columns, air)
        return 0

    def fly(block: Any) -> int:  # noqa: ANN401 - an address
        own = carray(_at(block, aircraft_at), (1,), AIRCRAFT)
        row = carray(_at(block, row_at), (1, columns), np.float64)
        wind = carray(_at(block, wind_at), (1, 7), np.float64)
        controls = carray(_at(block, controls_at), (1, 4), np.float64)
        lead = carray(_at(block, lead_at), (1, 4), np.float64)
        last = carray(_at(block, last_at), (1, 4), np.float64)
        first = carray(_at(block, first_at), (1, 4), np.float64)
        numbers = carray(_at(block, numbers_at), (1, 17), np.float64)
        air_columns = carray(_at(block, columns_at), (5,), np.intp)
        air = carray(_at(block, air_at), (1, 5), np.float64)
        gains = carray(_at(block, gains_at), (1,), GAINS)
        memory = carray(_at(block, memory_at), (1,), MEMORY)
        delay_line = carray(_at(block, delay_at), (1, periods, 3), np.float64)
        lowest = carray(_at(block, lowest_at), (1,), np.float64)
        only = carray(_at(block, only_at), (1,), np.intp)
        steps = carray(_at(block, steps_at), (1,), np.intp)
        changed = carray(_at(block, changed_at), (2,), np.bool_)
        status = carray(_at(block, status_at), (1,), np.uint8)
        copy_motion(own[0].truth, own[0].estimate)
        pack_wind(only, own, wind, changed)
        fly_by_wire_a(only, gains, memory, delay_line, own)
        pack_surfaces(only, own, controls, changed)
        lead_controls(controls, lead, last, first, only)
        run_rows(row, wind, controls, first, changed, dt, steps, only, status)
        changed[0] = changed[1] = False
        if status[0] != 0:
            return int(status[0])
        _write_outputs(row, only, numbers, frame, own, air_columns, air)
        if not -own[0].truth.position_ned[2] >= lowest[0]:
            return GROUND
        return 0

    return BlockFunctions(place, fly)


def _memory_columns(aircraft: CompiledAircraft) -> tuple[tuple[int, ...], ...]:
    """Return where a row has derivatives, their older values, and those of the attitude."""
    newest, older, attitude = list[int](), list[int](), list[int]()
    for name, olds in aircraft.memories.items():
        for columns in olds:
            places = [aircraft.columns[each] for each in columns]
            if name in COLUMN:
                newest += range(COLUMN[name], COLUMN[name] + len(places))
                older += places
            else:  # a row has no newest derivative of the attitude
                attitude += places
    return tuple(newest), tuple(older), tuple(attitude)


@kernel
def _write_outputs(
    row: Array,
    only: Array,
    numbers: Array,
    frame: Values,
    own: Record,
    air_columns: Array,
    air: Array,
) -> None:
    """Write motion and air data of the aircraft from its row."""
    write_motion(row, only, numbers)
    write_truth(only, numbers, frame, own, only)
    write_air_numbers(row, only, air_columns, air)
    write_air(only, air, own)


@kernel
def _write_start(
    row: Array,
    start: Record,
    placing: Record,
    wind: Array,
    yaw: float,
    frame: Values,
    attitude: Array,
) -> None:
    """Write position, attitude, velocity and rates of a start into a row (1, S).

    As JSBSim's initial condition does, in another order of operations.

    Args:
        row: of the aircraft in trim; written.
        start: record of START.
        placing: record of PLACING.
        wind: (3,) m/s, velocity of the air.
        yaw: rad.
        frame: see `write_truth`.
        attitude: at least 4 numbers, which are written.
    """
    q = row[0]
    local = LocalFrame(*frame)
    north, east, down = start.position_ned[0], start.position_ned[1], start.position_ned[2]
    p = placing.position_ned
    if north != p[0] or east != p[1] or down != p[2]:
        latitude, longitude, height = to_geodetic(local, north, east, down)
        sine, cosine = sin(latitude), cos(latitude)
        normal = SEMI_MAJOR / sqrt(cosine * cosine + _RATIO_2 * sine * sine)  # ft, radius
        around = longitude + q[_EARTH_ANGLE]
        q[_POSITION] = (normal + height / FOOT) * cosine * cos(around)
        q[_POSITION + 1] = (normal + height / FOOT) * cosine * sin(around)
        q[_POSITION + 2] = (normal * _RATIO_2 + height / FOOT) * sine
    # half angles of roll, pitch and yaw
    cr, sr = cos(0.5 * placing.roll), sin(0.5 * placing.roll)
    cp, sp = cos(0.5 * placing.pitch), sin(0.5 * placing.pitch)
    cy, sy = cos(0.5 * yaw), sin(0.5 * yaw)
    attitude[0] = cr * cp * cy + sr * sp * sy
    attitude[1] = sr * cp * cy - cr * sp * sy
    attitude[2] = cr * sp * cy + sr * cp * sy
    attitude[3] = cr * cp * sy - sr * sp * cy
    write_attitude(row, 0, attitude)
    t_bi = matrix_of((q[_ATTITUDE], q[_ATTITUDE + 1], q[_ATTITUDE + 2], q[_ATTITUDE + 3]))
    turn = earth_rates(t_bi)
    rows = rotation_rows((placing.roll, placing.pitch, yaw))
    for axis in range(3):
        q[_RATES + axis] = placing.rates_body[axis] + turn[axis]
    air = rotate_back(rows, (wind[0], wind[1], wind[2]))
    u, v, w = add(air, placing.velocity_body)
    over = rotate_back(t_bi, (u / FOOT, v / FOOT, w / FOOT))
    q[_VELOCITY] = over[0] - EARTH_RATE * q[_POSITION + 1]
    q[_VELOCITY + 1] = over[1] + EARTH_RATE * q[_POSITION]
    q[_VELOCITY + 2] = over[2]
    for axis in range(3):  # the aircraft was held until its propeller had settled
        q[_RATES_DOT + axis] = 0.0
        q[_UVW_DOT + axis] = 0.0
