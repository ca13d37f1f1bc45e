"""Measure how well a study uses the processors, and compare its file across backends.

Flies a study of 200 runs of Simulation 3 for 300 s, a leader and three followers, and prints the
share of the processors' time that its workers used: their processor seconds, start included, over
wall-clock time and number of processors. Time that the host of a virtual machine gave to others is
printed too, and the share of the rest. With --compare it flies the same with one process, killed
three times and resumed, and on a local Dask cluster, and compares the files to the last bit.

usage: python benchmarks/sweep.py [--runs N] [--seconds S] [--jobs N] [--compare] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from testbed.studies.sweep import sweep
from testbed.studies.table import StudyTable, read_table

STUDY = """
study:
  schema: 1
  name: benchmark
  scenario: simulation-3
  duration_s: {seconds}
  set: {{scenario.published: null}}
  design: latin-hypercube
  samples: {points}
  seeds: {seeds}
vary:
  network.loss: {{uniform: [0, 0.3]}}
  air.wind.speed_mps: {{uniform: [0, 5]}}
"""
SEEDS = 4
STAT = Path("/proc/stat")  # Linux
POLL_S = 0.2


def command(study: Path, out: Path, *more: str) -> list[str]:
    """Return the command that flies the study."""
    return [sys.executable, "-m", "testbed", "sweep", str(study), "--out", str(out), "-q", *more]


def timed(study: Path, out: Path, jobs: int) -> dict[str, float]:
    """Fly the study; return wall-clock time and processor time of the workers, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began, stolen_s = time.perf_counter(), stolen()
    sweep(study, out, jobs=jobs)
    wall_s = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": wall_s, "processor_s": used_s, "stolen_s": stolen() - stolen_s}


def stolen() -> float:
    """Return processor seconds that the host gave to other machines; 0 where unknown."""
    if not STAT.exists():
        return 0.0
    # proc(5): cpu user nice system idle iowait irq softirq steal
    return int(STAT.read_text(encoding="ascii").split()[8]) / os.sysconf("SC_CLK_TCK")


def killed(words: Sequence[str], journal: Path, times: int) -> None:
    """Run the command, kill it this many times on the way, and resume it."""
    for _ in range(times):
        before = journal.stat().st_size if journal.exists() else 0
        process = subprocess.Popen([*words, "--resume"])
        while process.poll() is None:
            time.sleep(POLL_S)
            if journal.exists() and journal.stat().st_size > before + 50_000:
                process.send_signal(signal.SIGKILL)
                process.wait()
    subprocess.run([*words, "--resume"], check=True)


def same(one: StudyTable, other: StudyTable) -> bool:
    """Return whether two files have the same content, to the last bit."""
    return (
        list(one.columns) == list(other.columns)
        and dict(one.metadata) == dict(other.metadata)
        and all(
            repr(one.columns[name].tolist()) == repr(other.columns[name].tolist())
            for name in one.columns
        )
    )


def on_dask(study: Path, out: Path, jobs: int) -> None:
    """Fly the study on a cluster of this machine."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=jobs, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        subprocess.run(command(study, out, "--backend", "dask", "--scheduler", address), check=True)


def main() -> None:
    """Measure, and print the result."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = folder / "benchmark.yaml"
        points = max(1, options.runs // SEEDS)
        study.write_text(STUDY.format(seconds=options.seconds, points=points, seeds=SEEDS))
        out = folder / "many.parquet"
        result: dict[str, Any] = timed(study, out, options.jobs)
        table = read_table(out)
        result |= {
            "runs": len(table.columns["run"]),
            "jobs": options.jobs,
            "bytes": out.stat().st_size,
        }
        available_s = result["wall_s"] * options.jobs
        result["share"] = result["processor_s"] / available_s
        result["share_of_left"] = result["processor_s"] / (available_s - result["stolen_s"])
        print(
            f"{result['runs']} runs of {options.seconds:g} s in {result['wall_s']:.1f} s on "
            f"{options.jobs} processors: {100 * result['share']:.1f} % of their time, "
            f"{100 * result['share_of_left']:.1f} % of the time left by the host; "
            f"{result['bytes'] / 1e6:.2f} MB",
            flush=True,
        )
        if options.compare:
            single = folder / "single.parquet"
            result["single"] = timed(study, single, 1)
            result["same_single"] = same(table, read_table(single))
            again = folder / "killed.parquet"
            killed(
                command(study, again, "--jobs", str(options.jobs)), again.with_suffix(".journal"), 3
            )
            result["same_killed"] = same(table, read_table(again))
            dask = folder / "dask.parquet"
            on_dask(study, dask, options.jobs)
            result["same_dask"] = same(table, read_table(dask))
            for what in ("single", "killed", "dask"):
                print(f"same content, {what}: {result[f'same_{what}']}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
