"""The compiled twin of `law.paper_step`: the same equations, agent by agent.

`law`, `laws`, `geometry`, `middle_loop`, `control_function` and `barrier` define what this does; a
test compares the two on thousands of states. numba compiles it at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan, atan2, copysign, cos, floor, hypot, isnan, pi, sin, sqrt, tanh

import numpy as np

from testbed.formation import law as numpy_law
from testbed.formation.barrier import NO_BARRIER
from testbed.formation.geometry import COURSE_FLOOR
from testbed.formation.geometry_twin import cross, frame_of, to_ned, twin
from testbed.formation.laws import SLOPE_FLOOR
from testbed.formation.middle_loop import GRAVITY, PITCH, ROLL, THROTTLE, MiddleLoopMemory
from testbed.state import FbwaCommand

CLAMPED, OUTSIDE, CLIPPED = numpy_law.CLAMPED, numpy_law.OUTSIDE, numpy_law.CLIPPED
Diagnosis, PaperMemory = numpy_law.Diagnosis, numpy_law.PaperMemory


@twin
def _mu(function, z):
    if not function.spline:
        base = function.nu1 + function.nu2 * z
        value = base**-function.m
        return value, (-function.m * function.nu2) * value / base
    if z > function.far:
        value = z**-0.5
        return value, -0.5 * value**3
    past = max(z - function.flat, 0.0)
    return (
        1.0 + past * past * (function.nu1 + function.nu2 * past),
        past * (2.0 * function.nu1 + 3.0 * function.nu2 * past),
    )


@twin
def _h(barrier, s, low, high):
    nu = barrier.nu
    if barrier.example == NO_BARRIER:
        return 1.0, 0.0
    if barrier.example == 6:
        past = (max(s + nu - high, 0.0) - max(low + nu - s, 0.0)) / nu
        return 1.0 - past * past, -2.0 * past / nu
    value, slope = nu * (high - s) * (s - low), nu * (high + low - 2.0 * s)
    if barrier.example == 5:
        value = tanh(value)
        slope *= 1.0 - value * value
    return value, slope


@twin
def _velocity_rates(v, a):
    along, across = v[0] * a[0] + v[1] * a[1], v[0] * a[1] - v[1] * a[0]
    square = max(v[0] * v[0] + v[1] * v[1], COURSE_FLOOR)
    horizontal = sqrt(square)
    climb = (v[2] * along / horizontal - horizontal * a[2]) / (square + v[2] * v[2])
    return across / square, climb


@twin
def _integrate(integral, error, dt, command, low, high):
    limited = min(max(command, low), high)
    if limited != command and (command > limited) == (error < 0.0):
        return limited, integral
    return limited, integral + dt * error


@twin
def _error(law, inbox, own, slot, frame, rates, i, now, level):
    """ξ_i for level 0, its rate for level 1, (6); own is q_i or q̇_i, slot χ_i or χ̇_i."""
    cs, ss, cg, sg = frame
    x = y = z = 0.0
    for m in range(law.gains.shape[1]):
        if isnan(inbox.stamp_s[i, m]):
            continue
        a, b, c = law.offsets[m]
        if level == 1:
            a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        a, b, c = to_ned(cs, ss, cg, sg, a, b, c)
        velocity = inbox.velocity_ned[i, m]
        if level == 1:
            u, v, w = velocity[0], velocity[1], velocity[2]
        else:
            since = inbox.stamp_s[i, m] if law.from_timestamp else inbox.received_s[i, m]
            position, lag = inbox.position_ned[i, m], now - since
            u = position[0] + lag * velocity[0]
            v = position[1] + lag * velocity[1]
            w = position[2] + lag * velocity[2]
        gain = law.gains[i, m]
        x += gain[0] * ((u - a) - (own[0] - slot[0]))
        y += gain[1] * ((v - b) - (own[1] - slot[1]))
        z += gain[2] * ((w - c) - (own[2] - slot[2]))
    return x, y, z


@twin
def paper_step(law, now, own, inbox, memory):
    n = len(law.k)
    pitch, roll, throttle = np.empty(n), np.empty(n), np.empty(n)
    climb_integral, course_integral, speed_integral = np.empty(n), np.empty(n), np.empty(n)
    acceleration = np.empty((n, 3))
    course_rates, climb_rates = np.empty(n), np.empty(n)
    speed_desired, speed_command = np.empty(n), np.empty(n)
    course_desired, climb_desired = np.empty(n), np.empty(n)
    guards, saturations = np.zeros(n, np.uint8), np.zeros(n, np.uint8)
    middle = law.middle
    for i in range(n):
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
        a, b, c = law.offsets[i + 1]
        slot = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        slot_velocity = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        slot_acceleration = to_ned(cs, ss, cg, sg, a, b, c)

        # Desired velocity and its rates, (6)-(12).
        x, y, z = _error(law, inbox, q, slot, frame, rates, i, now, 0)
        xr, yr, zr = _error(law, inbox, v, slot_velocity, frame, rates, i, now, 1)
        mu, mu_slope = _mu(law.control_function, x * x + y * y + z * z)
        along = 2.0 * mu_slope * (x * xr + y * yr + z * zr)
        k = law.k[i]
        p = (
            leader[0] + slot_velocity[0] + k * (mu * x),
            leader[1] + slot_velocity[1] + k * (mu * y),
            leader[2] + slot_velocity[2] + k * (mu * z),
        )
        for axis in range(3):
            heard = 0.0 if deaf else inbox.acceleration_ned[i, 0, axis]
            last = memory.leader_acceleration[i, axis]
            acceleration[i, axis] = last + law.acceleration_blend[axis] * (heard - last)
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
        low, high, margin = law.speeds.low[i], law.speeds.high[i], law.speeds.margin[i]
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
        h, slope = _h(law.barrier, s, low, high)
        gap = sd - s
        if inside or law.barrier.example == NO_BARRIER:
            u = (law.b[i] * gap**3 + sd_rate * h + law.a[i] * gap * h) / (h + gap * slope)
        else:
            u = law.b[i] * gap**2 / copysign(max(abs(slope), SLOPE_FLOOR), slope)
        u = u / law.pole[i] + s
        ocs, oss, ocg, osg = frame_of(v[0], v[1], v[2])
        y1, y2, y3 = ocg * ocs, ocg * oss, -osg
        closing = law.c[i] - (y1 * yd_rate[0] + y2 * yd_rate[1] + y3 * yd_rate[2])
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
        course_rate, climb_rate = _velocity_rates(v, own.acceleration_ned[i])
        blend = law.rate_blend[i]
        course_rate = memory.course_rate[i] + blend * (course_rate - memory.course_rate[i])
        climb_rate = memory.climb_rate[i] + blend * (climb_rate - memory.climb_rate[i])
        climb = atan2(-v[2], hypot(v[0], v[1]))
        cd, gd = atan2(yd[1], yd[0]), atan2(-yd[2], hypot(yd[0], yd[1]))
        turn_desired = yawing / cos(climb)
        climb_error = climb - gd
        ahead = pi - (atan2(v[1], v[0]) - cd)
        course_error = pi - (ahead - 2.0 * pi * floor(ahead / (2.0 * pi)))
        speed_error = own.airspeed[i] - (u if law.airspeed_error_as_printed else command)
        theta = (
            gd
            - middle.climb_p[i] * climb_error
            - middle.climb_i[i] * memory.integrals.climb[i]
            - middle.climb_d[i] * (climb_rate - pitching)
        )
        phi = (
            atan(turn_desired * s * cos(climb) / GRAVITY)
            - middle.course_p[i] * course_error
            - middle.course_i[i] * memory.integrals.course[i]
            - middle.course_d[i] * (course_rate - turn_desired)
        )
        power = (
            middle.trim_throttle[i]
            + middle.eta_bank[i] * (cos(own.euler[i, 0]) ** -2 - 1.0)
            + middle.eta_speed[i] * (command - middle.trim_airspeed[i])
            - middle.speed_p[i] * speed_error
            - middle.speed_i[i] * memory.integrals.speed[i]
        )
        limit, bank_limit = middle.pitch_limit[i], middle.roll_limit[i]
        pitch[i], climb_integral[i] = _integrate(
            memory.integrals.climb[i], climb_error, law.dt, theta, -limit, limit
        )
        roll[i], course_integral[i] = _integrate(
            memory.integrals.course[i], course_error, law.dt, phi, -bank_limit, bank_limit
        )
        throttle[i], speed_integral[i] = _integrate(
            memory.integrals.speed[i], speed_error, law.dt, power, 0.0, 1.0
        )
        saturations[i] = (
            (pitch[i] != theta) * PITCH
            + (roll[i] != phi) * ROLL
            + (throttle[i] != power) * THROTTLE
        )
        if deaf:
            pitch[i], roll[i], throttle[i] = 0.0, 0.0, middle.trim_throttle[i]
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
