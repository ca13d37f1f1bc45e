"""Trailing vortices: strength, position, the velocity about them and the rolling moment."""

import numpy as np
import pytest
from reference.adapters_atmosphere import (
    add_wakes,
    horseshoe,
    trail_crossing,
    wake_delta_cl,
)
from reference.frames import rotation_ned_body

from testbed.atmosphere.wake import (
    PAIRS,
    STATIONS,
    WakeModel,
    roll_gain,
    sheet_pairs,
    wing_stations,
)
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Airframe

DT = 0.005
DENSITY = 1.18
SPAN, MASS, SPEED = 2.795, 6.577, 22.0
CORE_SPANS = 0.05
PAIR = 0.25 * np.pi * SPAN  # b₀
CIRCULATION = MASS * GRAVITY / (DENSITY * SPEED * PAIR)
SINKING = CIRCULATION / (2.0 * np.pi * PAIR)  # m/s


def airframe(span=SPAN, area=0.98198, mass=MASS):
    return Airframe(span=span, area=area, arm=0.8, mass=mass, lift_slope=5.0)


def make(count=2, airframes=None, **changes):
    args = {
        "sheds": np.ones(count, dtype=bool),
        "affected": np.ones(count, dtype=bool),
        "core_spans": CORE_SPANS,
        "decay_s": None,
        "memory_s": 10.0,
        "dt": DT,
        "density": DENSITY,
    }
    return WakeModel(airframes or [airframe()] * count, **args | changes)


def level(wakes, *positions, heading=0.0):
    """Wind and rolling moment after straight and level flight to (forward, right, down)."""
    turn = rotation_ned_body(np.array([0.0, 0.0, heading]))
    position = np.array(positions, dtype=float) @ turn.T
    velocity = np.tile(SPEED * turn[:, 0], (len(position), 1))
    euler = np.tile([0.0, 0.0, heading], (len(position), 1))
    wind, roll = next_step(wakes, position, velocity, np.zeros_like(position), euler)
    return wind @ turn, roll


def next_step(wakes, position, velocity, acceleration, euler, ambient=0.0):
    """Wind (N, 3) and rolling-moment coefficient (N,) of the next step."""
    return add_wakes(wakes, position, velocity, acceleration, euler, ambient)


def small(**changes):
    """A follower of no span: its wind is that at a point."""
    airframes = [airframe(), airframe(span=1e-6, area=1e-13)]
    return make(airframes=airframes, sheds=np.array([True, False]), **changes)


# ----------------------------------------------------------------------------- the lifting line


def test_wing_stations_are_exact_for_polynomials():
    points, weights = wing_stations(6)
    # ∫ x^k √(1 − x²) dx over ∫ √(1 − x²) dx
    for power, exact in ((0, 1.0), (1, 0.0), (2, 1 / 4), (4, 1 / 8), (6, 5 / 64), (10, 21 / 512)):
        assert (weights * points**power).sum() == pytest.approx(exact, abs=1e-15)


def test_wake_delta_cl_rolling_wing_is_damped():
    """By the closed form of an elliptic wing."""
    aspect_ratio, slope = 7.955, 5.0
    section = slope / (1.0 - slope / (np.pi * aspect_ratio))
    mu = section / (np.pi * aspect_ratio)
    speed, rate, span = 22.0, 0.7, 2.795
    downwash = -rate * 0.5 * span * STATIONS
    found = wake_delta_cl(downwash, speed, roll_gain(aspect_ratio, slope))
    damping = -section / 8.0 / (1.0 + 2.0 * mu)
    assert found / (rate * span / (2.0 * speed)) == pytest.approx(damping, rel=1e-12)
    assert damping == pytest.approx(-0.52, abs=0.005)


def test_wake_delta_cl_satisfies_prandtls_equation():
    """Solved as it stands for the circulation at 60 points, by collocation."""
    rng = np.random.default_rng(1)
    aspect_ratio, section = 5.88, 5.139
    count = 60
    theta = np.arange(1, count + 1) * np.pi / (count + 1)
    order = np.arange(1, count + 1)
    mu = section / (np.pi * aspect_ratio)
    # Glauert eq. (11.7), with the elliptic chord's μ sin θ
    equation = np.sin(theta[:, None] * order) * (order * mu + 1.0)
    for _ in range(10):
        curve = np.polynomial.Polynomial(rng.normal(0.0, 0.5, 9))
        series = np.linalg.solve(equation, -mu * curve(np.cos(theta)) * np.sin(theta))
        gain = roll_gain(aspect_ratio, section / (1.0 + mu))
        found = wake_delta_cl(18.0 * curve(STATIONS), 18.0, gain)
        assert found == pytest.approx(-0.25 * np.pi * aspect_ratio * series[1], rel=1e-10)


