"""Followers with phases of their own, linearised, beside flights."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests

from testbed.linear import flown_response, follower_state, period_map, straight_formation
from testbed.linear.flown_response import fly_response
from testbed.linear.follower_state import FollowerStates
from testbed.linear.held_flight import InputChanges
from testbed.linear.linear_formation import join
from testbed.linear.predicted_margins import fly_linearisable, linearise
from testbed.linear.straight_formation import linearise_straight
from testbed.scenario import load_scenario

KICK = math.radians(0.02)


class Turn:
    """A steady turn at 25°."""

    def __init__(self, name):
        self.flight, problem = fly_linearisable(load_scenario(name), 25.0)
        assert not problem
        self.start = self.flight.save()
        self.maps = linearise(self.flight)
        self.formation = join(self.maps)

    def grows(self, follower, command, **changes):
        """Return whether a kick of a follower grows over 60 s, with a change of a command."""
        inputs, n = self.flight.inputs, len(self.maps.followers)
        kick = np.zeros((n, 3))
        kick[follower] = KICK, KICK, 2e-4
        rows = []
        for each in (kick, None):
            inputs.end()
            for name, value in changes.items():
                getattr(inputs, name)[follower, command] = value
            rows.append(self.flight.respond(self.start, round(60.0 / self.flight.dt), each))
        inputs.end()
        response = np.abs(rows[0] - rows[1])[:, follower, :2].max(axis=1)
        third, last = np.array_split(response, 4)[2:]
        return last.max() > third.max()


@pytest.fixture(scope="module")
def both():
    """Experiment 2: two followers that receive from each other, at 10 Hz with drawn phases."""
    return Turn("experiment-2")


def test_messages_are_late_by_whole_periods(both):
    """A message of the same period, or of the one before, by which of the two steps first."""
    maps = both.maps
    first, second = sorted((0, 1), key=lambda i: maps.phase_s[i])
    assert 0.0 < maps.phase_s[first] < maps.phase_s[second] < maps.dt
    apart = maps.phase_s[second] - maps.phase_s[first]
    assert maps.age_s[second, first + 1] == pytest.approx(apart)
    assert maps.age_s[first, second + 1] == pytest.approx(maps.dt - apart)
    assert maps.periods_late(second, first) == 0 and maps.periods_late(first, second) == 1
    # also where the ages alone, 0.6 and 0.4 of a period, would be the nearest to others
    ages = np.array([[np.nan, np.nan, 0.04], [np.nan, 0.06, np.nan]])
    other = replace(maps, phase_s=np.array([0.02, 0.08]), age_s=ages)
    assert other.periods_late(1, 0) == 0 and other.periods_late(0, 1) == 1


def test_axes_are_those_of_one_leader(both):
    """Each follower's period begins in the leader's frame at the leader's own control step."""
    flight = both.flight
    both.start.restore()
    states = FollowerStates(flight)
    axes, _ = states.frames()
    for group in period_map._groups(flight, both.maps.turn):
        period = period_map._Period(flight, states, group)
        assert period._from_ned == pytest.approx(axes, abs=1e-6)
        states.ahead = 0.0
        assert abs(states.frames()[0] - axes).max() > 1e-3  # the leader has turned on
        both.start.restore()
    flight.inputs.end()


MARGINS = [(follower, what) for what in ("latency_s", "gain") for follower in (0, 1)]


@pytest.mark.parametrize(("follower", "what"), MARGINS if ALL else MARGINS[:1])
def test_margins_with_phases_are_those_of_flights(both, follower, what):
    """Also of the follower whose control steps between two periods of the autopilot.

    Far above the margin both flights, with the kick and without it, end in the same limit cycle.
    """
    name = f"uav{follower + 1}"
    for command in (1, 2) if ALL else (1 + (what == "gain"),):
        loop = both.formation.loop(f"{name}.{('pitch', 'roll', 'throttle')[command]}")
        margin = getattr(loop.margins(), what)
        assert not both.grows(follower, command, **{what: 0.98 * margin})
        assert both.grows(follower, command, **{what: 1.02 * margin})


def test_phases_need_the_controls_before(both, monkeypatch):
    """Between two periods of the autopilot the surfaces are where they were: a part of the state.

    Without them the margin of the throttle would be a fifth too large.
    """
    odd = [round(100.0 * phase) % 2 for phase in both.maps.phase_s].index(1)
    numbers = follower_state._model_numbers
    monkeypatch.setattr(
        follower_state,
        "_model_numbers",
        lambda names, row, *, with_controls: numbers(names, row, with_controls=False),
    )
    both.flight.inputs.end()
    both.start.restore()
    wrong = join(linearise(both.flight)).loop(f"uav{odd + 1}.throttle").margins().gain
    assert wrong > 1.1 * both.formation.loop(f"uav{odd + 1}.throttle").margins().gain


@in_full  # as those of experiment 2, which has more followers
def test_experiment_1_has_predicted_margins():
    """A kick of the roll command decays below its margin, and grows above it."""
    turn = Turn("experiment-1")
    margin = turn.formation.loop("uav1.roll").margins().gain
    assert 4.0 < margin < 6.0
    assert not turn.grows(0, 1, gain=0.98 * margin)
    assert turn.grows(0, 1, gain=1.02 * margin)


def test_messages_that_swing_are_changed_once(monkeypatch):
    """Also those that stay in the links while others arrive, by the time of their content."""
    if not ALL:  # the integral of the course settles for longer, but hardly moves here
        for module in (flown_response, straight_formation):
            monkeypatch.setattr(module, "SETTLED_S", 45.0)
        monkeypatch.setattr(flown_response, "RECORD_S", 10.0)
    scenario, at = load_scenario("experiment-2"), np.array([0.1])
    formation = linearise_straight(scenario)
    found = formation.respond("message-right", at, 1).position[..., 1]
    flown = fly_response(scenario, "message-right", at[0], 1).response.position[..., 1]
    assert np.abs(flown - found).max() < 0.01 * np.abs(found).min()
    height = formation.respond("leader-height", at).error[..., 2]
    flown = fly_response(scenario, "leader-height", at[0]).response.error[..., 2]
    assert np.abs(flown - height).max() < 0.01 * np.abs(height).min()
    monkeypatch.setattr(InputChanges, "_as_arrived", lambda self, links: links)
    wrong = fly_response(scenario, "message-right", at[0], 1).response.position[..., 1]
    assert (np.abs(wrong) > 2.0 * np.abs(found)).all()
