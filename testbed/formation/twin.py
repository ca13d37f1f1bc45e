"""The compiled twin of `law.paper_step`: the same equations, agent by agent.

`law`, `laws`, `geometry`, `middle_loop`, `control_function` and `barrier` define what this does; a
test compares the two on thousands of states. numba compiles it at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan, atan2, copysign, cos, floor, hypot, isnan, pi, sin, sqrt

import numpy as np

from testbed.formation import law as numpy_law
from testbed.formation.barrier import NO_BARRIER
from testbed.formation.geometry_twin import cross, frame_of, to_ned, twin
from testbed.formation.laws import SLOPE_FLOOR
from testbed.formation.laws_twin import error_of, h_of, mu_of, velocity_rates
from testbed.formation.middle_loop import (
    GRAVITY,
    PITCH,
    ROLL,
    THROTTLE,
    MiddleLoopGains,
    MiddleLoopMemory,
)
from testbed.state import FbwaCommand

CLAMPED, OUTSIDE, CLIPPED = numpy_law.CLAMPED, numpy_law.OUTSIDE, numpy_law.CLIPPED
Diagnosis, PaperMemory = numpy_law.Diagnosis, numpy_law.PaperMemory


# What each agent is given, in the columns of one array: handing numba an array costs as much as
# computing a dozen of these.
_MIDDLE = MiddleLoopGains._fields
(K, A, B, C, POLE, LOW, HIGH, MARGIN, RATE_BLEND) = range(9)
(
    CLIMB_P,
    CLIMB_I,
    CLIMB_D,
    COURSE_P,
    COURSE_I,
    COURSE_D,
    SPEED_P,
    SPEED_I,
    ETA_SPEED,
    ETA_BANK,
    TRIM_THROTTLE,
    TRIM_AIRSPEED,
    PITCH_LIMIT,
    ROLL_LIMIT,
) = range(9, 9 + len(_MIDDLE))

_held = [None, None]  # the law that stepped last and its columns: a run steps one law


def _columns(law):
    if _held[0] is not law:
        speeds, own = law.speeds, (law.k, law.a, law.b, law.c, law.pole)
        bounds = (speeds.low, speeds.high, speeds.margin)
        _held[:] = law, np.column_stack([*own, *bounds, law.rate_blend, *law.middle])
    return _held[1]


def paper_step(law, now, own, inbox, memory):
    return _step(
        _columns(law),
        law.offsets,
        law.gains,
        law.control_function,
        law.barrier,
        law.dt,
        law.from_timestamp,
        law.airspeed_error_as_printed,
        law.acceleration_blend,
        now,
        own,
        inbox,
        memory,
    )


@twin
def _integrate(integral, error, dt, command, low, high):
    limited = min(max(command, low), high)
    if limited != command and (command > limited) == (error < 0.0):
        return limited, integral
    return limited, integral + dt * error


@twin
def _step(
    numbers,
    offsets,
    gains,
    control_function,
    barrier,
    dt,
    from_timestamp,
    as_printed,
    acceleration_blend,
    now,
    own,
    inbox,
    memory,
):
    n = len(numbers)
    pitch, roll, throttle = np.empty(n), np.empty(n), np.empty(n)
    climb_integral, course_integral, speed_integral = np.empty(n), np.empty(n), np.empty(n)
    acceleration = np.empty((n, 3))
    course_rates, climb_rates = np.empty(n), np.empty(n)
    speed_desired, speed_command = np.empty(n), np.empty(n)
    course_desired, climb_desired = np.empty(n), np.empty(n)
    guards, saturations = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
    for i in range(n):
        gain = numbers[i]
        q, v = own.position_ned[i], own.velocity_ned[i]
        deaf = isnan(inbox.stamp_s[i, 0])

        # The leader's frame and the own slot in it, (22)-(29).
        leader = v if deaf else inbox.velocity_ned[i, 0]
        frame = frame_of(leader[0], leader[1], leader[2])
        cs, ss, cg, sg = frame
        turn = 0.0 if deaf else inbox.euler_rates[i, 0, 2]
        rates = (
            -turn * sin(atan2(-leader[2], hypot(leader[0], leader[1]))),
            0.0 if deaf else inbox.euler_rates[i, 0, 1],
            turn * cos(atan2(-leader[2], hypot(leader[0], leader[1]))),
        )
        a, b, c = offsets[i + 1]
        slot = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        slot_velocity = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        slot_acceleration = to_ned(cs, ss, cg, sg, a, b, c)

        # Desired velocity and its rates, (6)-(12).
        x, y, z = error_of(offsets, gains, from_timestamp, inbox, q, slot, frame, rates, i, now, 0)
        xr, yr, zr = error_of(
            offsets, gains, from_timestamp, inbox, v, slot_velocity, frame, rates, i, now, 1
        )
        mu, mu_slope = mu_of(control_function, x * x + y * y + z * z)
        along = 2.0 * mu_slope * (x * xr + y * yr + z * zr)
        k = gain[K]
        p = (
            leader[0] + slot_velocity[0] + k * (mu * x),
            leader[1] + slot_velocity[1] + k * (mu * y),
            leader[2] + slot_velocity[2] + k * (mu * z),
        )
        for axis in range(3):
            heard = 0.0 if deaf else inbox.acceleration_ned[i, 0, axis]
            last = memory.leader_acceleration[i, axis]
            acceleration[i, axis] = last + acceleration_blend[axis] * (heard - last)
        w = acceleration[i]
        dp = (
            w[0] + slot_acceleration[0] + k * (mu * xr + along * x),
            w[1] + slot_acceleration[1] + k * (mu * yr + along * y),
            w[2] + slot_acceleration[2] + k * (mu * zr + along * z),
        )
        sd = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        yd = (p[0] / sd, p[1] / sd, p[2] / sd)
        sd_rate = yd[0] * dp[0] + yd[1] * dp[1] + yd[2] * dp[2]
        yd_rate = (
            (dp[0] - sd_rate * yd[0]) / sd,
            (dp[1] - sd_rate * yd[1]) / sd,
            (dp[2] - sd_rate * yd[2]) / sd,
        )
        low, high, margin = gain[LOW], gain[HIGH], gain[MARGIN]
        clamped = min(max(sd, low + margin), high - margin)
        if clamped != sd:
            guards[i] |= CLAMPED
            sd_rate = 0.0
        sd = clamped

        # u and ω, (14) and (15).
        s = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        inside = low < s < high
        if not inside:
            guards[i] |= OUTSIDE
        h, slope = h_of(barrier, s, low, high)
        gap = sd - s
        if inside or barrier.example == NO_BARRIER:
            u = (gain[B] * gap**3 + sd_rate * h + gain[A] * gap * h) / (h + gap * slope)
        else:
            u = gain[B] * gap**2 / copysign(max(abs(slope), SLOPE_FLOOR), slope)
        u = u / gain[POLE] + s
        ocs, oss, ocg, osg = frame_of(v[0], v[1], v[2])
        y1, y2, y3 = ocg * ocs, ocg * oss, -osg
        closing = gain[C] - (y1 * yd_rate[0] + y2 * yd_rate[1] + y3 * yd_rate[2])
        facing = y1 * yd[0] + y2 * yd[1] + y3 * yd[2]
        w1 = closing * yd[0] + facing * yd_rate[0]
        w2 = closing * yd[1] + facing * yd_rate[1]
        w3 = closing * yd[2] + facing * yd_rate[2]
        pitching = -(osg * ocs * w1 + osg * oss * w2 + ocg * w3)
        yawing = ocs * w2 - oss * w1

        # The guard on the commanded airspeed, then the middle loop, (19)-(21).
        wanted = u + own.airspeed[i] - s
        command = min(max(wanted, low), high)
        if command != wanted:
            guards[i] |= CLIPPED
        course_rate, climb_rate = velocity_rates(v, own.acceleration_ned[i])
        blend = gain[RATE_BLEND]
        course_rate = memory.course_rate[i] + blend * (course_rate - memory.course_rate[i])
        climb_rate = memory.climb_rate[i] + blend * (climb_rate - memory.climb_rate[i])
        climb = atan2(-v[2], hypot(v[0], v[1]))
        cd, gd = atan2(yd[1], yd[0]), atan2(-yd[2], hypot(yd[0], yd[1]))
        turn_desired = yawing / cos(climb)
        climb_error = climb - gd
        ahead = pi - (atan2(v[1], v[0]) - cd)
        course_error = pi - (ahead - 2.0 * pi * floor(ahead / (2.0 * pi)))
        speed_error = own.airspeed[i] - (u if as_printed else command)
        theta = (
            gd
            - gain[CLIMB_P] * climb_error
            - gain[CLIMB_I] * memory.integrals.climb[i]
            - gain[CLIMB_D] * (climb_rate - pitching)
        )
        phi = (
            atan(turn_desired * s * cos(climb) / GRAVITY)
            - gain[COURSE_P] * course_error
            - gain[COURSE_I] * memory.integrals.course[i]
            - gain[COURSE_D] * (course_rate - turn_desired)
        )
        power = (
            gain[TRIM_THROTTLE]
            + gain[ETA_BANK] * (cos(own.euler[i, 0]) ** -2 - 1.0)
            + gain[ETA_SPEED] * (command - gain[TRIM_AIRSPEED])
            - gain[SPEED_P] * speed_error
            - gain[SPEED_I] * memory.integrals.speed[i]
        )
        limit, bank_limit = gain[PITCH_LIMIT], gain[ROLL_LIMIT]
        pitch[i], climb_integral[i] = _integrate(
            memory.integrals.climb[i], climb_error, dt, theta, -limit, limit
        )
        roll[i], course_integral[i] = _integrate(
            memory.integrals.course[i], course_error, dt, phi, -bank_limit, bank_limit
        )
        throttle[i], speed_integral[i] = _integrate(
            memory.integrals.speed[i], speed_error, dt, power, 0.0, 1.0
        )
        saturations[i] = (
            (pitch[i] != theta) * PITCH
            + (roll[i] != phi) * ROLL
            + (throttle[i] != power) * THROTTLE
        )
        if deaf:
            pitch[i], roll[i], throttle[i] = 0.0, 0.0, gain[TRIM_THROTTLE]
            climb_integral[i], course_integral[i], speed_integral[i] = 0.0, 0.0, 0.0
        course_rates[i], climb_rates[i] = course_rate, climb_rate
        speed_desired[i], speed_command[i] = sd, command
        course_desired[i], climb_desired[i] = cd, gd
    return (
        FbwaCommand(pitch, roll, throttle),
        PaperMemory(
            MiddleLoopMemory(climb_integral, course_integral, speed_integral),
            acceleration,
            course_rates,
            climb_rates,
        ),
        Diagnosis(
            speed_desired,
            speed_command,
            course_desired,
            climb_desired,
            guards,
            saturations,
            now - inbox.stamp_s,
        ),
    )
