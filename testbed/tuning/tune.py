"""Tune gains: search, then compare the best gains with the scenario's on held-out seeds.

The flights are runs of the tune's study with other gains. The files are all candidates, the best
gains, a scenario with them, and the result; each is complete at any time of the search.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.version import __version__
from testbed.logs.run_directory import write_run_file
from testbed.metrics.document import write_json
from testbed.metrics.side_effects import to_document as side_effects_document
from testbed.pool.flight_pool import Progress, Report
from testbed.scenario import (
    dump_middle_loop,
    find_scenario,
    library,
    load_scenario,
    middle_loop_gains,
)
from testbed.scenario.arguments import check_calls, check_path
from testbed.scenario.yaml_io import write
from testbed.tuning.tune_constraints import ConstraintResult
from testbed.tuning.tune_schema import GAINS, Tune
from testbed.tuning.tune_search import (
    Candidate,
    default_population,
    describe_aggregate,
    generation_count,
    search,
)
from testbed.tuning.tuning import HeldOutTest, Tuning

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
        held_out: test on held-out seeds; None if nothing better was found.
    """

    tune: Tune
    directory: Path
    candidates: Sequence[Candidate]
    best: Candidate
    saturation: float
    flights: int
    stop_reason: str
    held_out: HeldOutTest | None


class SearchLog:
    """Write the files of a running search, each complete at any time."""

    def __init__(self, tuning: Tuning, directory: Path) -> None:
        self._tuning = tuning
        self.directory = directory
        self._lines: list[str] = []  # of the candidates

    def start(self, first: Candidate) -> None:
        """Write the tune file, and the gains of the scenario as the first candidate."""
        tune = self._tuning.tune
        write_run_file(self.directory, TUNE_FILE, tune.study.text.encode())
        runs = [f"cost of run {run.number}" for run in self._tuning.runs]
        head = ["candidate", "generation", "cost", *tune.config.gains, *runs]
        for result in first.evaluation.constraints:
            at = f"at {result.constraint.bank_deg:g} deg"
            head += [f"{key} {at}" for key, _ in result.required()] + [f"shortfall {at}"]
        self._lines.append(_csv_line(head))
        self._write_candidates([first])

    def add(self, candidates: Sequence[Candidate], best: Candidate) -> None:
        """Append a generation, and write the best gains if they are in it."""
        self._write_candidates(candidates)
        if any(each is best for each in candidates):
            self._write_gains(best, NOT_COMPARED)

    def finish(self, result: TuneResult) -> None:
        """Write the result, and the verdict into the files of the gains."""
        if result.held_out is not None:
            self._write_gains(result.best, result.held_out.comparison.verdict)
        write_json(self.directory / RESULT, to_document(result, self._tuning))

    def _write_candidates(self, new: Sequence[Candidate]) -> None:
        """Write all candidates: lines that are appended can be cut by the end of the process."""
        self._lines += [_csv_line(_cells(each)) for each in new]
        self._write(CANDIDATES, "".join(self._lines))

    def _write_gains(self, best: Candidate, verdict: str) -> None:
        """Write the middle loop's gains, and a scenario that extends the tuned one."""
        tuning = self._tuning
        settings, scenario = tuning.tune.config.study, tuning.scenario_with(best.gains)
        objective = tuning.tune.config.objective
        comment = (
            f"# Tuned by testbed {__version__} for {objective.metric} of {settings.scenario}, "
            f"study {settings.name}:\n# {describe_aggregate(objective.aggregate)} over its flights "
            f"is {best.evaluation.objective:.4g} ({verdict}).\n"
        )
        for result in best.evaluation.constraints:
            comment += f"# {result.describe()}\n"
        changes: dict[str, Any] = {}
        others = [key for key in tuning.space.names if not key.startswith(GAINS)]
        if others:  # of the gains before, with which the new file must not be flown
            (self.directory / SCENARIO).unlink(missing_ok=True)
        if any(key.startswith(GAINS) for key in tuning.space.names):
            profile, airframe = scenario.controller.profile, scenario.fleet[0].aircraft
            gains = dump_middle_loop({profile: middle_loop_gains(scenario, airframe)})
            self._write(GAINS_FILE, f"{comment}\n{gains}")
            changes["controller"] = {"middle_loop": GAINS_FILE, "profile": profile}
            if load_scenario(self._scenario_path).controller.gains:  # the gains file has them too
                changes["controller"]["gains"] = None
        for key, value in tuning.changed_keys(best.gains).items():
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
        return find_scenario(self._tuning.runs[0].scenario)

    def _extends(self) -> str:
        path = self._scenario_path
        if path.parent == library() / "scenarios":
            return path.stem
        return os.path.relpath(path, self.directory)

    def _write(self, name: str, text: str) -> None:
        path = self.directory / name
        with report_write_errors(path), write_text_file(path) as file:
            file.write(text)


