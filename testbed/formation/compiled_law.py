"""Formation laws of users as kernels of one follower, which fly without Python in the tick."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar, overload

import numpy as np
from numba.core import errors, types
from numba.extending import overload as overload_in_kernels

from testbed.core.call_list import NOW, Call, Words
from testbed.core.compile import checked_kernel, entry_of_user_code
from testbed.core.compile import kernel as core_kernel
from testbed.core.field_docs import document_fields
from testbed.core.records import (
    Array,
    FbwaCommand,
    Inbox,
    Indices,
    OwnState,
    Records,
    UnicycleCommand,
    Values,
    allocate,
)
from testbed.formation.follower_hbh23 import FollowerHbh23
from testbed.formation.law import FormationConfig
from testbed.formation.law_outputs import Outputs

F = TypeVar("F", bound=Callable[..., Any])
LawOptions: TypeAlias = tuple[bool | int | float | tuple[float, ...], ...]
ARGUMENTS = ("now", "own", "inbox", "memory", "config")  # of a law, before its options


@document_fields
class FollowerConfig(NamedTuple):
    """The configuration of one follower: what `FormationConfig` has of it."""

    agents: int  # its row among the N aircraft; the leader's is 0
    offsets: Array  # (N, 3) υ, m: forward, right, down in the leader's velocity frame; leader zero
    gains: Array  # (N, 3) β_i in row 0, β_ij behind it, per axis of NED
    airspeed_min: float  # m/s, lower bound of the airspeed
    airspeed_max: float  # m/s, upper bound
    ground_speed_min: float  # m/s, lower bound of the ground speed; 0: none
    ground_speed_max: float  # m/s, upper bound; infinite: none
    speed_min: float  # m/s, as airspeed_min, in flights without wind; for laws of older releases
    speed_max: float  # m/s, as airspeed_max, in flights without wind
    speed_pole: float  # 1/s, p of the speed model ṡ = p (u − s)
    pitch_limit: float  # rad, of the fly-by-wire-A command
    roll_limit: float  # rad
    trim_throttle: float  # 0..1, for level flight at trim_airspeed
    trim_airspeed: float  # m/s
    dt: float  # s, between two steps
    leader_timeout_s: float  # s since the last message, after which the leader is not used
    neighbour_timeout_s: float  # s, the same for a neighbour
    hbh23: FollowerHbh23  # the built-in law with the scenario's gains, to extend or wrap


@overload
def kernel(function: F) -> F: ...


@overload
def kernel(
    *,
    memory: object = None,
    send: Sequence[str] = (),
    log: Sequence[str] = (),
    events: Mapping[str, Sequence[str]] | None = None,
    requires: Callable[..., None] | None = None,
) -> Callable[[F], F]: ...


def kernel(
    function: F | None = None,
    *,
    memory: object = None,
    send: Sequence[str] = (),
    log: Sequence[str] = (),
    events: Mapping[str, Sequence[str]] | None = None,
    requires: Callable[..., None] | None = None,
) -> F | Callable[[F], F]:
    """Compile a formation law of one follower, or a function that such a law calls.

        @testbed.kernel
        def chase(now, own, inbox, memory, config, closing=0.3):
            ...
            return command_from_velocity(config, own, velocity_ned)

    In a scenario it is `controller: {law: "module:chase"}`. numba compiles it, and it flies with no
    Python in the tick. Its arguments are those of `testbed.law.Law.step`, with the same field
    names, of one follower: row i of each array, so `own.position_ned` is (3,) and
    `inbox.position_ned` (N, 3). `own`, `inbox` and `config` cannot be written. It returns a
    `UnicycleCommand` of numbers and triples, or an `FbwaCommand` of numbers.

    - `config` has the fields of `testbed.law.FormationConfig` but `names`; `config.agents` is the
      follower's row among the N aircraft.
    - `memory` is a record, which the law writes in place and which is zero before the first step;
      None without the argument `memory`.
    - `config.hbh23.step(now, own, inbox, memory.hbh23)` steps the built-in law and returns its
      command; its memory is a field `("hbh23", testbed.law.HBH23_MEMORY)`.
    - Arguments behind `config` are `controller.options`: numbers, booleans, or lists of numbers,
      which are tuples of floats here.

    Division by zero is infinite or NaN, but `//` and `%` of two integers by zero are 0. An index
    out of bounds is an error, as are a command that is not finite and a write to `config`. With
    NUMBA_DISABLE_JIT=1 in the environment a kernel runs as Python.

    Args:
        function: the law, or a function.
        memory: fields of the law's memory, as of a numpy dtype: `[("integral", float, 3)]`.
        send: fields of floats that each message carries: the others have them in `inbox.payload`.
        log: fields that the log has, in `law`.
        events: texts of the values of integer fields; see `testbed.law.Outputs`.
        requires: function of Python that is called before a flight with the
            `testbed.law.FormationConfig` of all followers and the options by name, also those at
            their defaults. It raises a ValueError where a hypothesis of the law does not hold.

    Raises:
        ValueError: `memory` is no list of fields with numbers, or lacks a field that is named.
    """
    outputs = Outputs(memory, send, log, events)

    def compile_law(function: F) -> F:
        compiled = checked_kernel(function)
        compiled.law_outputs = outputs  # type: ignore[attr-defined]
        compiled.law_requires = requires  # type: ignore[attr-defined]
        return compiled

    return compile_law if function is None else compile_law(function)


def is_kernel(value: object) -> bool:
    """Return whether a value is a function under `@testbed.kernel`."""
    return hasattr(value, "law_outputs")


def python_function(law: Any) -> Callable[..., Any]:  # noqa: ANN401 - numba's dispatcher
    """Return the Python function of a kernel."""
    function: Callable[..., Any] = getattr(law, "py_func", law)
    return function


class LawCommand(NamedTuple):
    """Commands of the n followers of a user's law; the one or the other is valid."""

    kind: Indices  # (1,) UNICYCLE or FBWA; 0: neither yet
    unicycle: UnicycleCommand  # (n)
    fbwa: FbwaCommand[Array]  # (n)

    @property
    def valid(self) -> UnicycleCommand | FbwaCommand[Array]:
        """The command that the law returns."""
        return self.unicycle if self.kind[0] == UNICYCLE else self.fbwa

    def put(self, command: UnicycleCommand | FbwaCommand[Array]) -> None:
        """Copy a command of full shape."""
        self.kind[0] = UNICYCLE if isinstance(command, UnicycleCommand) else FBWA
        ours: tuple[np.ndarray, ...] = self.valid
        for array, values in zip(ours, command, strict=True):
            array[:] = values


