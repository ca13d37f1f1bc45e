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
from testbed.formation.laws_twin import errors_of, h_of, motion_of, mu_of, silence, time_of
from testbed.formation.leader import BROADCAST, TURN, Memory
from testbed.formation.paper_law import CLAMPED, OUTSIDE, SILENT
from testbed.state import UnicycleCommand


def paper_step(law, now, own, inbox, memory):
    n = len(law.k)
    after = Memory(*(each.copy() for each in memory))
    remembered = np.array(memory[1:-2])
    floats, vectors, guards = np.empty((2, n)), np.empty((2, n, 3)), np.empty(n, np.uint8)
    step_into(
        np.arange(n),
        law.table,
        law.known_offsets,
        law.gains,
        law.from_timestamp,
        law.bounds_of_airspeed,
        now,
        own.position_ned,
        own.velocity_ned,
        own.airspeed,
        inbox,
        after.acceleration,
        remembered,
        after.place,
        after.place_time_s,
        floats[0],
        vectors[0],
        floats[1],
        vectors[1],
        guards,
    )
    told = UnicycleCommand(floats[0], vectors[0], floats[1], vectors[1], guards)
    return told, Memory(after.acceleration, *remembered, after.place, after.place_time_s)


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
def _leader_acceleration(agent, inbox, memory, i, k, said, frame, average, after):
    """The new average of q̈_g, and what is remembered of the leader, who `said` (s) all this.

    Of agent i, the k-th of those that step; memory is what it remembered.
    """
    heard = inbox.velocity_ned[i, 0]
    v = (heard[0], heard[1], 0.0 if agent.horizontal else heard[2])
    speed = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    climb = atan2(-v[2], hypot(v[0], v[1]))
    speed_rate, climb_rate = memory[SPEED_RATE], memory[CLIMB_RATE]
    since = said - memory[TIME]
    if since > 0.0:
        slope = (speed - memory[SPEED]) / since
        speed_rate += agent.difference_blend[0] * (slope - speed_rate)
        slope = (climb - memory[CLIMB]) / since
        climb_rate += agent.difference_blend[1] * (slope - climb_rate)
    after[TIME, k], after[SPEED, k], after[CLIMB, k] = said, speed, climb
    after[SPEED_RATE, k], after[CLIMB_RATE, k] = speed_rate, climb_rate
    if agent.acceleration_source == TURN:
        cs, ss, cg, sg = frame
        euler = inbox.euler[i, 0]
        turn = GRAVITY * tan(euler[0]) / (speed * cos(euler[1]))
        along, across = speed_rate, speed * turn * cos(climb)
        a, b, c = to_ned(cs, ss, cg, sg, along, across, -speed * climb_rate)
        average[k, 0], average[k, 1], average[k, 2] = a, b, c
        return
    for axis in range(3):
        sample = 0.0
        if agent.acceleration_source == BROADCAST:
            sample = inbox.acceleration_ned[i, 0, axis]
        share = 0.0 if said <= memory[TIME] else agent.acceleration_blend[axis]
        average[k, axis] += share * (sample - average[k, axis])


@twin
def step_into(
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
    acceleration,
    remembered,
    place,
    place_time_s,
    speed_command,
    turn,
    speed_desired,
    direction,
    guards,
):
    """Of the agents in these rows; what is remembered changes in place, as does what they say."""
    for k in range(len(rows)):
        i, agent = rows[k], table[k]
        memory = (
            remembered[TIME, k],
            remembered[SPEED, k],
            remembered[CLIMB, k],
            remembered[SPEED_RATE, k],
            remembered[CLIMB_RATE, k],
            remembered[SINCE, k],
            remembered[COURSE, k],
        )
        # of those that hear their leader no silence is remembered, of the others nothing else
        remembered[:, k] = nan
        turn[i, 0], guards[i] = 0.0, 0
        level = 0.0 if agent.horizontal else 1.0
        q, heading = position[i], velocity[i]
        v = (heading[0], heading[1], level * heading[2])
        s = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if silence(inbox, i, 0, now, agent.silent_after):
            begun = isnan(memory[SINCE])
            since = now if begun else memory[SINCE]
            held = atan2(v[1], v[0]) if begun else memory[COURSE]
            remembered[SPEED_RATE, k] = remembered[CLIMB_RATE, k] = 0.0
            remembered[SINCE, k], remembered[COURSE, k] = since, held
            round_ = agent.silent_turn
            heading_now = held + round_ * (now - since)
            north, east = cos(heading_now), sin(heading_now)
            yd = (north, east, 0.0)
            u = agent.silent_airspeed + s - airspeed[i]
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
        x, y, z = offsets[k, agent.row]
        chi = to_ned(cs, ss, cg, sg, x, y, z)
        a, b, c = cross(rates[0], rates[1], rates[2], x, y, z)
        chi_rate = to_ned(cs, ss, cg, sg, a, b, c)
        a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        x, y, z = cross(bending[0], bending[1], bending[2], x, y, z)
        chi_acceleration = to_ned(cs, ss, cg, sg, a + x, b + y, c + z)
        said = time_of(inbox, i, 0, from_timestamp)
        _leader_acceleration(agent, inbox, memory, i, k, said, frame, acceleration, remembered)

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
            k,
            now,
        )
        mu, mu_slope = mu_of(agent, x * x + y * y + z * z)
        along = 2.0 * mu_slope * (x * xr + y * yr + z * zr)
        gain, w = agent.k, acceleration[k]
        p = (
            leader[0] + chi_rate[0] + gain * (mu * x),
            leader[1] + chi_rate[1] + gain * (mu * y),
            leader[2] + chi_rate[2] + gain * (mu * z),
        )
        dp = (
            w[0] + chi_acceleration[0] + gain * (mu * xr + along * x),
            w[1] + chi_acceleration[1] + gain * (mu * yr + along * y),
            level * w[2] + chi_acceleration[2] + gain * (mu * zr + along * z),
        )
        sd = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
        yd = (p[0] / sd, p[1] / sd, p[2] / sd)
        sd_rate = yd[0] * dp[0] + yd[1] * dp[1] + yd[2] * dp[2]
        yd_rate = (
            (dp[0] - sd_rate * yd[0]) / sd,
            (dp[1] - sd_rate * yd[1]) / sd,
            (dp[2] - sd_rate * yd[2]) / sd,
        )
        shift = s - airspeed[i] if bounds_of_airspeed else 0.0
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
