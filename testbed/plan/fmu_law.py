"""A formation law that is an FMU: built from its file, and stepped by compiled code."""

from __future__ import annotations

import math
import mmap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.code_digest import code_digest
from testbed.core.errors import InputError
from testbed.core.forked import CrashError, Send, run_in_fork
from testbed.core.records import OwnState, Records
from testbed.fmi.archive import Archive
from testbed.fmi.instances import FmuLibrary, Value
from testbed.fmi.law_variables import LawVariables, ParameterSetting, match_variables
from testbed.fmi.model_description import ModelDescription, read_description
from testbed.formation import fmu_step
from testbed.formation.compiled_law import CompiledLaw
from testbed.formation.control_step import Hbh23Law
from testbed.formation.fmu_step import FmuStep
from testbed.formation.law import FormationConfig

_SETS = 3  # of instances without a state: of the flight, and two for the checks
_LARGE = 1e9  # in place of an infinite bound
_STATE = "FMUstate", "FMUState"  # in names of FMI 2.0 and 3.0
_COMMAND = {
    "fly-by-wire": ("pitch", "roll", "throttle"),
    "velocity": (*("velocity_ned",) * 3, *("acceleration_ned",) * 3),
    "unicycle": ("speed", *("omega",) * 3, "speed_desired", *("direction",) * 3),
}


class CallReport:
    """The call of an FMU that a flight makes now, which also another process can read.

    Args:
        end_s: time of a step that is not made but an error, s.
        reason: of that error.
    """

    CONSTANT = True  # for a saved flight

    def __init__(self, end_s: float = math.inf, reason: str = "is not stepped") -> None:
        self.reason = reason
        self._memory = mmap.mmap(-1, mmap.PAGESIZE)  # shared with forked processes
        numbers: NDArray[np.float64] = np.frombuffer(self._memory, dtype=np.float64)
        self.values = numbers[:5]
        self.values[:] = (0.0, 0.0, -1.0, 0.0, end_s)

    @property
    def time_s(self) -> float:
        """Time of the step, s."""
        return float(self.values[fmu_step.TIME_S])

    @property
    def aircraft(self) -> int:
        """Row of the follower among the N aircraft."""
        return int(self.values[fmu_step.ROW])

    @property
    def call(self) -> int:
        """Place of the function among `fmu_step`'s; negative: none is called now."""
        return int(self.values[fmu_step.CALL])


_shared: ContextVar[CallReport | None] = ContextVar("shared", default=None)


@contextmanager
def reporting_calls(report: CallReport) -> Iterator[None]:
    """Let the laws that are built in the block report their calls here."""
    token = _shared.set(report)
    try:
        yield
    finally:
        _shared.reset(token)


# what a call is to do, in the order of the functions in `fmu_step`
PURPOSES = (
    *("set inputs", "set inputs", "step", "return outputs", "read a state", "set a state"),
    *("return its state", "return the size of its state", "write its state", "free a state"),
)


def describe_crash(
    crash: CrashError, calls: CallReport, names: Sequence[str], *, begun: bool
) -> str:
    """Describe where an FMU has crashed.

    Args:
        crash: of the process in which it was stepped.
        calls: of that process.
        names: of the N aircraft.
        begun: the flight had begun.
    """
    if calls.call < 0:
        when = "outside of a step" if begun else "when it was loaded or initialised"
        return f"{crash.end} {when}"
    when = f" at {calls.time_s:g} s" if begun else ", in the checks before the flight"
    return f"{names[calls.aircraft]}{when}: {crash.end} in the call to {PURPOSES[calls.call]}"


_tried: set[tuple[str, ...]] = set()  # in this process


def try_first(work: Callable[[], object], names: Sequence[str], *key: str) -> None:
    """Do work with an FMU in a forked process, before it is done in this one.

    Nothing is done in a process that reports its calls, or again with the same key.

    Args:
        work: builds and checks a law.
        names: of the N aircraft, for the error.
        key: file and digest of the FMU, and what else is different.

    Raises:
        InputError: the FMU has crashed.
        Exception: what the work raises.
    """
    if _shared.get() is not None or key in _tried:
        return
    calls = CallReport()

    def report(_: Send) -> None:
        with reporting_calls(calls):
            work()

    try:
        run_in_fork(report, lambda message: None)
    except CrashError as crash:
        text = describe_crash(crash, calls, names, begun=False)
        raise InputError(f"{key[0]}: {text}") from None
    _tried.add(key)


