"""The followers' control: who steps when and writes where, and what a user's law may say."""

from dataclasses import fields, replace

import numpy as np
import pytest
from formation_cases import (
    DT,
    choose,
    leaves,
    make_law,
    make_middle,
    mixed_options,
    some_of,
    states,
)

from testbed.errors import InputError
from testbed.formation.flags import Saturation
from testbed.formation.law import Team
from testbed.sim.control import Control, Group, checked, direct
from testbed.state import FbwaCommand, UnicycleCommand

NAMES = ("uav1", "uav2", "uav3", "uav4", "uav5")


def team(names=NAMES, **changes):
    n = len(names)
    values = {
        "names": names,
        "agents": np.arange(1, n + 1, dtype=np.intp),
        "offsets": np.zeros((n + 1, 3)),
        "gains": np.zeros((n, n + 1, 3)),
        "pitch_limit": np.full(n, 0.3),
        "roll_limit": np.full(n, 0.8),
        "dt": DT,
        "silent_after": 5.0,
        "stale_after": 5.0,
    }
    taken = [field.name for field in fields(Team)]
    rest = {name: np.ones(n) for name in taken if name not in values and name != "paper"}
    return Team(**{**rest, **values, **changes})


def groups(law, middle, *rows, **limits):
    return tuple(
        Group(
            rows=np.array(each, dtype=np.intp),
            team=team(tuple(NAMES[i] for i in each), gains=law.gains[each], **limits),
            law=some_of(law, each),
            middle=choose(middle, each),
            ideal=np.zeros(len(each), dtype=bool),
            trusted=True,
        )
        for each in map(list, rows)
    )


def parts(control):
    """Everything a control knows, by name; every array (n, …)."""
    for name in ("command", "unicycle", "diagnosis"):
        yield from ((f"{name}.{inner}", each) for inner, each in leaves(getattr(control, name)))
    yield "age_s", control.age_s


def case(seed=90, n=5):
    rng = np.random.default_rng(seed)
    law = make_law(n, rng, **mixed_options(n, rng))
    middle = make_middle(n, altitude=np.array([np.nan, 100.0, np.nan, np.nan, 90.0]))
    return rng, law, middle


# groups


def test_groups_in_turn_are_everybody_at_once():
    """Whoever steps together: what each is told, does and remembers is the same, to the bit."""
    rng, law, middle = case()
    together = Control(groups(law, middle, range(5)), np.zeros((6, 3)), None)
    apart = Control(groups(law, middle, [3], [0, 4], [1, 2]), np.zeros((6, 3)), None)
    for k in range(20):
        now = 100.0 + DT * k
        own, inbox, _ = states(5, rng, silence=0.1, old=0.1, now=now)
        together.step(0, now, own, inbox, inbox.stamp_s)
        for number in (2, 0, 1):
            apart.step(number, now, own, inbox, inbox.stamp_s)
        for (name, ours), (_, theirs) in zip(parts(together), parts(apart), strict=True):
            np.testing.assert_array_equal(theirs, ours, err_msg=f"{name} in step {k}")


def test_a_group_writes_into_its_own_rows_alone():
    rng, law, middle = case(91)
    control = Control(groups(law, middle, [3], [0, 4], [1, 2]), np.zeros((6, 3)), None)
    own, inbox, _ = states(5, rng)
    for number in range(3):
        control.step(number, 100.0, own, inbox, inbox.stamp_s)
    for number, rows in ((1, [0, 4]), (0, [3]), (2, [1, 2])):
        others = [i for i in range(5) if i not in rows]
        before = dict(parts(control))
        kept = {name: each.copy() for name, each in before.items()}
        own, inbox, _ = states(5, rng, now=100.04)
        control.step(number, 100.04, own, inbox, inbox.stamp_s)
        for name, now in parts(control):
            np.testing.assert_array_equal(now[others], kept[name][others], err_msg=name)
            assert now is before[name], name  # nothing new is made
        assert (control.unicycle.direction[rows] != kept["unicycle.direction"][rows]).any(1).all()
        used = ~np.isnan(kept["age_s"][rows])
        assert used[:, 0].all()
        assert (control.age_s[rows][used] != kept["age_s"][rows][used]).all()


