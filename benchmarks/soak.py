"""Measure the growth of memory and of time per simulated second in a long flight.

usage: python benchmarks/soak.py [--hours H] [--aircraft N] [--json FILE]

Flies a vee on a circle, with its log, and records resident memory and processor time every half
minute of flight. The first tenth is left out: libraries are loaded and buffers filled.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fleets import vee
from full_over_bare import full
from memory import memory_now

from testbed.core.records import Event, Observer, RunInfo, Sample

EVERY_S = 30.0
PARTS = 9  # after the first tenth


class ResourceObserver(Observer):
    """Record time of flight, resident memory and processor time."""

    zero_copy = True

    def begin(self, info: RunInfo) -> None:
        """Start with an empty list."""
        self.seen: list[tuple[float, float, float]] = []

    def observe(self, sample: Sample) -> None:
        """Record every EVERY_S seconds."""
        if sample.time_s >= EVERY_S * len(self.seen):
            self.seen.append((sample.time_s, memory_now()["VmRSS"], time.process_time()))

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing."""


def numbers(seen: Sequence[tuple[float, float, float]]) -> dict[str, Any]:
    """Return the numbers of the flight after its first tenth."""
    at, resident, spent = np.array(seen[len(seen) // 10 :]).T
    growth = float(np.polyfit(at, resident, 1)[0])
    ends = np.linspace(0, len(at) - 1, PARTS + 1).astype(int)
    speeds = np.diff(at[ends]) / np.diff(spent[ends])
    return {
        "simulated_s": float(at[-1]),
        "resident_mb": [float(resident[0]) / 1e6, float(resident[-1]) / 1e6],
        "growth_mb_per_hour": growth * 3600.0 / 1e6,
        "simulated_s_per_processor_s": speeds.tolist(),
        "last_over_first": float(speeds[-1] / speeds[0]),
    }


def main() -> None:
    """Fly, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--aircraft", type=int, default=4)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    observer = ResourceObserver()
    full(vee(options.aircraft, options.hours * 3600.0), observer)
    result = numbers(observer.seen)
    first, last = result["resident_mb"]
    each = ", ".join(f"{speed:.0f}" for speed in result["simulated_s_per_processor_s"])
    print(
        f"{options.aircraft} aircraft, {result['simulated_s'] / 3600.0:.2f} h: {first:.0f} to "
        f"{last:.0f} MB, {result['growth_mb_per_hour']:+.2f} MB/h; simulated seconds per processor "
        f"second in ninths: {each}"
    )
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
