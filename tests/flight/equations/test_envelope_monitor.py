"""Limits of airspeed, angle of attack and distance from the slot: worked histories."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from testbed.core.random import named_stream
from testbed.core.records import AIRCRAFT, FOLLOWER, allocate
from testbed.flight.limits import EXCESS, RECOVERED, EnvelopeMonitor, find_exceeded

DT = 0.04
NAMES = ("leader", "uav1", "uav2")
ALL_FLYING = ((False, False, False), (False, False))
OVERSPEED, STALL, FORMATION = 40.0, math.radians(13.0), 100.0


def make(faults=None, *, stops=False):
    limits = np.tile([[OVERSPEED], [STALL], [FORMATION]], (1, 3))
    return EnvelopeMonitor(NAMES, limits, faults, stops=stops)


def simulate(monitor, histories, *, away=ALL_FLYING, first=0):
    """The events of histories by step: uav1's airspeed, angle of attack in deg, and distance.

    `away` are the aircraft that are lost (3), and the followers that have left their slots (2).
    """
    aircraft, followers, events = allocate(AIRCRAFT, 3), allocate(FOLLOWER, 2), []
    aircraft["lost"], left = away[0], np.array(away[1])
    aircraft["truth"]["equivalent_airspeed"], aircraft["air"]["alpha"] = 20.0, math.radians(3.0)
    followers["error_ned"][1] = [1.0, 0.0, 0.0]
    find = monitor.bind(aircraft, followers, left)
    for k, (airspeed, alpha, distance) in enumerate(histories, start=first):
        aircraft["truth"]["equivalent_airspeed"][1] = airspeed
        aircraft["air"]["alpha"][1] = np.radians(alpha)
        followers["error_ned"][0] = [0.6 * distance, 0.0, 0.8 * distance]
        events += monitor.changes(k * DT) if find(k * DT) else ()
    return events


def lines(events):
    return [(round(e.time_s, 6), e.level, e.source, e.text) for e in events]


CALM = (20.0, 3.0, 1.0)


def test_within_the_limits_there_is_no_event():
    near = (OVERSPEED, math.degrees(STALL), FORMATION)
    monitor = make()
    assert simulate(monitor, [(*near[:2], 0.0)] + [near] * 400) == []
    assert (monitor.outcome, monitor.terminate) == ("completed", False)


@pytest.mark.parametrize(
    ("history", "begins", "ends"),
    [
        (
            (44.0, 3.0, 1.0),
            "overspeed: 44.0 m/s equivalent airspeed (limit 40.0 m/s)",
            "no longer overspeed after 2.0 s, 44.0 m/s at most",
        ),
        (
            (20.0, 15.0, 1.0),
            "stalled: 15.0° angle of attack (limit 13.0°)",
            "no longer stalled after 2.0 s, 15.0° at most",
        ),
    ],
)
def test_an_excess_is_reported_after_its_hold_time(history, begins, ends):
    monitor = make()
    events = simulate(monitor, [CALM] * 25 + [history] * 50 + [CALM] * 25)
    assert lines(events) == [
        (1.52, "error", "uav1", begins),  # 1 s, and the first look at least 0.5 s later
        (3.0, "info", "uav1", ends),
    ]
    assert (monitor.outcome, monitor.terminate) == ("envelope_exceeded", False)


def test_short_excesses_are_not_reported():
    gusts = ([CALM] * 5 + [(44.0, 15.0, 1.0)] * 12) * 30
    assert simulate(make(), gusts) == []


def test_formation_is_lost_after_five_seconds():
    monitor = make()
    events = simulate(
        monitor,
        [CALM] * 25 + [(20.0, 3.0, 120.0)] * 200 + [CALM] * 5,
    )
    assert lines(events) == [
        (6.0, "error", "uav1", "lost its formation: 120 m from its slot (limit 101 m)"),
        (9.0, "info", "uav1", "back in its formation after 8.0 s, 120 m from its slot at most"),
    ]
    assert monitor.outcome == "formation_lost"


def test_distance_is_relative_to_the_closest():
    monitor = make()
    assert simulate(monitor, [(20.0, 3.0, 250.0)] + [(20.0, 3.0, 349.0)] * 400) == []
    (event,) = simulate(monitor, [(20.0, 3.0, 351.0)] * 400, first=401)
    assert "lost its formation: 351 m from its slot (limit 350 m)" in event.text
    monitor = make()
    simulate(monitor, [(20.0, 3.0, 250.0), (20.0, 3.0, 0.0)])
    (event,) = simulate(monitor, [(20.0, 3.0, 101.0)] * 400, first=2)
    assert "lost its formation: 101 m from its slot (limit 100 m)" in event.text


def test_closest_distance_restarts_on_return():
    monitor, apart = make(), (ALL_FLYING[0], (True, False))
    assert simulate(monitor, [CALM] * 25 + [(20.0, 3.0, 90.0)] * 25) == []
    assert simulate(monitor, [(20.0, 3.0, 700.0)] * 400, away=apart, first=50) == []
    assert simulate(monitor, [(20.0, 3.0, 790.0)] * 400, first=450) == []
    (event,) = simulate(monitor, [CALM] + [(20.0, 3.0, 790.0)] * 400, first=850)
    assert "lost its formation: 790 m from its slot (limit 101 m)" in event.text


def test_without_a_leader_no_slot_is_watched():
    missing = ((True, False, False), ALL_FLYING[1])
    assert simulate(make(), [CALM] + [(20.0, 3.0, 700.0)] * 400, away=missing) == []


def test_flight_at_a_limit_is_one_excess():
    jitter = named_stream(1, "test/envelope").uniform(RECOVERED * OVERSPEED, 1.05 * OVERSPEED, 1000)
    events = simulate(make(), [(45.0, 3.0, 1.0)] * 20 + [(each, 3.0, 1.0) for each in jitter])
    assert [event.level for event in events] == ["error"]
    assert (jitter < OVERSPEED).sum() > 100


@pytest.mark.parametrize("away", [0, 1])
def test_an_excess_that_ends_by_a_loss_has_no_event(away):
    far = [(20.0, 3.0, 150.0)] * 200
    monitor = make()
    assert len(simulate(monitor, [CALM, *far])) == 1
    lost, left = (False, True, False), (True, False)
    missing = (lost, ALL_FLYING[1]) if away else (ALL_FLYING[0], left)
    assert simulate(monitor, far, away=missing, first=200) == []
    assert simulate(monitor, [CALM] * 50, away=missing, first=400) == []


def test_stall_is_reported_out_of_formation():
    away = (ALL_FLYING[0], (True, False))
    (event,) = simulate(make(), [(20.0, 15.0, 500.0)] * 200, away=away)
    assert event.text.startswith("stalled")


def faulty(row):
    mask = np.zeros(3, dtype=bool)
    mask[row] = True
    return SimpleNamespace(active=mask)


@pytest.mark.parametrize(
    ("history", "row", "level"),
    [
        ((20.0, 15.0, 1.0), 1, "warning"),
        ((20.0, 15.0, 1.0), 2, "error"),  # the fault is another aircraft's
        ((44.0, 3.0, 1.0), 1, "warning"),
        ((44.0, 3.0, 1.0), 0, "error"),
        ((20.0, 3.0, 150.0), 1, "warning"),
        ((20.0, 3.0, 150.0), 0, "warning"),  # any fault may be the cause of a lost formation
    ],
)
def test_an_excess_with_a_fault_is_a_warning(history, row, level):
    monitor = make(faulty(row), stops=True)
    (event,) = simulate(monitor, [CALM] + [history] * 200)
    assert event.level == level
    assert monitor.terminate == (monitor.outcome != "completed") == (level == "error")


def test_two_excesses_at_once_are_two_events():
    events = simulate(make(), [(44.0, 15.0, 1.0)] * 20)
    assert [event.text.split(":")[0] for event in events] == ["overspeed", "stalled"]


def test_find_exceeded_matches_reference():
    rng = named_stream(2, "test/exceeded")
    seen = 0
    for _ in range(500):
        airspeed, alpha = rng.uniform(10.0, 41.0, 5), rng.uniform(-0.2, 0.25, 5)
        error, left = rng.uniform(-62.0, 62.0, (4, 3)), rng.random(4) < 0.1
        limits = np.tile([[OVERSPEED], [STALL], [FORMATION]], (1, 5))
        limits[:, 2] = np.inf
        airspeed[2], alpha[2] = rng.choice([np.nan, 1e6]), np.nan
        error[rng.integers(4)] = rng.choice([1.0, np.nan, np.inf])
        closest = np.array([0.0, *rng.choice([0.0, 10.0, np.inf], 4)])
        distance = np.array([0.0, *np.sqrt((error * error).sum(axis=1))])
        expected = np.stack([airspeed, alpha, distance])
        near = np.fmin(np.where([False, *left], np.inf, closest), distance)
        allowed = limits + np.stack([np.zeros(5), np.zeros(5), near])
        aircraft, followers, excesses = (
            allocate(dtype, *shape)
            for dtype, *shape in ((AIRCRAFT, 5), (FOLLOWER, 4), (EXCESS, 3, 5))
        )
        excesses["since_s"] = np.nan
        aircraft["truth"]["equivalent_airspeed"], aircraft["air"]["alpha"] = airspeed, alpha
        followers["error_ned"] = error
        state, seen_now = (limits, closest, excesses), (aircraft, followers, left)
        beyond = expected > allowed
        beyond[2, 1:] &= ~left
        assert not find_exceeded(*state, *seen_now, 1.0), "no excess has lasted"
        np.testing.assert_allclose(closest, near, rtol=1e-15)
        np.testing.assert_allclose(excesses["value"], expected, rtol=1e-15)
        assert np.array_equal(excesses["since_s"] == 1.0, beyond)
        found = find_exceeded(*state, *seen_now, 6.0)
        assert found == beyond.any()
        assert np.array_equal(excesses["began"], beyond)
        assert not find_exceeded(*state, *seen_now, 7.0), "each begins once"
        aircraft["truth"]["equivalent_airspeed"] = aircraft["air"]["alpha"] = 0.0
        followers["error_ned"] = 0.0
        assert find_exceeded(*state, *seen_now, 8.0) == found, "each ends"
        seen += found
    assert 100 < seen < 400


def test_excess_within_a_period_of_another_starts_anew():
    """The second excess, 0.4 s long, comes one sample after the end of the first."""
    high = (44.0, 3.0, 1.0)
    events = simulate(make(), [high] * 20 + [CALM] + [high] * 10 + [CALM] * 5)
    assert [event.level for event in events] == ["error", "info"]
