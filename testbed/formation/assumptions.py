"""Checks of the hypotheses of [HBH23] before a flight.

`control_function.example_1` and `control_function.make_own` check (C1) and (C2).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array
from testbed.formation.barrier import NO_BARRIER, OUTSIDE, SpeedBarrier, UserBarrier, barrier_curve
from testbed.formation.hbh23 import SLOPE_FLOOR

GRID = 2001  # speeds at which a barrier is checked, on S and on either side


class SpeedSet(NamedTuple):
    """Bounds of S and S_d of n agents, m/s, (n,) each."""

    min: Array  # s_lo
    max: Array  # s_hi
    desired_min: Array  # s_lo + ε, with ε = κ − k ρ̄ by fact 1
    desired_max: Array  # s_hi − ε


class Finding(NamedTuple):
    """A hypothesis that does not hold, or may not."""

    agent: int  # row of the follower
    about: str  # key of the scenario
    number: float  # margin or violation; the text has its unit
    text: str  # one sentence with what to write instead


def by_text(findings: Iterable[Finding]) -> dict[str, list[int]]:
    """Group agents by the text of their findings, in order of appearance."""
    agents: dict[str, list[int]] = {}
    for finding in findings:
        agents.setdefault(finding.text, []).append(finding.agent)
    return agents


def margin(k: Array, kappa: Array, bound: float | Array) -> Array:
    """Return ε = κ − k ρ̄ (n,), m/s, the margin of fact 1.

    It is the distance of the desired speed from the bounds.
    """
    return kappa - k * bound


def check_gain(k: Array, kappa: Array, bound: float | Array) -> list[Finding]:
    """Check that k < κ/ρ̄, as [HBH23] eq. (7) requires; the number is ε, m/s.

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
    """Check that (s_lo + κ, s_hi − κ) is not empty.

    The number is its width, m/s.

    Args:
        kappa: κ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
    """
    width = high - low - 2.0 * kappa
    return [
        Finding(
            i,
            "formation.kappa_mps",
            float(width[i]),
            f"kappa = {kappa[i]:g} m/s leaves no speed between {low[i]:g} + kappa and {high[i]:g} "
            "- kappa: no leader can be followed within the speed bounds (write a "
            f"formation.kappa_mps below {(high[i] - low[i]) / 2.0:g}, or a wider "
            "formation.speed_mps)",
        )
        for i in np.flatnonzero(~(width > 0.0)).tolist()
    ]


def check_barrier(
    barriers: Sequence[SpeedBarrier | UserBarrier], speeds: SpeedSet
) -> list[Finding]:
    """Check (B1)-(B5) on S x S_d and up to 5 m/s outside S.

    If S_d is in S, all five hold in examples 4 and 5 for every ν > 0, and in example 6 for every ν
    up to half the width of S. Example 4: the divisor h(s) + (s_d − s) h'(s) of (14) is
    h(s_d) + ν (s_d − s)². Example 5: times cosh² it is at least that, as sinh 2w >= 2w. Example 6
    is concave, so that no tangent lies below it and the divisor is at least h(s_d).

    Example 5 satisfies (B3) and (B4) only in exact arithmetic: outside S its slope soon falls below
    the smallest that the law divides by. That is a finding if it happens within those 5 m/s.
    Example 7, h = 1, violates (B2)-(B4) by design, which is one finding.
    """
    return [
        Finding(i, "formation.barrier", number, text)
        for i, barrier in enumerate(barriers)
        for number, text in _broken(barrier, *(float(each[i]) for each in speeds))
    ]


def _broken(
    barrier: SpeedBarrier | UserBarrier,
    low: float,
    high: float,
    desired_low: float,
    desired_high: float,
) -> Iterator[tuple[float, str]]:
    """Yield the conditions that one agent's barrier violates: a number and a text each."""
    if isinstance(barrier, UserBarrier):
        shown, smallest, remedy = "h", SLOPE_FLOOR, "change the function"
    else:
        unusable = list(_unusable(barrier, low, high))
        if unusable:
            yield from unusable
            return
        # an underflow of the slope is a finding of its own
        shown, smallest = f"h of barrier {barrier.example}", -SLOPE_FLOOR
        remedy = "write a positive nu of formation.barrier"

    def at(s: Array) -> tuple[Array, Array]:
        return barrier_curve(barrier, s, low, high)

    inside = np.linspace(low, high, GRID)[1:-1]
    below = np.linspace(low, max(low - OUTSIDE, 0.0), GRID)
    above = np.linspace(high, high + OUTSIDE, GRID)
    value, slope = at(inside)
    value_below, slope_below = at(below)
    value_above, slope_above = at(above)
    signs = [  # positive where the condition holds
        ("(B1)", "", 1.0, inside, value),
        ("(B2)", "", -1.0, below[1:], -value_below[1:]),
        ("(B2)", "", -1.0, above[1:], -value_above[1:]),
        ("(B3)", "'", -1.0, above, -slope_above),
        ("(B4)", "'", 1.0, below, slope_below),
    ]
    for name, prime, sign, s, good in signs:
        if (good <= (smallest if prime else 0.0)).any():
            worst = int(good.argmin())
            number = sign * float(good[worst])
            yield (
                number,
                f"{name} fails: {shown.replace('h', f'h{prime}', 1)} is {number:.3g} at "
                f"{s[worst]:.4g} m/s ({remedy})",
            )
    if isinstance(barrier, SpeedBarrier) and float(barrier.nu) > 0.0:
        yield from _flat(barrier, above - high, slope_above)
    # the divisor is affine in s_d: it is smallest at an end of S_d
    for s_d in (desired_low, desired_high):
        divisor = value + (s_d - inside) * slope
        bad = np.flatnonzero(divisor <= 0.0)
        if bad.size:
            worst = int(divisor.argmin())
            yield (
                float(divisor[worst]),
                f"(B5) fails: towards s_d = {s_d:.4g} m/s the divisor of the speed control is "
                f"{divisor[worst]:.3g} at worst, and not positive from {inside[bad[0]]:.4g} to "
                f"{inside[bad[-1]]:.4g} m/s (write a smaller formation.k, a larger "
                "formation.kappa_mps, or formation.speed_desired_mps within the speed bounds)",
            )


