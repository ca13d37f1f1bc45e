"""Assumptions of [HBH23] that are checked before a flight: (7), (B1)-(B5) and Assumption 1."""

import re

import numpy as np
import pytest
from cases import ALL
from reference.adapters import frame_rate, h, rho_and_rate
from reference.formation_arrays import norm
from reference.frames import velocity_frame

from testbed.formation.assumptions import (
    SpeedSet,
    by_text,
    check_barrier,
    check_gain,
    check_kappa,
    check_slot_speed,
    largest_kappa,
    margin,
)
from testbed.formation.barrier import NO_BARRIER, SpeedBarrier, barrier_curve
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.formation.hbh23 import SLOPE_FLOOR
from testbed.formation.slots import (
    slot_attitude,
    slot_attitude_range,
    slot_speed,
    slot_speed_range,
)

LOW, HIGH, KAPPA = 16.0, 30.0, 3.6
WIDTH = HIGH - LOW
FUNCTIONS = {
    "paper's simulations": example_1(50.0, 1.0, 0.5),
    "m = 1": example_1(3.0, 0.5, 1.0),
    "example 2": EXAMPLE_2,
    "example 3": EXAMPLE_3,
}
BARRIERS = {
    "example 4": SpeedBarrier(4, 0.02),
    "example 4, steep": SpeedBarrier(4, 5.0),
    "example 5": SpeedBarrier(5, 0.05),
    "example 5, slack": SpeedBarrier(5, 1e-4),
    "example 6": SpeedBarrier(6, 1.0),
    "example 6, thin": SpeedBarrier(6, 0.01),
    "example 6, widest": SpeedBarrier(6, WIDTH / 2.0),
}
every_barrier = pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)


def row(*values):
    return np.array(values, dtype=float)


def speed_set(epsilon=0.6, n=1):
    bounds = (LOW, HIGH, LOW + epsilon, HIGH - epsilon)
    return SpeedSet(*(np.full(n, each) for each in bounds))


def divisor(barrier, s, s_d):
    value, slope = h(barrier, s, np.full_like(s, LOW), np.full_like(s, HIGH))
    return value + (s_d - s) * slope


# the gain, eq. (7)


def test_check_gain_at_its_bound_is_found():
    found = check_gain(row(3.0, 3.6, 4.0), np.full(3, KAPPA), 1.0)
    assert [(f.agent, f.about) for f in found] == [(1, "formation.k"), (2, "formation.k")]
    assert [f.number for f in found] == pytest.approx([0.0, -0.4], abs=1e-15)
    assert "k = 4 is not below kappa / rho_bar = 3.6" in found[1].text
    assert "s_d may lie 0.4 m/s beyond the speed bounds" in found[1].text


def test_check_gain_uses_each_agents_bound_on_rho():
    # ν1 = 50, ν2 = 1, m = 1: ρ̄ = 1/(2 √50), so that k may be 2 √50 times κ = 50.9
    bound = row(1.0, example_1(50.0, 1.0, 1.0).bound)
    assert [f.agent for f in check_gain(row(50.0, 50.0), np.full(2, KAPPA), bound)] == [0]
    assert [f.agent for f in check_gain(row(3.0, 51.0), np.full(2, KAPPA), bound)] == [1]
    assert margin(row(3.0, 50.0), np.full(2, KAPPA), bound)[0] == pytest.approx(0.6, rel=1e-14)


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_check_gain_bound_is_the_largest_push(function):
    size = np.geomspace(1e-3, 1e6, 100_001)
    x = np.stack([0.6 * size, np.zeros_like(size), -0.8 * size], axis=1)
    push = norm(rho_and_rate(function, x, np.zeros_like(x))[0]).max()
    # at 1e6 m example 1 lacks 25e-12 of its bound; the grid lacks its square, 1e-8, of a maximum
    for k, refused in ((KAPPA / push * (1.0 - 1e-7), []), (KAPPA / push * (1.0 + 1e-7), [0])):
        assert (k * push >= KAPPA) == bool(refused)
        assert [f.agent for f in check_gain(row(k), row(KAPPA), function.bound)] == refused


