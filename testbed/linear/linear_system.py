"""Discrete, linear systems whose states, inputs and outputs have names.

The first word of a state's name, up to a dot, is the part of the system to which it belongs: in a
formation a follower. Systems are put side by side by `append` and joined by `connect`.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import (
    block_diag,
    eig,
    schur,
    solve_discrete_lyapunov,
    solve_sylvester,
    svd,
)
from scipy.sparse.csgraph import connected_components

from testbed.core.errors import InputError, MissingExtraError
from testbed.core.records import Array, BoolArray, join_names
from testbed.linear.loop_margins import FREQUENCIES, CommandMargins, margins_of

if TYPE_CHECKING:
    from scipy.signal import dlti

_NEGLIGIBLE = 1e-9  # elements of matrices
_VANISHED = 1e-6  # eigenvalues of what a period forgets
# 1/s; slower poles are those of the position on the round Earth
SLOWEST = 1e-3
_FROZEN = 1e-7  # largest distance of an eigenvalue that does not move from 1
# where that is looked for, as a share of half the control rate
_LOOK_HZ = np.geomspace(1e-3, 1.0, 200)
_NEAR = 3  # names in the error of an unknown one


class Mode(NamedTuple):
    """An oscillation, or an exponential where the frequency is zero.

    Attributes:
        frequency_hz: of its zero crossings, as that of `Oscillation`.
        damping: ratio; 1 or -1 for an exponential.
        pole: 1/s.
        follower: with the largest share in it.
        motion: of that follower, mostly: "bank", "pitch", "speed" or "height"; "": not known.
    """

    frequency_hz: float
    damping: float
    pole: complex
    follower: str
    motion: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LinearSystem:
    """A discrete, linear system: x⁺ = a x + b u, y = c x + d u, with deviations from steady flight.

    Args:
        a: (n, n).
        b: (n, k).
        c: (K, n).
        d: (K, k).
        dt: s, control period.
        states: (n,) names, such as `uav1.last fcs/elevator-cmd-norm`; of the memory of a user's
            law, `uav1.law/integral[0]`; of messages under way, by their age in periods,
            `uav2.message.position_ned.forward.1`.
        inputs: (k,) names: of a uniform wind, `wind.forward`; of the leader's message as used,
            `leader.position_ned.right`; of additions to commands, `uav1.roll`.
        outputs: (K,) names: of computed commands, `uav1.roll`; of slot errors with the leader's
            slot held, `uav1.error.down`; of attitudes, `uav1.attitude.pitch`.
        speed: m/s, of the leader over the ground; NaN: none, so that modes have no motion.

    Units are m, s, rad; throttle is 0 to 1. Axes are those of the leader: forward along its course,
    right, down.

    Raises:
        InputError: a matrix has not the shape of the names, or a name stands twice.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    dt: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    speed: float = math.nan

    def __post_init__(self) -> None:
        """Check names and shapes."""
        n, k, m = len(self.states), len(self.inputs), len(self.outputs)
        for name, shape in {"a": (n, n), "b": (n, k), "c": (m, n), "d": (m, k)}.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(
                    f"{name}: has the shape {np.shape(getattr(self, name))} (write {shape}, for "
                    f"{n} states, {k} inputs and {m} outputs)"
                )
        for kind in ("states", "inputs", "outputs"):
            names = getattr(self, kind)
            if len(set(names)) < len(names):
                twice = next(each for each in names if names.count(each) > 1)
                raise InputError(f"{kind}: {twice} stands twice (write each name once)")

    def __repr__(self) -> str:
        """Return the sizes."""
        return (
            f"LinearSystem({len(self.states)} states, {len(self.inputs)} inputs, "
            f"{len(self.outputs)} outputs, dt={self.dt:g})"
        )

    def select(
        self,
        inputs: str | Sequence[str] | None = None,
        outputs: str | Sequence[str] | None = None,
    ) -> LinearSystem:
        """Return the system with some of its inputs and outputs, in the order asked for.

        Args:
            inputs: names, or their beginnings up to a dot: "uav1" selects all of `uav1.…`; None:
                all.
            outputs: the same.

        Raises:
            InputError: there is no such name.
        """
        columns = _positions("inputs", self.inputs, inputs)
        rows = _positions("outputs", self.outputs, outputs)
        return replace(
            self,
            b=self.b[:, columns],
            c=self.c[rows],
            d=self.d[np.ix_(rows, columns)],
            inputs=tuple(self.inputs[k] for k in columns),
            outputs=tuple(self.outputs[k] for k in rows),
        )

    def without_unread(self) -> LinearSystem:
        """Return the system without the states that reach no output."""
        return self._with_states(_reached(self.a.T, self.c.T))

    def _with_states(self, kept: BoolArray) -> LinearSystem:
        return replace(
            self,
            a=self.a[np.ix_(kept, kept)],
            b=self.b[kept],
            c=self.c[:, kept],
            states=tuple(name for name, own in zip(self.states, kept, strict=True) if own),
        )

    def connect(
        self, sender: str, receiver: str, *, late: int = 0, turned: Array | None = None
    ) -> LinearSystem:
        """Feed the inputs `receiver.…` with the outputs `sender.…`, and return what is left.

        The inputs fed are no inputs any more. Messages under way are states; receivers of the same
        sender share them.

        Args:
            sender: beginning of K names of outputs.
            receiver: beginning of names of inputs, each with the rest of a name of an output.
            late: steps under way.
            turned: (K, K) that multiplies them in each step under way: in a turn their axes turn
                on; None: nothing does.

        Raises:
            InputError: there is no such name; an input has no output; `late` is not 0 or more;
                messages under way of this sender turn otherwise; or 1 − d of the loop is singular.
        """
        rows = _positions("outputs", self.outputs, sender)
        fed = _positions("inputs", self.inputs, receiver)
        if not (isinstance(late, int) and late >= 0):
            raise InputError(f"late: is {late!r} (write a whole number of steps, 0 or more)")
        rest = [self.outputs[k].removeprefix(sender) for k in rows]
        sources = []
        for name in (self.inputs[k].removeprefix(receiver) for k in fed):
            if name not in rest:
                raise InputError(f"receiver: {receiver}{name} has no output {sender}{name}")
            sources.append(rest.index(name))
        turn = np.eye(len(rows)) if turned is None else turned
        if np.shape(turn) != (len(rows),) * 2:
            raise InputError(f"turned: has the shape {np.shape(turn)} (write {(len(rows),) * 2})")
        system, by_state, by_input = self._sent(rows, late, turn)
        ahead = np.eye(len(fed)) - by_input[np.ix_(sources, fed)]
        if np.linalg.matrix_rank(ahead) < len(fed):
            raise InputError(
                f"receiver: {receiver} acts on {sender} at once (write late: 1 or more)"
            )
        by_input[:, fed] = 0.0
        back = np.asarray(np.linalg.inv(ahead), dtype=float)
        joined = system._with_inputs(fed, back @ by_state[sources], back @ by_input[sources])
        return joined.select([name for k, name in enumerate(self.inputs) if k not in set(fed)])

    def _sent(
        self, rows: Sequence[int], late: int, turned: Array
    ) -> tuple[LinearSystem, Array, Array]:
        """Delay outputs by states, those that are not there yet.

        Args:
            rows: of K outputs.
            late: steps.
            turned: (K, K) of each step.

        Returns:
            The system, and the outputs `late` steps later by its states (K, n) and inputs (K, k).
        """
        system, by_state, by_input = self, self.c[rows], self.d[rows]
        for step in range(1, late + 1):
            by_state, by_input = turned @ by_state, turned @ by_input
            names = [f"{self.outputs[k]}.{step}" for k in rows]
            if not set(names) <= set(system.states):
                system = replace(
                    system,
                    a=np.pad(np.vstack((system.a, by_state)), ((0, 0), (0, len(names)))),
                    b=np.vstack((system.b, by_input)),
                    c=np.pad(system.c, ((0, 0), (0, len(names)))),
                    states=(*system.states, *names),
                )
                by_state = np.pad(by_state, ((0, 0), (0, len(names))))
            at = [system.states.index(name) for name in names]
            if not np.allclose(system.a[at], by_state):
                raise InputError(f"turned: {names[0]} is turned otherwise by another receiver")
            by_state, by_input = np.zeros_like(by_state), np.zeros_like(by_input)
            by_state[np.arange(len(at)), at] = 1.0
        return system, by_state, by_input

    def _with_inputs(
        self, columns: Sequence[int], by_state: Array, by_input: Array
    ) -> LinearSystem:
        """Replace inputs by sums of states and inputs.

        Args:
            columns: (F,) of the inputs that are replaced.
            by_state: (F, n).
            by_input: (F, k), of all inputs.
        """
        b, d = self.b[:, columns], self.d[:, columns]
        others_b, others_d = self.b.copy(), self.d.copy()
        others_b[:, columns] = others_d[:, columns] = 0.0
        return replace(
            self,
            a=self.a + b @ by_state,
            b=others_b + b @ by_input,
            c=self.c + d @ by_state,
            d=others_d + d @ by_input,
        )

    def opened(self, command: str) -> LinearSystem:
        """Return the system with its loop opened at a command.

        Args:
            command: name of an input, which adds to the output of the same name. The input becomes
                the command given, the output stays the command computed.

        Raises:
            InputError: there is no such command, or no such loop.
        """
        [column] = _positions("inputs", self.inputs, command, whole=True)
        [row] = _positions("outputs", self.outputs, command, whole=True)
        share = 1.0 + self.d[row, column]
        if abs(share) < _NEGLIGIBLE:
            raise InputError(f"command: {command} is not set by any state: 1 + d is 0")
        by_input = -self.d[row : row + 1] / share
        by_input[0, column] = 1.0 / share
        return self._with_inputs([column], -self.c[row : row + 1] / share, by_input)

    def loop(self, command: str) -> LinearSystem:
        """Return the loop L opened at a command: from the command given to minus that computed.

        The loop is at its limit of stability where 1 + L(z) = 0. It has the states that the command
        reaches and that reach it; the others too where they alone are unstable.

        Args:
            command: such as "uav1.roll", name of an input and of an output.

        Raises:
            InputError: see `opened`.
        """
        _positions("outputs", self.outputs, command, whole=True)
        own = self.select([command], [command])
        seen = _reached(own.a, own.b) & _reached(own.a.T, own.c.T)
        parts = {_part_of(name) for name, is_seen in zip(own.states, seen, strict=True) if is_seen}
        every = np.array([_part_of(name) in parts for name in own.states], dtype=bool)
        # the matrix is block triangular: its eigenvalues are those of these two
        kept = seen if own._with_states(every & ~seen).is_stable() else every
        opened = own._with_states(kept).opened(command)
        return replace(opened, c=-opened.c, d=-opened.d)

    def coupled_parts(self) -> tuple[tuple[str, ...], ...]:
        """Return the parts that influence each other, through others too, each in one set."""
        parts = list(dict.fromkeys(map(_part_of, self.states)))
        owners = self._owners(parts)
        own = (owners == np.arange(len(parts))[:, np.newaxis]).astype(float)
        reads = own @ (np.abs(self.a) > 0.0) @ own.T
        number = connected_components(reads, connection="strong")[1].tolist()
        return tuple(
            tuple(name for name, of in zip(parts, number, strict=True) if of == each)
            for each in dict.fromkeys(number)
        )

    def coupled_with(self, part: str) -> LinearSystem:
        """Return a part and those that influence each other with it, by themselves.

        Args:
            part: such as "uav1".

        Raises:
            InputError: there is no such part.
        """
        sets = self.coupled_parts()
        every = [name for each in sets for name in each]
        [_] = _positions("states", every, part, whole=True)
        own = next(each for each in sets if part in each)
        others = set(every) - set(own)
        kept = self._with_states(np.array([_part_of(name) in own for name in self.states]))
        return kept.select(
            [name for name in self.inputs if _part_of(name) not in others],
            [name for name in self.outputs if _part_of(name) not in others],
        )

    def _owners(self, parts: Sequence[str]) -> Array:
        """Return the position (n,) of the part of each state."""
        return np.array([parts.index(_part_of(name)) for name in self.states], dtype=int)

    def modes(self) -> list[Mode]:
        """Return the modes, the least damped first; slower ones than SLOWEST are left out."""
        # not the inverse of `vectors`: those of messages under way are almost the same
        values, left, vectors = eig(self.a, left=True, right=True)
        parts = list(dict.fromkeys(map(_part_of, self.states)))
        owners = self._owners(parts)
        found = []
        for k in np.flatnonzero(np.abs(values) > _VANISHED):
            pole = complex(np.log(complex(values[k]))) / self.dt
            if abs(pole) < SLOWEST or pole.imag < 0.0:
                continue
            share = np.abs(vectors[:, k] * left[:, k])
            by_owner = [share[owners == i].sum() for i in range(len(parts))]
            follower = parts[int(np.argmax(by_owner))]
            found.append(
                Mode(
                    pole.imag / (2.0 * math.pi) if pole.imag > 1e-9 else 0.0,
                    -pole.real / abs(pole),
                    pole,
                    follower,
                    self._motion(follower, vectors[:, k], abs(pole)),
                )
            )
        return sorted(found, key=lambda mode: mode.damping)

    def _motion(self, follower: str, vector: Array, rate: float) -> str:
        """Return in what a follower moves most: angles, and velocities over its speed.

        Args:
            follower: name of the part; its attitude and slot error are compared.
            vector: (n,) of the mode.
            rate: its magnitude, 1/s.
        """
        over = rate / self.speed
        scales = {
            "bank": ("attitude.roll", 1.0),
            "pitch": ("attitude.pitch", 1.0),
            "speed": ("error.forward", over),
            "height": ("error.down", over),
        }
        parts = {
            motion: scale * abs(self.c[self.outputs.index(f"{follower}.{name}")] @ vector)
            for motion, (name, scale) in scales.items()
            if f"{follower}.{name}" in self.outputs and math.isfinite(scale)
        }
        return max(parts, key=lambda name: parts[name], default="")

    def is_stable(self) -> bool:
        """Return whether nothing grows faster than SLOWEST."""
        values = np.abs(np.linalg.eigvals(self.a))
        return bool(values.max(initial=0.0) < math.exp(SLOWEST * self.dt))

    def response_at(self, z: Array) -> Array:
        """Return the transfer function (F, K, k) at points z (F,)."""
        return transfer(self.a, self.b, self.c, z) + self.d

    def frequency_response(self, frequency_hz: Array) -> Array:
        """Return the frequency response (F, K, k), complex, at frequencies (F,) in Hz."""
        return self.response_at(np.exp(2j * np.pi * np.asarray(frequency_hz) * self.dt))

    def margins(self) -> CommandMargins:
        """Return the margins of a loop L, such as `loop` returns.

        Raises:
            InputError: there are several inputs or outputs.
        """
        self._check_loop("margins")
        feedback = -self.c / (1.0 + self.d)
        closed = replace(self, a=self.a + self.b @ feedback)
        loop = self.frequency_response(FREQUENCIES * (0.5 / self.dt))[:, 0, 0]
        return margins_of(loop, self.dt, stable=closed.is_stable())

    def reduced(self, tolerance: float = 1e-6) -> LinearSystem:
        """Return a small system with the same responses, for simulation.

        Modes that are frozen, such as those of the position on the round Earth, are taken off by an
        ordered Schur form; the rest is balanced and truncated. Open loops of what is reduced: the
        closed one is stable, an open one need not be.

        Args:
            tolerance: smallest Hankel singular value that is kept, as a part of the largest. The
                error of a response is at most twice the sum of those left out.

        Raises:
            InputError: the tolerance is not between 0 and 1, or an output does not come to rest.

        Source: Laub, Heath, Paige, Ward, Computation of system balancing transformations (1987).
        """
        if not 0.0 < tolerance < 1.0:
            raise InputError(f"tolerance: is {tolerance} (write a number between 0 and 1)")
        moving, frozen = self._split(1.0 - _FROZEN)
        seen = frozen.frequency_response(_LOOK_HZ * (0.5 / self.dt))
        whole = np.abs(moving.frequency_response(_LOOK_HZ * (0.5 / self.dt))).max(initial=0.0)
        if np.abs(seen).max(initial=0.0) > tolerance * whole:
            k, i = np.unravel_index(np.abs(seen).max(axis=0).argmax(), self.d.shape)
            raise InputError(
                f"reduced: {self.outputs[k]} does not come to rest after {self.inputs[i]} (select "
                "other inputs and outputs first)"
            )
        to_state = _root(solve_discrete_lyapunov(moving.a, moving.b @ moving.b.T))
        to_output = _root(solve_discrete_lyapunov(moving.a.T, moving.c.T @ moving.c))
        left, hankel, right = svd(to_output.T @ to_state)
        kept = int(np.count_nonzero(hankel > tolerance * hankel.max(initial=0.0)))
        scale = np.sqrt(hankel[:kept])
        into = (to_output @ left[:, :kept] / scale).T
        back = to_state @ right[:kept].T / scale
        return replace(
            moving,
            a=into @ moving.a @ back,
            b=into @ moving.b,
            c=moving.c @ back,
            states=tuple(f"reduced.{k + 1}" for k in range(kept)),
        )

    def _split(self, largest: float) -> tuple[LinearSystem, LinearSystem]:
        """Return the parts with eigenvalues below a magnitude, and with the others; with no d."""
        triangle, unitary, count = schur(
            self.a, output="real", sort=lambda re, im: math.hypot(re, im) < largest
        )
        one, other = triangle[:count, :count], triangle[count:, count:]
        b, c = unitary.T @ self.b, self.c @ unitary
        if 0 < count < len(self.a):  # and not only triangular, but apart
            apart = solve_sylvester(one, -other, -triangle[:count, count:])
            b[:count] -= apart @ b[count:]
            c[:, count:] += c[:, :count] @ apart
        names = tuple(f"reduced.{k + 1}" for k in range(len(self.a)))
        first = replace(self, a=one, b=b[:count], c=c[:, :count], states=names[:count])
        nothing = np.zeros_like(self.d)
        return first, replace(
            self, a=other, b=b[count:], c=c[:, count:], d=nothing, states=names[count:]
        )

    def poles_with_factors(self, factors: Array) -> Array:
        """Return the poles of a closed loop over factors of its command, as a root locus has them.

        Args:
            factors: (F,) that multiply the command; 0 opens the loop.

        Returns:
            (F, n) complex, 1/s.

        Raises:
            InputError: there are several inputs or outputs.
        """
        self._check_loop("poles_with_factors")
        found = []
        for factor in np.asarray(factors, dtype=float).tolist():
            feedback = -factor * self.c / (1.0 + factor * self.d)
            values = np.linalg.eigvals(self.a + self.b @ feedback).astype(complex)
            values[np.abs(values) < _VANISHED] = _VANISHED  # what a period forgets
            found.append(np.log(values) / self.dt)
        return np.array(found)

    def _check_loop(self, caller: str) -> None:
        if not len(self.inputs) == len(self.outputs) == 1:
            raise InputError(
                f"{caller}: {len(self.inputs)} inputs and {len(self.outputs)} outputs are no loop "
                f"(open one, as system.loop('uav1.roll').{caller}())"
            )

    def to_scipy(self) -> dlti:
        """Return it as a `scipy.signal.dlti`, which has no names."""
        from scipy.signal import dlti  # takes as long to import as all other libraries of a command

        return dlti(self.a, self.b, self.c, self.d, dt=self.dt)

    def to_control(self) -> Any:  # noqa: ANN401 - python-control has no types
        """Return it as a `control.StateSpace`, with an underscore for each dot of its names.

        Raises:
            InputError: python-control is not installed.
        """
        control = _python_control("to_control")
        names = self._names_without_dots("states", "inputs", "outputs")
        return control.ss(self.a, self.b, self.c, self.d, self.dt, **names)

    def frd(self) -> Any:  # noqa: ANN401 - python-control has no types
        """Return the frequency response as a `control.FrequencyResponseData`, with these names.

        Of a loop, `control.stability_margins` finds the margins of `margins` in it. Those of a
        state space are wrong: python-control takes polynomials for them, which have no accuracy
        left from some 15 states on.

        Raises:
            InputError: python-control is not installed.
        """
        control = _python_control("frd")
        hz = FREQUENCIES[:-1] * (0.5 / self.dt)  # at half the control rate its phase is arbitrary
        response = np.moveaxis(self.frequency_response(hz), 0, -1)
        names = self._names_without_dots("inputs", "outputs")
        return control.frd(response, 2.0 * np.pi * hz, smooth=False, dt=self.dt, **names)

    def _names_without_dots(self, *kinds: str) -> dict[str, list[str]]:
        """Return names as python-control takes them."""
        return {kind: [name.replace(".", "_") for name in getattr(self, kind)] for kind in kinds}