class FmuLaw(CompiledLaw):
    """An FMU as the law of n followers; see `CompiledLaw`.

    Attributes:
        library: its loaded binary.
        has_state: its state is in the memory of the law; else each follower has an instance.
    """

    ALIKE = ("file",)
    MAY_WRITE = False
    ADDRESSES = ("call", "_options", "_fmu")
    __slots__ = (
        *("library", "has_state", "_fmu", "_names", "_variables", "_start", "_next", "_report"),
        *("_rows", "_alive"),
        "__weakref__",
    )

    def __init__(
        self, library: FmuLibrary, variables: LawVariables, config: FormationConfig, hbh23: Records
    ) -> None:
        """Make the instances, and compile or load what steps them.

        Args:
            library: loaded.
            variables: of the FMU.
            config: of the followers.
            hbh23: (n,) of LAW, for a desired velocity.

        Raises:
            InputError: the FMU makes no instance, or a function of it fails.
        """
        model = library.model
        self.library, self._variables = library, variables
        self._names, self._rows = config.names, config.agents
        self.has_state, self._next = model.has_state, 0
        values = [_values(variables, config, row) for row in range(len(config.names))]
        sets = 1 if self.has_state else _SETS
        instances = np.zeros((sets, len(config.names)), dtype=np.uint64)
        for k in range(sets):
            for row, name in enumerate(config.names):
                instances[k, row] = library.instantiate(name, self)
                library.initialise(int(instances[k, row]), variables.structural, values[row])
        self._start: Callable[[int], None] = _Reset(library, variables, values, instances)
        states = [library.state(int(each)) for each in instances[0]] if self.has_state else [b""]
        size = len(states[0])
        if any(len(each) != size for each in states) or (self.has_state and not size):
            raise InputError(
                f"{model.file}: its states have different sizes, or none (write one size for all)"
            )
        self._report = _shared.get() or CallReport()
        made = _make_step(library, variables, config, instances, states, self._report)
        self._fmu, self._alive = made
        law = fmu_step.law_of_kind(variables.kind, size)
        super().__init__(law, config, hbh23, (self._fmu,), code_digest(law))  # type: ignore[arg-type]
        self.name, self.file = Path(model.file).name, model.file

    @property
    def why_not_saved(self) -> str:
        """Why a flight with this law cannot be saved; "": it can."""
        if self.has_state:
            return ""
        kind = _STATE[self.library.model.version - 2]
        return (
            f"{self.file}: its state can neither be saved nor restored (canGetAndSet{kind} and "
            f"canSerialize{kind} are false: export it with both, or fly it by testbed run, "
            "studies and Simulation without save)"
        )

    def start(self, own: OwnState) -> Records | None:
        """Return the memory (n,) before the first step; without a state, of other instances."""
        memory = super().start(own)
        assert memory is not None, "declared"
        if not self.has_state:
            self._next = self._next % (_SETS - 1) + 1
            self._start(self._next)
            memory["instance"] = self._next
        return memory

    def raise_error(self, now: float) -> None:
        """Raise an error that names the function of the FMU that has failed, if one has.

        Raises:
            InputError: it has.
        """
        if not self._failed[0]:
            return
        row = int(self._failed[0]) - 1
        self._failed[0] = 0
        call, status = self._report.call, int(self._report.values[fmu_step.STATUS])
        place, words = (
            f"{self.file}: {self._names[row]} at {now:g} s",
            self._fmu.words[self._rows[row]],
        )
        if call == fmu_step.STOPPED:
            raise InputError(f"{place}: {self._report.reason}")
        if call == fmu_step.NOT_FINITE:
            begin = int(words[fmu_step.COMMAND_AT])
            command = self._fmu.numbers[self._rows[row], begin:]
            found = zip(_COMMAND[self._variables.kind], command, strict=False)
            wrong = next((name for name, each in found if not np.isfinite(each)), "output")
            raise InputError(f"{place}: its {wrong} is not a finite number")
        if call == fmu_step.OTHER_SIZE:
            now_bytes, before = words[fmu_step.SIZE], words[fmu_step.STATE_BYTES]
            raise InputError(
                f"{place}: {self.library.size_function} is {now_bytes} and was {before} before "
                "(write states of one size)"
            )
        names = call_names(self.library.model)
        if 0 <= call < len(names):
            text = self.library.describe_status(status)
            raise InputError(f"{place}: {names[call]} returns {text}{self.library.last_message}")
        raise InputError(f"{place}: its desired velocity is zero (write one with a direction)")

    def _words_of(self, row: int) -> NDArray[np.int64]:
        words: NDArray[np.int64] = self._fmu.words[self._rows[row]]
        return words


