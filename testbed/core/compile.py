"""Compile kernels with numba and keep their machine code on disk.

A kernel is a function in plain scalar Python, for one aircraft or for a few arrays of records.
`@kernel` marks one that other kernels call, `@entry` one that Python calls: the machine code of an
entry, with all kernels in it, is kept on disk. So is that of a `@kept_kernel`, which kernels of
users call. `@jitable` marks a function that kernels may call and that Python calls uncompiled.

The entries of a flight are bound by `bind_entry`, which registers them while the flight is built.
`prepare` compiles or loads them before the first tick.

Machine code that is missing, damaged or not to be trusted is compiled anew: see `kept_files`.

One process at a time compiles the same kernels. The files for that are in the folder to which
machine code is written: `turn` is locked by the process that prepares kernels for the first time,
`compiling` while one of them is compiled rather than loaded, and `ready-…` marks sets of kernels
that need not be waited for. A lock ends with its process.

With NUMBA_DISABLE_JIT=1 in the environment all of them run as Python, for a debugger.
"""

from __future__ import annotations

import fcntl
import functools
import gc
import hashlib
import linecache
import os
import re
import shutil
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, TypeAlias, TypeVar

from testbed.core.kept_files import KeptFiles, Place, open_kept_files

F = TypeVar("F", bound=Callable[..., Any])
R = TypeVar("R")
Types: TypeAlias = tuple[Any, ...]  # numba's, of the arguments of an entry


class Compilable(Protocol):
    """An entry, or what has machine code of its own for one."""

    __module__: str
    __qualname__: str

    def has(self, types: Types) -> bool:
        """Return whether there is machine code in this process."""

    def compile(self, types: Types) -> object:
        """Compile it for arguments of these types, or load the machine code."""


Arguments: TypeAlias = tuple[Compilable, tuple[Any, ...]]  # an entry, and arguments of its calls

Progress: TypeAlias = Callable[[int, int], None]  # called with the entries done, and all

_registered: ContextVar[list[Arguments] | None] = ContextVar("registered", default=None)
_progress: ContextVar[Progress | None] = ContextVar("progress", default=None)

# Packages with kernels, or from which kept results follow: a change in any of their files makes all
# machine code and all results anew.
KERNEL_PACKAGES = (
    *("core", "airframes", "atmosphere", "ardupilot", "autopilot", "commissioning", "compiled"),
    *("flight", "fmi", "formation", "guidance", "network", "sensors", "vehicle"),
)
_FOLDER_NAME = re.compile("kernels-[0-9a-f]{16}")
_FILE_NAME = re.compile(
    r"turn|compiling|ready-[0-9a-f]+|result-[a-z-]+-[0-9a-f]+|.+\.code|\.[0-9a-f]+\.part"
    # of earlier versions
    r"|proof-[0-9a-f]+|run_[0-9a-f]+\.source|proof-[0-9a-f]+\.json|.+\.nb[ci](\.tmp\..+)?"
)  # in it
_COLLECT_EVERY = 50_000  # new objects, where kernels are compiled
UNUSED_DAYS = 30  # after which machine code in a shared folder is removed
# numba reads it, too, when it is imported
_INTERPRETED = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")
# numpy divides by zero as IEEE does; nothing is reordered, so that runs repeat to the bit
_OPTIONS: dict[str, Any] = {"error_model": "numpy"}
_CHECKED = {**_OPTIONS, "boundscheck": True}


