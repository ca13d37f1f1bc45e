"""Step the followers' control: groups of followers, each by its law and middle loop."""

from __future__ import annotations

import inspect
import signal
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import atan2, isnan, nan
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from testbed.core.call_list import NOW, Call, Steps
from testbed.core.compile import entry, kernel
from testbed.core.errors import FlightError, InputError, describe_error
from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.frames import course, flight_path_angle, gamma_of, norm
from testbed.core.interrupts import Interrupt
from testbed.core.records import (
    Array,
    BoolArray,
    Event,
    FbwaCommand,
    Inbox,
    Indices,
    OwnState,
    Record,
    Records,
    UnicycleCommand,
    Vector,
)
from testbed.flight.law_inputs import Declared, WindEstimates, give_inputs
from testbed.flight.law_reports import LawReports
from testbed.formation import barrier
from testbed.formation.barrier import sample_barrier
from testbed.formation.compiled_law import (
    UNICYCLE,
    CompiledLaw,
    LawCommand,
    allocate_command,
    allocate_inputs,
)
from testbed.formation.control_step import control_step, finish_step
from testbed.formation.law import FormationConfig, Law
from testbed.formation.law_outputs import Outputs, outputs_of
from testbed.formation.message_extrapolation import message_ages

if TYPE_CHECKING:
    from testbed.flight.companion import Companions
    from testbed.flight.membership import FormationMembership

LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
PITCH, ROLL, THROTTLE = int(Saturation.PITCH), int(Saturation.ROLL), int(Saturation.THROTTLE)
_UNKNOWN = ("speed_desired", "airspeed_command", "course_desired", "flight_path_angle_desired")


@dataclass(frozen=True)
class ControlGroup:
    """Followers whose control steps at the same ticks."""

    rows: Indices  # (m,) among the n followers
    config: FormationConfig
    law: Law | None  # a user's law; None: that of [HBH23]


@dataclass(frozen=True)
class BuiltControl:
    """The control of n followers, before the first step."""

    config: FormationConfig  # of all followers
    groups: tuple[ControlGroup, ...]
    controllers: Records  # (n,) of CONTROLLER
    neighbours: Records  # (n, N) of NEIGHBOUR
    builtin: bool  # the law is that of [HBH23]
    hold_stale_neighbours: bool
    messages: tuple[str, ...]  # about a user's code
    extrapolates: bool = False  # a user's law receives messages extrapolated to the present

    @property
    def outputs(self) -> Outputs:
        """What a user's law gives besides commands."""
        return outputs_of(self.groups[0].law)

    @property
    def barriers(self) -> tuple[tuple[int, float], ...]:
        """Example and ν of each follower's barrier, 0 for a user's; empty for a user's law."""
        records = self.controllers["law"]["barrier"]
        pairs = zip(records["example"].tolist(), records["nu"].tolist(), strict=True)
        return tuple(pairs) if self.builtin else ()

    @property
    def barrier_samples(self) -> tuple[tuple[float, ...], ...]:
        """Samples of each follower's barrier if it is a user's; empty if none is."""
        if not self.builtin:
            return ()
        bounds = (self.config.airspeed_min.tolist(), self.config.airspeed_max.tolist())
        each = barrier.barriers_of(self.controllers["law"]["barrier"])
        samples = tuple(sample_barrier(*one) for one in zip(each, *bounds, strict=True))
        return samples if any(samples) else ()


def _memory_key(number: int, group: ControlGroup) -> str:
    kind = type(group.law)
    return f"{number} {kind.__module__}.{kind.__qualname__}"


@dataclass(frozen=True, slots=True)
class LawSurroundings:
    """What a user's law reads besides estimates and motions, and what it gives besides commands."""

    ADDRESSES: ClassVar = ("declared",)  # faults, whose records are taken over one by one
    wind: WindEstimates
    declared: Declared
    payloads: Array  # (n, N, K) numbers of the law in the newest messages
    reports: LawReports


