"""Discrete gusts: the shape of MIL-F-8785C, when and where they act, and what moves them."""

from math import cos, pi, radians, sin

import numpy as np
import pytest
from reference.adapters_atmosphere import active_gusts, gust_velocity

from testbed.atmosphere.gusts import PlaneFrontGust, UniformGust, make_gusts
from testbed.atmosphere.mean_wind import make_mean_wind

AMPLITUDE = (3.0, -1.0, 2.0)
CALM = make_mean_wind(np.zeros(1), np.zeros((1, 3)))
STILL = np.zeros(3)  # a displacement, and a point
FACING = radians(70.0)


def wandering():
    rng = np.random.default_rng(60)
    velocity = rng.normal([4.0, -3.0, 0.0], 1.0, (61, 3))
    return make_mean_wind(np.arange(61.0), velocity)


def timed(*, pulse, start=5.0, ramp=2.0):
    return UniformGust(AMPLITUDE, start=start, ramp=ramp, pulse=pulse)


def front(*, pulse=False, speed=None, direction=FACING, start=4.0, point=(100.0, -40.0)):
    return PlaneFrontGust(
        AMPLITUDE,
        point=point,
        direction=direction,
        start=start,
        length=30.0,
        speed=speed,
        pulse=pulse,
    )


def at(gust, time, point=STILL, wind=CALM):
    """What one gust adds at a time and a point."""
    return gust_velocity(make_gusts([gust], wind), time, point, wind.displacement_ned(time))


@pytest.mark.parametrize(
    ("depth", "ramp", "pulse"),
    # (1 - cos(π x/d))/2 at thirds of d: 1/4 and 3/4
    [(-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1 / 3, 0.25, 0.25), (0.5, 0.5, 0.5), (2 / 3, 0.75, 0.75)]
    + [(1.0, 1.0, 1.0), (4 / 3, 1.0, 0.75), (1.5, 1.0, 0.5), (2.0, 1.0, 0.0), (9.0, 1.0, 0.0)],
)
def test_gust_ramp_and_pulse_shapes(depth, ramp, pulse):
    """A ramp is half a cosine; a pulse goes on with the other half."""
    for part, is_pulse in ((ramp, False), (pulse, True)):
        expected = part * np.array(AMPLITUDE)
        assert at(timed(pulse=is_pulse), 5.0 + 2.0 * depth) == pytest.approx(expected, abs=1e-14)
        behind = np.array([100.0, -40.0, 0.0])
        behind[:2] -= 30.0 * depth * np.array([cos(FACING), sin(FACING)])
        for speed in (None, 7.0):
            found = at(front(pulse=is_pulse, speed=speed), 4.0, behind, wandering())
            assert found == pytest.approx(expected, abs=1e-12)


def test_gust_pulse_integral_is_amplitude_times_rise():
    """The integral of (A/2)(1 - cos(π x/d)) over 2 d is A d; midpoints are exact for a cosine."""
    time = 5.0 + 4.0 * (np.arange(64) + 0.5) / 64
    added = [at(timed(pulse=True), t) for t in time]
    assert np.mean(added, axis=0) * 4.0 == pytest.approx(2.0 * np.array(AMPLITUDE))


@pytest.mark.parametrize("pulse", [False, True])
def test_gust_slope_is_continuous(pulse):
    """Its second derivative is at most A/2 (π/d)², so no slope changes faster than that."""
    time = np.arange(4.0, 10.0, 0.01)
    added = np.array([at(timed(pulse=pulse), t)[0] for t in time])
    curvature = np.diff(added, 2) / 0.01**2
    assert np.abs(curvature).max() <= 1.5 * (pi / 2.0) ** 2 * (1.0 + 1e-6)


def test_timed_gust_is_equal_everywhere():
    points = np.random.default_rng(61).normal(0.0, 500.0, (4, 6, 3))
    added = gust_velocity(make_gusts([timed(pulse=False)], CALM), 6.0, points, STILL)
    assert added.shape == (4, 6, 3)
    assert added == pytest.approx(np.broadcast_to(0.5 * np.array(AMPLITUDE), (4, 6, 3)))