def test_check_kappa_leaves_speeds_between_bounds():
    low, high = np.full(3, LOW), np.full(3, HIGH)
    found = check_kappa(row(6.9, 7.0, 8.0), low, high)
    assert [f.agent for f in found] == [1, 2]
    assert [f.number for f in found] == pytest.approx([0.0, -2.0], abs=1e-14)
    assert "below 7" in found[1].text


# the barrier, (B1)-(B5)


@every_barrier
def test_the_examples_keep_their_conditions(barrier):
    assert check_barrier([barrier], speed_set()) == []
    assert check_barrier([barrier], speed_set(epsilon=0.0)) == []


@every_barrier
def test_b5_holds_by_its_closed_forms(barrier):
    rng = np.random.default_rng(5)
    s, s_d = rng.uniform(LOW, HIGH, (2, 20_000))
    got = divisor(barrier, s, s_d)
    wanted, _ = h(barrier, s_d, np.full_like(s, LOW), np.full_like(s, HIGH))
    rounding = 1e-13 * (1.0 + abs(got))
    if barrier.example == 4:
        assert (abs(got - wanted - barrier.nu * (s_d - s) ** 2) < rounding).all()
    elif barrier.example == 5:
        w = barrier.nu * (HIGH - s) * (s - LOW)
        least = barrier.nu * ((HIGH - s_d) * (s_d - LOW) + (s_d - s) ** 2)
        assert (got * np.cosh(w) ** 2 >= least * (1.0 - 1e-9)).all()
    else:
        assert (got >= wanted - rounding).all()
    assert (got > 0.0).all()


def test_b5_fails_for_desired_speeds_outside_the_set():
    # Example 4: the divisor is ν ((s_hi − s_d)(s_d − s_lo) + (s_d − s)²). At s_d = 15.5 that is
    # 0.02 (−7.25 + (s − 15.5)²): −0.14 at 16, and zero at 15.5 + √7.25 = 18.19 m/s.
    low_end, high_end = check_barrier([SpeedBarrier(4, 0.02)], speed_set(epsilon=-0.5))
    assert low_end.number == pytest.approx(-0.14, abs=2e-4)  # the grid starts 7 mm/s inside
    assert "(B5)" in low_end.text
    found = re.search(r"not positive from ([\d.]+) to ([\d.]+) m/s", low_end.text)
    # a step of the grid, and half of the last digit shown
    assert [float(each) for each in found.groups()] == pytest.approx([16.0, 18.193], abs=0.0125)
    assert high_end.number == pytest.approx(low_end.number, rel=1e-12)
    assert "s_d = 30.5" in high_end.text


def test_a_negative_nu_breaks_every_condition():
    found = check_barrier([SpeedBarrier(4, -0.02)], speed_set())
    names = [f.text[:4] for f in found]
    assert sorted(set(names)) == ["(B1)", "(B2)", "(B3)", "(B4)", "(B5)"]
    # (B1) is worst in the middle of S: −0.02·7²
    assert found[0].number == pytest.approx(-0.98, rel=1e-12)
    assert "23 m/s" in found[0].text


def test_check_barrier_example_6_ends_overlap():
    wide = SpeedBarrier(6, 7.5)
    [found] = check_barrier([wide], speed_set())
    assert found.number == 7.5
    assert "between 22.5 and 23.5 m/s" in found.text
    assert "up to 7" in found.text
    # the slope there is half of the difference quotient, elsewhere it is equal
    s = row(20.0, 22.7, 23.3)
    low, high = np.full(3, LOW), np.full(3, HIGH)
    quotient = (h(wide, s + 1e-6, low, high)[0] - h(wide, s - 1e-6, low, high)[0]) / 2e-6
    assert quotient / h(wide, s, low, high)[1] == pytest.approx([1.0, 2.0, 2.0], rel=1e-6)


def test_check_barrier_no_barrier_is_one_finding():
    [found] = check_barrier([SpeedBarrier(NO_BARRIER, 0.0)], speed_set())
    assert "no barrier: speeds are limited by saturation" in found.text


