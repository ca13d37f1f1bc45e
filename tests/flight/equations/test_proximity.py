"""Separation and collision events: passes worked by hand, and a loop over all pairs."""

import itertools
import math

import numpy as np
import pytest

from testbed.core.random import named_stream
from testbed.core.records import AIRCRAFT, allocate
from testbed.flight.limits import ProximityMonitor
from testbed.flight.steps import find_losses

DT = 0.04
NONE_LOST = np.zeros(2, dtype=bool)


def run(monitor, positions):
    """Return all events over positions (K, N, 3) every DT, and the collided at the end."""
    lost = np.zeros(positions.shape[1], dtype=bool)
    events, collided = [], None
    for k, each in enumerate(positions):
        new, collided = monitor.changes(k * DT, each, lost)
        events += new
    return events, collided


def lines(events):
    return [(event.level, event.source, event.text) for event in events]


def passing(miss, steps=101):
    """Return positions of uav1 at rest and uav2 that passes at 10 m/s, closest at 2 s."""
    positions = np.zeros((steps, 2, 3))
    positions[:, 1, 0] = 10.0 * (np.arange(steps) * DT - 2.0)
    positions[:, 1, 2] = -miss
    return positions


def test_pass_has_an_event_at_begin_and_end():
    monitor = ProximityMonitor(["uav1", "uav2"], separation_m=5.0)
    events, collided = run(monitor, passing(3.2))
    assert lines(events) == [
        # 5² = 3.2² + 3.84², 0.384 s before the closest; the next call is 0.36 s before it, and
        # 3.2² + 3.6² = 4.82²
        ("warning", "uav1", "within 5 m of uav2: 4.8 m"),
        ("info", "uav1", "separated from uav2 again, closest 3.2 m"),
    ]
    assert events[0].time_s == pytest.approx(2.0 - 0.36, abs=1e-9)
    # 10 % more: 5.5² = 3.2² + 4.47², and the next call is 0.48 s after the closest
    assert events[1].time_s == pytest.approx(2.0 + 0.48, abs=1e-9)
    assert not collided.any()


def test_closest_distance_of_each_pass():
    monitor = ProximityMonitor(["uav1", "uav2"], separation_m=5.0)
    events, _ = run(monitor, np.concatenate([passing(2.0), passing(4.0)]))
    assert [event.text for event in events if event.level == "info"] == [
        "separated from uav2 again, closest 2.0 m",
        "separated from uav2 again, closest 4.0 m",
    ]


def test_no_event_beyond_the_limits():
    monitor = ProximityMonitor(["uav1", "uav2"], collision_m=1.0, separation_m=5.0)
    assert run(monitor, passing(5.0 + 1e-9))[0] == []


def test_limits_are_independent():
    assert run(ProximityMonitor(["uav1", "uav2"]), passing(0.0))[0] == []
    events, collided = run(ProximityMonitor(["uav1", "uav2"], separation_m=5.0), passing(0.0))
    assert [event.level for event in events] == ["warning", "info"]
    assert not collided.any()
    events, collided = run(ProximityMonitor(["uav1", "uav2"], collision_m=5.0), passing(4.0))
    assert [event.level for event in events] == ["error"] * 2  # one for each
    assert collided.all()


def minimum(names, metres, **options):
    return ProximityMonitor(names, minimum_m=np.array(metres), **options)


def test_lost_separation_is_one_error_per_approach():
    monitor = minimum(["uav1", "uav2"], [2.1, 2.79])  # the larger wingspan counts
    events, collided = run(monitor, np.concatenate([passing(1.2), passing(2.5), passing(2.8)]))
    assert lines(events) == [
        # 2.79² = 1.2² + 2.52²; 0.24 s before the closest 1.2² + 2.4² = 2.68²
        ("error", "uav1", "loss of separation: 2.7 m from uav2 (limit 2.79 m, a wingspan)"),
        ("info", "uav1", "separated from uav2 again, closest 1.2 m"),
        ("error", "uav1", "loss of separation: 2.8 m from uav2 (limit 2.79 m, a wingspan)"),
        ("info", "uav1", "separated from uav2 again, closest 2.5 m"),
    ]
    assert not collided.any()
    assert (monitor.outcome, monitor.terminate, monitor.watching[0]) == (
        "separation_lost",
        False,
        False,
    )


