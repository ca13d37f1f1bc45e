"""Frequency responses of a chain beside flights, and what its hops pass on."""

from dataclasses import replace

import numpy as np
import pytest
from cases import ALL
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from slow_control import RATES

from testbed.core.velocity_frame import velocity_frame
from testbed.linear import flown_response, straight_formation
from testbed.linear.flown_response import fly_response
from testbed.linear.linear_formation import received
from testbed.linear.linear_system import transfer
from testbed.linear.predicted_response import (
    AXES,
    amplitudes,
    gains_per_hop,
    leader_motion,
    slot_motion,
)
from testbed.linear.steady_flight import MarginsError
from testbed.linear.straight_formation import linearise_straight
from testbed.linear.string_gain import (
    hop_gains,
    impulse_response,
    leader_growth,
    needed_share,
)
from testbed.scenario import load_scenario

LATE = ("network.delay_s=0.4",)  # several control periods
LEADER = ("leader-speed", "leader-weave", "leader-height")


@pytest.fixture(scope="module")
def scenario():
    """Return Simulation 2, a chain, with late messages."""
    return load_scenario("simulation-2", [*LATE, *RATES])


@pytest.fixture(scope="module")
def chain(scenario):
    """Return it linearised."""
    return linearise_straight(scenario)


@pytest.fixture(scope="module", params=[("leader-speed", 0.3), ("leader-weave", 0.1)], ids=str)
def flown(request, scenario):
    """Return an input, its frequency, and the response of flights."""
    name, frequency = request.param
    with pytest.MonkeyPatch.context() as patch:
        if not ALL:  # the integral of the course settles for longer, but hardly moves here
            patch.setattr(flown_response, "SETTLED_S", 45.0)
        return name, frequency, fly_response(scenario, name, frequency).response


def error_of(formation, flown):
    """Return the largest relative errors of the slot errors and the gains per hop."""
    name, frequency, response = flown
    found = amplitudes(formation.respond(name, np.array([frequency])), name, "slot-error")
    measured = amplitudes(response, name, "slot-error")
    hops = [gains_per_hop(formation.ahead(), each)[:, 1:] for each in (found, measured)]
    return np.abs(found / measured - 1.0).max(), np.abs(hops[0] / hops[1] - 1.0).max()


def test_response_is_that_of_flights(chain, flown):
    """Also its phase, of each follower and axis."""
    assert max(error_of(chain, flown)) < 0.02
    name, frequency, response = flown
    found = chain.respond(name, np.array([frequency])).error
    apart = np.linalg.norm(found - response.error, axis=-1)
    assert (apart < 0.03 * np.linalg.norm(response.error, axis=-1)).all()


def test_response_needs_the_delay_of_a_hop(chain, flown):
    """With messages of the follower ahead on time the prediction is another."""
    ages = chain.age_s.copy()
    ages[:, 1:] *= 0.0
    assert max(error_of(replace(chain, age_s=ages), flown)) > 0.05


def test_response_needs_the_acceleration_of_the_leader(chain, flown):
    """And the attitude that belongs to it."""
    maps = []
    for each in chain.maps:
        fields = "acceleration_ned", "euler", "euler_rates"
        columns = [
            k
            for k, name in enumerate(each.inputs)
            if name.startswith(tuple(f"leader.{field}." for field in fields))
        ]
        b = each.b.copy()
        b[:, columns] = 0.0
        maps.append(replace(each, b=b))
    assert max(error_of(replace(chain, maps=tuple(maps)), flown)) > 0.1


@pytest.mark.parametrize("name", LEADER)
def test_slow_leader_moves_all_as_itself(chain, name):
    """A formation follows a leader that shifts, and stays in its slots."""
    slow = chain.respond(name, np.array([1e-4]))
    assert amplitudes(slow, name, "position") == pytest.approx(1.0, abs=2e-3)
    assert amplitudes(slow, name, "slot-error") == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_slots_turn_with_the_leaders_velocity(axis):
    """By central differences of R_g υ."""
    speed, frequency, offset = 22.0, 0.2, np.array([-30.0, 12.0, 7.0])
    moved = leader_motion(axis, speed, np.array([frequency]))
    slots = slot_motion(moved, offset[np.newaxis], speed, np.array([False]))[0, 0]
    expected = np.zeros(3, dtype=complex)
    for part, factor in ((np.real, 1.0), (np.imag, 1j)):
        step = 1e-5 * part(moved[0, 3:6])
        frames = [
            velocity_frame(np.array([[speed, 0.0, 0.0]]) + sign * step)[0] for sign in (1.0, -1.0)
        ]
        expected += factor * ((frames[0] - frames[1]) @ offset) / 2e-5
    assert slots == pytest.approx(moved[0, :3] + expected, abs=1e-6)