def test_roll_gain_impossible_lift_slope_is_rejected():
    with pytest.raises(InputError, match="aspect ratio 1 has the lift slope 3.2 per rad: .* 3.14$"):
        roll_gain(np.array([8.0, 1.0]), np.array([5.0, 3.2]))


# ------------------------------------------------------------------------------- the horseshoe


def test_horseshoe_velocity_is_biot_and_savarts():
    rng = np.random.default_rng(2)
    half, core = 1.1, 0.14
    # forward, right, down: from far behind to the left tip, to the right tip, and back
    stretch = np.concatenate([[0.0], np.geomspace(1e-4, 1e5, 40001)])
    across = np.linspace(-half, half, 20001)
    lines = [
        np.stack([-stretch[::-1], np.full_like(stretch, -half), 0 * stretch], axis=-1),
        np.stack([0 * across, across, 0 * across], axis=-1),
        np.stack([-stretch, np.full_like(stretch, half), 0 * stretch], axis=-1),
    ]
    for at in rng.uniform([-6.0, -3.0, -1.0], [3.0, 3.0, 1.0], (12, 3)):
        total = np.zeros(3)
        for line in lines:
            step, middle = np.diff(line, axis=0), 0.5 * (line[1:] + line[:-1])
            arm = at - middle
            length = np.linalg.norm(arm, axis=-1, keepdims=True)
            whole = (np.cross(step, arm) / length**3).sum(axis=0) / (4.0 * np.pi)
            along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
            square = (np.cross(along, at - line[0]) ** 2).sum()
            total += whole * square / (square + core**2)
        found = horseshoe(at, np.array(half), np.array(core))
        assert found == pytest.approx(total, abs=1e-5 * np.linalg.norm(total))


def test_sheet_of_many_pairs_has_prandtls_downwash():
    """Γ₀/(2 b) down along the wing, and up beside it."""
    positions, parts = sheet_pairs(2000)
    assert parts.sum() == pytest.approx(1.0, rel=1e-12)
    for eta in (0.0, 1.2, 1.5, 2.0):
        at = np.array([0.0, 0.5 * SPAN * eta, 0.0])
        down = (parts * horseshoe(at, 0.5 * SPAN * positions, np.array(1e-6))[:, 2]).sum()
        exact = 1.0 if eta < 1.0 else 1.0 - eta / np.sqrt(eta**2 - 1.0)
        assert down == pytest.approx(exact / (2.0 * SPAN), rel=1.0 / 2000)


@pytest.mark.parametrize("count", [1, 3, 8])
def test_sheet_pairs_carry_an_elliptic_wings_lift(count):
    positions, parts = sheet_pairs(count)
    assert (positions * parts).sum() == pytest.approx(0.25 * np.pi, rel=1e-12)
    assert np.all((0.0 < positions) & (positions < 1.0))


# ---------------------------------------------------------------------- strength, age and position


def two_dimensional(y, z):
    """Velocity right and down of the rolled-up pair, with its core, far from where it began."""
    core = CORE_SPANS * SPAN
    total = np.zeros(2)
    for side in (1.0, -1.0):
        arm = np.array([y - 0.5 * side * PAIR, z])
        # the right vortex turns right to down ... against the clock, seen from behind
        total += (
            side * CIRCULATION / (2.0 * np.pi) * np.array([arm[1], -arm[0]]) / (arm @ arm + core**2)
        )
    return total


def test_wake_far_behind_is_a_sunk_vortex_pair():
    sunk = SINKING * 500.0 / SPEED
    for y, z in ((0.0, 0.0), (1.0, 0.3), (1.2, -0.1), (-2.0, 1.0), (4.0, -2.0)):
        wind, _ = level(small(memory_s=60.0), (0.0, 0.0, 0.0), (-500.0, y, sunk + z))
        assert wind[1, 0] == pytest.approx(0.0, abs=1e-6)
        assert wind[1, 1:] == pytest.approx(two_dimensional(y, z), abs=1e-5)


