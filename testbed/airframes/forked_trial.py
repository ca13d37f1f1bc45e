"""Work that may crash, run in a forked copy of this process.

JSBSim crashes on many invalid aircraft: a table that does not increase, a motor without power. A
crash of the copy becomes an error with a message.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import resource
import signal
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NoReturn

from testbed.core.errors import describe_error, memory_shortage

# A valid aircraft takes a fraction of a second, of the processor: a loaded machine takes longer.
TIMEOUT_S = 30
_WAIT_S = 600  # by the clock, for work that waits and does not compute

Work = Callable[[Callable[[str], None]], Any]


@dataclass(frozen=True, slots=True)
class ForkedResult:
    """Result of work in a forked process."""

    value: Any  # None: the work failed, or ended the process
    messages: tuple[str, ...]  # sent by the work, also before a crash
    error: str  # raised by the work; "": none
    end: str  # description of an abnormal end of the process; "": normal


def run_forked(work: Work) -> Callable[[], ForkedResult]:
    """Start work in a copy of this process, for at most `TIMEOUT_S` of the processor.

    Args:
        work: gets a function that sends a message, and returns plain data.

    Returns:
        A function that waits for the result, to be called once; it raises a MemoryError of the
        work, which is no fault of what is tried.
    """
    read, write = os.pipe()
    with warnings.catch_warnings():
        # threads are not copied; the copy calls nothing that could wait for one of them
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        os.close(read)
        _serve(work, write)
    os.close(write)
    return partial(_wait, child, read)


def _wait(child: int, read: int) -> ForkedResult:
    """Wait for the end of the copy, and read its result from the pipe.

    Raises:
        MemoryError: the work had too little memory.
    """
    with os.fdopen(read, encoding="utf-8", errors="replace") as pipe:
        lines = pipe.read().splitlines()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    result, messages, error = None, [], ""
    for line in lines:
        try:
            kind, value = json.loads(line)
        except ValueError:
            continue  # cut off by the end of the process
        if kind == "result":
            result = value
        elif kind == "error":
            error = value
        elif kind == "memory":
            raise MemoryError(value)
        else:
            messages.append(value)
    if code == -signal.SIGXCPU:
        end = f"did not end within {TIMEOUT_S} s of processor time"
    elif code == -signal.SIGALRM:
        end = f"did not end within {_WAIT_S} s"
    elif code:
        end = f"crashed ({signal.Signals(-code).name})" if code < 0 else f"ended with {code}"
    else:
        end = ""
    return ForkedResult(result, tuple(messages), error, end)


def _serve(work: Work, write: int) -> NoReturn:
    """Run the work in the copy, without output, core file or cleanup, for a limited time."""
    code = 1
    try:
        faulthandler.disable()
        gc.freeze()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number in (signal.SIGINT, signal.SIGTERM):  # the parent handles them
            signal.signal(number, signal.SIG_IGN)
        limits = {signal.SIGALRM, signal.SIGXCPU}
        for number in limits:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, limits)
        # the copy begins at 0 s
        resource.setrlimit(resource.RLIMIT_CPU, (TIMEOUT_S, TIMEOUT_S + 1))
        signal.alarm(_WAIT_S)
        null = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(null, stream)

        def send(kind: str, value: Any) -> None:  # noqa: ANN401
            os.write(write, f"{json.dumps([kind, value])}\n".encode())

        try:
            send("result", work(lambda text: send("message", text)))
        except Exception as error:
            send("error" if memory_shortage(error) is None else "memory", describe_error(error))
        code = 0
    finally:
        os._exit(code)
