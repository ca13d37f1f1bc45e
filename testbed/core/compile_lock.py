"""Let one process at a time compile the same kernels, with a sign for the others.

The files are in the folder of the machine code: `turn` is locked by the process that prepares
kernels for the first time, `compiling` while one of them is compiled rather than loaded, and
`ready-…` marks sets of kernels that need not be waited for. A lock ends with its process.
"""

from __future__ import annotations

import fcntl
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

NOTICE = "compiling kernels that no run has needed before; later runs load them"
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
                    fcntl.flock(closing.enter_context(_open(folder / _COMPILING)), fcntl.LOCK_EX)

        ready = None if folder is None else folder / f"ready-{digest}"
        if folder is None or ready is None or ready.exists():
            yield announce
            return
        with suppress(OSError):
            _wait_for_turn(closing.enter_context(_open(folder / _TURN)), folder, waiting, check)
        yield announce
        with suppress(OSError):
            ready.touch()


def is_compiling(folder: Path | None) -> bool:
    """Return whether a process compiles kernels into a folder now."""
    if folder is None:
        return False
    with suppress(OSError), (folder / _COMPILING).open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _open(path: Path) -> IO[str]:
    return path.open("a")


def _wait_for_turn(
    file: IO[str], folder: Path, waiting: Callable[[], None], check: Callable[[], None]
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