class _Reset:
    """Return sets of instances to their start."""

    CONSTANT = True  # for a saved flight

    def __init__(
        self,
        library: FmuLibrary,
        variables: LawVariables,
        values: list[list[Value]],
        instances: NDArray[np.uint64],
    ) -> None:
        self._library, self._sizes = library, variables.structural
        self._values, self._instances = values, instances

    def __call__(self, number: int) -> None:
        for instance, values in zip(self._instances[number], self._values, strict=True):
            self._library.reset(int(instance))
            self._library.initialise(int(instance), self._sizes, values)


def call_names(model: ModelDescription) -> list[str]:
    """Return the names of the functions of a step, in the order of their places."""
    if model.version == 2:
        of_state = "fmi2DeSerializeFMUstate fmi2SetFMUstate fmi2GetFMUstate "
        of_state += "fmi2SerializedFMUstateSize fmi2SerializeFMUstate fmi2FreeFMUstate"
        of_step = "fmi2SetReal fmi2SetBoolean fmi2DoStep fmi2GetReal"
    else:
        of_state = "fmi3DeserializeFMUState fmi3SetFMUState fmi3GetFMUState "
        of_state += "fmi3SerializedFMUStateSize fmi3SerializeFMUState fmi3FreeFMUState"
        of_step = "fmi3SetFloat64 fmi3SetBoolean fmi3DoStep fmi3GetFloat64"
    return f"{of_step} {of_state}".split()


class _Opened(NamedTuple):
    """An FMU that is unpacked."""

    archive: Archive
    model: ModelDescription
    folder: Path


# by file and digest, of this process or of one that has forked it
_opened: dict[tuple[str, str], _Opened] = {}
_libraries: dict[tuple[str, str], FmuLibrary] = {}


@contextmanager
def opened_fmu(path: Path) -> Iterator[None]:
    """Unpack an FMU for the forked processes of the block, which cannot clean up after a crash.

    Raises:
        InputError: it cannot be used; the text begins with its path.
    """
    key = _open(path)
    try:
        yield
    finally:
        if key not in _libraries and key in _opened:
            _opened.pop(key).archive.remove()


def _open(path: Path) -> tuple[str, str]:
    archive = Archive(path)
    key = str(path), archive.digest
    if key not in _opened and key not in _libraries:
        model = read_description(archive)
        folder = archive.unpack(archive.binary_name(model.version, model.identifier))
        _opened[key] = _Opened(archive, model, folder)
    return key


def load_fmu(path: Path) -> FmuLibrary:
    """Read, check and load an FMU; one that is loaded is not loaded again.

    Raises:
        InputError: it cannot be used; the text begins with its path.
    """
    key = _open(path)
    if key not in _libraries:
        found = _opened[key]
        _libraries[key] = FmuLibrary(*found)
        if not found.archive.has_resources:
            found.archive.remove()  # the loaded file is not needed any more
    return _libraries[key]


