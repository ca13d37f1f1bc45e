"""Compile kernels with numba and keep their machine code on disk.

A kernel is a function in plain scalar Python, for one aircraft or for a few arrays of records.
`@kernel` marks one that other kernels call, `@entry` one that Python calls: the machine code of an
entry, with all kernels in it, is kept on disk. `@jitable` marks a function that kernels may call
and that Python calls uncompiled.

With NUMBA_DISABLE_JIT=1 in the environment all of them run as Python, for a debugger.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
Kernel: TypeAlias = "functools.partial[Any]"  # an entry bound to all of its arguments

# Packages with kernels: a change in any of their files recompiles all kernels.
KERNEL_PACKAGES = (
    *("core", "atmosphere", "autopilot", "formation", "guidance"),
    *("network", "sensors", "sim", "vehicle"),
)
UNUSED_DAYS = 30  # after which machine code in a shared folder is removed
# numpy divides by zero as IEEE does; nothing is reordered, so that runs repeat to the bit
_OPTIONS: dict[str, Any] = {"error_model": "numpy"}


def kernel(function: F) -> F:
    """Compile a function that other kernels call."""
    import numba

    compiled: Any = numba.njit(**_OPTIONS)(function)
    return compiled  # type: ignore[no-any-return]


def entry(function: F) -> F:
    """Compile a function that Python calls, and keep its machine code on disk where possible."""
    import numba

    config: Any = numba.config
    if config.DISABLE_JIT:
        return function
    folder = cache_folder()
    wanted = config.CACHE_DIR
    config.CACHE_DIR = wanted if folder is None else str(folder)
    try:
        compiled: Any = numba.njit(cache=folder is not None, **_OPTIONS)(function)
        return compiled  # type: ignore[no-any-return]
    finally:
        config.CACHE_DIR = wanted


def jitable(function: F) -> F:
    """Let kernels call a function, which stays plain Python when Python calls it."""
    from numba.extending import register_jitable

    return register_jitable(function)


def prepare(calls: Iterable[Kernel], progress: Callable[[int, int], None] | None = None) -> None:
    """Compile entries for the arguments they are bound to, or load their machine code.

    Args:
        calls: entries, each bound to all of its arguments; nothing is called.
        progress: called with the number of entries done and of all entries, from the moment at
            which the first has to be compiled; not at all where machine code is loaded.
    """
    from numba import typeof

    entries: list[tuple[Any, tuple[Any, ...]]] = [
        (each.func.compile, each.args)
        for each in calls
        if hasattr(each.func, "compile")  # not in debug mode
    ]
    compiled = False
    for done, (compile_for, arguments) in enumerate(entries):

        def begin(done: int = done) -> None:
            nonlocal compiled
            compiled = True
            if progress:
                progress(done, len(entries))

        with compiling(begin):
            compile_for(tuple(map(typeof, arguments)))
    if compiled and progress:
        progress(len(entries), len(entries))


@contextmanager
def compiling(begin: Callable[[], None]) -> Iterator[None]:
    """Call `begin` once in the block, when the first kernel is compiled rather than loaded."""
    import numba
    from numba.core import event

    config: Any = numba.config
    if config.DISABLE_JIT:
        yield
        return

    class Listener(event.Listener):
        begun = False

        def on_start(self, event: Any) -> None:  # noqa: ANN401
            if not self.begun:
                self.begun = True
                begin()

        def on_end(self, event: Any) -> None:  # noqa: ANN401
            pass

    with event.install_listener("numba:compile", Listener()):
        yield


@functools.cache
def cache_folder() -> Path | None:
    """Return the folder of the machine code of these sources, or None where none can be written.

    numba itself looks for changes only in the file of an entry; an entry holds kernels and
    constants of other files too. So the folder is named after the text of all kernel packages. It
    lies below NUMBA_CACHE_DIR, beside the bytecode, or in the user's cache, whichever can be
    written first. Folders of other texts are removed: beside the bytecode at once, elsewhere,
    where other installations may use them, after `UNUSED_DAYS`.
    """
    package = Path(__file__).parents[1]
    name = f"kernels-{source_digest(package)[:16]}"
    for parent in _parents(package):
        folder = parent / name
        try:
            new = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if not os.access(folder, os.W_OK):
            continue
        os.utime(folder)
        if new:
            shared = parent != package / "__pycache__"
            oldest = time.time() - UNUSED_DAYS * 86400.0
            for other in set(parent.glob("kernels-*")) - {folder}:
                if not (shared and other.stat().st_mtime > oldest):
                    shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


def source_digest(package: Path) -> str:
    """Return the SHA-256 of names and texts of all kernel packages below a folder."""
    digest = hashlib.sha256()
    for each in KERNEL_PACKAGES:
        for path in sorted((package / each).glob("*.py")):
            digest.update(f"{each}/{path.name}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _parents(package: Path) -> Iterator[Path]:
    wanted = os.environ.get("NUMBA_CACHE_DIR")
    if wanted:
        yield Path(wanted)
        return
    yield package / "__pycache__"
    cache = os.environ.get("XDG_CACHE_HOME")
    if cache or os.environ.get("HOME"):
        yield (Path(cache) if cache else Path.home() / ".cache") / "testbed"
