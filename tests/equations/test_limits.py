"""Who comes close to whom, and who collides: worked passes, and every pair by hand."""

import itertools
import math

import numpy as np
import pytest

from testbed.sim.limits import Proximity
from testbed.streams import stream

DT = 0.04
NOBODY = np.zeros(2, dtype=bool)


def flown(watch, places, gone=None):
    """All events over places (K, N, 3) every DT, and who has collided at the end."""
    gone = np.zeros(places.shape[1], dtype=bool) if gone is None else gone
    events, collided = [], None
    for k, each in enumerate(places):
        news, collided = watch.changes(k * DT, each, gone)
        events += news
    return events, collided


def told(events):
    return [(event.level, event.source, event.text) for event in events]


def passing(miss, steps=101):
    """uav1 stands still, uav2 passes it at 10 m/s and `miss` metres, closest at 2 s."""
    places = np.zeros((steps, 2, 3))
    places[:, 1, 0] = 10.0 * (np.arange(steps) * DT - 2.0)
    places[:, 1, 2] = -miss
    return places


def test_a_pass_is_told_at_its_beginning_and_its_end():
    watch = Proximity(["uav1", "uav2"], separation_m=5.0)
    events, collided = flown(watch, passing(3.2))
    assert told(events) == [
        # 5² = 3.2² + 3.84², 0.384 s before the closest; the next look is 0.36 s before it, and
        # 3.2² + 3.6² = 4.82²
        ("warning", "uav1", "within 5 m of uav2: 4.8 m"),
        ("info", "uav1", "apart from uav2 again: 3.2 m at the closest"),
    ]
    assert events[0].time_s == pytest.approx(2.0 - 0.36, abs=1e-9)
    # 10 % more: 5.5² = 3.2² + 4.47², and the next look is 0.48 s after the closest
    assert events[1].time_s == pytest.approx(2.0 + 0.48, abs=1e-9)
    assert not collided.any()


def test_the_closest_of_a_second_pass_is_its_own():
    watch = Proximity(["uav1", "uav2"], separation_m=5.0)
    events, _ = flown(watch, np.concatenate([passing(2.0), passing(4.0)]))
    assert [event.text for event in events if event.level == "info"] == [
        "apart from uav2 again: 2.0 m at the closest",
        "apart from uav2 again: 4.0 m at the closest",
    ]


def test_who_passes_beyond_the_limits_is_not_mentioned():
    watch = Proximity(["uav1", "uav2"], collision_m=1.0, separation_m=5.0)
    assert flown(watch, passing(5.0 + 1e-9))[0] == []


def test_what_nobody_looks_at_is_not_told():
    assert flown(Proximity(["uav1", "uav2"]), passing(0.0))[0] == []
    events, collided = flown(Proximity(["uav1", "uav2"], separation_m=5.0), passing(0.0))
    assert [event.level for event in events] == ["warning", "info"]
    assert not collided.any()
    events, collided = flown(Proximity(["uav1", "uav2"], collision_m=5.0), passing(4.0))
    assert [event.level for event in events] == ["error"]
    assert collided.all()


def test_one_aircraft_alone_is_near_nobody():
    watch = Proximity(["leader"], collision_m=1.0, separation_m=5.0)
    news, collided = watch.changes(0.0, np.zeros((1, 3)), np.zeros(1, dtype=bool))
    assert news == ()
    assert collided.tolist() == [False]


def test_two_collide_once_and_for_good():
    watch = Proximity(["uav1", "uav2"], collision_m=2.0, separation_m=5.0)
    events, collided = flown(watch, np.concatenate([passing(1.5), passing(1.5)]))
    assert told(events) == [
        ("warning", "uav1", "within 5 m of uav2: 4.6 m"),
        # 1.5² + 1.2² = 1.92², seen 0.12 s before the closest; at 0.16 s it was 2.19 m
        ("error", "uav1", "collided with uav2: 1.9 m between centres"),
    ]
    assert events[1].time_s == pytest.approx(1.88, abs=1e-9)
    assert collided.all()


def test_who_starts_inside_another_has_collided_and_not_come_near():
    watch = Proximity(["uav1", "uav2"], collision_m=2.0, separation_m=5.0)
    events, collided = watch.changes(0.0, np.zeros((2, 3)), NOBODY)
    assert told(events) == [("error", "uav1", "collided with uav2: 0.0 m between centres")]
    assert collided.all()


def test_what_was_given_out_stays_as_it_was():
    watch = Proximity(["uav1", "uav2"], collision_m=2.0)
    places = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    before = watch.changes(0.0, places, NOBODY)[1]
    after = watch.changes(DT, places * 0.1, NOBODY)[1]
    assert (before.tolist(), after.tolist()) == ([False, False], [True, True])


def test_a_pair_at_the_limit_does_not_chatter():
    watch = Proximity(["uav1", "uav2"], separation_m=5.0)
    jitter = stream(1, "test/chatter").uniform(-0.45, 0.45, 500)
    places = np.zeros((500, 2, 3))
    places[:, 1, 1] = 5.0 + jitter  # stays within 10 %
    events, _ = flown(watch, places)
    assert [event.level for event in events] == ["warning"]
    assert (np.diff(np.sign(jitter)) != 0).sum() > 100  # it did cross the limit


def test_the_lost_are_no_longer_in_the_way():
    watch = Proximity(["uav1", "uav2", "uav3"], collision_m=1.0, separation_m=5.0)
    gone = np.array([False, True, False])
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [4.0, 0.0, 0.0]])
    events, collided = watch.changes(0.0, places, gone)
    assert told(events) == [("warning", "uav1", "within 5 m of uav3: 4.0 m")]
    assert not collided.any()


