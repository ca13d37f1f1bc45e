"""The compiled functions of a block: place the aircraft, fly a period of its autopilot.

Both take a pointer to a block of `aircraft_block` and return a status: 0, or why the aircraft is
not flown on.
"""

from __future__ import annotations

from collections.abc import Callable
from math import asin, cos, sin, sqrt
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types
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
from testbed.core.records import (
    AIRCRAFT,
    Array,
    BoolArray,
    ByteArray,
    Indices,
    NedOrigin,
    Record,
    Records,
    Values,
)
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
_carray: Any = numba.carray  # type: ignore[attr-defined]
_POSITION, _VELOCITY, _ATTITUDE = COLUMN["position"], COLUMN["velocity"], COLUMN["attitude"]
_RATES, _WIND, _EARTH_ANGLE = COLUMN["rates"], COLUMN["wind"], COLUMN["earth_angle"]
_RATIO_2 = (SEMI_MINOR / SEMI_MAJOR) ** 2
_RATES_DOT, _UVW_DOT = COLUMN["rates_dot"], COLUMN["uvw_dot"]


class BlockFunctions(NamedTuple):
    """Functions of a pointer to a block, in Python, for numba; they return a status."""

    place: Callable[[Any], int]
    fly: Callable[[Any], int]


class _Views(NamedTuple):
    """The fields of a block as arrays of one aircraft."""

    aircraft: Records  # (1,) of AIRCRAFT
    row: Array  # (1, S)
    wind: Array  # (1, 7)
    controls: Array  # (1, 4), as the next three
    lead: Array
    last: Array
    first: Array
    numbers: Array  # (1, 17)
    air_columns: Indices  # (5,)
    air: Array  # (1, 5)
    gains: Records  # (1,) of GAINS
    memory: Records  # (1,) of MEMORY
    delay_line: Array  # (1, P, 3)
    start: Records  # (1,) of START
    placing: Records  # (1,) of PLACING
    lowest: Array  # (1,)
    only: Indices  # (1,) 0
    steps: Indices  # (1,)
    placing_steps: Indices  # (2,)
    changed: BoolArray  # (2,)
    status: ByteArray  # (1,)


