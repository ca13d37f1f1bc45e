"""Compiled twins: the laws that cost most, written out per agent for numba.

A flight steps a handful of agents, for which numpy's cost is all in its calls. The readable numpy
function stays the definition; a twin of the same name does the same per agent in machine code,
kept beside the bytecode, and a test holds the two together. Without numba, or with TESTBED_NUMPY=1
in the environment, the numpy functions fly: results agree to rounding, not to the bit.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import importlib.util
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from testbed.standing_in import standing_in

F = TypeVar("F", bound=Callable[..., Any])
_NAME = re.compile(r"\w+")
_IMPORT = re.compile(
    r"^[ \t]*(?:from|import)[ \t]+testbed([\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|[^\n#]*))?", re.M
)


def engine() -> str:
    """Which flies: "numba", or "numpy" where numba is missing or not wanted."""
    if os.environ.get("TESTBED_NUMPY"):
        return "numpy"
    return "numba" if importlib.util.find_spec("numba") else "numpy"


def load_engine() -> None:
    """Load what will fly, which takes a while, now."""
    if engine() == "numba":
        importlib.import_module("numba")


def twin_of(function: F, module: str) -> F:
    """The compiled function of the same name in a module of twins, or the function itself.

    It is looked up at the first call, because a module of twins imports what it copies.
    """
    chosen: list[Callable[..., Any]] = []

    @functools.wraps(function)
    def call(*args: Any) -> Any:  # noqa: ANN401 - whatever the function takes and gives
        if not chosen:
            twins = importlib.import_module(module) if engine() == "numba" else None
            chosen.append(getattr(twins, function.__name__) if twins else function)
        return chosen[0](*args)

    return call  # type: ignore[return-value]


def ready_of(function: Callable[..., Any], module: str) -> Callable[..., Callable[..., Any]]:
    """What binds the first arguments of a function, or of its compiled twin, for many calls.

    numba asks every argument for its type at every call, a table of records for each of its fields:
    that can take longer than the law itself. What is bound is asked once. Its arrays may change in
    place. The module of twins has a function `ready_<name>`, which calls `bound`; or the function
    itself takes nothing but arrays and numbers, all of them bound.
    """
    chosen: list[Callable[..., Any]] = []

    def bind(*fixed: Any) -> Callable[..., Any]:  # noqa: ANN401 - whatever the function takes
        if not chosen:
            if engine() == "numba":
                twins, name = importlib.import_module(module), function.__name__
                ready = getattr(twins, f"ready_{name}", None)
                chosen.append(ready or functools.partial(bound, getattr(twins, name)))
            else:
                chosen.append(functools.partial(functools.partial, function))
        call: Callable[..., Any] = chosen[0](*fixed)
        return call

    return bind


def bound(function: Callable[..., Any], *fixed: Any, more: tuple[Any, ...] = ()) -> Any:  # noqa: ANN401
    """A compiled function with its first arguments bound.

    Args:
        function: a `twin`.
        fixed: its first arguments.
        more: of each argument behind them one such as will come; three at most.

    Raises:
        TypeError: an argument is neither array, number, truth, nor a tuple of these.
    """
    from testbed.unboxed import Unboxed, kind_of

    kinds = tuple(map(kind_of, fixed))
    unboxed = Unboxed(kinds, fixed)
    return functools.partial(_entry(function, kinds, tuple(map(kind_of, more))), unboxed)


@functools.cache
def _entry(function: Callable[..., Any], kinds: tuple[Any, ...], more: tuple[Any, ...]) -> Any:  # noqa: ANN401
    """What Python calls of a function whose first arguments, of these types, are unboxed."""
    from testbed.unboxed import UnboxedType

    dispatcher, types = _calling(function, len(more)), (UnboxedType(kinds), *more)
    dispatcher.compile(types)
    return dispatcher.overloads[types].entry_point


@functools.cache
def _calling(function: Callable[..., Any], more: int) -> Any:  # noqa: ANN401 - numba's
    from testbed.unboxed import calling

    compiled: Any = twin(calling(function, more))
    _save_alone(compiled)
    return compiled


def twin(function: F) -> F:
    """Compile a function of a module of twins at its first call, and keep the machine code.

    Raises:
        ImportError: numba is missing.
    """
    import numba

    config: Any = numba.config
    wanted = config.CACHE_DIR
    config.CACHE_DIR = _machine_code(wanted)
    try:
        # numpy divides by zero as IEEE does; nothing is reordered, so that runs repeat to the bit
        compiled: Any = numba.njit(cache=True, error_model="numpy")(function)
        _load_alone(compiled)
        return compiled  # type: ignore[no-any-return]
    finally:
        config.CACHE_DIR = wanted


def instructions(function: F) -> F:
    """A function of a module of twins that writes LLVM's instructions: numba's `intrinsic`.

    Raises:
        ImportError: numba is missing.
    """
    from numba.extending import intrinsic

    made: Any = intrinsic(function)
    return made  # type: ignore[no-any-return]


def _load_alone(compiled: Any) -> None:  # noqa: ANN401 - numba's
    """Let a function's machine code be loaded without what only compiling needs.

    Before it looks for machine code numba collects the types and operations of all that it can
    compile, scipy's linear algebra too: a fifth of a run's start. What is not found is compiled,
    for which it collects them all the same.
    """
    from numba.core.runtime.nrt import rtsys

    cache = compiled._cache

    def load(signature: Any, context: Any) -> Any:  # noqa: ANN401
        rtsys.initialize(context)
        with cache._guard_against_spurious_io_errors(), standing_in("scipy.linalg.cython_blas"):
            return cache._load_overload(signature, context)

    cache.load_overload = load


def _save_alone(compiled: Any) -> None:  # noqa: ANN401 - numba's
    """Keep the machine code of a function without what only other compiled code would need.

    That is the same in LLVM's own terms, which takes longer to load than the machine code: of it
    only the names are kept, by which numba knows what there is.
    """
    from llvmlite.binding import parse_assembly

    kept = compiled._cache._impl
    reduce = kept.reduce

    def machine_code(result: Any) -> Any:  # noqa: ANN401
        module = result.library._get_module_for_linking()
        names = [each.name for each in module.functions if not each.is_declaration]
        held = [each.name for each in module.global_variables if not each.is_declaration]
        lines = [f'define void @"{_quoted(name)}"() {{ ret void }}' for name in names]
        lines += [f'@"{_quoted(name)}" = global i8 0' for name in held]
        (name, form, (code, _)), *rest = reduce(result)
        return ((name, form, (code, parse_assembly("\n".join(lines)).as_bitcode())), *rest)

    kept.reduce = machine_code


def _quoted(name: str) -> str:
    """A name as LLVM's text has it between quotation marks."""
    return "".join(chr(c) if chr(c).isalnum() and c < 128 else f"\\{c:02X}" for c in name.encode())


