"""How much memory a long flight of many aircraft needs, flown in a process of its own.

usage: python benchmarks/memory.py [--aircraft N] [--duration S]

Prints as JSON the most that was ever resident, and by how much what is resident grows. That is told
by the second half of the flight: in the first one libraries are still loaded and buffers filled.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fleets import vee
from full_over_bare import full

from testbed.state import Event, Frame, Observer, RunInfo

STATUS = Path("/proc/self/status")  # Linux


def memory_now() -> dict[str, float]:
    """Bytes that are resident now (VmRSS), and that were at most (VmHWM).

    Not `getrusage`, which begins with the peak of the process that started this one.
    """
    lines = (line.split() for line in STATUS.read_text(encoding="utf-8").splitlines())
    return {words[0][:-1]: 1024.0 * float(words[1]) for words in lines if words[-1] == "kB"}


class Resident(Observer):
    """Takes down the memory that is resident, every second of flight."""

    borrows = True

    def begin(self, info: RunInfo) -> None:
        """Nothing was flown yet."""
        self.times: list[float] = []
        self.bytes: list[float] = []

    def observe(self, frame: Frame) -> None:
        """Look once a second."""
        if frame.time_s >= len(self.times):
            self.times.append(frame.time_s)
            self.bytes.append(memory_now()["VmRSS"])

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Nothing."""


def memory(aircraft: int, duration_s: float) -> dict[str, float]:
    """Peak and growth of a flight in a process of its own, in MB and MB/s."""
    command = [sys.executable, str(Path(__file__)), "--aircraft", str(aircraft)]
    said = subprocess.run(
        [*command, "--duration", str(duration_s)], check=True, stdout=subprocess.PIPE, text=True
    )
    told: dict[str, float] = json.loads(said.stdout)
    return told


def main() -> None:
    """Fly once, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--duration", type=float, default=40.0, help="s of flight")
    asked = parser.parse_args()
    seen = Resident()
    full(vee(asked.aircraft, asked.duration), seen)
    half = len(seen.times) // 2
    peak = memory_now()["VmHWM"]
    growth, _ = np.polyfit(seen.times[half:], seen.bytes[half:], 1)
    told = {
        "aircraft": asked.aircraft,
        "simulated_s": asked.duration,
        "peak_mb": peak / 1e6,
        "growth_mb_per_s": growth / 1e6,
    }
    print(json.dumps(told))


if __name__ == "__main__":
    main()
