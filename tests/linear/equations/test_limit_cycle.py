"""Limit cycles of a bank near its limit: predicted beside flights, and by integration."""

import math

import numpy as np
import pytest
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests

from testbed.linear.held_flight import COMMANDS, HeldFlight
from testbed.linear.limit_cycle import find_limit_cycle, limit_sine
from testbed.linear.linear_formation import join
from testbed.linear.predicted_margins import linearise
from testbed.linear.steady_flight import steady_scenario
from testbed.plan.world import build
from testbed.scenario import load_scenario

ROLL = COMMANDS.index("roll")
FOLLOWER = 1  # 2 degrees below the limit of the bank
INNER = 0  # 7 degrees below it


class Turn:
    """Simulation 3 at 48 degrees of bank, where the roll command is limited to 50."""

    def __init__(self):
        scenario = load_scenario("simulation-3")
        self.flight = HeldFlight(build(steady_scenario(scenario, 45.0, "compiled")))
        self.flight.fly_to(120.0)
        self.start = self.flight.save()
        world = self.flight.world
        limit = world.formation.built_control.config.roll_limit[FOLLOWER]
        self.room_deg = math.degrees(limit - world.aircraft["control"]["roll"][1 + FOLLOWER])
        self.formation = join(linearise(self.flight))

    def bank(self, follower, commands, latency_s, kick_deg):
        """Return the bank (K,), degrees, of the last 20 of 80 s after a kick of the roll."""
        inputs = self.flight.inputs
        inputs.end()
        inputs.latency_s[follower, commands] = latency_s
        kick = np.zeros((3, 3))
        kick[follower, ROLL] = math.radians(kick_deg)
        rows = self.flight.respond(self.start, 2000, kick)
        inputs.end()
        return np.degrees(rows[-500:, follower, 0])


@pytest.fixture(scope="module")
def turn():
    """Return the turn."""
    return Turn()


def oscillation(bank, dt=0.04):
    """Return frequency and amplitude of the largest component of a bank."""
    padded = np.fft.rfft((bank - bank.mean()) * np.hanning(len(bank)), 2**16)
    largest = int(np.abs(padded).argmax())
    return largest / (2**16 * dt), 4.0 * np.abs(padded[largest]) / len(bank)


@pytest.mark.parametrize("clear", [-0.5, 0.0, 0.6, 0.95])
def test_limited_sine_by_integration(clear):
    """Mean and first harmonic of what a limit lets through."""
    found = limit_sine(clear)
    angle = (np.arange(200_000) + 0.5) * 2.0 * math.pi / 200_000
    wave = found.amplitude * np.sin(angle)
    behind = np.minimum(wave, clear * found.amplitude)  # the bias is the origin
    assert 2.0 * (behind * np.sin(angle)).mean() / found.amplitude == pytest.approx(found.gain)
    assert clear * found.amplitude - behind.mean() == pytest.approx(1.0)


def test_limit_cycle_is_that_of_a_flight(turn):
    """Late by 7 % more than it bears, the bank swings up to the limit and stays there."""
    predicted = find_limit_cycle(turn.formation, "uav2", 0.5, turn.room_deg)
    frequency, amplitude = oscillation(turn.bank(FOLLOWER, ROLL, 0.5, 20.0))
    assert predicted.frequency_hz == pytest.approx(frequency, rel=0.05)
    assert predicted.roll_deg == pytest.approx(amplitude, rel=0.15)
    # without the bias the limit would be that of a sine around zero, 50 degrees away
    unbiased = find_limit_cycle(turn.formation, "uav2", 0.5, 50.0)
    assert unbiased.roll_deg > 10.0 * amplitude


def test_limit_cycle_begins_at_the_margin(turn):
    margin = turn.formation.loop("uav2.roll").margins().latency_s
    assert find_limit_cycle(turn.formation, "uav2", 0.97 * margin, turn.room_deg) is None
    assert find_limit_cycle(turn.formation, "uav2", 1.03 * margin, turn.room_deg) is not None


def test_small_kicks_decay_and_large_ones_do_not(turn):
    """All commands late: a cycle that the describing function of the bank limit has not."""
    small, large = (
        float(np.ptp(turn.bank(INNER, slice(None), 0.18, kick_deg))) for kick_deg in (1.0, -20.0)
    )
    assert small < 0.5 and large > 15.0
