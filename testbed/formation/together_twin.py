"""The compiled twin of `together`: the twins of law and middle loop behind one door.

A test holds it to the numpy function. numba compiles it at its first call. Arrays are handed over
one by one: of a record of arrays numba asks the type anew at every call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import bound, twin
from testbed.formation.laws_twin import ages_into
from testbed.formation.middle_loop_twin import middle_into
from testbed.formation.paper_twin import step_into
from testbed.state import Inbox


def ready_together(law, loop, unheeded, patience, rows, own, inbox, measured_s, memory, said):
    return bound(
        _together,
        rows,
        law.table,
        law.known_offsets,
        law.gains,
        law.from_timestamp,
        law.bounds_of_airspeed,
        loop.table,
        loop.airspeed_error_as_printed,
        loop.dt,
        unheeded,
        patience,
        own.position_ned,
        own.velocity_ned,
        own.acceleration_ned,
        own.euler,
        own.airspeed,
        *inbox,
        measured_s,
        *memory,
        *said.command,
        *said.unicycle,
        *said.diagnosis[1:],
        said.age_s,
        more=(0.0,),
    )


@twin
def _together(
    rows,
    table,
    offsets,
    gains,
    from_timestamp,
    bounds_of_airspeed,
    loops,
    as_printed,
    dt,
    unheeded,
    patience,
    position,
    velocity,
    acceleration,
    euler,
    airspeed,
    stamp_s,
    received_s,
    positions,
    velocities,
    accelerations,
    eulers,
    euler_rates,
    measured_s,
    average,
    leader,
    place,
    place_time_s,
    middle,
    pitch,
    roll,
    throttle,
    speed,
    turn,
    speed_desired,
    direction,
    guards,
    speed_command,
    course_desired,
    climb_desired,
    guarded,
    saturations,
    age_s,
    now,
):
    inbox = Inbox(stamp_s, received_s, positions, velocities, accelerations, eulers, euler_rates)
    step_into(
        rows,
        table,
        offsets,
        gains,
        from_timestamp,
        bounds_of_airspeed,
        now,
        position,
        velocity,
        airspeed,
        inbox,
        average,
        leader,
        place,
        place_time_s,
        speed,
        turn,
        speed_desired,
        direction,
        guards,
    )
    middle_into(
        rows,
        loops,
        as_printed,
        dt,
        position,
        velocity,
        acceleration,
        euler,
        airspeed,
        speed,
        turn,
        direction,
        guards,
        middle,
        pitch,
        roll,
        throttle,
        speed_command,
        course_desired,
        climb_desired,
        guarded,
        saturations,
    )
    ages_into(rows, now, measured_s, received_s, unheeded, patience, True, age_s)
