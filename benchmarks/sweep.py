"""How well a study uses the processors, and that its file does not depend on who flies it.

Flies a study of 200 runs of Simulation 3 for 300 s, a leader and three followers, and says which
part of the processors' time its workers used: their processor seconds, starting included, over the
wall clock and the number of processors. What the host of a virtual machine kept of these for others
is told, and the part of what was left. With --compare it flies the same with one process, killed
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

from testbed.study.sweep import sweep
from testbed.study.table import StudyTable, read_table

PAGE = """
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


def command(page: Path, out: Path, *more: str) -> list[str]:
    """The command that flies it."""
    return [sys.executable, "-m", "testbed", "sweep", str(page), "--out", str(out), "-q", *more]


def timed(page: Path, out: Path, jobs: int) -> dict[str, float]:
    """Fly it from here: wall clock, and processor seconds of the workers, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began, stolen_s = time.perf_counter(), stolen()
    sweep(page, out, jobs=jobs)
    wall_s = time.perf_counter() - began
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": wall_s, "processor_s": used_s, "stolen_s": stolen() - stolen_s}


def stolen() -> float:
    """Processor seconds that a host has kept from this machine; 0 where none says so."""
    if not STAT.exists():
        return 0.0
    # proc(5): cpu user nice system idle iowait irq softirq steal
    return int(STAT.read_text(encoding="ascii").split()[8]) / os.sysconf("SC_CLK_TCK")


def killed(words: Sequence[str], journal: Path, times: int) -> None:
    """Have the command killed so many times in its midst, and resumed."""
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
    """Whether two files have the same content, to the last bit."""
    return (
        list(one.columns) == list(other.columns)
        and dict(one.facts) == dict(other.facts)
        and all(
            repr(one.columns[name].tolist()) == repr(other.columns[name].tolist())
            for name in one.columns
        )
    )


def on_dask(page: Path, out: Path, jobs: int) -> None:
    """Fly it on a cluster of this machine."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=jobs, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        subprocess.run(command(page, out, "--backend", "dask", "--scheduler", address), check=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        page = folder / "benchmark.yaml"
        points = max(1, asked.runs // SEEDS)
        page.write_text(PAGE.format(seconds=asked.seconds, points=points, seeds=SEEDS))
        out = folder / "many.parquet"
        result: dict[str, Any] = timed(page, out, asked.jobs)
        table = read_table(out)
        result |= {
            "runs": len(table.columns["run"]),
            "jobs": asked.jobs,
            "bytes": out.stat().st_size,
        }
        there_s = result["wall_s"] * asked.jobs
        result["share"] = result["processor_s"] / there_s
        result["share_of_left"] = result["processor_s"] / (there_s - result["stolen_s"])
        print(
            f"{result['runs']} runs of {asked.seconds:g} s in {result['wall_s']:.1f} s on "
            f"{asked.jobs} processors: {100 * result['share']:.1f} % of their time, "
            f"{100 * result['share_of_left']:.1f} % of what others left; "
            f"{result['bytes'] / 1e6:.2f} MB",
            flush=True,
        )
        if asked.compare:
            single = folder / "single.parquet"
            result["single"] = timed(page, single, 1)
            result["same_single"] = same(table, read_table(single))
            again = folder / "killed.parquet"
            killed(
                command(page, again, "--jobs", str(asked.jobs)), again.with_suffix(".journal"), 3
            )
            result["same_killed"] = same(table, read_table(again))
            dask = folder / "dask.parquet"
            on_dask(page, dask, asked.jobs)
            result["same_dask"] = same(table, read_table(dask))
            for what in ("single", "killed", "dask"):
                print(f"same content, {what}: {result[f'same_{what}']}")
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
