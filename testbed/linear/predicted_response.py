"""Frequency responses of a formation in straight flight, predicted from its linearised followers.

Each follower answers the messages that it uses and the wind by its own map of a control period
(`period_map`). At one frequency the formation is then a set of linear equations in the followers'
messages, whose graph is that of the scenario. Vectors are forward, right and down of the leader's
steady course. An input and its responses are complex amplitudes: x(t) = Re(X exp(2πi f t)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import GRAVITY
from testbed.core.records import Array, BoolArray
from testbed.linear.held_flight import MESSAGE
from testbed.linear.linear_formation import AXES, LEADER_SIZE, MESSAGE_SIZE, received
from testbed.linear.linear_system import LinearSystem

# complex numbers; their types differ between releases of numpy
Complex = NDArray[Any]

# inputs by their kind, with the axis of each
LEADER_INPUTS = {"leader-speed": 0, "leader-weave": 1, "leader-height": 2}
GUST_INPUTS = {f"gust-{name}": axis for axis, name in enumerate(AXES)}
MESSAGE_INPUTS = {f"message-{name}": axis for axis, name in enumerate(AXES)}
INPUTS = {**LEADER_INPUTS, **GUST_INPUTS, **MESSAGE_INPUTS}
_STILL = 1e-9  # m: what moves less does not move
_ELEMENTS = 4_000_000  # of the matrices of a formation that are in memory together


class Response(NamedTuple):
    """Amplitudes of n followers at F frequencies, per unit of the input.

    The unit is 1 m of the leader's position or of a message's, or 1 m/s of a gust.

    Attributes:
        position: (F, n, 3) of q_i, m.
        error: (F, n, 3) of the slot error q_i − (q_g + R_g υ_i), m.
    """

    position: Complex
    error: Complex


@dataclass(frozen=True, slots=True)
class StraightFormation:
    """A formation of n followers in straight, level flight.

    Attributes:
        dt: s, control period.
        speed: m/s, of the leader.
        names: of the followers.
        maps: of the followers, in this order: from the messages that each uses and the wind to its
            message; see `average`.
        age_s: (n, N) s of the messages used; NaN: not used.
        gains: (n, N, 3) β_i of the leader in column 0, β_ij of followers, forward, right, down.
        offsets: (N, 3) υ, m; the leader's zero first.
        level: (n,) followers that hold an altitude, whose slots turn with the course only.
        alike: their maps differ by slots and gains only.
    """

    dt: float
    speed: float
    names: tuple[str, ...]
    maps: tuple[LinearSystem, ...]
    age_s: Array
    gains: Array
    offsets: Array
    level: BoolArray
    alike: bool

    def respond(self, name: str, frequency_hz: Array, sender: int = 0) -> Response:
        """Return the response to one of INPUTS.

        Args:
            name: of the input.
            frequency_hz: (F,).
            sender: row of the aircraft whose messages have the error, of MESSAGE_INPUTS.
        """
        frequency = np.asarray(frequency_hz, dtype=float)
        at_once = max(1, _ELEMENTS // (MESSAGE_SIZE * len(self.names)) ** 2)
        answers = [each.frequency_response(frequency) for each in self.maps]
        parts = [
            self._respond(name, frequency[rows], [each[rows] for each in answers], sender)
            for rows in np.array_split(np.arange(len(frequency)), -(-len(frequency) // at_once))
        ]
        return Response(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def _respond(
        self, name: str, frequency: Array, answers: Sequence[Complex], sender: int
    ) -> Response:
        """Solve the equations of the graph.

        Args:
            name: of the input.
            frequency: (F,) Hz.
            answers: of each follower, (F, 9, M) its message by its inputs.
            sender: see `respond`.
        """
        axis, count, n = INPUTS[name], len(frequency), len(self.names)
        own = np.zeros((count, n, MESSAGE_SIZE), dtype=complex)  # by the input itself
        between = np.zeros((count, n, MESSAGE_SIZE, n, MESSAGE_SIZE), dtype=complex)
        moved = leader_motion(axis, self.speed, frequency)
        wrong = np.zeros((LEADER_SIZE if sender == 0 else MESSAGE_SIZE,))
        wrong[axis] = 1.0
        for i, (each, answer) in enumerate(zip(self.maps, answers, strict=True)):
            for j, columns in self._columns(i).items():
                late = self.delay(i, j, frequency)[:, np.newaxis, np.newaxis]
                part = late * answer[..., columns]
                if name in LEADER_INPUTS and j == 0:
                    own[:, i] += np.einsum("fom,fm->fo", part, moved)
                if name in MESSAGE_INPUTS and j == sender:
                    own[:, i] += part @ wrong
                if j > 0:
                    between[:, i, :, j - 1] = part
            if name in GUST_INPUTS:
                own[:, i] += answer[..., each.inputs.index(f"wind.{AXES[axis]}")]
        size = n * MESSAGE_SIZE
        closed = np.eye(size) - between.reshape(count, size, size)
        found = np.linalg.solve(closed, own.reshape(count, size, 1))
        position = found.reshape(count, n, MESSAGE_SIZE)[..., :3]
        slots = np.zeros_like(position)
        if name in LEADER_INPUTS:
            slots = slot_motion(moved, self.offsets[1:], self.speed, self.level)
        return Response(position, position - slots)

    def _columns(self, follower: int) -> dict[int, list[int]]:
        """Return the positions of a follower's inputs by each message, by the sender's row."""
        inputs, own = self.maps[follower].inputs, self.names[follower]
        prefixes = ["leader.", *(f"{received(own, other)}." for other in self.names)]
        columns = {
            j: [k for k, name in enumerate(inputs) if name.startswith(prefix)]
            for j, prefix in enumerate(prefixes)
        }
        return {j: of for j, of in columns.items() if of}

    def hop(self, follower: int, sender: int, axis: int, frequency_hz: Array) -> Complex:
        """Return T (F,): a follower's position by the position of another alone, along one axis.

        Position, velocity and acceleration of the other move together; the leader and all others
        fly steadily.

        Args:
            follower: 0..n-1.
            sender: row of another follower whose position acts.
            axis: of AXES.
            frequency_hz: (F,).
        """
        frequency = np.asarray(frequency_hz, dtype=float)
        own, from_sender = (
            self.names[follower],
            received(self.names[follower], self.names[sender - 1]),
        )
        answer = (
            self.maps[follower]
            .select(
                [f"{from_sender}.{field}.{AXES[axis]}" for field in MESSAGE],
                f"{own}.message.position_ned.{AXES[axis]}",
            )
            .frequency_response(frequency)[:, 0]
        )
        rate = 2j * np.pi * frequency
        moved = np.stack([rate**k for k in range(3)], axis=-1)
        late = self.delay(follower, sender, frequency)
        found: Complex = late * (answer * moved).sum(axis=-1)
        return found

    def delay(self, follower: int, sender: int, frequency_hz: Array) -> Complex:
        """Return the factor (F,) of a message by its age."""
        age = float(np.nan_to_num(self.age_s[follower, sender]))
        factor: Complex = np.exp(-2j * np.pi * frequency_hz * age)
        return factor

    def ahead(self) -> tuple[int, ...]:
        """Return for each follower the row (n,) of the aircraft ahead in the string.

        Of the followers with lower numbers whose positions act, that with the nearest slot; the
        leader where there is none.
        """
        rows = []
        for i, place in enumerate(self.offsets[1:]):
            apart = np.linalg.norm(self.offsets - place, axis=-1).tolist()
            acts = [j for j in range(1, i + 1) if self.gains[i, j].any()]
            rows.append(min(acts, key=apart.__getitem__, default=0))
        return tuple(rows)


def leader_motion(axis: int, speed: float, frequency_hz: Array) -> Complex:
    """Return the leader's message (F, 15) where its position swings by 1 m along an axis.

    Velocity and acceleration are its derivatives, the attitude is that of a coordinated turn.
    """
    rate = 2j * np.pi * np.asarray(frequency_hz)
    out = np.zeros((len(rate), LEADER_SIZE), dtype=complex)
    for order in range(3):
        out[:, 3 * order + axis] = rate**order
    if axis == 1:
        out[:, 9], out[:, 12] = rate**2 / GRAVITY, rate**3 / GRAVITY  # bank
        out[:, 11], out[:, 14] = rate / speed, rate**2 / speed  # course
    if axis == 2:
        out[:, 10], out[:, 13] = -rate / speed, -(rate**2) / speed  # flight-path angle
    return out


def slot_motion(moved: Complex, offsets: Array, speed: float, level: BoolArray) -> Complex:
    """Return the motion (F, n, 3) of slots, with the leader's position and its velocity frame.

    R_g υ turns with the direction of the leader's velocity: by v_right / V to the right and by
    −v_down / V up.

    Args:
        moved: (F, 15) of `leader_motion`.
        offsets: (n, 3) υ, m.
        speed: V, m/s.
        level: (n,) slots at a constant altitude, turned by the course only.
    """
    course = moved[:, np.newaxis, 4] / speed
    climb = np.where(level, 0.0, -moved[:, np.newaxis, 5] / speed)
    x, y, z = offsets.T
    vertical = np.where(level, 0.0, moved[:, np.newaxis, 2])
    return np.stack(
        (
            moved[:, np.newaxis, 0] - course * y + climb * z,
            moved[:, np.newaxis, 1] + course * x,
            vertical - climb * x,
        ),
        axis=-1,
    )


def amplitudes(response: Response, name: str, output: str) -> Array:
    """Return the amplitudes (F, n) of an output, m per unit of the input.

    Of "slot-error" all three components, by the root of their sum of squares; of "position" that
    along the axis of the input.
    """
    if output == "position":
        along: Array = np.abs(response.position[..., INPUTS[name]])
        return along
    whole: Array = np.linalg.norm(response.error, axis=-1)
    return whole


def gains_per_hop(ahead: Sequence[int], amplitude: Array) -> Array:
    """Return the amplitude (F, n) of each follower over that of the one ahead of it.

    NaN: the leader is ahead, or the one ahead does not move.

    Args:
        ahead: (n,) rows of `StraightFormation.ahead`.
        amplitude: (F, n).
    """
    out = np.full(amplitude.shape, np.nan)
    for i, row in enumerate(ahead):
        if row:
            moves = amplitude[:, row - 1] > _STILL
            out[moves, i] = amplitude[moves, i] / amplitude[moves, row - 1]
    return out