class CompiledFunction:
    """An entry or a kernel: numba's function is made when it is first needed.

    numba takes 0.3 ms to make one, and where machine code is loaded, its kernels are not needed.
    """

    CONSTANT = True
    __qualname__: str

    def __init__(self, function: Callable[..., Any], make: Callable[[], Any]) -> None:
        """Make nothing yet.

        Args:
            function: of Python.
            make: returns numba's dispatcher of it.
        """
        functools.update_wrapper(self, function)
        self.py_func = function
        self._make = make

    @functools.cached_property
    def dispatcher(self) -> Any:  # noqa: ANN401 - numba's
        """What numba compiles."""
        _register_jitable()
        return self._make()

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401 - numba's
        """By which numba knows it where another function calls it."""
        return self.dispatcher._numba_type_

    @property
    def signatures(self) -> list[Types]:
        """Types of the arguments for which there is machine code."""
        found: list[Types] = self.dispatcher.signatures
        return found

    @property
    def overloads(self) -> dict[Types, Any]:
        """What numba has compiled or loaded, by the types of the arguments."""
        found: dict[Types, Any] = self.dispatcher.overloads
        return found

    def has(self, types: Types) -> bool:
        """Return whether there is machine code in this process."""
        return types in self.overloads

    def compile(self, types: Types) -> object:
        """Compile it for arguments of these types, or load the machine code."""
        found: object = self.dispatcher.compile(types)
        return found

    def __call__(self, *args: Any, **named: Any) -> Any:  # noqa: ANN401
        """Call it from Python."""
        return self.dispatcher(*args, **named)

    def __reduce__(self) -> str:
        """Return its name, by which `pickle` and `copy` know it, as they do other functions."""
        return self.__qualname__


class _NotFromPython(CompiledFunction):
    """A function without numba's wrapper for Python, a call of which would end the process."""

    def __call__(self, *args: Any, **named: Any) -> Any:  # noqa: ANN401
        """Refuse it."""
        raise TypeError(
            f"{self.__qualname__} is called by its address (make a call_list.Call), or by kernels"
        )


def _compiled(
    function: F, make: Callable[[], Any], kind: type[CompiledFunction] = CompiledFunction
) -> F:
    if is_interpreted():
        return function
    return kind(function, make)  # type: ignore[return-value]


def kernel(function: F) -> F:
    """Compile a function that other kernels call."""
    return _compiled(function, lambda: _make_kernel(function, _OPTIONS))


def entry(function: F) -> F:
    """Compile a function that Python calls, and keep its machine code on disk where possible."""
    return _compiled(function, lambda: _make_entry(function, _OPTIONS))


def entry_beside_python(function: F) -> F:
    """Compile as `entry` does; other threads run Python meanwhile."""
    return _compiled(function, lambda: _make_entry(function, {**_OPTIONS, "nogil": True}))


def kept_kernel(function: F) -> F:
    """Compile a function that kernels of users call, and keep its machine code on disk.

    The first law that calls it compiles it; later ones load it.
    """
    options = {**_OPTIONS, "no_cpython_wrapper": True}
    return _compiled(function, lambda: _make_entry(function, options), _NotFromPython)


def checked_kernel(function: F) -> F:
    """Compile a function of a user's that kernels call; an index out of bounds is an exception."""
    return _compiled(function, lambda: _make_kernel(function, _CHECKED))


def entry_of_user_code(function: F, digest: str | None) -> F:
    """Compile an entry that calls checked kernels, and is called by its address alone.

    Without numba's wrapper for Python, which unpacks all arguments, it compiles sooner.

    Args:
        function: as `entry` has it; it may use variables of the function that encloses it.
        digest: of all that it consists of, which names the machine code; None: that is not kept.
    """
    if digest is not None:
        function.__name__ = function.__qualname__ = f"{function.__name__}_{digest[:32]}"
    by_name = None if digest is None else True
    options = {**_CHECKED, "no_cpython_wrapper": True}

    def make() -> Any:  # noqa: ANN401 - numba's
        return _make_entry(function, options, by_name=by_name)

    return _compiled(function, make, _NotFromPython)


def _make_kernel(function: Callable[..., Any], options: dict[str, Any]) -> Any:  # noqa: ANN401
    from testbed.core.kernel_code import Kernel

    return Kernel(function, options=options)


