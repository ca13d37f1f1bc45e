"""Start and stop the companion of each aircraft of a run, on this computer."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from testbed.core.child_guard import guard_command
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.records import Event
from testbed.mavlink.udp_endpoint import LOOPBACK, Address, Endpoint
from testbed.runs.companion_hub import CompanionHub

# without the current folder among those of modules
PROGRAM = (sys.executable, "-P", "-m", "testbed")
SCENARIO = "scenario.yaml"
START_S = 180.0  # until all listen; where nothing is compiled yet, it takes most of a minute
_GRACE_S = 3.0  # from SIGTERM to SIGKILL
_POLL_S = 0.05
_ATTEMPTS = 50  # to find neighbouring ports that are free
# below those that a system gives to programs which ask for any port: it must not give one away in
# the seconds until a companion opens it
_PORTS = range(20_000, 32_000)
_TAIL_LINES, _TAIL_BYTES = 12, 4000


def free_ports(count: int) -> int:
    """Return the first of neighbouring UDP ports of this computer that no program has.

    Raises:
        InputError: none were found.
    """
    for _ in range(_ATTEMPTS):
        first = secrets.choice(_PORTS)
        with ExitStack() as opened, suppress(InputError):
            for port in range(first, first + count):
                endpoint = Endpoint(Address("udpin", LOOPBACK, port), time.monotonic)
                opened.callback(endpoint.close)
            return first
    raise InputError(
        f"--companions: no {count} neighbouring UDP ports are free; end other programs"
    )


@dataclass
class _Process:
    """A companion that was started."""

    name: str
    child: subprocess.Popen[bytes]
    log: Path
    reported: bool = False

    @property
    def ending(self) -> str:
        """How it ended."""
        code = self.child.poll()
        if code is not None and code < 0:
            return f"was ended by signal {-code}"
        return f"ended with exit code {code}"

    def tail(self) -> str:
        """Return the last lines of its output, indented."""
        try:
            data = self.log.read_bytes()[-_TAIL_BYTES:]
        except OSError:
            data = b""
        lines = [line.strip() for line in data.decode("utf-8", "replace").splitlines()]
        shown = [f"    {line[:200]}" for line in lines if line][-_TAIL_LINES:]
        return "\n".join(["it last printed:", *shown]) if shown else "it printed nothing"

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to its process group, which is its own."""
        if self.child.returncode is None:
            with suppress(ProcessLookupError):
                os.killpg(self.child.pid, number)


class CompanionProcesses:
    """The companions of all aircraft of a run."""

    def __init__(
        self, names: Sequence[str], hub: CompanionHub, first_port: int, *, lockstep: bool
    ) -> None:
        """Start nothing yet.

        Args:
            names: of N aircraft, the leader first.
            hub: at which they exchange messages.
            first_port: of the leader's companion, at which it reads its autopilot.
            lockstep: the run waits for them.
        """
        self._names, self._hub, self._port, self._lockstep = names, hub, first_port, lockstep
        self._processes: list[_Process] = []
        self._folder: Path | None = None

    def start(self, scenario: str, code: Mapping[str, bytes]) -> None:
        """Start all processes, each as the leader of a group of its own.

        They end with this process, however it ends.

        Args:
            scenario: text of the resolved one.
            code: files of its laws, by name.
        """
        folder = self._folder = Path(tempfile.mkdtemp(prefix="testbed-companions-"))
        (folder / SCENARIO).write_text(scenario, encoding="utf-8")
        for name, content in code.items():
            (folder / name).write_bytes(content)
        mode = "--lockstep" if self._lockstep else "--at-once"
        for row, name in enumerate(self._names):
            command = [*PROGRAM, "companion", str(folder / SCENARIO), "--as", name]
            command += ["--autopilot", f"udpin:{LOOPBACK}:{self._port + row}"]
            command += ["--formation", self._hub.address, mode, "--no-log", "--quiet"]
            log = folder / f"{row}.log"
            with log.open("wb") as output:
                child = subprocess.Popen(
                    guard_command(folder, command),
                    stdin=subprocess.PIPE,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C goes to the run only, which then ends it
                )
            self._processes.append(_Process(name, child, log))

    def wait(self, check: Callable[[], None]) -> None:
        """Wait until all listen.

        Args:
            check: raises to end the wait.

        Raises:
            ExternalProgramLost: one has ended, or does not listen in time.
        """
        until = time.monotonic() + START_S
        while len(self._hub.listening) < len(self._names):
            check()
            self.check()
            if time.monotonic() > until:
                listening = self._hub.listening
                missing = [n for row, n in enumerate(self._names) if row not in listening]
                raise ExternalProgramLost(
                    f"{', '.join(missing)}: the companion does not listen after {START_S:g} s"
                )
            self._hub.wait_for_greetings(_POLL_S)

    def check(self) -> None:
        """Check in lockstep, or before the flight, that all run.

        Raises:
            ExternalProgramLost: one has ended; with its last lines.
        """
        for process in self._processes:
            if process.child.poll() is not None:
                text = f"{process.name}: its companion {process.ending}; {process.tail()}"
                raise ExternalProgramLost(text)

    def watch(self, now: float) -> list[Event]:
        """Look for companions that have ended.

        Args:
            now: s.

        Returns:
            In real time a warning for each that has ended since the last call.

        Raises:
            ExternalProgramLost: in lockstep one has ended; with its last lines.
        """
        if self._lockstep:
            self.check()
            return []
        found = []
        for process in self._processes:
            if not process.reported and process.child.poll() is not None:
                process.reported = True
                found.append(Event(now, "warning", process.name, f"its companion {process.ending}"))
        return found

    def close(self) -> None:
        """End all processes, with SIGTERM and then SIGKILL, and remove their files."""
        for process in self._processes:
            process.signal(signal.SIGTERM)
        until = time.monotonic() + _GRACE_S
        for process in self._processes:
            with suppress(subprocess.TimeoutExpired):
                process.child.wait(max(0.0, until - time.monotonic()))
            process.signal(signal.SIGKILL)
            process.child.wait()
            if process.child.stdin is not None:
                process.child.stdin.close()
        self._processes = []
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
