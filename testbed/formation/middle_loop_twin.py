"""The compiled twin of `middle_loop.middle_step`: (19)-(21) agent by agent.

`middle_loop` defines what this does; a test compares the two. numba compiles it at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN202, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan, atan2, cos, floor, hypot, isnan, pi, sin, sqrt

import numpy as np

from testbed.compiled import twin
from testbed.formation.geometry import GRAVITY
from testbed.formation.law import Diagnosis
from testbed.formation.laws_twin import velocity_rates
from testbed.formation.middle_loop import (
    CLIPPED,
    PITCH,
    ROLL,
    THROTTLE,
    MiddleLoopMemory,
)
from testbed.state import FbwaCommand


def middle_step(loop, own, told, memory):
    n = len(loop.altitude)
    command, after, floats = np.empty((3, n)), np.array(memory), np.empty((3, n))
    guards, saturations = np.empty((2, n), np.uint8)
    middle_into(
        np.arange(n),
        loop.table,
        loop.airspeed_error_as_printed,
        loop.dt,
        own.position_ned,
        own.velocity_ned,
        own.acceleration_ned,
        own.euler,
        own.airspeed,
        told.speed,
        told.turn,
        told.direction,
        told.guards,
        after,
        command[0],
        command[1],
        command[2],
        floats[0],
        floats[1],
        floats[2],
        guards,
        saturations,
    )
    diagnosis = Diagnosis(told.speed_desired, *floats, guards, saturations)
    return FbwaCommand(*command), MiddleLoopMemory(*after), diagnosis


@twin
def _average(last, sample, share):
    return sample if isnan(last) else last + share * (sample - last)


@twin
def _integrate(integral, error, dt, command, low, high):
    limited = min(max(command, low), high)
    if limited != command and (command > limited) == (error < 0.0):
        return limited, integral
    return limited, integral + dt * error


@twin
def middle_into(
    rows,
    table,
    as_printed,
    dt,
    position,
    velocity,
    acceleration,
    euler,
    airspeeds,
    speeds,
    turns,
    direction,
    told_guards,
    memory,
    pitch,
    roll,
    throttle,
    speed_command,
    course_desired,
    climb_desired,
    guards,
    saturations,
):
    """Of the agents in these rows; what is remembered changes in place, as does what they say."""
    for k in range(len(rows)):
        i = rows[k]
        g, y, sinking = table[k], direction[i], velocity[i, 2]
        holding = not isnan(g.altitude)
        v = (velocity[i, 0], velocity[i, 1], 0.0 if holding else sinking)
        s = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        airspeed, bank = airspeeds[i], euler[i, 0]
        unguarded = speeds[i] + airspeed - s
        command = min(max(unguarded, g.speed_low), g.speed_high)
        course_rate, climb_rate = velocity_rates(v, acceleration[i])
        share = dt / (dt + g.rate_filter)
        course_rate = _average(memory[4, k], course_rate, share)
        climb_rate = _average(memory[5, k], climb_rate, share)
        climb = atan2(-v[2], hypot(v[0], v[1]))
        gd, cd = atan2(-y[2], hypot(y[0], y[1])), atan2(y[1], y[0])

        climb_error = climb - gd
        path = (
            gd
            - g.climb_p * climb_error
            - g.climb_i * memory[0, k]
            - g.climb_d * (climb_rate - turns[i, 1])
            + g.incidence * (euler[i, 1] - climb)
            + g.turn_incidence * (1.0 / cos(bank) - 1.0)
        )
        height_error = -position[i, 2] - g.altitude if holding else 0.0
        hold = -g.altitude_p * height_error - g.altitude_i * memory[3, k] + g.altitude_d * sinking

        turn = turns[i, 2] / cos(climb)
        turn_bank = atan(turn * s * cos(climb) / GRAVITY)
        last = memory[6, k]
        slope = 0.0 if isnan(last) else (turn_bank - last) / dt
        slope_before = memory[7, k]
        slope = slope_before + dt / (dt + g.lead_filter) * (slope - slope_before)
        ahead = pi - (atan2(v[1], v[0]) - cd)
        course_error = pi - (ahead - 2.0 * pi * floor(ahead / (2.0 * pi)))
        phi = (
            turn_bank
            + g.roll_lead * slope
            - g.course_p * course_error
            - g.course_i * memory[1, k]
            - g.course_d * (course_rate - turn)
        )

        error = airspeed - (speeds[i] if as_printed else command)
        power = (
            g.trim_throttle
            + g.eta_bank * (cos(bank) ** -2 - 1.0)
            + g.eta_speed * (command - g.trim_airspeed)
            + g.eta_climb * sin(gd)
            - g.speed_p * error
            - g.speed_i * memory[2, k]
        )

        limit = g.pitch_limit
        theta, climb_integral = _integrate(memory[0, k], climb_error, dt, path, -limit, limit)
        level, altitude_integral = _integrate(memory[3, k], height_error, dt, hold, -limit, limit)
        wanted = hold if holding else path
        pitch[i] = level if holding else theta
        limit = g.roll_limit
        roll[i], course_integral = _integrate(memory[1, k], course_error, dt, phi, -limit, limit)
        throttle[i], speed_integral = _integrate(memory[2, k], error, dt, power, 0.0, 1.0)
        memory[0, k] = 0.0 if holding else climb_integral
        memory[1, k], memory[2, k], memory[3, k] = (
            course_integral,
            speed_integral,
            altitude_integral,
        )
        memory[4, k], memory[5, k] = course_rate, climb_rate
        memory[6, k], memory[7, k] = turn_bank, slope
        saturations[i] = (
            (pitch[i] != wanted) * PITCH
            + (roll[i] != phi) * ROLL
            + (throttle[i] != power) * THROTTLE
        )
        guards[i] = told_guards[i] | (CLIPPED if command != unguarded else 0)
        speed_command[i], course_desired[i], climb_desired[i] = command, cd, gd
