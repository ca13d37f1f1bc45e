"""A study flown: its runs apart from one another, its rows on disk as they come.

What the file holds depends on the study's page alone: not on how many processes fly, where, or how
often the study was interrupted.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.errors import InputError
from testbed.scenario import Scenario, dump
from testbed.scenario.messages import ScenarioError
from testbed.sim.world import versions
from testbed.study.checks import check
from testbed.study.cluster import notices
from testbed.study.crew import FLOWN, Crew, Flown, Task, crew
from testbed.study.golden_page import differences, digests, page_kept
from testbed.study.journal import Journal
from testbed.study.places import StudyFile, find_file
from testbed.study.plan import Plan, Study, load_study
from testbed.study.rows import OUTCOMES, Row, flatten
from testbed.study.table import make_facts, read_table, write_table

REFRESH_S = 30.0  # between two writings of the file while the study is flown, at least
SHARE = 0.02  # of the time that may go into them
_IDLE = ("name", "question", "metrics")  # what of a study's header moves no row

Progress = Callable[[int, int], None]
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Swept:
    """A study that has been flown.

    Args:
        study: its page.
        path: its file.
        flown: how many runs were flown for it now; the others had been before.
        outcomes: how many runs ended how.
    """

    study: Study
    path: Path
    flown: int
    outcomes: Mapping[str, int]

    @property
    def good(self) -> bool:
        """Whether all were flown to their end."""
        return all(not count for outcome, count in self.outcomes.items() if outcome != FLOWN)


def sweep(
    study: Study | str | Path,
    out: Path | None = None,
    *,
    jobs: int | None = None,
    resume: bool = False,
    backend: str = "joblib",
    scheduler: str | None = None,
    refresh_s: float = REFRESH_S,
    progress: Progress = lambda flown, of: None,
    tell: Tell = lambda text: None,
) -> Swept:
    """Fly a study into one Parquet file.

    Args:
        study: a study, or the name or path of its page.
        out: the file, ending in .parquet, or its directory; default logs/studies/<name>/<UTC>-<id>
            below the current directory.
        jobs: processes at once; default one for each processor.
        resume: go on with a study that was begun: fly only what is missing.
        backend: "joblib" is processes here, "dask" a cluster.
        scheduler: address of the cluster's.
        refresh_s: how often, at most, the file is written while the study is flown.
        progress: told how many runs are done, of how many.
        tell: told what else there is to say, a line at a time.

    Raises:
        InputError: the page, a place or an option cannot be used; or it was begun as another study.
        KeyboardInterrupt: Ctrl-C or SIGTERM; the file has what was flown.
    """
    study = study if isinstance(study, Study) else load_study(study)
    plan = Plan(study)
    began = time.monotonic()
    checked = check(plan)
    if checked.refused:
        tell(
            f"warning: {checked.refused} of {checked.points} points cannot be flown, as "
            f"{checked.example}"
        )
    begun = _begun(plan, checked.pages)
    tell(
        f"{len(plan):,} runs: {_times(len(plan.cases), 'case')}{_times(plan.points, 'point')}"
        f"{len(plan.seeds)} seeds; {checked.points:,} pages read in "
        f"{time.monotonic() - began:.1f} s"
    )
    if backend == "dask" and scheduler is not None:
        for line in notices(scheduler):
            tell(line)
    with crew(jobs=jobs, backend=backend, scheduler=scheduler) as ours:
        place = find_file(study.name, out, resume=resume)
        tell(f"file: {place.path}")
        if place.path.exists() and not place.journal.exists():
            return _complete(study, place, begun)
        new = not place.journal.exists()
        journal = Journal(place.journal, begun if new else None)
        try:
            if not new:
                _refuse_others(place, journal.begun, begun)
            pages = {case: dump(page) for case, page in checked.pages.items()}
            facts = make_facts(plan, pages, begun["versions"])
            facts["begun.json"] = json.dumps(begun, ensure_ascii=False)
            flown = _fly(
                plan, ours, journal, _Writer(place, plan, journal, facts, refresh_s), progress
            )
            outcomes = Counter(row.outcome for row in journal.rows())
            place.journal.unlink()  # while it is held: nobody goes on with what is complete
        finally:
            journal.close()
    return Swept(study, place.path, flown, _counted(outcomes))


class _Writer:
    """Writes the file anew now and then, and in the end."""

    def __init__(
        self,
        place: StudyFile,
        plan: Plan,
        journal: Journal,
        facts: Mapping[str, str],
        refresh_s: float,
    ) -> None:
        self._what = (place.path, plan, journal, facts)
        self._refresh_s = refresh_s
        self._next_s = 0.0

    def now(self) -> None:
        """Write it."""
        began = time.monotonic()
        write_table(*self._what)
        ended = time.monotonic()
        self._next_s = ended + max(self._refresh_s, (ended - began) / SHARE)

    def sometimes(self) -> None:
        """Write it, if the last time is long ago."""
        if time.monotonic() >= self._next_s:
            self.now()


def _fly(plan: Plan, ours: Crew, journal: Journal, writer: _Writer, progress: Progress) -> int:
    """Fly what is missing; the number of runs that were flown."""
    flown = 0
    try:
        writer.now()
        progress(len(journal), len(plan))
        for each in ours.fly(_tasks(plan, journal)):
            journal.add(_row(each, journal.begun["versions"]))
            flown += 1
            progress(len(journal), len(plan))
            writer.sometimes()
    finally:
        writer.now()
    return flown


def _tasks(plan: Plan, journal: Journal) -> Iterator[Task]:
    """The runs that are missing, each with its page or why it has none."""
    for number in range(len(plan)):
        if number not in journal:
            try:
                yield Task(number, plan.page(plan[number]))
            except ScenarioError as error:
                yield Task(number, f"cannot be flown: {error}")


def _row(flown: Flown, wanted: Mapping[str, str]) -> Row:
    """The row of a flight.

    Raises:
        InputError: what flew it is of other versions than what the study was begun with.
    """
    if flown.metrics is None:
        return Row(flown.number, flown.outcome, flown.error, {})
    other = differences(wanted, flown.metrics["versions"])
    if other:
        raise InputError(
            f"run {flown.number} was flown by a worker of other versions: {'; '.join(other)}; give "
            "all workers the same"
        )
    return Row(flown.number, flown.outcome, flown.error, flatten(flown.metrics))


def _begun(plan: Plan, pages: Mapping[str, Scenario]) -> dict[str, Any]:
    """What decides the rows of a study: when it is resumed, it has to be as it was."""
    page = plan.study.page.model_dump(mode="json", by_alias=True, exclude_none=True)
    page["study"] = {key: value for key, value in page["study"].items() if key not in _IDLE}
    folder = plan.study.path.resolve().parent
    files: dict[str, str] = {}
    for each in pages.values():
        files |= digests(each)
    begun = {
        "page": page,
        "scenarios": {case: page_kept(each, folder) for case, each in pages.items()},
        "files": files,
        "versions": versions(),
    }
    plain: dict[str, Any] = json.loads(json.dumps(begun))
    return plain


def _refuse_others(place: StudyFile, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to go on with what was begun as another study.

    Raises:
        InputError: saying what differs.
    """
    words = {
        "page": "the study's page",
        "scenarios": "a scenario",
        "files": "a file that a scenario names",
        "versions": "versions",
    }
    for part, what in words.items():
        other = differences(then.get(part, {}), now[part])
        if other:
            more = f"; and {len(other) - 3} more" if len(other) > 3 else ""
            raise InputError(
                f"{place.path}: was begun with {what} other than now: {'; '.join(other[:3])}{more} "
                "(put it back, or begin anew without --resume)"
            )


def _complete(study: Study, place: StudyFile, begun: Mapping[str, Any]) -> Swept:
    """A study that has been flown before.

    Raises:
        InputError: it is another, or its journal is gone.
    """
    table = read_table(place.path, ["outcome"])
    _refuse_others(place, json.loads(table.facts["begun.json"]), begun)
    if not table.complete:
        raise InputError(
            f"{place.path}: is not complete, and its journal {place.journal} is gone: begin anew "
            "without --resume"
        )
    return Swept(study, place.path, 0, _counted(Counter(table.columns["outcome"].tolist())))


def _counted(outcomes: Mapping[str, int]) -> dict[str, int]:
    return {outcome: outcomes.get(outcome, 0) for outcome in OUTCOMES}


def _times(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count > 1 else ''} × " if count > 1 else ""
