"""Trailing vortices: their strength, their place, the velocity about them and what it does."""

import os
from functools import partial

import numpy as np
import pytest

from testbed.air import wake
from testbed.air.lifting_line import nodes, roll_coefficient, roll_gain
from testbed.air.trails import abeam, remember, straight
from testbed.air.vortices import horseshoe, pairs
from testbed.air.wake import Wakes
from testbed.errors import InputError
from testbed.frames import GRAVITY, rotation_ned_body

DT = 0.005
DENSITY = 1.18
SPAN, MASS, SPEED = 2.795, 6.577, 22.0
CORE_SPANS = 0.05
PAIR = 0.25 * np.pi * SPAN  # b₀
CIRCULATION = MASS * GRAVITY / (DENSITY * SPEED * PAIR)
SINKING = CIRCULATION / (2.0 * np.pi * PAIR)  # m/s
FLIGHTS = int(os.environ.get("TESTBED_AIR_SAMPLES", "20"))


def make(count=2, **changes):
    given = {
        "span": np.full(count, SPAN),
        "area": np.full(count, 0.98198),
        "lift_slope": np.full(count, 5.0),
        "mass": np.full(count, MASS),
        "sheds": np.ones(count, dtype=bool),
        "feels": np.ones(count, dtype=bool),
        "core_spans": CORE_SPANS,
        "decay_s": None,
        "memory_s": 10.0,
        "dt": DT,
        "density": DENSITY,
    }
    return Wakes(**given | changes)


def level(wakes, *positions, heading=0.0):
    """What is felt by aircraft that have flown straight and level to (forward, right, down)."""
    turn = rotation_ned_body(np.array([0.0, 0.0, heading]))
    position = np.array(positions, dtype=float) @ turn.T
    velocity = np.tile(SPEED * turn[:, 0], (len(position), 1))
    euler = np.tile([0.0, 0.0, heading], (len(position), 1))
    wind, roll = felt(wakes, position, velocity, np.zeros_like(position), euler)
    return wind @ turn, roll


def felt(wakes, position, velocity, acceleration, euler, ambient=0.0):
    """Wind (N, 3) and rolling-moment coefficient (N,) of the next step."""
    wind, roll = np.zeros_like(position), np.zeros(len(position))
    ambient = np.zeros_like(position) + ambient
    wakes.bind(position, velocity, acceleration, euler, ambient, wind, roll)()
    return wind, roll


def small(**changes):
    """A follower of no span: it feels the air at a point."""
    span, area = np.array([SPAN, 1e-6]), np.array([0.98198, 1e-13])
    return make(span=span, area=area, sheds=np.array([True, False]), **changes)


# ----------------------------------------------------------------------------- the lifting line


def test_the_quadrature_is_exact_for_polynomials():
    points, weights = nodes(6)
    # ∫ x^k √(1 − x²) dx over ∫ √(1 − x²) dx
    for power, exact in ((0, 1.0), (1, 0.0), (2, 1 / 4), (4, 1 / 8), (6, 5 / 64), (10, 21 / 512)):
        assert (weights * points**power).sum() == pytest.approx(exact, abs=1e-15)


def test_a_rolling_wing_is_damped_as_the_closed_form_says():
    aspect_ratio, slope = 7.955, 5.0
    section = slope / (1.0 - slope / (np.pi * aspect_ratio))
    mu = section / (np.pi * aspect_ratio)
    points, _ = nodes(8)
    speed, rate, span = 22.0, 0.7, 2.795
    found = roll_coefficient(
        -rate * 0.5 * span * points, np.float64(speed), roll_gain(aspect_ratio, slope)
    )
    damping = -section / 8.0 / (1.0 + 2.0 * mu)
    assert found / (rate * span / (2.0 * speed)) == pytest.approx(damping, rel=1e-12)
    assert damping == pytest.approx(-0.52, abs=0.005)


def test_a_wing_in_any_downwash_rolls_as_prandtls_equation_says():
    """Solved as it stands for the circulation at 60 places, by collocation."""
    rng = np.random.default_rng(1)
    aspect_ratio, section = 5.88, 5.139
    count = 60
    theta = np.arange(1, count + 1) * np.pi / (count + 1)
    order = np.arange(1, count + 1)
    mu = section / (np.pi * aspect_ratio)
    # Glauert eq. (11.7), with the elliptic chord's μ sin θ
    equation = np.sin(theta[:, None] * order) * (order * mu + 1.0)
    points, _ = nodes(32)
    for _ in range(10):
        curve = np.polynomial.Polynomial(rng.normal(0.0, 0.5, 9))
        series = np.linalg.solve(equation, -mu * curve(np.cos(theta)) * np.sin(theta))
        found = roll_coefficient(
            18.0 * curve(points), np.float64(18.0), roll_gain(aspect_ratio, section / (1.0 + mu))
        )
        assert found == pytest.approx(-0.25 * np.pi * aspect_ratio * series[1], rel=1e-10)