def test_a_group_sees_the_rows_of_its_own_agents():
    """What the others know may be anything."""
    rng, law, middle = case(92)
    ours, theirs = (
        Control(groups(law, middle, [0, 4], [1, 2, 3]), np.zeros((6, 3)), None) for _ in range(2)
    )
    own, inbox, _ = states(5, rng)
    other_own, other_inbox, _ = states(5, rng)
    mixed = []
    for mine, another in ((own, other_own), (inbox, other_inbox)):
        copies = [each.copy() for each in mine]
        for copy, strange in zip(copies, another, strict=True):
            copy[1:4] = strange[1:4]
        mixed.append(type(mine)(*copies))
    ours.step(0, 100.0, own, inbox, inbox.stamp_s)
    theirs.step(0, 100.0, *mixed, mixed[1].stamp_s)
    for (name, one), (_, two) in zip(parts(ours), parts(theirs), strict=True):
        np.testing.assert_array_equal(two, one, err_msg=name)


def test_ages_are_of_what_was_used():
    rng, law, middle = case(93)
    law = replace(law, gains=np.ones((5, 6, 3)), hold=False)
    law.gains[2, 4:] = 0.0
    law.gains[2, 0] = 0.0  # the leader's rates are used all the same
    limits = {"silent_after": 2.0, "stale_after": 1.5}
    control = Control(groups(law, middle, range(5), **limits), np.zeros((6, 3)), None)
    assert np.isnan(control.age_s).all()
    own, inbox, _ = states(5, rng)
    inbox.stamp_s[:], inbox.received_s[:] = 99.7, 99.9
    inbox.stamp_s[1, 2] = inbox.received_s[1, 2] = np.nan
    inbox.received_s[3, 0] = 97.9
    inbox.received_s[4, 0] = 98.0
    inbox.received_s[4, 1], inbox.received_s[4, 2] = 98.5, 98.4
    control.step(0, 100.0, own, inbox, inbox.stamp_s)
    expected = np.full((5, 6), 0.3)
    expected[1, 2] = np.nan
    expected[3] = np.nan  # who does not hear the leader uses nobody's news
    expected[4, 2] = np.nan
    expected[2, 4:] = np.nan
    assert control.age_s == pytest.approx(expected, abs=1e-12, nan_ok=True)
    # of a neighbour that is held at its place the old news is used
    control = Control(
        groups(replace(law, hold=True), middle, range(5), **limits), np.zeros((6, 3)), None
    )
    control.step(0, 100.0, own, inbox, inbox.stamp_s)
    expected[4, 2] = 0.3
    assert control.age_s == pytest.approx(expected, abs=1e-12, nan_ok=True)


# laws that hold the sticks themselves


class Sticks:
    """A law that answers with the command it was built with, and counts its steps."""

    def __init__(self, told):
        self.told = told

    def start(self, own):
        return 0

    def step(self, now, own, inbox, memory):
        return self.told, memory + 1


def stick_control(told, names=("uav1", "uav2")):
    rows = np.arange(len(names), dtype=np.intp)
    group = Group(
        rows=rows,
        team=team(names),
        law=Sticks(told),
        middle=make_middle(len(names)),
        ideal=np.zeros(len(names), dtype=bool),
        trusted=False,
    )
    return Control((group,), np.zeros((len(names) + 1, 3)), None)


def test_sticks_are_flown_within_their_limits():
    told = FbwaCommand(np.array([0.5, -0.2]), np.array([-0.9, 0.8]), np.array([0.4, 1.2]))
    rng = np.random.default_rng(94)
    own, inbox, _ = states(2, rng)
    command, unicycle, diagnosis = direct(told, own, team(("uav1", "uav2")))
    assert command.pitch.tolist() == [0.3, -0.2]
    assert command.roll.tolist() == [-0.8, 0.8]
    assert command.throttle.tolist() == [0.4, 1.0]
    expected = [Saturation.PITCH | Saturation.ROLL, Saturation.THROTTLE]
    assert diagnosis.saturations.tolist() == expected
    assert diagnosis.guards.tolist() == [0, 0]
    # what it was after, nobody knows; where it flies is seen
    assert np.isnan(diagnosis.speed_desired).all() and np.isnan(diagnosis.speed_command).all()
    north, east, down = own.velocity_ned.T
    assert diagnosis.course_desired == pytest.approx(np.arctan2(east, north), abs=1e-15)
    climb = np.arctan2(-down, np.hypot(north, east))
    assert diagnosis.flight_path_angle_desired == pytest.approx(climb, abs=1e-15)
    assert np.isnan(unicycle.speed).all() and np.isnan(unicycle.turn).all()
    # and through the control
    control = stick_control(told)
    control.step(0, 100.0, own, inbox, inbox.stamp_s)
    assert np.array_equal(control.command.roll, command.roll)
    assert control.diagnosis.saturations.tolist() == expected


