"""Who hangs on nothing: A + B of the formation error, [HBH23] eq. (6)."""

import numpy as np
import pytest

from testbed.scenario import ScenarioError, load
from testbed.sim.teams import cut_off, make_altitudes, make_gains


def gains(n, leader=None, **edges):
    """β (n, n + 1, 3) from {agent: gain} and i_j=gain."""
    out = np.zeros((n, n + 1, 3))
    for i, gain in (leader or {}).items():
        out[i, 0] = gain
    for edge, gain in edges.items():
        i, j = map(int, edge.removeprefix("b").split("_"))
        out[i, j + 1] = gain
    return out


def test_an_agent_that_hears_nobody_is_cut_off():
    assert cut_off(gains(1)) == [0]
    assert cut_off(gains(1, {0: 1.0})) == []
    assert cut_off(gains(3, {0: 1.0}, b1_0=1.0)) == [2]


def test_a_chain_hangs_on_its_first():
    assert cut_off(gains(4, {0: 1.0}, b1_0=1.0, b2_1=1.0, b3_2=1.0)) == []
    # turned round, the last hears nobody, and all who follow it drift along
    assert cut_off(gains(4, {0: 1.0}, b0_1=1.0, b1_2=1.0, b2_3=1.0)) == [0, 1, 2, 3]
    assert cut_off(gains(4, {3: 1.0}, b0_1=1.0, b1_2=1.0, b2_3=1.0)) == []


def test_a_group_that_hears_itself_alone_is_cut_off():
    assert cut_off(gains(4, {0: 1.0}, b1_0=1.0, b2_3=1.0, b3_2=1.0)) == [2, 3]
    # and who listens to such a group, however well it hears the leader, is not fixed either
    assert cut_off(gains(3, {0: 1.0}, b0_1=1.0, b1_2=1.0, b2_1=1.0)) == [0, 1, 2]


def test_every_agent_reachable_is_enough():
    """Random graphs of positive gains against a search along the edges."""
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
        found = cut_off(weights * chosen[:, :, None])
        assert (found == []) == reached.all()
        # whom nothing reaches is named; who hears such an agent is not fixed either
        assert set(np.flatnonzero(~reached)) <= set(found)
        answers.add(found == [])
    assert answers == {True, False}


def test_the_size_of_the_gains_does_not_matter():
    chain = gains(3, {0: 1.0}, b1_0=1.0, b2_1=1.0)
    for size in (1e-9, 1e9):
        assert cut_off(size * chain) == []
        assert cut_off(size * gains(3, {0: 1.0}, b2_1=1.0)) == [1, 2]


def test_axes_are_looked_at_one_by_one():
    flat = gains(2, {0: 1.0}, b1_0=1.0)
    flat[1, 1, 2] = 0.0
    assert cut_off(flat) == [1]
    flat[1, 0, 2] = 0.5
    assert cut_off(flat) == []


def test_signed_gains_may_cancel_and_need_not():
    # agent 1 hears the leader with 1 and agent 0 with −1: its row of A + B sums to nothing
    assert cut_off(gains(2, {0: 1.0, 1: 1.0}, b1_0=-1.0)) == [1]
    assert cut_off(gains(2, {0: 1.0, 1: 1.0}, b1_0=-0.5)) == []
    # a row with a negative diagonal: det [[1 + x, −x], [1, −1]] = −1 for any x
    assert cut_off(gains(2, {0: 1.0}, b0_1=3.0, b1_0=-1.0)) == []


def test_who_holds_an_altitude_needs_nobody_to_tell_it():
    flat = gains(2, {0: [1.0, 1.0, 0.0]}, b1_0=[1.0, 1.0, 0.0])
    assert cut_off(flat) == [0, 1]
    assert cut_off(flat, np.array([True, True])) == []
    # the other still hangs on somebody: here on one that flies at a fixed altitude
    flat[1, 1, 2] = 1.0
    assert cut_off(flat, np.array([True, False])) == []
    assert cut_off(flat, np.array([False, True])) == [0]
    # and on the map nobody is excused
    assert cut_off(gains(2, {0: 1.0}), np.array([True, True])) == [1]


def test_a_page_says_who_holds_an_altitude():
    flat = [
        "formation.leader_gains={uav1: [1, 1, 0], uav2: 1, uav3: 1}",
        "formation.neighbour_gains={}",
    ]
    with pytest.raises(ScenarioError, match=r"uav1 cannot tell"):
        make_gains(load("simulation-3", flat))
    held = load("simulation-3", [*flat, "formation.altitudes_m={uav1: 100}"])
    assert make_gains(held).shape == (3, 4, 3)
    assert np.array_equal(make_altitudes(held), [100.0, np.nan, np.nan], equal_nan=True)


def test_a_page_with_a_cut_off_agent_is_refused_by_name():
    def build(*changes):
        return make_gains(load("simulation-3", list(changes)))

    assert build().shape == (3, 4, 3)
    assert build("formation.leader_gains={uav1: 1}").shape == (3, 4, 3)
    with pytest.raises(ScenarioError, match=r"uav3 cannot tell.*A \+ B is singular"):
        build("formation.leader_gains={uav1: 1}", "formation.neighbour_gains={uav2: {uav1: 1}}")


def test_gains_of_a_page_are_put_where_they_belong():
    page = load(
        "simulation-3",
        [
            "formation.leader_gains={uav1: [1, 2, 3], uav3: 4}",
            "formation.neighbour_gains={uav2: {uav1: 5, uav3: [6, 7, 8]}}",
        ],
    )
    expected = np.zeros((3, 4, 3))
    expected[0, 0], expected[2, 0] = [1, 2, 3], 4
    expected[1, 1], expected[1, 3] = 5, [6, 7, 8]
    assert np.array_equal(make_gains(page), expected)