def _make_entry(
    function: Callable[..., Any], options: dict[str, Any], *, by_name: bool | None = False
) -> Any:  # noqa: ANN401
    """Return numba's dispatcher of an entry.

    Args:
        function: of Python.
        options: numba's.
        by_name: see `machine_code.KeptCode`; None: its machine code is not kept.
    """
    import numba

    njit: Any = numba.njit
    compiled = njit(**options, no_cfunc_wrapper=True)(function)
    if by_name is not None:
        _keep(compiled, function, by_name=by_name)
    return compiled


def entry_of_source(name: str, source: str) -> Callable[..., Any]:
    """Compile a function of generated source as an entry.

    Tracebacks and debuggers show the source, which is in no file.

    Args:
        name: of the function, different for each source.
        source: of a module with the function; of this package's making, as it is executed.
    """
    file = f"<{name}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    module = ModuleType(f"{__package__}.generated.{name}")
    sys.modules[module.__name__] = module  # where numba finds it when it loads machine code
    exec(compile(source, file, "exec"), module.__dict__)
    generated: Callable[..., Any] = entry(module.__dict__[name])
    return generated


def address_of(function: Callable[..., Any], returns: Any, *types: Any) -> int:  # noqa: ANN401
    """Compile a function for calls by its address, or load its machine code.

    Args:
        function: as `entry` has it; its name is that of its machine code.
        returns: type of its result, numba's.
        types: of its arguments, numba's.
    """
    from numba.core.ccallback import CFunc

    compiled: Any = CFunc(function, (types, returns), locals={}, options=dict(_OPTIONS))
    _keep(compiled, function, by_name=True)
    compiled.compile()
    return int(compiled.address)


def is_interpreted() -> bool:
    """Return whether entries and kernels run as Python."""
    return _INTERPRETED


def is_compiled(value: object) -> bool:
    """Return whether something is a function that numba compiles."""
    from numba.core.dispatcher import Dispatcher

    return isinstance(value, CompiledFunction | Dispatcher)


def _keep(compiled: Any, function: Callable[..., Any], *, by_name: bool) -> None:  # noqa: ANN401
    """Keep machine code on disk; numba's own caches see changes in the file of an entry only.

    Args:
        compiled: numba's dispatcher or callback.
        function: that it compiles.
        by_name: see `machine_code.KeptCode`.
    """
    from testbed.core.machine_code import KeptCode

    compiled._cache = KeptCode(function, kept_files(), by_name=by_name)


def jitable(function: F) -> F:
    """Let kernels call a function, which stays plain Python when Python calls it."""
    _jitable.append(function)
    return function


_jitable: list[Callable[..., Any]] = []  # not yet known to numba


def _register_jitable() -> None:
    from numba.extending import register_jitable

    while _jitable:
        register_jitable(_jitable.pop())


def bind_entry(
    function: Callable[..., R], *args: object, like: Sequence[object] = ()
) -> functools.partial[R]:
    """Bind an entry to its first arguments, and register it where entries are registered.

    Args:
        function: an entry.
        args: its first arguments.
        like: examples of all further arguments; calls have arguments of the same types.

    Returns:
        The entry bound to `args`.
    """
    if isinstance(function, CompiledFunction):  # not in debug mode
        register(function, *args, *like)
    return functools.partial(function, *args)


def register(function: Compilable, *args: object) -> None:
    """Register an entry with arguments of the types of its calls, where entries are registered."""
    if (entries := _registered.get()) is not None:
        entries.append((function, args))


@contextmanager
def registering() -> Iterator[None]:
    """Register the entries that are bound in the block; also a decorator of functions."""
    token = _registered.set([])
    try:
        yield
    finally:
        _registered.reset(token)


def types_of(args: Sequence[object]) -> Types:
    """Return numba's types of arguments; those of arrays of records take it 0.2 ms each."""
    return tuple(map(_type_of, args))


def _type_of(value: object) -> Any:  # noqa: ANN401
    # imported here, as every command imports this module for its notice
    import numba
    import numpy as np

    typeof: Any = numba.typeof
    if type(value) is not np.ndarray:
        return typeof(value)
    flags = value.flags
    layout = flags.c_contiguous, flags.f_contiguous, flags.aligned, flags.writeable
    key = value.dtype, value.ndim, layout
    if key not in _array_types:
        _array_types[key] = typeof(value)
    return _array_types[key]