def build_fmu(
    path: Path,
    names: Mapping[str, str],
    options: Mapping[str, Any],
    config: FormationConfig,
    hbh23: Hbh23Law,
    aircraft: int,
) -> tuple[FmuLaw, LawVariables]:
    """Build the law of an FMU.

    Args:
        path: of its file.
        names: `controller.map`.
        options: `controller.options`.
        config: of the law's followers.
        hbh23: the built-in law of these.
        aircraft: N of the flight.

    Raises:
        InputError: the FMU cannot be used, or a variable of it does not fit.
    """
    library = load_fmu(path)
    if library.model.single and aircraft > 2:
        raise InputError(
            f"{path}: canBeInstantiatedOnlyOncePerProcess is true, and each follower needs an "
            "instance (export it so that several can be made)"
        )
    variables = match_variables(library.model, names, options, aircraft, config.dt)
    return FmuLaw(library, variables, config, hbh23.law), variables


def _values(variables: LawVariables, config: FormationConfig, row: int) -> list[Value]:
    """Return the values of the parameters of a follower."""
    return [Value(each.variable, _of_setting(each, config, row)) for each in variables.settings]


def _of_setting(setting: ParameterSetting, config: FormationConfig, row: int) -> tuple[Any, ...]:
    if not setting.name:
        return setting.values
    name = setting.name.removeprefix("config.")
    if name in ("slot", "offsets"):
        numbers = config.offsets if name == "offsets" else config.offsets[config.agents[row]]
    else:
        found: Any = getattr(config, name)
        numbers = np.asarray(found[row] if np.ndim(found) else found)
    flat = (float(numbers[each]) for each in setting.indices)
    values = tuple(min(max(each, -_LARGE), _LARGE) for each in flat)
    return tuple(map(int, values)) if setting.variable.type != "Float64" else values


def _make_step(
    library: FmuLibrary,
    variables: LawVariables,
    config: FormationConfig,
    instances: NDArray[np.uint64],
    states: list[bytes],
    report: CallReport,
) -> tuple[FmuStep, tuple[NDArray[Any], ...]]:
    """Return the data of the steps of n followers, and arrays whose addresses are in it."""
    model, size = library.model, len(states[0])
    n, aircraft = config.gains.shape[:2]
    names = call_names(model)[: None if model.has_state else fmu_step.DESERIALIZE]
    functions = [library.address(each) for each in names]
    groups = variables.inputs, variables.flags, variables.outputs
    refs = [np.array([ref for ref, _ in each], dtype=np.uint32) for each in groups]
    places = [[place for _, each in group for place in each] for group in groups]
    initial = np.zeros((n, max(size, 1)), dtype=np.uint8)
    for row, each in enumerate(states if size else ()):
        initial[row] = np.frombuffer(each, dtype=np.uint8)
    values_at = fmu_step.FIRST_MESSAGE + fmu_step.MESSAGE_SIZE * aircraft
    found_at = values_at + len(places[0])
    command_at = found_at + len(places[2])
    # a Boolean has up to 4 bytes
    words = np.zeros((aircraft, fmu_step.FLAGS_AT + 1 + len(places[1]) // 2), dtype=np.int64)
    columns: dict[int, int] = {
        fmu_step.VERSION: model.version,
        fmu_step.STATE_BYTES: size,
        fmu_step.AIRCRAFT: variables.aircraft,
        **{fmu_step.FUNCTIONS + k: each for k, each in enumerate(functions)},
        fmu_step.VALUES_AT: values_at,
        fmu_step.FOUND_AT: found_at,
        fmu_step.COMMAND_AT: command_at,
    }
    first = fmu_step.INPUT_REFS, fmu_step.FLAG_REFS, fmu_step.OUTPUT_REFS
    for column, found, numbers in zip(first, refs, places, strict=True):
        columns |= {column: found.ctypes.data, column + 1: len(found), column + 2: len(numbers)}
    for column, value in columns.items():
        words[:, column] = value
    for row, agent in enumerate(config.agents):
        words[agent, fmu_step.INITIAL] = initial[row].ctypes.data
        for k, each in enumerate(instances[:, row]):
            words[agent, fmu_step.INSTANCES + k] = each
    every = np.array([place for each in places for place in each], dtype=np.intp)
    scratch = np.zeros((aircraft, command_at + fmu_step.COMMAND_SIZE))
    return FmuStep(words, every, scratch, report.values), (*refs, initial)