def test_no_wing_lifts_more_than_its_aspect_ratio_lets_it():
    with pytest.raises(InputError, match="aspect ratio 1 has the lift slope 3.2 per rad: .* 3.14$"):
        roll_gain(np.array([8.0, 1.0]), np.array([5.0, 3.2]))


# ------------------------------------------------------------------------------- the horseshoe


def test_the_velocity_of_a_horseshoe_is_biot_and_savarts():
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


def test_an_elliptic_sheet_of_many_pairs_washes_as_prandtl_says():
    """Γ₀/(2 b) down along the wing, and up beside it."""
    places, shares = pairs(2000)
    assert shares.sum() == pytest.approx(1.0, rel=1e-12)
    for eta in (0.0, 1.2, 1.5, 2.0):
        at = np.array([0.0, 0.5 * SPAN * eta, 0.0])
        down = (shares * horseshoe(at, 0.5 * SPAN * places, np.array(1e-6))[:, 2]).sum()
        exact = 1.0 if eta < 1.0 else 1.0 - eta / np.sqrt(eta**2 - 1.0)
        assert down == pytest.approx(exact / (2.0 * SPAN), rel=1.0 / 2000)


@pytest.mark.parametrize("count", [1, 3, 8])
def test_the_pairs_carry_the_lift_of_an_elliptic_wing(count):
    places, shares = pairs(count)
    assert (places * shares).sum() == pytest.approx(0.25 * np.pi, rel=1e-12)
    assert np.all((0.0 < places) & (places < 1.0))


# ---------------------------------------------------------------------- strength, age and place


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


def test_far_behind_level_flight_lies_a_vortex_pair_that_has_sunk():
    sunk = SINKING * 500.0 / SPEED
    for y, z in ((0.0, 0.0), (1.0, 0.3), (1.2, -0.1), (-2.0, 1.0), (4.0, -2.0)):
        wind, _ = level(small(memory_s=60.0), (0.0, 0.0, 0.0), (-500.0, y, sunk + z))
        assert wind[1, 0] == pytest.approx(0.0, abs=1e-6)
        assert wind[1, 1:] == pytest.approx(two_dimensional(y, z), abs=1e-5)


def test_the_circulation_bears_the_weight_and_the_load_of_a_turn():
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
        down[bank] = felt(wakes, position, velocity, pulled, euler)[0][1] @ axes / load
    assert down[0.5] == pytest.approx(down[0.0], abs=1e-6)
    assert down[0.0][2] == pytest.approx(two_dimensional(0.0, 0.0)[1], abs=1e-6)


def test_a_trail_sinks_at_the_speed_that_its_vortices_give_each_other():
    age, delta = 4.0, 0.4  # s, m
    for decay_s, aged in ((None, age), (3.0, 3.0 * (1.0 - np.exp(-age / 3.0)))):
        at = [(-SPEED * age, 0.8, SINKING * aged + z) for z in (-delta, delta)]
        above, below = (level(small(decay_s=decay_s), (0, 0, 0), each)[0][1] for each in at)
        assert above[2] == pytest.approx(below[2], rel=1e-9)
        assert above[1] == pytest.approx(-below[1], rel=1e-9)
        assert abs(above[1]) > 0.01


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0, 1.5])
def test_the_sheet_rolls_up_within_spreiter_and_sacks_distance(share):
    area = 0.98198
    lift_coefficient = MASS * GRAVITY / (0.5 * DENSITY * SPEED**2 * area)
    behind = share * 0.28 * (SPAN**2 / area) / lift_coefficient * SPAN
    places, shares = pairs(wake.PAIRS)
    rolled = np.pi / 4.0
    drawn = 0.5 * SPAN * (rolled + (places - rolled) * max(0.0, 1.0 - share))
    sunk = SINKING * behind / SPEED
    for y in (0.3, 1.1, 1.6):
        wind, _ = level(small(), (0.0, 0.0, 0.0), (-behind, y, 0.2))
        at = np.array([-behind, y, 0.2 - sunk])
        one = horseshoe(at, drawn, np.array(CORE_SPANS * SPAN))
        assert wind[1] == pytest.approx(CIRCULATION * (shares @ one), abs=1e-6)


def test_a_trail_decays_with_its_age():
    light = np.array([1e-3, 1e-3])  # it hardly sinks
    for age in (0.5, 2.0, 6.0):
        at = ((0.0, 0.0, 0.0), (-SPEED * age, 0.7, 0.0))
        fresh, old = (level(make(mass=light, decay_s=decay), *at) for decay in (None, 3.0))
        kept = np.exp(-age / 3.0)
        assert old[0][1, 2] == pytest.approx(kept * fresh[0][1, 2], rel=1e-6)
        assert old[1][1] == pytest.approx(kept * fresh[1][1], rel=1e-6)