UNICYCLE, FBWA = 1, 2


def allocate_inputs(n: int, aircraft: int, sent: int) -> tuple[OwnState, Inbox]:
    """Return estimates of n followers and their messages of N aircraft, of zeros.

    Args:
        n: followers.
        aircraft: N.
        sent: numbers of the law in each message.
    """
    own = OwnState._make((*np.zeros((5, n, 3)), *np.zeros((2, n)), np.zeros((n, 3))))
    received = *np.zeros((2, n, aircraft)), *np.zeros((5, n, aircraft, 3))
    others = np.zeros((n, aircraft)), np.zeros((n, aircraft), dtype=bool)
    return own, Inbox._make((*received, *others, np.zeros((n, aircraft, sent))))


def allocate_command(n: int) -> LawCommand:
    """Return commands of n followers, of no kind yet."""
    speeds, angles = np.zeros((2, n)), np.zeros((3, n))
    vectors, flags = np.zeros((2, n, 3)), np.zeros(n, dtype=np.uint8)
    unicycle = UnicycleCommand(speeds[0], vectors[0], speeds[1], vectors[1], flags)
    return LawCommand(np.zeros(1, dtype=np.intp), unicycle, FbwaCommand(*angles))


class CompiledLaw:
    """A user's kernel as the law of n followers.

    Attributes:
        name: of the kernel.
        file: of its code.
        own: (n) estimates that `call` steps the law with.
        inbox: (n, N) messages that it does.
        command: that it writes.
        call: step all followers; returns something but 0 where `raise_error` has something to say.
        outputs: that it declares.
    """

    ALIKE = ("name",)  # another law has another memory
    MAY_WRITE = True  # its code is a user's, whose writes to the configuration are found
    __slots__ = (
        *("name", "file", "own", "inbox", "command", "call", "outputs"),
        *("_kernel", "_config", "_options", "_memory", "_failed", "_gains", "_given"),
    )

    def __init__(
        self,
        law: Any,  # noqa: ANN401 - numba's dispatcher
        config: FormationConfig,
        hbh23: Records,
        options: LawOptions,
        digest: str | None,
    ) -> None:
        """Compile the law, or load its machine code.

        Args:
            law: under `@kernel`.
            config: of its followers.
            hbh23: (n,) of LAW, for `command_from_velocity`.
            options: further arguments.
            digest: of its code; None: its machine code is not kept on disk.

        Raises:
            Exception: numba's, for what it cannot compile.
        """
        function = python_function(law)
        self.name, self.file = function.__name__, function.__code__.co_filename
        n, aircraft = config.gains.shape[:2]
        self.outputs: Outputs = law.law_outputs
        self.own, self.inbox = allocate_inputs(n, aircraft, self.outputs.sent_numbers)
        self.command, self._options = allocate_command(n), options
        self._kernel = law
        # laws that name an old field are refused where it has no meaning; see `user_code`
        taken = {"speed_min": "airspeed_min", "speed_max": "airspeed_max"}
        names = (each for each in FollowerConfig._fields if each != "hbh23")
        values: Any = {each: _read_only(getattr(config, taken.get(each, each))) for each in names}
        # numba lets a law write fields of a record, also of an array that is read-only
        plain = allocate(hbh23.dtype, n)
        _copy_fields(hbh23, plain)
        given = np.frombuffer(plain.tobytes(), dtype=np.uint64).reshape(n, -1)  # read-only
        self._gains, self._given = given.copy(), given
        used = self._gains.view(hbh23.dtype).reshape(n).view(type(hbh23))
        used.flags.writeable = False
        # the fields of each follower are arrays (n, …)
        paper = FollowerHbh23(used, values["offsets"], values["gains"])
        self._config = FollowerConfig(**values, hbh23=paper)
        memory = self.outputs.memory
        self._memory = None if memory is None else allocate(memory, n)
        self._failed = np.zeros(1, dtype=np.intp)  # follower + 1; 0: none
        own, inbox = (type(each)(*map(_read_only, each)) for each in (self.own, self.inbox))
        words = self._gains.shape[1] if self.MAY_WRITE else 0
        compared = (each[:, :words] for each in (self._gains, self._given))
        self.call = Call(
            entry_of_user_code(_make_step(law, memory is not None), digest),
            *(own, inbox, () if self._memory is None else self._memory),
            *(self._config, options, self.command, self._failed),
            *map(_read_only, compared),
            NOW,
        )
        self.call.prepare()

    @property
    def memory(self) -> Records | None:
        """Memory (n,) that `call` steps the law with; None: it has none."""
        return self._memory

    def start(self, own: OwnState) -> Records | None:
        """Return the memory (n,) before the first step."""
        return None if self._memory is None else np.zeros_like(self._memory)

    def step(
        self, now: float, own: OwnState, inbox: Inbox, memory: Records | None
    ) -> tuple[UnicycleCommand | FbwaCommand[Array], Records | None]:
        """Step all followers; see `law.Law`."""
        for ours, theirs in zip((*self.own, *self.inbox), (*own, *inbox), strict=True):
            ours[:] = theirs
        after = None
        if self._memory is not None:
            self._memory[:] = memory
        self.call(now)
        if self._failed[0]:
            self.raise_error(now)
        if self._memory is not None:
            after = self._memory.copy()
            self._memory[:] = np.zeros((), dtype=self._memory.dtype)
        command: Any = self.command.valid
        return type(command)(*(each.copy() for each in command)), after

    def raise_error(self, now: float) -> None:
        """Raise the exception of the last step, if there was one, by running it as Python."""
        if not self._failed[0]:
            return
        row = int(self._failed[0]) - 1
        self._gains[:] = self._given
        paper = self._config.hbh23
        paper = paper._replace(gains=paper.gains.view(np.recarray))
        config = self._config._replace(hbh23=paper)
        one = python_function(follower_config)(config, row)
        own, inbox = (type(each)(*(x[row] for x in each)) for each in (self.own, self.inbox))
        memory = None if self._memory is None else self._memory.view(np.recarray)[row]
        law = python_function(self._kernel)
        write_command(law(now, own, inbox, memory, one, *self._options), row, self.command)
        raise ValueError(f"an exception at {now:g} s, for follower {row + 1} of this law")