_array_types: dict[tuple[Any, ...], Any] = {}


def registered() -> tuple[Arguments, ...]:
    """Return the entries registered so far in this block, for `prepare`."""
    return tuple(_registered.get() or ())


@contextmanager
def reporting(progress: Progress | None) -> Iterator[None]:
    """Use this where `prepare` is called in the block without a function of its own."""
    token = _progress.set(progress)
    try:
        yield
    finally:
        _progress.reset(token)


def current_progress() -> Progress | None:
    """Return the function of `reporting`, if there is one."""
    return _progress.get()


def prepare(
    calls: Iterable[Arguments],
    progress: Progress | None = None,
    check: Callable[[], None] = lambda: None,
) -> None:
    """Compile entries for the arguments they are bound to, or load their machine code.

    Of several processes that need the same entries one compiles, and the others wait for it.
    Entries that have machine code in this process are left out.

    Args:
        calls: entries, each with arguments of the types of its calls; nothing is called.
        progress: called with the number of entries done and of these, from the moment at which the
            first has to be compiled; not at all where machine code is loaded. None: that of
            `reporting`.
        check: called before each entry, and while another process compiles; an error that it
            raises ends the call.
    """
    progress = progress or _progress.get()
    found = ((function, types_of(args)) for function, args in calls)
    entries = [each for each in dict.fromkeys(found) if not each[0].has(each[1])]
    if not entries:
        return
    compiled = False

    def show(done: int) -> None:
        nonlocal compiled
        compiled = True
        if progress:
            progress(done, len(entries))

    signatures = [f"{each.__module__}.{each.__qualname__}{types}" for each, types in entries]
    with compile_turn(cache_folder(), signatures, lambda: show(0), check) as announce:
        for done, (dispatcher, types) in enumerate(entries):
            check()

            def begin(done: int = done) -> None:
                if not compiled:
                    announce()
                show(done)

            with compiling(begin):
                dispatcher.compile(types)
    if compiled and progress:
        progress(len(entries), len(entries))


@contextmanager
def compiling(begin: Callable[[], None]) -> Iterator[None]:
    """Call `begin` once in the block, when the first kernel is compiled rather than loaded."""
    if is_interpreted():
        yield
        return
    from numba.core import event

    class Listener(event.Listener):
        begun = False

        def on_start(self, event: Any) -> None:  # noqa: ANN401
            if not self.begun:
                self.begun = True
                # numba leaves garbage in cycles: with the command line's threshold, 60 MB of it
                threshold, *others = gc.get_threshold()
                gc.set_threshold(min(threshold, _COLLECT_EVERY), *others)
                begin()

        def on_end(self, event: Any) -> None:  # noqa: ANN401
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


@functools.cache
def kept_files() -> KeptFiles:
    """Return the kept files of these sources: machine code, and what follows from it.

    numba itself looks for changes only in the file of an entry; an entry holds kernels and
    constants of other files too. So the folder is named after the text of all kernel packages. It
    lies in NUMBA_CACHE_DIR, beside the bytecode, and in the user's cache: in each of them, in this
    order, it is read, up to the first that can be written. Folders of other texts are removed:
    beside the bytecode at once, elsewhere, where other installations may use them, after
    `UNUSED_DAYS`.
    """
    package = Path(__file__).parents[1]
    beside = package / "__pycache__"

    def remove_unused(parent: Path, folder: Path) -> None:
        keep_s = UNUSED_DAYS * 86400.0 if parent != beside else 0.0
        _remove_unused(parent, time.time() - keep_s, keep=folder)

    name = f"kernels-{source_digest(package)[:16]}"
    return open_kept_files(name, _places(package), remove_unused)


def cache_folder() -> Path | None:
    """Return the folder to which machine code is written; None: none can be."""
    return kept_files().folder


