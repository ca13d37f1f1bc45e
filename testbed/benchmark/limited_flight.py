"""Run a stranger's program: each flight in a process of its own, with limits of time and memory.

The process is a forked copy of a worker, so that the testbed is loaded and only the law is not. Its
limits are those of the kernel: processor time, address space, size of a file. The worker also ends
it and all processes of its group after a time by the clock. What it returns is JSON of
a bounded size, which is data.

It is no sandbox: the program has the rights of the account, and can open files and sockets.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import resource
import select
import signal
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

from testbed.core.compile import kept_files
from testbed.core.errors import InputError, describe_error, memory_shortage
from testbed.core.input_files import parse_json

Failure = Literal["", "exception", "time", "memory", "crash"]
Work = Callable[[Path], Any]
MAX_RESULT_BYTES = 1_000_000
MAX_TEXT = 1000  # characters of an error
_POLL_S = 0.5


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Limits of one flight.

    Attributes:
        cpu_s: processor time, s, with the compilation of the law.
        wall_s: time by the clock, s.
        memory_bytes: that it may need beside what the testbed has.
        file_bytes: largest file that it may write.
    """

    cpu_s: int = 60
    wall_s: int = 300
    memory_bytes: int = 2_000_000_000
    file_bytes: int = 64_000_000


LIMITS = FlightLimits()


@dataclass(frozen=True, slots=True)
class LimitedResult:
    """What has become of a program.

    Attributes:
        value: that it returned, plain data; None: it failed.
        failure: kind of failure; "": none.
        text: of the failure.
        cpu_s: processor time, s.
    """

    value: Any
    failure: Failure
    text: str
    cpu_s: float


def run_limited(work: Work, limits: FlightLimits = LIMITS) -> LimitedResult:
    """Run work in a copy of this process.

    Args:
        work: gets an empty folder, which is removed afterwards, and returns plain data.
        limits: of the copy.
    """
    with tempfile.TemporaryDirectory(
        prefix="testbed-flight-", ignore_cleanup_errors=True
    ) as folder:
        read, write = os.pipe()
        with warnings.catch_warnings():
            # threads are not copied; the copy calls nothing that could wait for one of them
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            _serve(work, write, Path(folder), limits)
        os.close(write)
        try:
            data, in_time = _receive(read, limits.wall_s)
        finally:
            os.close(read)
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(child, signal.SIGKILL)  # and what it has started
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
    code, cpu_s = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
    return _result(data, in_time, code, cpu_s, limits)


def _receive(read: int, wall_s: float) -> tuple[bytes, bool]:
    """Return what the copy writes, and whether it ended in time."""
    data, end_s = b"", time.monotonic() + wall_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        if not select.select([read], [], [], min(left_s, _POLL_S))[0]:
            continue
        piece = os.read(read, 1 << 16)
        data += piece
        if not piece or len(data) > MAX_RESULT_BYTES:
            return data, True
    return data, False


def _result(
    data: bytes, in_time: bool, code: int, cpu_s: float, limits: FlightLimits
) -> LimitedResult:
    """Judge what a copy has sent and how it has ended."""

    def failed(failure: Failure, text: str) -> LimitedResult:
        return LimitedResult(None, failure, text[:MAX_TEXT], cpu_s)

    if not in_time:
        return failed("time", f"did not end within {limits.wall_s} s by the clock")
    if len(data) > MAX_RESULT_BYTES:
        return failed("crash", f"sent more than {MAX_RESULT_BYTES:,} bytes")
    found: Any = None
    with suppress(ValueError):
        found = parse_json(data)
    if isinstance(found, list) and len(found) == 2:
        kind, value = found
        if kind == "result":
            return LimitedResult(value, "", "", cpu_s)
        if kind in ("exception", "memory"):
            return failed(kind, str(value))
    if code == -signal.SIGXCPU or cpu_s >= limits.cpu_s:
        return failed("time", f"did not end within {limits.cpu_s} s of processor time")
    if code < 0 and code != -signal.SIGKILL:
        return failed("crash", f"ended by {signal.Signals(-code).name}")
    return failed("crash", f"ended without a result, with {code}")


def _serve(work: Work, write: int, folder: Path, limits: FlightLimits) -> NoReturn:
    """Run the work in the copy, without output, core file or cleanup."""
    code = 1
    try:
        os.setsid()
        faulthandler.disable()
        gc.freeze()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGXCPU, signal.SIGXFSZ):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        signal.set_wakeup_fd(-1)  # a pipe of the parent, which is closed below
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(null, stream)
        largest = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        # the links of the worker to its parent are none of the program's
        os.closerange(3, write)
        os.closerange(write + 1, largest if largest != resource.RLIM_INFINITY else 1 << 16)
        kept_files.cache_clear()  # the folder of machine code was among them
        os.chdir(folder)
        threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
        memory = _address_space() + limits.memory_bytes
        for each, limit in (
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_FSIZE, limits.file_bytes),
            (resource.RLIMIT_AS, memory),
        ):
            resource.setrlimit(each, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 1))
        try:
            found: tuple[str, Any] = ("result", work(folder))
        except BaseException as error:
            gc.collect()
            kind = "exception" if memory_shortage(error) is None else "memory"
            found = (kind, _describe(error).replace(f"{folder}/", "")[:MAX_TEXT])
        os.write(write, json.dumps(found, allow_nan=False).encode())
        code = 0
    finally:
        os._exit(code)


def _describe(error: BaseException) -> str:
    """Return an error as text, with the line of the law if it has none itself."""
    if isinstance(error, InputError):
        return str(error)
    last = traceback.extract_tb(error.__traceback__)[-1:]
    where = f" ({Path(last[0].filename).name}:{last[0].lineno})" if last else ""
    named = describe_error(error) if isinstance(error, Exception) else type(error).__name__
    return f"{type(error).__name__}: {named}{where}"


def _address_space() -> int:
    """Return the size of this process's address space, bytes."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return 0
    return int(pages.read_text().split()[0]) * resource.getpagesize()


def _end_with(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(1)