@functools.cache
def _machine_code(wanted: str) -> str:
    """The folder of the machine code of these sources; it need not be there, or be writable.

    numba looks for changes in a function's own file alone. A twin holds constants and calls
    functions of other files too, so what was compiled from other sources is not used again: the
    twins, and all that they import, directly or not.

    Args:
        wanted: parent that the environment asks for; empty: beside the bytecode.
    """
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for name, text in sorted(_sources(package).items()):
        digest.update(name.encode() + text)
    parent = Path(wanted) if wanted else package / "__pycache__"
    folder = parent / f"twins-{digest.hexdigest()[:16]}"
    if not folder.exists():
        for stale in parent.glob("twins-*"):
            shutil.rmtree(stale, ignore_errors=True)
    return str(folder)


def _sources(package: Path) -> dict[str, bytes]:
    """The modules of twins, and every module of the package that they lead to; with their text.

    Returns:
        By the path below the package.
    """
    found: dict[str, bytes] = {}
    tried: set[str] = set()
    twins = (twin.relative_to(package).with_suffix("") for twin in package.rglob("*twin.py"))
    waiting = {Path(__file__).stem, *(twin.as_posix() for twin in twins)}
    while waiting := waiting - tried:
        tried |= waiting
        led_to: set[str] = set()
        for name in waiting:
            try:
                text = (package / f"{name}.py").read_bytes()
            except FileNotFoundError:  # what is imported from a module need not be one itself
                continue
            found[f"{name}.py"] = text
            for module, names in _IMPORT.findall(text.decode()):
                place = module.lstrip(".").replace(".", "/")
                led_to |= {place, f"{place}/__init__"}
                led_to |= {f"{place}/{each}" for each in _NAME.findall(names)}
        waiting = {name.lstrip("/") for name in led_to}
    return found
