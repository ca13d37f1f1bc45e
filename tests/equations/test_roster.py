"""Who is known to have failed, what is made of it, and who is lost."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import NOW, PAPERS_MU, make_law, results, states

from testbed.formation import paper_law as numpy_law
from testbed.formation.law import Team
from testbed.scenario.faults import (
    AutopilotFrozen,
    BatteryLow,
    Condition,
    EngineOut,
    GpsJump,
    SurfaceStuck,
    ThrustLoss,
)
from testbed.sim.breakdowns import Breakdowns
from testbed.sim.casualties import Casualties
from testbed.sim.control import Group
from testbed.sim.limits import Proximity
from testbed.sim.roster import Roster
from testbed.state import Inbox, VehicleState

NAMES = ["leader", "uav1", "uav2", "uav3"]
OFFSETS = np.array([[0.0, 0, 0], [-5, 5, 0], [-10, -5, 0], [-15, 5, 0]])
# a chain: each hears the leader and the one ahead; gains that can be told apart
GAINS = np.zeros((3, 4, 3))
GAINS[:, 0] = [[1.0], [2.0], [3.0]]
GAINS[1, 1] = 4.0
GAINS[2, 2] = 5.0


def truth(altitude=100.0, airspeed=20.0, bank=0.0):
    state = VehicleState(*np.zeros((5, 4, 3)), *np.full((2, 4), airspeed))
    state.position_ned[:, 2] = -altitude
    state.euler[:, 0] = bank
    return state


def no_air():
    raise AssertionError("nobody's battery matters")


def breaking(*faults, row=2, after_s=2.0):
    each = [[], [], [], []]
    each[row] = list(faults)
    return Breakdowns(NAMES, each, after_s)


def told(breakdowns, now, state=None):
    events = breakdowns.changes(
        now, truth() if state is None else state, no_air, np.zeros(4, dtype=bool)
    )
    return [(e.time_s, e.level, e.source, e.text) for e in events]


def test_a_fault_begins_at_its_moment_and_ends_after_its_time():
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0, lasts_s=5.0))
    assert told(watch, 9.98) == []
    assert watch.failing.power.tolist() == [1.0, 1.0, 1.0, 1.0]
    assert told(watch, 10.0) == [(10.0, "warning", "uav2", "engine out")]
    assert watch.failing.power.tolist() == [1.0, 1.0, 0.0, 1.0]
    assert watch.broken.tolist() == [False, False, True, False]
    assert told(watch, 14.98) == []
    assert told(watch, 15.0) == [(15.0, "info", "uav2", "engine out: over")]
    assert watch.failing.power.tolist() == [1.0, 1.0, 1.0, 1.0]
    assert told(watch, 20.0) == []  # it does not begin again


@pytest.mark.parametrize(
    ("condition", "before", "then"),
    [
        ({"quantity": "altitude_m", "above": 120.0}, truth(120.0), truth(120.1)),
        ({"quantity": "airspeed_mps", "below": 18.0}, truth(airspeed=18.0), truth(airspeed=17.9)),
        ({"quantity": "bank_deg", "above": 20.0}, truth(bank=0.34), truth(bank=-0.36)),
    ],
)
def test_a_condition_counts_from_its_time_on_and_once(condition, before, then):
    watch = breaking(
        AutopilotFrozen(kind="autopilot-frozen", at_s=5.0, lasts_s=1.0, when=Condition(**condition))
    )
    assert told(watch, 4.0, then) == []
    assert told(watch, 5.0, before) == []
    assert [each[3] for each in told(watch, 6.0, then)] == ["autopilot frozen"]
    assert watch.failing.frozen[2]
    assert [each[3] for each in told(watch, 7.0, then)] == ["autopilot frozen: over"]
    assert told(watch, 8.0, then) == []


def test_several_faults_of_an_aircraft_add_up():
    watch = breaking(
        ThrustLoss(kind="thrust-loss", at_s=1.0, left=0.5),
        ThrustLoss(kind="thrust-loss", at_s=2.0, left=0.5, lasts_s=3.0),
        GpsJump(kind="gps-jump", at_s=1.0, offset_m=(1.0, 2.0, 3.0)),
        GpsJump(kind="gps-jump", at_s=1.0, offset_m=(10.0, 0.0, 0.0)),
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=1.0, position=0.25),
    )
    told(watch, 2.0)
    assert watch.failing.power[2] == 0.25
    assert watch.failing.gps_jump[2].tolist() == [11.0, 2.0, 3.0]
    assert watch.failing.stuck[2].tolist() == [False, False, True, False, False]
    assert watch.failing.stuck_at[2, 2] == 0.25
    told(watch, 5.0)
    assert watch.failing.power[2] == 0.5


def test_a_battery_drops_once():
    watch = breaking(BatteryLow(kind="battery-low", at_s=1.0, state_of_charge=0.2))
    told(watch, 1.0)
    assert watch.failing.charge[2] == 0.2
    told(watch, 1.02)
    assert np.isnan(watch.failing.charge).all()


def test_messages_tell_of_a_failure_from_its_declaration_on():
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0, lasts_s=5.0), after_s=2.0)
    told(watch, 10.0)
    measured = np.array([[0.0, 0.0, 11.96, 0.0], [0.0, 0.0, 12.0, 0.0], [0.0, 0.0, np.nan, 0.0]])
    assert watch.told(measured)[:, 2].tolist() == [False, True, False]
    told(watch, 15.0)
    assert watch.told(np.array([0.0, 0.0, 16.0, 0.0])).tolist() == [False, False, True, False]
    # a later fault changes nothing of what old messages said
    assert watch.told(np.array([0.0, 0.0, 11.96, 0.0])).tolist() == [False] * 4


def test_what_is_over_before_it_is_told_is_never_told():
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0, lasts_s=1.0), after_s=2.0)
    told(watch, 10.0)
    told(watch, 11.0)
    assert not watch.told(np.full(4, 30.0)).any()


def test_the_lost_break_no_more():
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0))
    lost = np.array([False, False, True, False])
    assert list(watch.changes(10.0, truth(), no_air, lost)) == []
    assert not watch.broken.any()


def test_of_two_that_stick_the_last_has_its_way():
    watch = breaking(
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=2.0, position=0.5),
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=1.0, position=0.25),
    )
    told(watch, 1.0)
    told(watch, 2.0)
    assert watch.failing.stuck_at[2, 2] == 0.5


def roster(*, clear_m=10.0, lasts_s=None):
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0, lasts_s=lasts_s), after_s=2.0)
    told(watch, 10.0)
    return Roster(NAMES, OFFSETS, GAINS, watch, clear_m), watch


def heard(time_s, *, uav3=None):
    """Times (n, N) at which what has arrived was true; uav3 may have heard uav2 less recently."""
    measured = np.full((3, 4), time_s)
    if uav3 is not None:
        measured[2, 2] = uav3
    return measured


def team(rows=(0, 1, 2)):
    law = make_law(3, np.random.default_rng(1), mu=PAPERS_MU, offsets=OFFSETS, gains=GAINS)
    n = len(rows)
    nothing = np.zeros(n)
    own = Team(
        names=tuple(NAMES[row + 1] for row in rows),
        agents=np.array([row + 1 for row in rows]),
        offsets=OFFSETS,
        gains=GAINS[list(rows)],
        **dict.fromkeys(
            (
                "speed_low",
                "speed_high",
                "speed_pole",
                "pitch_limit",
                "roll_limit",
                "trim_throttle",
                "trim_airspeed",
            ),
            nothing,
        ),
        dt=0.04,
        silent_after=5.0,
        stale_after=5.0,
    )
    return Group(
        rows=np.array(rows),
        team=own,
        law=replace(law, gains=GAINS[list(rows)]),
        middle=None,
        ideal=np.zeros(n, dtype=bool),
        trusted=True,
    )


def news(below=0.0):
    """A leader that flies north at 20 m/s, all in their places but for uav2, this far below."""
    place = np.tile(OFFSETS + [0.0, 0.0, -100.0], (3, 1, 1))
    place[:, 2, 2] += below
    velocity = np.tile([20.0, 0.0, 0.0], (3, 4, 1))
    still = np.zeros((3, 4, 3))
    never = np.zeros((3, 4))
    return Inbox(never, never, place, velocity, still, still, still)


EVERY = np.arange(3)


def learnt(ours, now, measured, below=0.0):
    return [(e.source, e.text) for e in ours.changes(now, EVERY, news(below), measured)]


def test_each_follower_knows_of_a_failure_once_it_has_heard_of_it():
    ours, _ = roster()
    assert learnt(ours, 11.0, heard(11.0)) == []
    assert learnt(ours, 12.1, heard(12.1, uav3=11.9)) == [
        ("uav1", "uav2 has failed"),
        ("uav2", "leaves the formation: flies on its own"),
    ]
    assert ours.known.tolist() == [[False, False, True, False], [False] * 4, [False] * 4]
    assert learnt(ours, 12.2, heard(12.2)) == [("uav3", "uav2 has failed: leaves it out")]
    # what is known stays known when nothing is heard any more
    assert learnt(ours, 13.0, heard(12.2, uav3=np.nan)) == []
    assert ours.known[:, 2].tolist() == [True, False, True]  # of itself it makes nothing


def test_a_place_is_taken_once_who_failed_has_left_it():
    ours, _ = roster()
    learnt(ours, 12.1, heard(12.1))
    assert learnt(ours, 14.0, heard(14.0), below=9.9) == []
    assert np.array_equal(ours.offsets, OFFSETS)
    assert learnt(ours, 15.0, heard(15.0), below=10.1) == [
        ("uav1", "uav2 has left its place"),
        ("uav3", "uav2 has left its place, takes the place of uav2"),
    ]
    assert ours.alone.tolist() == [False, True, False]
    assert learnt(ours, 16.0, heard(16.0), below=0.0) == []  # and stays taken
    assert ours.places.tolist() == [1, 2, 2]


def test_where_it_is_counts_when_its_message_was_true():
    """The leader's message is 0.5 s newer: 10 m of its way are no distance from a place."""
    ours, _ = roster(clear_m=5.0)
    measured = heard(14.0)
    measured[:, 0] = 14.5
    inbox = news()
    inbox.position_ned[:, 0, 0] += 10.0
    told_ = [e.text for e in ours.changes(14.5, EVERY, inbox, measured)]
    assert told_ == [
        "uav2 has failed",
        "uav2 has failed: leaves it out",
        "leaves the formation: flies on its own",
    ]


