"""Step the followers' control: groups of followers, each by its law and middle loop."""

from __future__ import annotations

import inspect
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.errors import FlightError, InputError, describe_error
from testbed.core.frames import course, flight_path_angle
from testbed.core.interrupts import Interrupt
from testbed.core.records import (
    Array,
    BoolArray,
    Event,
    FbwaCommand,
    Inbox,
    Indices,
    Records,
    UnicycleCommand,
    VehicleState,
    fields_of,
)
from testbed.flight.vehicles import Steps
from testbed.formation.control_step import control_step, finish_step
from testbed.formation.law import FormationConfig, Law, LimiterFlag, Saturation
from testbed.formation.message_extrapolation import message_ages

if TYPE_CHECKING:
    from testbed.flight.companion import Companions
    from testbed.flight.membership import FormationMembership

LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
# what `_step` does: the law of [HBH23] with its middle loop, or after a user's law the middle loop
# and message ages, or these alone
_LAW, _MIDDLE_LOOP, _AGES = 0, 1, 2
_UNKNOWN = ("speed_desired", "airspeed_command", "course_desired", "flight_path_angle_desired")


@dataclass(frozen=True)
class ControlGroup:
    """Followers whose control steps at the same ticks."""

    rows: Indices  # (m,) among the n followers
    config: FormationConfig
    law: Law | None  # a user's law; None: that of [HBH23]


class Control:
    """Step the control of n followers on the records of the run.

    Attributes:
        offsets: υ (N, 3) m of the followers' present slots.
        left: (n,) followers that have left the formation.
    """

    def __init__(
        self,
        groups: tuple[ControlGroup, ...],
        controllers: Records,
        neighbours: Records,
        offsets: Array,
        membership: FormationMembership | None,
        run: tuple[Records, Records, Records],
        companions: Companions | None = None,
    ) -> None:
        """Start before the first step; outputs are NaN.

        Args:
            groups: of followers; each follower is in one.
            controllers: (n,) of CONTROLLER.
            neighbours: (n, N) of NEIGHBOUR.
            offsets: υ (N, 3) m of the followers' slots, the leader's zero first.
            membership: responses to declared failures; None: none.
            run: AIRCRAFT (N,), FOLLOWER (n,) and LINK (n, N).
            companions: that run the control; None: the autopilots' estimates are at hand.
        """
        self.groups, self.offsets, self._membership = groups, offsets, membership
        self._aircraft, self._followers, self._links = run
        self._companions = companions
        # whose estimates the laws have
        self._own = companions.aircraft if companions else self._aircraft
        self._neighbours = neighbours
        for name in _UNKNOWN:
            self._followers[name] = np.nan
        self._followers["slot_index"] = np.arange(1, len(offsets))
        self._links["age_s"] = np.nan
        self.left: BoolArray = np.zeros(len(self._followers), dtype=bool)
        self._memory: list[Any] = [None] * len(groups)
        self._use_all_messages()
        parts = controllers, neighbours, self._own, *run
        self._parts = parts
        # of groups with a user's law: what comes after that, with and without middle loop
        self._finish = [
            tuple(Call(_step, group.rows, *parts, what, NOW) for what in (_AGES, _MIDDLE_LOOP))
            if group.law is not None
            else ()
            for group in groups
        ]

    def _use_all_messages(self) -> None:
        """Mark all messages as used by users' laws, because their use is not known."""
        for group in self.groups:
            if group.law is not None:
                self._neighbours["used"][group.rows] = True

    @property
    def has_membership(self) -> bool:
        """Whether followers respond to declared failures."""
        return self._membership is not None

    def update_membership(self, number: int, now: float) -> list[Event]:
        """Step the responses of a group's followers to declared failures; return events.

        Args:
            number: of the group.
            now: s.
        """
        membership = self._membership
        if membership is None:
            return []
        inbox = fields_of(Inbox, self._links)
        measured_s = np.ascontiguousarray(self._links["measured_s"])
        events = list(membership.changes(now, self.groups[number].rows, inbox, measured_s))
        if events:
            membership.write_neighbours(self._neighbours)
            self._use_all_messages()
            self.offsets[:] = membership.offsets
            self._followers["slot_index"] = membership.slots
            self.left = membership.left
        return events

    def steps(self, number: int) -> Steps:
        """Return the steps of a group's control."""
        group, companions = self.groups[number], self._companions
        step: Call | Callable[[float], None] = (
            Call(_step, group.rows, *self._parts, _LAW, NOW)
            if group.law is None
            else partial(self._step_user_law, number, group, group.law)
        )
        if companions is None:
            return (step,)
        return companions.receive_states, step, companions.send_commands(group.rows)

    def _step_user_law(self, number: int, group: ControlGroup, law: Law, now: float) -> None:
        """Step a group by a user's law, which receives copies of its inputs."""
        rows, followers = group.rows, self._followers
        estimate = fields_of(VehicleState, self._own["estimate"])
        own = VehicleState(*(each[1:][rows] for each in estimate))
        inbox = Inbox(*(each[rows] for each in fields_of(Inbox, self._links)))
        excluded = self._neighbours["excluded"][rows]
        if excluded.any():
            for each in inbox:
                each[excluded] = np.nan
        try:
            with user_code_errors(law_file(law)):
                known = self._memory[number]
                memory = law.start(own) if known is None else known[0]
                command, memory = law.step(now, own, inbox, memory)
                command = validate_command(command, group.config, now)
        except InputError as error:
            raise FlightError(str(error)) from error
        self._memory[number] = (memory,)
        if isinstance(command, UnicycleCommand):
            followers["speed_command"][rows] = command.speed
            for name in ("omega", "speed_desired", "direction", "limiter_flags"):
                followers[name][rows] = getattr(command, name)
            self._finish[number][True](now)
        else:
            self._write_fbwa(command, own, group)
            self._finish[number][False](now)
        timed_out = rows[np.isnan(self._links["age_s"][rows, 0])]
        followers["limiter_flags"][timed_out] |= LEADER_TIMEOUT

    def _write_fbwa(
        self, command: FbwaCommand[Array], own: VehicleState, group: ControlGroup
    ) -> None:
        """Write a fly-by-wire-A command, limited; desired speeds are NaN."""
        config, rows, followers = group.config, group.rows, self._followers
        pitch = np.clip(command.pitch, -config.pitch_limit, config.pitch_limit)
        roll = np.clip(command.roll, -config.roll_limit, config.roll_limit)
        throttle = np.clip(command.throttle, 0.0, 1.0)
        control = self._aircraft["control"]
        for name, array in (("pitch", pitch), ("roll", roll), ("throttle", throttle)):
            control[name][1:][rows] = array
        motion = own.velocity_ned / np.linalg.norm(own.velocity_ned, axis=1, keepdims=True)
        followers["speed_command"][rows] = followers["omega"][rows] = np.nan
        followers["speed_desired"][rows] = followers["airspeed_command"][rows] = np.nan
        followers["direction"][rows] = motion
        followers["course_desired"][rows] = course(motion)
        followers["flight_path_angle_desired"][rows] = flight_path_angle(motion)
        followers["limiter_flags"][rows] = 0
        followers["saturations"][rows] = (
            (pitch != command.pitch) * int(Saturation.PITCH)
            + (roll != command.roll) * int(Saturation.ROLL)
            + (throttle != command.throttle) * int(Saturation.THROTTLE)
        )


