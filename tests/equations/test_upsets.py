"""Who is upset: worked histories, and the compiled look against the numpy one."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from testbed.sim.upsets import BACK, READY_BEYOND, Upsets, beyond, measured
from testbed.sim.upsets_twin import beyond as compiled
from testbed.streams import stream

DT = 0.04
NAMES = ("leader", "uav1", "uav2")
NOBODY = (np.zeros(3, dtype=bool), np.zeros(2, dtype=bool))
OVERSPEED, STALL, FORMATION = 40.0, math.radians(13.0), 100.0


def watch(breakdowns=None, *, stops=False):
    limits = np.tile([[OVERSPEED], [STALL], [FORMATION]], (1, 3))
    return Upsets(NAMES, limits, breakdowns, stops=stops)


def flown(upsets, histories, *, away=NOBODY, first=0):
    """The events of histories by step: uav1's airspeed, angle of attack in deg, and distance."""
    events = []
    for k, (airspeed, alpha, distance) in enumerate(histories, start=first):
        truth = SimpleNamespace(equivalent_airspeed=np.array([20.0, airspeed, 20.0]))
        air = SimpleNamespace(alpha=np.radians([3.0, alpha, 3.0]))
        error = np.array([[0.6 * distance, 0.0, 0.8 * distance], [1.0, 0.0, 0.0]])
        news = upsets.changes(k * DT, Record(truth), Record(air), Slots(error), away)
        events += news
    return events


class Record(tuple):
    """A record made anew at each step, as ideal vehicles make theirs."""

    def __new__(cls, *fields):
        if len(fields) == 1 and isinstance(fields[0], SimpleNamespace):
            fields = tuple(vars(fields[0]).values())
        return super().__new__(cls, fields)

    equivalent_airspeed = alpha = property(lambda self: self[0])


class Slots(Record):
    error_ned = property(lambda self: self[0])


def told(events):
    return [(round(e.time_s, 6), e.level, e.source, e.text) for e in events]


CALM = (20.0, 3.0, 1.0)


def test_who_stays_within_the_limits_is_not_mentioned():
    near = (OVERSPEED, math.degrees(STALL), FORMATION)
    upsets = watch()
    assert flown(upsets, [(*near[:2], 0.0)] + [near] * 400) == []
    assert (upsets.unforeseen, upsets.over) == (False, False)


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
def test_an_upset_is_told_once_it_has_lasted_and_when_it_is_over(history, begins, ends):
    upsets = watch()
    events = flown(upsets, [CALM] * 25 + [history] * 50 + [CALM] * 25)
    assert told(events) == [
        (1.52, "error", "uav1", begins),  # 1 s, and the first look at least 0.5 s later
        (3.0, "info", "uav1", ends),
    ]
    assert (upsets.unforeseen, upsets.over) == (True, False)


def test_a_gust_is_no_upset():
    gusts = ([CALM] * 5 + [(44.0, 15.0, 1.0)] * 12) * 30
    assert flown(watch(), gusts) == []


def test_a_formation_is_lost_after_five_seconds():
    upsets = watch()
    events = flown(
        upsets,
        [CALM] * 25 + [(20.0, 3.0, 120.0)] * 200 + [CALM] * 5,
    )
    assert told(events) == [
        (6.0, "error", "uav1", "lost its formation: 120 m from its slot (limit 101 m)"),
        (9.0, "info", "uav1", "back from 120 m off its slot at most, after 8.0 s"),
    ]


def test_a_follower_is_held_to_how_close_it_has_been():
    upsets = watch()
    assert flown(upsets, [(20.0, 3.0, 250.0)] + [(20.0, 3.0, 349.0)] * 400) == []
    (event,) = flown(upsets, [(20.0, 3.0, 351.0)] * 400, first=401)
    assert "lost its formation: 351 m from its slot (limit 350 m)" in event.text
    upsets = watch()
    flown(upsets, [(20.0, 3.0, 250.0), (20.0, 3.0, 0.0)])
    (event,) = flown(upsets, [(20.0, 3.0, 101.0)] * 400, first=2)
    assert "lost its formation: 101 m from its slot (limit 100 m)" in event.text


