"""The linearised formation beside flights with small disturbances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from scipy.signal import dlsim
from slow_control import RATES

from testbed.linear.held_flight import COMMANDS, KICK_S, HeldFlight
from testbed.linear.linear_formation import average, join
from testbed.linear.loop_margins import FREQUENCIES, MAX_GAIN, MIN_GAIN, margins_of
from testbed.linear.predicted_margins import linearise
from testbed.linear.steady_flight import steady_scenario
from testbed.plan.world import build
from testbed.scenario import load_scenario

DELAYED = ("network.delay_s=0.12",)  # three control periods
KICK = math.radians(0.01)
ROLL = 1
NAMES = ("uav1", "uav2", "uav3")


def begin(name, climb_mps, *overrides, settle_s=120.0):
    """Return a steady turn at about 30°, and its state then."""
    scenario = load_scenario(name, list(overrides))
    flight = HeldFlight(build(steady_scenario(scenario, 30.0, "compiled", climb_mps)))
    flight.fly_to(settle_s)
    return flight, flight.save()


class Linearised:
    """A steady turn."""

    def __init__(self, name, climb_mps, *overrides, settle_s=120.0):
        self.flight, self.start = begin(name, climb_mps, *overrides, settle_s=settle_s)
        self.maps = linearise(self.flight)
        self.formation = join(self.maps)

    def respond(self, follower, periods, *, command=ROLL, gain=1.0, latency_s=0.0):
        """Return the response (K, n, 5) of a flight to a kick of one follower."""
        inputs, n = self.flight.inputs, len(self.maps.followers)
        inputs.end()
        inputs.gain[follower, command], inputs.latency_s[follower, command] = gain, latency_s
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
    name = NAMES[follower]
    kicked = formation.select(
        [f"{name}.pitch", f"{name}.roll"],
        [f"{each}.attitude.{angle}" for each in NAMES for angle in ("roll", "pitch")],
    )
    inputs = np.zeros((periods, 2))
    inputs[: round(KICK_S / formation.dt)] = KICK
    _, rows, _ = dlsim(kicked.to_scipy(), inputs)
    return rows.reshape(periods, len(NAMES), 2)


def margins_of_command(formation, follower, command):
    """Return the margins of a command by its number."""
    return formation.loop(f"{NAMES[follower]}.{COMMANDS[command]}").margins()


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
    rows = [k for k, name in enumerate(turn.formation.states) if f"uav1.{missing}" in name]
    assert rows
    a[rows] = 0.0
    found = predicted(replace(turn.formation, a=a), 0, 200)[:, 0]
    assert largest_error(found, flown) > 0.03


def test_response_in_a_descending_turn():
    """The propeller turns slowly, so the throttle does more than in level flight."""
    descent = Linearised("simulation-3", -2.0, *RATES, settle_s=120.0 if ALL else 60.0)
    velocity = descent.flight.world.aircraft["truth"]["velocity_ned"]
    assert np.abs(velocity[:, 2] - 2.0).max() < 0.05
    periods = round(8.0 / descent.flight.dt)
    flown = descent.respond(1, periods)[:, 1, :2]
    assert largest_error(predicted(descent.formation, 1, periods)[:, 1], flown) < 0.01
    if ALL:  # else the response alone, which would be wrong with the level map
        level = Linearised("simulation-3", 0.0)
        throttle = [margins_of_command(each.formation, 1, 2).gain for each in (descent, level)]
        assert throttle[0] < 0.7 * throttle[1]


def test_average_has_the_poles_of_the_product(turn):
    """The maps of five periods differ by the autopilot's filters of the airspeed."""
    own = turn.maps.followers[0]
    assert len(own.a) == 5 and np.abs(own.a[0] - own.a[1]).max() > 1e-3
    whole = np.linalg.multi_dot(own.a[::-1])
    exact = poles_of(whole, 5.0 * turn.maps.dt)
    poles = poles_of(average(turn.maps, 0).a, turn.maps.dt)
    oscillations = [pole for pole in poles if pole.imag > 0.1 and abs(pole) < 12.0]
    assert len(oscillations) >= 3
    for pole in oscillations:
        assert np.abs(exact - pole).min() < 0.01 * abs(pole)


MARGINS = [(command, what) for what in ("gain", "latency_s") for command in range(3)]


