"""The map of one control period of each follower in steady flight, linearised.

A formation flies steadily behind a virtual leader. Then one control period is flown again and
again, each time with one number of the followers' state, one message or one command changed a
little, and central differences are taken. The state of a follower is that of its flight model, its
autopilot, its middle loop and its filter of the leader's messages; messages are inputs, so that a
graph, delays and losses are joined to the maps afterwards (`linear_formation`).

Vectors are resolved in the leader's horizontal frame: forward, right, down. In it the maps of
periods that the flight repeats are equal, straight or turning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.frames import course
from testbed.core.records import Array, BoolArray, Records
from testbed.trials.held_flight import LEADER_MESSAGE, MESSAGE, HeldFlight
from testbed.vehicle.compiled.columns import CONSTANTS, CONTROLS, START, WIND
from testbed.vehicle.compiled.frame import quaternion_of

_STEP = 1e-5  # of the central differences, times the scale of a number
_SCALES = (  # of numbers whose steps are not 1e-5, by the beginning of their names
    ("position/", 100.0),
    ("velocities/eci", 10.0),
    ("memory/velocity", 10.0),
    ("memory/acceleration", 10.0),
    ("accelerations/", 10.0),
    ("propulsion/", 1000.0),
    ("autopilot/pressure", 100.0),
)
_INERTIAL = ("position/eci-", "velocities/eci-", "memory/velocity_", "memory/acceleration_")
_ATTITUDE = ("attitude/eci-", "memory/attitude_dot_")


class FollowerMap(NamedTuple):
    """The linearised control period of one follower, for P periods after which the flight repeats.

    Of a state deviation x (S,), messages m (M,) of an aircraft that are used at the control step,
    and additions v (3,) to the commands:

        x⁺ = a x + Σ b_message[j] m_j + b_command v
        commands before the addition = c_command x + Σ d_message[j] m_j

    Attributes:
        name: of the follower.
        labels: (S,) of the state.
        a: (P, S, S).
        b_command: (P, Q, S, 3) of pitch, roll, rad, and throttle, each added in one of the Q
            periods of the autopilot in a control period; the sum is that of a whole period.
        c_command: (P, 3, S).
        b_message: by the row of the sender, (P, S, M).
        d_message: the same, (P, 3, M).
        c_message: (P, 9, S) its own message: position, m, velocity, m/s, acceleration, m/s².
        c_error: (P, 3, S) its slot error forward, right and down, m, with the leader's slot held.
        c_attitude: (P, 2, S) roll and pitch, rad.
        updates_airspeed: (P,) whether the autopilot's airspeed filters step in the period.
    """

    name: str
    labels: tuple[str, ...]
    a: Array
    b_command: Array
    c_command: Array
    b_message: dict[int, Array]
    d_message: dict[int, Array]
    c_message: Array
    c_error: Array
    c_attitude: Array
    updates_airspeed: Array


@dataclass(frozen=True, slots=True)
class PeriodMaps:
    """The linearised control period of a formation in steady flight.

    Attributes:
        dt: s, control period.
        followers: n.
        bank: (n,) rad, of the followers.
        error_ned: (n, 3) m, their steady slot errors, forward, right, down in the leader's frame.
        age_s: (n, N) s, ages of the messages used; NaN: not used.
        turn: (3, 3) rotation of a vector that keeps its direction, from one period to the next.
        from_timestamp: (n,) whether a follower extrapolates messages from their time stamps.
        with_acceleration: (n,) whether it does so along a parabola.
    """

    dt: float
    followers: tuple[FollowerMap, ...]
    bank: Array
    error: Array
    age_s: Array
    turn: Array
    from_timestamp: BoolArray
    with_acceleration: BoolArray


class _Numbers(NamedTuple):
    """Some consecutive numbers of a state: views of where the flight has them."""

    names: tuple[str, ...]
    view: Array
    kind: str  # "scalar", "inertial", "attitude" or "ned"


class PeriodLinearisation:
    """Flies control periods of a steady flight with small changes."""

    def __init__(self, flight: HeldFlight) -> None:
        """Take a flight that is steady.

        Args:
            flight: whose time is that of a control step.
        """
        self._flight, self._world = flight, flight.world
        self._states = [list(self._numbers_of(i)) for i in range(len(flight.world.followers))]
        self._signs: list[Array | None] = [None] * len(self._states)

    # the state

    def _numbers_of(self, i: int) -> Iterator[_Numbers]:
        """Yield the state of a follower."""
        row = self._flight.vehicles.rows.tolist().index(i + 1)
        [(aircraft, state)] = [
            (kind.aircraft, kind.state) for kind in self._flight.fleet.kinds if row in kind.which
        ]
        constant = {name for each in (*CONSTANTS, CONTROLS, WIND) for name in each.columns}
        skipped = constant | {"position/epa-rad"}
        names, at = list(aircraft.columns), 0
        while at < len(names):
            name, width, kind = names[at], 1, "scalar"
            if name.startswith(_INERTIAL) or START["acceleration"] == at:
                width, kind = 3, "inertial"
            elif name.startswith(_ATTITUDE):
                width, kind = 4, "attitude"
            if name not in skipped:
                yield _Numbers(tuple(names[at : at + width]), state[row, at : at + width], kind)
            at += width
        controls = tuple(f"last {name}" for name in CONTROLS.columns)
        yield _Numbers(controls, self._flight.fleet.last_controls[row], "scalar")
        autopilots, formation = self._flight.vehicles.autopilots, self._world.formation
        yield from _float_fields("autopilot", autopilots.memory, row, skip=("slew",))
        delayed = autopilots.delay_line[row].reshape(-1)
        labels = tuple(f"autopilot/delay-{k}" for k in range(len(delayed)))
        yield _Numbers(labels, delayed, "scalar")
        controllers = formation.built_control.controllers
        yield from _float_fields("middle loop", controllers["integrals"], i)
        yield from _float_fields("leader filter", controllers["leader"], i, skip=("time_s",))

    def _read(self, i: int) -> Array:
        return np.concatenate([each.view for each in self._states[i]])

    def _add(self, i: int, change: Array) -> None:
        """Add to the state of a follower."""
        at = 0
        for each in self._states[i]:
            each.view[:] += change[at : at + len(each.view)]
            at += len(each.view)

    def _frames(self) -> tuple[Array, Array]:
        """Return the rotations (3, 3) from NED, and from inertial axes, to the leader's frame."""
        turn = float(course(self._world.aircraft["truth"]["velocity_ned"][0]))
        c, s = math.cos(turn), math.sin(turn)
        from_ned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        origin = self._world.info.origin
        lat, lon = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        kind = self._flight.fleet.kinds[0]
        angle = float(kind.state[kind.which[0], START["earth_angle"]])
        sl, cl, so, co = math.sin(lat), math.cos(lat), math.sin(lon + angle), math.cos(lon + angle)
        to_ned = np.array([[-co * sl, -so * sl, cl], [-so, co, 0.0], [-co * cl, -so * cl, -sl]])
        return from_ned, from_ned @ to_ned

    def _basis(self, i: int) -> Array:
        """Return the orthogonal matrix (S, S) from the numbers of a state to the leader's frame."""
        from_ned, from_inertial = self._frames()
        to_frame = quaternion_of(tuple(map(tuple, from_inertial.tolist())))
        turned = _left_product((to_frame[0], -to_frame[1], -to_frame[2], -to_frame[3]))
        blocks: dict[str, Array] = {"inertial": from_inertial, "ned": from_ned}
        size = sum(len(each.view) for each in self._states[i])
        basis, at = np.eye(size), 0
        for each in self._states[i]:
            width = len(each.view)
            if each.kind == "attitude":
                if each.names[0].startswith("attitude/"):
                    # a rotation has two quaternions: keep to one of them
                    own = turned @ each.view
                    before = self._signs[i]
                    if before is None:
                        self._signs[i] = before = own
                    if own @ before < 0.0:
                        turned = -turned
                basis[at : at + 4, at : at + 4] = turned
            elif each.kind != "scalar":
                basis[at : at + 3, at : at + 3] = blocks[each.kind]
            at += width
        return basis

    def maps(self, periods: int) -> PeriodMaps:
        """Linearise the next control periods.

        Args:
            periods: after which the flight repeats, but for its position and course.
        """
        before, _ = self._frames()
        parts = [self._next_period() for _ in range(periods)]
        n = len(self._states)
        joined = []
        for i in range(n):
            each = [part[i] for part in parts]
            senders = list(each[0].b_message)
            joined.append(
                FollowerMap(
                    self._world.names[i + 1],
                    each[0].labels,
                    *(np.stack([getattr(one, key) for one in each]) for key in _STACKED[:3]),
                    *(
                        {j: np.stack([getattr(one, key)[j] for one in each]) for j in senders}
                        for key in ("b_message", "d_message")
                    ),
                    *(np.stack([getattr(one, key) for one in each]) for key in _STACKED[3:]),
                    np.array([one.updates_airspeed for one in each]),
                )
            )
        from_ned, _ = self._frames()
        self._flight.write_errors()
        law = self._world.formation.built_control.controllers["law"]
        followers = self._world.followers
        return PeriodMaps(
            self._flight.dt,
            tuple(joined),
            np.array(self._world.aircraft["truth"]["euler"][1:, 0]),
            followers["error_ned"] @ from_ned.T,
            np.array(self._world.links["age_s"]),
            _fraction(from_ned @ before.T, periods),
            *(np.array(law[name]) for name in ("from_timestamp", "with_acceleration")),
        )

    def _next_period(self) -> list[FollowerMap]:
        """Linearise the next control period, and fly it."""
        n, inputs, world = len(self._states), self._flight.inputs, self._world
        begin = self._flight.save()
        until = self._flight.time_s + self._flight.dt
        bases = [self._basis(i) for i in range(n)]
        from_ned, _ = self._frames()
        memory = self._flight.vehicles.autopilots.memory
        first = memory["period"].copy()
        inputs.held = None
        self._flight.fly_to(until)
        # the links at the end are those of the control step: there is one in a period
        inputs.held = world.links.copy()
        ends = [self._basis(i) for i in range(n)]
        end = self._flight.save()
        every = self._flight.vehicles.autopilots.gains["airspeed_periods"]
        updates = (memory["period"] - 1) // every > (first - 1) // every

        def probe(change: Callable[[], None]) -> tuple[list[Array], list[Array], Array]:
            """Fly the period with a change: states at its end, outputs at its start, commands."""
            begin.restore()
            change()
            self._flight.write_motion()
            self._flight.write_errors()
            outputs = [self._outputs(i, from_ned) for i in range(n)]
            self._flight.fly_to(until)
            states = [ends[i] @ self._read(i) for i in range(n)]
            return states, outputs, inputs.computed.copy()

        def differ(
            change: Callable[[float], None], step: Array
        ) -> Iterator[tuple[Array, Array, Array]]:
            """Yield for each follower the derivatives of state, outputs and commands."""
            later, sooner = (probe(lambda sign=sign: change(sign)) for sign in (1.0, -1.0))
            for i in range(n):
                by = 0.5 / step[i]
                yield tuple(
                    (one[i] - other[i]) * by for one, other in zip(later, sooner, strict=True)
                )

        sizes = [len(basis) for basis in bases]
        steps = [_STEP * self._scales(i) for i in range(n)]
        a = [np.zeros((size, size)) for size in sizes]
        c = [np.zeros((_OUTPUTS, size)) for size in sizes]
        c_command = [np.zeros((3, size)) for size in sizes]
        for k in range(max(sizes)):
            step = np.array([steps[i][k] if k < sizes[i] else 1.0 for i in range(n)])

            def change(sign: float, k: int = k) -> None:
                for i in range(n):
                    if k < sizes[i]:
                        self._add(i, sign * steps[i][k] * bases[i][k])

            for i, found in enumerate(differ(change, step)):
                if k < sizes[i]:
                    a[i][:, k], c[i][:, k], c_command[i][:, k] = found
        parts = len(inputs.added)
        b_command = [np.zeros((parts, size, 3)) for size in sizes]
        for part, k in np.ndindex(parts, 3):

            def command(sign: float, part: int = part, k: int = k) -> None:
                inputs.added[part, :, k] = sign * _STEP

            for i, (state, _, _) in enumerate(differ(command, np.full(n, _STEP))):
                b_command[i][part, :, k] = state
            inputs.added[:] = 0.0
        b_message: list[dict[int, Array]] = [{} for _ in range(n)]
        d_message: list[dict[int, Array]] = [{} for _ in range(n)]
        used = world.formation.built_control.neighbours["used"]
        for j in np.flatnonzero(used.any(axis=0)).tolist():
            width = 3 * len(LEADER_MESSAGE if j == 0 else MESSAGE)
            for i in np.flatnonzero(used[:, j]).tolist():
                b_message[i][j] = np.zeros((sizes[i], width))
                d_message[i][j] = np.zeros((3, width))
            for k in range(width):

                def send(sign: float, j: int = j, k: int = k) -> None:
                    first_of = k - k % 3
                    inputs.messages[:, j, first_of : first_of + 3] = (
                        sign * 0.01 * from_ned[k % 3] if k < 9 else 0.0
                    )
                    if k >= 9:
                        inputs.messages[:, j, k] = sign * 0.01

                for i, (state, _, computed) in enumerate(differ(send, np.full(n, 0.01))):
                    if used[i, j]:
                        b_message[i][j][:, k], d_message[i][j][:, k] = state, computed
                inputs.messages[:] = 0.0
        end.restore()
        inputs.end()
        return [
            FollowerMap(
                world.names[i + 1],
                tuple(name for each in self._states[i] for name in each.names),
                a[i],
                b_command[i],
                c_command[i],
                b_message[i],
                d_message[i],
                c[i][:9],
                c[i][9:12],
                c[i][12:],
                updates[i],
            )
            for i in range(n)
        ]

    def _outputs(self, i: int, from_ned: Array) -> Array:
        """Return message, error and attitude of a follower, in the leader's frame."""
        own = self._world.aircraft["estimate"][i + 1]
        message = [from_ned @ own[name] for name in MESSAGE]
        error = from_ned @ self._world.followers["error_ned"][i]
        return np.concatenate((*message, error, own["euler"][:2]))

    def _scales(self, i: int) -> Array:
        names = [name for each in self._states[i] for name in each.names]
        scales = np.ones(len(names))
        for k, name in enumerate(names):
            for start, scale in _SCALES:
                if name.startswith(start):
                    scales[k] = scale
        return scales


