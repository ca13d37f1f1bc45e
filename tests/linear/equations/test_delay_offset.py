"""Steady slot errors by late and lost messages: predicted beside flights, and by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, some
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests

from testbed.linear import delay_flight
from testbed.linear.delay_flight import (
    fly_errors,
    message_ages,
    predict_errors,
    solve_errors,
    with_network,
)
from testbed.linear.delay_offset import SteadyMotion, ages_of_messages, steady_offsets
from testbed.linear.steady_flight import MarginsError
from testbed.plan.world import build
from testbed.scenario import load_scenario

SPEED = 22.0
TURN = SPEED / 90.0  # rad/s
CHAIN, RING = "simulation-2", "simulation-1"  # RING: neighbours receive from each other


def loaded(name, *overrides, delay_s=0.0, origin="receipt"):
    return with_network(load_scenario(name, list(overrides)), delay_s, origin)


def predicted(scenario, motion):
    return solve_errors(scenario, build(scenario), motion)


def relative(found, expected):
    """Return the largest error of a follower's offset, of its length."""
    return (np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)).max()


OFFSETS = (
    (CHAIN, 0.0, 0.13, "receipt"),
    (CHAIN, 30.0, 0.13, "receipt"),
    (CHAIN, -30.0, 0.5, "timestamp"),
    (RING, 0.0, 0.5, "receipt"),
    (RING, 30.0, 0.13, "timestamp"),
    (RING, 30.0, 0.5, "receipt"),
)


@pytest.mark.parametrize(("name", "bank_deg", "delay_s", "origin"), some(OFFSETS, 1))
def test_offset_is_that_of_a_flight(name, bank_deg, delay_s, origin):
    """Within 2 %, also after whole minutes in which the integral of the course settles."""
    scenario = loaded(name, delay_s=delay_s, origin=origin)
    flown, found = fly_errors(scenario, bank_deg), predict_errors(scenario, bank_deg)
    assert not flown.problem and not flown.note and not found.problem
    assert relative(found.error_m, flown.error_m) < 0.02


def test_offset_of_lost_messages_is_flown(monkeypatch):
    """Half of the messages lost: the frame is late, though receipt is compensated."""
    monkeypatch.setattr(delay_flight, "RANDOM_LOOK_S", 200.0)
    scenario = loaded(CHAIN, "network.loss=0.5")
    flown, found = fly_errors(scenario, 30.0), predict_errors(scenario, 30.0)
    assert relative(found.error_m, flown.error_m) < 0.08
    lossless = predict_errors(loaded(CHAIN), 30.0).error_m
    assert relative(lossless, flown.error_m) > 0.9  # the loss is what is measured


@pytest.mark.parametrize("name", [CHAIN, RING] if ALL else [RING])
def test_offset_needs_each_hop_and_the_whole_age(name):
    """Faults put back: every hop the leader's delay only; half a control period left out."""
    scenario = loaded(name, delay_s=0.13)
    flown = fly_errors(scenario, 30.0).error_m
    world = build(scenario)
    control = world.formation.built_control
    motion = delay_flight._motion(delay_flight._build(scenario, 30.0, 1.0))
    ages = message_ages(scenario, world)

    def solve(gains, used):
        law = control.controllers["law"]
        return steady_offsets(motion, law, gains, control.config.offsets, used)

    gains = control.config.gains
    assert relative(solve(gains, ages), flown) < 0.02
    direct = np.zeros_like(gains)
    direct[:, 0] = gains.sum(axis=1)  # all position feedback from the leader
    assert relative(solve(direct, ages), flown) > 0.3
    younger = replace(ages, age_s=ages.age_s - 0.02)
    assert relative(solve(gains, younger), flown) > 0.05


@pytest.mark.parametrize(("name", "hops"), [(CHAIN, (1, 2, 3)), (RING, (5, 8, 9))])
def test_straight_offsets_add_up_along_the_graph(name, hops):
    """-V d at each hop, through the means with the law's weights; climbing, too."""
    motion = SteadyMotion(SPEED, climb=2.0)
    errors = predicted(loaded(name, delay_s=0.13), motion)
    level = math.sqrt(SPEED**2 - 2.0**2)
    assert errors[:, 0] == pytest.approx(-0.13 * level * np.array(hops), rel=1e-9)
    assert errors[:, 1] == pytest.approx(np.zeros(3), abs=1e-9)
    assert errors[:, 2] == pytest.approx(0.13 * 2.0 * np.array(hops), rel=1e-9)
    compensated = predicted(loaded(name, delay_s=0.13, origin="timestamp"), motion)
    assert compensated == pytest.approx(np.zeros((3, 3)), abs=1e-9)


def test_offsets_in_a_turn_are_a_first_order_lag():
    """A place p behind the late slot follows that of the messages T: (K β + iΩ) p = K Σ β_ij T."""
    turn, delay = 0.1, 0.04  # a control period: messages are used as they arrive
    errors = predicted(loaded("simulation-3", delay_s=delay), SteadyMotion(SPEED, turn))
    pull = 3.0 / math.sqrt(50.0)  # k μ(0): ρ is linear for small errors
    turned = np.exp(-1j * turn * delay)
    slots = np.array([complex(*each) for each in ((-5, 5), (-5, -5), (-5, -5))])
    late_slots = turned * (SPEED / (1j * turn) + slots)  # from the centre of the circle
    places = [0.0]
    for i, weights in enumerate(((1.0, 0.0), (1.0, 1.0), (1.0, 1.0))):
        sent = late_slots[i - 1] * (turned - 1.0) + turned * places[-1]
        places.append(pull * weights[1] * sent / (pull * sum(weights) + 1j * turn))
    expected = late_slots * (1.0 - 1.0 / turned) + np.array(places[1:])
    found = errors[:, 0] + 1j * errors[:, 1]
    assert abs(found - expected) / abs(expected) == pytest.approx(np.zeros(3), abs=0.01)


def test_ages_follow_from_periods_and_losses():
    """A delay of 1.5 periods waits for the second step; p lost messages add p/(1-p) periods."""
    late, lossy = np.full((1, 2), 0.06), np.array([[0.0, 0.5]])
    ages = ages_of_messages(late, lossy, np.zeros((1, 2, 1)), 0.04, from_timestamp=False)
    mean = (ages.share * ages.age_s).sum(axis=-1)
    assert mean == pytest.approx(np.array([[0.08, 0.12]]), abs=1e-6)
    step = (ages.share * ages.step_s).sum(axis=-1)
    assert step == pytest.approx(mean - 0.06)
    square = (ages.share[0, 1] * (ages.age_s[0, 1] - 0.08) ** 2).sum()
    assert square == pytest.approx(0.04**2 * 0.5 * 1.5 / 0.5**2, rel=1e-4)  # p (1 + p) / (1 - p)²


@pytest.mark.parametrize(
    ("overrides", "place"),
    [
        (["network.jitter={spread_s: 0.01}", "network.delay_s=0.1"], "network.jitter"),
        (["network.loss={probability: 0.2, correlation: 0.5}"], "network.loss"),
        (["controller.companion={state_latency_s: 0.1, command_latency_s: 0}"], "companion"),
        (["formation.leader_gains.uav1=[1, 2, 1]"], "formation"),
    ],
)
def test_offset_names_what_it_cannot_predict(overrides, place):
    with pytest.raises(MarginsError, match=place):
        predict_errors(load_scenario(CHAIN, overrides), 30.0)
