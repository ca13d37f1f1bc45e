"""What the loop tells others: broadcasts of estimates, and errors of the truth."""

import numpy as np
import pytest

from testbed.formation.flags import Guard
from testbed.formation.law import Diagnosis
from testbed.network.ledger import Ledger, blank
from testbed.scenario import load
from testbed.sim.hearing import DEAF, OVERDUE, READY_HEARD, Hearing, Silence, heard
from testbed.sim.watch import READY_HELD, Arrivals, Engagement, Slots, Speaker, held
from testbed.sim.world import build
from testbed.state import VehicleState


def flying():
    """A leader that flies east at 20 m/s, and two followers; numbers that can be told apart."""
    vectors = np.arange(5 * 3 * 3, dtype=float).reshape(5, 3, 3)
    state = VehicleState(*vectors, np.array([20.0, 21.0, 22.0]), np.array([19.0, 20.0, 21.0]))
    state.position_ned[:] = [[100.0, 200.0, -50.0], [96.0, 195.0, -50.0], [106.0, 194.0, -47.0]]
    state.velocity_ned[:] = [[0.0, 20.0, 0.0], [12.0, 16.0, 0.0], [0.0, 3.0, -4.0]]
    return state


DIAGNOSIS = Diagnosis(
    *np.arange(8.0).reshape(4, 2),
    guards=np.array([1, 2], dtype=np.uint8),
    saturations=np.array([4, 0], dtype=np.uint8),
)
AGE_S = np.array([[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]])
PLACES = np.array([1, 2], dtype=np.uint32)
NOBODY = np.array([np.nan, np.nan])  # holds an altitude


def test_slots_and_errors_are_the_truths():
    # 5 m behind and 5 m right of east is west and south; 4 m down
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 4.0]])
    truth = flying()
    state = Slots(2).state(truth, truth, DIAGNOSIS, AGE_S, offsets, PLACES, NOBODY)
    assert state.slot_ned == pytest.approx(
        np.array([[95.0, 195.0, -50.0], [105.0, 195.0, -46.0]]), abs=1e-12
    )
    # (16): position − slot
    assert state.error_ned == pytest.approx(
        np.array([[1.0, 0.0, 0.0], [1.0, -1.0, -1.0]]), abs=1e-12
    )
    # (17), (18): what is and what is wanted, side by side
    assert state.speed == pytest.approx([20.0, 5.0], rel=1e-15)
    assert state.course == pytest.approx([np.arctan2(16.0, 12.0), np.pi / 2.0], rel=1e-15)
    assert state.flight_path_angle == pytest.approx([0.0, np.arctan2(4.0, 3.0)], rel=1e-15)
    assert state.speed_desired.tolist() == [0.0, 1.0]
    assert state.speed_command.tolist() == [2.0, 3.0]
    assert state.course_desired.tolist() == [4.0, 5.0]
    assert state.flight_path_angle_desired.tolist() == [6.0, 7.0]
    assert state.guards.tolist() == [1, 2]
    assert state.saturations.tolist() == [4, 0]
    assert np.array_equal(state.age_s, AGE_S)
    # where all estimates are exact, nothing else is believed
    assert state.believed_ned is state.error_ned


def test_what_is_believed_is_the_error_of_the_estimates():
    """The leader takes itself to be 2 m farther north, and uav2 1 m lower, than they are."""
    truth, estimate = flying(), flying()
    estimate.position_ned[0, 0] += 2.0
    estimate.position_ned[2, 2] += 1.0
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 4.0]])
    state = Slots(2).state(truth, estimate, DIAGNOSIS, AGE_S, offsets, PLACES, NOBODY)
    assert state.error_ned == pytest.approx(
        np.array([[1.0, 0.0, 0.0], [1.0, -1.0, -1.0]]), abs=1e-12
    )
    assert state.believed_ned == pytest.approx(
        np.array([[-1.0, 0.0, 0.0], [-1.0, -1.0, 0.0]]), abs=1e-12
    )


def test_the_slot_of_who_holds_an_altitude_lies_at_it():
    """On the map it is where it was; the depth of its offset and the leader's climb are nothing."""
    flight = flying()
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 7.0], [-5.0, -5.0, 4.0]])
    for climb in (0.0, 15.0):
        flight.velocity_ned[0] = [0.0, 20.0, -climb]
        state = Slots(2).state(
            flight, flight, DIAGNOSIS, AGE_S, offsets, PLACES, np.array([60.0, np.nan])
        )
        assert state.slot_ned[0] == pytest.approx([95.0, 195.0, -60.0], abs=1e-12)
        assert state.error_ned[0] == pytest.approx([1.0, 0.0, 10.0], abs=1e-12)
    # the other's slot climbs with the leader: 25 m/s along (0, 0.8, −0.6)
    tilted = 200.0 - 5.0 * 0.8 + 4.0 * 0.6
    assert state.slot_ned[1] == pytest.approx([105.0, tilted, -50.0 + 5.0 * 0.6 + 4.0 * 0.8])


