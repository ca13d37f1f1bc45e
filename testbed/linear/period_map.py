"""The map of one control period of each follower in steady flight, linearised.

One control period is flown again and again, each time with one number of the followers' state, one
message, one command or the wind changed a little, and central differences are taken. Messages are
inputs, so that the graph and its delays are joined to the maps afterwards (`linear_formation`).
While one follower changes, the others' messages to it are held, so all can change at once.

Vectors are resolved in the leader's horizontal frame: forward, right, down. In it the maps of
periods that the flight repeats are equal, straight or turning.

A period begins with a control step of the follower. Where followers have phases of their own, the
period of each begins later than the leader's by its phase; all use the leader's frame of that time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from testbed.core.records import Array, BoolArray
from testbed.linear.follower_state import CONTROL_MEMORY, LAW, NED, FollowerStates
from testbed.linear.held_flight import COMMANDS, LEADER_MESSAGE, MESSAGE, HeldFlight
from testbed.linear.steady_flight import MarginsError

_OUTPUTS = 3 * len(MESSAGE) + 3 + 2  # message, slot error, roll and pitch
# m, m/s, m/s²: with large gains more would move throttles past TRIM_THROTTLE, where ArduPlane
# pitches down
_MESSAGE_STEP = 0.001
_ANGLE_STEP = 1e-4  # rad, rad/s
_COMMAND_STEP = 1e-5  # rad, or throttle
_WIND_STEP = 1e-3  # m/s
_NO_EFFECT = 1e-9  # of derivatives
# largest change of derivatives of a law's memory after the periods, as a share of the largest, and
# of the angle by which the leader has turned; a vector in wrong axes changes by the angle
_REPEATED, _REPEATED_PER_TURN = 1e-3, 0.1


class FollowerMap(NamedTuple):
    """The linearised control period of one follower, for P periods after which the flight repeats.

    Of a state deviation x (S,), messages m (M,) of an aircraft that are used at the control step,
    additions v (3,) to the commands and a uniform wind w (3,):

        x⁺ = a x + Σ b_message[j] m_j + Σ b_command[q] v_q + b_wind w
        commands before the addition = c_command x + Σ d_message[j] m_j

    Attributes:
        name: of the follower.
        labels: (S,) of the state.
        a: (P, S, S).
        c_command: (P, 3, S).
        c_output: (P, 14, S) its own message (position, m, velocity, m/s, acceleration, m/s²), its
            slot error, m, with the leader's slot held, and roll and pitch, rad.
        b_command: (P, S, 3) of pitch, roll, rad, and throttle, added during the whole period.
        b_wind: (P, S, 3).
        b_message: by the row of the sender, (P, S, M): M is 9, of the leader 15.
        d_message: the same, (P, 3, M).
    """

    name: str
    labels: tuple[str, ...]
    a: Array
    c_command: Array
    c_output: Array
    b_command: Array
    b_wind: Array
    b_message: dict[int, Array]
    d_message: dict[int, Array]


@dataclass(frozen=True, slots=True)
class PeriodMaps:
    """The linearised control period of a formation in steady flight.

    Attributes:
        dt: s, control period.
        speed: m/s, of the leader over the ground.
        followers: n.
        bank: (n,) rad, of the followers.
        error: (n, 3) m, their steady slot errors, forward, right, down.
        age_s: (n, N) s, ages of the messages used, at the control step; NaN: not used.
        turn: rad, of the leader's course in a period.
        from_timestamp: (n,) whether messages are extrapolated from their stamp.
        with_acceleration: (n,) whether along a parabola.
        phase_s: (n,) s, by which their control, and with it their messages, follow the leader's.
    """

    dt: float
    speed: float
    followers: tuple[FollowerMap, ...]
    bank: Array
    error: Array
    age_s: Array
    turn: float
    from_timestamp: BoolArray
    with_acceleration: BoolArray
    phase_s: Array

    def periods_late(self, follower: int, sender: int) -> int:
        """Return how many control periods earlier than a follower its message's sender began.

        Args:
            follower: 0..n-1.
            sender: another follower.
        """
        age = float(np.nan_to_num(self.age_s[follower, sender + 1]))
        apart = float(self.phase_s[sender] - self.phase_s[follower])
        return round((age + apart) / self.dt)


def linearise_periods(flight: HeldFlight, periods: int) -> PeriodMaps:
    """Linearise the next control periods of a steady flight, and fly them.

    Args:
        flight: at a control step.
        periods: after which the flight repeats, but for its position and course.

    Raises:
        MarginsError: the memory of a user's law does not repeat with it.
    """
    states = FollowerStates(flight)
    control = flight.world.formation.built_control
    law = control.controllers["law"]
    turn = _turn_in(flight, periods)
    followers: dict[int, FollowerMap] = {}
    for group in _groups(flight, turn):
        parts = [_Period(flight, states, group).linearise() for _ in range(periods)]
        maps = [_stacked(each) for each in zip(*parts, strict=True)]
        if not control.builtin:
            maps = [_without_unused(each) for each in maps]
            _check_memory(flight, states, maps, group, periods * abs(turn))
        followers |= zip(group.rows, maps, strict=True)
    from_ned, _ = states.frames()
    flight.write_errors()
    return PeriodMaps(
        flight.dt,
        float(np.linalg.norm(flight.world.aircraft["truth"]["velocity_ned"][0])),
        tuple(followers[i] for i in sorted(followers)),
        np.array(flight.world.aircraft["truth"]["euler"][1:, 0]),
        flight.world.followers["error_ned"] @ from_ned.T,
        np.array(flight.world.links["age_s"]),
        turn,
        np.array(law["from_timestamp"]),
        np.array(law["with_acceleration"]),
        np.array(flight.world.clock.control_phases) / flight.world.clock.base_rate_hz,
    )


class _Group(NamedTuple):
    """Followers whose control steps are at the same ticks.

    Attributes:
        rows: of the n followers.
        phase_s: s, by which their control follows the leader's.
        turned: rad, of the leader's course in that time.
    """

    rows: list[int]
    phase_s: float
    turned: float


def _groups(flight: HeldFlight, turn: float) -> Iterator[_Group]:
    """Fly on to the next control step of each group of followers, and yield the group."""
    clock = flight.world.clock
    for rows in clock.groups:
        phase = clock.control_phases[rows[0]]
        tick = clock.ticks(flight.time_s)
        if ahead := (phase - tick) % clock.control:
            flight.fly_to(clock.time_s(tick + ahead))
        yield _Group(list(rows), phase / clock.base_rate_hz, turn * phase / clock.control)


def _turn_in(flight: HeldFlight, periods: int) -> float:
    """Return the angle by which the leader's course turns in a control period, rad."""
    present, inputs = flight.save(), flight.inputs
    inputs.end()

    def direction() -> Array:
        velocity: Array = np.array(flight.world.aircraft["truth"]["velocity_ned"][0, :2])
        return velocity

    before = direction()
    flight.fly_to(flight.time_s + periods * flight.dt)
    after = direction()
    present.restore()
    across = before[0] * after[1] - before[1] * after[0]
    return math.atan2(across, float(before @ after)) / periods


