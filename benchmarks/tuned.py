"""Write the tables of docs/tune.md, and the picture of a study's report.

usage: python benchmarks/tuned.py --into docs/tune.md docs/studies.md

Searches gains of the X8's middle loop, and flies Experiment 2 with the old and the new ones. The
picture is a screenshot of the report, by Chromium.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from inputs import ROOT, Case, Inputs
from pictures import screenshot, testbed
from tables import add_output_arguments, publish, row

from testbed.core.stats import student_interval
from testbed.studies.table import read_table

TUNING, SCENARIO = "x8-middle-loop", "experiment-2"
SEARCH, WHOLE = "python benchmarks/tuned.py, search", "python benchmarks/tuned.py, whole"
PICTURE = "python benchmarks/tuned.py, report"
IMAGE = ROOT / "docs" / "images" / "study-report.png"
SIZE = "1100,1165"
ALT = "The head of a study's report: numbers of two cases with intervals, and their difference"
SHOWN = {  # metrics of the study, their names and digits
    "windows.rectangles.mean_rms_m": ("mean RMS error, m", 3),
    "saturations.uav1.seconds": ("uav1 at a limit of its commands, s", 0),
    "saturations.uav2.seconds": ("uav2 at a limit of its commands, s", 0),
}
STUDY = """study:
  schema: 1
  name: x8-tuned-whole
  scenario: {scenario}
  seeds: [21, 22, 23, 24]
  metrics: [{metrics}]
cases:
  before: {{}}
  after: {{controller.gains: {gains}}}
"""
_OF_BOTH = Inputs((Case(SCENARIO),), tunings=(TUNING,))
INPUTS = {SEARCH: _OF_BOTH, WHOLE: _OF_BOTH, PICTURE: _OF_BOTH}


def digits4(value: float) -> str:
    """Return a number with four significant digits."""
    return f"{value:.4g}"


def search_table(found: Mapping[str, Any]) -> Iterator[str]:
    """Return the rows of gains, and of the metric before and after."""
    yield row("gain", "from", "to", "before", "after")
    yield "|---|--:|--:|--:|--:|"
    for key, gain in found["gains"].items():
        name = key.removeprefix("controller.gains.")
        bounds = (f"{gain[end]:g}" for end in ("from", "to"))
        yield row(f"`{name}`", *bounds, digits4(gain["before"]), digits4(gain["after"]))
    cost, held = found["cost"], found["comparison"]
    seeds, others = (found[key] for key in ("seeds", "held_out_seeds"))
    difference = [signed(held["difference"][key], 3) for key in ("mean", "low", "high")]
    share = [percent(each["after"] / each["before"] - 1.0) for each in (held, cost)]
    yield ""
    yield row("mean RMS error, m", "before", "after", "difference, 95 %")
    yield "|---|--:|--:|--:|"
    yield row(
        f"the worst of the seeds tuned on, {' and '.join(map(str, seeds))}",
        *(f"{cost[key]:.3f}" for key in ("before", "after")),
        "",
    )
    yield row(
        f"mean of the seeds held out, {others[0]} to {others[-1]}",
        *(f"{held[key]:.3f}" for key in ("before", "after")),
        f"{difference[0]} [{difference[1]}, {difference[2]}]",
    )
    yield ""
    significant = "a significant" if held["better"] else "no significant"
    yield (
        f"The search took {found['flights']} flights. On the held-out seeds the error changes by "
        f"{share[0]}, {significant} difference; on the seeds used for tuning by {share[1]}."
    )


def signed(value: float, digits: int) -> str:
    """Return a number with its sign, a minus where it is negative."""
    return f"{value:+.{digits}f}".replace("-", "−")


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{signed(100.0 * share, 0)} %"


def whole_table(file: Path) -> Iterator[str]:
    """Return the rows of the study of whole flights."""
    rows = list(read_table(file).rows())
    yield row("median of 4 seeds", "before", "after", "mean difference, 95 %")
    yield "|---|--:|--:|--:|"
    for key, (name, digits) in SHOWN.items():
        before, after = (
            np.array([each[f"metrics.{key}"] for each in rows if each["case"] == case])
            for case in ("before", "after")
        )
        mean, low, high = (signed(each, digits) for each in student_interval(after - before))
        medians = (f"{np.median(each):.{digits}f}" for each in (before, after))
        yield row(name, *medians, f"{mean} [{low}, {high}]")


def main() -> None:
    """Search, fly, take the picture, and print or insert the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    add_output_arguments(parser)
    options = parser.parse_args()
    jobs = ("--jobs", str(options.jobs))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        testbed("tune", TUNING, "--out", folder / "tuned", *jobs)
        found = json.loads((folder / "tuned" / "result.json").read_text(encoding="utf-8"))
        parts = {SEARCH: "\n".join(search_table(found))}
        study = folder / "x8.yaml"
        study.write_text(study_text(found), encoding="utf-8")
        testbed("sweep", study, "--out", folder / "x8.parquet", *jobs)
        parts[WHOLE] = "\n".join(
            ["```yaml", study_text(found).strip(), "```", "", *whole_table(folder / "x8.parquet")]
        )
        parts[PICTURE] = f"![{ALT}](images/{IMAGE.name})"
        testbed("study-report", folder / "x8.parquet", "--out", folder / "x8.html")
        if options.into and not options.check:
            screenshot(folder / "x8.html", IMAGE, SIZE)
    sys.exit(0 if publish(options, parts, INPUTS) else 1)


def study_text(found: Mapping[str, Any]) -> str:
    """Return the study of whole flights with the gains before and after."""
    nested: dict[str, dict[str, str]] = {}
    for key, gain in found["gains"].items():
        loop, name = key.removeprefix("controller.gains.").split(".")
        nested.setdefault(loop, {})[name] = digits4(gain["after"])
    loops = (
        f"{loop}: {{{', '.join(f'{name}: {value}' for name, value in gains.items())}}}"
        for loop, gains in nested.items()
    )
    return STUDY.format(
        scenario=SCENARIO, metrics=", ".join(SHOWN), gains=f"{{{', '.join(loops)}}}"
    )


if __name__ == "__main__":
    main()