def test_a_broadcast_is_the_senders_estimate_with_euler_rates():
    state = flying()
    # a level turn at 60° of bank and 0.4 rad/s of course: p = 0, q = 0.4 sin 60°, r = 0.4 cos 60°
    state.euler[:] = [np.pi / 3.0, 0.0, 1.0]
    state.rates_body[:] = [0.0, 0.4 * np.sin(np.pi / 3.0), 0.2]
    speaker = Speaker(3)
    speaker.says(flying(), 7.0)
    said = speaker.says(state, 7.5)
    assert said.stamp_s.tolist() == [7.5, 7.5, 7.5]
    for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler"):
        assert np.array_equal(getattr(said, name), getattr(state, name))
    assert said.euler_rates == pytest.approx(np.tile([0.0, 0.0, 0.4], (3, 1)), abs=1e-15)


MUTE = int(Guard.LEADER_SILENT)


def test_silence_and_its_end_are_events_of_who_does_not_hear():
    watch = Silence(["uav1", "uav2", "uav3"], 5.0)

    def changes(now, *guards):
        events = watch.changes(
            now, np.array(guards, dtype=np.uint8), np.zeros(len(guards), dtype=bool)
        )
        return [(e.time_s, e.level, e.source, e.text) for e in events]

    lost, found = "does not hear the leader: flies on its own", "hears the leader again"
    assert changes(0.0, 0, 0, 0) == []
    # other guards are no silence
    assert changes(1.0, 7, 0, 1) == []
    assert changes(2.0, MUTE, MUTE | 4, 0) == [
        (2.0, "warning", "uav1", lost),
        (2.0, "warning", "uav2", lost),
    ]
    # said once
    assert changes(3.0, MUTE, MUTE, 0) == []
    assert changes(3.5, MUTE | 1, MUTE, 2) == []
    assert changes(4.0, MUTE, 0, MUTE) == [
        (4.0, "info", "uav2", found),
        (4.0, "warning", "uav3", lost),
    ]
    assert changes(5.0, 0, 0, 0) == [(5.0, "info", "uav1", found), (5.0, "info", "uav3", found)]
    assert changes(6.0, 0, 0, 0) == []
    # and again, as news
    assert changes(7.0, 0, MUTE, 0) == [(7.0, "warning", "uav2", lost)]


def test_a_first_message_under_way_is_no_silence_until_it_is_late():
    watch = Silence(["uav1", "uav2"], 5.0)

    def changes(now, *guards):
        return [
            (e.source, e.level)
            for e in watch.changes(
                now, np.array(guards, dtype=np.uint8), np.zeros(len(guards), dtype=bool)
            )
        ]

    assert changes(0.0, MUTE, MUTE) == []
    assert changes(0.1, 0, MUTE) == []
    assert changes(4.9, MUTE, MUTE) == [("uav1", "warning")]
    assert changes(5.0, 0, MUTE) == [("uav1", "info"), ("uav2", "warning")]


NOTHING = np.nan
ALL = np.arange(3)
LEFT_OUT, HELD = ": leaves it out", ": takes it to hold its place"


def neighbours(*changes, page="simulation-3"):
    """What is said of neighbours of simulation-3: uav2 heeds uav1, and uav3 heeds uav2."""
    world = build(load(page, ["controller.staleness.after_s=2", *changes]))
    watch = Hearing(world.names, world.groups, world.radio.ledger)
    unused, guards = np.full((3, 4), np.nan), np.zeros(3, np.uint8)

    def changes_of(now, received, rows=ALL):
        events = watch.changes(now, np.array(rows), unused, guards, np.array(received))
        return [(e.time_s, e.level, e.source, e.text) for e in events]

    return changes_of


def heard_at(now, uav2=None, uav3=None):
    """All that is heeded arrived now, but for what uav2 has of uav1, or uav3 of uav2."""
    received = np.full((3, 4), now)
    received[1, 1] = now if uav2 is None else uav2
    received[2, 2] = now if uav3 is None else uav3
    return received


