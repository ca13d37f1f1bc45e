"""Work in a forked process, whose crash is an error of this one."""

from __future__ import annotations

import faulthandler
import os
import pickle
import resource
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO, NoReturn

from testbed.core.errors import Portable
from testbed.core.interrupts import INTERRUPTED, STOP_SIGNALS, Interrupt

Send = Callable[[object], None]
_GRACE_S = 5.0  # for the work to end after the parent
_RESULT, _ERROR, _MESSAGE = "result", "error", "message"


class CrashError(Portable):
    """The forked process has ended before its work. `end` is how: "crashed (SIGSEGV)"."""

    def __init__(self, end: str, *, killed: bool) -> None:
        self.end, self.killed = end, killed
        super().__init__(end)


def run_in_fork(work: Callable[[Send], Any], receive: Callable[[Any], None]) -> Any:  # noqa: ANN401
    """Do work in a copy of this process, and return its result.

    Ctrl-C and SIGTERM are sent on to it. It ends with this process.

    Args:
        work: gets a function that sends a message; messages and the result can be pickled.
        receive: called here with each message.

    Raises:
        CrashError: the copy has crashed, or was killed.
        BaseException: what the work raises.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # it is closed
            stream.flush()
    (read, write), (end, life) = os.pipe(), os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # threads are not copied
        child = os.fork()
    if not child:
        os.close(read)
        os.close(life)
        _serve(work, write, end)
    os.close(write)
    os.close(end)
    try:
        with _forwarding_signals(child), os.fdopen(read, "rb") as pipe:
            found = _receive(pipe, receive)
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        os.close(life)
    if found is not None and found[0] == _ERROR:
        raise found[1]
    if found is not None:
        return found[1]
    if code == INTERRUPTED or -code in STOP_SIGNALS:
        raise Interrupt
    if code < 0:
        killed = -code == signal.SIGKILL
        name = signal.Signals(-code).name
        raise CrashError(f"was killed ({name})" if killed else f"crashed ({name})", killed=killed)
    raise CrashError(f"ended the process with {code}", killed=False)


def _receive(pipe: BinaryIO, receive: Callable[[Any], None]) -> tuple[str, Any] | None:
    """Receive messages up to the result or the error; None: the process ends before."""
    while True:
        try:
            kind, value = pickle.load(pipe)
        except (EOFError, pickle.UnpicklingError):  # cut off by its end
            return None
        if kind != _MESSAGE:
            return kind, value
        receive(value)


@contextmanager
def _forwarding_signals(child: int) -> Iterator[None]:
    """Send SIGINT and SIGTERM on to a process in the block; in the main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def forward(number: int, _: object) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, number)

    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, forward)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _serve(work: Callable[[Send], Any], write: int, end: int) -> NoReturn:
    """Do the work in the copy, and end it without cleaning up for the parent."""
    code = 1
    try:
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with suppress(ValueError):  # not in the main thread
            signal.set_wakeup_fd(-1)  # it is the parent's
        threading.Thread(target=_end_with_parent, args=(end,), daemon=True).start()
        pipe = os.fdopen(write, "wb")

        def send(kind: str, value: object) -> None:
            pipe.write(pickle.dumps((kind, value)))
            pipe.flush()

        try:
            send(_RESULT, work(lambda message: send(_MESSAGE, message)))
        except BaseException as error:
            send(_ERROR, _portable(error))
        code = 0
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        os._exit(code)


def _portable(error: BaseException) -> BaseException:
    """Return an error that can be pickled, with its place where it is no input of the user."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("".join(traceback.format_exception(error)))
    return error


def _end_with_parent(end: int) -> None:
    """End this process when its parent has ended, which closes the pipe."""
    while os.read(end, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os._exit(1)
