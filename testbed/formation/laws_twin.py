"""The compiled twins of `laws.formation_error`, `control_function.mu`, `barrier.h` and of rates.

For one agent each; a test holds them to the numpy functions through `law.paper_step`.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import isnan, sqrt, tanh

from testbed.formation.barrier import NO_BARRIER
from testbed.formation.geometry import COURSE_FLOOR
from testbed.formation.geometry_twin import cross, to_ned, twin


@twin
def mu_of(function, z):
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
def h_of(barrier, s, low, high):
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
def velocity_rates(v, a):
    along, across = v[0] * a[0] + v[1] * a[1], v[0] * a[1] - v[1] * a[0]
    square = max(v[0] * v[0] + v[1] * v[1], COURSE_FLOOR)
    horizontal = sqrt(square)
    climb = (v[2] * along / horizontal - horizontal * a[2]) / (square + v[2] * v[2])
    return across / square, climb


@twin
def error_of(offsets, gains, from_timestamp, inbox, own, slot, frame, rates, i, now, level):
    """ξ_i for level 0, its rate for level 1, (6); own is q_i or q̇_i, slot χ_i or χ̇_i."""
    cs, ss, cg, sg = frame
    x = y = z = 0.0
    for m in range(gains.shape[1]):
        if isnan(inbox.stamp_s[i, m]):
            continue
        a, b, c = offsets[m]
        if level == 1:
            a, b, c = cross(rates[0], rates[1], rates[2], a, b, c)
        a, b, c = to_ned(cs, ss, cg, sg, a, b, c)
        velocity = inbox.velocity_ned[i, m]
        if level == 1:
            u, v, w = velocity[0], velocity[1], velocity[2]
        else:
            since = inbox.stamp_s[i, m] if from_timestamp else inbox.received_s[i, m]
            position, lag = inbox.position_ned[i, m], now - since
            u = position[0] + lag * velocity[0]
            v = position[1] + lag * velocity[1]
            w = position[2] + lag * velocity[2]
        gain = gains[i, m]
        x += gain[0] * ((u - a) - (own[0] - slot[0]))
        y += gain[1] * ((v - b) - (own[1] - slot[1]))
        z += gain[2] * ((w - c) - (own[2] - slot[2]))
    return x, y, z