def test_who_comes_back_from_something_else_counts_anew():
    upsets, apart = watch(), (NOBODY[0], np.array([True, False]))
    assert flown(upsets, [CALM] * 25 + [(20.0, 3.0, 90.0)] * 25) == []
    assert flown(upsets, [(20.0, 3.0, 700.0)] * 400, away=apart, first=50) == []
    assert flown(upsets, [(20.0, 3.0, 790.0)] * 400, first=450) == []
    (event,) = flown(upsets, [CALM] + [(20.0, 3.0, 790.0)] * 400, first=850)
    assert "lost its formation: 790 m from its slot (limit 101 m)" in event.text


def test_without_a_leader_nobody_has_a_place():
    gone = (np.array([True, False, False]), NOBODY[1])
    assert flown(watch(), [CALM] + [(20.0, 3.0, 700.0)] * 400, away=gone) == []


def test_who_flies_at_a_limit_does_not_chatter():
    jitter = stream(1, "test/upset").uniform(BACK * OVERSPEED, 1.05 * OVERSPEED, 1000)
    events = flown(watch(), [(45.0, 3.0, 1.0)] * 20 + [(each, 3.0, 1.0) for each in jitter])
    assert [event.level for event in events] == ["error"]
    assert (jitter < OVERSPEED).sum() > 100


@pytest.mark.parametrize("away", [0, 1])
def test_what_ends_because_somebody_is_away_ends_without_a_word(away):
    far = [(20.0, 3.0, 150.0)] * 200
    upsets = watch()
    assert len(flown(upsets, [CALM, *far])) == 1
    lost, apart = np.array([False, True, False]), np.array([True, False])
    gone = (lost, NOBODY[1]) if away else (NOBODY[0], apart)
    assert flown(upsets, far, away=gone, first=200) == []
    assert flown(upsets, [CALM] * 50, away=gone, first=400) == []


def test_who_has_left_its_slot_can_still_stall():
    away = (NOBODY[0], np.array([True, False]))
    (event,) = flown(watch(), [(20.0, 15.0, 500.0)] * 200, away=away)
    assert event.text.startswith("stalled")


def broken(row):
    mask = np.zeros(3, dtype=bool)
    mask[row] = True
    return SimpleNamespace(broken=mask)


@pytest.mark.parametrize(
    ("history", "row", "level"),
    [
        ((20.0, 15.0, 1.0), 1, "warning"),
        ((20.0, 15.0, 1.0), 2, "error"),  # it is the other that is broken
        ((44.0, 3.0, 1.0), 1, "warning"),
        ((44.0, 3.0, 1.0), 0, "error"),
        ((20.0, 3.0, 150.0), 1, "warning"),
        ((20.0, 3.0, 150.0), 0, "warning"),  # a formation may be lost by anybody's fault
    ],
)
def test_what_a_fault_of_the_page_explains_is_a_warning(history, row, level):
    upsets = watch(broken(row), stops=True)
    (event,) = flown(upsets, [CALM] + [history] * 200)
    assert event.level == level
    assert upsets.unforeseen == upsets.over == (level == "error")


def test_two_upsets_at_once_are_two():
    events = flown(watch(), [(44.0, 15.0, 1.0)] * 20)
    assert [event.text.split(":")[0] for event in events] == ["overspeed", "stalled"]


def test_the_compiled_look_sees_what_numpy_sees():
    rng = stream(2, "test/beyond")
    seen = 0
    for _ in range(500):
        airspeed, alpha = rng.uniform(10.0, 41.0, 5), rng.uniform(-0.2, 0.25, 5)
        error = rng.uniform(-62.0, 62.0, (4, 3))
        limits = np.tile([[OVERSPEED], [STALL], [FORMATION]], (1, 5))
        limits[:, 2] = np.inf
        airspeed[2], alpha[2] = rng.choice([np.nan, 1e6]), np.nan
        error[rng.integers(4)] = rng.choice([1.0, np.nan, np.inf])
        closest = np.array([0.0, *rng.choice([0.0, 10.0, np.inf], 4)])
        args = airspeed, alpha, error, limits
        rooms = closest.copy(), closest.copy(), closest.copy()
        distance = measured(*args[:3])[2]
        near = np.where(distance < closest, distance, closest)
        allowed = limits + np.stack([np.zeros(5), np.zeros(5), near])
        expected = bool((measured(*args[:3]) > allowed).any())
        looks = beyond(*args, rooms[0]), compiled(*args, rooms[1]), READY_BEYOND(*args, rooms[2])()
        assert looks == (expected,) * 3
        for room in rooms:
            np.testing.assert_allclose(room, near, rtol=1e-15)
        seen += expected
    assert 100 < seen < 400