def _unusable(barrier: SpeedBarrier, low: float, high: float) -> Iterator[tuple[float, str]]:
    """Yield why a barrier of the paper cannot be used on a speed range, m/s."""
    if barrier.example == NO_BARRIER:
        # h outside S, where (B2) requires h < 0
        yield (
            1.0,
            "no barrier: speeds are limited by saturation, without a proof that they stay within "
            "the speed bounds (write formation.barrier: {example: 5, nu: 0.05} for a "
            "barrier)",
        )
    if barrier.example == 6 and 2.0 * float(barrier.nu) > high - low:
        yield (
            float(barrier.nu),
            f"nu = {barrier.nu:g} m/s is more than half the width of the speed set: the two ends "
            f"of barrier 6 overlap, and its slope is wrong between {high - barrier.nu:g} and "
            f"{low + barrier.nu:g} m/s (write a nu of formation.barrier up to "
            f"{(high - low) / 2.0:g})",
        )


def _flat(barrier: SpeedBarrier, past: Array, slope: Array) -> Iterator[tuple[float, str]]:
    """Yield the distance past the bounds at which the slope underflows, m/s."""
    flat = np.abs(slope) < SLOPE_FLOOR
    if flat.any():
        distance = float(past[flat.argmax()])
        yield (
            distance,
            f"barrier {barrier.example} with nu = {barrier.nu:g} is flat to machine precision from "
            f"{distance:.2g} m/s past the speed bounds: farther out only the limit on the "
            "commanded airspeed acts (write a smaller nu of formation.barrier)",
        )


def largest_kappa(slowest: Array, fastest: Array, low: Array, high: Array) -> Array:
    """Return the κ (n,), m/s, below which Assumption 1 holds; not positive: for none.

    Args:
        slowest: smallest ‖q̇_g + χ̇_i‖ (n,) m/s.
        fastest: largest ‖q̇_g + χ̇_i‖ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
    """
    return np.minimum(slowest - low, high - fastest)


def check_slot_speed(
    slowest: Array,
    fastest: Array,
    kappa: Array,
    low: Array,
    high: Array,
    *,
    possible: bool,
    medium: str = "over the ground",
    in_air: tuple[Array, Array] | None = None,
) -> list[Finding]:
    """Check Assumption 1, ‖q̇_g + χ̇_i‖ in (s_lo + κ, s_hi − κ).

    The number is `largest_kappa`.

    Args:
        slowest: smallest ‖q̇_g + χ̇_i‖ (n,) m/s.
        fastest: largest ‖q̇_g + χ̇_i‖ (n,) m/s.
        kappa: κ (n,) m/s.
        low: s_lo (n,) m/s.
        high: s_hi (n,) m/s.
        possible: the speeds are those that the leader's limits allow (`slot_speed_range`), not
            those of its known path (`slot_speed`).
        medium: of the speeds: "over the ground" or "through the air".
        in_air: slowest and fastest through the air, where these are over the ground and a wind
            adds to them; None: no wind, or it does not matter.
    """
    limit = largest_kappa(slowest, fastest, low, high)
    without_wind = limit if in_air is None else largest_kappa(*in_air, low, high)
    moves, found = "may move" if possible else "moves", []
    for i in np.flatnonzero(~(limit > kappa)).tolist():
        text = f"the slot {moves} at {slowest[i]:.2f} to {fastest[i]:.2f} m/s {medium}"
        windy = without_wind[i] > limit[i]
        if windy and limit[i] <= 0.0:
            text += (
                f" in this wind, beyond the speed bounds of {low[i]:g} to {high[i]:g} m/s, "
                "where no follower can hold it (write controller.bounded_speed: airspeed)"
            )
        else:
            text += " in this wind" if windy else ""
            text += (
                f", but Assumption 1 with kappa = {kappa[i]:g} requires {low[i] + kappa[i]:g} to "
                f"{high[i] - kappa[i]:g} (write "
                f"{'controller.bounded_speed: airspeed, ' if windy else ''}"
                f"{_remedy(float(limit[i]))}a wider formation.speed_mps, or a leader that turns "
                "wider)"
            )
        found.append(Finding(i, "formation.kappa_mps", float(limit[i]), text))
    return found


def _remedy(limit: float) -> str:
    """Suggest a κ below the limit, rounded down; "" if the limit is not positive."""
    kappa = (math.ceil(100.0 * limit) - 1) / 100.0
    return f"formation.kappa_mps: {kappa:g}, " if kappa > 0.0 else ""
