"""Discrete gusts: the shape of MIL-F-8785C, when and where they are felt, and what carries them."""

from math import cos, pi, radians, sin

import numpy as np
import pytest

from testbed.air.gusts import PlacedGust, TimedGust, make_gusts
from testbed.air.mean import make_mean_wind

AMPLITUDE = (3.0, -1.0, 2.0)
CALM = make_mean_wind(np.zeros(1), np.zeros((1, 3)))
STILL = np.zeros(3)  # a displacement, and a point
FACING = radians(70.0)


def wandering():
    rng = np.random.default_rng(60)
    velocity = rng.normal([4.0, -3.0, 0.0], 1.0, (61, 3))
    return make_mean_wind(np.arange(61.0), velocity)


def timed(*, pulse, start=5.0, ramp=2.0):
    return TimedGust(AMPLITUDE, start=start, ramp=ramp, pulse=pulse)


def placed(*, pulse=False, speed=None, towards=FACING, start=4.0, place=(100.0, -40.0)):
    return PlacedGust(
        AMPLITUDE,
        place=place,
        towards=towards,
        start=start,
        length=30.0,
        speed=speed,
        pulse=pulse,
    )


def at(gust, time, point=STILL, wind=CALM):
    """What one gust adds at a time and a point."""
    return make_gusts([gust], wind).velocity_ned(
        time, np.asarray(point), wind.displacement_ned(time)
    )


@pytest.mark.parametrize(
    ("depth", "ramp", "pulse"),
    # (1 - cos(π x/d))/2 at thirds of d: 1/4 and 3/4
    [(-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1 / 3, 0.25, 0.25), (0.5, 0.5, 0.5), (2 / 3, 0.75, 0.75)]
    + [(1.0, 1.0, 1.0), (4 / 3, 1.0, 0.75), (1.5, 1.0, 0.5), (2.0, 1.0, 0.0), (9.0, 1.0, 0.0)],
)
def test_the_shape_is_half_a_cosine_and_for_a_pulse_the_other_half(depth, ramp, pulse):
    for part, is_pulse in ((ramp, False), (pulse, True)):
        expected = part * np.array(AMPLITUDE)
        assert at(timed(pulse=is_pulse), 5.0 + 2.0 * depth) == pytest.approx(expected, abs=1e-14)
        behind = np.array([100.0, -40.0, 0.0])
        behind[:2] -= 30.0 * depth * np.array([cos(FACING), sin(FACING)])
        for speed in (None, 7.0):
            given = at(placed(pulse=is_pulse, speed=speed), 4.0, behind, wandering())
            assert given == pytest.approx(expected, abs=1e-12)


def test_a_pulse_carries_its_top_times_its_rise():
    """The integral of (A/2)(1 - cos(π x/d)) over 2 d is A d; midpoints are exact for a cosine."""
    time = 5.0 + 4.0 * (np.arange(64) + 0.5) / 64
    added = [at(timed(pulse=True), t) for t in time]
    assert np.mean(added, axis=0) * 4.0 == pytest.approx(2.0 * np.array(AMPLITUDE))


@pytest.mark.parametrize("pulse", [False, True])
def test_a_gust_begins_and_ends_without_a_jump_of_its_slope(pulse):
    """Its second derivative is at most A/2 (π/d)², so no slope changes faster than that."""
    time = np.arange(4.0, 10.0, 0.01)
    added = np.array([at(timed(pulse=pulse), t)[0] for t in time])
    bending = np.diff(added, 2) / 0.01**2
    assert np.abs(bending).max() <= 1.5 * (pi / 2.0) ** 2 * (1.0 + 1e-6)


def test_a_gust_at_a_time_is_felt_alike_everywhere():
    points = np.random.default_rng(61).normal(0.0, 500.0, (4, 6, 3))
    added = make_gusts([timed(pulse=False)], CALM).velocity_ned(6.0, points, STILL)
    assert added.shape == (4, 6, 3)
    assert added == pytest.approx(np.broadcast_to(0.5 * np.array(AMPLITUDE), (4, 6, 3)))