@entry
def _step(
    rows: Indices,
    controllers: Records,
    neighbours: Records,
    own: Records,
    aircraft: Records,
    followers: Records,
    links: Records,
    what: int,
    now: float,
) -> None:
    """Step the followers in these rows (m,), with the estimates of `own`, by one of the parts."""
    for i in rows:
        estimate, control = own[i + 1].estimate, aircraft[i + 1].control
        controller, link, neighbour = controllers[i], links[i], neighbours[i]
        if what == _LAW:
            control_step(controller, now, estimate, link, neighbour, followers[i], control)
        elif what == _MIDDLE_LOOP:
            finish_step(controller, now, estimate, link, neighbour, False, followers[i], control)
        else:
            message_ages(now, neighbour, False, link)


@contextmanager
def user_code_errors(file: str, what: str = "the law") -> Iterator[None]:
    """Turn exceptions of a user's code into errors with file and line.

    Also those that would end the program, as of `sys.exit()`: a flight that is cut short by its law
    is not a success.

    Args:
        file: of the code.
        what: the code is.

    Raises:
        InputError: for every other exception but those of signals.
        MemoryError: the code had too little memory.
    """
    try:
        yield
    except (InputError, Interrupt):
        raise
    except BaseException as error:
        by_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if isinstance(error, KeyboardInterrupt) and by_default:  # then it is no Interrupt
            raise
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == file]
        location = f"{file}:{lines[-1]}" if lines else file
        if isinstance(error, MemoryError):  # of this machine; what asks for too much has a place
            raise MemoryError(f"{location}: {what}: {describe_error(error)}") from error
        raise InputError(f"{location}: {what} raised {type(error).__name__}: {error}") from error


def law_file(law: object) -> str:
    """Return the file in which a law's class is defined; its module if that is no Python file."""
    try:
        return inspect.getfile(type(law))
    except (TypeError, OSError):
        return type(law).__module__


def validate_command(
    command: object, config: FormationConfig, now: float
) -> UnicycleCommand | FbwaCommand[Array]:
    """Check the command of a user's law, and return it with arrays of full shape.

    Args:
        command: as the law returned it.
        config: of the law's followers.
        now: s, for the message.

    Raises:
        InputError: the command has another type or shape, or is not finite.
    """
    n = len(config.names)
    if not isinstance(command, UnicycleCommand | FbwaCommand):
        raise InputError(
            f"controller.law: the law returned {type(command).__name__} at {now:g} s (return a "
            "UnicycleCommand or an FbwaCommand, and the memory)"
        )
    fields = []
    for name, value in zip(command._fields, command, strict=True):
        shape = (n, 3) if name in ("omega", "direction") else (n,)
        kind = np.uint8 if name == "limiter_flags" else np.float64
        try:
            array = np.ascontiguousarray(np.broadcast_to(np.asarray(value, dtype=kind), shape))
        except (TypeError, ValueError, OverflowError):
            array = None
        if array is None:
            raise InputError(
                f"controller.law: the law's {name} is not an array of shape {shape} at {now:g} s "
                f"(one row for each of {', '.join(config.names)})"
            )
        wrong = np.flatnonzero(~np.isfinite(array).reshape(n, -1).all(axis=1))
        if len(wrong):
            raise InputError(
                f"controller.law: the law's {name} for {config.names[wrong[0]]} is not a finite "
                f"number at {now:g} s"
            )
        fields.append(array)
    return type(command)(*fields)