def _python_control(caller: str) -> Any:  # noqa: ANN401 - python-control has no types
    """Return the module of python-control.

    Raises:
        InputError: it is not installed.
    """
    try:
        import control  # type: ignore[import-not-found, unused-ignore]
    except ModuleNotFoundError:
        raise MissingExtraError(
            f"{caller}: python-control is not installed; write pip install control"
        ) from None
    return control


def append(systems: Sequence[LinearSystem]) -> LinearSystem:
    """Put systems side by side: block-diagonal, but an input of the same name acts on each.

    Args:
        systems: one or more, with the control period and the speed of the first.

    Raises:
        InputError: control periods differ, or states or outputs of the same name.
    """
    if any(each.dt != systems[0].dt for each in systems):
        raise InputError("systems: their control periods differ (write systems of one dt)")
    inputs = list(dict.fromkeys(name for each in systems for name in each.inputs))
    parts = []
    for each in systems:
        into = np.zeros((len(each.inputs), len(inputs)))
        into[np.arange(len(each.inputs)), [inputs.index(name) for name in each.inputs]] = 1.0
        parts.append((each.b @ into, each.d @ into))
    return LinearSystem(
        a=block_diag(*(each.a for each in systems)),
        b=np.vstack([b for b, _ in parts]),
        c=block_diag(*(each.c for each in systems)),
        d=np.vstack([d for _, d in parts]),
        dt=systems[0].dt,
        states=tuple(name for each in systems for name in each.states),
        inputs=tuple(inputs),
        outputs=tuple(name for each in systems for name in each.outputs),
        speed=systems[0].speed,
    )