_STACKED = ("a", "b_command", "c_command", "c_message", "c_error", "c_attitude")
_OUTPUTS = 3 * len(MESSAGE) + 3 + 2


def _float_fields(
    owner: str, records: Records, row: int, skip: Sequence[str] = ()
) -> Iterator[_Numbers]:
    """Yield the float fields of a record that have a value, those of records in it, too."""
    for name in records.dtype.names or ():
        inner = records.dtype[name]
        if name in skip:
            continue
        if inner.names:
            yield from _float_fields(f"{owner}/{name}", records[name], row)
        elif inner.base == np.float64:
            view = records[name][row : row + 1].reshape(-1)
            if np.isfinite(view).all():
                width, kind = len(view), "scalar"
                if width == 3:
                    kind = "ned"
                names = tuple(f"{owner}/{name}{k if width > 1 else ''}" for k in range(width))
                yield _Numbers(names, view, kind)


def _left_product(q: tuple[float, float, float, float]) -> Array:
    """Return the matrix (4, 4) of the product q ⊗ ·."""
    a, b, c, d = q
    return np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])


def _fraction(turn: Array, periods: int) -> Array:
    """Return the rotation about the vertical whose power is another."""
    angle = math.atan2(turn[0, 1], turn[0, 0]) / periods
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
