"""What `testbed study-report` reads, writes and says."""

from __future__ import annotations

import json as jsonlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from testbed.errors import InputError
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.report.study import Rows, Study, write_figures, write_page, write_tables
from testbed.report.study.grid import Cell
from testbed.report.study.numbers import STATISTICS, Estimate
from testbed.report.study.page import grids_of, summary
from testbed.report_outputs import NAME, figure_ending, writing
from testbed.scenario.messages import ScenarioError, did_you_mean
from testbed.scenario.yaml_door import parse, validated
from testbed.study.crew import FLOWN
from testbed.study.page import StudyPage
from testbed.study.places import FILE, STUDIES
from testbed.study.rows import METRICS, SET, last_error
from testbed.study.table import StudyTable, read_table


def report_study(
    name: str,
    *,
    out: Path | None = None,
    figures: Path | None = None,
    ending: str | None = None,
    tables: Path | None = None,
    json: Path | None = None,
    metrics: Sequence[str] = (),
    statistic: str | None = None,
) -> None:
    """Read a study's file, write its page and what else was asked for, and say what came out.

    Raises:
        InputError: there is no such study, an option cannot be used, or a file not be written.
    """
    ending = figure_ending(out=out, figures=figures, ending=ending)
    refuse_files(json=json)
    statistic = statistic or next(iter(STATISTICS))
    if statistic not in STATISTICS:
        raise InputError(f"--statistic {statistic}: write one of {', '.join(STATISTICS)}")
    path = find_table(name)
    study = read_study(path, metrics=metrics, statistic=statistic)
    page = out or path.with_name(NAME)
    with writing(page):
        write_page(study, page)
        drawn = write_figures(study, figures, ending) if figures else []
        written = write_tables(study, tables) if tables else []
    console = Console(stderr=is_stdout(json), highlight=False)
    summary(study, console)
    console.print(f" page     {page}", soft_wrap=True)
    if figures:
        console.print(f" figures  {len(drawn)} in {figures}", soft_wrap=True)
    if tables:
        console.print(f" tables   {len(written)} in {tables}", soft_wrap=True)
    put_json(json, document(study))


def find_table(name: str) -> Path:
    """A study's file, named by itself, its directory, or the study's name for the latest.

    Raises:
        InputError: there is no such study.
    """
    path = Path(name)
    if path.is_file():
        return path
    if (path / FILE).is_file():
        return path / FILE
    for folder in (path, STUDIES / path):
        begun = sorted(folder.glob(f"*/{FILE}"))
        if begun:
            return begun[-1]
    known = sorted({each.parent.parent.name for each in STUDIES.glob(f"*/*/{FILE}")})
    hint = f"studies of: {', '.join(known)}" if known else "no studies yet"
    raise InputError(
        f"{name}: neither a study's file, nor a directory with a {FILE}, nor a study flown from "
        f"here ({STUDIES} has {hint})"
    )


def read_study(path: Path, *, metrics: Sequence[str], statistic: str) -> Study:
    """A study as the report takes it.

    Args:
        path: its file.
        metrics: to be shown; none: those of its page, or the mean RMS error of the last portion.
        statistic: a key of `STATISTICS`.

    Raises:
        InputError: the file is none of a study, is empty, or has no such metric.
    """
    table = read_table(path)
    if not len(table.columns["run"]):
        raise InputError(f"{path}: no run has ended yet, so that there is nothing to report")
    page = _page(table)
    rows = _rows(table)
    commands = dict(zip(rows.run.tolist(), table.columns["command"].tolist(), strict=True))
    head = page.study if page else None
    return Study(
        name=table.facts.get("study.name", path.stem),
        file=path.name,
        question=head.question if head else "",
        scenario=_flown(page),
        design=(head.design or "") if head else "",
        metrics=_metrics(rows, metrics, head.metrics if head else ()),
        statistic=statistic,
        rows=rows,
        planned=int(table.facts.get("runs", rows.run.size)),
        versions=jsonlib.loads(table.facts.get("versions.json", "{}")),
        pages={name: table.facts.get(name, "") for name in ("study.yaml", "scenario.yaml")},
        command=lambda run: str(commands[run]),
        repeat="testbed sweep study.yaml",
    )


def _page(table: StudyTable) -> StudyPage | None:
    try:
        return validated(parse(table.facts["study.yaml"], "study.yaml", Path.cwd()), StudyPage)
    except (ScenarioError, KeyError):  # of another version
        return None


def _flown(page: StudyPage | None) -> str:
    if page is None:
        return "its scenario"
    named = [str(case["scenario"]) for case in page.cases.values() if "scenario" in case]
    own = [page.study.scenario] if len(named) < max(len(page.cases), 1) else []
    return ", ".join(dict.fromkeys((*own, *named)))


def _rows(table: StudyTable) -> Rows:
    columns = table.columns
    outcome = [str(each) for each in columns["outcome"].tolist()]
    return Rows(
        run=columns["run"].astype(np.int64),
        case=[str(each) for each in columns["case"].tolist()],
        seed=columns["seed"].astype(np.int64),
        outcome=outcome,
        error=[str(each or "") for each in columns["error"].tolist()],
        settings={
            name.removeprefix(SET): values.tolist()
            for name, values in columns.items()
            if name.startswith(SET)
        },
        metrics={
            name.removeprefix(METRICS): values.astype(np.float64)
            for name, values in columns.items()
            if name.startswith(METRICS)
        },
        good=np.array([each == FLOWN for each in outcome], dtype=np.bool_),
    )


def _metrics(rows: Rows, asked: Sequence[str], of_page: Sequence[str]) -> tuple[str, ...]:
    wanted = tuple(dict.fromkeys(asked or of_page))
    if not wanted:
        return last_error(rows.metrics) or tuple(rows.metrics)[:1]
    for name in wanted:
        if name not in rows.metrics:
            near = did_you_mean(name, rows.metrics)
            known = [each for each in rows.metrics if each.startswith("portions.")][:6]
            raise InputError(
                f"{name}: is no number of this study{near} (write for example "
                f"{', '.join(known or list(rows.metrics)[:6])})"
            )
    return wanted


def document(study: Study) -> dict[str, Any]:
    """All tables as JSON has them."""
    return {
        "schema": 1,
        "study": study.name,
        "runs": study.rows.run.size,
        "planned": study.planned,
        "statistic": study.statistic,
        "tables": {
            grid.name: [
                {
                    heading or "verdict": _plain(cell)
                    for heading, cell in zip(grid.columns, row, strict=True)
                }
                for row in grid.rows
            ]
            for grid in grids_of(study)
        },
    }


def _plain(cell: Cell) -> Any:  # noqa: ANN401 - what JSON has
    if isinstance(cell, Estimate):
        numbers = {"value": cell.value, "low": cell.low, "high": cell.high}
        return {name: _plain(value) for name, value in numbers.items()} | {"count": cell.count}
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