def _copy_fields(source: Records, target: Records) -> None:
    """Copy records, without what is between their fields, which differs from flight to flight."""
    for name in source.dtype.names or ():
        if source[name].dtype.names is None:
            target[name] = source[name]
        else:
            _copy_fields(source[name], target[name])


def _read_only(value: Any) -> Any:  # noqa: ANN401
    """View an array so that kernels cannot write it; numbers stay as they are."""
    if not isinstance(value, np.ndarray):
        return value
    view = np.ascontiguousarray(value).view()
    view.flags.writeable = False
    return view


def _make_step(law: Callable[..., Any], has_memory: bool) -> Callable[..., int]:
    """Return the entry that steps a law for n followers.

    It returns whether a follower's law has raised an exception or written its configuration, or its
    command is not finite.
    """
    if has_memory:

        def step_follower(
            now: float, own: Values, inbox: Values, memory: Records, i: int, rest: Values
        ) -> Values:
            config, options = rest
            return law(now, own, inbox, memory[i], config, *options)
    else:

        def step_follower(
            now: float, own: Values, inbox: Values, memory: Records, i: int, rest: Values
        ) -> Values:
            config, options = rest
            return law(now, own, inbox, None, config, *options)

    step_one = checked_kernel(step_follower)

    def step_law(
        own: OwnState,
        inbox: Inbox,
        memory: Records,
        config: Values,
        options: Values,
        command: LawCommand,
        failed: Indices,
        gains: Words,
        given: Words,
        now: float,
    ) -> int:
        failed[0] = 0
        finite = True
        for i in range(len(own.airspeed)):
            state, received, one = own_state(own, i), messages(inbox, i), follower_config(config, i)
            try:
                found = step_one(now, state, received, memory, i, (one, options))
                finite &= write_command(found, i, command)
            except Exception:  # whatever the law raises
                failed[0] = i + 1
                return 1
            for k in range(gains.shape[1]):
                if gains[i, k] != given[i, k]:
                    failed[0] = i + 1
                    return 1
        return 0 if finite else 1

    return step_law


