"""Measure the memory of a long flight of many aircraft, in a separate process.

usage: python benchmarks/memory.py [--aircraft N] [--duration S]

Prints as JSON the peak of the resident memory, and its growth in the second half of the flight: in
the first half libraries are loaded and buffers filled.
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

from testbed.core.records import Event, Observer, RunInfo, Sample

STATUS = Path("/proc/self/status")  # Linux


def memory_now() -> dict[str, float]:
    """Return resident bytes, now (VmRSS) and at most (VmHWM).

    `getrusage` would start with the peak of the parent process.
    """
    lines = (line.split() for line in STATUS.read_text(encoding="utf-8").splitlines())
    return {words[0][:-1]: 1024.0 * float(words[1]) for words in lines if words[-1] == "kB"}


class MemoryObserver(Observer):
    """Record the resident memory every second of flight."""

    zero_copy = True

    def begin(self, info: RunInfo) -> None:
        """Start with empty lists."""
        self.times: list[float] = []
        self.bytes: list[float] = []

    def observe(self, sample: Sample) -> None:
        """Record once a second."""
        if sample.time_s >= len(self.times):
            self.times.append(sample.time_s)
            self.bytes.append(memory_now()["VmRSS"])

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing."""


def memory(aircraft: int, duration_s: float) -> dict[str, float]:
    """Measure peak and growth of a flight in a separate process, MB and MB/s."""
    command = [sys.executable, str(Path(__file__)), "--aircraft", str(aircraft)]
    done = subprocess.run(
        [*command, "--duration", str(duration_s)], check=True, stdout=subprocess.PIPE, text=True
    )
    result: dict[str, float] = json.loads(done.stdout)
    return result


def main() -> None:
    """Fly once, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--duration", type=float, default=40.0, help="s of flight")
    options = parser.parse_args()
    seen = MemoryObserver()
    full(vee(options.aircraft, options.duration), seen)
    half = len(seen.times) // 2
    peak = memory_now()["VmHWM"]
    growth, _ = np.polyfit(seen.times[half:], seen.bytes[half:], 1)
    result = {
        "aircraft": options.aircraft,
        "simulated_s": options.duration,
        "peak_mb": peak / 1e6,
        "growth_mb_per_s": growth / 1e6,
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