@pytest.mark.parametrize("speed", [0.0, 7.0])
def test_a_front_moves_at_its_own_speed_where_it_faces(speed):
    gust, rng = placed(speed=speed), np.random.default_rng(62)
    for _ in range(50):
        point, time, later = rng.normal(0.0, 60.0, 3), rng.uniform(0.0, 9.0), rng.uniform(0.0, 9.0)
        moved = point + speed * later * np.array([cos(FACING), sin(FACING), 0.0])
        assert at(gust, time + later, moved, wandering()) == pytest.approx(
            at(gust, time, point, wandering()), abs=1e-12
        )


def test_a_front_without_a_speed_goes_with_the_air():
    """Air that was at the front when it began stays there, and so does all behind it."""
    gust, wind, rng = placed(start=4.0), wandering(), np.random.default_rng(63)
    felt = []
    for _ in range(50):
        point = rng.normal(0.0, 60.0, 3)
        began = wind.displacement_ned(4.0)
        felt.append(at(gust, 4.0, point, wind))
        for time in (0.0, 11.5, 60.0):
            moved = point + wind.displacement_ned(time) - began
            assert at(gust, time, moved, wind) == pytest.approx(felt[-1], abs=1e-12)
    ramping = np.abs(np.array(felt)[:, 0] - 1.5) < 1.4
    assert 5 < ramping.sum() < 45  # of all three parts of the ramp there were some


def test_in_still_air_it_stands_and_is_flown_into():
    gust = placed(towards=pi, place=(100.0, 0.0), start=0.0)  # faces south
    assert at(gust, 50.0, (99.0, 30.0, -100.0)) == pytest.approx(0.0)
    assert at(gust, 50.0, (115.0, -80.0, -50.0)) == pytest.approx(0.5 * np.array(AMPLITUDE))
    assert at(gust, 50.0, (131.0, 0.0, 0.0)) == pytest.approx(AMPLITUDE)


def test_along_the_front_and_up_nothing_changes():
    along = np.array([-sin(FACING), cos(FACING), 0.0])
    point = np.array([90.0, -45.0, -100.0])
    here = at(placed(), 4.0, point)
    assert 0.1 < here[0] < 2.9
    for off in (300.0 * along, -20.0 * along, np.array([0.0, 0.0, 50.0])):
        assert at(placed(), 4.0, point + off) == pytest.approx(here, abs=1e-12)


def test_turning_the_world_turns_where_a_gust_is():
    turn, rng = 1.1, np.random.default_rng(64)
    rotation = np.array([[cos(turn), -sin(turn), 0], [sin(turn), cos(turn), 0], [0, 0, 1.0]])
    place = rotation @ [100.0, -40.0, 0.0]
    turned = placed(towards=FACING + turn, place=(place[0], place[1]), speed=3.0)
    for point in rng.normal(0.0, 80.0, (40, 3)):
        given = at(turned, 6.0, rotation @ point)
        assert given == pytest.approx(at(placed(speed=3.0), 6.0, point), abs=1e-12)


def test_several_gusts_add_up():
    several = [
        timed(pulse=True),
        timed(pulse=False, start=6.0),
        placed(speed=5.0),
        placed(pulse=True),
    ]
    points, wind = np.random.default_rng(65).normal(50.0, 60.0, (5, 6, 3)), wandering()
    together = make_gusts(several, wind).velocity_ned(7.0, points, wind.displacement_ned(7.0))
    alone = [at(gust, 7.0, points, wind) for gust in several]
    assert together == pytest.approx(sum(alone), abs=1e-13)
    none = make_gusts([], wind).velocity_ned(7.0, points, wind.displacement_ned(7.0))
    assert none.shape == points.shape and not none.any()


def test_an_aircraft_is_inside_where_the_gust_adds_something():
    several = [timed(pulse=True), timed(pulse=False), placed(), placed(pulse=True)]
    gusts, rng = make_gusts(several, CALM), np.random.default_rng(66)
    seen = np.zeros((4, 2), dtype=int)
    for time in (3.0, 6.0, 8.0, 30.0):
        points = rng.normal((100.0, -40.0, 0.0), 60.0, (50, 3))
        felt = gusts.inside(time, points, STILL)
        assert felt.shape == (4, 50)
        for g, gust in enumerate(several):
            assert (felt[g] == (at(gust, time, points)[:, 0] > 0.0)).all()
            seen[g] += felt[g].sum(), (~felt[g]).sum()
    assert (seen > 20).all()