def test_check_barrier_tanh_is_flat_outside():
    barrier = SpeedBarrier(5, 0.5)
    [found] = check_barrier([barrier], speed_set())
    # h' = −ν (w + 2d) / cosh²(x), x = ν d (d + w), d past the bound; in logarithms nothing is lost
    d = np.linspace(0.0, 5.0, 100_001)
    x = barrier.nu * d * (d + WIDTH)
    log_slope = np.log(barrier.nu * (WIDTH + 2.0 * d)) - 2.0 * (
        x + np.log1p(np.exp(-2.0 * x)) - np.log(2.0)
    )
    assert np.isfinite(log_slope).all()  # never zero: (B3) holds
    expected = d[np.argmax(log_slope < np.log(SLOPE_FLOOR))]
    assert found.number == pytest.approx(expected, abs=0.003)  # one step of its grid
    assert "flat to machine precision" in found.text


def test_every_agent_has_its_own_barrier():
    several = [SpeedBarrier(4, 0.02), SpeedBarrier(6, 9.0), SpeedBarrier(5, 0.05)]
    assert [f.agent for f in check_barrier(several, speed_set(n=3))] == [1]
    assert [f.agent for f in check_barrier([SpeedBarrier(7, 0.0)] * 3, speed_set(n=3))] == [0, 1, 2]


@every_barrier
def test_a_sampled_barrier_is_the_barrier_of_the_law(barrier):
    s = np.linspace(LOW - 5.0, HIGH + 5.0, 201)
    np.testing.assert_array_equal(barrier_curve(barrier, s, LOW, HIGH), h(barrier, s, LOW, HIGH))


def test_by_text_merges_equal_findings():
    found = check_gain(row(4.0, 3.0, 4.0, 5.0), np.full(4, KAPPA), 1.0)
    assert list(by_text(found).values()) == [[0, 2], [3]]


# the speed of the slots, Assumption 1


def test_slot_speed_on_a_circle_by_its_radius():
    # clockwise at 22 m/s on 120 m: υ = (x, y) circles on √((120 − y)² + x²) at 22/120 rad/s
    offsets = np.array([[0.0, 12.0, 0.0], [0.0, -12.0, 5.0], [-50.0, 0.0, 0.0]])
    rate = np.array([[0.0, 0.0, 22.0 / 120.0]])
    [got] = slot_speed(np.array([[0.0, 22.0, 0.0]]), rate, offsets)
    assert got == pytest.approx([22.0 * 0.9, 22.0 * 1.1, 22.0 * 130.0 / 120.0], rel=1e-14)


def test_slot_speed_is_the_derivative_of_the_slot():
    # a leader that turns, climbs and accelerates: course, flight-path angle and speed by time
    def velocity(t):
        sigma, gamma = 0.3 * t - 0.02 * t**2, 0.2 * np.sin(0.5 * t)
        speed = 22.0 + 2.0 * np.sin(0.3 * t)
        north, east = np.cos(gamma) * np.cos(sigma), np.cos(gamma) * np.sin(sigma)
        return np.array([[north, east, -np.sin(gamma)]]) * speed

    offsets = np.array([[-30.0, 20.0, -10.0], [5.0, -40.0, 15.0]])

    def chi(t):  # (27)
        return offsets @ velocity_frame(velocity(t))[0].T

    for t in (0.0, 2.0, 7.0):
        rate = frame_rate(
            row(0.2 * np.sin(0.5 * t)), row(0.3 - 0.04 * t), row(0.1 * np.cos(0.5 * t))
        )
        [got] = slot_speed(velocity(t), rate, offsets)
        step = 1e-5
        expected = norm(velocity(t) + (chi(t + step) - chi(t - step)) / (2.0 * step))
        # positions of 50 m round to 1e-14 m; third derivatives of below 10 m/s³ times step²/6
        assert got == pytest.approx(expected, abs=2e-8)


