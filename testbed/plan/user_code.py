"""Laws, functions and barriers of users: load them, call them, hold laws to their contract."""

from __future__ import annotations

import copy
import hashlib
import importlib
import importlib.util
import inspect
import json
import pickle
import re
import site
import sys
import sysconfig
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import distributions
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn, cast
from urllib.parse import unquote, urlsplit

import numpy as np

from testbed.core.code_digest import UnknownValueError, code_digest, names_in_kernel
from testbed.core.errors import InputError, raise_memory_shortage
from testbed.core.input_files import read_bounded
from testbed.core.reads import Deferred, current, unrecorded
from testbed.core.records import Array, FbwaCommand, Inbox, OwnState, UnicycleCommand
from testbed.flight.control import law_file, law_name, user_code_errors, validate_command
from testbed.fmi.archive import MAX_BYTES as MAX_FMU_BYTES
from testbed.formation.compiled_law import (
    ARGUMENTS,
    CompiledLaw,
    describe_compile_error,
    is_kernel,
    python_function,
)
from testbed.formation.control_step import Hbh23Law
from testbed.formation.law import OLD_BOUNDS, FormationConfig, Law
from testbed.formation.law_outputs import Outputs, outputs_of
from testbed.scenario import FMU, LAWS, Scenario, code_references, find_code, library, with_values
from testbed.scenario.fields import KeyPath, is_number

if TYPE_CHECKING:
    from testbed.fmi.law_variables import LawVariables
    from testbed.plan.fmu_law import FmuLaw


def build_law(
    name: str,
    options: Mapping[str, Any],
    config: FormationConfig,
    parts: Mapping[str, Deferred],
    hbh23: Hbh23Law,
    formation: FormationConfig | None = None,
    variables: Mapping[str, str] | None = None,
) -> tuple[Law, str]:
    """Import and construct the law of a scenario's `controller.law`.

    Args:
        name: of a law of the library, "module:name" of a file in scenarios/ or an installed
            module, or "path/of/file.py:name", of a class or of a function under `@testbed.kernel`;
            or the path of an FMU.
        options: keyword arguments.
        config: of its followers.
        parts: what was read for the fields of the configuration.
        hbh23: their law of [HBH23], for one that extends it.
        formation: configuration of all followers, of which a kernel may require something; None:
            the same.
        variables: `controller.map` of an FMU.

    Returns:
        The law, and a description of its code with the digest.

    Raises:
        InputError: the module or name does not exist, does not accept these options, cannot be
            compiled, or requires what the formation or the options do not have.
    """
    if name.endswith(FMU):
        return _build_fmu(Path(find_code(name)), variables or {}, options, config, parts, hbh23)
    module_name, _, law_name = find_code(name).rpartition(":")
    module, origin = import_code(module_name, "controller.law")
    with user_code_errors(origin):  # attributes of modules and classes can be code, too
        found: Any = getattr(module, law_name, None)
        compiled = is_kernel(found)
    described = _describe(module_name, origin)
    if compiled:
        _use_named(names_in_kernel(found), config, parts, hbh23)
        law, kept = _build_kernel(found, options, config, hbh23, formation or config)
        return law, f"{described}{kept}"
    with user_code_errors(origin):
        if hasattr(found, "py_func"):
            raise InputError(
                f"controller.law: {law_name} is compiled by numba alone (write @testbed.kernel in "
                "place of its decorator)"
            )
        if not isinstance(found, type):
            laws = [n for n, each in vars(module).items() if _is_law_of(module, each)]
            raise InputError(
                f"controller.law: {origin} has no class {law_name!r}, and no function of this name "
                f"under @testbed.kernel (it has {', '.join(laws) or 'none'})"
            )
        for method in ("start", "step"):
            if not callable(getattr(found, method, None)):
                raise InputError(
                    f"controller.law: {law_name} has no method {method} (a law has "
                    "start(own) -> memory and step(now, own, inbox, memory) -> command, memory)"
                )
        with unrecorded():
            config = replace(config, hbh23=hbh23)
        if (reads := current()) is not None:
            reads.register_parts(config, parts)
            # also what it reads only in states that no check meets
            _use_named(_names_in_file(origin), config, parts, None)
        _check_options(law_name, found, (config,), options)
        make = cast(Callable[..., Law], found)
        return make(config, **options), described


