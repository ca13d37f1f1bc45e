"""What the theorem assumes is needed: break one hypothesis, and see the claim fail."""

import closed_loop
import numpy as np
import pytest
from closed_loop import Leader, angle, fly
from reference import formation_laws as laws
from reference.formation_laws import SpeedSet
from theorem_cases import (
    BARRIERS,
    STEEPER_MU,
    at_slots,
    each,
    graph,
    one_formation,
)

from testbed.formation.barrier import NO_BARRIER, SpeedBarrier
from testbed.formation.control_function import EXAMPLE_2

ALONE = graph([1.0])
NO_GAINS = graph([0.0])


def end_of(formations, start, times):
    *_, (t, state) = fly(formations, start, times)
    return state, formations.wanted(t, state)


def test_agents_not_connected_to_leader_keep_an_error():
    """A + B singular: agents 2 and 3 use each other alone.

    Where μ = 1 and both fly as desired, the sum of their errors cannot change: 1ᵀ (A + B) = 0. So
    (O1) fails and (O2) does not; with one more link both hold.
    """
    pair = [(1, 2, 1.0), (2, 1, 1.0)]
    errors = np.array([[0.1, 0.2, -0.1], [0.3, 0.1, 0.1], [-0.1, 0.1, 0.2]])
    times = np.linspace(0.0, 10.0, 201)
    mean, nought = 0.5 * (errors[1] + errors[2]), np.zeros(3)
    for links, left in ((pair, [nought, mean, mean]), ([*pair, (1, 0, 1.0)], [nought] * 3)):
        formations = one_formation(gains=graph([1.0, 0.0, 0.0], links), mu=EXAMPLE_2)
        singular = abs(np.linalg.det(formations.couplings[0, 0])) < 1e-12
        assert singular == (links is pair)
        _, wanted = end_of(formations, at_slots(formations, errors), times)
        # the slowest rate of k (A + B) is 3·0.38 per second with the link, 3 without
        assert wanted.error == pytest.approx(np.array(left), abs=1e-5)
        assert wanted.rate.q == pytest.approx(wanted.slot_velocity, abs=1e-4)


UNCLAMPED = SpeedSet(each(16.0, 1), each(30.0, 1), each(-np.inf, 1), each(np.inf, 1))


def near_the_bound(leader_speed):
    """An agent at 28.9 m/s, 10 m behind its slot; S = (16, 30), S_d = (16.6, 29.4), k = 3."""
    formations = one_formation(
        "straight", speed=leader_speed, gains=ALONE, mu=STEEPER_MU, barrier=BARRIERS["example 4"]
    )
    north_east = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    return formations, at_slots(formations, -10.0 * north_east[None])._replace(s=each(28.9, 1))


def test_k_above_its_limit_exceeds_the_speed_set():
    """Fact 1 needs k < κ/ρ̄; here k = 3 m/s and κ = 1 m/s ask for nearly 32 m/s.

    Unclamped, D = h + (s_d − s) h' is negative and (14) slows down in order to speed up. The clamp
    keeps s in S, and the agent arrives all the same: 10 m at 0.4 m/s, then at k μ(0) = 1.5 per
    second.
    """
    formations, start = near_the_bound(29.0)
    unclamped = formations.change(speeds=UNCLAMPED).wanted(0.0, start)
    assert unclamped.desired.speed[0] > 31.5
    assert unclamped.rate.s[0] < 0.0
    clamped = formations.wanted(0.0, start)
    assert clamped.desired.clamped.all()
    assert clamped.desired.speed[0] == pytest.approx(29.4)
    assert clamped.rate.s[0] > 0.0
    flight = list(fly(formations, start, np.linspace(0.0, 40.0, 301)))
    assert all(16.0 < state.s[0] < 30.0 for _, state in flight)
    assert np.linalg.norm(formations.wanted(*flight[-1]).error) < 1e-3


def test_leader_faster_than_s_is_not_followed():
    """Assumption 1: at 31 m/s the error grows at 31 − 29.4 m/s, what is left to the clamp."""
    formations, start = near_the_bound(31.0)
    flight = list(fly(formations, start, np.linspace(0.0, 30.0, 151)))
    distance = [np.linalg.norm(formations.wanted(*flight[i]).error) for i in (100, 150)]
    assert distance[1] - distance[0] == pytest.approx(1.6 * 10.0, rel=1e-3)
    assert all(16.0 < state.s[0] < 30.0 for _, state in flight)


class Surging(Leader):
    """A leader that flies north at 23 + 4 sin(1.5 t) m/s."""

    def motion(self, t):
        along = np.array([[1.0, 0.0, 0.0]])
        where = 23.0 * t - 4.0 / 1.5 * (np.cos(1.5 * t) - 1.0)
        return where * along, (23.0 + 4.0 * np.sin(1.5 * t)) * along, 6.0 * np.cos(1.5 * t) * along