class Control:
    """Step the control of n followers on the records of the run.

    Attributes:
        offsets: υ (N, 3) m of the followers' present slots.
        left: (n,) followers that have left the formation.
        reports: outputs of a user's law.
    """

    def __init__(
        self,
        groups: tuple[ControlGroup, ...],
        controllers: Records,
        neighbours: Records,
        offsets: Array,
        membership: FormationMembership | None,
        run: tuple[Records, Records, Records],
        surroundings: LawSurroundings,
        companions: Companions | None = None,
        *,
        extrapolates: bool = False,
    ) -> None:
        """Start before the first step; outputs are NaN.

        Args:
            groups: of followers; each follower is in one.
            controllers: (n,) of CONTROLLER.
            neighbours: (n, N) of NEIGHBOUR.
            offsets: υ (N, 3) m of the followers' slots, the leader's zero first.
            membership: responses to declared failures; None: none.
            run: AIRCRAFT (N,), FOLLOWER (n,) and LINK (n, N).
            surroundings: of a user's law.
            companions: that run the control; None: the autopilots' estimates are at hand.
            extrapolates: a user's law receives messages that are extrapolated to the present.
        """
        self._extrapolates = extrapolates
        self._surroundings, self.reports = surroundings, surroundings.reports
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
        # by group and law: of another law there is no counterpart
        self._memory: dict[str, Any] = {_memory_key(*each): None for each in enumerate(groups)}
        self._use_all_messages()
        self._parts = controllers, neighbours, self._own, *run

    @property
    def responds(self) -> bool:
        """Whether followers respond to declared failures."""
        return self._membership is not None

    def _use_all_messages(self) -> None:
        """Mark all messages as used by users' laws, because their use is not known."""
        for group in self.groups:
            if group.law is not None:
                self._neighbours["used"][group.rows] = True

    def membership_call(self, number: int) -> Call | None:
        """Return the call after which `update_membership` is needed where it returns true.

        Args:
            number: of the group; None is returned where none responds.
        """
        if self._membership is None:
            return None
        return self._membership.bind(self.groups[number].rows, self._links)

    def update_membership(self, number: int, now: float) -> list[Event]:
        """Step the responses of a group's followers to declared failures; return events.

        Args:
            number: of the group.
            now: s.
        """
        membership = self._membership
        if membership is None:
            return []
        events = list(membership.changes(now, self.groups[number].rows, self._links))
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
        steps: Steps
        if group.law is None:
            steps = (Call(_step, group.rows, *self._parts, NOW),)
        elif isinstance(group.law, CompiledLaw):
            steps = self.compiled_law_steps(group, group.law)
        else:
            sent = outputs_of(group.law).sent_numbers
            inputs = allocate_inputs(len(group.rows), self._links.shape[1], sent)
            command = allocate_command(len(group.rows))
            before, after = self._inputs_call(group, *inputs), self._finish_call(group, command)
            steps = (
                before,
                partial(self._step_user_law, number, group.law, inputs, command, after),
            )
        if companions is None:
            return steps
        return *companions.before_control, *steps, companions.send_commands(group.rows)

    def compiled_law_steps(self, group: ControlGroup, law: CompiledLaw) -> Steps:
        """Return the steps of a group with a user's kernel, which may be another than its own."""
        then = partial(_report_command, law, group.config)
        steps: Steps = (
            self._inputs_call(group, law.own, law.inbox),
            (law.call, then),
            self._finish_call(group, law.command),
        )
        if law.memory is None or not law.outputs.fields:
            return steps
        return *steps, self.reports.copy_call(group.rows, law.memory)

    def changed_call(self, number: int) -> Call | None:
        """Return the call after which `law_events` is needed where it returns true.

        Args:
            number: of the group; None is returned where its law declares no events.
        """
        if not self.reports.outputs.events:
            return None
        return self.reports.changed_call(self.groups[number].rows)

    def law_events(self, number: int, now: float) -> list[Event]:
        """Return the events of a group's law since the last call.

        Args:
            number: of the group.
            now: s.
        """
        return list(self.reports.changes(self.groups[number].rows, now))

    def _inputs_call(self, group: ControlGroup, own: OwnState, inbox: Inbox) -> Call:
        """Return what gives a user's law its inputs."""
        known = self._own, self._links, self._neighbours, self._parts[0]
        around = self._surroundings
        also = around.wind, around.declared, around.payloads, self._extrapolates
        return Call(give_inputs, group.rows, *known, *also, own, inbox, NOW)

    def _finish_call(self, group: ControlGroup, command: LawCommand) -> Call:
        """Return what comes after a user's law."""
        limits = group.config.pitch_limit, group.config.roll_limit
        return Call(_finish, group.rows, command, *limits, *self._parts, NOW)

    def _step_user_law(
        self,
        number: int,
        law: Law,
        inputs: tuple[OwnState, Inbox],
        command: LawCommand,
        finish: Call,
        now: float,
    ) -> None:
        """Step a group by a user's law in Python, which receives copies of its inputs.

        Args:
            number: of the group.
            law: its own.
            inputs: of `give_inputs`, for this step.
            command: written.
            finish: of `_finish_call`.
            now: s.
        """
        group, followers = self.groups[number], self._followers
        rows = group.rows
        own = OwnState(*(each.copy() for each in inputs[0]))
        inbox = Inbox._make(each.copy() for each in inputs[1])
        with _flight_errors(law):
            known = self._memory[_memory_key(number, group)]
            memory = law.start(own) if known is None else known[0]
            returned, memory = law.step(now, own, inbox, memory)
            valid = validate_command(returned, group.config, now)
            if outputs_of(law).fields:
                self.reports.copy(rows, memory)
        self._memory[_memory_key(number, group)] = (memory,)
        command.put(valid)
        finish(now)
        if isinstance(valid, FbwaCommand):
            # the last bits of numpy's angles are others than those of the kernel
            motion = followers["direction"][rows]
            followers["course_desired"][rows] = course(motion)
            followers["flight_path_angle_desired"][rows] = flight_path_angle(motion)