def _build_fmu(
    path: Path,
    variables: Mapping[str, str],
    options: Mapping[str, Any],
    config: FormationConfig,
    parts: Mapping[str, Deferred],
    hbh23: Hbh23Law,
) -> tuple[Law, str]:
    """Build the law of an FMU; see `build_law`."""
    from testbed.plan.fmu_law import build_fmu, opened_fmu, try_first

    def build() -> tuple[FmuLaw, LawVariables]:
        return build_fmu(path, variables, options, config, hbh23, config.gains.shape[1])

    names_of_all = [f"aircraft {k}" for k in range(config.gains.shape[1])]
    for agent, each in zip(config.agents, config.names, strict=True):
        names_of_all[agent] = each
    digest = hashlib.sha256(read_fmu(path)).hexdigest()
    key = str(path), digest, repr(variables), repr(options), *config.names
    with opened_fmu(path):
        try_first(lambda: check_law(build()[0], config), names_of_all, *key)
        law, found = build()
    names = found.config_names
    names |= {"offsets"} if "slot" in names else set()
    names |= {"command_from_velocity"} if found.kind == "velocity" else set()
    _use_named(names, config, parts, hbh23)
    return law, f"the FMU {path.name} (SHA-256 {law.library.digest[:12]})"


def _use_named(
    names: Collection[str],
    config: FormationConfig,
    parts: Mapping[str, Deferred],
    hbh23: Hbh23Law | None,
) -> None:
    """Count as used what a law's code names; a kernel also uses the built-in law by name.

    Raises:
        InputError: a kernel names bounds that have another meaning in this flight.
    """
    used = [parts[name] for name in names if name in parts]
    if "ground_speed_bounds" in names:
        used += [part for name, part in parts.items() if "speed_m" in name]
    if hbh23 is not None:
        used += hbh23.velocity_reads if "command_from_velocity" in names else ()
        used += hbh23.step_reads if "hbh23" in names else ()
        if "hbh23" in names and hbh23.law["hold_stale_neighbours"].any():
            raise InputError(
                "controller.on_neighbour_timeout: hold-relative-position has no place in a kernel "
                "that steps config.hbh23 (write drop, or the law as a class)"
            )
        for name in ("speed_min", "speed_max"):
            if name in names and not config.bounds_ground_speed:
                raise InputError(f"controller.law: config.{name} {OLD_BOUNDS}")
    for each in used:
        each.use()


def _names_in_file(origin: str) -> set[str]:
    """Return the words of a law's file; none if it cannot be read as text."""
    with suppress(OSError, UnicodeDecodeError):
        return set(re.findall(r"\w+", Path(origin).read_text(encoding="utf-8")))
    return set()


def _is_law_of(module: ModuleType, found: object) -> bool:
    """Return whether a value is a class or kernel that a module does not import."""
    kernel = is_kernel(found)
    made = python_function(found) if kernel else found
    return (kernel or inspect.isclass(made)) and getattr(made, "__module__", "") == module.__name__


