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


def ages(now, stamp_s, received_s, unheeded, limit, needs_leader):
    out = np.empty(stamp_s.shape)
    limits = np.broadcast_to(limit, stamp_s.shape[1:]).copy()
    rows = np.arange(len(stamp_s))
    ages_into(rows, now, stamp_s, received_s, unheeded, limits, needs_leader, out)
    return out


@twin
def ages_into(rows, now, stamp_s, received_s, unheeded, limit, needs_leader, out):
    for k in range(len(rows)):
        i = rows[k]
        out[i] = nan
        for m in range(stamp_s.shape[1]):
            if not unheeded[k, m] and now - received_s[i, m] <= limit[m]:
                out[i, m] = now - stamp_s[i, m]
            elif needs_leader and m == 0:
                break


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
    agent,
    offsets,
    gains,
    from_timestamp,
    inbox,
    own,
    leader,
    slots,
    frame,
    rates,
    places,
    i,
    k,
    now,
):
    """ξ_i and its rate, (6), of agent i, the k-th of those that step.

    own is (q_i, q̇_i), leader (q_g, q̇_g), slots (χ_i, χ̇_i).

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
        gn, ge, gd = gains[k, m, 0], gains[k, m, 1], level * gains[k, m, 2]
        if gn == 0.0 and ge == 0.0 and gd == 0.0:
            continue
        position, velocity = leader
        if m > 0:
            if not silence(inbox, i, m, now, agent.stale_after):
                position, velocity = motion_of(agent, inbox, i, m, now, from_timestamp)
                said = time_of(inbox, i, m, from_timestamp)
                if agent.hold and not said <= place_time_s[k, m]:
                    place_time_s[k, m] = said
                    where = place_of(frame, leader[0], position)
                    place[k, m, 0], place[k, m, 1], place[k, m, 2] = where
            elif agent.hold and not isnan(place[k, m, 0]):
                position, velocity = kept_at(frame, rates, leader, place[k, m])
            else:
                continue
        a, b, c = offsets[k, m]
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
