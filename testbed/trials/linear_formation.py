"""A formation in steady flight as one linear, time-invariant, discrete system.

The maps of the control periods (`period_map`) are averaged over the periods after which the flight
repeats, and joined by the messages of the scenario's graph, each as many control periods old as in
the flight. The average stands for filters that step in some periods only; tests compare its
eigenvalues with those of the product of the maps, which is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur
from scipy.sparse.csgraph import connected_components

from testbed.core.records import Array, BoolArray
from testbed.trials.follower_state import about_vertical
from testbed.trials.period_map import FollowerMap, PeriodMaps

_NEGLIGIBLE = 1e-9  # elements of matrices
_VANISHED = 1e-6  # eigenvalues of what a period forgets
# 1/s; slower poles are those of the position on the round Earth
SLOWEST = 1e-3
MESSAGE_SIZE = 9  # of a follower
MAX_GAIN, MIN_GAIN, MAX_LATENCY_S = 10.0, 0.001, 1.0  # that are tried
_STEPS = 20  # upwards, to the first value at which something grows
_BISECTIONS = 12


class Mode(NamedTuple):
    """An oscillation, or an exponential where the frequency is zero.

    Attributes:
        frequency_hz: of its zero crossings, as that of `Oscillation`.
        damping: ratio; 1 or -1 for an exponential.
        pole: 1/s.
        follower: with the largest share in it.
        motion: of that follower, mostly: "bank", "pitch", "speed" or "height".
    """

    frequency_hz: float
    damping: float
    pole: complex
    follower: str
    motion: str


class CommandMargins(NamedTuple):
    """How much one command of one follower can change; nothing where the flight is unstable.

    Attributes:
        gain: largest factor; inf: none found.
        least_gain: smallest factor; 0: none needed.
        latency_s: largest additional latency; inf: none found.
        phase_deg: at the crossing with the least; inf: the loop crosses 1 nowhere.
        distance: least of |1 + L|.
    """

    gain: float
    least_gain: float
    latency_s: float
    phase_deg: float
    distance: float


@dataclass(frozen=True, slots=True)
class LinearFollower:
    """One follower, averaged, without the states that nothing reads."""

    name: str
    labels: tuple[str, ...]  # (S,)
    a: Array  # (S, S)
    b_command: Array  # (Q, S, 3)
    c_command: Array  # (3, S)
    b_wind: Array  # (S, 3)
    b_message: dict[int, Array]  # by the sender's row, (S, M)
    d_message: dict[int, Array]  # (3, M)
    c_message: Array  # (9, S)
    c_error: Array  # (3, S)
    c_attitude: Array  # (2, S)


def average(follower: FollowerMap) -> LinearFollower:
    """Average the maps of a follower, and leave out the states that nothing reads."""
    a = follower.a.mean(axis=0)
    command, output = follower.c_command.mean(axis=0), follower.c_output.mean(axis=0)
    kept = _read_states(a, np.vstack((command, output)))
    message, error, attitude = np.split(output[:, kept], (MESSAGE_SIZE, MESSAGE_SIZE + 3))
    return LinearFollower(
        follower.name,
        tuple(np.array(follower.labels)[kept].tolist()),
        a[np.ix_(kept, kept)],
        follower.b_command.mean(axis=0)[:, kept],
        command[:, kept],
        follower.b_wind.mean(axis=0)[kept],
        {j: each.mean(axis=0)[kept] for j, each in follower.b_message.items()},
        {j: each.mean(axis=0) for j, each in follower.d_message.items()},
        message,
        error,
        attitude,
    )


def _read_states(a: Array, outputs: Array) -> BoolArray:
    """Return which states (S,) reach an output."""
    reads, kept = np.abs(a) > _NEGLIGIBLE, (np.abs(outputs) > _NEGLIGIBLE).any(axis=0)
    count = -1
    while count != int(np.count_nonzero(kept)):
        count = int(np.count_nonzero(kept))
        kept = np.logical_or(kept, reads[kept].any(axis=0))
    return np.asarray(kept)


@dataclass(frozen=True, slots=True)
class LinearFormation:
    """The followers of a formation with their messages.

    Attributes:
        dt: s, control period.
        speed: m/s, of the leader over the ground.
        names: of the n followers.
        a: (S, S) of the states of all followers, then of the messages under way.
        b_command: (n, Q, S, 3).
        c_command: (n, 3, S).
        b_wind: (S, 3) of a uniform wind.
        b_leader: (S, 15) of the leader's message, as used.
        d_leader: (n, 3, 15) to the commands.
        c_error: (n, 3, S).
        c_attitude: (n, 2, S).
        owners: (S,) rows of the followers, those of the senders of messages.
        loops: (n,) number of the set of followers that influence each other, through others too.
        labels: (S,).
    """

    dt: float
    speed: float
    names: tuple[str, ...]
    a: Array
    b_command: Array
    c_command: Array
    b_wind: Array
    b_leader: Array
    d_leader: Array
    c_error: Array
    c_attitude: Array
    owners: Array
    loops: Array
    labels: tuple[str, ...]

    def of(self, follower: int) -> LinearFormation:
        """Return the followers that influence each other with one of them, by themselves."""
        own = self.loops[self.owners] == self.loops[follower]
        rows = np.flatnonzero(self.loops == self.loops[follower])
        number = np.cumsum(self.loops == self.loops[follower]) - 1
        return LinearFormation(
            self.dt,
            self.speed,
            tuple(self.names[i] for i in rows),
            self.a[np.ix_(own, own)],
            self.b_command[rows][:, :, own],
            self.c_command[rows][..., own],
            self.b_wind[own],
            self.b_leader[own],
            self.d_leader[rows],
            self.c_error[rows][..., own],
            self.c_attitude[rows][..., own],
            number[self.owners[own]],
            self.loops[rows],
            tuple(np.array(self.labels)[own].tolist()),
        )

    def modes(self) -> list[Mode]:
        """Return the modes, the least damped first; slower ones than SLOWEST are left out."""
        values, vectors = np.linalg.eig(self.a)
        left = np.linalg.pinv(vectors)
        found = []
        for k in np.flatnonzero(np.abs(values) > _VANISHED):
            pole = complex(np.log(complex(values[k]))) / self.dt
            if abs(pole) < SLOWEST or pole.imag < 0.0:
                continue
            share = np.abs(vectors[:, k] * left[k])
            by_owner = [share[self.owners == i].sum() for i in range(len(self.names))]
            follower = int(np.argmax(by_owner))
            found.append(
                Mode(
                    pole.imag / (2.0 * math.pi) if pole.imag > 1e-9 else 0.0,
                    -pole.real / abs(pole),
                    pole,
                    self.names[follower],
                    self._motion(follower, vectors[:, k], abs(pole)),
                )
            )
        return sorted(found, key=lambda mode: mode.damping)

    def _motion(self, follower: int, vector: Array, rate: float) -> str:
        """Return in what a follower moves most: angles, and velocities over its speed.

        Args:
            follower: 0..n-1.
            vector: (S,) of the mode.
            rate: its magnitude, 1/s.
        """
        roll, pitch = np.abs(self.c_attitude[follower] @ vector)
        forward, _, down = np.abs(self.c_error[follower] @ vector) * rate / self.speed
        parts = {"bank": roll, "pitch": pitch, "speed": forward, "height": down}
        return max(parts, key=lambda name: parts[name])

    def is_stable(self, a: Array | None = None) -> bool:
        """Return whether nothing grows."""
        values = np.abs(np.linalg.eigvals(self.a if a is None else a))
        return bool(values.max() < math.exp(SLOWEST * self.dt))

    def margins(self, follower: int, command: int) -> CommandMargins:
        """Return the margins of one command of one follower.

        Args:
            follower: 0..n-1.
            command: row of COMMANDS.
        """
        own = self.of(follower)  # others cannot destabilise it
        at = own.names.index(self.names[follower])
        a, b, c = own.a, own.b_command[at, ..., command], own.c_command[at, command]
        whole = b.sum(axis=0)

        def with_gain(factor: float) -> bool:
            return self.is_stable(a + (factor - 1.0) * np.outer(whole, c))

        frequency = np.geomspace(0.01, 0.5 / self.dt, 3000)
        loop = own.open_loop(at, command, frequency)
        distance = float(np.abs(1.0 + loop).min())
        if not self.is_stable(a):
            return CommandMargins(1.0, 1.0, 0.0, 0.0, distance)
        gain = _largest(with_gain, 1.0, MAX_GAIN)
        least = 1.0 / _largest(lambda by: with_gain(1.0 / by), 1.0, 1.0 / MIN_GAIN)
        latency = _largest(
            lambda late: self.is_stable(self._late(a, b, c, late)), 0.0, MAX_LATENCY_S
        )
        return CommandMargins(gain, least, latency, _phase_margin_deg(loop), distance)

    def open_loop(self, follower: int, command: int, frequency_hz: Array) -> Array:
        """Return L at frequencies (F,): from a command given to minus that computed."""
        b = self.b_command[follower, ..., command].sum(axis=0)
        c = self.c_command[follower, command]
        z = np.exp(2j * np.pi * np.asarray(frequency_hz) * self.dt)
        loop: Array = -transfer(self.a - np.outer(b, c), b[:, np.newaxis], c, z)[:, 0]
        return loop

    def _late(self, closed: Array, b: Array, c: Array, latency_s: float) -> Array:
        """Return the system with one command late.

        As the autopilots take it: in each of their Q periods the command of so many periods before,
        between two of them in proportion.

        Args:
            closed: (S, S) without latency.
            b: (Q, S) of the command in each period of the autopilot.
            c: (S,) the command computed.
            latency_s: additional.
        """
        parts, size = b.shape
        periods = latency_s * parts / self.dt
        whole = math.floor(periods)
        shares = {whole: 1.0 - (periods - whole), whole + 1: periods - whole}
        # control periods before, of the command in part q with a delay of k parts
        needed = math.ceil((whole + 1) / parts)
        a = np.zeros((size + needed, size + needed))
        a[:size, :size] = closed - np.outer(b.sum(axis=0), c)
        for q in range(parts):
            for k, share in shares.items():
                before = math.ceil((k - q) / parts) if k > q else 0
                if before == 0:
                    a[:size, :size] += share * np.outer(b[q], c)
                elif share:
                    a[:size, size + before - 1] += share * b[q]
        if needed:
            a[size, :size] = c
            for k in range(1, needed):
                a[size + k, size + k - 1] = 1.0
        return a


def transfer(a: Array, b: Array, c: Array, z: Array) -> Array:
    """Return c (z − a)⁻¹ b.

    Args:
        a: (S, S).
        b: (S, M).
        c: (P, S), or (S,).
        z: (F,).

    Returns:
        (F, P, M), or (F, M).
    """
    # by a triangular matrix: messages under way have no eigenvectors
    triangle, unitary = schur(a, output="complex")
    into = unitary.conj().T @ b
    states = np.zeros((len(z), *into.shape), dtype=complex)
    for k in range(len(a) - 1, -1, -1):
        later = triangle[k, k + 1 :] @ states[:, k + 1 :]
        states[:, k] = (into[k] + later) / (z - triangle[k, k])[:, np.newaxis]
    response: Array = (c @ unitary) @ states
    return response


def join(maps: PeriodMaps) -> LinearFormation:
    """Join the followers of a formation by their messages.

    Args:
        maps: of their control periods.
    """
    followers = [average(each) for each in maps.followers]
    n = len(followers)
    first = np.concatenate(([0], np.cumsum([len(each.labels) for each in followers])))
    ages = np.zeros((n, n + 1), dtype=int)
    for i, each in enumerate(followers):
        for j in each.b_message:
            ages[i, j] = round(float(np.nan_to_num(maps.age_s[i, j])) / maps.dt)
    history = [int(ages[:, j + 1].max(initial=0)) for j in range(n)]
    starts = first[-1] + np.concatenate(([0], np.cumsum(MESSAGE_SIZE * np.array(history))))
    size = int(starts[-1])
    turned = np.kron(np.eye(3), about_vertical(maps.turn))
    a, b_command = np.zeros((size, size)), np.zeros((n, *followers[0].b_command.shape[:1], size, 3))
    c_command, c_error = np.zeros((n, 3, size)), np.zeros((n, 3, size))
    c_attitude = np.zeros((n, 2, size))
    b_wind = np.zeros((size, 3))
    b_leader, d_leader = np.zeros((size, 15)), np.zeros((n, 3, 15))
    for i, each in enumerate(followers):
        own = slice(first[i], first[i + 1])
        a[own, own] = each.a
        b_wind[own] = each.b_wind
        b_command[i][:, own] = each.b_command
        c_command[i][:, own], c_error[i][:, own] = each.c_command, each.c_error
        c_attitude[i][:, own] = each.c_attitude
        for j in each.b_message:
            if j == 0:
                b_leader[own], d_leader[i] = each.b_message[j], each.d_message[j]
                continue
            b, d = each.b_message[j], each.d_message[j]
            sender = slice(first[j - 1], first[j])
            if ages[i, j] == 0:
                a[own, sender] += b @ followers[j - 1].c_message
                c_command[i][:, sender] += d @ followers[j - 1].c_message
            else:
                at = starts[j - 1] + MESSAGE_SIZE * (ages[i, j] - 1)
                sent = slice(at, at + MESSAGE_SIZE)
                a[own, sent] += b
                c_command[i][:, sent] += d
    for j in range(n):
        for k in range(history[j]):
            at = starts[j] + MESSAGE_SIZE * k
            to = slice(at, at + MESSAGE_SIZE)
            if k == 0:
                a[to, first[j] : first[j + 1]] = turned @ followers[j].c_message
            else:
                a[to, at - MESSAGE_SIZE : at] = turned
    owners = np.concatenate(
        [np.full(len(each.labels), i) for i, each in enumerate(followers)]
        + [np.full(MESSAGE_SIZE * count, j) for j, count in enumerate(history)]
    )
    labels = [f"{each.name}: {label}" for each in followers for label in each.labels]
    labels += ["message"] * (size - int(first[-1]))
    names = tuple(each.name for each in followers)
    return LinearFormation(
        *(maps.dt, maps.speed, names, a, b_command, c_command, b_wind, b_leader, d_leader),
        *(c_error, c_attitude, owners, loops_of(followers), tuple(labels)),
    )


def loops_of(followers: list[LinearFollower]) -> Array:
    """Return for each follower the number of the set of those that influence each other."""
    n = len(followers)
    reads = np.zeros((n, n))
    for i, each in enumerate(followers):
        reads[i, [j - 1 for j in each.b_message if j]] = 1.0
    found: Array = connected_components(reads, connection="strong")[1]
    return found


def _largest(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return the largest value up to which something holds; inf: at all that are tried.

    It holds at `low`. Steps upwards come before a bisection: it may hold again beyond.
    """
    for step in np.linspace(low, high, _STEPS + 1)[1:].tolist():
        if not holds(step):
            high = step
            break
        low = step
    else:
        return math.inf
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _phase_margin_deg(loop: Array) -> float:
    """Return the least angle to -1 where |L| crosses 1."""
    magnitude = np.abs(loop)
    crossing = np.flatnonzero((magnitude[:-1] - 1.0) * (magnitude[1:] - 1.0) < 0.0)
    if not len(crossing):
        return math.inf
    return float(np.degrees(np.abs(np.angle(-loop[crossing]))).min())