def test_sticks_below_their_limits_are_flown_as_they_are():
    told = FbwaCommand(np.array([-0.5, 0.3]), np.array([0.9, -0.8]), np.array([-0.1, 0.0]))
    own, _, _ = states(2, np.random.default_rng(95))
    command, _, diagnosis = direct(told, own, team(("uav1", "uav2")))
    assert command.pitch.tolist() == [-0.3, 0.3]
    assert command.roll.tolist() == [0.8, -0.8]
    assert command.throttle.tolist() == [0.0, 0.0]
    assert diagnosis.saturations.tolist() == [sum(Saturation), 0]


# what a user's law may answer


def unicycle(n=2, **changes):
    told = UnicycleCommand(
        np.full(n, 22.0),
        np.zeros((n, 3)),
        np.full(n, 22.0),
        np.tile([1.0, 0.0, 0.0], (n, 1)),
        np.zeros(n, dtype=np.uint8),
    )
    return told._replace(**changes)


def sticks(n=2, **changes):
    return FbwaCommand(np.zeros(n), np.zeros(n), np.full(n, 0.4))._replace(**changes)


TWO = team(("uav1", "uav2"))


@pytest.mark.parametrize("told", [unicycle(), sticks()], ids=["unicycle", "sticks"])
def test_a_right_answer_is_the_answer(told):
    found = checked(told, TWO, 1.0)
    assert type(found) is type(told)
    for ours, theirs in zip(found, told, strict=True):
        assert np.array_equal(ours, theirs) and ours.dtype == theirs.dtype


def test_a_number_stands_for_everybody():
    found = checked(sticks(roll=0, throttle=0.4), TWO, 1.0)
    assert found.roll.tolist() == [0.0, 0.0] and found.throttle.tolist() == [0.4, 0.4]
    assert found.roll.dtype == np.float64 and found.roll.flags["C_CONTIGUOUS"]
    found = checked(unicycle(direction=[1, 0, 0], guards=0), TWO, 1.0)
    assert found.direction.shape == (2, 3) and found.guards.dtype == np.uint8


SHAPED = r"is not an array of shape \(2,\) at 1\.5 s \(one row for each of uav1, uav2\)"
WRONG = [
    (None, r"the law answered with NoneType at 1\.5 s \(return a UnicycleCommand or an Fbwa"),
    ((0.0, 0.0, 0.4), r"the law answered with tuple at"),
    (sticks(roll=np.zeros(3)), f"the law's roll {SHAPED}"),
    (sticks(pitch="up"), f"the law's pitch {SHAPED}"),
    (sticks(pitch=None), r"the law's pitch for uav1 is not a finite number at 1\.5 s"),
    (sticks(throttle=np.array([[0.4], [0.4]])), f"the law's throttle {SHAPED}"),
    (sticks(roll=np.array([0.0, np.nan])), r"the law's roll for uav2 is not a finite number at"),
    (sticks(pitch=np.array([-np.inf, 0.0])), r"the law's pitch for uav1 is not a finite number"),
    (unicycle(turn=np.zeros(2)), r"the law's turn is not an array of shape \(2, 3\) at 1\.5 s"),
    (unicycle(turn=[[0, 0, 0], [0, 0, np.nan]]), r"the law's turn for uav2 is not a finite"),
    (unicycle(direction=np.zeros((3, 3))), r"the law's direction is not an array of shape \(2, 3"),
    (unicycle(speed=[22.0, float("inf")]), r"the law's speed for uav2 is not a finite number"),
    (unicycle(guards="many"), f"the law's guards {SHAPED}"),
    (unicycle(guards=-1), f"the law's guards {SHAPED}"),
]


@pytest.mark.parametrize(("told", "message"), WRONG, ids=[message[10:40] for _, message in WRONG])
def test_a_wrong_answer_is_named_with_its_field_and_its_agent(told, message):
    with pytest.raises(InputError, match=message):
        checked(told, TWO, 1.5)


def test_a_users_answer_is_looked_at_and_the_papers_is_not():
    own, inbox, _ = states(2, np.random.default_rng(96))
    bad = sticks(roll=np.array([0.0, np.nan]))
    control = stick_control(bad)
    with pytest.raises(InputError, match="the law's roll for uav2"):
        control.step(0, 100.0, own, inbox, inbox.stamp_s)
    trusted = replace(stick_control(bad).groups[0], trusted=True)
    Control((trusted,), np.zeros((3, 3)), None).step(0, 100.0, own, inbox, inbox.stamp_s)