def test_closing_up_gives_the_place_its_offset_and_gains():
    ours, _ = roster()
    learnt(ours, 12.1, heard(12.1), below=20.0)
    group = ours.regrouped(team())
    # uav3 flies in the place of uav2: with the leader gain 2, and 4 for who is in the first place
    assert group.law.gains[2, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]
    assert group.team.gains[2, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]
    assert np.array_equal(group.law.offsets[2], OFFSETS[[0, 1, 2, 2]])
    # uav1 keeps its own, and uav2 knows of nothing
    assert group.law.gains[0, :, 0].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert group.law.gains[1, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]
    assert np.array_equal(ours.offsets, OFFSETS[[0, 1, 2, 2]])
    assert group.unheeded[2].tolist() == [False, False, True, True]


def test_dropping_leaves_everybody_in_place():
    ours, _ = roster(clear_m=None)
    told_ = [text for _, text in learnt(ours, 12.1, heard(12.1), below=20.0)]
    assert told_ == ["uav2 has failed", "uav2 has failed: leaves it out"]
    group = ours.regrouped(team())
    assert group.law.gains[2, :, 0].tolist() == [3.0, 0.0, 0.0, 0.0]
    assert np.array_equal(ours.offsets, OFFSETS)


def test_a_group_of_some_followers_gets_their_rows():
    ours, _ = roster()
    learnt(ours, 12.1, heard(12.1), below=20.0)
    group = ours.regrouped(team(rows=(2,)))
    assert group.law.gains.shape == (1, 4, 3)
    assert group.law.gains[0, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]


