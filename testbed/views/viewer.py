"""Find a Rerun viewer on this machine, start one that only this machine can reach, or serve one.

The web viewer is for a browser on this machine or, through ssh, on another one.
"""

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
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from testbed.core.child_guard import guard_command
from testbed.core.errors import InputError, install_command

HOST = "127.0.0.1"
PORT = 9876  # Rerun's default, on which a viewer receives a flight
ANY_HOST = "0.0.0.0"
HOSTS = (HOST, ANY_HOST)  # on which a web viewer listens
PAGE_PORT = 9090  # Rerun's default
PROBE_S = 0.3
START_S = 20.0  # a first start on a slow machine
PORT_ATTEMPTS = 3  # when another program takes the free port first
END_S = 2.0  # in which a viewer without a driver ends: it listens before it looks for one
TCP_LISTEN = "0A"  # the state of a socket in /proc/net/tcp
# Each viewer asks api.github.com for a newer version, which no option switches off: its requests go
# to a proxy that does not exist.
PROXY = f"http://{HOST}:9"
NO_DRIVER = (
    "the Rerun viewer does not start without a screen: it needs a Vulkan driver (on Debian and "
    "Ubuntu, apt-get install mesa-vulkan-drivers)"
)


class ViewerUnavailableError(InputError):
    """There is no Rerun viewer that can draw here; the text has the reason and the remedy."""


def is_listening(port: int) -> bool:
    """Check whether a program listens on the port."""
    try:
        with socket.create_connection((HOST, port), PROBE_S):
            return True
    except OSError:
        return False


def rerun_program() -> str | None:
    """Find the `rerun` program of this Python environment."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent))


def _needed_program() -> str:
    executable = rerun_program()
    if executable is None:
        raise ViewerUnavailableError(
            f"there is no `rerun` program beside {sys.executable}: write {install_command('view')}"
        )
    return executable


def unavailable_reason(port: int) -> str | None:
    """Explain why there is no viewer; None if one runs or can be started."""
    if is_listening(port):
        return None
    if rerun_program() is None:
        return (
            f"there is no `rerun` program beside {sys.executable} and no viewer on "
            f"{HOST}:{port}: write {install_command('view')}"
        )
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return f"there is no display here, and no viewer listens on {HOST}:{port}"
    return None


def free_port() -> int:
    """Find a port of this machine on which no program listens."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def start_viewer(port: int) -> bool:
    """Start a viewer that outlives this process, and wait until it listens.

    Returns:
        Whether it listens; False as soon as it exits.
    """
    executable = rerun_program()
    if executable is None:
        return False
    viewer = launch(executable, port)
    if wait_until_listening(viewer, port):
        return True
    kill(viewer)
    return False


@contextlib.contextmanager
def headless_viewer(size: tuple[int, int], *, limit_s: float = math.inf) -> Iterator[int]:
    """Run a viewer that draws without a screen, until the context or this process ends.

    Args:
        size: width and height, pixels.
        limit_s: time after which it is killed.

    Yields:
        The port of this machine on which it listens.

    Raises:
        ViewerUnavailableError: There is no viewer, it cannot draw, or it did not answer in time.
    """
    executable = _needed_program()
    window = ("--headless", "--window-size", "{}x{}".format(*size))
    scratch = tempfile.TemporaryDirectory(prefix="testbed-view-", ignore_cleanup_errors=True)
    timed_out = threading.Event()
    guarded = guarded_viewer(executable, *window, folder=scratch.name)
    with scratch, guarded as (viewer, port):
        if viewer.poll() is not None:
            raise ViewerUnavailableError(NO_DRIVER)

        def time_out() -> None:
            timed_out.set()
            kill(viewer)

        timer = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), time_out)
        timer.daemon = True
        timer.start()
        try:
            yield port
        except Exception as error:
            if timed_out.is_set() or isinstance(error, TimeoutError):
                limit = f" within {limit_s:g} s" if timed_out.is_set() else ""
                raise ViewerUnavailableError(
                    f"the Rerun viewer does not answer{limit}: the machine may be busy"
                ) from error
            if isinstance(error, OSError) and _ends(viewer):
                raise ViewerUnavailableError(NO_DRIVER) from error
            raise
        finally:
            timer.cancel()


def _ends(viewer: subprocess.Popen[bytes]) -> bool:
    """Return whether a viewer has ended, or does so at once."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(END_S)
    return viewer.poll() is not None


@contextlib.contextmanager
def guarded_viewer(
    executable: str, *arguments: str, folder: str = ""
) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Run a viewer until the context ends or this process does, also by SIGKILL.

    Args:
        executable: the program.
        arguments: for it.
        folder: for its scratch files; removed if this process is killed.

    Yields:
        The viewer and the port on which it listens; if it did not start, a process that has ended.
    """
    for _ in range(PORT_ATTEMPTS):
        port = free_port()
        viewer = launch(executable, port, *arguments, guarded=True, folder=folder)
        try:
            if wait_until_listening(viewer, port) and owns_port(viewer, port):
                yield viewer, port
                return
        finally:
            kill(viewer)
        if not is_listening(port):  # otherwise another program took the port first
            break
    yield viewer, port


