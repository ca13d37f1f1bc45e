"""Measure the cost of a live view: runs with a viewer and without, alternating.

Two viewers on the same machine, as fast as the run flies: one that receives the data and draws
nothing, as with a graphics card, and one that draws in software, which uses a processor. Two ratios
each: of the flight's wall-clock time, and of the processor time of the run's own process.

usage: make bench  (or: python benchmarks/view_cost.py [--scenario NAME] [--duration S]
[--repeats N] [--json FILE]); needs a Vulkan driver, such as mesa-vulkan-drivers
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from testbed import run
from testbed.scenario import Scenario, load_scenario, set_duration
from testbed.views import FAST_HZ, LiveViewer, RerunView
from testbed.views.viewer import guarded_viewer, headless_viewer, rerun_program


def fly(scenario: Scenario, *watching: RerunView) -> tuple[float, float]:
    """Measure a flight's wall-clock time and the processor time of this process, s."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        flown = run(scenario, out=Path(folder) / "run", observers=watching)
        return flown.metrics["wall_s"], time.process_time() - began


def main() -> None:
    """Measure, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--duration", type=float, help="s of flight; default the scenario's")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    if options.duration:
        scenario = set_duration(scenario, options.duration)
    fly(set_duration(scenario, 1.0))  # compiles the kernels
    result: dict[str, object] = {
        "scenario": scenario.name,
        "simulated_s": scenario.scenario.duration_s,
    }
    for kind, viewer in (("not_drawing", not_drawing), ("drawing_in_software", drawing)):
        alone, watched = [fly(scenario)], []
        for _ in range(options.repeats):
            with viewer() as port:
                watched.append(fly(scenario, RerunView(LiveViewer(port=port), max_hz=FAST_HZ)))
            alone.append(fly(scenario))
        # each run relative to the mean of those before and after it, against drift
        turns = list(zip(watched, alone, alone[1:], strict=False))
        ratios = [[2.0 * w[k] / (p[k] + q[k]) for w, p, q in turns] for k in range(2)]
        shown = []
        for what, each in zip(("wall", "own_processor"), ratios, strict=True):
            result[f"{kind}_{what}_ratio"] = statistics.median(each)
            result[f"{kind}_{what}_ratio_spread"] = [min(each), max(each)]
            shown.append(f"{statistics.median(each):.2f} ({min(each):.2f}-{max(each):.2f})")
        print(
            f"{scenario.name}, {scenario.scenario.duration_s:g} s, viewer "
            f"{kind.replace('_', ' ')}: wall clock x {shown[0]}, "
            f"the run's own processor time x {shown[1]}",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


@contextlib.contextmanager
def drawing() -> Iterator[int]:
    """Start a viewer that draws in software, and yield its port."""
    with headless_viewer((1600, 900)) as port:
        yield port


@contextlib.contextmanager
def not_drawing() -> Iterator[int]:
    """Start a viewer that saves everything without drawing, and yield its port."""
    executable = rerun_program()
    assert executable is not None, "install rerun-sdk"
    with tempfile.TemporaryDirectory() as folder:
        saving = ("--save", str(Path(folder) / "it.rrd"))
        with guarded_viewer(executable, *saving) as (viewer, port):
            assert viewer.poll() is None, "the viewer did not start"
            yield port


if __name__ == "__main__":
    main()
