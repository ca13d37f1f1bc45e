"""What watching costs: a run with a live view against the same run without, in turns.

Two viewers on the same machine, as fast as the run flies: one that takes the data and draws
nothing, as where a graphics card draws, and one that draws in software, which takes a processor of
its own. Of each, two ratios: of the wall clock of the flight, and of the processor time that the
run's own process spends.

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
from testbed.scenario import Scenario, load, shorten
from testbed.views import FAST_HZ, LiveViewer, RerunView
from testbed.views.viewer import headless, program, tethered


def fly(page: Scenario, *watching: RerunView) -> tuple[float, float]:
    """Wall clock of a flight by its own account, and processor time of this process, s."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        flown = run(page, out=Path(folder) / "run", observers=watching)
        return flown.metrics["wall_s"], time.process_time() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--scenario", default="simulation-3")
    parser.add_argument("--duration", type=float, help="s of flight; default the scenario's")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    page = load(asked.scenario)
    if asked.duration:
        page = shorten(page, asked.duration)
    fly(shorten(page, 1.0))  # compiles what is compiled once
    result: dict[str, object] = {
        "scenario": page.name,
        "simulated_s": page.scenario.duration_s,
    }
    for kind, viewer in (("not_drawing", blind), ("drawing_in_software", drawing)):
        alone, watched = [fly(page)], []
        for _ in range(asked.repeats):
            with viewer() as port:
                watched.append(fly(page, RerunView(LiveViewer(port=port), most_hz=FAST_HZ)))
            alone.append(fly(page))
        # each run against the mean of what was measured before and after it: machines drift
        turns = list(zip(watched, alone, alone[1:], strict=False))
        ratios = [[2.0 * w[k] / (p[k] + q[k]) for w, p, q in turns] for k in range(2)]
        told = []
        for what, each in zip(("wall", "own_processor"), ratios, strict=True):
            result[f"{kind}_{what}_ratio"] = statistics.median(each)
            result[f"{kind}_{what}_ratio_spread"] = [min(each), max(each)]
            told.append(f"{statistics.median(each):.2f} ({min(each):.2f}-{max(each):.2f})")
        print(
            f"{page.name}, {page.scenario.duration_s:g} s, viewer {kind.replace('_', ' ')}: wall "
            f"clock x {told[0]}, the run's own processor time x {told[1]}",
            flush=True,
        )
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


@contextlib.contextmanager
def drawing() -> Iterator[int]:
    """The port of a viewer that draws in software."""
    with headless((1600, 900)) as port:
        yield port


@contextlib.contextmanager
def blind() -> Iterator[int]:
    """The port of a viewer that takes everything and saves it."""
    executable = program()
    assert executable is not None, "install rerun-sdk"
    with tempfile.TemporaryDirectory() as folder:
        saving = ("--save", str(Path(folder) / "it.rrd"))
        with tethered(executable, *saving) as (viewer, port):
            assert viewer.poll() is None, "the viewer did not start"
            yield port


if __name__ == "__main__":
    main()