def test_a_trail_fades_out_where_memory_ends():
    light = np.array([1e-3, 1e-3])
    strong, half, nothing = (
        level(make(mass=light), (0.0, 0.0, 0.0), (-SPEED * age, 0.7, 0.0))[0][1, 2]
        for age in (8.9, 9.5, 10.01)
    )
    assert half == pytest.approx(0.5 * strong, rel=1e-3)
    assert nothing == 0.0


def circling(turn, seconds):
    """The trail of one aircraft that circles; where it was at a time, and which way it flew."""
    radius = SPEED / turn if turn else np.inf

    def at(time):
        angle = turn * time
        if turn:
            place = radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        else:
            place = np.array([SPEED * time, 0.0, 0.0])
        return place, np.array([np.cos(angle), np.sin(angle), 0.0])

    right = np.array([[0.0, 1.0, 0.0]])
    place, forward = at(0.0)
    trails = straight(
        place[None], SPEED * forward[None], forward[None], right, np.ones(1), kept=10, dt=DT,
        memory_s=6.0,
    )  # fmt: skip
    for tick in range(round(seconds / DT) + 1):
        place, forward = at(tick * DT)
        right = np.array([[-forward[1], forward[0], 0.0]])
        remember(trails, 10, tick, place[None], forward[None], right, np.ones(1))
    return trails, at


@pytest.mark.parametrize("bank_deg", [0.0, 30.0])
def test_twenty_five_metres_behind_the_trail_is_where_the_aircraft_was(bank_deg):
    turn = GRAVITY * np.tan(np.radians(bank_deg)) / SPEED
    trails, at = circling(turn, 2.0)
    there, forward = at(2.0 - 25.0 / SPEED)
    aside = np.array([-forward[1], forward[0], 0.0])
    for offset in (-2.0, 0.0, 1.5):
        found = abeam(trails, DT, (there + offset * aside)[None])
        assert found.found.all()
        # the chord between places 1.1 m apart leaves the circle by (1.1 m)²/(8 R)
        assert found.position[0, 0] == pytest.approx(there, abs=0.002)
        assert found.forward[0, 0] == pytest.approx(forward, abs=1e-3)
        assert found.right[0, 0] == pytest.approx(aside, abs=1e-3)
        assert found.ahead[0, 0] == pytest.approx(25.0, abs=0.03)
        assert found.age[0, 0] == pytest.approx(25.0 / SPEED, abs=1e-3)
    if bank_deg:
        now, onward = at(2.0)
        astray = np.linalg.norm(now - 25.0 * onward - there)
        assert astray == pytest.approx(25.0**2 / (2.0 * SPEED / turn), rel=0.02)


def test_what_was_flown_before_the_first_step_was_straight():
    trails, _ = circling(0.3, 1.0)
    found = abeam(trails, DT, np.array([[-40.0, 1.0, 0.0]]))
    assert found.position[0, 0] == pytest.approx([-40.0, 0.0, 0.0], abs=1e-9)
    assert found.ahead[0, 0] == pytest.approx(40.0 + SPEED, abs=1e-3)


def test_two_aircraft_in_a_turn_feel_what_they_would_in_straight_flight():
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
        wind, roll = felt(wakes, position, SPEED * forward, SPEED * turn * inward, euler)
    heavier = make(mass=np.full(2, MASS / np.cos(bank)))
    wind_level, roll_level = level(heavier, (0.0, 0.0, 0.0), (-25.0, offset, 0.0))
    axes = rotation_ned_body(euler)[1]
    assert abs(roll_level[1]) > 1e-3
    assert wind[1] @ axes == pytest.approx(wind_level[1], abs=0.01 * abs(wind_level[1]).max())
    assert roll[1] == pytest.approx(roll_level[1], rel=0.01)


# --------------------------------------------------------------------------------- who feels it


def test_nobody_feels_itself_and_masks_are_kept():
    assert not np.any(level(make(1), (0.0, 0.0, 0.0))[0])
    positions = (0.0, 0.0, 0.0), (-10.0, 1.0, 0.2), (-20.0, -1.0, 0.0)
    some = np.array([True, False, True])
    whole, _ = level(make(3), *positions)
    assert np.all(whole != 0.0)
    deaf_wind, deaf_roll = level(make(3, feels=some), *positions)
    assert not deaf_wind[1].any()
    assert deaf_roll[1] == 0.0
    assert np.array_equal(deaf_wind[[0, 2]], whole[[0, 2]])
    without, _ = level(make(3, sheds=some), *positions)
    assert without[[0, 2]] == pytest.approx(level(make(2), *positions[::2])[0], abs=1e-15)


