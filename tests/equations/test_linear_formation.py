"""The linearised formation beside flights with small disturbances."""

import math
from dataclasses import replace

import numpy as np
import pytest

from testbed.plan.world import build
from testbed.scenario import load_scenario
from testbed.trials.held_flight import HeldFlight
from testbed.trials.linear_formation import average, join
from testbed.trials.predicted_margins import linearise
from testbed.trials.steady_flight import steady_scenario

DELAYED = ("network.delay_s=0.12",)  # three control periods
KICK = math.radians(0.01)
ROLL = 1


def begin(name, climb_mps, *overrides):
    """Return a steady turn at about 30°, and its state then."""
    scenario = load_scenario(name, list(overrides))
    flight = HeldFlight(build(steady_scenario(scenario, 30.0, "compiled", climb_mps)))
    flight.fly_to(120.0)
    return flight, flight.save()


class Linearised:
    """A steady turn."""

    def __init__(self, name, climb_mps, *overrides):
        self.flight, self.start = begin(name, climb_mps, *overrides)
        self.maps = linearise(self.flight)
        self.formation = join(self.maps)

    def respond(self, follower, periods, *, gain=1.0, latency_s=0.0):
        """Return the response (K, n, 5) of a flight to a kick of one follower."""
        inputs, n = self.flight.inputs, len(self.formation.names)
        inputs.end()
        inputs.gain[follower, ROLL], inputs.latency_s[follower, ROLL] = gain, latency_s
        still = self.flight.respond(self.start, periods)
        kick = np.zeros((n, 3))
        kick[follower, :2] = KICK
        kicked = self.flight.respond(self.start, periods, kick)
        inputs.end()
        return kicked - still


@pytest.fixture(scope="module")
def turn():
    """Return a turn of Simulation 1, in whose graph followers form circles."""
    return Linearised("simulation-1", 0.0, *DELAYED)


def predicted(formation, follower, periods):
    """Return the roll and pitch (K, n, 2) after a kick of one follower for 0.2 s."""
    state, rows = np.zeros(len(formation.a)), []
    push = formation.b_command[follower].sum(axis=0)[:, :2].sum(axis=1) * KICK
    for k in range(periods):
        rows.append(formation.c_attitude @ state)
        state = formation.a @ state + (push if k < 5 else 0.0)
    return np.array(rows)


def poles_of(a, dt):
    """Return the poles of a discrete system but those that a period forgets, 1/s."""
    values = np.linalg.eigvals(a).astype(complex)
    return np.log(values[np.abs(values) > 1e-6]) / dt


def largest_error(found, flown):
    """Return the largest error of roll and pitch of a follower, relative."""
    return np.max(np.linalg.norm(found - flown, axis=0) / np.linalg.norm(flown, axis=0))


def test_response_is_that_of_a_flight(turn):
    """Also of the followers that receive from the one that is kicked, three periods late."""
    flown = turn.respond(0, 200)[..., :2]
    found = predicted(turn.formation, 0, 200)
    for i in range(3):
        assert largest_error(found[:, i], flown[:, i]) < 0.01
    assert not found[:4, 1].any() and found[:, 1].any()


@pytest.mark.parametrize("missing", ["last fcs/elevator", "autopilot/gyro_first1", "middle loop/"])
def test_response_needs_the_whole_state(turn, missing):
    """Without some numbers of the state the response is another."""
    flown = turn.respond(0, 200)[:, 0, :2]
    a = turn.formation.a.copy()
    rows = [k for k, name in enumerate(turn.formation.labels) if f"uav1: {missing}" in name]
    assert rows
    a[rows] = 0.0
    found = predicted(replace(turn.formation, a=a), 0, 200)[:, 0]
    assert largest_error(found, flown) > 0.03


def test_response_in_a_descending_turn():
    """The propeller turns slowly, so the throttle does more than in level flight."""
    descent = Linearised("simulation-3", -2.0)
    velocity = descent.flight.world.aircraft["truth"]["velocity_ned"]
    assert np.abs(velocity[:, 2] - 2.0).max() < 0.05
    flown = descent.respond(1, 200)[:, 1, :2]
    assert largest_error(predicted(descent.formation, 1, 200)[:, 1], flown) < 0.01
    level = Linearised("simulation-3", 0.0)
    throttle = [each.formation.margins(1)[2].gain for each in (descent, level)]
    assert throttle[0] < 0.7 * throttle[1]


def test_average_has_the_poles_of_the_product(turn):
    """The maps of five periods differ by the autopilot's filters of the airspeed."""
    own = turn.maps.followers[0]
    assert len(own.a) == 5 and np.abs(own.a[0] - own.a[1]).max() > 1e-3
    whole = np.linalg.multi_dot(own.a[::-1])
    exact = poles_of(whole, 5.0 * turn.maps.dt)
    poles = poles_of(average(own).a, turn.maps.dt)
    oscillations = [pole for pole in poles if pole.imag > 0.1 and abs(pole) < 12.0]
    assert len(oscillations) >= 3
    for pole in oscillations:
        assert np.abs(exact - pole).min() < 0.01 * abs(pole)


def test_latency_margin_is_that_of_flights(turn):
    """A follower's oscillation decays below it, and grows above it."""
    margin = turn.formation.margins(0)[ROLL].latency_s
    assert 0.2 < margin < 0.8
    for factor, grows in ((0.93, False), (1.07, True)):
        response = np.abs(turn.respond(0, 500, latency_s=factor * margin)[:, 0, 0])
        assert bool(response[-100:].max() > response[150:250].max()) is grows


def test_gain_margin_is_that_of_flights(turn):
    """The same of the factor of the roll command."""
    margin = turn.formation.margins(0)[ROLL].gain
    assert 2.0 < margin < 8.0
    for factor, grows in ((0.93, False), (1.07, True)):
        response = np.abs(turn.respond(0, 500, gain=factor * margin)[:, 0, 0])
        assert bool(response[-100:].max() > response[150:250].max()) is grows


def test_phase_margin_and_distance_of_the_loop(turn):
    """At the crossing with the least phase |L| is 1; the distance is not larger than these two."""
    margins = turn.formation.margins(0)[ROLL]
    chord = 2.0 * math.sin(0.5 * math.radians(margins.phase_deg))
    assert margins.distance <= chord + 1e-3
    assert margins.distance <= 1.0 - 1.0 / margins.gain + 1e-3
