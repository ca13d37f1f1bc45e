"""The compiled twin of `paper_law.paper_step`: the same equations, agent by agent.

`paper_law`, `laws`, `leader`, `geometry`, `control_function` and `barrier` define what this does; a
test compares the two on thousands of states. numba compiles it at its first call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import atan2, copysign, cos, hypot, isnan, nan, sin, sqrt, tan

import numpy as np

from testbed.compiled import twin
from testbed.formation.barrier import NO_BARRIER
from testbed.formation.geometry import GRAVITY
from testbed.formation.geometry_twin import cross, frame_of, to_ned
from testbed.formation.laws import SLOPE_FLOOR
from testbed.formation.laws_twin import errors_of, h_of, motion_of, mu_of, rows_of, silence, time_of
from testbed.formation.leader import BROADCAST, TURN, Memory
from testbed.formation.paper_law import CLAMPED, OUTSIDE, SILENT
from testbed.state import UnicycleCommand


def paper_step(law, now, own, inbox, memory):
    place, place_time_s = memory.place, memory.place_time_s
    if law.hold:
        place, place_time_s = place.copy(), place_time_s.copy()
    told, acceleration, after = _step(
        law.table,
        law.known_offsets,
        law.gains,
        law.from_timestamp,
        law.bounds_of_airspeed,
        now,
        own,
        inbox,
        memory.acceleration,
        rows_of(memory[1:-2]),
        place,
        place_time_s,
    )
    return told, Memory(acceleration, *after, place, place_time_s)


# The rows of what is remembered beside q̈_g and places, in the order of `leader.Memory`.
TIME, SPEED, CLIMB, SPEED_RATE, CLIMB_RATE, SINCE, COURSE = range(7)


@twin
def _turn_of(v, yd, yd_rate, c):
    """e2ᵀω and e3ᵀω, (15)."""
    cs, ss, cg, sg = frame_of(v[0], v[1], v[2])
    y1, y2, y3 = cg * cs, cg * ss, -sg
    closing = c - (y1 * yd_rate[0] + y2 * yd_rate[1] + y3 * yd_rate[2])
    facing = y1 * yd[0] + y2 * yd[1] + y3 * yd[2]
    w1 = closing * yd[0] + facing * yd_rate[0]
    w2 = closing * yd[1] + facing * yd_rate[1]
    w3 = closing * yd[2] + facing * yd_rate[2]
    return -(sg * cs * w1 + sg * ss * w2 + cg * w3), cs * w2 - ss * w1


@twin
def _leader_acceleration(agent, inbox, average, memory, i, said, frame, acceleration, after):
    """The new average of q̈_g, and what is remembered of the leader, who `said` (s) all this."""
    heard = inbox.velocity_ned[i, 0]
    v = (heard[0], heard[1], 0.0 if agent.horizontal else heard[2])
    speed = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    climb = atan2(-v[2], hypot(v[0], v[1]))
    speed_rate, climb_rate = memory[SPEED_RATE, i], memory[CLIMB_RATE, i]
    since = said - memory[TIME, i]
    if since > 0.0:
        slope = (speed - memory[SPEED, i]) / since
        speed_rate += agent.difference_blend[0] * (slope - speed_rate)
        slope = (climb - memory[CLIMB, i]) / since
        climb_rate += agent.difference_blend[1] * (slope - climb_rate)
    after[TIME, i], after[SPEED, i], after[CLIMB, i] = said, speed, climb
    after[SPEED_RATE, i], after[CLIMB_RATE, i] = speed_rate, climb_rate
    if agent.acceleration_source == TURN:
        cs, ss, cg, sg = frame
        euler = inbox.euler[i, 0]
        turn = GRAVITY * tan(euler[0]) / (speed * cos(euler[1]))
        along, across = speed_rate, speed * turn * cos(climb)
        a, b, c = to_ned(cs, ss, cg, sg, along, across, -speed * climb_rate)
        acceleration[i, 0], acceleration[i, 1], acceleration[i, 2] = a, b, c
        return
    for axis in range(3):
        sample = 0.0
        if agent.acceleration_source == BROADCAST:
            sample = inbox.acceleration_ned[i, 0, axis]
        share = 0.0 if said <= memory[TIME, i] else agent.acceleration_blend[axis]
        acceleration[i, axis] = average[i, axis] + share * (sample - average[i, axis])


@twin
def _step(
    table,
    offsets,
    gains,
    from_timestamp,
    bounds_of_airspeed,
    now,
    own,
    inbox,
    average,
    memory,
    place,
    place_time_s,
):
    n = len(table)
    speed_command, speed_desired = np.empty(n), np.empty(n)
    turn, direction = np.zeros((n, 3)), np.empty((n, 3))
    guards = np.zeros(n, np.uint8)
    # of those that hear their leader no silence is remembered, of those that do not nothing else
    acceleration, after = average.copy(), np.full((7, n), nan)
    for i in range(n):
        agent = table[i]
        level = 0.0 if agent.horizontal else 1.0
        q, heading = own.position_ned[i], own.velocity_ned[i]
        v = (heading[0], heading[1], level * heading[2])
        s = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if silence(inbox, i, 0, now, agent.silent_after):
            begun = isnan(memory[SINCE, i])
            since = now if begun else memory[SINCE, i]
            held = atan2(v[1], v[0]) if begun else memory[COURSE, i]
            after[SPEED_RATE, i] = after[CLIMB_RATE, i] = 0.0
            after[SINCE, i], after[COURSE, i] = since, held
            round_ = agent.silent_turn
            heading_now = held + round_ * (now - since)
            north, east = cos(heading_now), sin(heading_now)
            yd = (north, east, 0.0)
            u = agent.silent_airspeed + s - own.airspeed[i]
            speed_command[i] = speed_desired[i] = u
            c = agent.c + agent.c_speed * u * u
            turn[i, 1], turn[i, 2] = _turn_of(v, yd, (-round_ * east, round_ * north, 0.0), c)
            direction[i, 0], direction[i, 1], direction[i, 2] = yd
            guards[i] = SILENT
            continue

        # The leader's frame and the own slot in it, (22)-(29).
        reckoned = motion_of(agent, inbox, i, 0, now, from_timestamp)
        leader = reckoned[1]
        speed_g = sqrt(leader[0] ** 2 + leader[1] ** 2 + leader[2] ** 2)
        climb = atan2(-leader[2], hypot(leader[0], leader[1]))
        sine, cosine = sin(climb), cos(climb)
        frame = frame_of(leader[0], leader[1], leader[2])
        cs, ss, cg, sg = frame
        rolling = inbox.euler_rates[i, 0, 0]
        climbing, turning = level * inbox.euler_rates[i, 0, 1], inbox.euler_rates[i, 0, 2]
        rates = (-turning * sine, climbing, turning * cosine)
        bending = (0.0, 0.0, 0.0)
        if agent.turn_acceleration:
            euler = inbox.euler[i, 0]
            curl = GRAVITY * rolling / (speed_g * cos(euler[1]) * cos(euler[0]) ** 2)
            bending = (
                -curl * sine - turning * climbing * cosine,
                0.0,
                curl * cosine - turning * climbing * sine,
            )
        x, y, z = offsets[i, agent.row]
        chi = to_ned(cs, ss, cg, sg, x, y, z)
        a, b, c = cross(rates[0], rates[1], rates[2], x, y, z)
        chi_rate = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        x, y, z = cross(bending[0], bending[1], bending[2], x, y, z)
        chi_acceleration = to_ned(cs, ss, cg, sg, a + x, b + y, c + z)
        said = time_of(inbox, i, 0, from_timestamp)
        _leader_acceleration(agent, inbox, average, memory, i, said, frame, acceleration, after)

        # Desired velocity and its rates, (6)-(12).
        (x, y, z), (xr, yr, zr) = errors_of(
            agent,
            offsets,
            gains,
            from_timestamp,
            inbox,
            (q, v),
            reckoned,
            (chi, chi_rate),
            frame,
            rates,
            (place, place_time_s),
            i,
            now,
        )
        mu, mu_slope = mu_of(agent, x * x + y * y + z * z)
        along = 2.0 * mu_slope * (x * xr + y * yr + z * zr)
        k, w = agent.k, acceleration[i]
        p = (
            leader[0] + chi_rate[0] + k * (mu * x),
            leader[1] + chi_rate[1] + k * (mu * y),
            leader[2] + chi_rate[2] + k * (mu * z),
        )
        dp = (
            w[0] + chi_acceleration[0] + k * (mu * xr + along * x),
            w[1] + chi_acceleration[1] + k * (mu * yr + along * y),
            level * w[2] + chi_acceleration[2] + k * (mu * zr + along * z),
        )
        sd = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        yd = (p[0] / sd, p[1] / sd, p[2] / sd)
        sd_rate = yd[0] * dp[0] + yd[1] * dp[1] + yd[2] * dp[2]
        yd_rate = (
            (dp[0] - sd_rate * yd[0]) / sd,
            (dp[1] - sd_rate * yd[1]) / sd,
            (dp[2] - sd_rate * yd[2]) / sd,
        )
        shift = s - own.airspeed[i] if bounds_of_airspeed else 0.0
        low, high = agent.low + shift, agent.high + shift
        clamped = min(max(sd, agent.desired_low + shift), agent.desired_high + shift)
        if clamped != sd:
            guards[i] |= CLAMPED
            sd_rate = 0.0
        sd = clamped

        # u and ω, (14) and (15).
        inside = low < s < high
        if not inside:
            guards[i] |= OUTSIDE
        h, slope = h_of(agent, s, low, high)
        gap = sd - s
        if inside or agent.example == NO_BARRIER:
            u = (agent.b * gap**3 + sd_rate * h + agent.a * gap * h) / (h + gap * slope)
        else:
            u = agent.b * gap**2 / copysign(max(abs(slope), SLOPE_FLOOR), slope)
        speed_command[i] = u / agent.pole + s
        turn[i, 1], turn[i, 2] = _turn_of(v, yd, yd_rate, agent.c + agent.c_speed * sd * sd)
        speed_desired[i] = sd
        direction[i, 0], direction[i, 1], direction[i, 2] = yd
    return (
        UnicycleCommand(speed_command, turn, speed_desired, direction, guards),
        acceleration,
        after,
    )