def test_circulation_bears_weight_and_load_of_a_turn():
    down = {}
    for bank in (0.0, 0.5):
        wakes = small(memory_s=60.0)
        position, velocity = np.zeros((2, 3)), np.array([[SPEED, 0.0, 0.0]] * 2)
        # level with the right wing down, and pulled to the right as in a coordinated turn
        euler = np.array([[bank, 0.0, 0.0], [0.0, 0.0, 0.0]])
        pulled = np.array([[0.0, GRAVITY * np.tan(bank), 0.0], [0.0, 0.0, 0.0]])
        axes = rotation_ned_body(euler[0])
        load = 1.0 / np.cos(bank)
        position[1] = axes @ [-500.0, 0.0, load * SINKING * 500.0 / SPEED]
        down[bank] = next_step(wakes, position, velocity, pulled, euler)[0][1] @ axes / load
    assert down[0.5] == pytest.approx(down[0.0], abs=1e-6)
    assert down[0.0][2] == pytest.approx(two_dimensional(0.0, 0.0)[1], abs=1e-6)


def test_trail_sinks_at_its_own_induced_speed():
    age, delta = 4.0, 0.4  # s, m
    for decay_s, aged in ((None, age), (3.0, 3.0 * (1.0 - np.exp(-age / 3.0)))):
        at = [(-SPEED * age, 0.8, SINKING * aged + z) for z in (-delta, delta)]
        above, below = (level(small(decay_s=decay_s), (0, 0, 0), each)[0][1] for each in at)
        assert above[2] == pytest.approx(below[2], rel=1e-9)
        assert above[1] == pytest.approx(-below[1], rel=1e-9)
        assert abs(above[1]) > 0.01


@pytest.mark.parametrize("part", [0.25, 0.5, 1.0, 1.5])
def test_sheet_rolls_up_within_the_distance(part):
    """Of Spreiter and Sacks."""
    area = 0.98198
    lift_coefficient = MASS * GRAVITY / (0.5 * DENSITY * SPEED**2 * area)
    behind = part * 0.28 * (SPAN**2 / area) / lift_coefficient * SPAN
    positions, parts = sheet_pairs(PAIRS)
    rolled = np.pi / 4.0
    drawn = 0.5 * SPAN * (rolled + (positions - rolled) * max(0.0, 1.0 - part))
    sunk = SINKING * behind / SPEED
    for y in (0.3, 1.1, 1.6):
        wind, _ = level(small(), (0.0, 0.0, 0.0), (-behind, y, 0.2))
        at = np.array([-behind, y, 0.2 - sunk])
        one = horseshoe(at, drawn, np.array(CORE_SPANS * SPAN))
        assert wind[1] == pytest.approx(CIRCULATION * (parts @ one), abs=1e-6)


def test_trail_decays_with_its_age():
    light = [airframe(mass=1e-3)] * 2  # it hardly sinks
    for age in (0.5, 2.0, 6.0):
        at = ((0.0, 0.0, 0.0), (-SPEED * age, 0.7, 0.0))
        without, decaying = (
            level(make(airframes=light, decay_s=decay), *at) for decay in (None, 3.0)
        )
        left = np.exp(-age / 3.0)
        assert decaying[0][1, 2] == pytest.approx(left * without[0][1, 2], rel=1e-6)
        assert decaying[1][1] == pytest.approx(left * without[1][1], rel=1e-6)


def test_trail_fades_out_where_memory_ends():
    light = [airframe(mass=1e-3)] * 2
    strong, half, nothing = (
        level(make(airframes=light), (0.0, 0.0, 0.0), (-SPEED * age, 0.7, 0.0))[0][1, 2]
        for age in (8.9, 9.5, 10.01)
    )
    assert half == pytest.approx(0.5 * strong, rel=1e-3)
    assert nothing == 0.0