def test_fault_explains_a_lost_separation():
    monitor = minimum(["uav1", "uav2"], [3.0, 3.0], stops=True)
    close = passing(1.0)[50]
    events, _ = monitor.changes(0.0, close, NONE_LOST, np.array([False, True]))
    assert [event.level for event in events] == ["warning"]
    assert (monitor.outcome, monitor.terminate) == ("completed", False)
    monitor.changes(1.0, passing(1.0)[0], NONE_LOST)
    events, _ = monitor.changes(2.0, close, NONE_LOST, np.array([False, False]))
    assert [event.level for event in events] == ["error"]
    assert monitor.terminate


def test_warning_before_a_lost_separation():
    monitor = minimum(["uav1", "uav2"], [3.0, 3.0], separation_m=5.0)
    events, _ = run(monitor, passing(1.0))
    assert [(event.level, event.text.partition(":")[0]) for event in events] == [
        ("warning", "within 5 m of uav2"),
        ("error", "loss of separation"),
        ("info", "separated from uav2 again, closest 1.0 m"),
    ]


def test_pairs_without_a_minimum():
    """A virtual leader has none, and zero switches the check off."""
    monitor = minimum(["leader", "uav1"], [np.nan, 3.0])
    assert run(monitor, passing(0.0))[0] == []
    assert run(minimum(["uav1", "uav2"], [0.0, 0.0]), passing(0.0))[0] == []


def test_many_lost_separations_have_one_event():
    monitor = minimum([f"uav{i}" for i in range(1, 8)], [5.0] * 7)
    (event,) = monitor.changes(0.0, row(7, 4.0), np.zeros(7, dtype=bool))[0]
    text = "loss of separation: 6 pairs, closest uav1 and uav2 at 4.0 m"
    assert lines([event]) == [("error", "run", text)]


@pytest.mark.parametrize("seed", range(5))
def test_compiled_check_finds_every_close_pair(seed):
    """It decides whether the monitor is called at all."""
    rng = named_stream(seed, "test/close")
    aircraft, watching = allocate(AIRCRAFT, 6), np.zeros(1, dtype=bool)
    found = []
    for _ in range(200):
        own = rng.choice([np.nan, 1.0, 3.0, 5.0], 6)
        limit = float(rng.choice([0.0, 2.0, 4.0]))
        positions = rng.uniform(-6.0, 6.0, (6, 3)) - [0.0, 0.0, 50.0]
        positions[rng.integers(6)] = rng.choice([0.0, np.nan])
        aircraft["truth"]["position_ned"] = positions
        lost = rng.random(6) < 0.3
        aircraft["lost"] = lost
        lowest = np.ones(len(aircraft))
        find_losses(aircraft, lowest, False, limit, own, watching)  # writes `down`
        expected = any(
            math.dist(positions[i], positions[j]) < max(limit, max(own[i], own[j]))
            if not np.isnan(own[[i, j]]).any()
            else math.dist(positions[i], positions[j]) < limit
            for i, j in itertools.combinations(np.flatnonzero(~lost), 2)
        )
        assert find_losses(aircraft, lowest, False, limit, own, watching) is expected
        found.append(expected)
        assert find_losses(aircraft, lowest, False, limit, own, ~watching), "an encounter may end"
    assert 20 < sum(found) < 180


def test_one_aircraft():
    monitor = ProximityMonitor(["leader"], collision_m=1.0, separation_m=5.0)
    events, collided = monitor.changes(0.0, np.zeros((1, 3)), np.zeros(1, dtype=bool))
    assert events == ()
    assert collided.tolist() == [False]


def test_collision_is_reported_once():
    monitor = ProximityMonitor(["uav1", "uav2"], collision_m=2.0, separation_m=5.0)
    events, collided = run(monitor, np.concatenate([passing(1.5), passing(1.5)]))
    assert lines(events) == [
        ("warning", "uav1", "within 5 m of uav2: 4.6 m"),
        # 1.5² + 1.2² = 1.92², seen 0.12 s before the closest; at 0.16 s it was 2.19 m
        ("error", "uav1", "collided with uav2: 1.9 m between centres"),
        ("error", "uav2", "collided with uav1: 1.9 m between centres"),
    ]
    assert events[1].time_s == pytest.approx(1.88, abs=1e-9)
    assert collided.all()