def transfer(a: Array, b: Array, c: Array, z: Array) -> Array:
    """Return c (z − a)⁻¹ b.

    Args:
        a: (S, S).
        b: (S, M).
        c: (P, S).
        z: (F,).

    Returns:
        (F, P, M).
    """
    if not len(a):
        return np.zeros((len(z), len(c), b.shape[1]), dtype=complex)
    # by a triangular matrix: messages under way have no eigenvectors
    triangle, unitary = schur(a, output="complex")
    into = unitary.conj().T @ b
    count = into.shape[1]
    states = np.zeros((len(a), count, len(z)), dtype=complex)
    for k in range(len(a) - 1, -1, -1):
        later = triangle[k, k + 1 :] @ states[k + 1 :].reshape(-1, count * len(z))
        states[k] = (into[k][:, np.newaxis] + later.reshape(count, -1)) / (z - triangle[k, k])
    response = (c @ unitary) @ states.reshape(-1, count * len(z))
    return np.moveaxis(response.reshape(len(c), count, len(z)), -1, 0)


def _root(gramian: Array) -> Array:
    """Return a root L of a positive semidefinite matrix L Lᵀ."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _reached(a: Array, b: Array) -> BoolArray:
    """Return which states (n,) the inputs reach; of aᵀ and cᵀ, which reach the outputs."""
    acts: BoolArray = np.abs(a) > _NEGLIGIBLE
    reached: BoolArray = np.asarray((np.abs(b) > _NEGLIGIBLE).any(axis=1))
    count = -1
    while count != int(np.count_nonzero(reached)):
        count = int(np.count_nonzero(reached))
        reached |= acts[:, reached].any(axis=1)
    return reached


def _part_of(name: str) -> str:
    return name.partition(".")[0]


def _positions(
    kind: str,
    names: Sequence[str],
    wanted: str | Sequence[str] | None,
    *,
    whole: bool = False,
) -> list[int]:
    """Return the positions of names.

    Args:
        kind: as an error begins.
        names: all.
        wanted: names, or beginnings up to a dot; a name selects itself alone; None: all.
        whole: names only.

    Raises:
        InputError: there is no such name; with the nearest ones.
    """
    if wanted is None:
        return list(range(len(names)))
    by_name = {name: k for k, name in enumerate(names)}
    found: dict[int, None] = {}
    for word in [wanted] if isinstance(wanted, str) else wanted:
        own = [by_name[word]] if word in by_name else []
        if not (own or whole):
            own = [k for k, name in enumerate(names) if name.startswith(f"{word}.")]
        if not own:
            raise InputError(f"{kind}: there is no {word} (write {_nearest(word, names, whole)})")
        found |= dict.fromkeys(own)
    return list(found)


def _nearest(word: str, names: Sequence[str], whole: bool) -> str:
    """Return the names, or beginnings of names, that are nearest to a word."""
    known = dict.fromkeys(names)
    if not whole:
        for name in names:
            words = name.split(".")
            known |= dict.fromkeys(".".join(words[:k]) for k in range(1, len(words)))
    near = difflib.get_close_matches(word, known, n=_NEAR, cutoff=0.4)
    return " or ".join(near) if near else join_names(list(known))
