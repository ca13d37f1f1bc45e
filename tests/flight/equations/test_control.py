"""Control of the followers: groups that step in turn, and the commands of users' laws."""

from dataclasses import fields

import numpy as np
import pytest
from formation_cases import DT, make_law, make_middle, mixed_options, states
from reference.adapters import law_records, loop_records

from testbed.core.errors import InputError
from testbed.core.flags import Saturation
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    LINK,
    FbwaCommand,
    UnicycleCommand,
    allocate,
    write_fields,
)
from testbed.flight.control import Control, ControlGroup, LawSurroundings, validate_command
from testbed.flight.law_inputs import declared_faults, wind_estimates
from testbed.flight.law_reports import LawReports
from testbed.formation.control_step import initial_controllers, make_neighbours
from testbed.formation.law import FormationConfig
from testbed.formation.law_outputs import Outputs

NAMES = ("uav1", "uav2", "uav3", "uav4", "uav5")


def make_config(names=NAMES):
    n = len(names)
    values = {
        "names": names,
        "agents": np.arange(1, n + 1, dtype=np.intp),
        "offsets": np.zeros((n + 1, 3)),
        "gains": np.zeros((n, n + 1, 3)),
        "pitch_limit": np.full(n, 0.3),
        "roll_limit": np.full(n, 0.8),
        "dt": DT,
        "leader_timeout_s": 5.0,
        "neighbour_timeout_s": 5.0,
    }
    taken = [field.name for field in fields(FormationConfig)]
    rest = {name: np.ones(n) for name in taken if name not in values and name != "hbh23"}
    return FormationConfig(**{**rest, **values})


class Run:
    """The records of n followers and their control.

    Args:
        law: of the reference.
        middle: of the reference.
        rows: those of each group.
        user_law: of all groups; None: the built-in law.
    """

    def __init__(self, law, middle, *rows, user_law=None):
        n = len(law.k)
        self.aircraft, self.followers = allocate(AIRCRAFT, n + 1), allocate(FOLLOWER, n)
        self.links = allocate(LINK, n, n + 1)
        timeout_s = np.inf if law.hold_stale_neighbours else law.neighbour_timeout_s
        groups = [
            ControlGroup(
                np.array(each, dtype=np.intp), make_config(tuple(NAMES[i] for i in each)), law_
            )
            for each, law_ in ((list(each), user_law) for each in rows)
        ]
        self.control = Control(
            tuple(groups),
            initial_controllers(law_records(law), loop_records(middle), [False] * n),
            make_neighbours(law.offsets, law.gains, law.leader_timeout_s, timeout_s),
            np.zeros((n + 1, 3)),
            None,
            (self.aircraft, self.followers, self.links),
            LawSurroundings(
                wind_estimates(None, self.aircraft),
                declared_faults(None),
                np.zeros((n, n + 1, 0)),
                LawReports(NAMES[:n], Outputs(), np.zeros((n + 1, 0))),
            ),
        )
        self.steps = [self.control.steps(number) for number in range(len(groups))]

    def step(self, number, now, own, inbox):
        write_fields(self.aircraft["estimate"][1:], own)
        write_fields(self.links, inbox)
        self.links["measured_s"] = inbox.stamp_s
        for step in self.steps[number]:
            step(now)

    @property
    def command(self):
        return self.aircraft["control"][1:]

    def outputs(self):
        """Return what a control step writes, by name; every array (n, …)."""
        found = {name: self.followers[name].copy() for name in FOLLOWER.names}
        found |= {f"command.{name}": self.command[name].copy() for name in self.command.dtype.names}
        return {**found, "age_s": self.links["age_s"].copy()}


def make_laws(seed=90, n=5):
    rng = np.random.default_rng(seed)
    law = make_law(n, rng, **mixed_options(n, rng))
    middle = make_middle(n, altitude=np.array([np.nan, 100.0, np.nan, np.nan, 90.0]))
    return rng, law, middle


# groups


def test_groups_in_turn_equal_one_group_to_the_bit():
    rng, *laws = make_laws()
    one, three = Run(*laws, range(5)), Run(*laws, [3], [0, 4], [1, 2])
    for k in range(20):
        now = 100.0 + DT * k
        own, inbox, _ = states(5, rng, never=0.1, old=0.1, now=now)
        one.step(0, now, own, inbox)
        for number in (2, 0, 1):
            three.step(number, now, own, inbox)
        found = three.outputs()
        for name, expected in one.outputs().items():
            np.testing.assert_array_equal(found[name], expected, err_msg=f"{name} in step {k}")


