"""How fast errors fall: closed forms where the closed loop has them, rates where it has not.

Three facts follow from the proof of Theorem 1 for any leader, slots, graph and gains:

    θ̇ = −c sin θ          for the angle θ between y and y_d, from (A9) with Y = 1 − cos θ
    ζ̇ = −a ζ − b h ζ³     for ζ = s̃/h, from (A3) with Z = ½ ζ²
    q̃̇ = k ρ(ξ)            where s̃ = 0 and ỹ = 0, and these stay zero, (A12)
"""

import numpy as np
import pytest
from cases import ALL, in_full
from closed_loop import angle, fly, halved
from reference.formation_control_function import per_agent
from theorem_cases import (
    BARRIERS,
    PATHS,
    SIMULATION_1,
    SIMULATION_2,
    at_slots,
    directions,
    each,
    every_case,
    graph,
    one_formation,
    scattered,
    turned_away,
)

from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1

# States of thousands of metres, divided by errors down to 1e-6 of their start.
ROUNDING = 1e-8


def simulate(formations, start, times, measure):
    """What `measure` makes of t, state and wanted after every step (T, ...)."""
    states = fly(formations, start, times)
    return np.array([measure(t, state, formations.wanted(t, state)) for t, state in states])


def with_tolerance(formations, start, times, measure):
    """`flown`, with every step also halved, and how far each agent may be off for its steps.

    By Richardson an error of fourth order is 1/15 of the difference between the two. The rest is
    for places where a spline or a barrier jumps in its second derivative.
    """
    coarse = simulate(formations, start, times, measure)
    fine = simulate(formations, start, halved(times), measure)[::2]
    return fine, abs(fine - coarse).max(axis=0)


@in_full
def test_integration_is_of_fourth_order():
    """Halving steps of 25 ms divides an agent's error by 16; the median of 108 agents.

    A wrong step is found by `test_held_commands_converge_to_continuous_time`, too.

    Not that of one which shoots past its slot at 50 m/s: a step takes it through half of ρ's bend.
    """
    formations = every_case(b=0.02).change(barrier=BARRIERS["example 5"])
    start = scattered(np.random.default_rng(1), formations, spread=5.0)
    start = start._replace(s=0.5 * (start.s + 23.0))
    times, ends = np.linspace(0.0, 1.0, 41), []
    for _ in range(3):
        *_, (_, state) = fly(formations, start, times)
        ends.append(np.array([*state.q.T, *state.y.T, state.s]))
        times = halved(times)
    first, second = (
        np.linalg.norm(a - b, axis=0) for a, b in zip(ends[:-1], ends[1:], strict=True)
    )
    assert np.median(first / second) == pytest.approx(16.0, rel=0.05)


TIMES = np.arange(151 if ALL else 76) * 0.02


def falling(b):
    """Random a and c, any direction, speeds down to some centimetres from a bound.

    Returns the formations; ln tan(θ/2) and ln |ζ| (T, N); and how far these may be off (N,). The
    kinks of example 6 leave errors of second order that depend on where in a step they lie, so
    that each agent is given the largest of those with its barrier.
    """
    rng = np.random.default_rng(3)
    formations = every_case(b=b)
    n = len(formations.k)
    formations = formations.change(a=rng.uniform(0.3, 2.0, n), c=rng.uniform(0.3, 2.0, n))

    def logarithms(t, state, wanted):
        half_angle = np.tan(0.5 * angle(state.y, wanted.desired.direction))
        zeta = (state.s - wanted.desired.speed) / formations.h(state.s)
        return np.log([half_angle, abs(zeta)])

    found, tolerance = with_tolerance(formations, scattered(rng, formations), TIMES, logarithms)
    for example in set(formations.barrier.example):
        alike = formations.barrier.example == example
        tolerance[:, alike] = tolerance[:, alike].max(axis=1, keepdims=True)
    assert tolerance[0].max() < 1e-4
    assert tolerance[1].max() < 0.02
    return formations, *found.swapaxes(0, 1), *(tolerance + ROUNDING)


@pytest.fixture(scope="module")
def with_b():
    return falling(0.1)


def test_direction_error_in_closed_form(with_b):
    """tan(θ/2) = tan(θ(0)/2) exp(−c t), also while y_d turns with the leader and with ξ."""
    formations, half_angle, _, tolerance, _ = with_b
    proved = half_angle[0] - formations.c * TIMES[:, None]
    assert (abs(half_angle - proved) < tolerance).all()


def test_speed_error_without_b_in_closed_form():
    """s̃/h = s̃(0)/h(s(0)) exp(−a t)."""
    formations, _, zeta, _, tolerance = falling(0.0)
    assert zeta[0].max() > 4.0
    assert (abs(zeta - zeta[0] + formations.a * TIMES[:, None]) < tolerance).all()


def test_speed_error_with_b_between_two_closed_forms(with_b):
    """With w = 1/ζ²: ẇ = 2 a w + 2 b h, and 0 <= h <= h̄.

    So w(0) exp(2 a t) <= w(t) <= (w(0) + b h̄/a) exp(2 a t) − b h̄/a.
    """
    formations, _, zeta, _, tolerance = with_b
    w, growth = np.exp(-2.0 * zeta[0]), 2.0 * formations.a * TIMES[:, None]
    most = formations.b * formations.h_top / formations.a
    slowest = zeta[0] - 0.5 * growth
    fastest = -0.5 * (growth + np.log(w + most * -np.expm1(-growth)))
    assert (zeta < slowest + tolerance).all()
    assert (zeta > fastest - tolerance).all()
    assert (fastest < slowest - 0.1)[-1].any()