@core_kernel
def own_state(own: OwnState, i: int) -> OwnState:
    """Return the estimate of one of n followers."""
    return OwnState(
        own.position_ned[i],
        own.velocity_ned[i],
        own.acceleration_ned[i],
        own.euler[i],
        own.rates_body[i],
        own.airspeed[i],
        own.equivalent_airspeed[i],
        own.wind_ned[i],
    )


@core_kernel
def messages(inbox: Inbox, i: int) -> Inbox:
    """Return the messages that one of n followers has received."""
    return Inbox(
        inbox.stamp_s[i],
        inbox.received_s[i],
        inbox.position_ned[i],
        inbox.velocity_ned[i],
        inbox.acceleration_ned[i],
        inbox.euler[i],
        inbox.euler_rates[i],
        inbox.turn_rate[i],
        inbox.failed[i],
        inbox.payload[i],
    )


@core_kernel
def follower_config(config: Values, i: int) -> FollowerConfig:
    """Return the configuration of one of n followers, of a FollowerConfig of their arrays."""
    return FollowerConfig(
        config.agents[i],
        config.offsets,
        config.gains[i],
        config.airspeed_min[i],
        config.airspeed_max[i],
        config.ground_speed_min[i],
        config.ground_speed_max[i],
        config.speed_min[i],
        config.speed_max[i],
        config.speed_pole[i],
        config.pitch_limit[i],
        config.roll_limit[i],
        config.trim_throttle[i],
        config.trim_airspeed[i],
        config.dt,
        config.leader_timeout_s,
        config.neighbour_timeout_s,
        FollowerHbh23(config.hbh23.gains[i : i + 1], config.offsets, config.gains[i]),
    )


