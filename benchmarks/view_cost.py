"""What watching costs: a run with a live view against the same run without, in turns.

The viewer draws without a screen, in software, on the same machine, which is the dearest case: with
a graphics card it takes no processor from the run. Flown as fast as it goes, and at a pace that two
processors can draw. Two ratios: of the wall clock of the flight, and of the processor time that the
run's own process spends.

usage: make bench  (or: python benchmarks/view_cost.py [--scenario NAME] [--duration S]
[--repeats N] [--json FILE]); needs a Vulkan driver, such as mesa-vulkan-drivers
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

from testbed import run
from testbed.scenario import Scenario, load, shorten
from testbed.views import LiveViewer, RerunView
from testbed.views.viewer import free_port, headless


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
    alone, watched = [fly(page)], []
    for turn in range(asked.repeats):
        port = free_port()
        with headless(port, (1600, 900)):
            watched.append(fly(page, RerunView(LiveViewer(port=port))))
        alone.append(fly(page))
        print(f"turn {turn + 1}: {watched[-1][0]:.2f} s, without {alone[-1][0]:.2f} s", flush=True)
    # each run against the mean of what was measured before and after it: machines drift
    ratios = [
        [2.0 * w[k] / (p[k] + q[k]) for w, p, q in zip(watched, alone, alone[1:], strict=False)]
        for k in range(2)
    ]
    wall, own = (statistics.median(each) for each in ratios)
    result = {
        "scenario": page.name,
        "simulated_s": page.scenario.duration_s,
        "wall_ratio": wall,
        "wall_ratio_spread": [min(ratios[0]), max(ratios[0])],
        "own_processor_ratio": own,
        "own_processor_ratio_spread": [min(ratios[1]), max(ratios[1])],
    }
    print(
        f"{page.name}, {page.scenario.duration_s:g} s, live view: wall clock x {wall:.2f} "
        f"({min(ratios[0]):.2f}-{max(ratios[0]):.2f}), the run's own processor time x {own:.2f} "
        f"({min(ratios[1]):.2f}-{max(ratios[1]):.2f})"
    )
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