@in_full  # responses of this formation, and margins of others, are compared with flights
@pytest.mark.parametrize(("command", "what"), MARGINS)
def test_margin_is_that_of_flights(turn, command, what):
    """A follower's oscillation decays below the margin of a command, and grows above it."""
    margin = getattr(margins_of_command(turn.formation, 0, command), what)
    assert 2.0 < margin < 8.0 if what == "gain" else 0.1 < margin < 0.95
    for factor, grows in ((0.93, False), (1.07, True)):
        flown = turn.respond(0, 600, command=command, **{what: factor * margin})[:, 0, :2]
        response = np.abs(flown).max(axis=1)
        assert bool(response[-150:].max() > response[200:350].max()) is grows


def test_phase_margin_and_distance_of_the_loop(turn):
    """At the crossing with the least phase |L| is 1; the distance is not larger than these two."""
    margins = margins_of_command(turn.formation, 0, ROLL)
    chord = 2.0 * math.sin(0.5 * math.radians(margins.phase_deg))
    assert margins.distance <= chord + 1e-3
    assert margins.distance <= 1.0 - 1.0 / margins.gain + 1e-3


DT = 0.04
Z = np.exp(1j * np.pi * FREQUENCIES)


@pytest.mark.parametrize("k", [0.25, 0.5, 1.5])
def test_margins_of_an_integrator_by_hand(k):
    """L = k / (z - 1): a pole leaves at z = -1, so the factor is 2 / k; |L| is 1 at 2 asin k/2."""
    margins = margins_of(k / (Z - 1.0), DT, stable=True)
    assert margins.gain == pytest.approx(2.0 / k, rel=1e-3)
    assert margins.least_gain == 0.0
    crossing = 2.0 * math.asin(0.5 * k)
    phase = 0.5 * math.pi - 0.5 * crossing
    assert margins.phase_deg == pytest.approx(math.degrees(phase), rel=1e-3)
    assert margins.latency_s == pytest.approx(phase / crossing * DT, rel=1e-3)


def conditional(k, square, real, b):
    """Return L = k (z - b) / (z² - real z + square), which is unstable open where square > 1.

    Closed, with a factor g, the product of the poles is square - g k b; a pole leaves at z = -1
    where 1 + real - g k + square - g k b is 0.
    """
    return k * (Z - b) / (Z**2 - real * Z + square)


def test_least_gain_of_a_loop_by_hand():
    """A loop that is unstable open needs a factor, and bears one: (square - 1) / k b to 6.03."""
    margins = margins_of(conditional(0.4, 1.02, 1.6, 0.5), DT, stable=True)
    assert margins.least_gain == pytest.approx(0.02 / 0.2, rel=1e-3)
    assert margins.gain == pytest.approx(3.62 / 0.6, rel=1e-3)


def test_gains_nearest_to_one_are_the_margins():
    """Of several crossings of the real axis: two of their factors below 1, two above it."""
    real = np.interp(np.arange(len(Z)), (0, 200, 600, 1200, 1800, 2999), (9, 8, 2, 0.5, 0.25, 0.2))
    turns = np.interp(np.arange(len(Z)), (0, 200, 600, 1200, 1800, 2999), (0.5, 1, 3, 5, 7, 7.5))
    margins = margins_of(real * np.exp(1j * np.pi * turns), DT, stable=True)
    assert margins.least_gain == pytest.approx(0.5, rel=1e-3)
    assert margins.gain == pytest.approx(2.0, rel=1e-3)


def test_margins_beyond_what_is_tried():
    """Neither a factor above MAX_GAIN nor one below MIN_GAIN; an unstable loop has none."""
    slow = margins_of(1.9 / MAX_GAIN / (Z - 1.0), DT, stable=True)
    assert math.isinf(slow.gain) and slow.least_gain == 0.0
    index, least = np.arange(len(Z)), 0.5 * MIN_GAIN
    size = np.interp(index, (0, 200, 210, 1200, 2999), (2.0 / least, 1.0 / least, 2.0, 0.5, 0.2))
    turns = np.interp(index, (0, 200, 210, 1200, 2999), (0.5, 1.0, 1.1, 3.0, 4.5))
    weak = margins_of(size * np.exp(1j * np.pi * turns), DT, stable=True)
    assert weak.least_gain == 0.0 and weak.gain == pytest.approx(2.0, rel=1e-3)
    unstable = margins_of(conditional(0.4, 1.02, 1.6, 0.5), DT, stable=False)
    assert unstable[:4] == (1.0, 1.0, 0.0, 0.0)
