"""Virtual and ideal leaders: derivatives of paths by differences, and a mission."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from close_arrays import assert_close

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, euler_rates, wrap_pi
from testbed.core.records import AIRCRAFT, allocate
from testbed.guidance import analytic_paths as analytic
from testbed.guidance.analytic_paths import (
    SWING,
    CirclePath,
    FigureEightPath,
    SinusoidalPath,
    SpeedChangePath,
    StraightPath,
    turn_radius,
)
from testbed.guidance.flight_plan import (
    GuidanceMission,
    LoiterLeg,
    LoiterLevel,
    WaypointLeg,
    make_plan,
)
from testbed.guidance.mission_follower import begin_flight, guide_unicycle, segment_records
from testbed.guidance.recorded_path import SampledTrajectory
from testbed.scenario.middle_loop import Guidance
from testbed.vehicle.unicycle import advance, make_unicycles, write_motion

START = {"position_ned": (100.0, -50.0, -120.0), "course": 0.7, "speed": 22.0}
CURVES = {
    "straight": StraightPath(**START, climb=1.5),
    "circle": CirclePath(**START, radius=120.0),
    "circle, anticlockwise": CirclePath(**START, radius=120.0, clockwise=False),
    "helix": CirclePath(**START, radius=90.0, climb=-2.0),
    "figure-eight": FigureEightPath(**START, radius=100.0),
    "figure-eight, anticlockwise": FigureEightPath(**START, radius=60.0, clockwise=False),
    "weave": SinusoidalPath(**START, amplitude=40.0, period=20.0),
    "speed-change": SpeedChangePath(**START, amplitude=3.0, period=12.0),
}
WIDE = np.linspace(0.0, 200.0, 1201)
every_curve = pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)


def difference(function, time, step=0.01):
    """The derivative by central differences of fourth order, step⁴ / 30 times the fifth."""
    near = function(time + step) - function(time - step)
    far = function(time + 2.0 * step) - function(time - 2.0 * step)
    return (8.0 * near - far) / (12.0 * step)


def frame_rates(curve, time):
    return analytic.frame_rates(analytic.derivatives(curve, time))


@every_curve
def test_derivatives_equal_finite_differences(curve):
    names = analytic.Derivatives._fields
    path = analytic.derivatives(curve, WIDE)
    for lower, higher in zip(names[:-1], names[1:], strict=True):
        slope = difference(
            lambda time, name=lower: getattr(analytic.derivatives(curve, time), name), WIDE
        )
        # rounding of 5,000 m over 0.01 s; 0.01⁴ / 30 of 22 m/s · (0.88 rad/s)⁵ is 4e-9
        assert_close(slope, getattr(path, higher), 2e-9)
    assert max(np.abs(path.velocity).max(), np.abs(path.acceleration).max()) < 40.0


@every_curve
def test_path_begins_at_its_position_and_course(curve):
    path = analytic.derivatives(curve, np.zeros(1))
    assert path.position[0] == pytest.approx(START["position_ned"], abs=1e-12)
    north, east, down = path.velocity[0]
    assert math.atan2(east, north) == pytest.approx(0.7)
    assert math.sqrt(north**2 + east**2 + down**2) == pytest.approx(22.0)
    assert down == pytest.approx(-getattr(curve, "climb", 0.0))


@every_curve
def test_attitude_and_rates_are_those_of_the_path(curve):
    track = analytic.evaluate(curve, WIDE)
    path = analytic.derivatives(curve, WIDE)
    for name in ("position", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(track, f"{name}_ned"), getattr(path, name))
    assert {len(getattr(track, each.name)) for each in fields(SampledTrajectory)} == {len(WIDE)}

    north, east, down = path.velocity.T
    assert_close(wrap_pi(track.euler[:, 2] - np.arctan2(east, north)), 0.0, 1e-12)
    gamma = -down / np.linalg.norm(path.velocity, axis=1)
    assert_close(np.sin(track.euler[:, 1]), gamma, 1e-14)
    # a coordinated turn: the horizontal acceleration across the velocity is g tan φ
    right = np.column_stack([-np.sin(track.euler[:, 2]), np.cos(track.euler[:, 2])])
    across = (path.acceleration[:, :2] * right).sum(axis=1)
    assert_close(GRAVITY * np.tan(track.euler[:, 0]), across, 1e-12)

    def angles(time):  # unwrapped about now, so that differences are differences
        return wrap_pi(analytic.evaluate(curve, time).euler - track.euler) + track.euler

    turning = euler_rates(track.euler, track.rates_body)
    assert_close(difference(angles, WIDE), turning, 1e-8)


@every_curve
def test_frame_rates_equal_finite_differences(curve):
    rates = frame_rates(curve, WIDE)
    track = analytic.evaluate(curve, WIDE)
    turning = euler_rates(track.euler, track.rates_body)
    assert_close(rates.chi_dot, turning[:, 2], 1e-14)
    assert_close(rates.gamma_dot, turning[:, 1], 1e-14)

    def rate(name):
        return lambda time: getattr(frame_rates(curve, time), name)

    assert_close(difference(rate("chi_dot"), WIDE), rates.chi_ddot, 1e-8)
    assert_close(difference(rate("gamma_dot"), WIDE), rates.gamma_ddot, 1e-8)


def test_frame_rates_with_a_changing_climb():
    """No curve changes its climb, so the formulas for γ̇ and γ̈ meet a path that does."""

    def path(time):
        wave, still = 0.2 * time, np.zeros_like(time)
        rows = [
            (22.0 * time, 5.0 * np.sin(wave), -8.0 * np.cos(wave)),
            (still + 22.0, np.cos(wave), 1.6 * np.sin(wave)),
            (still, -0.2 * np.sin(wave), 0.32 * np.cos(wave)),
            (still, -0.04 * np.cos(wave), -0.064 * np.sin(wave)),
        ]
        return analytic.Derivatives(*(np.stack(row, axis=1) for row in rows))

    def angle(time):
        velocity = path(time).velocity
        return np.arctan2(-velocity[:, 2], np.hypot(velocity[:, 0], velocity[:, 1]))

    rates = analytic.frame_rates(path(WIDE))
    assert np.abs(rates.gamma_dot).max() > 0.01
    assert_close(difference(angle, WIDE), rates.gamma_dot, 1e-11)
    slope = difference(lambda time: analytic.frame_rates(path(time)).gamma_dot, WIDE)
    assert_close(slope, rates.gamma_ddot, 1e-11)


def test_circle_by_hand():
    # σ̇ = 22 / 120 = 0.183333 rad/s; tan φ = 484 / (120 · 9.80665) = 0.4112855, φ = 22.3567°
    track = analytic.evaluate(CURVES["circle"], WIDE)
    assert np.degrees(track.euler[:, 0]) == pytest.approx(22.3567, abs=1e-4)
    assert euler_rates(track.euler, track.rates_body)[:, 2] == pytest.approx(0.1833333, abs=1e-7)
    # p = 0, q = σ̇ sin φ, r = σ̇ cos φ of a level turn
    expected = 22.0 / 120.0 * np.array([0.0, 0.3803709, 0.9248340])
    assert track.rates_body == pytest.approx(np.tile(expected, (len(WIDE), 1)), abs=1e-7)
    centre = np.array([100.0, -50.0]) + 120.0 * np.array([-math.sin(0.7), math.cos(0.7)])
    assert np.hypot(*(track.position_ned[:, :2] - centre).T) == pytest.approx(120.0)
    left = analytic.evaluate(CURVES["circle, anticlockwise"], WIDE)
    assert left.euler[:, 0] == pytest.approx(-track.euler[:, 0])
    # the helix: σ̇ = √(22² − 2²) / 90, and −2 m/s of climb are 2 m/s down
    helix = analytic.evaluate(CURVES["helix"], WIDE)
    rates = frame_rates(CURVES["helix"], WIDE)
    assert rates.chi_dot == pytest.approx(math.sqrt(480.0) / 90.0)
    assert helix.position_ned[:, 2] == pytest.approx(-120.0 + 2.0 * WIDE)
    assert helix.airspeed == pytest.approx(22.0)


def test_figure_eight_closes_with_its_radius():
    curve = CURVES["figure-eight"]
    assert curve.period == pytest.approx(2.0 * math.pi * 2.404826 * 100.0 / 22.0, rel=1e-6)
    time = curve.period * np.linspace(0.0, 1.0, 4001)
    path, rates = analytic.derivatives(curve, time), frame_rates(curve, time)
    start = np.array(START["position_ned"])
    for row in (0, 2000, 4000):  # at the crossing between the loops, and again at the end
        assert path.position[row] == pytest.approx(start, abs=1e-10)
    assert np.linalg.norm(path.velocity, axis=1) == pytest.approx(22.0)
    assert np.abs(rates.chi_dot).max() == pytest.approx(0.22, rel=1e-5)
    assert rates.chi_dot[:2001].min() > -1e-12 and rates.chi_dot[2000:].max() < 1e-12
    # the two ways through the crossing: 2 z = 275.57° apart
    one, two = path.velocity[0] / 22.0, path.velocity[2000] / 22.0
    assert one @ two == pytest.approx(math.cos(2.0 * SWING), abs=1e-12)
    # the loops are mirror images, flown alike, either side of the line along which both tips turn
    tip = 0.7 + SWING
    away = path.position - start
    along = away[:, 0] * math.cos(tip) + away[:, 1] * math.sin(tip)
    across = away[:, 1] * math.cos(tip) - away[:, 0] * math.sin(tip)
    assert_close(along[:2001], along[2000:], 1e-9)
    assert_close(across[:2001], -across[2000:], 1e-9)
    assert np.abs(across).max() == pytest.approx(283.2, abs=0.1)
    assert np.abs(along).max() == pytest.approx(104.7, abs=0.1)


def test_wind_changes_only_the_airspeed():
    wind = (3.0, -4.0, 0.0)
    still, windy = (analytic.evaluate(CURVES["weave"], WIDE, w) for w in ((0, 0, 0), wind))
    expected = np.linalg.norm(still.velocity_ned - wind, axis=1)
    assert windy.airspeed == pytest.approx(expected)
    np.testing.assert_array_equal(windy.velocity_ned, still.velocity_ned)


@pytest.mark.parametrize("climb", [0.0, 6.0, -9.0])
def test_radius_of_a_bank_is_flown_at_it(climb):
    """The attitude along the path has the bank; at the radius of a level turn it has not."""
    bank = math.radians(40.0)
    path = CirclePath(**START, radius=turn_radius(bank, 22.0, climb), climb=climb)
    assert analytic.evaluate(path, WIDE).euler[:, 0] == pytest.approx(bank, abs=1e-12)
    level = replace(path, radius=turn_radius(bank, 22.0))
    assert (analytic.evaluate(level, WIDE).euler[0, 0] == pytest.approx(bank)) == (climb == 0.0)
    # the largest one is accepted, at every speed
    for speed in np.linspace(15.0, 25.0, 101):
        CirclePath(**START | {"speed": speed}, radius=turn_radius(math.radians(60.0), speed))


@pytest.mark.parametrize(
    "name, change, words",
    [
        ("straight", {"speed": 0.0}, "speed_mps: must be positive, not 0"),
        ("straight", {"speed": math.nan}, "speed_mps: must be positive, not nan"),
        ("straight", {"climb": 22.0}, "climb_mps: .* write less than 22"),
        ("helix", {"climb": -30.0}, "climb_mps: .* write less than 22"),
        ("circle", {"radius": -120.0}, "radius_m: must be positive"),
        # 22² / (9.80665 tan 60°) = 28.495 m; atan(22² / (9.80665 · 20)) = 67.95°
        ("circle", {"radius": 20.0}, "radius_m: .* needs 68 degrees .* write 28.5 or more"),
        ("figure-eight", {"radius": 28.0}, "radius_m: .* write 28.5 or more"),
        # 2π √(40 / 16.986) = 9.642 s
        ("weave", {"period": 9.6}, "period_s: .* write 9.7 or more, or a smaller amplitude_m"),
        ("weave", {"amplitude": 0.0}, "amplitude_m: must be positive"),
        ("speed-change", {"amplitude": 22.0}, "amplitude_mps: .* write less than 22"),
        ("speed-change", {"period": math.inf}, "period_s: must be positive"),
    ],
)
def test_impossible_path_is_an_error(name, change, words):
    with pytest.raises(InputError, match=words):
        replace(CURVES[name], **change)


def test_value_from_an_error_is_accepted():
    assert replace(CURVES["circle"], radius=28.5).radius == 28.5
    assert replace(CURVES["weave"], period=9.7).period == 9.7


# The mission of Simulation 3: level laps, laps with two raised corners, a circle at five levels.
CORNERS = ((640.0, 0.0), (640.0, 640.0), (0.0, 640.0), (0.0, 0.0))
LEVEL = tuple((*corner, 100.0) for corner in CORNERS)
RAISED = tuple((*corner, 150.0 if i in (1, 3) else 100.0) for i, corner in enumerate(CORNERS))
CIRCLE = LoiterLeg(
    centre=(320.0, 320.0),
    radius=120.0,
    levels=(
        LoiterLevel(100, 3),
        LoiterLevel(130, 3),
        LoiterLevel(100, 3),
        LoiterLevel(150, 3),
        LoiterLevel(120, 1),
    ),
)


@pytest.fixture(scope="module")
def flight():
    """Rows of time, north, east, altitude, speed, bank and part at 25 Hz for 1080 s."""
    legs = (WaypointLeg(LEVEL[1:]), WaypointLeg(LEVEL, 2), WaypointLeg(RAISED, 2), CIRCLE)
    plan = make_plan(GuidanceMission(legs=legs, airspeed=22.0), (640.0, -80.0, 100.0))
    held, gains = (100.0, 0.0, 0.0, 0.0), Guidance().model_dump()
    state, segments = begin_flight(plan, held, dt=0.04, gains=gains), segment_records(plan)
    position, velocity = np.array([[640.0, -80.0, -100.0]]), np.array([[0.0, 22.0, 0.0]])
    leader, aircraft = make_unicycles(position, velocity, np.array([0.64])), allocate(AIRCRAFT, 1)
    row, truth, estimate = np.zeros(1, dtype=np.intp), aircraft["truth"], aircraft["estimate"]
    rows, speed, turn = [], np.zeros(1), np.zeros(3)
    # views, as numpy finds a field of records slowly
    place, airspeed, euler = (truth[each] for each in ("position_ned", "airspeed", "euler"))
    speed_command, omega = leader["speed_command"], leader["omega"]
    part = state["memory"]["segment"]
    for k in range(1080 * 25):
        write_motion(leader, row, aircraft)
        north, east, down = place[0].tolist()
        estimate[:] = truth
        guide_unicycle(0, aircraft, segments, state, speed, turn)
        assert speed[0] == 22.0 and turn[0] == 0.0
        speed_command[:], omega[:] = speed, turn
        write_motion(leader, row, aircraft)
        rows.append([k / 25.0, north, east, -down, airspeed[0], euler[0, 0], part[0]])
        advance(leader, 1.0 / 200.0, 8)
    return np.array(rows).T


def test_ideal_leader_passes_corners_at_altitude(flight):
    time, north, east, altitude, speed, _, part = flight
    begun = np.flatnonzero(np.diff(part)) + 1
    assert part[-1] == 23 and len(begun) == 23
    begun = begun[:19]  # the rest are levels of the circle
    corner = np.array((LEVEL[1:] + LEVEL * 2 + RAISED * 2), dtype=float)
    away = np.hypot(north[begun] - corner[:, 0], east[begun] - corner[:, 1])
    # a path angle lags by 1/k_p = 0.5 s, which is 1 m at the 2 m/s of the climbs
    assert altitude[begun] == pytest.approx(corner[:, 2], abs=1.0)
    # a turn begins 0.75 · 15 s · 22 m/s / π = 78.8 m ahead, found out at most 0.9 m later
    assert np.all(away[:-1] < 79.0) and np.all(away[:-1] > 77.5)
    assert_close(speed, 22.0, 1e-9)

    # A lap is four sides less what each corner cuts: a turn on 22² / (g tan 30°) = 85.5 m saves
    # (2 − π/2) · 85.5 = 36.7 m. L1 begins its turn 6.9 m late and eases out of it: up to 2 s more.
    laps = np.diff(time[begun[2:-1:4]])
    assert len(laps) == 3
    shortest = (4.0 * 640.0 - 4.0 * 36.7) / 22.0
    assert np.all(laps > shortest) and np.all(laps < shortest + 2.0)


def test_ideal_leader_keeps_to_legs_and_bank_limit(flight):
    _, north, east, _, _, bank, part = flight
    laps = (part > 0) & (part < 19)
    corner = np.array(CORNERS)
    near = np.hypot(north[:, np.newaxis] - corner[:, 0], east[:, np.newaxis] - corner[:, 1])
    aside = np.min([np.abs(north), np.abs(north - 640.0), np.abs(east), np.abs(east - 640.0)], 0)
    assert aside[laps & (near.min(axis=1) > 200.0)].max() < 5.0
    assert near[laps].min() == pytest.approx(85.5 * (math.sqrt(2.0) - 1.0), abs=7.0)
    assert np.degrees(np.abs(bank).max()) == pytest.approx(30.0, abs=1e-9)


def test_ideal_leader_counts_turns(flight):
    time, north, east, altitude, _, bank, part = flight
    change = np.flatnonzero(np.diff(part))[19:] + 1
    assert altitude[change] == pytest.approx([100.0, 130.0, 100.0, 150.0], abs=0.1)
    # three turns of 2π · 120 m at 22 m/s, 102.8 s; a climb at 1.5 m/s is 0.2 % slower over ground
    assert np.diff(time[change]) == pytest.approx(6.0 * math.pi * 120.0 / 22.0, abs=0.3)
    circle = time > change[0] / 25.0
    assert_close(np.hypot(north - 320.0, east - 320.0)[circle], 120.0, 0.01)
    # atan(22² / (120 · 9.80665)), less the climb's share of the speed
    assert_close(np.degrees(bank[circle]), 22.356, 0.15)
    assert altitude[-1] == pytest.approx(120.0, abs=0.1)
