"""Which hypotheses of [HBH23] hold, as far as a world tells before it flies.

(C1) and (C2) need no check here: `control_function.example_1` refuses what breaks them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from testbed.formation.barrier import NO_BARRIER, Barrier, h
from testbed.formation.laws import SLOPE_FLOOR, SpeedSet
from testbed.state import Array

GRID = 2001  # speeds at which a barrier is looked at, on S and to either side
OUTSIDE = 5.0  # how far past the bounds that is, m/s; nobody is meant to fly there


class Finding(NamedTuple):
    """A hypothesis that does not hold, or may not."""

    agent: int  # row of the follower
    about: str  # key of the page that it is about
    number: float  # how far off: the unit and the sign are said in the text
    text: str  # one sentence with what to write instead


def by_text(findings: Iterable[Finding]) -> dict[str, list[int]]:
    """The agents of which the same is said, by what is said, in order of appearance."""
    agents: dict[str, list[int]] = {}
    for finding in findings:
        agents.setdefault(finding.text, []).append(finding.agent)
    return agents


def margin(k: Array, kappa: Array, bound: float | Array) -> Array:
    """ε = κ − k ρ̄ (n,) m/s: how far the desired speed stays from the bounds, fact 1."""
    return kappa - k * bound


def check_gain(k: Array, kappa: Array, bound: float | Array) -> list[Finding]:
    """That k < κ/ρ̄, as [HBH23] eq. (7) demands; the number is ε, m/s.

    Args:
        k: (n,) m/s over ρ̄.
        kappa: κ (n,) m/s.
        bound: ρ̄, for all agents or (n,).
    """
    left, bounds = margin(k, kappa, bound), np.broadcast_to(bound, k.shape)
    return [
        Finding(
            i,
            "formation.k",
            float(left[i]),
            f"k = {k[i]:g} is not below kappa / rho_bar = {kappa[i] / bounds[i]:.4g}: unclamped, "
            f"s_d may lie {-left[i]:.3g} m/s beyond the speed bounds (write a formation.k below "
            f"{kappa[i] / bounds[i]:.4g}, or a formation.kappa_mps above {k[i] * bounds[i]:.4g})",
        )
        for i in np.flatnonzero(~(left > 0.0)).tolist()
    ]


def check_kappa(kappa: Array, low: Array, high: Array) -> list[Finding]:
    """That there are speeds in (s_lo + κ, s_hi − κ); the number is how many m/s of them.

    Args:
        kappa: κ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
    """
    room = high - low - 2.0 * kappa
    return [
        Finding(
            i,
            "formation.kappa_mps",
            float(room[i]),
            f"kappa = {kappa[i]:g} m/s leaves no speed between {low[i]:g} + kappa and {high[i]:g} "
            "- kappa: no leader can be followed within the speed bounds (write a "
            f"formation.kappa_mps below {(high[i] - low[i]) / 2.0:g}, or a wider "
            "formation.speed_mps)",
        )
        for i in np.flatnonzero(~(room > 0.0)).tolist()
    ]


def check_barrier(barrier: Barrier, speeds: SpeedSet) -> list[Finding]:
    """(B1)-(B5) for every agent, on S x S_d and up to 5 m/s outside S.

    Where S_d lies in S every ν > 0 keeps all five in examples 4 and 5, and every ν up to half the
    width of S in example 6. Example 4: the divisor h(s) + (s_d − s) h'(s) of (14) is
    h(s_d) + ν (s_d − s)². Example 5: times cosh² it is at least that, as sinh 2w >= 2w. Example 6
    is concave, so that no tangent lies below it and the divisor is at least h(s_d).

    Example 5 also keeps (B3) and (B4), but only in exact arithmetic: outside S its slope soon
    drops below the smallest that the law divides by. That is a finding where it happens within
    those 5 m/s. Example 7, h = 1, breaks (B2)-(B4) by design: one finding says so.
    """
    count = len(speeds.low)
    example = np.broadcast_to(barrier.example, count)
    nu = np.broadcast_to(barrier.nu, count)
    return [
        Finding(i, "formation.barrier", number, text)
        for i in range(count)
        for number, text in _broken(
            Barrier(int(example[i]), float(nu[i])), *(float(each[i]) for each in speeds)
        )
    ]


def _broken(
    barrier: Barrier, low: float, high: float, desired_low: float, desired_high: float
) -> Iterator[tuple[float, str]]:
    """What one agent's barrier breaks: a number and a sentence each."""
    if barrier.example == NO_BARRIER:
        # h outside S, where (B2) wants it negative
        yield (
            1.0,
            "no barrier: speeds are kept by saturation instead, and nothing proves that they stay "
            "within the speed bounds (write formation.barrier: {example: 5, nu: 0.05} for a "
            "barrier)",
        )
        return
    if barrier.example == 6 and 2.0 * float(barrier.nu) > high - low:
        yield (
            float(barrier.nu),
            f"nu = {barrier.nu:g} m/s is more than half the width of the speed set: the two ends "
            f"of barrier 6 overlap, and its slope is wrong between {high - barrier.nu:g} and "
            f"{low + barrier.nu:g} m/s (write a nu of formation.barrier up to "
            f"{(high - low) / 2.0:g})",
        )
        return

    def at(s: Array) -> tuple[Array, Array]:
        return h(barrier, s, np.full_like(s, low), np.full_like(s, high))

    inside = np.linspace(low, high, GRID)[1:-1]
    below = np.linspace(low, max(low - OUTSIDE, 0.0), GRID)
    above = np.linspace(high, high + OUTSIDE, GRID)
    value, slope = at(inside)
    value_below, slope_below = at(below)
    value_above, slope_above = at(above)
    signs = [  # positive where the condition holds
        ("(B1)", "h", 1.0, inside, value),
        ("(B2)", "h", -1.0, below[1:], -value_below[1:]),
        ("(B2)", "h", -1.0, above[1:], -value_above[1:]),
        ("(B3)", "h'", -1.0, above, -slope_above),
        ("(B4)", "h'", 1.0, below, slope_below),
    ]
    for name, what, sign, s, good in signs:
        floor = -SLOPE_FLOOR if what == "h'" else 0.0
        if (good <= floor).any():
            worst = int(good.argmin())
            number = sign * float(good[worst])
            yield (
                number,
                f"{name} fails: {what} of barrier {barrier.example} is {number:.3g} at "
                f"{s[worst]:.4g} m/s (write a positive nu of formation.barrier)",
            )
    if float(barrier.nu) > 0.0:
        yield from _flat(barrier, above - high, slope_above)
    # The divisor is affine in s_d: its smallest value lies at an end of S_d.
    for s_d in (desired_low, desired_high):
        divisor = value + (s_d - inside) * slope
        bad = np.flatnonzero(divisor <= 0.0)
        if bad.size:
            worst = int(divisor.argmin())
            yield (
                float(divisor[worst]),
                f"(B5) fails: towards s_d = {s_d:.4g} m/s the divisor of the speed control is down "
                f"to {divisor[worst]:.3g}, and not positive from {inside[bad[0]]:.4g} to "
                f"{inside[bad[-1]]:.4g} m/s (write a smaller formation.k, a larger "
                "formation.kappa_mps, or formation.speed_desired_mps within the speed bounds)",
            )