def test_position_error_of_one_agent_in_closed_form():
    """ẋ = −k β x (ν1 + ν2 x²)^(−m) for x = β ‖q̃‖, so F(x(0)) − F(x(t)) = k β t with

    F(x) = √(ν1 + x²) − √ν1 arsinh(√ν1/x) for m = ½, ν2 = 1: from 29 m to some decimetres;
    F(x) = ν1 ln x + ½ ν2 x² for m = 1: from 5 m to some decimetres.
    """
    nu1, nu2, beta, k = 4.0, 1.0, 0.8, 3.0
    functions = [example_1(nu1, nu2, m) for m in (0.5, 1.0) for _ in PATHS]
    formations = one_formation(
        gains=graph([beta]), k=k, mu=per_agent(functions), copies=8, margin=0.5
    )
    climb, course_rate = np.array([*PATHS.values()] * 2).T
    formations = formations.change(
        leader=formations.leader._replace(climb=climb, course_rate=course_rate)
    )
    far = np.repeat([29.0, 5.0], 4) / beta
    error = directions(np.random.default_rng(4), 8) * far[:, None]
    times = np.linspace(0.0, 11.5, 116)

    def f(t, state, wanted):
        x = beta * np.linalg.norm(wanted.error, axis=1)
        half = np.sqrt(nu1 + x * x) - nu1**0.5 * np.arcsinh(nu1**0.5 / x)
        return np.where(far > 10.0, half, nu1 * np.log(x) + 0.5 * nu2 * x * x)

    found, tolerance = with_tolerance(formations, at_slots(formations, error), times, f)
    assert tolerance.max() < 1e-3
    proved = found[0] - k * beta * times[:, None]
    assert (abs(found - proved) < tolerance + ROUNDING).all()
    assert proved[-1].max() < 2.0


def exponential(matrix):
    """exp of a matrix: Taylor's series of its 2⁻¹⁰th part, squared ten times."""
    part, term = np.eye(len(matrix)), np.eye(len(matrix))
    for order in range(1, 12):
        term = term @ matrix / (1024.0 * order)
        part = part + term
    return np.linalg.matrix_power(part, 1024)


def test_small_errors_follow_the_matrix_exponential():
    """q̃(t) = exp(−diag(k) (A + B) t) q̃(0) where μ = 1: ‖ξ‖² < 0.5 m² or 0.1 m²; k unequal.

    Undirected and directed graphs, examples 2 and 3.
    """
    k = np.array([2.0, 3.0, 2.5])
    functions = [EXAMPLE_2, EXAMPLE_3] * 2
    formations = one_formation(
        gains=SIMULATION_1,
        k=np.tile(k, 4),
        mu=per_agent([function for function in functions for _ in range(3)]),
        copies=4,
    ).change(gains=np.concatenate([SIMULATION_1] * 2 + [SIMULATION_2] * 2))
    flat = formations.mu.flat
    error = 0.2 * flat[:, None] ** 0.5 * directions(np.random.default_rng(5), 12)
    times = np.linspace(0.0, 6.0, 121)
    found, tolerance = with_tolerance(
        formations,
        at_slots(formations, error),
        times,
        lambda t, state, wanted: np.stack([wanted.error, wanted.xi]),
    )
    assert ((found[:, 1] ** 2).sum(axis=2) < flat).all()
    generators = -k[:, None] * formations.couplings[:, 0]
    start = error.reshape(4, 3, 3)
    proved = np.array(
        [[exponential(t * a) @ x for a, x in zip(generators, start, strict=True)] for t in times]
    ).reshape(-1, 12, 3)
    assert tolerance[0].max() < 1e-4
    assert (abs(found[:, 0] - proved) < tolerance[0] + ROUNDING).all()
    assert np.linalg.norm(proved[-1]) < 0.15 * np.linalg.norm(error)


SLOW = {"k": 3.0 * 0.198062, "a": 0.25, "c": 0.25}  # 0.198062: the least eigenvalue of A + B


@pytest.mark.parametrize("slowest", SLOW)
def test_small_errors_fall_at_the_slowest_rate(slowest):
    """q̃ falls at the least of the eigenvalues of k μ(0) (A + B), a and c.

    (A12) linearised is q̃̇ = −k μ(0) (A + B) q̃ + s̃ y + s_d ỹ, with s̃ and ỹ falling at a and c.
    The next rate is 0.34 per second faster or more: after 24 s some exp(−8) of it is left, and
    ln ‖q̃‖ falls over 8 s as at the slowest rate within some 1e-3.
    """
    fast = {"a": 3.0, "c": 3.0}
    gains = fast if slowest == "k" else {**fast, slowest: SLOW[slowest]}
    formations = one_formation("straight climb", mu=EXAMPLE_2, **gains)
    eigenvalue = np.linalg.eigvalsh(formations.couplings[0, 0])[0]
    rate = 3.0 * eigenvalue if slowest == "k" else SLOW[slowest]
    start = at_slots(formations, 0.1 * directions(np.random.default_rng(6), 3))
    start = start._replace(
        s=start.s + 0.05,
        y=turned_away(start.y, each(0.01, 3), np.array([0.3, -0.2, 1.0])),
    )
    times = np.linspace(0.0, 32.0, 161)
    error = simulate(formations, start, times, lambda t, x, wanted: np.linalg.norm(wanted.error))
    measured = np.log(error[120] / error[160]) / 8.0
    assert rate == pytest.approx(SLOW[slowest], rel=1e-5)
    assert measured == pytest.approx(rate, rel=2e-3)
