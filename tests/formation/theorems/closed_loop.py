"""The control law (5)-(15) around the extended unicycle (1)-(4), in continuous time.

Many formations fly at once: M formations of n agents are M n agents on the leading axis, those of
one formation next to each other. The controller is the product's kernels; only the integrator is
the tests' own: classical Runge-Kutta of order 4, with the law evaluated at every stage.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from reference.adapters import follow, follower_records, frame_rate, h, velocity_frame
from reference.adapters import slot_motions as slots
from reference.formation_laws import Desired, SpeedSet

from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import ControlFunction


class State(NamedTuple):
    """Agents: position (N, 3) m, direction of flight (N, 3), speed (N,) m/s."""

    q: np.ndarray
    y: np.ndarray
    s: np.ndarray


class Leader(NamedTuple):
    """M virtual leaders on straight lines, circles and helices: s_g, γ_g and σ̇_g are constant."""

    origin: np.ndarray  # (M, 3) m
    speed: np.ndarray  # (M,) m/s
    climb: np.ndarray  # (M,) rad
    course: np.ndarray  # (M,) rad, at t = 0
    course_rate: np.ndarray  # (M,) rad/s

    def motion(self, t):
        """q_g, q̇_g and q̈_g (M, 3) in closed form."""
        turned = self.course_rate * t
        level = self.speed * np.cos(self.climb)
        # the chord of an arc: its length times sinc of half its angle, along the mean course
        chord = level * t * np.sinc(turned / (2.0 * np.pi))
        mean, now = self.course + turned / 2.0, self.course + turned
        sink, zero = -self.speed * np.sin(self.climb), np.zeros_like(level)
        position = self.origin + np.stack([chord * np.cos(mean), chord * np.sin(mean), sink * t], 1)
        velocity = np.stack([level * np.cos(now), level * np.sin(now), sink], 1)
        pull = level * self.course_rate
        acceleration = np.stack([-pull * np.sin(now), pull * np.cos(now), zero], 1)
        return position, velocity, acceleration

    def turn(self, t):
        """ω_g and ω̇_g (M, 3) in the leader's frame."""
        rate = frame_rate(self.climb, self.course_rate, np.zeros_like(self.climb))
        return rate, np.zeros_like(rate)


class Wanted(NamedTuple):
    """What the law makes of a state, and what it answers."""

    error: np.ndarray  # q̃ (N, 3), eq. (16)
    xi: np.ndarray  # ξ (N, 3), eq. (6)
    desired: Desired
    slot_velocity: np.ndarray  # q̇_g + χ̇ (N, 3)
    u: np.ndarray  # (N,) m/s
    omega: np.ndarray  # ω (N, 3) rad/s in the zero-roll velocity frame
    rate: State  # q̇, ẏ, ṡ


@dataclass(frozen=True, eq=False)
class Formations:
    """M formations of n agents; every array of agents has the leading axis N = M n."""

    leader: Leader
    offsets: np.ndarray  # υ (M, n, 3) m in the leader's frame
    gains: np.ndarray  # (N, n + 1, 3) β_i, then β_ij, per axis of NED
    k: np.ndarray  # (N,)
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    pole: np.ndarray
    mu: ControlFunction
    barrier: SpeedBarrier
    speeds: SpeedSet

    def change(self, **fields):
        return replace(self, **fields)

    @lru_cache(maxsize=3)  # noqa: B019 - the times of one step, which stages and looks share
    def targets(self, t):
        """What leader and slots do at the time t: q_g, q̇_g, q̈_g, ω_g; χ, χ̇, χ̈ (M, n, 3)."""
        motion = self.leader.motion(t)
        rate, acceleration = self.leader.turn(t)
        # slots are linear in the offset: those of the unit offsets give all
        units = slots(velocity_frame(motion[1]), rate, acceleration, np.eye(3))
        return np.stack([*motion, rate]), np.stack([self.offsets @ each for each in units])

    @cached_property
    def records(self):
        """What the kernels know of the agents."""
        return follower_records(self)

    def follow(self, t, state):
        """What the kernels compute at one state, and its rate."""
        velocity = state.s[:, None] * state.y
        found = follow(self.records, *self.targets(t), state.q, velocity, state.s)
        return found, State(velocity, found["y_rate"], self.pole * (found["u"] - state.s))

    def wanted(self, t, state):
        """The law and the model (1)-(4) with f = −p s, g = p, at one state."""
        (q_g, v_g, *_), (chi, chi_rate, _) = self.targets(t)
        found, rate = self.follow(t, state)
        return Wanted(
            error=state.q - (q_g[:, None] + chi).reshape(-1, 3),
            xi=found["xi"],
            desired=Desired(*(found[name] for name in Desired._fields)),
            slot_velocity=(v_g[:, None] + chi_rate).reshape(-1, 3),
            u=found["u"],
            omega=found["omega"],
            rate=rate,
        )

    def rate(self, t, state):
        return self.follow(t, state)[1]

    def h(self, s):
        return h(self.barrier, s, self.speeds.min, self.speeds.max)[0]

    @property
    def h_top(self):
        """h̄ (N,), (A4): every example is largest midway between the bounds."""
        return self.h(0.5 * (self.speeds.min + self.speeds.max))

    @property
    def margin(self):
        """ε (N,)."""
        return self.speeds.desired_min - self.speeds.min

    @property
    def couplings(self):
        """A + B for each formation and axis of NED (M, 3, n, n)."""
        m, n = self.offsets.shape[:2]
        beta = self.gains.reshape(m, n, n + 1, 3)
        out = -np.moveaxis(beta[:, :, 1:], 3, 1)
        diagonal = np.arange(n)
        out[:, :, diagonal, diagonal] = np.moveaxis(beta.sum(axis=2), 2, 1)
        return out


def moved(state, rate, dt):
    return State(*(x + dt * x_rate for x, x_rate in zip(state, rate, strict=True)))


def runge_kutta(field, t, state, dt):
    """One classical step of a state; directions are put back on the sphere."""
    one = field(t, state)
    two = field(t + 0.5 * dt, moved(state, one, 0.5 * dt))
    three = field(t + 0.5 * dt, moved(state, two, 0.5 * dt))
    four = field(t + dt, moved(state, three, dt))
    stages = zip(one, two, three, four, strict=True)
    mean = State(*((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in stages))
    q, y, s = moved(state, mean, dt)
    return State(q, y / np.linalg.norm(y, axis=1, keepdims=True), s)


def fly(formations, state, times):
    """The states at the times (T,) s, one step from each to the next; the first is the start."""
    yield times[0], state
    for start, end in zip(times[:-1], times[1:], strict=True):
        state = runge_kutta(formations.rate, start, state, end - start)
        yield end, state


def angle(y, y_d):
    """θ (N,) rad between unit vectors, exact near 0 and near π."""
    return 2.0 * np.arctan2(np.linalg.norm(y - y_d, axis=1), np.linalg.norm(y + y_d, axis=1))


def halved(times):
    """The same times with one more midway between each two."""
    return np.sort(np.concatenate([times, 0.5 * (times[1:] + times[:-1])]))