def _flat(barrier: Barrier, past: Array, slope: Array) -> Iterator[tuple[float, str]]:
    """Where the slope is too small to divide by, `past` (m/s) the bounds; both ends are alike."""
    flat = np.abs(slope) < SLOPE_FLOOR
    if flat.any():
        distance = float(past[flat.argmax()])
        yield (
            distance,
            f"barrier {barrier.example} with nu = {barrier.nu:g} is flat to machine precision from "
            f"{distance:.2g} m/s past the speed bounds: farther out only the clip on the commanded "
            "airspeed acts (write a smaller nu of formation.barrier)",
        )


def largest_kappa(slowest: Array, fastest: Array, low: Array, high: Array) -> Array:
    """The κ (n,) m/s below which Assumption 1 holds; where it is not positive, for none.

    Args:
        slowest: smallest ‖q̇_g + χ̇_i‖ (n,) m/s.
        fastest: largest ‖q̇_g + χ̇_i‖ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
    """
    return np.minimum(slowest - low, high - fastest)


def check_slot_speed(
    slowest: Array, fastest: Array, kappa: Array, low: Array, high: Array, *, possible: bool
) -> list[Finding]:
    """Assumption 1: ‖q̇_g + χ̇_i‖ stays in (s_lo + κ, s_hi − κ); the number is `largest_kappa`.

    Args:
        slowest: smallest ‖q̇_g + χ̇_i‖ (n,) m/s.
        fastest: largest ‖q̇_g + χ̇_i‖ (n,) m/s.
        kappa: κ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
        possible: these speeds are what the leader's limits allow (`slot_speed_range`), not what
            it is known to fly (`slot_speed`).
    """
    room = largest_kappa(slowest, fastest, low, high)
    return [
        Finding(
            i,
            "formation.kappa_mps",
            float(room[i]),
            f"the slot {'may move' if possible else 'moves'} at {slowest[i]:.2f} to "
            f"{fastest[i]:.2f} m/s over the ground, but Assumption 1 with kappa = {kappa[i]:g} "
            f"wants it between {low[i] + kappa[i]:g} and {high[i] - kappa[i]:g} "
            f"(write {_remedy(float(room[i]))}a wider formation.speed_mps, or a leader that turns "
            "wider)",
        )
        for i in np.flatnonzero(~(room > kappa)).tolist()
    ]


def _remedy(room: float) -> str:
    """The κ to write, rounded down so that it lies below the largest; none if that is nothing."""
    kappa = (math.ceil(100.0 * room) - 1) / 100.0
    return f"formation.kappa_mps: {kappa:g}, " if kappa > 0.0 else ""