def write_command(found: Any, i: int, command: LawCommand) -> bool:  # noqa: ANN401
    """Write what a law returned for follower i; return whether it is finite.

    Kernels call it, too: then an error is one of numba's.

    Raises:
        ValueError: it is no command, or a vector has not three numbers.
    """
    writer = _WRITERS.get(type(found))
    if writer is None:
        raise ValueError(f"returns {type(found).__name__} ({_RETURNS})")
    return bool(python_function(writer)(found, i, command))


_RETURNS = "return a UnicycleCommand or an FbwaCommand"


def require_vector(name: str, value: Any) -> None:  # noqa: ANN401 - a type of numba's
    """Raise numba's error unless a type is that of three numbers or of an array (k,)."""
    array = isinstance(value, types.Array) and value.ndim == 1
    if not array and not (isinstance(value, types.BaseTuple) and len(value) == 3):
        raise errors.TypingError(f"{name} is {value} (write 3 numbers)")


def _writer_in_kernels(found: Any) -> Any:  # noqa: ANN401 - a type of numba's
    """Return what kernels compile in place of `write_command`."""
    kind = getattr(found, "instance_class", None)
    if kind not in _WRITERS:
        raise errors.TypingError(f"the law returns {found} ({_RETURNS})")
    for name, value in zip(found.fields, found, strict=True):
        if name in ("omega", "direction"):
            require_vector(f"{name} of the law's command", value)
        elif not isinstance(value, types.Number | types.Boolean | types.IntEnumMember):
            remedy = "its .value" if isinstance(value, types.EnumMember) else "a number"
            raise errors.TypingError(f"{name} of the law's command is {value} (write {remedy})")
    writer = _WRITERS[kind]
    return lambda found, i, command: writer(found, i, command)


overload_in_kernels(write_command)(lambda found, i, command: _writer_in_kernels(found))


@checked_kernel
def _write_unicycle(found: UnicycleCommand, i: int, command: LawCommand) -> bool:
    omega, direction, out = found.omega, found.direction, command.unicycle
    if len(omega) != 3 or len(direction) != 3:
        raise ValueError("omega or direction of the law's command has not 3 numbers")
    command.kind[0] = UNICYCLE
    out.speed[i], out.speed_desired[i] = found.speed, found.speed_desired
    out.omega[i, 0], out.omega[i, 1], out.omega[i, 2] = omega[0], omega[1], omega[2]
    out.direction[i, 0], out.direction[i, 1] = direction[0], direction[1]
    out.direction[i, 2] = direction[2]
    out.limiter_flags[i] = found.limiter_flags
    finite = isfinite(out.speed[i]) and isfinite(out.speed_desired[i])
    for k in range(3):
        finite = finite and isfinite(out.omega[i, k]) and isfinite(out.direction[i, k])
    return finite


@checked_kernel
def _write_fbwa(found: FbwaCommand[float], i: int, command: LawCommand) -> bool:
    command.kind[0], out = FBWA, command.fbwa
    out.pitch[i], out.roll[i], out.throttle[i] = found.pitch, found.roll, found.throttle
    return isfinite(found.pitch) and isfinite(found.roll) and isfinite(found.throttle)


