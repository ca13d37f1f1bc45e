"""Agents that differ in everything the theorem lets them differ in, and gains per axis."""

import numpy as np
import pytest
from closed_loop import State, fly
from reference import formation_barrier as barrier
from reference import formation_control_function as control_function
from reference.adapters import mu
from reference.formation_laws import SpeedSet
from theorem_bounds import Envelope
from theorem_cases import (
    BARRIERS,
    FUNCTIONS,
    PATHS,
    SIMULATION_3,
    STEEPER_MU,
    at_slots,
    graph,
    one_formation,
    scattered,
)


def squadron(**changes):
    """A slow, a middling and a fast agent: every gain, function, barrier and bound differs."""
    low, high = np.array([14.0, 15.0, 17.0]), np.array([28.0, 31.0, 34.0])
    margin = np.array([0.5, 0.8, 1.5])
    formations = one_formation(
        "helix",
        gains=SIMULATION_3,
        k=np.array([2.0, 3.0, 2.5]),
        a=np.array([0.5, 1.0, 2.0]),
        b=np.array([0.2, 0.1, 0.05]),
        c=np.array([1.0, 2.0, 3.0]),
        mu=control_function.per_agent(list(FUNCTIONS.values())),
        barrier=barrier.per_agent(list(BARRIERS.values())),
    )
    return formations.change(
        pole=np.array([0.4, 0.64, 1.5]),
        speeds=SpeedSet(low, high, low + margin, high - margin),
        **changes,
    )


def test_different_agents_converge():
    """The envelope of `theorem_bounds` from 3 s on takes the least of the agents' own rates.

    The slowest is that of example 1 with ν1 = 50 m²: 2/√50 = 0.28 per second.
    """
    formations = squadron()
    start = scattered(np.random.default_rng(18), formations)
    speeds, envelope = formations.speeds, None
    times = np.concatenate([np.arange(0.0, 5.0, 0.05), np.linspace(5.0, 50.0, 451)])
    for t, state in fly(formations, start, times):
        assert ((state.s > speeds.min) & (state.s < speeds.max)).all(), t
        wanted = formations.wanted(t, state)
        assert not wanted.desired.clamped.any()
        if t >= 3.0:
            envelope = envelope or Envelope(formations, t, state)
            proved, error = envelope.advance(t), np.linalg.norm(wanted.error, axis=1)
            # steps of 0.1 s leave 3e-5 m in formation, of 0.05 s a sixteenth
            assert (error < proved + 1e-4).all(), t
    assert proved.max() < 1e-3


def test_agent_with_only_the_leader_flies_as_alone():
    """Agents that use the leader alone fly in a mixed formation as they would by themselves."""
    formations = squadron(gains=graph([1.0, 0.7, 1.3]))
    start = scattered(np.random.default_rng(19), formations)
    times = np.linspace(0.0, 6.0, 121)
    *_, (_, together) = fly(formations, start, times)
    for i in range(3):
        one = slice(i, i + 1)
        alone = formations.change(
            offsets=formations.offsets[:, one],
            gains=formations.gains[one, :2] * [[[1.0], [0.0]]],
            mu=list(FUNCTIONS.values())[i],
            barrier=list(BARRIERS.values())[i],
            speeds=SpeedSet(*(each[one] for each in formations.speeds)),
            **{name: getattr(formations, name)[one] for name in ("k", "a", "b", "c", "pole")},
        )
        *_, (_, found) = fly(alone, State(*(each[one] for each in start)), times)
        for ours, theirs in zip(found, together, strict=True):
            assert ours == pytest.approx(theirs[one], abs=1e-9)


def test_speed_pole_has_no_effect_in_continuous_time():
    """(14) cancels f = −p s and g = p: the closed loop is the same for any pole."""
    formations = squadron()
    start = scattered(np.random.default_rng(20), formations)
    times = np.linspace(0.0, 6.0, 121)
    *_, (_, first) = fly(formations, start, times)
    *_, (_, second) = fly(formations.change(pole=np.array([3.0, 0.1, 0.3])), start, times)
    for ours, theirs in zip(first, second, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-9)


def test_different_graphs_per_axis_converge():
    """β and β_ij as diagonal matrices: three graphs, of which each makes A + B nonsingular.

    The argument of `theorem_bounds` holds for components: where |q̃_i|/x_i is the largest, m, of all
    agents and axes, that component of −ξ_i is at least m, and ‖ξ_i‖² <= Σ over axes of
    (2 l − 1)² m². So without speed and direction errors ṁ <= −min k μ(‖ξ‖²)/x m, and m never
    exceeds its start.
    """
    gains = np.zeros((3, 4, 3))
    gains[0, 0] = [1.0, 0.6, 0.0]  # north, east: 1 uses the leader, ...
    gains[1, 1] = [0.5, 0.8, 0.0]  # 2 uses 1
    gains[2, 2] = [0.7, 0.4, 0.5]  # and 3 uses 2
    gains[1, 0, 2] = 0.8  # down: 2 uses the leader
    gains[0, 2, 2] = 0.9  # and 1 uses 2
    k = np.array([2.5, 3.0, 2.0])
    formations = one_formation(gains=gains, k=np.tile(k, 4), mu=STEEPER_MU, copies=4)
    climb, course_rate = np.array(list(PATHS.values())).T
    lead = formations.leader._replace(climb=climb, course_rate=course_rate)
    formations = formations.change(leader=lead)

    coupling = formations.couplings[0]  # (axis, 3, 3)
    x = np.linalg.solve(coupling, np.ones((3, 3, 1)))[..., 0].T
    reach = 2.0 * np.diagonal(coupling, axis1=1, axis2=2).T * x - 1.0
    errors = np.random.default_rng(21).uniform(-0.4, 0.4, (12, 3))

    def largest(error):
        return (abs(error).reshape(4, 3, 3) / x).max(axis=(1, 2))

    first = largest(errors)
    xi_square = (reach**2).sum(axis=1) * first[:, None] ** 2  # (4, 3)
    rate = (k * mu(formations.mu, xi_square)[0] / x.max(axis=1)).min(axis=1)
    assert (rate > 0.08).all()
    for t, state in fly(formations, at_slots(formations, errors), np.linspace(0.0, 60.0, 401)):
        measured = largest(formations.wanted(t, state).error)
        assert (measured < first * np.exp(-rate * t) + 1e-4).all(), t
    assert (first * np.exp(-rate * t) < 1e-3).all()
