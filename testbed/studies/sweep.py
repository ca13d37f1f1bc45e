"""Fly a study: its runs in worker processes, its rows on disk as they finish.

The content of the result file depends on the study file only: not on the number of processes,
their place, or how often the study was interrupted.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.metrics.document import initial_warnings
from testbed.metrics.expectations import bound_key, violations
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.plan.scenario_files import file_digests
from testbed.plan.world import versions
from testbed.pool.dask_workers import cluster_notices
from testbed.pool.flight_code import flight_code
from testbed.pool.flight_pool import FlightPool, Progress, Report, open_flight_pool
from testbed.pool.flight_task import COMPLETED, OUTCOMES, FlightResult, FlightTask
from testbed.pool.scenario_snapshot import differences, snapshot
from testbed.runs.bounds import violation_lines
from testbed.scenario import Scenario, dump, set_seed
from testbed.scenario.arguments import (
    check_calls,
    check_count,
    check_not_negative,
    check_path,
)
from testbed.scenario.problems import ScenarioError
from testbed.studies.journal import Journal, JournalRow
from testbed.studies.plan import Plan, Study, load_study
from testbed.studies.plan_check import CheckedPlan, check_plan
from testbed.studies.predicted_numbers import predict_numbers
from testbed.studies.run_choice import RunChoice, choose_runs
from testbed.studies.table import (
    StudyOutput,
    find_output,
    make_metadata,
    read_table,
    write_table,
)

REFRESH_S = 30.0  # between two writes of the result file while runs are flown, at least
MAX_WRITE_SHARE = 0.02  # of the time, for these writes
MAX_WARNINGS = 6  # kinds of warnings from before a flight that are reported
_LEFT_OUT = ("name", "question", "metrics")  # settings that change no row


@dataclass(frozen=True, slots=True)
class SweepResult:
    """Result of a study.

    Args:
        study: its file.
        path: of the result file.
        new_runs: number of runs that this call has added; the others were in the file.
        outcomes: number of runs by outcome.
        unexpected: number of completed runs with a number outside the scenario's bounds.
    """

    study: Study
    path: Path
    new_runs: int
    outcomes: Mapping[str, int]
    unexpected: int = 0

    @property
    def completed(self) -> bool:
        """Return whether all runs were completed."""
        return all(not count for outcome, count in self.outcomes.items() if outcome != COMPLETED)


def sweep(
    study: Study | str | Path,
    out: str | os.PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    resume: bool = False,
    backend: str = "joblib",
    scheduler: str | None = None,
    refresh_s: float = REFRESH_S,
    progress: Progress = lambda done, total: None,
    report: Report = lambda text: None,
) -> SweepResult:
    """Fly a study into one Parquet file.

    Args:
        study: a study, or the name or path of its file.
        out: the result file, ending in .parquet, or its directory; default
            logs/studies/<name>/<UTC>-<id> below the current directory.
        jobs: processes at once; default one for each processor.
        resume: continue a study: fly only the missing runs.
        backend: "joblib" for processes on this machine, "dask" for a cluster.
        scheduler: address of the cluster's scheduler.
        refresh_s: shortest time between two writes of the result file while runs are flown.
        progress: called with the number of finished runs and of all.
        report: called with each message, of one line.

    Raises:
        InputError: the study, a path or an option cannot be used; or the inputs changed since the
            study was started.
        KeyboardInterrupt: Ctrl-C or SIGTERM; the file has the finished runs.
    """
    out = None if out is None else check_path("out", out)
    if jobs is not None:
        check_count("jobs", jobs)
    check_not_negative("refresh_s", refresh_s)
    check_calls("progress", progress)
    check_calls("report", report)
    study = study if isinstance(study, Study) else load_study(check_path("study", study))
    plan = Plan(study)
    start = time.monotonic()
    checked = check_plan(plan)
    if checked.invalid:
        report(
            f"warning: {checked.invalid} of {checked.checked} points are invalid, such as "
            f"{checked.example}"
        )
    for line in checked.without_effect:
        report(f"warning: in some flights, {line}")
    if unreached := plan.unreached_metrics():
        report(f"warning: {unreached}")
    for line in plan.unchecked_bounds():
        report(f"warning: {line}")
    inputs = _make_inputs(plan, checked)
    report(
        f"{_describe_plan(plan)}; {_count(checked.checked, 'scenario')} read in "
        f"{time.monotonic() - start:.1f} s"
    )
    if backend == "dask" and scheduler is not None:
        for line in cluster_notices(scheduler):
            report(line)
    with open_flight_pool(jobs=jobs, backend=backend, scheduler=scheduler, report=report) as pool:
        output = find_output(study.name, None if out is None else Path(out), resume=resume)
        report(f"file: {output.path}")
        if output.path.exists() and not output.journal.exists():
            return _completed(study, output, inputs)
        new = not output.journal.exists()
        journal = Journal(output.journal, inputs if new else None)
        try:
            if not new:
                _refuse_changed_inputs(output, journal.inputs, inputs)
                journal.refuse_other_runs(len(plan))
            texts = {case: dump(scenario) for case, scenario in checked.scenarios.items()}
            metadata = make_metadata(plan, texts, inputs["versions"])
            metadata["inputs.json"] = json.dumps(inputs, ensure_ascii=False)
            choice = choose_runs(plan)
            for row in journal.rows():
                choice.add(row)
            writer = _TableWriter(output, plan, journal, choice, metadata, refresh_s)
            new_runs = _fly(plan, pool, journal, choice, writer, progress, report)
            for line in _changed_files(checked, inputs):
                report(f"warning: {line}")
            outcomes, unexpected = _count_outcomes(
                (row.outcome, row.error) for row in journal.rows(choice.needs)
            )
            output.journal.unlink()  # while it is locked, so that nothing else resumes it
        finally:
            journal.close()
    return SweepResult(study, output.path, new_runs, outcomes, unexpected)


class _TableWriter:
    """Writes the result file from time to time, and at the end."""

    def __init__(
        self,
        output: StudyOutput,
        plan: Plan,
        journal: Journal,
        choice: RunChoice,
        metadata: Mapping[str, str],
        refresh_s: float,
    ) -> None:
        self._arguments = (output.path, plan, journal, choice, metadata)
        self._refresh_s = refresh_s
        self._next_s = 0.0

    def write(self) -> None:
        """Write the file."""
        start = time.monotonic()
        write_table(*self._arguments)
        end = time.monotonic()
        self._next_s = end + max(self._refresh_s, (end - start) / MAX_WRITE_SHARE)

    def write_if_due(self) -> None:
        """Write the file if the last write was long enough ago."""
        if time.monotonic() >= self._next_s:
            self.write()


def _fly(
    plan: Plan,
    pool: FlightPool,
    journal: Journal,
    choice: RunChoice,
    writer: _TableWriter,
    progress: Progress,
    report: Report,
) -> int:
    """Fly the missing runs, return their number; report each kind of warning and bound once.

    Where no seed changes a point, the row of its first flight is also that of its other seeds.
    A flight that is not needed when it ends is dropped.
    """
    before = choice.done
    points: set[int] = set()  # that no seed changes
    copies = copied = 0
    warnings = _Warnings(plan, report)
    try:
        writer.write()
        progress(choice.done, choice.total)
        while open_points := choice.open_points():
            if text := choice.round_text:
                report(text)
            for result in pool.run_groups(_missing_points(plan, journal, choice, open_points)):
                runs: Sequence[int] = [result.number]
                if not result.depends_on_seed:
                    runs = plan.seeds_of_point(result.number)
                    points.add(runs[0])
                row = _to_row(result, journal.inputs["versions"])
                added = 0
                for number in runs:
                    # not a copy, made while it was flown, nor one that is not needed any more
                    if number not in journal and choice.needs(number):
                        own = replace(row, run=number)
                        journal.add(own)
                        choice.add(own)
                        added += 1
                        progress(choice.done, choice.total)
                        writer.write_if_due()
                if added:
                    warnings.report(result)
                    copied, copies = copied + (added > 1), copies + added - 1
        if copies:
            report(
                f"no seed changes {_count(copied, 'point')}: {_count(copies, 'run')} with the "
                "numbers of a flown one"
            )
        elif points and plan.study.config.study.until:
            report(f"no seed changes {_count(len(points), 'point')}: one run each")
        if flown := _count_equal_points(plan, journal, choice) - copied:
            report(
                f"all seeds of {_count(flown, 'further point')} were flown, and gave the same "
                "numbers (write fewer seeds)"
            )
    finally:
        writer.write()
    return choice.done - before


def _count_equal_points(plan: Plan, journal: Journal, choice: RunChoice) -> int:
    """Count the points of several completed runs whose numbers are equal to the bit."""
    points, seeds = 0, len(plan.seeds)
    if seeds == 1:
        return 0
    for _, rows in itertools.groupby(journal.rows(choice.needs), lambda row: row.run // seeds):
        first, *others = rows
        numbers = (COMPLETED, first.metrics)
        equal = all((each.outcome, each.metrics) == numbers for each in (first, *others))
        points += equal and bool(others)
    return points


class _Warnings:
    """Reports each kind of warning from before a flight, and each violated bound, once."""

    def __init__(self, plan: Plan, report: Report) -> None:
        self._plan, self._report = plan, report
        self._kinds: set[str] = set()
        self._bounds: set[str] = set()

    def report(self, result: FlightResult) -> None:
        """Report what is new of a flight."""
        for text in initial_warnings(result.metrics or {}):
            kind = re.sub(r"[\d.]+", "#", text)
            if kind not in self._kinds and len(self._kinds) < MAX_WARNINGS:
                self._report(f"warning: run {result.number}: {text}")
            self._kinds.add(kind)
        violated = violations(result.metrics or {})
        first = {bound_key(each): each for each in reversed(violated)}
        new = {key: each for key, each in first.items() if key not in self._bounds}
        run = self._plan[result.number]
        for line in violation_lines(list(new.values()), run.scenario, run.overrides):
            self._report(f"warning: run {result.number}: {line}")
        self._bounds |= set(new)


def _missing_points(
    plan: Plan, journal: Journal, choice: RunChoice, points: Iterable[int]
) -> Iterator[Iterator[FlightTask]]:
    """Yield for each point the tasks of the runs that the journal does not have."""
    for point in points:
        yield _missing_tasks(plan, journal, choice, plan.seeds_of_point(point * len(plan.seeds)))


def _missing_tasks(
    plan: Plan, journal: Journal, choice: RunChoice, runs: Iterable[int]
) -> Iterator[FlightTask]:
    """Yield the tasks of those runs of a point that are needed, and not in the journal."""
    scenario: Scenario | None = None
    bank_deg = plan.margins_at_deg
    measure = None if bank_deg is None else partial(predict_numbers, bank_deg)
    for number in runs:
        if not choice.needs(number):  # nor those of further seeds
            return
        if number not in journal:
            try:
                # read once: several points are flown at the same time
                scenario = scenario or plan.scenario(plan[number])
                yield FlightTask(number, set_seed(scenario, plan[number].seed), measure=measure)
            except ScenarioError as error:
                yield FlightTask(number, None, f"invalid: {error}")


def _describe_plan(plan: Plan) -> str:
    """Return the number of runs, and of what it is the product."""
    factors = [(len(plan.cases), "case"), (plan.point_count, "point"), (len(plan.seeds), "seed")]
    product = " × ".join(_count(*each) for each in factors if each[0] > 1 or each[1] == "seed")
    most = "at most " if plan.study.config.study.chooses_runs else ""
    return f"{most}{_count(len(plan), 'run')}: {product}"


def _to_row(result: FlightResult, expected: Mapping[str, str]) -> JournalRow:
    """Return the row of a flight.

    Raises:
        InputError: its worker has other versions than the study was started with.
    """
    any_seed = not result.depends_on_seed
    if result.metrics is None:
        return JournalRow(result.number, result.outcome, result.error, {}, any_seed)
    different = differences(expected, result.metrics["versions"])
    if different:
        raise InputError(
            f"run {result.number} was flown by a worker of other versions: {'; '.join(different)} "
            "(install the same versions for all workers)"
        )
    numbers = flatten_metrics(result.metrics)
    return JournalRow(result.number, result.outcome, result.error, numbers, any_seed)


def _make_inputs(plan: Plan, checked: CheckedPlan) -> dict[str, Any]:
    """Return the inputs of a study, which may not change before a resume."""
    config = plan.study.config.model_dump(mode="json", by_alias=True, exclude_none=True)
    config["study"] = {key: v for key, v in config["study"].items() if key not in _LEFT_OUT}
    folder = plan.study.path.resolve().parent
    scenarios = checked.scenarios
    predictions = plan.margins_at_deg is not None
    inputs = {
        "study": config,
        "scenarios": {case: snapshot(scenario, folder) for case, scenario in scenarios.items()},
        "expect": {case: scenario.expect.model_dump() for case, scenario in scenarios.items()},
        "files": file_digests(checked.referents),
        "versions": versions(),
        "code": {"testbed": flight_code(predictions=predictions)},
    }
    plain: dict[str, Any] = json.loads(json.dumps(inputs))
    return plain


def _refuse_changed_inputs(
    output: StudyOutput, old: Mapping[str, Any], new: Mapping[str, Any]
) -> None:
    """Refuse to resume a study whose inputs changed.

    Raises:
        InputError: saying what changed.
    """
    titles = {
        "study": "the study file",
        "scenarios": "a scenario",
        "expect": "a bound of a scenario",
        "files": "a file of a scenario",
        "versions": "the versions",
        "code": "the code",
    }
    for part, title in titles.items():
        changed = differences(old.get(part, {}), new[part])
        if changed:
            more = f"; and {len(changed) - 3} more" if len(changed) > 3 else ""
            raise InputError(
                f"{output.path}: {title} changed since the study was started: "
                f"{'; '.join(changed[:3])}{more} (undo the change, or start again without --resume)"
            )


def _changed_files(checked: CheckedPlan, inputs: Mapping[str, Any]) -> Iterator[str]:
    """Describe the files that have changed while the study was flown."""
    try:
        changed = differences(inputs["files"], file_digests(checked.referents))
    except InputError as error:
        changed = (str(error),)
    for each in changed:
        yield (
            f"a file of a scenario changed while the study was flown: {each}; rows may be of "
            "either (start again without --resume)"
        )


def _completed(study: Study, output: StudyOutput, inputs: Mapping[str, Any]) -> SweepResult:
    """Return the result of a study that was complete before.

    Raises:
        InputError: its inputs changed, or it is incomplete and its journal is missing.
    """
    table = read_table(output.path, ["outcome", "error"])
    _refuse_changed_inputs(output, table.json("inputs.json"), inputs)
    if not table.complete:
        raise InputError(
            f"{output.path}: is incomplete, and its journal {output.journal} is missing (start "
            "again without --resume)"
        )
    rows = zip(table.columns["outcome"].tolist(), table.columns["error"].tolist(), strict=True)
    return SweepResult(study, output.path, 0, *_count_outcomes(rows))


def _count_outcomes(rows: Iterable[tuple[str, str]]) -> tuple[dict[str, int], int]:
    """Count rows by outcome, and the completed ones with an error."""
    counts: Counter[str] = Counter()
    unexpected = 0
    for outcome, error in rows:
        counts[outcome] += 1
        unexpected += outcome == COMPLETED and bool(error)
    return {outcome: counts.get(outcome, 0) for outcome in OUTCOMES}, unexpected


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