def to_document(result: TuneResult, tuning: Tuning) -> dict[str, Any]:
    """Return the result as plain data for JSON."""
    config = result.tune.config
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
                config.gains.items(), tuning.before, result.best.gains, strict=True
            )
        },
        "cost": {
            "before": result.candidates[0].evaluation.objective,
            "after": result.best.evaluation.objective,
        },
        "constraints": [
            {
                "bank_deg": before.constraint.bank_deg,
                "required": dict(before.required()),
                "before": _constraint_document(before),
                "after": _constraint_document(after),
            }
            for before, after in zip(
                result.candidates[0].evaluation.constraints,
                result.best.evaluation.constraints,
                strict=True,
            )
        ],
        "comparison": None,
    }
    if result.held_out is not None:
        comparison, costs = result.held_out.comparison, result.held_out.costs
        change = comparison.change
        document["comparison"] = {
            "verdict": comparison.verdict,
            "better": comparison.better,
            "pairs": comparison.pairs,
            "seeds": change.units,
            "one_flight": change.one_flight,
            "before": _finite(change.before),
            "after": _finite(change.after),
            "difference": {
                name: _finite(getattr(change, name)) for name in ("mean", "low", "high")
            },
            "failed_before": comparison.failed_before,
            "failed_after": comparison.failed_after,
            "cost": {"before": costs[0], "after": costs[1]},
            "worse": side_effects_document(result.held_out.side_effects),
            "margins": [
                {
                    "bank_deg": each.bank_deg,
                    "problem": each.problem,
                    "worse": side_effects_document(each.side_effects),
                }
                for each in result.held_out.margins
            ],
        }
    return document


def _constraint_document(result: ConstraintResult) -> dict[str, Any]:
    return {"met": not result.shortfall, "problem": result.problem, **result.measured}


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value


def _cells(candidate: Candidate) -> list[str]:
    evaluation = candidate.evaluation
    numbers = [evaluation.cost, *candidate.gains, *evaluation.costs]
    cells = [str(candidate.number), str(candidate.generation), *map(repr, numbers)]
    for result in evaluation.constraints:
        measured = [result.measured.get(key) for key, _ in result.required()]
        cells += ["" if each is None else repr(each) for each in measured]
        cells.append(repr(result.shortfall))
    return cells


def _csv_line(cells: Sequence[str]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(cells)
    return file.getvalue()


def describe_candidate(candidate: Candidate) -> str:
    """Return the objective as text, and by how much the constraints are missed."""
    evaluation = candidate.evaluation
    missed = f" (misses constraints by {evaluation.shortfall:.2g})" if evaluation.shortfall else ""
    return f"{evaluation.objective:.4g}{missed}"


def tune_gains(
    tuning: Tuning,
    out: Path,
    *,
    progress: Progress = lambda done, total: None,
    report: Report = lambda line: None,
) -> TuneResult:
    """Search gains, and compare the best with the scenario's on held-out seeds.

    The result does not depend on the number of processes, which end with the search. After each
    generation the files in `out` have everything found so far.

    Args:
        tuning: whose flights are used.
        out: an empty directory.
        progress: called with the number of finished flights and the largest possible number.
        report: called with a line for each generation.

    Raises:
        InputError: the metric is not a number of these flights, or `max_flights` is too small.
        KeyboardInterrupt: Ctrl-C or SIGTERM was received.
    """
    out = check_path("out", out)
    check_calls("progress", progress)
    check_calls("report", report)
    config = tuning.tune.config
    held_out = 2 * len(config.held_out_seeds) * len(tuning.without_seeds)
    most_flights = config.search.max_flights + held_out
    tuning.progress = lambda done, _: progress(done, most_flights)
    with tuning.session():
        return _search(tuning, SearchLog(tuning, out), report)


def _search(tuning: Tuning, log: SearchLog, report: Report) -> TuneResult:
    """Search, compare, and write the result."""
    settings = tuning.tune.config.search
    first = Candidate(0, 0, tuning.before, tuning.evaluations([tuning.before])[0])
    candidates, best = [first], first
    log.start(first)
    report(f"gains of the scenario: {describe_candidate(first)}")
    population = settings.population or default_population(len(tuning.space.names))
    generations = _generations(tuning, population)
    found_by_search = search(
        tuning.space, tuning.evaluations, settings=settings, generations=generations
    )
    for found in found_by_search:
        candidates += found
        cheapest = min(found, key=lambda candidate: candidate.cost)
        best = cheapest if cheapest.cost < best.cost else best
        log.add(found, best)
        report(
            f"generation {found[0].generation} of {generations}: "
            f"{describe_candidate(cheapest)}, best so far {describe_candidate(best)}"
        )
    last, flights = candidates[-1].generation, tuning.flights
    if last < generations:
        reason = f"converged after {last} generations"
    else:
        limit = settings.max_flights
        reason = f"{generations} generations of {population}, the limit of {limit} flights"
    result = TuneResult(
        tune=tuning.tune,
        directory=log.directory,
        candidates=candidates,
        best=best,
        saturation=tuning.saturation,
        flights=flights,
        stop_reason=reason,
        held_out=tuning.compare(best.gains) if best.number else None,
    )
    log.finish(result)
    return result


def _generations(tuning: Tuning, population: int) -> int:
    each, settings = len(tuning.runs), tuning.tune.config.search
    generations = generation_count(settings, population, each)
    if generations < 1:
        raise InputError(
            f"search.max_flights: {settings.max_flights} is too small for one generation "
            f"(write {each * (population + 1)} or more: {each} for each of {population} "
            "candidates, and for the gains of the scenario)"
        )
    return generations