def linearise_control(flight: HeldFlight, maps: PeriodMaps) -> PeriodMaps:
    """Return the maps of a steady flight with the gains that its control has now.

    Aircraft and autopilots stay as they were linearised: law and middle loop alone are stepped.

    Args:
        flight: that has been linearised.
        maps: of it, with other gains and the same steady commands.
    """
    states, parts, present = FollowerStates(flight), dict[int, _ControlMap](), flight.save()
    for group in _groups(flight, maps.turn):
        parts |= zip(group.rows, _control_maps(flight, states, group), strict=True)
    present.restore()
    followers = [_with_control(old, parts[i]) for i, old in enumerate(maps.followers)]
    if not flight.world.formation.built_control.builtin:
        followers = [_without_unused(each) for each in followers]
    return replace(maps, followers=tuple(followers))


def _control_maps(flight: HeldFlight, states: FollowerStates, group: _Group) -> list[_ControlMap]:
    """Return the derivatives of a group's control in its next period, which is not flown."""
    present = flight.save()
    parts = _Period(flight, states, group, control_alone=True).linearise_control()
    flight.inputs.end()
    present.restore()
    return parts


def _without_unused(follower: FollowerMap) -> FollowerMap:
    """Return a map without the messages of followers that have no effect on it.

    A user's law may use any message, and receives all of them.
    """
    used = [
        j
        for j, each in follower.b_message.items()
        if j == 0 or max(np.abs(each).max(), np.abs(follower.d_message[j]).max()) > _NO_EFFECT
    ]
    return follower._replace(
        b_message={j: follower.b_message[j] for j in used},
        d_message={j: follower.d_message[j] for j in used},
    )