def test_collision_at_the_start():
    monitor = ProximityMonitor(["uav1", "uav2"], collision_m=2.0, separation_m=5.0)
    events, collided = monitor.changes(0.0, np.zeros((2, 3)), NONE_LOST)
    assert lines(events) == [
        ("error", "uav1", "collided with uav2: 0.0 m between centres"),
        ("error", "uav2", "collided with uav1: 0.0 m between centres"),
    ]
    assert collided.all()


def test_returned_array_does_not_change():
    monitor = ProximityMonitor(["uav1", "uav2"], collision_m=2.0)
    positions = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    before = monitor.changes(0.0, positions, NONE_LOST)[1]
    after = monitor.changes(DT, positions * 0.1, NONE_LOST)[1]
    assert (before.tolist(), after.tolist()) == ([False, False], [True, True])


def test_one_event_for_a_pair_at_the_limit():
    monitor = ProximityMonitor(["uav1", "uav2"], separation_m=5.0)
    jitter = named_stream(1, "test/chatter").uniform(-0.45, 0.45, 500)
    positions = np.zeros((500, 2, 3))
    positions[:, 1, 1] = 5.0 + jitter  # stays within 10 %
    events, _ = run(monitor, positions)
    assert [event.level for event in events] == ["warning"]
    assert (np.diff(np.sign(jitter)) != 0).sum() > 100  # it did cross the limit


def test_lost_aircraft_are_ignored():
    monitor = ProximityMonitor(["uav1", "uav2", "uav3"], collision_m=1.0, separation_m=5.0)
    lost = np.array([False, True, False])
    positions = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [4.0, 0.0, 0.0]])
    events, collided = monitor.changes(0.0, positions, lost)
    assert lines(events) == [("warning", "uav1", "within 5 m of uav3: 4.0 m")]
    assert not collided.any()


