"""ArduPlane processes: find the binary, start it in a temporary folder, and stop it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from testbed.core.child_guard import CANNOT_START, guard_command
from testbed.core.errors import InputError
from testbed.core.geodetic import origin_geodetic
from testbed.core.records import NedOrigin

VARIABLE = "ARDUPLANE"
# What a process gets of the environment, which may hold passwords of the user: these, and names
# with a prefix, of which the second is for users' own scripts around ArduPlane.
_KEPT = ("PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "TZ", "TMPDIR", "LD_LIBRARY_PATH")
_KEPT_PREFIXES = ("LC_", f"{VARIABLE}_")
_SPEEDUP = 100  # limit of its speed, times real time; high, so that it never delays the run
_GRACE_S = 1.0  # from SIGTERM to SIGKILL; it ignores SIGTERM while it waits for its physics
_KILLED_S = 10.0  # after SIGKILL; a machine with other work may end it late
_POLL_S = 0.002
_TAIL_LINES, _TAIL_BYTES = 12, 4000


def find_binary(option: Path | None) -> Path:
    """Find the ArduPlane binary: of the option, else of the environment; a scenario names none.

    Raises:
        InputError: none of them is set, or the file cannot be executed.
    """
    name = option or os.environ.get(VARIABLE)
    if not name:
        raise InputError(
            "autopilot: ardupilot needs the program arduplane, and its path is not set (write "
            f"--arduplane PATH, or set the environment variable {VARIABLE})"
        )
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        raise InputError(f"{path}: there is no such program (write the path of arduplane)")
    if not os.access(path, os.X_OK):
        raise InputError(f"{path}: is not executable (chmod +x it, or write another path)")
    return path


def environment() -> dict[str, str]:
    """Return the environment of an ArduPlane: an allow list of this process's."""
    return {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_KEPT_PREFIXES)
    }


def command_line(
    binary: Path | str, instance: int, origin: NedOrigin, heading_deg: float, defaults: Path | str
) -> list[str]:
    """Return the command line of ArduPlane for the JSON link.

    Args:
        binary: path of ArduPlane.
        instance: its number, which sets its ports.
        origin: of the scenario, which is its home.
        heading_deg: heading at the start.
        defaults: path of its parameter file.
    """
    home = (*origin_geodetic(origin), heading_deg)
    return [
        str(binary),
        "--model",
        "JSON:127.0.0.1",
        "--speedup",
        str(_SPEEDUP),
        f"-I{instance}",
        "--home",
        ",".join(f"{number:.10g}" for number in home),
        "--defaults",
        str(defaults),
    ]


class SitlProcess:
    """An ArduPlane process with a temporary working folder."""

    def __init__(
        self, binary: Path, instance: int, origin: NedOrigin, heading_deg: float, defaults: str
    ) -> None:
        """Start the process.

        Args:
            binary: see `command_line`.
            instance: see `command_line`.
            origin: see `command_line`.
            heading_deg: see `command_line`.
            defaults: text of its parameter file.

        Raises:
            InputError: it cannot be started.
        """
        # an empty folder has the effect of --wipe
        self._folder = Path(tempfile.mkdtemp(prefix="testbed-arduplane-"))
        self._log = self._folder / "arduplane.log"
        defaults_file = self._folder / "defaults.parm"
        defaults_file.write_text(defaults, encoding="utf-8")
        try:
            with self._log.open("wb") as log:
                line = command_line(binary, instance, origin, heading_deg, defaults_file)
                self._child = subprocess.Popen(
                    guard_command(self._folder, line),  # it ends if this process is killed
                    cwd=self._folder,
                    env=environment(),
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C goes to the run only, which then stops it
                )
        except OSError as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise InputError(f"{binary}: cannot be started: {error.strerror}") from error

    @property
    def pid(self) -> int:
        """Number of its process group."""
        return self._child.pid

    def exit_text(self) -> str | None:
        """Describe how it ended; None: it runs.

        Raises:
            InputError: it could not be started.
        """
        code = self._child.poll()
        if code is None:
            return None
        if code == CANNOT_START:
            raise InputError(self._output_lines()[-1])
        return f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"

    def output_tail(self) -> str:
        """Return the last lines of its output, indented.

        Each line once, without the keys that it lists after its first state (JSON received).
        """
        tail: dict[str, None] = {}
        keys = True  # of a list whose beginning is cut off
        for line in self._output_lines():
            keys = line.startswith("JSON received") or (keys and line.startswith("\t"))
            if not keys:
                tail.pop(line, None)
                tail[line] = None
        shown = [f"    {' '.join(line.split())[:200]}" for line in [*tail][-_TAIL_LINES:]]
        return "\n".join(["it last printed:", *shown]) if shown else "it printed nothing"

    def _output_lines(self) -> list[str]:
        """Return the last lines of its output that are not empty."""
        try:
            data = self._log.read_bytes()
        except OSError:
            data = b""
        lines = data[-_TAIL_BYTES:].decode("utf-8", "replace").splitlines()
        if len(data) > _TAIL_BYTES:  # the first line is a part of one
            lines = lines[1:] or lines
        return [line.rstrip() for line in lines if line.strip()]

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to its process group."""
        if self._child.returncode is None:  # not reaped, so that the number is still its own
            try:
                os.killpg(self.pid, number)
            except ProcessLookupError:
                pass

    def wait(self, until: float) -> None:
        """Wait for the end of its process group until a monotonic time, s."""
        try:
            self._child.wait(max(0.0, until - time.monotonic()))
            while time.monotonic() < until:  # after SIGKILL the guard may end before the program
                os.killpg(self.pid, 0)
                time.sleep(_POLL_S)
        except (subprocess.TimeoutExpired, ProcessLookupError):
            pass

    def remove_folder(self) -> None:
        """Remove its folder."""
        if self._child.stdin is not None:
            self._child.stdin.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def stop_processes(processes: Iterable[SitlProcess]) -> None:
    """Stop all processes at once, with SIGTERM and then SIGKILL, and remove their folders."""
    running = list(processes)
    for process in running:
        process.signal(signal.SIGTERM)
    deadline = time.monotonic() + _GRACE_S
    for process in running:
        process.wait(deadline)
    for process in running:
        process.signal(signal.SIGKILL)
        process.wait(time.monotonic() + _KILLED_S)
        process.remove_folder()