def circling(turn, seconds):
    """The wake of one aircraft that circles; where it was at a time, and its flight direction."""
    radius = SPEED / turn if turn else np.inf

    def at(time):
        angle = turn * time
        if turn:
            place = radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        else:
            place = np.array([SPEED * time, 0.0, 0.0])
        return place, np.array([np.cos(angle), np.sin(angle), 0.0])

    wakes = make(1, memory_s=6.0)
    for tick in range(round(seconds / DT) + 1):
        place, forward = at(tick * DT)
        euler = np.array([[0.0, 0.0, turn * tick * DT]])
        add_wakes(wakes, place[None], SPEED * forward[None], np.zeros((1, 3)), euler, 0.0)
    return wakes, at


@pytest.mark.parametrize("bank_deg", [0.0, 30.0])
def test_trail_crossing_is_where_the_aircraft_was(bank_deg):
    """25 m behind it."""
    turn = GRAVITY * np.tan(np.radians(bank_deg)) / SPEED
    wakes, at = circling(turn, 2.0)
    there, forward = at(2.0 - 25.0 / SPEED)
    aside = np.array([-forward[1], forward[0], 0.0])
    for offset in (-2.0, 0.0, 1.5):
        place = there + offset * aside
        position, along, right, _, ahead, age, found = trail_crossing(wakes, 0, place)
        assert found
        # the chord between points 1.1 m apart leaves the circle by (1.1 m)²/(8 R)
        assert position == pytest.approx(there, abs=0.002)
        assert along == pytest.approx(forward, abs=1e-3)
        assert right == pytest.approx(aside, abs=1e-3)
        assert ahead == pytest.approx(25.0, abs=0.03)
        assert age == pytest.approx(25.0 / SPEED, abs=1e-3)
    if bank_deg:
        now, onward = at(2.0)
        astray = np.linalg.norm(now - 25.0 * onward - there)
        assert astray == pytest.approx(25.0**2 / (2.0 * SPEED / turn), rel=0.02)


def test_trail_before_the_first_step_is_straight():
    wakes, _ = circling(0.3, 1.0)
    position, *_, ahead, _, _ = trail_crossing(wakes, 0, [-40.0, 1.0, 0.0])
    assert position == pytest.approx([-40.0, 0.0, 0.0], abs=1e-9)
    assert ahead == pytest.approx(40.0 + SPEED, abs=1e-3)


def test_wake_in_a_turn_is_that_of_straight_flight():
    """On one circle, 25 m apart: as wide apart in straight flight, at the turn's load."""
    bank, offset = np.radians(30.0), 1.2
    turn = GRAVITY * np.tan(bank) / SPEED
    wakes = make()
    for tick in range(701):
        angle = turn * (tick * DT - np.array([0.0, 25.0 / SPEED]))
        forward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        inward = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=-1)
        euler = np.stack([np.full(2, bank), 0 * angle, angle], axis=-1)
        position = -SPEED / turn * inward
        wing = rotation_ned_body(euler)[1, :, 1]
        position[1] += offset * wing
        wind, roll = next_step(wakes, position, SPEED * forward, SPEED * turn * inward, euler)
    heavier = make(airframes=[airframe(mass=MASS / np.cos(bank))] * 2)
    wind_level, roll_level = level(heavier, (0.0, 0.0, 0.0), (-25.0, offset, 0.0))
    axes = rotation_ned_body(euler)[1]
    assert abs(roll_level[1]) > 1e-3
    assert wind[1] @ axes == pytest.approx(wind_level[1], abs=0.01 * abs(wind_level[1]).max())
    assert roll[1] == pytest.approx(roll_level[1], rel=0.01)


# ------------------------------------------------------------------------------- at followers


def test_wake_masks_choose_sources_and_receivers():
    """No aircraft is a receiver of its own trail."""
    assert not np.any(level(make(1), (0.0, 0.0, 0.0))[0])
    positions = (0.0, 0.0, 0.0), (-10.0, 1.0, 0.2), (-20.0, -1.0, 0.0)
    some = np.array([True, False, True])
    whole, _ = level(make(3), *positions)
    assert np.all(whole != 0.0)
    masked_wind, masked_roll = level(make(3, affected=some), *positions)
    assert not masked_wind[1].any()
    assert masked_roll[1] == 0.0
    assert np.array_equal(masked_wind[[0, 2]], whole[[0, 2]])
    without, _ = level(make(3, sheds=some), *positions)
    assert without[[0, 2]] == pytest.approx(level(make(2), *positions[::2])[0], abs=1e-15)