def test_group_writes_only_its_own_rows():
    rng, *laws = make_laws(91)
    run = Run(*laws, [3], [0, 4], [1, 2])
    own, inbox, _ = states(5, rng)
    for number in range(3):
        run.step(number, 100.0, own, inbox)
    for number, rows in ((1, [0, 4]), (0, [3]), (2, [1, 2])):
        others = [i for i in range(5) if i not in rows]
        before = run.outputs()
        own, inbox, _ = states(5, rng, now=100.04)
        run.step(number, 100.04, own, inbox)
        after = run.outputs()
        for name, array in after.items():
            np.testing.assert_array_equal(array[others], before[name][others], err_msg=name)
        assert (after["direction"][rows] != before["direction"][rows]).any(1).all()
        used = ~np.isnan(before["age_s"][rows])
        assert used[:, 0].all()
        assert (after["age_s"][rows][used] != before["age_s"][rows][used]).all()


def test_group_reads_only_its_own_rows():
    rng, *laws = make_laws(92)
    ours, theirs = (Run(*laws, [0, 4], [1, 2, 3]) for _ in range(2))
    known = states(5, rng)[:2]
    mixed = []
    for mine, other in zip(known, states(5, rng)[:2], strict=True):
        copies = [each.copy() for each in mine]
        for copy, strange in zip(copies, other, strict=True):
            copy[1:4] = strange[1:4]
        mixed.append(type(mine)(*copies))
    ours.step(0, 100.0, *known)
    theirs.step(0, 100.0, *mixed)
    found = theirs.outputs()
    for name, expected in ours.outputs().items():
        np.testing.assert_array_equal(found[name], expected, err_msg=name)


@pytest.mark.parametrize("hold", [False, True], ids=["drop", "hold"])
def test_ages_are_those_of_the_messages_used(hold):
    rng = np.random.default_rng(93)
    gains = np.ones((5, 6, 3))
    gains[2, 4:] = 0.0
    gains[2, 0] = 0.0  # the leader's message is used without a gain too
    law = make_law(
        5,
        rng,
        gains=gains,
        hold_stale_neighbours=hold,
        leader_timeout_s=2.0,
        neighbour_timeout_s=1.5,
    )
    run = Run(law, make_middle(5), range(5))
    assert np.isnan(run.links["age_s"]).all()
    own, inbox, _ = states(5, rng)
    inbox.stamp_s[:], inbox.received_s[:] = 99.7, 99.9
    inbox.stamp_s[1, 2] = inbox.received_s[1, 2] = np.nan
    inbox.received_s[3, 0] = 97.9
    inbox.received_s[4, 0] = 98.0
    inbox.received_s[4, 1], inbox.received_s[4, 2] = 98.5, 98.4
    run.step(0, 100.0, own, inbox)
    expected = np.full((5, 6), 0.3)
    expected[1, 2] = np.nan
    expected[3] = np.nan  # in a leader timeout no message is used
    expected[2, 4:] = np.nan
    if not hold:  # of a neighbour that is held at its position the old message is used
        expected[4, 2] = np.nan
    assert run.links["age_s"] == pytest.approx(expected, abs=1e-12, nan_ok=True)


# users' laws that command fly-by-wire A


class ConstantLaw:
    """Returns the command that it was made with, and counts its steps."""

    def __init__(self, command):
        self.command = command

    def start(self, own):
        return 0

    def step(self, now, own, inbox, memory):
        return self.command, memory + 1


def run_with_user_law(command):
    law = make_law(2, np.random.default_rng(94))
    return Run(law, make_middle(2), range(2), user_law=ConstantLaw(command))


def test_fbwa_command_of_a_law_is_clamped():
    run = run_with_user_law(
        FbwaCommand(np.array([0.5, -0.2]), np.array([-0.9, 0.8]), np.array([0.4, 1.2]))
    )
    own, inbox, _ = states(2, np.random.default_rng(94))
    run.step(0, 100.0, own, inbox)
    assert run.command["pitch"].tolist() == [0.3, -0.2]
    assert run.command["roll"].tolist() == [-0.8, 0.8]
    assert run.command["throttle"].tolist() == [0.4, 1.0]
    followers = run.followers
    expected = [Saturation.PITCH | Saturation.ROLL, Saturation.THROTTLE]
    assert followers["saturations"].tolist() == expected
    assert followers["limiter_flags"].tolist() == [0, 0]
    # what the law desired is unknown; the desired motion is the present one
    for name in ("speed_desired", "airspeed_command", "speed_command", "omega"):
        assert np.isnan(followers[name]).all(), name
    north, east, down = own.velocity_ned.T
    assert followers["course_desired"] == pytest.approx(np.arctan2(east, north), abs=1e-15)
    gamma = np.arctan2(-down, np.hypot(north, east))
    assert followers["flight_path_angle_desired"] == pytest.approx(gamma, abs=1e-15)
    # an own law may use any message, so all are counted
    assert run.links["age_s"] == pytest.approx(100.0 - inbox.stamp_s, abs=1e-12)