@pytest.mark.parametrize(("then", "what"), [("drop", LEFT_OUT), ("hold", HELD)])
def test_a_neighbour_whose_news_is_too_old_is_an_event_of_who_heeds_it(then, what):
    changes = neighbours(f"controller.staleness.then={then}")
    assert changes(1.0, heard_at(1.0)) == []
    # exactly the limit is not too old, as in the law; nobody heeds the other links, and of the
    # leader's is told elsewhere
    assert changes(3.0, heard_at(0.5, uav2=1.0, uav3=1.0)) == []
    lost = (3.01, "warning", "uav2", f"does not hear uav1{what}")
    assert changes(3.01, heard_at(3.01, uav2=1.0)) == [lost]
    assert changes(3.05, heard_at(3.05, uav2=1.0)) == []
    assert changes(9.0, heard_at(9.0, uav2=8.5, uav3=5.0)) == [
        (9.0, "info", "uav2", "hears uav1 again"),
        (9.0, "warning", "uav3", f"does not hear uav2{what}"),
    ]
    assert changes(9.1, heard_at(9.1)) == [(9.1, "info", "uav3", "hears uav2 again")]
    # and again, as news
    assert changes(12.0, heard_at(12.0, uav2=9.9))[0][2:] == lost[2:]


def test_a_first_message_of_a_neighbour_is_missed_when_it_is_late():
    """Who was never heard has no place to hold."""
    changes = neighbours("controller.staleness.then=hold")
    assert changes(0.0, np.full((3, 4), NOTHING)) == []
    assert changes(2.0, heard_at(2.0, uav2=NOTHING)) == []
    assert changes(2.1, heard_at(2.1, uav2=NOTHING)) == [
        (2.1, "warning", "uav2", f"does not hear uav1{LEFT_OUT}")
    ]
    assert changes(2.2, heard_at(2.2)) == [(2.2, "info", "uav2", "hears uav1 again")]


def test_the_compiled_watch_over_news():
    pytest.importorskip("numba")
    rng = np.random.default_rng(11)
    heeded, found = rng.random((3, 4)) < 0.7, set()
    (received, age_s), guards = np.empty((2, 3, 4)), np.zeros(3, np.uint8)
    missed, ours, theirs = np.zeros((3, 3, 4), bool)
    ledgers = blank(3, 4), blank(3, 4)
    for rows in (np.array([0, 2]), np.array([1])):
        given = rows, age_s, guards, received, heeded, missed, 2.0
        look = READY_HEARD(ledgers[1], *given, theirs)
        for now in rng.uniform(0.0, 8.0, 200):
            lost = rng.random((2, 3, 4)) < 0.2
            received[:], age_s[:] = np.where(lost, np.nan, rng.uniform(0.0, 3.0, (2, 3, 4)))
            received[:] = now - received
            missed[:] = rng.random((3, 4)) < 0.1
            guards[:] = rng.integers(0, 256, 3) & [15, 255, 255]
            said = heard(ledgers[0], *given, ours, now)
            found.add(said)
            assert look(now) == said
            assert np.array_equal(ours, theirs)
    assert found == {0, DEAF, OVERDUE, DEAF | OVERDUE}
    assert ledgers[0].uses.any()
    for name, one, two in zip(Ledger._fields, *ledgers, strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-12, err_msg=name)


def test_who_is_watched_hears_its_leader_or_not():
    """Looked for by who steps: of a leader that nobody has ever missed nothing more is asked."""
    world = build(load("simulation-3"))
    watch = Hearing(world.names, world.groups, world.radio.ledger)
    unused, nobody = np.full((3, 4), np.nan), np.zeros(3, bool)
    guards = np.zeros(3, np.uint8)

    def said(now, *deaf):
        guards[:] = np.where(deaf, MUTE, 0)
        events = [*watch.changes(now, ALL, unused, guards, heard_at(now))]
        events += watch.silences(now, guards, nobody)
        return [(event.level, event.source) for event in events]

    assert said(1.0, False, False, False) == []
    assert said(2.0, False, True, False) == [("warning", "uav2")]
    assert said(3.0, False, True, False) == []
    assert said(4.0, False, False, False) == [("info", "uav2")]
    assert said(5.0, True, False, False) == [("warning", "uav1")]


def test_who_was_heard_only_while_the_leader_was_silent_has_no_place_to_hold():
    """uav2 hears uav1 but not its leader; uav3 hears both, at the last moment."""
    changes = neighbours("controller.staleness.then=hold", "controller.silence.after_s=4")
    for now in (0.0, 1.0, 6.0):
        received = heard_at(now)
        received[1:, 0] = NOTHING
        assert changes(now, received, [0, 1]) == []
    # exactly the limit is not too old, as in the law
    received[2, 0], received[:, 1] = 4.0, 8.0
    assert changes(8.0, received) == []
    assert changes(8.5, received) == [
        (8.5, "warning", "uav3", f"does not hear uav2{HELD}"),
    ]
    received[:, 2] = 8.5
    assert changes(11.0, received)[0] == (11.0, "warning", "uav2", f"does not hear uav1{LEFT_OUT}")
    # heard together with the leader, it has one
    assert changes(12.0, heard_at(12.0))[0][1:3] == ("info", "uav2")
    assert changes(15.0, heard_at(15.0, uav2=12.0))[0][3] == f"does not hear uav1{HELD}"