def _remove_unused(parent: Path, oldest: float, *, keep: Path) -> None:
    """Remove folders of machine code that were last used before a time."""
    for other in parent.glob("kernels-*"):
        if other != keep and _FOLDER_NAME.fullmatch(other.name):
            with suppress(OSError):
                if other.stat().st_mtime <= oldest and _has_only_machine_code(other):
                    shutil.rmtree(other)


def _has_only_machine_code(folder: Path) -> bool:
    files = (name for _, _, names in os.walk(folder) for name in names)
    return all(_FILE_NAME.fullmatch(name) for name in files)


def source_digest(package: Path, folders: Iterable[str] = KERNEL_PACKAGES) -> str:
    """Return the SHA-256 of names and texts of all Python files in folders of a package."""
    digest = hashlib.sha256()
    for each in folders:
        for path in sorted((package / each).rglob("*.py")):
            name = path.relative_to(package).as_posix()
            digest.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _places(package: Path) -> Iterator[Place]:
    if wanted := os.environ.get(_VARIABLE):
        yield Place(Path(wanted), variable=_VARIABLE)
    # other users of an installation may read its machine code, as they do its bytecode
    yield Place(package / "__pycache__", stat.S_IMODE(package.stat().st_mode) & 0o755 | 0o700)
    cache = os.environ.get("XDG_CACHE_HOME")
    if cache or os.environ.get("HOME"):
        yield Place((Path(cache) if cache else Path.home() / ".cache") / "testbed")


def notice() -> str:
    """Return what to print where kernels are compiled."""
    if cache_folder() is not None:
        return "compiling kernels; later runs load them"
    return (
        "compiling kernels, as in each run: no folder can keep them (write one that can be "
        f"written to {_VARIABLE})"
    )


_VARIABLE = "NUMBA_CACHE_DIR"
_TURN, _COMPILING = "turn", "compiling"
_POLL_S = 0.05


@contextmanager
def compile_turn(
    folder: Path | None,
    signatures: Sequence[str],
    waiting: Callable[[], None] = lambda: None,
    check: Callable[[], None] = lambda: None,
) -> Iterator[Callable[[], None]]:
    """Hold the turn to compile in the block, unless these kernels have been prepared before.

    Args:
        folder: of the machine code; None, or one that cannot be written: nothing is locked.
        signatures: of the kernels and their arguments.
        waiting: called once if another process has the turn and compiles.
        check: called again and again while it has; an error that it raises ends the wait.

    Yields:
        A function to call when something is compiled rather than loaded.
    """
    digest = hashlib.sha256("\n".join(signatures).encode()).hexdigest()[:16]
    with ExitStack() as closing:

        def announce() -> None:
            if folder is not None:
                with suppress(OSError):
                    fcntl.flock(_open(folder / _COMPILING, closing), fcntl.LOCK_EX)

        ready = None if folder is None else folder / f"ready-{digest}"
        if folder is None or ready is None or ready.exists():
            yield announce
            return
        with suppress(OSError):
            _wait_for_turn(_open(folder / _TURN, closing), folder, waiting, check)
        yield announce
        with suppress(OSError):
            _open(ready, closing)


def is_compiling(folder: Path | None) -> bool:
    """Return whether a process compiles kernels into a folder now."""
    if folder is None:
        return False
    with suppress(OSError), ExitStack() as closing:
        file = _open(folder / _COMPILING, closing, os.O_RDONLY)
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _open(path: Path, closing: ExitStack, mode: int = os.O_WRONLY | os.O_CREAT) -> int:
    """Open a file, without waiting for the other end of a pipe in its place."""
    file = os.open(path, mode | os.O_NONBLOCK | os.O_NOCTTY | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    closing.callback(os.close, file)
    return file


def _wait_for_turn(
    file: int, folder: Path, waiting: Callable[[], None], check: Callable[[], None]
) -> None:
    reported = False
    while True:
        check()
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if not reported and is_compiling(folder):
                reported = True
                waiting()
            time.sleep(_POLL_S)