def _check_options(
    name: str, function: Callable[..., Any], args: Sequence[object], options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments of a call with the options, by name, with defaults."""
    signature = inspect.signature(function)
    try:
        bound = signature.bind(*args, **options)
    except TypeError as error:
        raise InputError(
            f"controller.options: {name}{signature} cannot be built: {error}"
        ) from error
    bound.apply_defaults()
    return bound.arguments


def _build_kernel(
    found: Callable[..., Any],
    options: Mapping[str, Any],
    config: FormationConfig,
    hbh23: Hbh23Law,
    formation: FormationConfig,
) -> tuple[CompiledLaw, str]:
    """Build a law under `@testbed.kernel`, and describe how its machine code is kept."""
    function = python_function(found)
    name, signature = function.__name__, inspect.signature(function)
    parameters = list(signature.parameters.values())
    plain = all(each.kind is each.POSITIONAL_OR_KEYWORD for each in parameters)
    if not plain or len(parameters) < len(ARGUMENTS):
        raise InputError(
            f"controller.law: {name}{signature} has other arguments than a law (write "
            f"{name}({', '.join(ARGUMENTS)}) and behind these one for each option)"
        )
    arguments = _check_options(name, function, ARGUMENTS, options)
    values = tuple(
        _kernel_option(each.name, arguments[each.name], each.default)
        for each in parameters[len(ARGUMENTS) :]
    )
    _check_hypotheses(
        found, formation, dict(zip(list(arguments)[len(ARGUMENTS) :], values, strict=True))
    )
    digest, kept = None, ""
    try:
        digest = code_digest(found)
    except UnknownValueError as error:
        kept = (
            f"; it is compiled for each run, as the value of {error} in it is no number, array or "
            "function under @testbed.kernel"
        )
    try:
        return CompiledLaw(found, config, hbh23.law, values, digest), kept
    except Exception as error:  # numba's, of many classes
        raise_memory_shortage(error)
        raise InputError(f"controller.law: {describe_compile_error(error, found)}") from error


def _check_hypotheses(
    law: Any,  # noqa: ANN401 - numba's dispatcher
    formation: FormationConfig,
    options: Mapping[str, Any],
) -> None:
    """Call what a law requires of its formation and options.

    Raises:
        InputError: it raises an error; the text has file and line, and that of the error.
    """
    if (requires := law.law_requires) is None:
        return
    name, file = python_function(law).__name__, python_function(law).__code__.co_filename
    with user_code_errors(file, f"the hypotheses of the law {name}"):
        try:
            requires(formation, **options)
        except ValueError as error:
            frames = traceback.extract_tb(error.__traceback__)
            line = [each.lineno for each in frames if each.filename == file]
            place = f"{file}:{line[-1]}" if line else file
            raise InputError(f"{place}: {name} requires: {error}") from error


def _kernel_option(name: str, value: Any, default: Any) -> Any:  # noqa: ANN401
    if isinstance(value, list | tuple) and all(map(is_number, value)):
        return tuple(map(float, value))
    if isinstance(value, bool) or is_number(value):
        return float(value) if isinstance(default, float) else value
    raise InputError(
        f"controller.options: {name} is {value!r} (an option of a law under @testbed.kernel is a "
        "number, true or false, or a list of numbers)"
    )


def build_function(name: str, key: str) -> tuple[Callable[..., Array], str]:
    """Import a function of the array (K,) that is its first argument.

    Args:
        name: "module:function" of a file in scenarios/ or an installed module, or
            "path/of/file.py:function".
        key: of the scenario, for errors.

    Returns:
        The function, which raises `InputError` unless its values (K,) are finite numbers, and a
        description of its code with the digest.

    Raises:
        InputError: the module or function does not exist.
    """
    module_name, _, function_name = find_code(name).rpartition(":")
    module, origin = import_code(module_name, key)
    with user_code_errors(origin, "the module"):
        found: Any = getattr(module, function_name, None)
    if not callable(found):
        functions = [n for n, each in vars(module).items() if inspect.isfunction(each)]
        raise InputError(
            f"{key}: {origin} has no function {function_name!r} (it has "
            f"{', '.join(functions) or 'none'})"
        )

    def call(x: Array, *others: float) -> Array:
        with user_code_errors(origin, "the function"), np.errstate(all="ignore"):
            values = np.asarray(found(x.copy(), *others), dtype=np.float64)
        if values.shape != x.shape:
            raise InputError(
                f"{key}: {function_name} of an array of shape {x.shape} has shape {values.shape} "
                "(write NumPy operations on the whole array)"
            )
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise InputError(
                f"{key}: {function_name}({x[wrong[0]]:.4g}) is {values[wrong[0]]} (write a "
                "function that is finite everywhere)"
            )
        return values

    return call, _describe(module_name, origin)


def with_stored_code(scenario: Scenario) -> tuple[Scenario, Mapping[str, bytes]]:
    """Return the scenario and the code files to store with a run.

    A file is named relative to the stored scenario; code of the testbed or of an installed package
    keeps its name.

    Raises:
        InputError: a file cannot be read, or two have the same name.
    """
    changes: list[tuple[KeyPath, str]] = []
    files: dict[str, bytes] = {}
    for loc, name in code_references(scenario):
        module_name, _, object_name = find_code(name).rpartition(":")
        path = Path(name if name.endswith(FMU) else module_name)
        if path.suffix not in (".py", FMU) or path.parent == library() / "scenarios":
            continue
        code = read_fmu(path) if path.suffix == FMU else _read(path)
        if files.setdefault(path.name, code) != code:
            raise InputError(
                f"{'.'.join(map(str, loc))}: two different files are named {path.name} (rename one)"
            )
        changes.append((loc, path.name if path.suffix == FMU else f"{path.name}:{object_name}"))
    return (with_values(scenario, changes) if changes else scenario), files


def is_installed(name: str) -> bool:
    """Return whether the package of a module is installed, also in editable mode.

    Nothing is imported. Modules of the standard library do not count: none of them is a law.
    """
    try:
        spec = importlib.util.find_spec(name.partition(".")[0])
    except (ImportError, ValueError):
        return False
    if spec is None:
        return False
    paths = [spec.origin, *(spec.submodule_search_locations or ())]
    found = [Path(path).resolve() for path in paths if path]
    return any(path.is_relative_to(folder) for folder in _package_folders() for path in found)


def _package_folders() -> Iterator[Path]:
    """Yield the site-packages folders, and those of editable installations."""
    for each in (*map(sysconfig.get_path, ("purelib", "platlib")), site.getusersitepackages()):
        yield Path(each).resolve()
    for package in distributions():
        source = json.loads(package.read_text("direct_url.json") or "{}")
        if source.get("dir_info", {}).get("editable"):
            yield Path(unquote(urlsplit(source["url"]).path)).resolve()


def _in_library(path: Path) -> bool:
    """Return whether a file is a law of the library, or belongs to the testbed's scenarios."""
    return path.parent in (LAWS, library() / "scenarios")


def _describe(module_name: str, origin: str) -> str:
    """Describe the code independently of the folder it is in."""
    path = Path(origin)
    digest = hashlib.sha256(_read(path)).hexdigest()[:12] if path.is_file() else "unknown"
    if not module_name.endswith(".py"):
        return f"the installed module {module_name} (SHA-256 {digest})"
    return f"{path.name}{' of the testbed' * _in_library(path)} (SHA-256 {digest})"


def _read(path: Path) -> bytes:
    return read_bounded(path, error=InputError)


def read_fmu(path: Path) -> bytes:
    """Return the bytes of an FMU.

    Raises:
        InputError: it cannot be read, or is too large.
    """
    return read_bounded(path, MAX_FMU_BYTES, error=InputError)


_loaded: dict[str, set[str]] = {}  # modules that the first import of code has loaded, by its file


def loaded_by(origin: str) -> Sequence[str]:
    """Return the names of the modules that the imports of a file have loaded in this process."""
    return sorted(_loaded.get(origin, ()))


def import_code(name: str, key: str) -> tuple[ModuleType, str]:
    """Import a file or an installed module for a key; return it with its path.

    Raises:
        InputError: it does not exist, or its import fails; the text begins with the key.
    """
    before = set(sys.modules)
    module, origin = _import(name, key)
    _loaded.setdefault(origin, set()).update(sys.modules.keys() - before)
    return module, origin


def _import(name: str, key: str) -> tuple[ModuleType, str]:
    what = "the law" if key == "controller.law" else "the module"
    if name.endswith(".py"):
        path = Path(name)
        # under a prefixed name: it must not hide a module of the same name
        spec = importlib.util.spec_from_file_location(f"testbed_law_{path.stem}", path)
        if spec is None or spec.loader is None or not path.is_file():
            raise InputError(f"{key}: there is no file {path}")
        module = importlib.util.module_from_spec(spec)
        # dataclasses look up the module while their class is defined
        sys.modules[spec.name] = module
        # leave no __pycache__ beside the scenario
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        try:
            with user_code_errors(str(path), what):
                spec.loader.exec_module(module)
        except InputError as error:
            raise InputError(f"{key}: {path} cannot be imported: {error}") from error
        finally:
            sys.dont_write_bytecode = before
        return module, str(path)
    remedy = f"write a {name}.py beside the scenario, install the package, or check the name"
    if not all(part.isidentifier() for part in name.split(".")) or not is_installed(name):
        raise InputError(f"{key}: no module {name!r} ({remedy})")
    try:
        with user_code_errors(name, what):
            module = importlib.import_module(name)
            return module, str(getattr(module, "__file__", None) or name)
    except InputError as error:
        raise InputError(f"{key}: no module {name!r} ({remedy}): {error}") from error


SEED = 11
STEPS = 4
MISSING_SHARES = (0.0, 0.3)  # of messages that are missing, and of those that are old
SPEED_FACTOR = 2.0  # of the speed bounds, beyond which a commanded speed has another unit
Command = UnicycleCommand | FbwaCommand[Array]
Step = tuple[float, OwnState, Inbox]


def check_law(law: Law, config: FormationConfig) -> type[Command]:
    """Check a law on generated flights of its followers, and return its type of command.

    Raises:
        InputError: naming the first rule that it violates, or the exception that it raises.
    """
    with user_code_errors(law_file(law)):
        return _check_rules(law, config)


def _check_rules(law: Law, config: FormationConfig) -> type[Command]:
    rng = np.random.default_rng(SEED)
    before = _attributes(law)
    for share in MISSING_SHARES:
        flight = [_make_step(config, rng, share, k * config.dt) for k in range(STEPS)]
        flight = _with_payloads(law, config, flight)
        commands = _fly(law, config, flight)
        if not _same(commands, _fly(law, config, flight)):
            _reject(
                law,
                f"returns another command for the same input ({_remedy(law)})",
            )
        for row in range(len(config.names) if len(config.names) > 1 else 0):
            _check_locality(law, config, flight, commands, rng, row)
        _check_interleaved(law, config, flight, commands, rng)
        for command in commands:
            if isinstance(command, UnicycleCommand):
                _check_axes(law, command)
    _check_values(law, config)
    _check_attributes(law, before)
    return type(commands[0])


def _check_values(law: Law, config: FormationConfig) -> None:
    """Check units and axes of commands in level flight in the slots at the trim airspeed."""
    rng = np.random.default_rng(SEED)
    calm = [_make_step(config, rng, 0.0, k * config.dt, noise=0.0) for k in range(STEPS)]
    calm = _with_payloads(law, config, calm)
    commands = _fly(law, config, calm)
    unicycle = [each for each in commands if isinstance(each, UnicycleCommand)]
    for name in ("speed", "speed_desired") if unicycle else ():
        speeds = np.median([getattr(each, name) for each in unicycle], axis=0)
        for row, speed in enumerate(speeds):
            low, high = config.airspeed_min[row], config.airspeed_max[row]
            if not low / SPEED_FACTOR <= speed <= high * SPEED_FACTOR:
                _reject(
                    law,
                    f"returns a {name} of {speed:.4g} for {config.names[row]} near its slot, "
                    f"whose bounds are {low:g} to {high:g} m/s (speeds are in m/s)",
                )
    for each in commands:
        if isinstance(each, FbwaCommand):
            for name in ("pitch", "roll"):
                angle = abs(getattr(each, name)).max()
                if angle > np.pi / 2.0:
                    _reject(law, f"returns a {name} of {angle:.4g} (angles are in rad)")


def _check_axes(law: Law, command: UnicycleCommand) -> None:
    """Check that directions are unit vectors, and that ω has no component along the velocity."""
    length = np.linalg.norm(command.direction, axis=1)
    if abs(length - 1.0).max() > 1e-6:
        _reject(law, f"returns a direction of length {length.max():.4g} (unit vectors)")
    rolling = command.omega[:, 0]
    if rolling.any():
        _reject(
            law,
            f"returns omega with a first component of {rolling[abs(rolling).argmax()]:.4g} rad/s "
            "(write 0: omega is (0, pitch rate, yaw rate), and the velocity frame does not roll)",
        )


def _check_interleaved(
    law: Law,
    config: FormationConfig,
    flight: list[Step],
    commands: list[Command],
    rng: np.random.Generator,
) -> None:
    """Check that a flight is the same while another one is stepped at the same times."""
    other = []
    for now, own, inbox in flight:
        moved = OwnState(
            *(each * (1.0 + 0.1 * draws.random(each.shape)) for each, draws in _drawing(own, rng))
        )
        other.append((now, moved, inbox))
    memories = [law.start(_read_only(each[0][1])) for each in (other, flight)]
    for one, two, expected in zip(other, flight, commands, strict=True):
        for k, (now, own, inbox) in enumerate((one, two)):
            result = law.step(now, _read_only(own), _read_only(inbox), memories[k])
            command, memories[k] = result
        if not _same([expected], [validate_command(command, config, two[0])]):
            _reject(
                law,
                f"returns another command where it also steps another flight ({_remedy(law)})",
            )


def _attributes(law: Law) -> dict[str, bytes]:
    """Return the attributes of a law as bytes; those that cannot be pickled are left out."""
    with unrecorded():  # pickling reads all fields, which is no use of them
        found = {name: _pickled(value) for name, value in getattr(law, "__dict__", {}).items()}
    return {name: value for name, value in found.items() if value}


def _check_attributes(law: Law, before: dict[str, bytes]) -> None:
    """Check that no attribute of a law has changed."""
    after = _attributes(law)
    changed = [name for name in after if before.get(name) != after[name]]
    if changed:
        _reject(
            law,
            f"changes its attribute {changed[0]!r} while it steps (store state in the memory, "
            "which step receives and returns)",
        )


def _fly(law: Law, config: FormationConfig, flight: list[Step]) -> list[Command]:
    """Return the command of each step; memory and inputs must not be modified."""
    commands = []
    memory = law.start(_read_only(flight[0][1]))
    twin = law.start(_read_only(flight[0][1])) if keeps_state(law) else None
    for now, own, inbox in flight:
        before = copy.deepcopy(memory) if twin is None else twin
        with _naming_missing_messages(config, inbox):
            try:
                result = law.step(now, _read_only(own), _read_only(inbox), memory)
            except ValueError as error:
                if "read-only" not in str(error):
                    raise
                _reject(law, f"writes into its inputs ({error}; make a copy)")
            if not (isinstance(result, tuple) and len(result) == 2):
                _reject(law, "must return two values from step: the command and the memory")
            command, after = result
            modified = twin is None and _pickled(memory) != _pickled(before)
            again, twin_after = law.step(now, _read_only(own), _read_only(inbox), before)
            twin = None if twin is None else twin_after
            command = validate_command(command, config, now)
            if (outputs := outputs_of(law)).fields:
                _read_outputs(law, outputs, after, len(config.names))
        if modified or not _same([command], [validate_command(again, config, now)]):
            _reject(
                law,
                f"does not carry its memory as a value ({_remedy(law, in_step=True)})",
            )
        commands.append(command)
        memory = after
    return commands


def keeps_state(law: Law) -> bool:
    """Return whether a law is an FMU whose state is in its instances and cannot be saved."""
    return bool(getattr(law, "why_not_saved", ""))


def _remedy(law: Law, *, in_step: bool = False) -> str:
    """Return where a law should keep its state."""
    if keeps_state(law):
        return "return to the start in the reset function, and share no variable between instances"
    if hasattr(law, "library"):
        return "write all state of an instance into its serialised state, and share no variable"
    if in_step:
        return (
            "return a new memory from step, do not modify the old one, and store state nowhere else"
        )
    return "store state in the memory, not in attributes or global variables"


@contextmanager
def _naming_missing_messages(config: FormationConfig, inbox: Inbox) -> Iterator[None]:
    """Add to the errors of a step which followers lacked messages.

    Raises:
        InputError: in place of one that is raised in the block.
    """
    missing = np.isnan(inbox.stamp_s)
    of_leader = missing[:, 0].any()
    rows = np.flatnonzero(missing[:, 0] if of_leader else missing.any(axis=1))
    note = ""
    if rows.size:
        what = "messages of the leader" if of_leader else "messages"
        names = ", ".join(config.names[row] for row in rows)
        note = (
            f"in this trial {what} had not arrived at {names} (NaN in the inbox), others were old"
        )
    try:
        yield
    except InputError as error:
        raise InputError(f"{error}; {note}" if note else str(error)) from error
    except Exception as error:
        if note:
            error.add_note(note)
        raise


def _check_locality(
    law: Law,
    config: FormationConfig,
    flight: list[Step],
    commands: list[Command],
    rng: np.random.Generator,
    row: int,
) -> None:
    """Check that a follower's command does not depend on the inputs of the others."""
    changed = []
    for now, own, inbox in flight:
        other_own = OwnState(
            *(_perturb_others(each, draws, row) for each, draws in _drawing(own, rng))
        )
        content = [_perturb_others(each, draws, row) for each, draws in _drawing(inbox, rng)][2:]
        changed.append((now, other_own, Inbox._make((*inbox[:2], *content))))
    others = [name for name in config.names if name != config.names[row]]
    for before, after in zip(commands, _fly(law, config, changed), strict=True):
        for field, one, two in zip(before._fields, _arrays(before), _arrays(after), strict=True):
            if not np.allclose(one[row], two[row], rtol=1e-9, atol=1e-9):
                _reject(
                    law,
                    f"returns another {field} for {config.names[row]} when only inputs of "
                    f"{', '.join(others)} change (row i may use row i of own and inbox only)",
                )


def _drawing(
    record: OwnState | Inbox, rng: np.random.Generator
) -> Iterator[tuple[Any, np.random.Generator]]:
    """Yield the fields of a record, each with a generator.

    Fields that were added later have one of their own, so that the other trials stay the same.
    """
    for k, each in enumerate(record):
        times = isinstance(record, Inbox) and k < 2  # which are not changed
        yield each, np.random.default_rng(SEED) if times or k >= 7 else rng


def _perturb_others(values: Any, rng: np.random.Generator, row: int) -> Any:  # noqa: ANN401
    """Return a copy with all rows but one increased by up to 10 %; flags are the others."""
    factor = 1.0 + 0.1 * rng.random(values.shape)
    out = ~values if values.dtype == np.bool_ else values * factor
    out[row] = values[row]
    return out


def _make_step(
    config: FormationConfig, rng: np.random.Generator, share: float, now: float, noise: float = 1.0
) -> Step:
    """Generate estimates and messages of a formation in level flight north, near its slots."""
    n, aircraft = len(config.names), len(config.offsets)
    speed = float(np.mean(config.trim_airspeed))
    centre = np.array([now * speed, 0, -100.0])
    position = config.offsets + noise * rng.normal(0.0, 3.0, (aircraft, 3)) + centre
    velocity = np.array([speed, 0.0, 0.0]) + noise * rng.normal(0.0, 1.0, (aircraft, 3))
    acceleration = noise * rng.normal(0.0, 0.5, (aircraft, 3))
    euler = noise * rng.normal(0.0, 0.2, (aircraft, 3))
    rates = noise * rng.normal(0.0, 0.1, (aircraft, 3))
    rows = config.agents
    airspeed = np.linalg.norm(velocity, axis=1)
    own = OwnState(
        position[rows],
        velocity[rows],
        acceleration[rows],
        euler[rows],
        rates[rows],
        airspeed[rows],
        airspeed[rows],
        np.zeros((n, 3)),
    )
    # some messages are missing, and some are older than the time-out
    old = rng.random((n, aircraft)) < share
    limit = np.full(aircraft, config.neighbour_timeout_s)
    limit[0] = config.leader_timeout_s
    stamp = now - np.where(old, 2.0 * limit * rng.random((n, aircraft)), 0.0)
    stamp[rng.random((n, aircraft)) < share] = np.nan
    missing = np.isnan(stamp)[:, :, np.newaxis]
    content = (position, velocity, acceleration, euler, rates)
    received = (np.where(missing, np.nan, np.stack([each] * n)) for each in content)
    turn_rate = (velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]) / (
        velocity[:, 0] ** 2 + velocity[:, 1] ** 2
    )
    turns = np.where(missing[..., 0], np.nan, turn_rate)
    chosen = np.random.default_rng((SEED, round(now / config.dt))).random((n, aircraft)) < share
    failed = ~missing[..., 0] & chosen
    added = turns, failed, np.zeros((n, aircraft, 0))
    return now, own, Inbox._make((stamp, stamp.copy(), *received, *added))