def test_only_who_steps_can_miss_a_neighbour():
    changes = neighbours()
    late = heard_at(3.0, uav2=0.5, uav3=0.5)
    assert [source for _, _, source, _ in changes(3.0, late, [1])] == ["uav2"]
    assert [source for _, _, source, _ in changes(3.01, late, [0, 2])] == ["uav3"]
    # what arrives before the next step was not missed, and is not missed any more
    assert changes(3.02, heard_at(3.02), [0]) == []
    assert changes(3.03, heard_at(3.02), [2]) == [(3.03, "info", "uav3", "hears uav2 again")]
    assert changes(3.04, heard_at(3.02), [1]) == [(3.04, "info", "uav2", "hears uav1 again")]


def test_a_law_of_ones_own_may_heed_everybody_and_nobody_knows_what_it_does():
    changes = neighbours(page="own-law-integral")
    received = heard_at(3.0)
    received[0, :] = 0.5
    assert changes(3.0, received) == [
        (3.0, "warning", "uav1", "does not hear uav2"),
        (3.0, "warning", "uav1", "does not hear uav3"),
    ]


def test_a_gust_is_told_of_once_where_it_arrives():
    arrivals = Arrivals(["front", "puff"], ["leader", "uav1"])

    def said(now, *inside):
        return [
            (event.source, event.text) for event in arrivals.changes(now, np.array(inside, bool))
        ]

    assert said(1.0, [False, False], [False, False]) == []
    assert said(2.0, [False, True], [True, True]) == [
        ("uav1", "gust front reaches it"),
        ("run", "gust puff reaches everyone"),
    ]
    assert said(3.0, [True, True], [False, False]) == [("leader", "gust front reaches it")]
    assert said(4.0, [True, True], [True, False]) == [("leader", "gust puff reaches it")]


def engaged(*distances_m, names=("uav1", "uav2"), gone=(False, False)):
    """Events of frames 1 s apart in which the followers are so far from their slots (k, n)."""
    watch = Engagement(names, 200)
    errors = np.zeros((len(distances_m), len(names), 3))
    errors[:, :, 1] = distances_m
    lost = np.array((False, *gone))  # the leader first
    return [e for k, error in enumerate(errors) for e in watch.changes(200 * k, error, lost)]


def test_a_follower_engages_once_it_has_held_its_slot_for_five_seconds():
    out, inside = 5.01, 5.0
    uav1 = [out, inside, inside, inside, inside, inside, inside, out, *[inside] * 9]
    uav2 = [inside, inside, inside, inside, inside, out, *[inside] * 11]
    told = engaged(*zip(uav1, uav2, strict=True))
    assert [(event.time_s, event.source) for event in told] == [(6.0, "uav1"), (11.0, "uav2")]
    assert [event.text.split()[-2:] for event in told] == [["1.0", "s"], ["6.0", "s"]]
    assert not engaged(*[(out, out)] * 10)


def test_who_is_lost_does_not_engage_wherever_it_lies():
    told = engaged(*[(1.0, 1.0)] * 10, gone=(True, False))
    assert [event.source for event in told] == ["uav2"]


def test_the_compiled_look_at_who_holds_a_slot():
    rng = np.random.default_rng(45)
    n, answers = 4, []
    error, gone = np.zeros((n, 3)), np.zeros(n + 1, dtype=bool)
    since, awaited = np.full((2, n), -1), np.ones(n, dtype=bool)
    look = READY_HELD(error, gone, awaited, since[1], 60.0)
    for tick in range(0, 40_000, 8):
        error[:] = rng.normal(0.0, 1.8, (n, 3))
        if tick == 20_000:
            gone[2], awaited[0] = True, False
        if tick == 36_000:
            gone[0] = True
        answers.append(held(error, gone, awaited, since[0], 60.0, tick))
        assert look(tick) == answers[-1]
        assert np.array_equal(*since)
    assert 500 < sum(answers[:4500]) < 4400
    assert not any(answers[4500:])


def test_five_seconds_are_counted_in_ticks():
    """At 25 Hz one frame in a hundred is, as a number of seconds, not 5 s after another."""
    for first in range(0, 4000, 8):
        watch, inside = Engagement(["uav1"], 200), np.zeros((1, 3))
        nobody = np.zeros(2, dtype=bool)
        assert not list(watch.changes(first, inside, nobody))
        assert list(watch.changes(first + 1000, inside, nobody))