def launch(
    executable: str,
    port: int,
    *arguments: str,
    guarded: bool = False,
    folder: str = "",
    host: str = HOST,
) -> subprocess.Popen[bytes]:
    """Start a viewer in its own process group; by default only this machine can reach it.

    Args:
        executable: the program.
        port: on which it shall listen.
        arguments: for it.
        guarded: whether it ends with this process, or outlives it.
        folder: for its scratch files; empty: the system's default.
        host: address of this machine on which it listens.
    """
    command = [executable, "--bind", host, "--port", str(port), "--hide-welcome-screen", *arguments]
    if guarded:
        command = guard_command(folder, command)
    # no questions on the terminal, no notices in pictures and, because CI is set, no analytics
    quiet = {"RERUN_APP_ONLY": "true", "RUST_LOG": "off", "CI": "true"}
    quiet |= {"ALL_PROXY": PROXY, "NO_PROXY": HOST, "no_proxy": HOST}
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE if guarded else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=_without_settings() | quiet | ({"TMPDIR": folder} if folder else {}),
        start_new_session=True,  # Ctrl-C is for the run
    )


def _without_settings() -> dict[str, str]:
    """Return the environment without a user's settings of Rerun."""
    return {key: value for key, value in os.environ.items() if not key.startswith("RERUN")}


def wait_until_listening(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Wait until a viewer listens; False as soon as it exits, or after `START_S`."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and viewer.poll() is None:
        if is_listening(port):
            return True
        time.sleep(0.1)
    return False


def owns_port(viewer: subprocess.Popen[bytes], port: int) -> bool:
    """Check that this viewer, and no other program, listens on the port (Linux only)."""
    table = Path("/proc/net/tcp")
    if not table.exists():
        return viewer.poll() is None
    rows = (line.split() for line in table.read_text().splitlines()[1:])
    ours = f"{int.from_bytes(socket.inet_aton(HOST), sys.byteorder):08X}:{port:04X}"
    sockets = {f"socket:[{row[9]}]" for row in rows if row[1] == ours and row[3] == TCP_LISTEN}
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            if os.getpgid(int(process.name)) != viewer.pid:
                continue
            if any(os.readlink(each) in sockets for each in (process / "fd").iterdir()):
                return True
    return False


def kill(viewer: subprocess.Popen[bytes]) -> None:
    """Kill a viewer and everything it started; `rerun` is a script that runs another program."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(viewer.pid, signal.SIGKILL)
    viewer.wait()
    if viewer.stdin:
        viewer.stdin.close()


@dataclass(frozen=True, slots=True)
class WebViewer:
    """A web viewer that is being served.

    Attributes:
        host: one of `HOSTS`, on which it listens.
        page_port: of the page.
        port: on which the run sends the flight and the page receives it.
    """

    host: str
    page_port: int
    port: int

    @property
    def url(self) -> str:
        """Address of the page, for a browser; the colours are for a dark background."""
        name = socket.gethostname() if self.host == ANY_HOST else self.host
        data = quote(f"rerun+http://{name}:{self.port}/proxy", safe="")
        return f"http://{name}:{self.page_port}/?url={data}&theme=dark"

    @property
    def directions(self) -> tuple[str, str]:
        """Lines with the address, and how to open it."""
        if self.host == ANY_HOST:
            access = (
                "any client that reaches this machine can see the flight, and send to the viewer"
            )
        else:
            ports = (self.page_port, self.port)
            forwards = " ".join(f"-L {each}:{self.host}:{each}" for each in ports)
            access = (
                "only this machine reaches it; on another one, first write "
                f"ssh {forwards} {socket.gethostname()}"
            )
        return f"view: {self.url}", f"      {access}"


@contextlib.contextmanager
def serve_web_viewer(host: str = HOST) -> Iterator[WebViewer]:
    """Serve a web viewer until the context or this process ends, also by SIGKILL.

    Args:
        host: one of `HOSTS`.

    Raises:
        InputError: it is another one, or the viewer does not start.
    """
    if host not in HOSTS:
        raise InputError(
            f"--host {host}: write {HOST}, or {ANY_HOST} to let other machines reach it"
        )
    executable = _needed_program()
    served = WebViewer(host, _port(host, PAGE_PORT), _port(host, PORT))
    process = launch(
        executable,
        served.port,
        "--serve-web",
        "--web-viewer-port",
        str(served.page_port),
        guarded=True,
        host=host,
    )
    try:
        started = all(
            wait_until_listening(process, port) for port in (served.port, served.page_port)
        )
        if not started:
            raise InputError(
                f"the web viewer does not start; has another program taken port {served.port} or "
                f"{served.page_port}?"
            )
        yield served
    finally:
        kill(process)


def _port(host: str, usual: int) -> int:
    """Choose the usual port, or a free one where it is taken."""
    for port in (usual, 0):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    raise InputError(f"--host {host}: there is no free port")
