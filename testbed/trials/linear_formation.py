"""A formation in steady flight as one linear, time-invariant, discrete system.

The maps of the control periods (`period_map`) are averaged over the periods after which the flight
repeats, and joined by the messages of the scenario's graph, each as many control periods old as in
the flight. The average stands for filters that step in some periods only; tests compare its
eigenvalues with those of the product of the maps, which is exact.
"""

from __future__ import annotations

import math
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
MAX_GAIN, MIN_GAIN, MAX_LATENCY_S = 10.0, 0.001, 1.0  # that are reported
FREQUENCIES = np.geomspace(2e-4, 1.0, 3000)  # of loops, as a share of half the control rate


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

    def is_stable(self) -> bool:
        """Return whether nothing grows."""
        values = np.abs(np.linalg.eigvals(self.a))
        return bool(values.max() < math.exp(SLOWEST * self.dt))

    def margins(self, follower: int) -> tuple[CommandMargins, ...]:
        """Return the margins of the commands of one follower, in the order of COMMANDS.

        Args:
            follower: 0..n-1.
        """
        own = self.of(follower)  # others cannot destabilise it
        at = own.names.index(self.names[follower])
        loops = own.open_loops(at, FREQUENCIES * (0.5 / self.dt))
        stable = own.is_stable()
        return tuple(_margins_of(loop, self.dt, stable) for loop in loops)

    def open_loops(self, follower: int, frequency_hz: Array) -> Array:
        """Return L at frequencies (F,), (3, F): from a command given to minus that computed."""
        z = np.exp(2j * np.pi * np.asarray(frequency_hz) * self.dt)
        added, computed = self.b_command[follower].sum(axis=0), self.c_command[follower]
        closed = np.diagonal(transfer(self.a, added, computed, z), axis1=1, axis2=2).T
        loops: Array = -closed / (1.0 + closed)
        return loops


def _margins_of(loop: Array, dt: float, stable: bool) -> CommandMargins:
    """Return the margins of a loop.

    As a factor or a latency grows, a pole becomes unstable where 1 + L is 0 with it for the first
    time, at some frequency.

    Args:
        loop: (F,) L at FREQUENCIES.
        dt: s, control period.
        stable: whether the closed loop is.
    """
    distance = float(np.abs(1.0 + loop).min())
    if not stable:
        return CommandMargins(1.0, 1.0, 0.0, 0.0, distance)
    _, real = _crossings(loop.imag, loop.real)
    factors = -1.0 / real[real < 0.0]
    if loop.real[-1] < 0.0:  # at half the control rate L is real
        factors = np.append(factors, -1.0 / loop.real[-1])
    gain = float(factors[factors > 1.0].min(initial=math.inf))
    least = float(factors[factors < 1.0].max(initial=0.0))
    where, phase = _crossings(np.abs(loop) - 1.0, np.unwrap(np.angle(loop)))
    angular = np.interp(where, np.arange(len(loop)), FREQUENCIES) * np.pi / dt
    latency = float((np.mod(phase + np.pi, 2.0 * np.pi) / angular).min(initial=math.inf))
    to_point = np.abs(np.mod(phase, 2.0 * np.pi) - np.pi)
    return CommandMargins(
        gain if gain <= MAX_GAIN else math.inf,
        least if least >= MIN_GAIN else 0.0,
        latency if latency <= MAX_LATENCY_S else math.inf,
        float(np.degrees(to_point).min(initial=math.inf)),
        distance,
    )


def _crossings(values: Array, others: Array) -> tuple[Array, Array]:
    """Return where values (F,) cross 0, as an index with a fraction, and others (F,) there."""
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    part = values[before] / (values[before] - values[before + 1])
    return before + part, others[before] + part * (others[before + 1] - others[before])


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
    count = into.shape[1]
    states = np.zeros((len(a), count, len(z)), dtype=complex)
    for k in range(len(a) - 1, -1, -1):
        later = triangle[k, k + 1 :] @ states[k + 1 :].reshape(-1, count * len(z))
        states[k] = (into[k][:, np.newaxis] + later.reshape(count, -1)) / (z - triangle[k, k])
    response = (c @ unitary) @ states.reshape(-1, count * len(z))
    return np.moveaxis(response.reshape(*c.shape[:-1], count, len(z)), -1, 0)


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
