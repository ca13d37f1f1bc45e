"""A run as a process of its own, and the programs outside that meet it."""

import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from patience import PATIENCE_S, until

from testbed.record.read import frames, read_log

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / ".venv-clients" / "bin"


def clients():
    """The folder of the clients' programs; where they are not, their tests are skipped."""
    if not (CLIENTS.parent / ".installed").exists():
        missing = "the MAVLink clients are not installed: make clients"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    return CLIENTS


def free_port():
    """A UDP port of loopback that nobody has now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.bind(("127.0.0.1", 0))
        return asked.getsockname()[1]


class Flight:
    """A run under way, or over."""

    def __init__(self, process, out, paper):
        self.process, self.out, self._paper = process, out, paper

    @property
    def said(self):
        return self._paper.read_text()

    def stop(self):
        """End it as Ctrl-C does; its metrics."""
        self.process.terminate()
        return self.end(130)

    def end(self, code=0):
        """Let it end by itself, with this code; its metrics."""
        ended = self.process.wait(PATIENCE_S)
        assert ended == code, self.said
        assert "Traceback" not in self.said
        return json.loads((self.out / "metrics.json").read_text())

    def log(self):
        return read_log(self.out / "run.mcap")

    def frames(self):
        return list(frames(self.log()))


@contextmanager
def flying(folder, *arguments, page="simulation-3"):
    """`testbed run` of a page; it is over when the block is left."""
    folder.mkdir(exist_ok=True)
    out, paper = folder / "run", folder / "said.txt"
    command = [sys.executable, "-m", "testbed", "run", page, "--quiet", "--out", out, *arguments]
    with paper.open("w") as file:
        process = subprocess.Popen(
            list(map(str, command)),
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"},
            stdout=file,
            stderr=subprocess.STDOUT,
        )
        try:
            yield Flight(process, out, paper)
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()


def run_client(flight, *command):
    """What a client's program said; it ended well, in time, and before the flight it is for."""
    paper = flight.out.parent / "client.txt"
    with paper.open("w") as file:
        process = subprocess.Popen(list(map(str, command)), stdout=file, stderr=subprocess.STDOUT)
        try:
            until(lambda: process.poll() is not None or flight.process.poll() is not None)
        finally:
            if process.poll() is None:
                process.kill()
            code = process.wait()
            print(paper.read_text())  # pytest shows it where the test fails
    assert code == 0, flight.said + paper.read_text()
    return paper.read_text()


def said_events(metrics, source=None):
    """Texts of a run's events, of one aircraft or of all."""
    events = metrics["events"]
    return [each["text"] for each in events if source in (None, each["source"])]