def test_slot_attitude_on_a_helix_by_its_slots():
    # a leader at a constant rate of turn and climb, through a wind: its slots by (27), their
    # velocity and acceleration by differences
    speed, gamma, rate, wind = 22.0, 0.15, 0.4, np.array([6.0, -3.0, 0.0])
    offsets = np.array([[-5.0, 5.0, 0.0], [-30.0, -20.0, -10.0], [0.0, 0.0, 6.0]])

    def velocity(t):
        level = speed * np.cos(gamma)
        turning = [level * np.cos(rate * t), level * np.sin(rate * t), -speed * np.sin(gamma)]
        return np.array([turning])

    def slots(t):
        level = speed * np.cos(gamma) / rate
        place = [level * np.sin(rate * t), -level * np.cos(rate * t), -speed * np.sin(gamma) * t]
        return np.array(place) + offsets @ velocity_frame(velocity(t))[0].T

    t, step = 1.3, 1e-3
    acceleration = (velocity(t + step) - velocity(t - step)) / (2.0 * step)
    bank, climb = slot_attitude(velocity(t), acceleration, offsets, wind)
    through_air = (slots(t + step) - slots(t - step)) / (2.0 * step) - wind
    second = (slots(t + step) - 2.0 * slots(t) + slots(t - step)) / step**2
    level = np.hypot(through_air[:, 0], through_air[:, 1])
    across = through_air[:, 0] * second[:, 1] - through_air[:, 1] * second[:, 0]
    # differences: third derivatives of 6 m/s³ times step²/6, positions of 60 m round to 1e-14 m
    assert bank[0] == pytest.approx(np.arctan(across / level / 9.80665), abs=1e-6)
    assert climb[0] == pytest.approx(np.arctan2(-through_air[:, 2], level), abs=1e-6)


def test_slot_attitude_range_is_that_of_its_circle():
    # 22 m/s at 0.4 rad/s: 55 m; the slot at υ = (−5, −5) is on √(60² + 5²) m. It climbs as fast.
    limits = {"speed_min": 22.0, "speed_max": 22.0, "turn_rate": 0.4}
    offsets = np.array([[-5.0, -5.0, 0.0]])
    bank, climb = slot_attitude_range(offsets, **limits, gamma=0.0)
    assert bank == pytest.approx(np.arctan(0.4**2 * np.hypot(60.0, 5.0) / 9.80665), rel=1e-12)
    assert climb == pytest.approx(0.0)
    _, climb = slot_attitude_range(np.zeros((1, 3)), **limits, gamma=0.2)
    assert climb == pytest.approx(0.2, rel=1e-12)


def test_slot_speed_range_in_level_turns_by_hand():
    offsets = np.array([[0.0, 12.0, 0.0], [-9.0, 12.0, 3.0], [-60.0, 60.0, 0.0], [0.0, 0.0, 8.0]])
    limits = {"speed_min": 20.0, "speed_max": 24.0, "turn_rate": 0.25}
    slowest, fastest = slot_speed_range(offsets, **limits)
    # forward 20 − 3 and 24 + 3 by the right or left wing; across 0.25·9
    assert slowest[:2] == pytest.approx([17.0, np.hypot(17.0, 2.25)], rel=1e-14)
    assert fastest[:2] == pytest.approx([27.0, np.hypot(27.0, 2.25)], rel=1e-14)
    # far out the slowest is no longer at the sharpest turn: √((20 − 60 r)² + (60 r)²) is least at
    # r = 1/6 rad/s, half of it across
    assert slowest[2] == pytest.approx(20.0 / np.sqrt(2.0), rel=1e-14)
    # above or below the leader a level turn changes nothing
    assert (slowest[3], fastest[3]) == (20.0, 24.0)


def test_slot_speed_range_of_a_pull_up_by_hand():
    # In the sharpest turn (−10, 8, 0.5) m moves at (20 − 2 + 0.5 y, −2.5, 10 y) m/s, y = γ̇: the
    # square is least at y = −9/100.25 rad/s, inside its limit, and 81/100.25 below that at zero.
    slowest, _ = slot_speed_range(
        np.array([[-10.0, 8.0, 0.5]]),
        speed_min=20.0,
        speed_max=20.0,
        turn_rate=0.25,
        gamma_dot=0.2,
    )
    assert slowest == pytest.approx(np.sqrt(18.0**2 + 2.5**2 - 81.0 / 100.25), rel=1e-14)


