"""What the loop tells others: broadcasts of estimates, and errors of the truth."""

import numpy as np
import pytest

from testbed.formation.law import Diagnosis
from testbed.sim.watch import broadcast, formation_state, losses
from testbed.state import VehicleState


def flying():
    """A leader that flies east at 20 m/s, and two followers; numbers that can be told apart."""
    vectors = np.arange(5 * 3 * 3, dtype=float).reshape(5, 3, 3)
    state = VehicleState(*vectors, np.array([20.0, 21.0, 22.0]), np.array([19.0, 20.0, 21.0]))
    state.position_ned[:] = [[100.0, 200.0, -50.0], [96.0, 195.0, -50.0], [106.0, 194.0, -47.0]]
    state.velocity_ned[:] = [[0.0, 20.0, 0.0], [12.0, 16.0, 0.0], [0.0, 3.0, -4.0]]
    return state


def test_slots_and_errors_are_the_truths():
    diagnosis = Diagnosis(
        *np.arange(8.0).reshape(4, 2),
        guards=np.array([1, 2], dtype=np.uint8),
        saturations=np.array([4, 0], dtype=np.uint8),
        age_s=np.array([[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]]),
    )
    # 5 m behind and 5 m right of east is west and south; 4 m down
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, 4.0]])
    state = formation_state(flying(), diagnosis, offsets)
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
    assert np.array_equal(state.age_s, diagnosis.age_s)


def test_a_broadcast_is_the_senders_estimate_with_euler_rates():
    state = flying()
    # a level turn at 60° of bank and 0.4 rad/s of course: p = 0, q = 0.4 sin 60°, r = 0.4 cos 60°
    state.euler[:] = [np.pi / 3.0, 0.0, 1.0]
    state.rates_body[:] = [0.0, 0.4 * np.sin(np.pi / 3.0), 0.2]
    said = broadcast(state, 7.5)
    assert said.stamp_s.tolist() == [7.5, 7.5, 7.5]
    for name in ("position_ned", "velocity_ned", "acceleration_ned"):
        assert np.array_equal(getattr(said, name), getattr(state, name))
    assert said.euler_rates == pytest.approx(np.tile([0.0, 0.0, 0.4], (3, 1)), abs=1e-15)


def test_each_lost_aircraft_is_an_error_of_its_own():
    events = losses(3.5, np.array([False, True, True]), ["leader", "uav1", "uav2"])
    assert [(e.time_s, e.level, e.source) for e in events] == [
        (3.5, "error", "uav1"),
        (3.5, "error", "uav2"),
    ]
