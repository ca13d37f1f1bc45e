"""Files of a tune: candidates, best gains, tuned scenario, result."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed import __version__
from testbed.core.files import report_write_errors, write_text_file
from testbed.logs.run_directory import write_run_file
from testbed.metrics.document import write_json
from testbed.scenario import (
    dump_middle_loop,
    find_scenario,
    library,
    load_scenario,
    middle_loop_gains,
)
from testbed.scenario.yaml_io import write
from testbed.studies.tune_objective import HeldOutComparison, describe_aggregate
from testbed.studies.tune_problem import TuneProblem
from testbed.studies.tune_schema import GAINS, Tune
from testbed.studies.tune_search import Candidate

CANDIDATES, GAINS_FILE, SCENARIO, RESULT, TUNE_FILE = (
    "candidates.csv", "middle_loop.yaml", "tuned.yaml", "result.json", "tune.yaml",
)  # fmt: skip
NOT_COMPARED = "not compared on held-out seeds"


@dataclass(frozen=True, slots=True)
class TuneResult:
    """Result of a tune.

    Args:
        tune: its file.
        directory: of its output files.
        candidates: all evaluated ones, in order; the first has the gains of the scenario.
        best: the cheapest, of equals the first.
        saturation: metric above which costs saturate.
        flights: number of flights of the search.
        stop_reason: why the search ended.
        comparison: on held-out seeds; None if nothing better was found.
        held_out_costs: combined costs on these seeds, before and after.
    """

    tune: Tune
    directory: Path
    candidates: Sequence[Candidate]
    best: Candidate
    saturation: float
    flights: int
    stop_reason: str
    comparison: HeldOutComparison | None
    held_out_costs: tuple[float, float] | None


class SearchLog:
    """Write the files of a running search, each complete at any time."""

    def __init__(self, problem: TuneProblem, directory: Path) -> None:
        """Write into this directory."""
        self._problem = problem
        self.directory = directory

    def start(self, first: Candidate) -> None:
        """Write the tune file, and the gains of the scenario as the first candidate."""
        tune = self._problem.tune
        write_run_file(self.directory, TUNE_FILE, tune.study.text.encode())
        runs = [f"cost of run {run.number}" for run in self._problem.runs]
        head = ["candidate", "generation", "cost", *tune.config.gains, *runs]
        self._write(CANDIDATES, _csv_line(head) + _csv_line(_cells(first)))

    def add(self, candidates: Sequence[Candidate], best: Candidate) -> None:
        """Append a generation, and write the best gains if they are in it."""
        path = self.directory / CANDIDATES
        with report_write_errors(path), path.open("a", encoding="utf-8", newline="") as file:
            file.writelines(_csv_line(_cells(each)) for each in candidates)
            file.flush()
            os.fsync(file.fileno())
        if any(each is best for each in candidates):
            self._write_gains(best, NOT_COMPARED)

    def finish(self, result: TuneResult) -> None:
        """Write the result, and the verdict into the files of the gains."""
        if result.comparison is not None:
            self._write_gains(result.best, result.comparison.verdict)
        write_json(self.directory / RESULT, to_document(result, self._problem))

    def _write_gains(self, best: Candidate, verdict: str) -> None:
        """Write the middle loop's gains, and a scenario that extends the tuned one."""
        problem = self._problem
        settings, scenario = problem.tune.config.study, problem.scenario_with(best.gains)
        objective = problem.tune.config.objective
        comment = (
            f"# Tuned by testbed {__version__} for {objective.metric} of {settings.scenario}, "
            f"study {settings.name}:\n# {describe_aggregate(objective.aggregate)} over its flights "
            f"is {best.cost:.4g} ({verdict}).\n"
        )
        changes: dict[str, Any] = {}
        if any(key.startswith(GAINS) for key in problem.keys):
            profile, airframe = scenario.controller.profile, scenario.fleet[0].aircraft
            gains = dump_middle_loop({profile: middle_loop_gains(scenario, airframe)})
            self._write(GAINS_FILE, f"{comment}\n{gains}")
            changes["controller"] = {"middle_loop": GAINS_FILE, "profile": profile}
            if load_scenario(self._scenario_path).controller.gains:  # the gains file has them too
                changes["controller"]["gains"] = None
        for key, value in problem.changed_keys(best.gains).items():
            if not key.startswith(GAINS):
                node = changes
                *parts, last = key.split(".")
                for part in parts:
                    node = node.setdefault(part, {})
                node[last] = value
        header = {"extends": self._extends(), "scenario": {"name": f"{settings.name}-tuned"}}
        command = f"# testbed run {self.directory / SCENARIO}\n"
        self._write(SCENARIO, f"{comment}{command}\n{write({**header, **changes})}")

    @property
    def _scenario_path(self) -> Path:
        """Path of the first case's scenario."""
        return find_scenario(self._problem.runs[0].scenario)

    def _extends(self) -> str:
        path = self._scenario_path
        if path.parent == library() / "scenarios":
            return path.stem
        return os.path.relpath(path, self.directory)

    def _write(self, name: str, text: str) -> None:
        path = self.directory / name
        with report_write_errors(path), write_text_file(path) as file:
            file.write(text)


def to_document(result: TuneResult, problem: TuneProblem) -> dict[str, Any]:
    """Return the result as plain data for JSON."""
    config, comparison = result.tune.config, result.comparison
    document: dict[str, Any] = {
        "schema": 2,
        "study": config.study.name,
        "scenario": config.study.scenario,
        "metric": config.objective.metric,
        "aggregate": describe_aggregate(config.objective.aggregate),
        "seeds": list(config.study.seeds),
        "held_out_seeds": list(config.held_out_seeds),
        "saturate_above": result.saturation,
        "flights": result.flights,
        "stop_reason": result.stop_reason,
        "gains": {
            key: {"before": before, "after": after, "from": bounds.low, "to": bounds.high}
            for (key, bounds), before, after in zip(
                config.gains.items(), problem.before, result.best.gains, strict=True
            )
        },
        "cost": {"before": result.candidates[0].cost, "after": result.best.cost},
        "comparison": None,
    }
    if comparison is not None and result.held_out_costs is not None:
        mean, low, high = comparison.difference
        document["comparison"] = {
            "verdict": comparison.verdict,
            "better": comparison.better,
            "pairs": comparison.pairs,
            "seeds": comparison.seeds,
            "before": _finite(comparison.before),
            "after": _finite(comparison.after),
            "difference": {"mean": _finite(mean), "low": _finite(low), "high": _finite(high)},
            "failed_before": comparison.failed_before,
            "failed_after": comparison.failed_after,
            "cost": {"before": result.held_out_costs[0], "after": result.held_out_costs[1]},
        }
    return document


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value


def _cells(candidate: Candidate) -> list[str]:
    numbers = (candidate.cost, *candidate.gains, *candidate.costs)
    return [str(candidate.number), str(candidate.generation), *map(repr, numbers)]


def _csv_line(cells: Sequence[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(cells)
    return file.getvalue()