def _with_payloads(law: Law, config: FormationConfig, flight: list[Step]) -> list[Step]:
    """Return a flight in which messages carry what the law has sent in the step before."""
    outputs, found = outputs_of(law), list[Step]()
    if not outputs.sent:
        return flight
    memory, own_columns = law.start(_read_only(flight[0][1])), outputs.columns(outputs.sent)
    sent = np.full((flight[0][2].stamp_s.shape[1], len(own_columns)), np.nan)
    for now, own, inbox in flight:
        missing = np.isnan(inbox.stamp_s)[..., np.newaxis]
        inbox = inbox._replace(payload=np.where(missing, np.nan, sent))
        found.append((now, own, inbox))
        result: Any = law.step(now, _read_only(own), _read_only(inbox), memory)
        if not (isinstance(result, tuple) and len(result) == 2):
            return flight  # refused by another check
        memory = result[1]
        read = _read_outputs(law, outputs, memory, len(config.names))
        sent[config.agents] = read[:, own_columns]
    return found


def _read_outputs(law: Law, outputs: Outputs, memory: object, n: int) -> Array:
    """Return the outputs (n, F) of a law."""
    try:
        return outputs.read(memory, n)
    except ValueError as error:
        _reject(law, f"has outputs, but {error}")


def _read_only(record: Any) -> Any:  # noqa: ANN401 - a record of arrays
    copies = [each.copy() for each in record]
    for each in copies:
        each.flags.writeable = False
    return type(record)(*copies)


def _pickled(memory: Any) -> bytes:  # noqa: ANN401 - any type
    """Return the memory as bytes for a comparison; empty if it cannot be pickled."""
    try:
        return pickle.dumps(memory)
    except Exception as error:  # of the types in it, which may be the user's
        raise_memory_shortage(error)
        return b""


def _arrays(command: Any) -> list[Array]:  # noqa: ANN401 - a record of arrays
    return list(command)


def _same(ours: list[Command], theirs: list[Command]) -> bool:
    return all(
        type(one) is type(two) and all(map(np.array_equal, _arrays(one), _arrays(two)))
        for one, two in zip(ours, theirs, strict=True)
    )


def _reject(law: Law, text: str) -> NoReturn:
    raise InputError(f"controller.law: {law_name(law)} {text}")