@pytest.mark.parametrize("place", [0.0, np.nan, np.inf, 1e200])
def test_lost_aircraft_end_an_encounter_without_event(place):
    monitor = ProximityMonitor(["uav1", "uav2", "uav3"], separation_m=5.0)
    positions = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    assert len(monitor.changes(0.0, positions, np.zeros(3, dtype=bool))[0]) == 1
    positions[1:] = place  # two of them, so that inf − inf comes up
    assert monitor.changes(DT, positions, np.array([False, True, True]))[0] == ()
    # the encounter is over
    far = np.array([[0.0, 0.0, 0.0], [90.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    assert monitor.changes(2 * DT, far, np.zeros(3, dtype=bool))[0] == ()


def test_collided_aircraft_are_ignored():
    monitor = ProximityMonitor(["uav1", "uav2", "uav3"], collision_m=1.0, separation_m=5.0)
    alive = np.zeros(3, dtype=bool)
    positions = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [4.0, 0.0, 0.0]])
    events, collided = monitor.changes(0.0, positions, alive)
    assert lines(events) == [
        ("error", "uav1", "collided with uav2: 0.5 m between centres"),
        ("error", "uav2", "collided with uav1: 0.5 m between centres"),
        ("warning", "uav1", "within 5 m of uav3: 4.0 m"),
        ("warning", "uav2", "within 5 m of uav3: 3.5 m"),
    ]
    assert collided.tolist() == [True, True, False]
    positions[2] = 0.0  # through both of them
    events, collided = monitor.changes(DT, positions, alive)
    assert events == ()
    assert collided.tolist() == [True, True, False]


def test_three_aircraft_collide_at_once():
    monitor = ProximityMonitor(["uav1", "uav2", "uav3"], collision_m=1.0)
    events, collided = monitor.changes(0.0, np.zeros((3, 3)), np.zeros(3, dtype=bool))
    assert [(event.source, event.text[:18]) for event in events] == [
        ("uav1", "collided with uav2"),
        ("uav2", "collided with uav1"),
        ("uav1", "collided with uav3"),
        ("uav3", "collided with uav1"),
        ("uav2", "collided with uav3"),
        ("uav3", "collided with uav2"),
    ]
    assert collided.all()


def row(count, spacing):
    positions = np.zeros((count, 3))
    positions[:, 1] = spacing * np.arange(count)
    return positions


def test_more_than_five_pairs_have_one_event():
    names = [f"uav{i}" for i in range(1, 8)]
    for count, expected in ((6, 5), (7, 1)):  # in a row: one pair fewer than aircraft
        monitor = ProximityMonitor(names[:count], separation_m=5.0)
        alive = np.zeros(count, dtype=bool)
        assert len(monitor.changes(0.0, row(count, 4.0), alive)[0]) == expected
        assert monitor.changes(DT, row(count, 4.5), alive)[0] == ()
        assert len(monitor.changes(2 * DT, row(count, 6.0), alive)[0]) == expected


def test_summary_gives_the_number_and_the_closest():
    monitor = ProximityMonitor([f"uav{i}" for i in range(1, 8)], separation_m=5.0)
    alive, tight = np.zeros(7, dtype=bool), row(7, 4.0)
    tight[3:] -= [0.0, 0.5, 0.0]  # uav4 and all that follow
    (event,) = monitor.changes(0.0, tight, alive)[0]
    assert lines([event]) == [
        ("warning", "run", "6 pairs within 5 m of each other, closest uav3 and uav4 at 3.5 m")
    ]
    (event,) = monitor.changes(DT, row(7, 9.0), alive)[0]
    assert lines([event]) == [
        ("info", "run", "6 pairs separated again, closest uav3 and uav4 at 3.5 m")
    ]


def one_by_one(names, positions, *, collision, separation):
    """Compute the same by plain loops, for aircraft that are lost only by collision."""
    events, near, hit = [], {}, set()
    for k, each in enumerate(positions):
        before = set(hit)
        for i, j in itertools.combinations(range(len(names)), 2):
            if i in before or j in before:
                near.pop((i, j), None)
                continue
            distance = math.dist(each[i], each[j])
            if distance < collision:
                events.append((k, "error", names[i], names[j], distance))
                events.append((k, "error", names[j], names[i], distance))
                near.pop((i, j), None)
                hit |= {i, j}
            elif (i, j) in near and distance >= 1.1 * separation:
                events.append((k, "info", names[i], names[j], near.pop((i, j))))
            elif (i, j) in near:
                near[i, j] = min(near[i, j], distance)
            elif distance < separation:
                events.append((k, "warning", names[i], names[j], distance))
                near[i, j] = distance
    return events, hit


@pytest.mark.parametrize("seed", range(5))
def test_events_equal_those_of_a_loop_over_pairs(seed):
    count, steps = 9, 400
    names = [f"uav{i}" for i in range(1, count + 1)]
    rng = named_stream(seed, "test/swarm")
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, count, 3))
    turns = rng.uniform(0.2, 1.5, (2, count, 3))
    time = DT * np.arange(steps)[:, np.newaxis, np.newaxis]
    positions = 5.0 * (np.sin(turns[0] * time + phase[0]) + np.sin(turns[1] * time + phase[1]))
    events, collided = run(ProximityMonitor(names, collision_m=1.2, separation_m=5.0), positions)
    expected, hit = one_by_one(names, positions, collision=1.2, separation=5.0)
    assert not any(event.source == "run" for event in events)  # never more than five at one time

    def line(k, level, one, other, distance):
        text = {
            "error": f"collided with {other}: {distance:.1f} m between centres",
            "warning": f"within 5 m of {other}: {distance:.1f} m",
            "info": f"separated from {other} again, closest {distance:.1f} m",
        }[level]
        return k * DT, level, one, text

    ours = [(event.time_s, event.level, event.source, event.text) for event in events]
    assert sorted(ours) == sorted(line(*each) for each in expected)
    assert set(np.flatnonzero(collided)) == hit
    assert {level for _, level, *_ in expected} == {"warning", "info", "error"}