@pytest.mark.parametrize("place", [0.0, np.nan, np.inf, 1e200])
def test_an_encounter_with_one_that_is_lost_ends_without_a_word(place):
    watch = Proximity(["uav1", "uav2", "uav3"], separation_m=5.0)
    places = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    assert len(watch.changes(0.0, places, np.zeros(3, dtype=bool))[0]) == 1
    places[1:] = place  # two of them, so that inf − inf comes up
    assert watch.changes(DT, places, np.array([False, True, True]))[0] == ()
    # nor is it remembered
    far = np.array([[0.0, 0.0, 0.0], [90.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    assert watch.changes(2 * DT, far, np.zeros(3, dtype=bool))[0] == ()


def test_who_has_collided_is_in_nobodys_way_though_nobody_says_it_is_lost():
    watch = Proximity(["uav1", "uav2", "uav3"], collision_m=1.0, separation_m=5.0)
    alive = np.zeros(3, dtype=bool)
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [4.0, 0.0, 0.0]])
    events, collided = watch.changes(0.0, places, alive)
    assert told(events) == [
        ("error", "uav1", "collided with uav2: 0.5 m between centres"),
        ("warning", "uav1", "within 5 m of uav3: 4.0 m"),
        ("warning", "uav2", "within 5 m of uav3: 3.5 m"),
    ]
    assert collided.tolist() == [True, True, False]
    places[2] = 0.0  # through both of them
    news, collided = watch.changes(DT, places, alive)
    assert news == ()
    assert collided.tolist() == [True, True, False]


def test_three_in_one_place_have_all_collided_pair_by_pair():
    watch = Proximity(["uav1", "uav2", "uav3"], collision_m=1.0)
    events, collided = watch.changes(0.0, np.zeros((3, 3)), np.zeros(3, dtype=bool))
    assert [(event.source, event.text[:18]) for event in events] == [
        ("uav1", "collided with uav2"),
        ("uav1", "collided with uav3"),
        ("uav2", "collided with uav3"),
    ]
    assert collided.all()


def row(count, spacing):
    places = np.zeros((count, 3))
    places[:, 1] = spacing * np.arange(count)
    return places


def test_up_to_five_pairs_at_one_time_have_a_line_each_and_more_have_one_together():
    names = [f"uav{i}" for i in range(1, 8)]
    for count, lines in ((6, 5), (7, 1)):  # in a row, so that there is a pair less
        watch = Proximity(names[:count], separation_m=5.0)
        alive = np.zeros(count, dtype=bool)
        assert len(watch.changes(0.0, row(count, 4.0), alive)[0]) == lines
        assert watch.changes(DT, row(count, 4.5), alive)[0] == ()
        assert len(watch.changes(2 * DT, row(count, 6.0), alive)[0]) == lines


def test_what_is_summed_up_says_how_many_and_who_is_closest():
    watch = Proximity([f"uav{i}" for i in range(1, 8)], separation_m=5.0)
    alive, tight = np.zeros(7, dtype=bool), row(7, 4.0)
    tight[3:] -= [0.0, 0.5, 0.0]  # uav4 and all behind it
    (event,) = watch.changes(0.0, tight, alive)[0]
    assert told([event]) == [
        ("warning", "run", "6 pairs within 5 m of each other: uav3 and uav4 the closest, 3.5 m")
    ]
    (event,) = watch.changes(DT, row(7, 9.0), alive)[0]
    assert told([event]) == [
        ("info", "run", "6 pairs are apart again: uav3 and uav4 the closest, 3.5 m")
    ]


def one_by_one(names, places, *, collision, separation):
    """The same by plain loops, for aircraft of which none is lost but by collision."""
    events, near, hit = [], {}, set()
    for k, each in enumerate(places):
        before = set(hit)
        for i, j in itertools.combinations(range(len(names)), 2):
            if i in before or j in before:
                near.pop((i, j), None)
                continue
            distance = math.dist(each[i], each[j])
            if distance < collision:
                events.append((k, "error", names[i], names[j], distance))
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
def test_swarms_are_told_as_pair_by_pair(seed):
    count, steps = 9, 400
    names = [f"uav{i}" for i in range(1, count + 1)]
    rng = stream(seed, "test/swarm")
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, count, 3))
    turns = rng.uniform(0.2, 1.5, (2, count, 3))
    time = DT * np.arange(steps)[:, np.newaxis, np.newaxis]
    places = 5.0 * (np.sin(turns[0] * time + phase[0]) + np.sin(turns[1] * time + phase[1]))
    events, collided = flown(Proximity(names, collision_m=1.2, separation_m=5.0), places)
    wanted, hit = one_by_one(names, places, collision=1.2, separation=5.0)
    assert not any(event.source == "run" for event in events)  # never more than five at one time

    def line(k, level, one, other, distance):
        text = {
            "error": f"collided with {other}: {distance:.1f} m between centres",
            "warning": f"within 5 m of {other}: {distance:.1f} m",
            "info": f"apart from {other} again: {distance:.1f} m at the closest",
        }[level]
        return k * DT, level, one, text

    ours = [(event.time_s, event.level, event.source, event.text) for event in events]
    assert sorted(ours) == sorted(line(*each) for each in wanted)
    assert set(np.flatnonzero(collided)) == hit
    assert {level for _, level, *_ in wanted} == {"warning", "info", "error"}