_WRITERS: dict[type, Any] = {UnicycleCommand: _write_unicycle, FbwaCommand: _write_fbwa}


_ANSI = re.compile(r"\x1b\[[0-9;]*m")
_HEADING = "Failed in nopython mode pipeline"
_SPECIFIC = re.compile(r"^\s*\w+Error: (?!Failed in )(.+)$", re.M)
_NO_CALL = re.compile(r"^\s*>>> (.+)$", re.M)
_UNKNOWN_NAME = re.compile(r"name '(\w+)' is not defined")
_RAISED_FROM = re.compile(r"\.* *Raised from .*")


def describe_compile_error(error: Exception, law: Callable[..., Any]) -> str:
    """Return in one line where and why numba cannot compile a law."""
    function = python_function(law)
    file = function.__code__.co_filename
    text = _ANSI.sub("", str(error))
    name = re.escape(Path(file).name)
    place = re.search(rf'{name}(?:", line |:| \()(\d+)', f"{text} {getattr(error, 'loc', '')}")
    line = place[1] if place else function.__code__.co_firstlineno
    lines = (each.strip() for each in text.splitlines())
    reason = next((each for each in lines if each and not each.startswith(_HEADING)), "")
    if specific := _SPECIFIC.findall(text):
        reason = specific[-1]
    elif call := _NO_CALL.search(text):
        reason = f"numba has no {call[1]}"
    if not reason:  # numba has no text for what it does not foresee
        reason = f"numba gives no reason ({type(error).__name__})"
        if assigned := _assigned_vector(law):
            line, field = assigned
            reason = f"memory.{field} is a vector (write memory.{field}[:] = …)"
    if not place and (unknown := _UNKNOWN_NAME.search(reason)):
        line = _line_of(function, lambda node: getattr(node, "id", "") == unknown[1]) or line
    reason = _RAISED_FROM.sub("", _without_fields(reason))
    return f"{file}:{line}: {function.__name__} cannot be compiled: {reason.rstrip('.')}"


def _assigned_vector(law: Any) -> tuple[int, str] | None:  # noqa: ANN401 - numba's dispatcher
    """Return line and name of a vector of the memory to which a law assigns; None: of none."""
    memory: np.dtype[Any] | None = law.law_outputs.memory
    for field in () if memory is None else memory.names or ():
        if memory is not None and memory[field].shape:

            def assigns(node: ast.AST, field: str = field) -> bool:
                targets = node.targets if isinstance(node, ast.Assign) else ()
                return any(ast.unparse(each) == f"memory.{field}" for each in targets)

            if line := _line_of(python_function(law), assigns):
                return line, field
    return None


def _line_of(function: Callable[..., Any], is_it: Callable[[ast.AST], bool]) -> int | None:
    """Return the line of a file in which a function's code has something first; None: nowhere."""
    try:
        lines, first = inspect.getsourcelines(function)
        tree = ast.parse(textwrap.dedent("".join(lines)))
    except (OSError, SyntaxError, TypeError):  # there is no source, as of a prompt
        return None
    found = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.stmt | ast.expr)
             and is_it(node)]  # fmt: skip
    return first + min(found) - 1 if found else None


def _without_fields(text: str) -> str:
    """Remove the types of the fields behind the names of named tuples."""
    for kind in (
        *(OwnState, Inbox, FollowerConfig, FollowerHbh23),
        *(UnicycleCommand, FbwaCommand, LawCommand),
    ):
        while (at := text.find(f"{kind.__name__}(")) >= 0:
            begin = end = at + len(kind.__name__)
            depth = 0
            for end in range(begin, len(text)):
                depth += {"(": 1, ")": -1}.get(text[end], 0)
                if not depth:
                    break
            text = text[:begin] + text[end + 1 :]
    return text
