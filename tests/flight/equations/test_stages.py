"""Stages of the loop: formation states of the truth and of the estimates, broadcast messages."""

import numpy as np
import pytest

from testbed.core.records import AIRCRAFT, FOLLOWER, MESSAGE, allocate
from testbed.flight.steps import write_messages
from testbed.formation.slots import write_formation_state

OFFSETS = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 4.0]])
NO_ALTITUDES = np.array([np.nan, np.nan])


def flying():
    """A leader that flies east at 20 m/s, and two followers; estimates are exact."""
    aircraft = allocate(AIRCRAFT, 3)
    for motion in (aircraft["truth"], aircraft["estimate"]):
        motion["position_ned"] = [
            [100.0, 200.0, -50.0],
            [96.0, 195.0, -50.0],
            [106.0, 194.0, -47.0],
        ]
        motion["velocity_ned"] = [[0.0, 20.0, 0.0], [12.0, 16.0, 0.0], [0.0, 3.0, -4.0]]
    return aircraft


def observed(aircraft, offsets=OFFSETS, altitudes=NO_ALTITUDES):
    followers = allocate(FOLLOWER, 2)
    write_formation_state(aircraft, followers, offsets, altitudes)
    return followers


def test_slots_and_errors_are_those_of_the_truth():
    """5 m behind and 5 m right of east is west and south; 4 m down."""
    found = observed(flying())
    assert found["slot_ned"] == pytest.approx(
        np.array([[95.0, 195.0, -50.0], [105.0, 195.0, -46.0]]), abs=1e-12
    )
    # (16): position − slot
    assert found["error_ned"] == pytest.approx(
        np.array([[1.0, 0.0, 0.0], [1.0, -1.0, -1.0]]), abs=1e-12
    )
    # the actual motion of (17), (18)
    assert found["speed"] == pytest.approx([20.0, 5.0], rel=1e-15)
    assert found["course"] == pytest.approx([np.arctan2(16.0, 12.0), np.pi / 2.0], rel=1e-15)
    assert found["flight_path_angle"] == pytest.approx([0.0, np.arctan2(4.0, 3.0)], rel=1e-15)
    assert np.array_equal(found["estimated_error_ned"], found["error_ned"])


def test_estimated_errors_are_those_of_the_estimates():
    """The leader's estimate is 2 m farther north, and uav2's 1 m lower, than they are."""
    aircraft = flying()
    aircraft["estimate"]["position_ned"][0, 0] += 2.0
    aircraft["estimate"]["position_ned"][2, 2] += 1.0
    found = observed(aircraft)
    assert found["error_ned"] == pytest.approx(
        np.array([[1.0, 0.0, 0.0], [1.0, -1.0, -1.0]]), abs=1e-12
    )
    assert found["estimated_error_ned"] == pytest.approx(
        np.array([[-1.0, 0.0, 0.0], [-1.0, -1.0, 0.0]]), abs=1e-12
    )


def test_slot_of_an_altitude_hold_lies_at_the_altitude():
    """North and east as before; the depth of its offset and the leader's climb have no effect."""
    aircraft = flying()
    offsets = OFFSETS + [[0.0, 0.0, 0.0], [0.0, 0.0, 7.0], [0.0, 0.0, 0.0]]
    for climb in (0.0, 15.0):
        aircraft["truth"]["velocity_ned"][0] = [0.0, 20.0, -climb]
        found = observed(aircraft, offsets, np.array([60.0, np.nan]))
        assert found["slot_ned"][0] == pytest.approx([95.0, 195.0, -60.0], abs=1e-12)
        assert found["error_ned"][0] == pytest.approx([1.0, 0.0, 10.0], abs=1e-12)
    # the other's slot climbs with the leader: 25 m/s along (0, 0.8, −0.6)
    tilted = 200.0 - 5.0 * 0.8 + 4.0 * 0.6
    assert found["slot_ned"][1] == pytest.approx([105.0, tilted, -50.0 + 5.0 * 0.6 + 4.0 * 0.8])


def test_a_message_is_the_estimate_with_euler_rates():
    """A level turn at 60° of bank and 0.4 rad/s of course: p = 0, q = 0.4 sin 60°, r = 0.2."""
    aircraft, messages = flying(), allocate(MESSAGE, 3)
    estimate = aircraft["estimate"]
    estimate["acceleration_ned"] = np.arange(9.0).reshape(3, 3)
    estimate["euler"] = [np.pi / 3.0, 0.0, 1.0]
    estimate["rates_body"] = [0.0, 0.4 * np.sin(np.pi / 3.0), 0.2]
    sent_s = np.zeros(3)
    write_messages(aircraft, messages, np.full(3, np.nan), sent_s, 7.5)
    assert messages["stamp_s"].tolist() == sent_s.tolist() == [7.5, 7.5, 7.5]
    for name in ("position_ned", "velocity_ned", "acceleration_ned", "euler"):
        assert np.array_equal(messages[name], estimate[name])
    assert messages["euler_rates"] == pytest.approx(np.tile([0.0, 0.0, 0.4], (3, 1)), abs=1e-15)


def test_messages_hold_the_state_when_sent():
    """3 ms and 5 ms after the estimate, positions are those along the velocity."""
    aircraft, messages = flying(), allocate(MESSAGE, 3)
    aircraft["estimate"]["velocity_ned"][0] = np.inf  # not sent later: stays as it is
    sent_s = np.zeros(3)
    write_messages(aircraft, messages, np.array([np.nan, 7.503, 7.505]), sent_s, 7.5)
    assert messages["stamp_s"].tolist() == sent_s.tolist() == [7.5, 7.503, 7.505]
    later = [[100.0, 200.0, -50.0], [96.036, 195.048, -50.0], [106.0, 194.015, -47.02]]
    assert messages["position_ned"] == pytest.approx(np.array(later), abs=1e-9)
    assert np.array_equal(messages["velocity_ned"], aircraft["estimate"]["velocity_ned"])