def _report_command(law: CompiledLaw, config: FormationConfig, now: float) -> None:
    """Raise the error of a user's kernel in its last step.

    Raises:
        FlightError: it raised an exception, or its command is not finite.
    """
    with _flight_errors(law):
        law.raise_error(now)
        validate_command(law.command.valid, config, now)


@contextmanager
def _flight_errors(law: Law) -> Iterator[None]:
    """Turn exceptions of a user's law into a FlightError with file and line."""
    try:
        with user_code_errors(law_file(law)):
            yield
    except InputError as error:
        raise FlightError(str(error)) from error


@entry
def _step(
    rows: Indices,
    controllers: Records,
    neighbours: Records,
    own: Records,
    aircraft: Records,
    followers: Records,
    links: Records,
    now: float,
) -> None:
    """Step the followers in these rows (m,) by the law of [HBH23], with the estimates of `own`."""
    for i in rows:
        estimate, control = own[i + 1].estimate, aircraft[i + 1].control
        control_step(controllers[i], now, estimate, links[i], neighbours[i], followers[i], control)


@entry
def _finish(
    rows: Indices,
    command: LawCommand,
    pitch_limit: Array,
    roll_limit: Array,
    controllers: Records,
    neighbours: Records,
    own: Records,
    aircraft: Records,
    followers: Records,
    links: Records,
    now: float,
) -> None:
    """Write the commands (m) of a user's law, run the middle loop behind (u, ω), and write ages."""
    for k in range(len(rows)):
        i = rows[k]
        estimate, control = own[i + 1].estimate, aircraft[i + 1].control
        follower, link, neighbour = followers[i], links[i], neighbours[i]
        if command.kind[0] == UNICYCLE:
            given = command.unicycle
            follower.speed_command = given.speed[k]
            follower.speed_desired = given.speed_desired[k]
            for axis in range(3):
                follower.omega[axis] = given.omega[k, axis]
                follower.direction[axis] = given.direction[k, axis]
            follower.limiter_flags = given.limiter_flags[k]
            controller = controllers[i]
            finish_step(controller, now, estimate, link, neighbour, False, follower, control)
        else:
            fbwa = command.fbwa
            control.pitch = min(max(fbwa.pitch[k], -pitch_limit[k]), pitch_limit[k])
            control.roll = min(max(fbwa.roll[k], -roll_limit[k]), roll_limit[k])
            control.throttle = min(max(fbwa.throttle[k], 0.0), 1.0)
            saturations = PITCH if control.pitch != fbwa.pitch[k] else 0
            saturations |= ROLL if control.roll != fbwa.roll[k] else 0
            saturations |= THROTTLE if control.throttle != fbwa.throttle[k] else 0
            _write_unknown(estimate.velocity_ned, follower)
            follower.saturations = saturations
            message_ages(now, neighbour, False, link)
        if isnan(link[0].age_s):
            follower.limiter_flags |= LEADER_TIMEOUT


@kernel
def _write_unknown(velocity_ned: Vector, follower: Record) -> None:
    """Write that what a law of fly-by-wire-A commands desires is unknown: NaN, or its motion."""
    speed = norm(velocity_ned)
    follower.speed_command = follower.speed_desired = follower.airspeed_command = nan
    for axis in range(3):
        follower.omega[axis] = nan
        follower.direction[axis] = velocity_ned[axis] / speed
    north, east, down = follower.direction
    follower.course_desired = atan2(east, north)
    follower.flight_path_angle_desired = gamma_of(north, east, down)
    follower.limiter_flags = 0


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
        notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
        if isinstance(error, MemoryError):  # of this machine; what asks for too much has a place
            raise MemoryError(f"{location}: {what}: {describe_error(error)}") from error
        raise InputError(
            f"{location}: {what} raised {type(error).__name__}: {error}{notes}"
        ) from error


def law_name(law: object) -> str:
    """Return the name of a law's class or kernel."""
    return law.name if isinstance(law, CompiledLaw) else type(law).__name__


def law_file(law: object) -> str:
    """Return the file in which a law is defined; its module if that is no Python file."""
    if isinstance(law, CompiledLaw):
        return law.file
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
            given = np.asarray(value, dtype=kind)
        except (TypeError, ValueError, OverflowError):
            given = None
        # flags may be one number, such as 0; else one number for all followers is a mistake
        if given is None or (given.shape != shape and (given.ndim or name != "limiter_flags")):
            what = "is no number" if given is None else f"has shape {given.shape}"
            what = "is one number" if given is not None and not given.ndim else what
            raise InputError(
                f"controller.law: the law's {name} {what} at {now:g} s (write an array of shape "
                f"{shape}, a row for each of {', '.join(config.names)})"
            )
        array = np.ascontiguousarray(np.broadcast_to(given, shape))
        wrong = np.flatnonzero(~np.isfinite(array).reshape(n, -1).all(axis=1))
        if len(wrong):
            raise InputError(
                f"controller.law: the law's {name} for {config.names[wrong[0]]} is not a finite "
                f"number at {now:g} s"
            )
        fields.append(array)
    return type(command)(*fields)