@pytest.mark.parametrize("climbing", [(0.0, 0.0), (0.2, 0.0), (0.0, 0.15), (0.3, 0.2)])
def test_slot_speed_range_holds_within_the_limits(climbing):
    (gamma, gamma_dot), n = climbing, 40 if ALL else 12
    rng = np.random.default_rng(11)
    offsets = rng.uniform(-1.0, 1.0, (n, 3)) * rng.choice([10.0, 80.0, 250.0], (n, 1))
    slowest, fastest = slot_speed_range(
        offsets,
        speed_min=20.0,
        speed_max=24.0,
        turn_rate=0.25,
        gamma=gamma,
        gamma_dot=gamma_dot,
    )
    # every corner of the limits, and a grid between them
    axes = [np.linspace(-1.0, 1.0, 41)] * 3
    yaw, climb, slope = (each.ravel() for each in np.meshgrid(*axes))
    rate = frame_rate(gamma * slope, 0.25 * yaw, gamma_dot * climb)
    north = np.array([1.0, 0.0, 0.0])
    least = slot_speed(np.tile(20.0 * north, (len(rate), 1)), rate, offsets).min(axis=0)
    most = slot_speed(np.tile(24.0 * north, (len(rate), 1)), rate, offsets).max(axis=0)
    middle = slot_speed(np.tile(22.0 * north, (len(rate), 1)), rate, offsets)
    assert (middle.min(axis=0) >= slowest).all()
    assert (middle.max(axis=0) <= fastest).all()
    # The function's own grid of γ has steps of a third of one here: no worse, to its curvature.
    assert (slowest <= least + 0.01).all()
    assert (fastest >= most - 0.01).all()
    # and sharp: a flight on the grid comes within its steps, 5 % of the rates, of the bounds
    steps = 0.05 * (0.25 + gamma_dot) * norm(offsets)
    assert (least - slowest <= steps + 1e-12).all()
    assert (most - fastest <= 1e-9 + 0.01).all()


def test_slot_speed_of_the_papers_circle_meets_kappa():
    offsets = np.array([[-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0], [-5.0, -5.0, 4.0]])
    rate = 22.0 / 120.0
    low, high = np.full(3, LOW), np.full(3, HIGH)
    ranged = slot_speed_range(offsets, speed_min=22.0, speed_max=22.0, turn_rate=rate)
    assert check_slot_speed(*ranged, np.full(3, KAPPA), low, high, possible=True) == []
    # towards the centre 22 (1 − 5/120), 5.09 m/s above the bound, and 0.02 for the 5 m behind
    room = largest_kappa(*ranged, low, high)
    assert room == pytest.approx(np.full(3, np.hypot(22.0 * 115 / 120, 5 * rate) - 16), rel=1e-12)


def test_check_slot_speed_names_the_largest_kappa():
    slowest, fastest = row(18.7, 14.7, 22.0, 19.5), row(25.0, 23.0, 27.234, 25.0)
    bounds = np.full(4, LOW), np.full(4, HIGH)
    kappa = row(3.6, 3.6, 3.6, 3.5)
    found = check_slot_speed(slowest, fastest, kappa, *bounds, possible=False)
    assert [f.agent for f in found] == [0, 1, 2, 3]  # the last at the bound: the set is open
    numbers = [f.number for f in found]
    assert numbers == pytest.approx([2.7, -1.3, 2.766, 3.5], abs=1e-12)
    assert "moves at 18.70 to 25.00 m/s" in found[0].text
    assert "requires 19.6 to 26.4" in found[0].text
    assert "formation.kappa_mps" not in found[1].text  # no κ would do
    assert "formation.speed_mps" in found[1].text
    for f in (found[0], found[2], found[3]):
        kappa[f.agent] = float(re.search(r"formation\.kappa_mps: ([\d.]+)", f.text)[1])
    assert kappa == pytest.approx([2.69, 3.6, 2.76, 3.49])
    left = check_slot_speed(slowest, fastest, kappa, *bounds, possible=True)
    assert [f.agent for f in left] == [1]
    assert "may move" in left[0].text