def _check_memory(
    flight: HeldFlight,
    states: FollowerStates,
    followers: Sequence[FollowerMap],
    group: _Group,
    turned: float,
) -> None:
    """Check that the derivatives of the memory of a user's law repeat in the leader's frame.

    A vector that turns with the aircraft and is taken as one that does not, or the reverse, has
    others after each turn.

    Args:
        flight: after the linearised periods.
        states: of its followers.
        followers: maps of a group.
        group: of these.
        turned: rad, of the leader's course in these periods.

    Raises:
        MarginsError: they do not repeat.
    """
    if not any(label.startswith(f"{LAW}/") for each in followers for label in each.labels):
        return
    tolerance = max(_REPEATED, _REPEATED_PER_TURN * turned)
    for old, new in zip(followers, _control_maps(flight, states, group), strict=True):
        own = np.array([label.startswith(f"{LAW}/") for label in old.labels])
        # only the derivatives with respect to other states and commands depend on the axes
        pairs = (
            (old.a[0][own][:, ~own], new.a[own][:, ~own]),
            (old.c_command[0][:, own].T, new.c_command[:, own].T),
        )
        fields = [label.partition("[")[0] for label in old.labels if label.startswith(f"{LAW}/")]
        used = _used(old, own)
        for before, after in pairs:
            for field in dict.fromkeys(fields):
                rows = np.array([each == field for each in fields])
                if not used[rows].any():  # as a number that is only logged
                    continue
                largest = float(np.abs(before[rows]).max())
                if np.abs(after - before)[rows].max() > tolerance * largest + _NO_EFFECT:
                    _refuse_memory(old.name, field.removeprefix(f"{LAW}/"))


def _used(follower: FollowerMap, own: BoolArray) -> BoolArray:
    """Return which numbers of a law's memory have an effect on a command or on another state.

    Args:
        follower: map of it.
        own: (S,) which of its numbers are memory of the law.
    """
    a = follower.a[0]
    outside = np.concatenate([a[~own][:, own], follower.c_command[0][:, own]])
    used: BoolArray = (np.abs(outside) > _NO_EFFECT).any(axis=0)
    within = np.abs(a[own][:, own]) > _NO_EFFECT
    for _ in range(len(used)):
        used = used | within[used].any(axis=0)
    return used


def _refuse_memory(follower: str, field: str) -> None:
    if field.endswith(NED):
        remedy = f"write a name without {NED}, if it does not turn with the aircraft"
    else:
        remedy = (
            f"write {field}{NED} if it is a vector of north, east and down, and let a law do the "
            "same in each of its steps"
        )
    raise MarginsError(
        f"controller.law: the effect of memory {field} of {follower} changes in a steady turn "
        f"({remedy})"
    )


def _with_control(follower: FollowerMap, control: _ControlMap) -> FollowerMap:
    """Return a follower's maps with other derivatives of its control.

    Where the state is the control's own memory they are the new ones. The rest of the state follows
    the commands.
    """
    own = np.array([label.startswith(CONTROL_MEMORY) for label in follower.labels])[:, np.newaxis]

    def replaced(old: Array, memory: Array, command: Array) -> Array:
        changed: Array = np.where(own, memory, old + follower.b_command @ command)
        return changed

    a = replaced(follower.a, control.a, control.c_command - follower.c_command)
    shape = np.ones((len(follower.a), 1, 1))
    nothing = np.zeros(1)
    b_message = {
        j: replaced(
            shape * follower.b_message.get(j, nothing),
            control.b_message[j],
            each - follower.d_message.get(j, nothing),
        )
        for j, each in control.d_message.items()
    }
    return follower._replace(
        a=a,
        c_command=shape * control.c_command,
        b_message=b_message,
        d_message={j: shape * each for j, each in control.d_message.items()},
    )


