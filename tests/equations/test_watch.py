"""What the loop tells others: broadcasts of estimates, and errors of the truth."""

import numpy as np
import pytest

from testbed.formation.flags import Guard
from testbed.formation.law import Diagnosis
from testbed.sim.watch import Arrivals, Silence, broadcast, formation_state, losses
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
NOBODY = np.array([np.nan, np.nan])  # holds an altitude


def test_slots_and_errors_are_the_truths():
    # 5 m behind and 5 m right of east is west and south; 4 m down
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 4.0]])
    state = formation_state(flying(), DIAGNOSIS, AGE_S, offsets, NOBODY)
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


def test_the_slot_of_who_holds_an_altitude_lies_at_it():
    """On the map it is where it was; the depth of its offset and the leader's climb are nothing."""
    flight = flying()
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 7.0], [-5.0, -5.0, 4.0]])
    for climb in (0.0, 15.0):
        flight.velocity_ned[0] = [0.0, 20.0, -climb]
        state = formation_state(flight, DIAGNOSIS, AGE_S, offsets, np.array([60.0, np.nan]))
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
    said = broadcast(state, 7.5)
    assert said.stamp_s.tolist() == [7.5, 7.5, 7.5]
    for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler"):
        assert np.array_equal(getattr(said, name), getattr(state, name))
    assert said.euler_rates == pytest.approx(np.tile([0.0, 0.0, 0.4], (3, 1)), abs=1e-15)


def test_each_lost_aircraft_is_an_error_of_its_own():
    events = losses(3.5, np.array([False, True, True]), ["leader", "uav1", "uav2"])
    assert [(e.time_s, e.level, e.source) for e in events] == [
        (3.5, "error", "uav1"),
        (3.5, "error", "uav2"),
    ]


DEAF = int(Guard.LEADER_SILENT)


def test_silence_and_its_end_are_events_of_who_does_not_hear():
    watch = Silence(["uav1", "uav2", "uav3"], 5.0)

    def changes(now, *guards):
        events = watch.changes(now, np.array(guards, dtype=np.uint8))
        return [(e.time_s, e.level, e.source, e.text) for e in events]

    lost, found = "does not hear the leader: flies on its own", "hears the leader again"
    assert changes(0.0, 0, 0, 0) == []
    # other guards are no silence
    assert changes(1.0, 7, 0, 1) == []
    assert changes(2.0, DEAF, DEAF | 4, 0) == [
        (2.0, "warning", "uav1", lost),
        (2.0, "warning", "uav2", lost),
    ]
    # said once
    assert changes(3.0, DEAF, DEAF, 0) == []
    assert changes(3.5, DEAF | 1, DEAF, 2) == []
    assert changes(4.0, DEAF, 0, DEAF) == [
        (4.0, "info", "uav2", found),
        (4.0, "warning", "uav3", lost),
    ]
    assert changes(5.0, 0, 0, 0) == [(5.0, "info", "uav1", found), (5.0, "info", "uav3", found)]
    assert changes(6.0, 0, 0, 0) == []
    # and again, as news
    assert changes(7.0, 0, DEAF, 0) == [(7.0, "warning", "uav2", lost)]


def test_a_first_message_under_way_is_no_silence_until_it_is_late():
    watch = Silence(["uav1", "uav2"], 5.0)

    def changes(now, *guards):
        return [(e.source, e.level) for e in watch.changes(now, np.array(guards, dtype=np.uint8))]

    assert changes(0.0, DEAF, DEAF) == []
    assert changes(0.1, 0, DEAF) == []
    assert changes(4.9, DEAF, DEAF) == [("uav1", "warning")]
    assert changes(5.0, 0, DEAF) == [("uav1", "info"), ("uav2", "warning")]


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