def test_fbwa_command_is_clamped_at_its_other_limits():
    run = run_with_user_law(
        FbwaCommand(np.array([-0.5, 0.3]), np.array([0.9, -0.8]), np.array([-0.1, 0.0]))
    )
    own, inbox, _ = states(2, np.random.default_rng(95))
    run.step(0, 100.0, own, inbox)
    assert run.command["pitch"].tolist() == [-0.3, 0.3]
    assert run.command["roll"].tolist() == [0.8, -0.8]
    assert run.command["throttle"].tolist() == [0.0, 0.0]
    assert run.followers["saturations"].tolist() == [sum(Saturation), 0]


# what a user's law may return


def unicycle_command(n=2, **changes):
    command = UnicycleCommand(
        np.full(n, 22.0),
        np.zeros((n, 3)),
        np.full(n, 22.0),
        np.tile([1.0, 0.0, 0.0], (n, 1)),
        np.zeros(n, dtype=np.uint8),
    )
    return command._replace(**changes)


def fbwa_command(n=2, **changes):
    return FbwaCommand(np.zeros(n), np.zeros(n), np.full(n, 0.4))._replace(**changes)


TWO = make_config(("uav1", "uav2"))


@pytest.mark.parametrize("command", [unicycle_command(), fbwa_command()], ids=["unicycle", "fbwa"])
def test_valid_command_is_unchanged(command):
    found = validate_command(command, TWO, 1.0)
    assert type(found) is type(command)
    for ours, theirs in zip(found, command, strict=True):
        assert np.array_equal(ours, theirs) and ours.dtype == theirs.dtype


def test_command_of_integers_is_converted():
    """Lists and integers become arrays of the right type; one flag stands for all followers."""
    found = validate_command(fbwa_command(roll=[0, 1], throttle=[0.4, 0.4]), TWO, 1.0)
    assert found.roll.tolist() == [0.0, 1.0] and found.throttle.tolist() == [0.4, 0.4]
    assert found.roll.dtype == np.float64 and found.roll.flags["C_CONTIGUOUS"]
    found = validate_command(unicycle_command(limiter_flags=0), TWO, 1.0)
    assert found.direction.shape == (2, 3) and found.limiter_flags.dtype == np.uint8


ROWS = r"\(write an array of shape \(2,\), a row for each of uav1, uav2\)"
WRONG = [
    (None, r"the law returned NoneType at 1\.5 s \(return a UnicycleCommand or an Fbwa"),
    ((0.0, 0.0, 0.4), r"the law returned tuple at"),
    (fbwa_command(roll=np.zeros(3)), rf"the law's roll has shape \(3,\) at 1\.5 s {ROWS}"),
    (fbwa_command(pitch="up"), rf"the law's pitch is no number at 1\.5 s {ROWS}"),
    (fbwa_command(pitch=None), rf"the law's pitch is one number at 1\.5 s {ROWS}"),
    (
        fbwa_command(throttle=np.array([[0.4], [0.4]])),
        rf"the law's throttle has shape \(2, 1\) at 1\.5 s {ROWS}",
    ),
    (
        fbwa_command(roll=np.array([0.0, np.nan])),
        r"the law's roll for uav2 is not a finite number at",
    ),
    (
        fbwa_command(pitch=np.array([-np.inf, 0.0])),
        r"the law's pitch for uav1 is not a finite number",
    ),
    (
        unicycle_command(omega=np.zeros(2)),
        r"the law's omega has shape \(2,\) at 1\.5 s \(write an array of shape \(2, 3\)",
    ),
    (
        unicycle_command(omega=[[0, 0, 0], [0, 0, np.nan]]),
        r"the law's omega for uav2 is not a finite",
    ),
    (
        unicycle_command(direction=np.zeros((3, 3))),
        r"the law's direction has shape \(3, 3\) at 1\.5 s \(write an array of shape \(2, 3\)",
    ),
    (
        unicycle_command(speed=[22.0, float("inf")]),
        r"the law's speed for uav2 is not a finite number",
    ),
    (
        unicycle_command(limiter_flags="many"),
        rf"the law's limiter_flags is no number at 1\.5 s {ROWS}",
    ),
    (unicycle_command(limiter_flags=-1), rf"the law's limiter_flags is no number at 1\.5 s {ROWS}"),
]


@pytest.mark.parametrize(
    ("command", "message"), WRONG, ids=[message[10:40] for _, message in WRONG]
)
def test_invalid_command_names_field_and_follower(command, message):
    with pytest.raises(InputError, match=message):
        validate_command(command, TWO, 1.5)


def test_command_of_a_user_law_is_validated_in_flight():
    run = run_with_user_law(fbwa_command(roll=np.array([0.0, np.nan])))
    own, inbox, _ = states(2, np.random.default_rng(96))
    with pytest.raises(InputError, match="the law's roll for uav2"):
        run.step(0, 100.0, own, inbox)