def test_who_has_failed_stays_out_when_its_fault_is_over():
    ours, watch = roster(lasts_s=5.0)
    learnt(ours, 12.1, heard(12.1), below=20.0)
    told(watch, 15.0)
    assert learnt(ours, 15.1, heard(15.1), below=0.0) == []
    assert ours.places.tolist() == [1, 2, 2]


def test_a_leader_that_fails_leads_on():
    watch = breaking(EngineOut(kind="engine-out", at_s=10.0), row=0)
    told(watch, 10.0)
    ours = Roster(NAMES, OFFSETS, GAINS, watch, 10.0)
    assert learnt(ours, 13.0, heard(13.0)) == []
    assert not ours.known.any()


def test_of_two_that_fail_only_the_place_that_is_left_is_filled():
    """uav1 falls out and uav2 flies on in its place: uav3 stays behind until that is free too."""
    both = [[], [EngineOut(kind="engine-out", at_s=1.0)], [EngineOut(kind="engine-out", at_s=1.0)]]
    watch = Breakdowns(NAMES, [*both, []], 0.0)
    told(watch, 1.0)
    ours = Roster(NAMES, OFFSETS, GAINS, watch, 10.0)
    inbox = news()
    inbox.position_ned[:, 1, 2] += 50.0
    list(ours.changes(2.0, EVERY, inbox, heard(2.0)))
    assert ours.places[2] == 1
    assert ours.alone.tolist() == [True, True, False]