def _stacked(maps: Sequence[FollowerMap]) -> FollowerMap:
    """Stack the maps of one follower in several periods."""
    fields: list[Any] = []
    for each in zip(*maps, strict=True):
        if isinstance(each[0], dict):
            fields.append({j: np.stack([one[j] for one in each]) for j in each[0]})
        else:
            fields.append(np.stack(each) if isinstance(each[0], np.ndarray) else each[0])
    return FollowerMap(*fields)


class _Derivative(NamedTuple):
    """Derivatives by one number: of the state (S,), the outputs (14,) and the commands (3,)."""

    state: Array
    output: Array
    command: Array


class _ControlMap(NamedTuple):
    """Derivatives of one follower's control in a period, as those of FollowerMap.

    Rows of `a` and `b_message` that are not the control's own memory have no meaning.
    """

    a: Array
    c_command: Array
    b_message: dict[int, Array]
    d_message: dict[int, Array]


class _Period:
    """One control period of a group of followers that is flown with changes."""

    def __init__(
        self,
        flight: HeldFlight,
        states: FollowerStates,
        group: _Group,
        *,
        control_alone: bool = False,
    ) -> None:
        """Fly the period without changes, and keep its beginning and its end.

        Args:
            flight: at a control step of the group.
            states: of its followers.
            group: of followers that are linearised.
            control_alone: with changes, step the control alone.
        """
        self._control_alone = control_alone
        self._flight, self._states, self._rows = flight, states, group.rows
        self._begin, self._until = flight.save(), flight.time_s + flight.dt
        states.ahead = group.turned
        self._bases = {i: states.basis(i) for i in self._rows}
        self._from_ned, _ = states.frames()
        flight.inputs.end()
        # those that the control step uses; messages that arrive later in the period are others
        flight.inputs.held = flight.fly_on_with_messages(self._until)
        self._ends = {i: states.basis(i) for i in self._rows}
        self._end = flight.save()

    def linearise(self) -> list[FollowerMap]:
        """Return the maps of the followers, without an axis of periods, and end the period."""
        states, inputs = self._states, self._flight.inputs
        sizes = [len(states.labels[i]) for i in self._rows]
        by_state = [self._by_state(k) for k in range(max(sizes))]
        by_command = [self._by_command(k) for k in range(len(COMMANDS))]
        by_wind = [self._by_wind(k) for k in range(3)]
        by_message = self._by_messages()
        self._end.restore()
        inputs.end()
        maps = []
        for at, (i, size) in enumerate(zip(self._rows, sizes, strict=True)):
            own = [each[at] for each in by_state[:size]]
            maps.append(
                FollowerMap(
                    self._flight.world.names[i + 1],
                    states.labels[i],
                    _columns(each.state for each in own),
                    _columns(each.command for each in own),
                    _columns(each.output for each in own),
                    _columns(each[at].state for each in by_command),
                    _columns(each[at].state for each in by_wind),
                    *self._message_columns(by_message, at),
                )
            )
        return maps

    def linearise_control(self) -> list[_ControlMap]:
        """Return the derivatives of the followers' control."""
        sizes = [len(self._states.labels[i]) for i in self._rows]
        by_state = [self._by_state(k) for k in range(max(sizes))]
        by_message = self._by_messages()
        return [
            _ControlMap(
                _columns(each[at].state for each in by_state[:size]),
                _columns(each[at].command for each in by_state[:size]),
                *self._message_columns(by_message, at),
            )
            for at, size in enumerate(sizes)
        ]

    def _by_messages(self) -> dict[int, list[list[_Derivative]]]:
        """Return the derivatives by each number of each message, by the row of its sender."""
        used = self._neighbours[self._rows].any(axis=0)
        return {
            j: [self._by_message(j, k) for k in range(3 * len(MESSAGE if j else LEADER_MESSAGE))]
            for j in np.flatnonzero(used).tolist()
        }

    def _message_columns(
        self, by_message: dict[int, list[list[_Derivative]]], at: int
    ) -> tuple[dict[int, Array], dict[int, Array]]:
        """Return `b_message` and `d_message` of a follower of the group, by its position in it."""
        used = [j for j in by_message if self._neighbours[self._rows[at], j]]
        return (
            {j: _columns(each[at].state for each in by_message[j]) for j in used},
            {j: _columns(each[at].command for each in by_message[j]) for j in used},
        )

    @property
    def _neighbours(self) -> BoolArray:
        used: BoolArray = self._flight.world.formation.built_control.neighbours["used"]
        return used

    def _by_state(self, k: int) -> list[_Derivative]:
        """Return the derivatives of each follower by the k-th number of its state."""
        steps = np.ones(len(self._rows))
        those = [(at, i) for at, i in enumerate(self._rows) if k < len(self._states.labels[i])]
        for at, i in those:
            steps[at] = self._states.steps[i][k]

        def change(sign: float) -> None:
            for at, i in those:
                self._states.add(i, sign * steps[at] * self._bases[i][k])

        return self._differ(change, steps)

    def _by_command(self, k: int) -> list[_Derivative]:
        added = self._flight.inputs.added

        def change(sign: float) -> None:
            added[:, k] = sign * _COMMAND_STEP

        found = self._differ(change, np.full(len(self._rows), _COMMAND_STEP))
        added[:] = 0.0
        return found

    def _by_wind(self, axis: int) -> list[_Derivative]:
        wind = self._flight.world.aircraft["wind"]["wind_ned"]

        def change(sign: float) -> None:
            wind[1:] += sign * _WIND_STEP * self._from_ned[axis]
            self._flight.fleet.write_wind(self._flight.time_s)

        return self._differ(change, np.full(len(self._rows), _WIND_STEP))

    def _by_message(self, sender: int, k: int) -> list[_Derivative]:
        messages = self._flight.inputs.messages
        axis, first = k % 3, k - k % 3
        turned = first < 3 * len(MESSAGE)  # angles and their rates are not turned
        direction = self._from_ned[axis] if turned else np.eye(3)[axis]
        step = _MESSAGE_STEP if turned else _ANGLE_STEP

        def change(sign: float) -> None:
            messages[:] = 0.0
            messages[:, sender, first : first + 3] = sign * step * direction

        found = self._differ(change, np.full(len(self._rows), step))
        messages[:] = 0.0
        return found

    def _differ(self, change: Callable[[float], None], steps: Array) -> list[_Derivative]:
        """Return the central differences of each follower.

        Args:
            change: makes the change, with a sign.
            steps: of each follower's number.
        """
        later, sooner = self._fly(change, 1.0), self._fly(change, -1.0)
        return [
            _Derivative(*((a - b) * (0.5 / step) for a, b in zip(one, other, strict=True)))
            for one, other, step in zip(later, sooner, steps.tolist(), strict=True)
        ]

    def _fly(self, change: Callable[[float], None], sign: float) -> list[_Derivative]:
        """Fly the period with a change: states at its end, outputs at its begin, commands."""
        flight, inputs = self._flight, self._flight.inputs
        self._begin.restore()
        change(sign)
        flight.write_motion()
        flight.write_errors()
        outputs = [self._outputs(i) for i in self._rows]
        if self._control_alone:
            flight.step_control()
        else:
            flight.fly_to(self._until)
        return [
            _Derivative(self._ends[i] @ self._states.read(i), output, inputs.computed[i].copy())
            for i, output in zip(self._rows, outputs, strict=True)
        ]

    def _outputs(self, i: int) -> Array:
        """Return message, error, roll and pitch of a follower."""
        world, from_ned = self._flight.world, self._from_ned
        own = world.aircraft["estimate"][i + 1]
        message = [from_ned @ own[name] for name in MESSAGE]
        error = from_ned @ world.followers["error_ned"][i]
        return np.concatenate((*message, error, own["euler"][:2]))


def _columns(vectors: Any) -> Array:  # noqa: ANN401 - an iterator of arrays
    return np.stack(list(vectors), axis=-1)