def test_chain_passes_on_what_it_receives(chain):
    """Without gains for the leader: all of a slow deviation, and no more of a fast one."""
    for axis in range(3):
        first, *others = hop_gains(chain, axis)
        assert first is None
        for hop in others:
            assert hop.gain == pytest.approx(1.0, abs=0.01) and hop.leader_share == 0.0
            assert 1.0 - 1e-3 < hop.peak_gain < 1.1


def test_slow_errors_add_up_along_a_chain(chain):
    """The formula of `leader_growth`, from the linearised formation."""
    slow = amplitudes(
        chain.respond("leader-speed", np.array([0.002])), "leader-speed", "slot-error"
    )
    assert slow[0] / slow[0, 0] == pytest.approx(
        [leader_growth(0.0, k) for k in range(3)], rel=0.01
    )
    assert leader_growth(0.5, 50) == pytest.approx(2.0)


def test_needed_share_makes_the_gain_one():
    """The gain of a hop is (1 − share) max |M|."""
    assert needed_share(1.6) == pytest.approx(1.0 - 1.0 / 1.6)
    assert needed_share(0.98) == 0.0
    share = needed_share(1.6, growth=2.0, hops=5)
    assert ((1.0 - share) * 1.6) ** 5 == pytest.approx(2.0)


def test_impulse_response_of_a_lag():
    """A first-order lag: its impulse response sums to 1, and decays by a factor."""
    a, b, c = np.array([[0.9]]), np.array([[0.1]]), np.array([[1.0]])
    z = np.exp(1j * np.pi * np.arange(513) / 512)
    found = impulse_response(transfer(a, b, c, z)[:, 0, 0])
    assert np.abs(found).sum() == pytest.approx(1.0)
    assert found[1:20] == pytest.approx(0.1 * 0.9 ** np.arange(19), abs=1e-9)


def test_alike_followers_need_eight_maps(monkeypatch):
    """A ninth follower's map is that composed of the eight others'."""
    if not ALL:  # what integrals still move is the same for all
        monkeypatch.setattr(straight_formation, "SETTLED_S", 75.0)
    eight = straight_formation._EXAMPLES
    slot, leader, first = (-25.0, 15.0, -10.0), 1.0, 6.0
    monkeypatch.setattr(straight_formation, "_EXAMPLES", (*eight, (slot, leader, first)))
    nine = straight_formation._example(load_scenario("vee-30"))
    maps = straight_formation.linearise(straight_formation._fly_straight(nine))
    monkeypatch.setattr(straight_formation, "_EXAMPLES", eight)
    parts = straight_formation._Parts(replace(maps, followers=maps.followers[:8]))
    offsets = np.array([(0.0, 0.0, 0.0), eight[0][0], slot])
    names = [maps.followers[0].name, maps.followers[8].name]
    found = parts.compose(names, 1, offsets, np.array([leader, first, 0.0]))
    own = straight_formation._messages_of(maps)[8]
    scale = np.abs(own.a).max()
    assert np.abs(found.a - own.a).max() < 1e-3 * scale
    assert found.states == own.states and found.outputs == own.outputs
    for prefix in ("leader", received(names[1], names[0]), "wind"):
        columns, others = found.select(prefix), own.select(prefix)
        assert columns.inputs == others.inputs
        assert np.abs(columns.b - others.b).max() < 0.01 * np.abs(others.b).max()
    wrong = parts.compose(names, 1, offsets, np.array([leader + 1.0, first, 0.0]))
    assert np.abs(wrong.a - own.a).max() > np.abs(found.a - own.a).max() * 20.0


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ("fleet.uav15.aircraft=skywalker_x8", "uav15 differs from uav1"),
        ("formation.agents={uav5: {k: 2}}", "formation.agents"),
        ("formation.leader_gains={uav1: [1, 1, 0]}", "a gain of uav1 differs between the axes"),
    ],
)
def test_large_formations_are_alike(change, error):
    """Others are refused, with the key."""
    with pytest.raises(MarginsError, match=error):
        linearise_straight(load_scenario("vee-30", [change]))
