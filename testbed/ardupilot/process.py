"""The process of an ArduPlane: found, started in a folder of its own, and surely ended."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from testbed.errors import InputError
from testbed.state import Origin

VARIABLE = "ARDUPLANE"
_SPEEDUP = 100  # times real time at which it would slow us down; it waits for us, never we for it
_GRACE_S = 1.0  # after SIGTERM; one that is waiting for its physics does not heed it
_TAIL_LINES, _TAIL_BYTES = 12, 4000


def find_binary(written: str | None, given: Path | None) -> Path:
    """The ArduPlane to start: the page's, or the one given, or the environment's.

    Raises:
        InputError: there is none, or it cannot be run.
    """
    named = written or given or os.environ.get(VARIABLE)
    if not named:
        raise InputError(
            "autopilot: ardupilot needs the program arduplane, and nobody says where it is (write "
            f"--arduplane PATH, or set {VARIABLE}, or write binary: PATH under autopilot)"
        )
    path = Path(named).expanduser().resolve()
    if not path.is_file():
        raise InputError(f"{path}: there is no such program (write the path of arduplane)")
    if not os.access(path, os.X_OK):
        raise InputError(f"{path}: is not executable (chmod +x it, or write another path)")
    return path


def command_line(
    binary: Path | str, instance: int, origin: Origin, heading_deg: float, defaults: Path | str
) -> list[str]:
    """How ArduPlane is started for the JSON link; its home is the origin of the page."""
    home = (origin.latitude_deg, origin.longitude_deg, origin.elevation_m, heading_deg)
    return [
        str(binary),
        "--model",
        "JSON:127.0.0.1",
        "--speedup",
        str(_SPEEDUP),
        f"-I{instance}",
        "--home",
        ",".join(f"{number:.9g}" for number in home),
        "--defaults",
        str(defaults),
    ]


class Process:
    """One ArduPlane with a temporary folder, which it fills with what it writes."""

    def __init__(
        self, binary: Path, instance: int, origin: Origin, heading_deg: float, defaults: str
    ) -> None:
        """Start it.

        Raises:
            InputError: the system refuses.
        """
        # an empty folder is what --wipe would make of any other
        self._folder = Path(tempfile.mkdtemp(prefix="testbed-arduplane-"))
        self._log = self._folder / "arduplane.log"
        written = self._folder / "defaults.parm"
        written.write_text(defaults, encoding="utf-8")
        try:
            with self._log.open("wb") as log:
                self._child = subprocess.Popen(
                    command_line(binary, instance, origin, heading_deg, written),
                    cwd=self._folder,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C is for the run, which then ends it
                )
        except OSError as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise InputError(f"{binary}: cannot be started: {error.strerror}") from error

    @property
    def pid(self) -> int:
        """Of the process, which leads a group of its own."""
        return self._child.pid

    def ended(self) -> str | None:
        """How it ended, in words; None: it runs."""
        code = self._child.poll()
        if code is None:
            return None
        return f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"

    def last_words(self) -> str:
        """The last lines it printed, indented."""
        try:
            data = self._log.read_bytes()[-_TAIL_BYTES:]
        except OSError:
            data = b""
        lines = [line.rstrip() for line in data.decode("utf-8", "replace").splitlines()]
        said = [f"    {line[:200]}" for line in lines if line][-_TAIL_LINES:]
        return "\n".join(["it last printed:", *said]) if said else "it printed nothing"

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to it and to whatever it started."""
        if self._child.returncode is None:  # not reaped: the number is still its own
            try:
                os.killpg(self.pid, number)
            except ProcessLookupError:
                pass

    def wait(self, until: float) -> None:
        """Wait for its end until this moment of the monotonic clock, s."""
        try:
            self._child.wait(max(0.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            pass

    def clear(self) -> None:
        """Remove its folder."""
        shutil.rmtree(self._folder, ignore_errors=True)


def end(processes: Iterable[Process]) -> None:
    """End them all, together: asked first, then killed; their folders go."""
    left = list(processes)
    for process in left:
        process.signal(signal.SIGTERM)
    deadline = time.monotonic() + _GRACE_S
    for process in left:
        process.wait(deadline)
    for process in left:
        process.signal(signal.SIGKILL)
        process.wait(time.monotonic() + _GRACE_S)
        process.clear()
