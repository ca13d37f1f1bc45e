"""The compiled twins of `laws.formation_error`, `control_function.mu`, `barrier.h` and of rates.

For one agent each; a test holds them to the numpy functions through `paper_law.paper_step`. The
agent is its record of `paper_law.AGENT`.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import isnan, nan, sqrt, tanh

import numpy as np

from testbed.compiled import twin
from testbed.formation.barrier import NO_BARRIER
from testbed.formation.geometry_twin import cross, to_ned
from testbed.frames import COURSE_FLOOR


def rows_of(record):
    """Arrays (n,) as the rows of one array: handing numba each by itself costs more.

    Those that a twin gave are such rows already.
    """
    whole = record[0].base
    if isinstance(whole, np.ndarray) and whole.shape == (len(record), len(record[0])):
        if all(each.base is whole for each in record):
            return whole
    return np.array(record)


@twin
def mu_of(agent, z):
    if not agent.spline:
        base = agent.nu1 + agent.nu2 * z
        value = base**-agent.m
        return value, (-agent.m * agent.nu2) * value / base
    if z > agent.far:
        value = z**-0.5
        return value, -0.5 * value**3
    past = max(z - agent.flat, 0.0)
    return (
        1.0 + past * past * (agent.nu1 + agent.nu2 * past),
        past * (2.0 * agent.nu1 + 3.0 * agent.nu2 * past),
    )


@twin
def h_of(agent, s, low, high):
    nu = agent.nu
    if agent.example == NO_BARRIER:
        return 1.0, 0.0
    if agent.example == 6:
        past = (max(s + nu - high, 0.0) - max(low + nu - s, 0.0)) / nu
        return 1.0 - past * past, -2.0 * past / nu
    value, slope = nu * (high - s) * (s - low), nu * (high + low - 2.0 * s)
    if agent.example == 5:
        value = tanh(value)
        slope *= 1.0 - value * value
    return value, slope


@twin
def velocity_rates(v, a):
    along, across = v[0] * a[0] + v[1] * a[1], v[0] * a[1] - v[1] * a[0]
    square = max(v[0] * v[0] + v[1] * v[1], COURSE_FLOOR)
    horizontal = sqrt(square)
    climb = (v[2] * along / horizontal - horizontal * a[2]) / (square + v[2] * v[2])
    return across / square, climb


@twin
def silence(inbox, i, m, now, limit):
    return isnan(inbox.stamp_s[i, m]) or now - inbox.received_s[i, m] > limit


@twin
def ages(now, stamp_s, received_s, unheeded, limit, needs_leader):
    out = np.full(stamp_s.shape, nan)
    limits = np.broadcast_to(limit, stamp_s.shape)
    for i in range(stamp_s.shape[0]):
        for m in range(stamp_s.shape[1]):
            if not unheeded[i, m] and now - received_s[i, m] <= limits[i, m]:
                out[i, m] = now - stamp_s[i, m]
            elif needs_leader and m == 0:
                break
    return out


@twin
def time_of(inbox, i, m, from_timestamp):
    return inbox.stamp_s[i, m] if from_timestamp else inbox.received_s[i, m]


@twin
def motion_of(agent, inbox, i, m, now, from_timestamp):
    """Position and velocity of aircraft m as agent i reckons it, sec. 8.3; level for some."""
    lag = now - time_of(inbox, i, m, from_timestamp)
    q, v, a = inbox.position_ned[i, m], inbox.velocity_ned[i, m], inbox.acceleration_ned[i, m]
    gain = lag if agent.with_acceleration else 0.0
    x, y, z = gain * a[0], gain * a[1], gain * a[2]
    level = 0.0 if agent.horizontal else 1.0
    return (
        (
            q[0] + lag * v[0] + 0.5 * lag * x,
            q[1] + lag * v[1] + 0.5 * lag * y,
            q[2] + lag * v[2] + 0.5 * lag * z,
        ),
        (v[0] + x, v[1] + y, level * (v[2] + z)),
    )


@twin
def place_of(frame, leader, position):
    """`measurement.places` for one position."""
    cs, ss, cg, sg = frame
    x, y, z = position[0] - leader[0], position[1] - leader[1], position[2] - leader[2]
    return cg * cs * x + cg * ss * y - sg * z, cs * y - ss * x, sg * cs * x + sg * ss * y + cg * z


@twin
def kept_at(frame, rates, leader, place):
    """`measurement.kept` for one place; leader is (q_g, q̇_g)."""
    cs, ss, cg, sg = frame
    (x, y, z), (u, v, w) = leader
    a, b, c = place
    da, db, dc = cross(rates[0], rates[1], rates[2], a, b, c)
    a, b, c = to_ned(cs, ss, cg, sg, a, b, c)
    da, db, dc = to_ned(cs, ss, cg, sg, da, db, dc)
    return (x + a, y + b, z + c), (u + da, v + db, w + dc)


@twin
def errors_of(
    agent, offsets, gains, from_timestamp, inbox, own, leader, slots, frame, rates, places, i, now
):
    """ξ_i and its rate, (6); own is (q_i, q̇_i), leader (q_g, q̇_g), slots (χ_i, χ̇_i).

    Writes the places of neighbours that say something new and the times of that, if they are to
    be held.
    """
    place, place_time_s = places
    cs, ss, cg, sg = frame
    q, v = own
    chi, chi_rate = slots
    level = 0.0 if agent.horizontal else 1.0
    x = y = z = xr = yr = zr = 0.0
    for m in range(gains.shape[1]):
        gn, ge, gd = gains[i, m, 0], gains[i, m, 1], level * gains[i, m, 2]
        if gn == 0.0 and ge == 0.0 and gd == 0.0:
            continue
        position, velocity = leader
        if m > 0:
            if not silence(inbox, i, m, now, agent.stale_after):
                position, velocity = motion_of(agent, inbox, i, m, now, from_timestamp)
                said = time_of(inbox, i, m, from_timestamp)
                if agent.hold and not said <= place_time_s[i, m]:
                    place_time_s[i, m] = said
                    where = place_of(frame, leader[0], position)
                    place[i, m, 0], place[i, m, 1], place[i, m, 2] = where
            elif agent.hold and not isnan(place[i, m, 0]):
                position, velocity = kept_at(frame, rates, leader, place[i, m])
            else:
                continue
        a, b, c = offsets[i, m]
        da, db, dc = cross(rates[0], rates[1], rates[2], a, b, c)
        a, b, c = to_ned(cs, ss, cg, sg, a, b, c)
        da, db, dc = to_ned(cs, ss, cg, sg, da, db, dc)
        x += gn * ((position[0] - a) - (q[0] - chi[0]))
        y += ge * ((position[1] - b) - (q[1] - chi[1]))
        z += gd * ((position[2] - c) - (q[2] - chi[2]))
        xr += gn * ((velocity[0] - da) - (v[0] - chi_rate[0]))
        yr += ge * ((velocity[1] - db) - (v[1] - chi_rate[1]))
        zr += gd * ((velocity[2] - dc) - (v[2] - chi_rate[2]))
    return (x, y, z), (xr, yr, zr)