def test_mirrored_flights_roll_the_other_way():
    for offset in (0.3, 0.9, 2.0):
        one = level(make(), (0.0, 0.0, 0.0), (-8.0, offset, 0.1))
        two = level(make(), (0.0, 0.0, 0.0), (-8.0, -offset, 0.1))
        assert two[0][1] == pytest.approx(one[0][1] * [1.0, -1.0, 1.0], abs=1e-12)
        assert two[1][1] == pytest.approx(-one[1][1], abs=1e-12)


def test_what_is_felt_does_not_depend_on_the_heading():
    at = (0.0, 0.0, 0.0), (-8.0, 1.0, 0.2), (-30.0, -2.0, 0.0)
    north, east = level(make(3), *at), level(make(3), *at, heading=2.1)
    for one, two in zip(north, east, strict=True):
        assert two == pytest.approx(one, abs=1e-12)


def test_a_right_wing_in_the_downwash_goes_down_and_a_wing_beside_the_vortex_is_lifted():
    wind, roll = level(make(), (0.0, 0.0, 0.0), (-SPAN, -0.5 * SPAN, 0.0))
    assert roll[1] > 0.005
    wind, _ = level(make(), (0.0, 0.0, 0.0), (-SPAN, SPAN, 0.0))
    assert wind[1, 2] < -0.05
    assert -0.02 < wind[0, 2] < 0.0  # the leader is lifted a little by who follows


def test_nothing_jumps_as_a_follower_draws_level_with_the_wing():
    near = [level(make(), (0.0, 0.0, 0.0), (x, 3.0, 0.3)) for x in (-1e-7, 0.0, 1e-7)]
    for wind, roll in near[1:]:
        assert wind == pytest.approx(near[0][0], abs=1e-6)
        assert roll == pytest.approx(near[0][1], abs=1e-6)


def test_nothing_jumps_as_places_are_kept():
    """Flown on, and begun anew at every tick, are one flight as long as it is straight."""
    wakes = make()
    first = None
    for tick in range(45):
        wind, roll = level(wakes, (SPEED * tick * DT, 0, 0), (SPEED * tick * DT - 9.0, 1.0, 0.1))
        first = first or (wind, roll)
        assert wind == pytest.approx(first[0], abs=1e-12)
        assert roll == pytest.approx(first[1], abs=1e-12)


# --------------------------------------------------------------------------------- the twin


def flight(rng, count):
    """Aircraft that fly behind and beside one another and wander: arguments of `step`."""
    start = np.stack(
        [-6.0 * np.arange(count), rng.normal(0.0, 2.0, count), rng.normal(0.0, 0.5, count)], axis=-1
    )
    turn, wave = rng.normal(0.0, 0.3), rng.uniform(0.5, 2.0, (count, 3))
    for tick in range(60):
        time = 0.02 * tick
        wander = 0.3 * np.sin(wave * time)
        heading = turn * time
        forward = np.array([np.cos(heading), np.sin(heading), 0.0])
        velocity = 20.0 * forward + 0.3 * wave * np.cos(wave * time)
        place = 20.0 * time * forward + wander
        yield (
            start + place,
            velocity,
            rng.normal(0.0, 3.0, (count, 3)),
            np.stack([wander[:, 0], 0.2 * wander[:, 1], heading + 0.1 * wander[:, 2]], axis=-1),
        )


def test_the_compiled_twin_does_the_same(monkeypatch):
    pytest.importorskip("numba")
    from testbed.air import wake_twin

    rng = np.random.default_rng(3)
    most = 0.0
    for _ in range(FLIGHTS):
        count = int(rng.integers(1, 7))
        given = {
            "span": rng.uniform(1.5, 3.0, count),
            "mass": rng.uniform(2.0, 8.0, count),
            "sheds": rng.random(count) < 0.8,
            "feels": rng.random(count) < 0.8,
            "core_spans": rng.uniform(0.01, 0.1),
            "decay_s": rng.choice([None, 5.0]),
            "memory_s": rng.choice([0.5, 4.0]),
            "dt": rng.choice([0.02, 0.1]),
        }
        ours, theirs = make(count, **given), make(count, **given)
        for now in flight(rng, count):
            ambient = rng.normal(0.0, 3.0, (count, 3))
            monkeypatch.setattr(wake, "READY_WAKES", partial(partial, wake.add_wakes))
            wind, roll = felt(ours, *now, ambient)
            monkeypatch.setattr(wake, "READY_WAKES", wake_twin.ready_add_wakes)
            compiled = felt(theirs, *now, ambient)
            assert compiled[0] == pytest.approx(wind, abs=1e-11)
            assert compiled[1] == pytest.approx(roll, abs=1e-11)
            most = max(most, abs(wind).max())
    assert most > 0.3
