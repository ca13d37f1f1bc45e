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
PORTS = 3  # that are tried when others take the one that was free
TETHER = Path(__file__).with_name("tether.py")
LISTENS = "0A"  # the state of a socket in Linux's table


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
            f"{HOST}:{port}: install rerun-sdk"
        )
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return f"there is no display here and no viewer listens on {HOST}:{port}"
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
def headless(size: tuple[int, int], *, limit_s: float = math.inf) -> Iterator[int]:
    """A viewer that draws without a screen, for as long as the context and this process last.

    Args:
        size: width and height, pixels.
        limit_s: after which it is ended whatever it does, and with it who waits for it.

    Yields:
        The port of this machine on which it listens.

    Raises:
        InputError: there is none, it cannot draw, or it was ended.
    """
    executable = program()
    if executable is None:
        raise InputError(f"there is no `rerun` program beside {sys.executable}: install rerun-sdk")
    window = ("--headless", "--window-size", "{}x{}".format(*size))
    scratch = tempfile.TemporaryDirectory(prefix="testbed-view-", ignore_cleanup_errors=True)
    late = threading.Event()
    with scratch as folder, tethered(executable, *window, folder=folder) as (viewer, port):
        if viewer.poll() is not None:
            raise InputError(
                "the Rerun viewer does not start without a screen: it needs a Vulkan driver (on "
                "Debian and Ubuntu, apt-get install mesa-vulkan-drivers)"
            )

        def give_up() -> None:
            late.set()
            end(viewer)

        watch = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), give_up)
        watch.daemon = True
        watch.start()
        try:
            yield port
        except Exception as error:
            if late.is_set() or isinstance(error, TimeoutError):
                raise InputError(
                    "the Rerun viewer does not answer; is the machine busy?"
                ) from error
            raise
        finally:
            watch.cancel()


@contextlib.contextmanager
def tethered(
    executable: str, *arguments: str, folder: str = ""
) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A viewer that ends with the context, or with this process however that ends.

    Args:
        executable: the program.
        arguments: for it.
        folder: for its scratch files, which are removed with it when this process is killed.

    Yields:
        The viewer and the port that it holds; a viewer that has ended if it does not start.
    """
    for _ in range(PORTS):
        port = free_port()
        viewer = launched(executable, port, *arguments, tether=True, folder=folder)
        try:
            if awaited(viewer, port) and holds(viewer, port):
                yield viewer, port
                return
        finally:
            end(viewer)
        if not listening(port):  # else somebody took it between the first two lines above
            break
    yield viewer, port


def launched(
    executable: str, port: int, *arguments: str, tether: bool = False, folder: str = ""
) -> subprocess.Popen[bytes]:
    """A viewer on its way, reachable from this machine alone, in a process group of its own.

    Args:
        executable: the program.
        port: on which it is to listen.
        arguments: for it.
        tether: whether it ends when this process does, or outlives it.
        folder: for its scratch files; none: where such files are by default.
    """
    command = [executable, "--bind", HOST, "--port", str(port), "--hide-welcome-screen", *arguments]
    if tether:
        command = [sys.executable, "-I", "-S", str(TETHER), folder, *command]
    # No questions on the terminal, no messages in the pictures, and, as everywhere where CI is set,
    # no statistics of use for Rerun.
    silent = {"RERUN_APP_ONLY": "true", "RUST_LOG": "off", "CI": "true"}
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE if tether else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | silent | ({"TMPDIR": folder} if folder else {}),
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


def holds(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Whether it is this viewer that listens on a port, as far as the system tells."""
    table = Path("/proc/net/tcp")
    if not table.exists():
        return viewer.poll() is None
    rows = (line.split() for line in table.read_text().splitlines()[1:])
    ours = f"{int.from_bytes(socket.inet_aton(HOST), sys.byteorder):08X}:{port:04X}"
    sockets = {f"socket:[{row[9]}]" for row in rows if row[1] == ours and row[3] == LISTENS}
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or is somebody else's
            if os.getpgid(int(process.name)) != viewer.pid:
                continue
            if any(os.readlink(each) in sockets for each in (process / "fd").iterdir()):
                return True
    return False


def end(viewer: subprocess.Popen[bytes]) -> None:
    """End a viewer with everything that it has started: its program is a script round another."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()
    if viewer.stdin:
        viewer.stdin.close()