def test_an_inbox_forgets_who_has_failed():
    ours, _ = roster()
    full = np.zeros((3, 4, 3))
    inbox = Inbox(heard(12.0), heard(12.0), full, full, full, full, full)
    assert ours.heard(inbox) is inbox
    learnt(ours, 12.1, heard(12.1))
    left = ours.heard(inbox)
    out = ours.known | ours.alone[:, np.newaxis]  # and who has left hears nobody
    assert np.isnan(left.stamp_s).tolist() == out.tolist()
    assert out.sum() == 6
    assert np.isnan(left.position_ned).all(axis=2).tolist() == out.tolist()
    assert np.array_equal(left.euler[~out], full[~out])


def test_offsets_as_each_agent_knows_them_are_those_of_a_law_of_its_own():
    """Agent i of a law with offsets (n, N, 3) does what it would with its own alone."""
    n, rng = 4, np.random.default_rng(3)
    law = make_law(n, rng)
    known = np.concatenate([np.zeros((n, 1, 3)), rng.uniform(-10.0, 10.0, (n, n, 3))], axis=1)
    what = states(n, rng)
    for step in (numpy_law.paper_step, numpy_law.STEP):  # the compiled one, where there is one
        together = results(step(replace(law, offsets=known), NOW, *what))
        for i in range(n):
            alone = results(step(replace(law, offsets=known[i]), NOW, *what))
            for name, values in together.items():
                np.testing.assert_array_equal(values[i], alone[name][i], err_msg=name)


def casualties(*, fly_on, breakdowns=None, collision_m=None):
    return Casualties(NAMES, Proximity(NAMES, collision_m=collision_m), breakdowns, fly_on=fly_on)


FAR = np.array([[100.0 * i, 0.0, -100.0] for i in range(4)])


def test_each_lost_aircraft_is_an_error_of_its_own_and_ends_the_run():
    ours = casualties(fly_on=False)
    assert list(ours.changes(3.0, FAR, np.zeros(4, dtype=bool))) == []
    assert (ours.over, ours.outcome) == (False, "flown")
    events = list(ours.changes(3.5, FAR, np.array([False, True, True, False])))
    assert [(e.time_s, e.level, e.source) for e in events] == [
        (3.5, "error", "uav1"),
        (3.5, "error", "uav2"),
    ]
    assert (ours.over, ours.outcome) == (True, "lost")


def test_flying_on_without_those_the_page_broke_is_a_flight():
    _, watch = roster()  # breaks uav2
    ours = casualties(fly_on=True, breakdowns=watch)
    list(ours.changes(3.0, FAR, np.array([False, False, True, False])))
    assert (ours.over, ours.outcome) == (False, "flown")
    assert list(ours.changes(4.0, FAR, np.array([False, False, True, False]))) == []
    list(ours.changes(5.0, FAR, np.array([False, True, True, False])))  # nobody broke uav1
    assert (ours.over, ours.outcome) == (False, "lost")


def test_a_run_without_anybody_left_is_over():
    ours = casualties(fly_on=True)
    list(ours.changes(3.0, FAR, np.ones(4, dtype=bool)))
    assert (ours.over, ours.outcome) == (True, "lost")


def test_who_collides_is_lost():
    _, watch = roster()
    ours = casualties(fly_on=True, breakdowns=watch, collision_m=3.0)
    near = FAR.copy()
    near[3] = near[2] + [0.0, 2.0, 0.0]
    before = ours.gone
    events = list(ours.changes(3.0, near, np.zeros(4, dtype=bool)))
    assert [(e.level, e.source) for e in events] == [("error", "uav2")]
    assert ours.gone.tolist() == [False, False, True, True]
    assert not before.any()  # what observers were given stays as it was
    assert ours.outcome == "lost"  # uav3 was not broken by the page
