"""Finding a Rerun viewer on this machine, or starting one that only this machine can reach."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from testbed.errors import InputError

HOST = "127.0.0.1"
PROBE_S = 0.3
START_S = 20.0  # a first start on a slow machine


def listening(port: int) -> bool:
    """Whether something listens on the port."""
    try:
        with socket.create_connection((HOST, port), PROBE_S):
            return True
    except OSError:
        return False


def program() -> str | None:
    """The `rerun` program of this Python environment."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent))


def obstacle(port: int) -> str | None:
    """Why no viewer can be had, or None if one is there or may be started."""
    if listening(port):
        return None
    if program() is None:
        return (
            f"there is no `rerun` program beside {sys.executable} and no viewer on "
            f"{HOST}:{port}. Install rerun-sdk, or save the view: `testbed view RUN --rrd FILE`."
        )
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return (
            f"there is no display here and no viewer listens on {HOST}:{port}. Save the view with "
            "`testbed view RUN --rrd FILE` and open it elsewhere with `rerun FILE`, or save a "
            "picture with `testbed shot RUN --out FILE.png`."
        )
    return None


def free_port() -> int:
    """A port of this machine on which nothing listens."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def start(port: int) -> bool:
    """Start a viewer that outlives this process, and wait until it listens.

    Returns:
        Whether it listens; False as soon as it gives up.
    """
    executable = program()
    if executable is None:
        return False
    viewer = launched(executable, port)
    if awaited(viewer, port):
        return True
    end(viewer)
    return False


@contextlib.contextmanager
def headless(
    port: int, size: tuple[int, int], *, limit_s: float = math.inf
) -> Iterator[subprocess.Popen[bytes]]:
    """A viewer that draws without a screen, for as long as the context lasts.

    Args:
        port: of this machine, on which it listens.
        size: width and height, pixels.
        limit_s: after which it is ended whatever it does, and with it who waits for it.

    Raises:
        InputError: there is none, it cannot draw, or it was ended.
    """
    executable = program()
    if executable is None:
        raise InputError(f"there is no `rerun` program beside {sys.executable}: install rerun-sdk")
    window = ("--headless", "--window-size", "{}x{}".format(*size))
    scratch = tempfile.TemporaryDirectory(prefix="testbed-view-", ignore_cleanup_errors=True)
    viewer = launched(executable, port, *window, TMPDIR=scratch.name)  # it leaves folders there
    late = threading.Event()

    def give_up() -> None:
        late.set()
        end(viewer)

    watch = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), give_up)
    watch.daemon = True
    watch.start()
    try:
        if not awaited(viewer, port):
            raise InputError(
                "the Rerun viewer does not start without a screen: it needs a Vulkan driver (on "
                "Debian and Ubuntu, apt-get install mesa-vulkan-drivers)"
            )
        yield viewer
    except Exception as error:
        if late.is_set() or isinstance(error, TimeoutError):
            raise InputError("the Rerun viewer does not answer; is the machine busy?") from error
        raise
    finally:
        watch.cancel()
        end(viewer)
        scratch.cleanup()


def launched(
    executable: str, port: int, *arguments: str, **environment: str
) -> subprocess.Popen[bytes]:
    """A viewer on its way, reachable from this machine alone, in a process group of its own."""
    return subprocess.Popen(
        [executable, "--bind", HOST, "--port", str(port), "--hide-welcome-screen", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        # No questions on the terminal, no messages in the pictures, and, as everywhere where CI
        # is set, no statistics of use for Rerun.
        env=os.environ | {"RERUN_APP_ONLY": "true", "RUST_LOG": "off", "CI": "true"} | environment,
        start_new_session=True,  # Ctrl-C ends the run, not the picture of it
    )


def awaited(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Whether a viewer listens in the end; False as soon as it gives up."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and viewer.poll() is None:
        if listening(port):
            return True
        time.sleep(0.1)
    return False


def end(viewer: subprocess.Popen[bytes]) -> None:
    """End a viewer, of which the program is a script around another one."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()