@pytest.mark.parametrize("speed", [0.0, 7.0])
def test_front_moves_at_its_own_speed(speed):
    """In the direction that it faces."""
    gust, rng = front(speed=speed), np.random.default_rng(62)
    for _ in range(50):
        point, time, later = rng.normal(0.0, 60.0, 3), rng.uniform(0.0, 9.0), rng.uniform(0.0, 9.0)
        moved = point + speed * later * np.array([cos(FACING), sin(FACING), 0.0])
        assert at(gust, time + later, moved, wandering()) == pytest.approx(
            at(gust, time, point, wandering()), abs=1e-12
        )


def test_front_without_a_speed_moves_with_the_air():
    """Air that was at the front when it began stays there, and so does all behind it."""
    gust, wind, rng = front(start=4.0), wandering(), np.random.default_rng(63)
    added = []
    for _ in range(50):
        point = rng.normal(0.0, 60.0, 3)
        began = wind.displacement_ned(4.0)
        added.append(at(gust, 4.0, point, wind))
        for time in (0.0, 11.5, 60.0):
            moved = point + wind.displacement_ned(time) - began
            assert at(gust, time, moved, wind) == pytest.approx(added[-1], abs=1e-12)
    ramping = np.abs(np.array(added)[:, 0] - 1.5) < 1.4
    assert 5 < ramping.sum() < 45  # of all three parts of the ramp there were some


def test_front_in_still_air_stands():
    gust = front(direction=pi, point=(100.0, 0.0), start=0.0)  # faces south
    assert at(gust, 50.0, (99.0, 30.0, -100.0)) == pytest.approx(0.0)
    assert at(gust, 50.0, (115.0, -80.0, -50.0)) == pytest.approx(0.5 * np.array(AMPLITUDE))
    assert at(gust, 50.0, (131.0, 0.0, 0.0)) == pytest.approx(AMPLITUDE)


def test_front_is_constant_along_itself_and_upwards():
    along = np.array([-sin(FACING), cos(FACING), 0.0])
    point = np.array([90.0, -45.0, -100.0])
    here = at(front(), 4.0, point)
    assert 0.1 < here[0] < 2.9
    for off in (300.0 * along, -20.0 * along, np.array([0.0, 0.0, 50.0])):
        assert at(front(), 4.0, point + off) == pytest.approx(here, abs=1e-12)


def test_front_rotates_with_the_world():
    turn, rng = 1.1, np.random.default_rng(64)
    rotation = np.array([[cos(turn), -sin(turn), 0], [sin(turn), cos(turn), 0], [0, 0, 1.0]])
    place = rotation @ [100.0, -40.0, 0.0]
    turned = front(direction=FACING + turn, point=(place[0], place[1]), speed=3.0)
    for point in rng.normal(0.0, 80.0, (40, 3)):
        found = at(turned, 6.0, rotation @ point)
        assert found == pytest.approx(at(front(speed=3.0), 6.0, point), abs=1e-12)


def test_gusts_add_up():
    several = [
        timed(pulse=True),
        timed(pulse=False, start=6.0),
        front(speed=5.0),
        front(pulse=True),
    ]
    points, wind = np.random.default_rng(65).normal(50.0, 60.0, (5, 6, 3)), wandering()
    displacement = wind.displacement_ned(7.0)
    together = gust_velocity(make_gusts(several, wind), 7.0, points, displacement)
    alone = [at(gust, 7.0, points, wind) for gust in several]
    assert together == pytest.approx(sum(alone), abs=1e-13)
    none = gust_velocity(make_gusts([], wind), 7.0, points, displacement)
    assert none.shape == points.shape and not none.any()


def test_active_gusts_are_where_gusts_add_wind():
    several = [timed(pulse=True), timed(pulse=False), front(), front(pulse=True)]
    gusts, rng = make_gusts(several, CALM), np.random.default_rng(66)
    seen = np.zeros((4, 2), dtype=int)
    for time in (3.0, 6.0, 8.0, 30.0):
        points = rng.normal((100.0, -40.0, 0.0), 60.0, (50, 3))
        active = active_gusts(gusts, CALM, time, points)
        assert active.shape == (4, 50)
        for g, gust in enumerate(several):
            assert (active[g] == (at(gust, time, points)[:, 0] > 0.0)).all()
            seen[g] += active[g].sum(), (~active[g]).sum()
    assert (seen > 20).all()