@_intrinsic  # type: ignore[untyped-decorator]
def _at(typing: Any, block: Any, offset: Any) -> Any:  # noqa: ANN401 - numba's
    """Point to the byte of a block at an offset."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
        return builder.gep(args[0], [args[1]], inbounds=True)

    return _pointer(_pointer, types.intp), make


def _make_views(block: np.dtype[Any]) -> Callable[[Any], _Views]:
    """Return the kernel that views a block of this type."""
    at = {name: block.fields[name][1] for name in block.names or ()} if block.fields else {}
    aircraft, row, wind = at["aircraft"], at["row"], at["wind_numbers"]
    controls, lead, last = at["controls"], at["lead"], at["last_controls"]
    first, numbers = at["first_controls"], at["numbers"]
    air_columns, air = at["air_columns"], at["air_numbers"]
    gains, memory, delay_line = at["gains"], at["memory"], at["delay_line"]
    start, placing, lowest = at["start"], at["placing"], at["lowest_m"]
    only, steps, placing_steps = at["only"], at["steps"], at["placing_steps"]
    changed, status = at["changed"], at["status"]
    columns, periods = block["row"].shape[0], block["delay_line"].shape[0]

    @kernel
    def view(block: Any) -> _Views:  # noqa: ANN401 - an address
        return _Views(
            _carray(_at(block, aircraft), (1,), AIRCRAFT),
            _carray(_at(block, row), (1, columns), np.float64),
            _carray(_at(block, wind), (1, 7), np.float64),
            _carray(_at(block, controls), (1, 4), np.float64),
            _carray(_at(block, lead), (1, 4), np.float64),
            _carray(_at(block, last), (1, 4), np.float64),
            _carray(_at(block, first), (1, 4), np.float64),
            _carray(_at(block, numbers), (1, 17), np.float64),
            _carray(_at(block, air_columns), (5,), np.intp),
            _carray(_at(block, air), (1, 5), np.float64),
            _carray(_at(block, gains), (1,), GAINS),
            _carray(_at(block, memory), (1,), MEMORY),
            _carray(_at(block, delay_line), (1, periods, 3), np.float64),
            _carray(_at(block, start), (1,), START),
            _carray(_at(block, placing), (1,), PLACING),
            _carray(_at(block, lowest), (1,), np.float64),
            _carray(_at(block, only), (1,), np.intp),
            _carray(_at(block, steps), (1,), np.intp),
            _carray(_at(block, placing_steps), (2,), np.intp),
            _carray(_at(block, changed), (2,), np.bool_),
            _carray(_at(block, status), (1,), np.uint8),
        )

    return view


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
    view, run_rows, dt = _make_views(block), aircraft.run_rows, 1.0 / physics_hz
    frame = tuple(local_frame(origin, RADIANS))
    newest, older, attitude_older = _memory_columns(aircraft)
    remembered, turned = len(newest), len(attitude_older)

    def place(block: Any) -> int:  # noqa: ANN401 - an address
        v = view(block)
        start, placing, q = v.start[0], v.placing[0], v.row[0]
        wind, course = v.aircraft[0].wind.wind_ned, start.course
        if not -start.position_ned[2] >= v.lowest[0]:
            return GROUND
        windy = wind[0] != 0.0 or wind[1] != 0.0 or wind[2] != 0.0
        moved = course != 0.0
        for axis in range(3):
            moved = moved or start.position_ned[axis] != placing.position_ned[axis]
        if moved or windy:  # else the row is that of JSBSim, to the bit
            across = wind[1] * cos(course) - wind[0] * sin(course)
            along = wind[0] * cos(course) + wind[1] * sin(course)
            square = placing.level_speed * placing.level_speed - across * across
            if not square > 0.0 or along + sqrt(square) <= 0.0:
                return STRONG_WIND
            yaw = course - asin(across / placing.level_speed) + placing.yaw
            _write_start(v.row, start, placing, wind, yaw, frame, v.numbers[0])
            # twice, as JSBSim does: memories have the derivatives of the first evaluation
            once, settle = v.placing_steps[:1], v.placing_steps[1:]
            inputs = v.wind, v.controls, v.first, v.changed
            run_rows(v.row, *inputs, 0.0, once, v.only, v.status)
            for k in range(remembered):
                q[older[k]] = q[newest[k]]
            attitude = q[_ATTITUDE], q[_ATTITUDE + 1], q[_ATTITUDE + 2], q[_ATTITUDE + 3]
            rate = attitude_rate(attitude, (q[_RATES], q[_RATES + 1], q[_RATES + 2]))
            for k in range(turned):
                q[attitude_older[k]] = rate[k % 4]
            run_rows(v.row, *inputs, 0.0, once, v.only, v.status)
            for axis in range(3):
                q[_WIND + axis] = wind[axis] / FOOT
            if windy:
                run_rows(v.row, *inputs, NO_TIME, settle, v.only, v.status)
            if v.status[0] != 0:
                return int(v.status[0])
        _write_outputs(v, frame)
        return 0

    def fly(block: Any) -> int:  # noqa: ANN401 - an address
        v = view(block)
        own = v.aircraft[0]
        copy_motion(own.truth, own.estimate)
        pack_wind(v.only, v.aircraft, v.wind, v.changed)
        fly_by_wire_a(v.only, v.gains, v.memory, v.delay_line, v.aircraft)
        pack_surfaces(v.only, v.aircraft, v.controls, v.changed)
        lead_controls(v.controls, v.lead, v.last, v.first, v.only)
        inputs = v.wind, v.controls, v.first, v.changed
        run_rows(v.row, *inputs, dt, v.steps, v.only, v.status)
        v.changed[:] = False
        if v.status[0] != 0:
            return int(v.status[0])
        _write_outputs(v, frame)
        if not -own.truth.position_ned[2] >= v.lowest[0]:
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
def _write_outputs(v: _Views, frame: Values) -> None:
    """Write motion and air data of the aircraft from its row."""
    write_motion(v.row, v.only, v.numbers)
    write_truth(v.only, v.numbers, frame, v.aircraft, v.only)
    write_air_numbers(v.row, v.only, v.air_columns, v.air)
    write_air(v.only, v.air, v.aircraft)


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