def test_removed_aircraft_sheds_and_feels_no_wake():
    positions = (0.0, 0.0, 0.0), (-10.0, 1.0, 0.2), (-20.0, -1.0, 0.0)
    wakes = make(3)
    wakes.remove(np.array([False, True, False]))
    wind, roll = level(wakes, *positions)
    assert not wind[1].any() and roll[1] == 0.0
    assert wind[[0, 2]] == pytest.approx(level(make(2), *positions[::2])[0], abs=1e-15)


def test_wake_mirrored_rolls_the_other_way():
    for offset in (0.3, 0.9, 2.0):
        one = level(make(), (0.0, 0.0, 0.0), (-8.0, offset, 0.1))
        two = level(make(), (0.0, 0.0, 0.0), (-8.0, -offset, 0.1))
        assert two[0][1] == pytest.approx(one[0][1] * [1.0, -1.0, 1.0], abs=1e-12)
        assert two[1][1] == pytest.approx(-one[1][1], abs=1e-12)


def test_wake_is_independent_of_the_heading():
    at = (0.0, 0.0, 0.0), (-8.0, 1.0, 0.2), (-30.0, -2.0, 0.0)
    north, east = level(make(3), *at), level(make(3), *at, heading=2.1)
    for one, two in zip(north, east, strict=True):
        assert two == pytest.approx(one, abs=1e-12)


def test_wake_signs_of_roll_and_upwash():
    """A right wing in the downwash goes down; a wing beside the vortex is lifted."""
    wind, roll = level(make(), (0.0, 0.0, 0.0), (-SPAN, -0.5 * SPAN, 0.0))
    assert roll[1] > 0.005
    wind, _ = level(make(), (0.0, 0.0, 0.0), (-SPAN, SPAN, 0.0))
    assert wind[1, 2] < -0.05
    assert -0.02 < wind[0, 2] < 0.0  # the leader is lifted a little by its follower


def test_wake_is_continuous_abeam_of_the_wing():
    near = [level(make(), (0.0, 0.0, 0.0), (x, 3.0, 0.3)) for x in (-1e-7, 0.0, 1e-7)]
    for wind, roll in near[1:]:
        assert wind == pytest.approx(near[0][0], abs=1e-6)
        assert roll == pytest.approx(near[0][1], abs=1e-6)


def test_wake_is_continuous_as_points_are_stored():
    """A flight of many ticks and one that starts at each tick agree as long as it is straight."""
    wakes = make()
    first = None
    for tick in range(45):
        wind, roll = level(wakes, (SPEED * tick * DT, 0, 0), (SPEED * tick * DT - 9.0, 1.0, 0.1))
        first = first or (wind, roll)
        assert wind == pytest.approx(first[0], abs=1e-12)
        assert roll == pytest.approx(first[1], abs=1e-12)


def test_wake_is_carried_by_the_wind():
    """Flights through the air are the same in any wind, of which the shedders' mean counts."""
    mean, apart = np.array([4.0, -3.0, 0.5]), np.array([1.0, 2.0, -0.3])
    ambient = np.array([mean + apart, mean - apart, mean + 5.0])
    sheds = np.array([True, True, False])
    calm, windy = make(3, sheds=sheds), make(3, sheds=sheds)
    turn, bank = 0.2, np.arctan(0.2 * SPEED / GRAVITY)
    start = np.array([[0.0, 0.0, 0.0], [-9.0, 1.5, 0.2], [-17.0, -1.0, 0.0]])
    for tick in range(200):
        angle = turn * tick * DT
        forward, inward = [np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0]
        axes = rotation_ned_body(np.array([0.0, 0.0, angle]))
        position = start @ axes.T - SPEED / turn * np.array(inward)
        velocity = np.tile(SPEED * np.array(forward), (3, 1))
        motion = (
            np.tile(SPEED * turn * np.array(inward), (3, 1)),
            np.tile([bank, 0.0, angle], (3, 1)),
        )
        expected = next_step(calm, position, velocity, *motion)
        carried = position + mean * tick * DT
        found = next_step(windy, carried, velocity + ambient, *motion, ambient)
        for one, two in zip(found, expected, strict=True):
            assert one == pytest.approx(two, abs=1e-9)
    assert abs(expected[0]).max() > 0.1
