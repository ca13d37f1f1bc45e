"""Ctrl-C and SIGTERM: counted while libraries are loaded, and where compiled code does not return.

Python handles a signal between two of its instructions. In compiled code there are none: a law that
never returns is ended by a thread, which the system's own handler wakes by a byte in a pipe. That
code runs with Python's lock released, see `call_list`.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from testbed.core.errors import InputError

GRACE_S = 1.0  # after a signal that took effect; signals within it have no effect
INTERRUPTED = 130  # exit code
COMPILED = "testbed.core.call_list", "testbed.core.compile"  # the modules that call compiled code
STOP_SIGNALS = signal.SIGINT, signal.SIGTERM
_END = b"\0"  # no signal's number

_signals: list[int] = []
_REPEAT_S = 0.02
_handled_s = [float("-inf")]  # when Python last handled a signal


class Interrupt(KeyboardInterrupt):
    """A KeyboardInterrupt of a signal, unlike one that a user's code raises."""


@contextmanager
def count_signals() -> Iterator[None]:
    """Count SIGINT and SIGTERM in the block; each raises KeyboardInterrupt.

    Raises:
        Interrupt: also in place of an error that the library makes of it which is being loaded.
    """
    before = {each: signal.getsignal(each) for each in STOP_SIGNALS}
    defaults = signal.default_int_handler, signal.SIG_DFL
    for number in STOP_SIGNALS:
        if before[number] in defaults:  # keep another handler, or an ignored signal
            signal.signal(number, _interrupt)
    hook = sys.unraisablehook
    sys.unraisablehook = lambda lost: _repeat() if lost.exc_type is Interrupt else hook(lost)
    try:
        with watch_compiled_code():
            yield
    except Exception as error:
        if _signals and not isinstance(error, InputError):
            raise Interrupt from error
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook
        _signals.clear()


def signal_count() -> int:
    """Return the number of signals so far in the block of `count_signals`."""
    return len(_signals)


def mark_handled() -> None:
    """Note that Python handles a signal, so that the code is not stuck; for handlers."""
    _handled_s[0] = time.monotonic()


def _interrupt(number: int, frame: FrameType | None) -> None:
    mark_handled()
    _signals.append(number)
    raise Interrupt


def _repeat() -> None:
    """Send the last signal again, whose exception Python ignores in a callback of a weak reference.

    It is sent a moment later, by a thread: an exception within this function is ignored, too.
    """
    if _signals:
        timer = threading.Timer(_REPEAT_S, _send, (_signals.pop(),))
        timer.daemon = True
        timer.start()


def _send(number: int) -> None:
    if signal.getsignal(number) is _interrupt:  # else the block has ended
        os.kill(os.getpid(), number)


@contextmanager
def watch_compiled_code() -> Iterator[None]:
    """End the process at a second SIGINT or SIGTERM in compiled code that does not return.

    The first one is reported to standard error after `GRACE_S`. Nothing is watched outside the main
    thread, or where signals are watched already.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    if before != -1:  # of an event loop, or of this function
        signal.set_wakeup_fd(before)
        os.close(reading)
        os.close(writing)
        yield
        return
    threading.Thread(target=_watch, args=(reading,), name="signals", daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(-1)
        os.write(writing, _END)  # a forked child may have this end, too
        os.close(writing)


def _watch(reading: int) -> None:
    """Read the numbers of signals, and act on those that Python does not handle."""
    count, effective_s = 0, float("-inf")
    while (found := os.read(reading, 1)) not in (b"", _END):
        if found[0] not in STOP_SIGNALS or time.monotonic() - effective_s < GRACE_S:
            continue
        count, effective_s = count + 1, time.monotonic()
        if not _is_stuck(effective_s):
            continue
        if count > 1:
            _print("ended: compiled code did not return")
            os._exit(INTERRUPTED)
        _print(
            "\nstopping, but still in compiled code, such as a law under @testbed.kernel: "
            "Ctrl-C (or another signal) ends it at once"
        )
    os.close(reading)


def _print(text: str) -> None:
    with suppress(OSError, ValueError):  # it is closed
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


def _is_stuck(since_s: float) -> bool:
    """Return whether the main thread stays in compiled code for `GRACE_S` after a signal.

    It does not if Python handles the signal, which it may have done before this thread has read of
    it.
    """
    while time.monotonic() - since_s < GRACE_S:
        frame = sys._current_frames().get(threading.main_thread().ident or 0)
        compiled = frame is not None and frame.f_globals.get("__name__") in COMPILED
        if not compiled or _handled_s[0] > since_s - GRACE_S:
            return False
        time.sleep(0.02)
    return True
