"""Run `testbed run` and client programs as processes."""

import json
import os
import signal
import socket
import subprocess
from contextlib import contextmanager
from pathlib import Path

import pytest
from commands import environment
from forked import Forked
from waiting import TIMEOUT_S, until

from testbed.logs.read import read_log, samples

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / ".venv-clients" / "bin"


def clients():
    """Return the folder of the clients' programs; skip the test if they are not installed."""
    if not (CLIENTS.parent / ".installed").exists():
        missing = "the MAVLink clients are not installed: make clients"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    return CLIENTS


def free_port():
    """Return an unused UDP port of loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Flight:
    """A run in a process."""

    def __init__(self, process, out, output_file):
        self.process, self.out, self._output_file = process, out, output_file

    @property
    def output(self):
        return self._output_file.read_text()

    def stop(self):
        """Interrupt it, and return its metrics."""
        self.process.send_signal(signal.SIGTERM)
        return self.end(130)

    def end(self, code=0):
        """Wait for its end, check the exit code, and return its metrics."""
        exit_code = self.process.wait(TIMEOUT_S)
        assert exit_code == code, self.output
        assert "Traceback" not in self.output
        return json.loads((self.out / "metrics.json").read_text())

    def log(self):
        return read_log(self.out / "run.mcap")

    def frames(self):
        return list(samples(self.log()))


@contextmanager
def start_run(folder, *arguments, scenario="simulation-3"):
    """Start `testbed run`; the process ends with the block at the latest."""
    folder.mkdir(exist_ok=True)
    out, output_file = folder / "run", folder / "output.txt"
    command = ["run", scenario, "--quiet", "--out", out, *arguments]
    with output_file.open("w") as file:
        process = Forked(
            *("testbed.cli.main:main", *command),
            cwd=folder,
            env=environment(120),
            stdout=file,
            stderr=file,
        )
        try:
            yield Flight(process, out, output_file)
        finally:
            process.kill()
            process.wait(TIMEOUT_S)


def run_client(flight, *command):
    """Run a client program, check that it succeeds before the run ends, and return its output."""
    output_file = flight.out.parent / "client.txt"
    with output_file.open("w") as file:
        process = subprocess.Popen(list(map(str, command)), stdout=file, stderr=subprocess.STDOUT)
        try:
            until(lambda: process.poll() is not None or flight.process.poll() is not None)
        finally:
            if process.poll() is None:
                process.kill()
            code = process.wait()
            print(output_file.read_text())  # pytest shows it if the test fails
    assert code == 0, flight.output + output_file.read_text()
    return output_file.read_text()


def event_texts(metrics, source=None):
    """Return the texts of a run's events, of one aircraft or of all."""
    events = metrics["events"]
    return [each["text"] for each in events if source in (None, each["source"])]