def surging(barrier):
    formations = one_formation("straight", gains=NO_GAINS, a=0.2, b=0.0, barrier=barrier)
    formations = formations.change(leader=Surging(*formations.leader))
    return formations, at_slots(formations, np.zeros((1, 3)))._replace(s=each(29.5, 1))


def test_without_barrier_a_speed_leaves_s():
    """h = 1 and b = 0: s = s_d + s̃(0) exp(−a t), which is 32 m/s where s_d has risen to 27.

    With any of the three barriers, what was above s_d is kept below the bound.
    """
    times = np.linspace(0.0, 3.0, 101)
    formations, start = surging(SpeedBarrier(NO_BARRIER, 0.0))
    fastest = 0.0
    for t, state in fly(formations, start, times):
        expected = 23.0 + 4.0 * np.sin(1.5 * t) + 6.5 * np.exp(-0.2 * t)
        assert state.s[0] == pytest.approx(expected, abs=1e-6)
        fastest = max(fastest, state.s[0])
    assert fastest > 32.0
    for barrier in BARRIERS.values():
        formations, start = surging(barrier)
        assert max(state.s[0] for _, state in fly(formations, start, times)) < 30.0


def steep(barrier, s, low, high):
    """Positive inside S alone, but rising so steeply about 23 m/s that (B5) fails there."""
    parabola, slope = (high - s) * (s - low), high + low - 2.0 * s
    step = 1.0 / (1.0 + np.exp(-4.0 * (s - 23.0)))
    return (0.05 + step) * parabola, (0.05 + step) * slope + 4.0 * step * (1.0 - step) * parabola


def test_barrier_without_b5_leaves_the_desired_speed(monkeypatch):
    """(B5) keeps D = h + (s_d − s) h' positive: where it is not, (14) points the wrong way."""
    formations = one_formation(
        "straight", speed=19.0, gains=NO_GAINS, barrier=BARRIERS["example 4"]
    )
    start = at_slots(formations, np.zeros((1, 3)))._replace(s=each(22.8, 1))
    times = np.linspace(0.0, 0.5, 51)
    good, _ = end_of(formations, start, times)
    assert 19.0 < good.s[0] < 22.0

    def rate(self, t, state):
        """No barrier of the kernels breaks it: the reference takes any."""
        wanted, gains = self.wanted(t, state), (self.a, self.b, self.pole)
        u, _ = laws.speed_control(state.s, wanted.desired, *gains, self.barrier, self.speeds)
        return wanted.rate._replace(s=self.pole * (u - state.s))

    monkeypatch.setattr(closed_loop.Formations, "rate", rate)
    assert np.array_equal(end_of(formations, start, times)[0].s, good.s)
    monkeypatch.setattr(laws, "h", steep)
    s = np.linspace(16.1, 29.9, 139)
    height, slope = steep(None, s, 16.0, 30.0)
    assert (height > 0.0).all()  # (B1)
    assert (height + (19.0 - s) * slope).min() < 0.0
    bad, _ = end_of(formations, start, times)
    assert bad.s[0] > 22.9


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
def test_without_b_a_speed_outside_s_is_constant(barrier):
    """(A5): ḣ = b s̃². Statement v) needs b > 0."""
    formations = one_formation("straight", gains=ALONE, b=0.0, barrier=barrier)
    start = at_slots(formations, np.zeros((1, 3)))._replace(s=each(31.0, 1))
    state, _ = end_of(formations, start, np.linspace(0.0, 5.0, 26))
    assert state.s[0] == pytest.approx(31.0, abs=1e-12)


class Unannounced(Leader):
    """A leader whose q̈_g is not broadcast: taken as zero."""

    def motion(self, t):
        position, velocity, acceleration = super().motion(t)
        return position, velocity, 0.0 * acceleration


def test_without_leader_acceleration_an_error_remains():
    """On a circle y then lags by θ with c s_d sin θ = n_dᵀ q̈_g, n_d to the right of y_d.

    (15) turns y at c sin θ + n_dᵀ ẏ_d in the plane, with what it takes for ẏ_d; that is short of
    the truth by q̈_g/s_d, and both turn at the same rate in the end.
    """
    formations = one_formation("circle", gains=ALONE, mu=STEEPER_MU, c=3.0, offsets=[[0, 0, 0]])
    start = at_slots(formations, np.zeros((1, 3)))
    times = np.linspace(0.0, 15.0, 151)
    state, wanted = end_of(formations, start, times)
    assert np.linalg.norm(wanted.error) < 1e-4
    unannounced = formations.change(leader=Unannounced(*formations.leader))
    state, wanted = end_of(unannounced, start, times)
    _, _, acceleration = formations.leader.motion(times[-1])
    right = np.cross([0.0, 0.0, 1.0], wanted.desired.direction[0])
    pull = 3.0 * wanted.desired.speed[0] * np.sin(angle(state.y, wanted.desired.direction)[0])
    assert pull == pytest.approx(right @ acceleration[0], rel=1e-4)
    assert pull > 3.0
    assert np.linalg.norm(wanted.error) > 0.5
