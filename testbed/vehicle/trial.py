"""Work that may end the process it is done in, done in a copy of this one.

JSBSim crashes on many an aircraft that is wrong: a table that does not increase, a motor without a
power. A crash of the copy is an error like any other here.
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

LONGEST_S = 30  # an aircraft that flies takes a fraction of a second


@dataclass(frozen=True, slots=True)
class Trial:
    """How it went: an answer, or none."""

    answer: Any  # None: the work has failed, or ended the process
    said: tuple[str, ...]  # on the way, also by a process that has crashed
    error: str  # that the work has raised; empty: none
    end: str  # how the process ended, in words; empty: as it should


def attempt(work: Callable[[Callable[[str], None]], Any]) -> Callable[[], Trial]:
    """Begin some work in a copy of this process, for `LONGEST_S` at most.

    Args:
        work: is given a function that takes what it has to say, and answers with plain data.

    Returns:
        What waits for its end, to be called once.
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
    return partial(_ended, child, read)


def _ended(child: int, read: int) -> Trial:
    """How the work of a copy went, which tells it through a pipe."""
    with os.fdopen(read, encoding="utf-8", errors="replace") as pipe:
        lines = pipe.read().splitlines()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    answer, said, error = None, [], ""
    for line in lines:
        try:
            kind, value = json.loads(line)
        except ValueError:
            continue  # cut off by the end of the process
        if kind == "answer":
            answer = value
        elif kind == "error":
            error = value
        else:
            said.append(value)
    if code == -signal.SIGALRM:
        end = f"did not come to an end within {LONGEST_S} s"
    elif code:
        end = f"crashed ({signal.Signals(-code).name})" if code < 0 else f"ended with {code}"
    else:
        end = ""
    return Trial(answer, tuple(said), error, end)


def _serve(work: Callable[[Callable[[str], None]], Any], write: int) -> NoReturn:
    """The life of the copy: silent, without a core file, ended in time, and never cleaned up."""
    code = 1
    try:
        faulthandler.disable()
        gc.freeze()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number in (signal.SIGINT, signal.SIGTERM):  # of the group: the parent decides
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
        signal.alarm(LONGEST_S)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(nowhere, stream)

        def send(kind: str, value: Any) -> None:  # noqa: ANN401
            os.write(write, f"{json.dumps([kind, value])}\n".encode())

        try:
            send("answer", work(lambda text: send("said", text)))
        except Exception as error:
            send("error", str(error))
        code = 0
    finally:
        os._exit(code)
