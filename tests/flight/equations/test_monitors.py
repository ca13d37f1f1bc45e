"""Events of followers that join the formation, and of gusts that reach aircraft."""

import numpy as np

from testbed.core.records import AIRCRAFT, FOLLOWER, allocate
from testbed.flight.monitors import JOIN, GustMonitor, JoinMonitor, find_joined

RATE_HZ = 200


def test_gust_events_name_the_aircraft_once():
    monitor = GustMonitor(["front", "puff"], ["leader", "uav1"])

    def events(now, *active):
        found = monitor.changes(now, np.array(active, bool))
        return [(event.source, event.text) for event in found]

    assert events(1.0, [False, False], [False, False]) == []
    assert events(2.0, [False, True], [True, True]) == [
        ("uav1", "gust front reaches it"),
        ("run", "gust puff reaches all aircraft"),
    ]
    assert events(3.0, [True, True], [False, False]) == [("leader", "gust front reaches it")]
    assert events(4.0, [True, True], [True, False]) == [("leader", "gust puff reaches it")]


def joins(monitor, now):
    """The events of a time, s, if there are any."""
    return list(monitor.changes(now)) if monitor.call(now) else []


def joined(*distances_m, lost=(False, False)):
    """Events of ticks 1 s apart in which two followers are so far from their slots (k, 2)."""
    aircraft, followers = allocate(AIRCRAFT, 3), allocate(FOLLOWER, 2)
    monitor = JoinMonitor(("uav1", "uav2"), RATE_HZ, aircraft, followers)
    aircraft["lost"][1:] = lost
    events = []
    for k, distances in enumerate(distances_m):
        followers["error_ned"][:, 1] = distances
        events += joins(monitor, k)
    return events


def test_a_follower_joins_after_five_seconds_in_slot():
    out, inside = 5.01, 5.0
    uav1 = [out, inside, inside, inside, inside, inside, inside, out, *[inside] * 9]
    uav2 = [inside, inside, inside, inside, inside, out, *[inside] * 11]
    events = joined(*zip(uav1, uav2, strict=True))
    assert [(event.time_s, event.source) for event in events] == [(6.0, "uav1"), (11.0, "uav2")]
    assert [event.text.split()[-2:] for event in events] == [["1.0", "s"], ["6.0", "s"]]
    assert not joined(*[(out, out)] * 10)


def test_a_lost_follower_does_not_join():
    events = joined(*[(1.0, 1.0)] * 10, lost=(True, False))
    assert [event.source for event in events] == ["uav2"]


def test_five_seconds_are_counted_in_ticks():
    """At 25 Hz one sample in a hundred is, as a number of seconds, not 5 s after another."""
    for first in range(0, 4000, 8):
        aircraft, followers = allocate(AIRCRAFT, 2), allocate(FOLLOWER, 1)
        monitor = JoinMonitor(["uav1"], RATE_HZ, aircraft, followers)
        assert not joins(monitor, first / RATE_HZ)
        assert joins(monitor, first / RATE_HZ + 5.0)


def test_find_joined_matches_reference():
    rng = np.random.default_rng(45)
    n, found = 4, []
    aircraft, followers, joins = allocate(AIRCRAFT, n + 1), allocate(FOLLOWER, n), allocate(JOIN, n)
    joins["since"] = since = np.full(n, -1)
    waiting = np.ones(n, dtype=bool)
    for tick in range(0, 40_000, 8):
        followers["error_ned"] = error = rng.normal(0.0, 1.8, (n, 3))
        if tick % 1000 == 0:
            joins["joined"], waiting = False, np.ones(n, dtype=bool)
        if tick == 20_000:
            aircraft["lost"][2] = True
        if tick == 36_000:
            aircraft["lost"][0] = True
        lost = aircraft["lost"]
        inside = (np.linalg.norm(error, axis=1) <= 5.0) & ~(lost[1:] | lost[0])
        since = np.where(inside, np.where(since < 0, tick, since), -1)
        new = waiting & inside & (tick - since >= 60)
        waiting &= ~new
        found.append(find_joined(aircraft, followers, 5.0, 60.0, 200.0, joins, tick / 200))
        assert found[-1] == new.any()
        assert np.array_equal(joins["since"], since)
        assert np.array_equal(joins["joined"], ~waiting)
    assert 50 < sum(found[:4500]) < 4400
    assert not any(found[4500:])
