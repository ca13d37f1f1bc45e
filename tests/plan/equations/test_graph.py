"""Position references of the followers: A + B of the formation error, [HBH23] eq. (6)."""

import numpy as np
import pytest

from testbed.plan.fleet import solve_weights, unreachable_agents
from testbed.plan.measured_fleet import resolve
from testbed.scenario import ScenarioError, load_scenario


def build_gains(scenario):
    return solve_weights(scenario.formation, scenario.aircraft_names[1:])


def gains(n, leader=None, **edges):
    """Return β (n, n + 1, 3) from {agent: leader gain} and neighbour gains bi_j=gain."""
    out = np.zeros((n, n + 1, 3))
    for i, gain in (leader or {}).items():
        out[i, 0] = gain
    for edge, gain in edges.items():
        i, j = map(int, edge.removeprefix("b").split("_"))
        out[i, j + 1] = gain
    return out


def test_agent_without_gains_is_unreachable():
    assert unreachable_agents(gains(1)) == [0]
    assert unreachable_agents(gains(1, {0: 1.0})) == []
    assert unreachable_agents(gains(3, {0: 1.0}, b1_0=1.0)) == [2]


def test_chain_needs_a_leader_gain_at_its_start():
    assert unreachable_agents(gains(4, {0: 1.0}, b1_0=1.0, b2_1=1.0, b3_2=1.0)) == []
    # reversed, the last agent has no gain, and so no other agent has a reference
    assert unreachable_agents(gains(4, {0: 1.0}, b0_1=1.0, b1_2=1.0, b2_3=1.0)) == [0, 1, 2, 3]
    assert unreachable_agents(gains(4, {3: 1.0}, b0_1=1.0, b1_2=1.0, b2_3=1.0)) == []


def test_group_without_leader_gain_is_unreachable():
    assert unreachable_agents(gains(4, {0: 1.0}, b1_0=1.0, b2_3=1.0, b3_2=1.0)) == [2, 3]
    # an agent with gains of such a group is not fixed either, despite its leader gain
    assert unreachable_agents(gains(3, {0: 1.0}, b0_1=1.0, b1_2=1.0, b2_1=1.0)) == [0, 1, 2]


def test_random_graphs_agree_with_a_graph_search():
    """With positive gains A + B is regular if the leader reaches all agents along edges."""
    rng = np.random.default_rng(60)
    answers = set()
    for _ in range(300):
        n = int(rng.integers(1, 7))
        chosen = rng.random((n, n + 1)) < rng.uniform(0.1, 0.5)
        chosen[:, 1:][np.eye(n, dtype=bool)] = False
        reached = chosen[:, 0].copy()
        for _ in range(n):
            reached |= (chosen[:, 1:] & reached).any(axis=1)
        weights = rng.uniform(0.1, 10.0, (n, n + 1, 1)) * np.ones(3)
        found = unreachable_agents(weights * chosen[:, :, None])
        assert (found == []) == reached.all()
        # agents with gains of an unreachable one are not fixed either
        assert set(np.flatnonzero(~reached)) <= set(found)
        answers.add(found == [])
    assert answers == {True, False}


def test_magnitude_of_the_gains_does_not_matter():
    chain = gains(3, {0: 1.0}, b1_0=1.0, b2_1=1.0)
    for size in (1e-9, 1e9):
        assert unreachable_agents(size * chain) == []
        assert unreachable_agents(size * gains(3, {0: 1.0}, b2_1=1.0)) == [1, 2]


def test_each_axis_is_checked():
    flat = gains(2, {0: 1.0}, b1_0=1.0)
    flat[1, 1, 2] = 0.0
    assert unreachable_agents(flat) == [1]
    flat[1, 0, 2] = 0.5
    assert unreachable_agents(flat) == []


def test_negative_gains_may_cancel():
    # leader gain 1 and neighbour gain −1 of agent 1: its row of A + B sums to zero
    assert unreachable_agents(gains(2, {0: 1.0, 1: 1.0}, b1_0=-1.0)) == [1]
    assert unreachable_agents(gains(2, {0: 1.0, 1: 1.0}, b1_0=-0.5)) == []
    # a row with a negative diagonal: det [[1 + x, −x], [1, −1]] = −1 for any x
    assert unreachable_agents(gains(2, {0: 1.0}, b0_1=3.0, b1_0=-1.0)) == []


def test_altitude_holder_needs_no_vertical_reference():
    flat = gains(2, {0: [1.0, 1.0, 0.0]}, b1_0=[1.0, 1.0, 0.0])
    assert unreachable_agents(flat) == [0, 1]
    assert unreachable_agents(flat, np.array([True, True])) == []
    # the other agent needs one: here the neighbour at a fixed altitude
    flat[1, 1, 2] = 1.0
    assert unreachable_agents(flat, np.array([True, False])) == []
    assert unreachable_agents(flat, np.array([False, True])) == [0]
    # horizontally both need a reference
    assert unreachable_agents(gains(2, {0: 1.0}), np.array([True, True])) == [1]


def test_altitudes_of_a_scenario():
    flat = [
        "formation.leader_gains={uav1: [1, 1, 0], uav2: 1, uav3: 1}",
        "formation.neighbour_gains={}",
    ]
    with pytest.raises(ScenarioError, match="no position reference for uav1"):
        build_gains(load_scenario("simulation-3", flat))
    held = load_scenario("simulation-3", [*flat, "formation.altitudes_m={uav1: 100}"])
    assert build_gains(held).shape == (3, 4, 3)
    assert np.array_equal(resolve(held).altitudes, [100.0, np.nan, np.nan], equal_nan=True)


def test_unreachable_agent_is_an_error():
    def build(*changes):
        return build_gains(load_scenario("simulation-3", list(changes)))

    assert build().shape == (3, 4, 3)
    assert build("formation.leader_gains={uav1: 1}").shape == (3, 4, 3)
    with pytest.raises(ScenarioError, match=r"reference for uav3: A \+ B is singular"):
        build("formation.leader_gains={uav1: 1}", "formation.neighbour_gains={uav2: {uav1: 1}}")


def test_gains_of_a_scenario():
    scenario = load_scenario(
        "simulation-3",
        [
            "formation.leader_gains={uav1: [1, 2, 3], uav3: 4}",
            "formation.neighbour_gains={uav2: {uav1: 5, uav3: [6, 7, 8]}}",
        ],
    )
    expected = np.zeros((3, 4, 3))
    expected[0, 0], expected[2, 0] = [1, 2, 3], 4
    expected[1, 1], expected[1, 3] = 5, [6, 7, 8]
    assert np.array_equal(build_gains(scenario), expected)
