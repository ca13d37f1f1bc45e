"""The command that writes a report of a study: study-report."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import JsonFile, output_option, value_option
from testbed.cli.output import (
    check_output_folder,
    result_console,
    write_json_output,
)
from testbed.cli.report import (
    FigureFormat,
    Figures,
    ReportFile,
    check_figures,
    default_report,
    figure_format,
    write_figures,
    write_latex,
    write_report,
)
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.reports.study import StudyData, StudyFlights
    from testbed.reports.study.report_table import Cell
    from testbed.studies.study_schema import StudyConfig
    from testbed.studies.table import StudyTable


@draws_figures("figures")
def study_report_command(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A file written by `testbed sweep`, its directory, or a study's name for the "
            "latest.",
        ),
    ],
    out: ReportFile = None,
    metric: Annotated[
        list[str] | None,
        value_option(
            "NAME",
            "Report this number of metrics.json, e.g. windows.circles.mean_rms_m; may be "
            "repeated.  \\[default: the metrics that the study names]",
        ),
    ] = None,
    statistic: Annotated[str, value_option("median|mean", "Statistic over the seeds.")] = "median",
    figures: Figures = None,
    format: FigureFormat = None,
    latex: Annotated[
        Path | None,
        output_option(
            metavar="FILE.tex",
            help="Also write the metrics by case and point as a LaTeX table; not of a map.",
            suffixes=(".tex",),
        ),
    ] = None,
    tables: Annotated[
        Path | None,
        value_option(
            "DIR", "Also write every table as CSV to this folder.", check=check_output_folder
        ),
    ] = None,
    margins: Annotated[
        bool,
        typer.Option(
            "--margins",
            help="Also predict the margins of each case in straight flight, at its first point.",
        ),
    ] = False,
    json: JsonFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Write a report of a study: results, effects, what got worse, losses, commands to repeat."""
    from testbed.logs.file_record import check_folder_output, record_folder_output
    from testbed.reports.study import (
        study_figures,
        study_page,
        study_tables,
        table_file,
        write_tables,
    )
    from testbed.reports.study.page import print_summary
    from testbed.reports.study.study_data import STATISTICS

    ending = figure_format(format, figures)
    if statistic not in STATISTICS:
        raise InputError(f"--statistic {statistic}: write one of {', '.join(STATISTICS)}")
    path = find_study_file(study)
    report = default_report(path) if out is None else out
    data = read_study(path, metrics=metric or (), statistic=statistic)
    if margins:
        data = _with_margins(data, path)
    drawn = list(study_figures(data)) if figures else []
    check_figures(drawn, figures, ending, look)
    listed = list(study_tables(data)) if tables else []
    if tables:
        check_folder_output(tables, map(table_file, listed), f"--tables {tables}")
    table = _latex(data, latex)
    page = study_page(data)
    write_json_output(json, _document(data))
    console = result_console(json)
    print_summary(data, console)
    write_report(page, report, console, default=out is None)
    if figures:
        write_figures(drawn, figures, ending, console, look)
    if latex:
        write_latex(table, latex, console)
    if tables:
        with report_write_errors(f"--tables {tables}"):
            files = write_tables(listed, tables)
        record_folder_output(tables, [each.name for each in files])
        console.write_line(f" tables   {len(files)} in {tables}")


def _with_margins(study: StudyData, path: Path) -> StudyData:
    """Predict the margins of the cases.

    Raises:
        InputError: the study has no cases, or this version cannot read their scenarios.
    """
    from testbed.pool.flight_pool import open_flight_pool
    from testbed.scenario import loads
    from testbed.studies.margin_changes import predict_changes
    from testbed.studies.table import read_table

    cases = study.flights.cases
    if len(cases) < 2 or study.is_map:
        kind = "is a map" if study.is_map else "has none"
        raise InputError(f"--margins: is for cases of a study, and this one {kind} (leave it out)")
    texts = read_table(path, ()).metadata
    scenarios = [
        loads(texts.get(f"scenario.{case}.yaml", ""), source=f"--margins: case {case}")
        for case in cases
    ]
    with open_flight_pool() as pool:
        changes = dict(zip(cases[1:], predict_changes(scenarios, pool), strict=True))
    return replace(
        study,
        margins={case: each.side_effects for case, each in changes.items()},
        unpredicted={case: each.problem for case, each in changes.items() if each.problem},
    )


def _latex(study: StudyData, path: Path | None) -> str:
    """Return the table of --latex; "" without it.

    Raises:
        InputError: the study is a map, which has none.
    """
    from testbed.reports.study import latex_table

    if path is None:
        return ""
    try:
        return latex_table(study)
    except InputError as error:
        raise InputError(f"--latex {path}: {error}") from None


def find_study_file(name: str) -> Path:
    """Find a study's file by path, directory, or name (the latest).

    Raises:
        InputError: there is no such study.
    """
    from testbed.studies.table import FILE, STUDIES

    path = Path(name)
    if os.path.isfile(path):
        return path
    if os.path.isfile(path / FILE):
        return path / FILE
    for folder in (path, STUDIES / path):
        files = sorted(folder.glob(f"*/{FILE}")) if os.path.isdir(folder) else []
        if files:
            return files[-1]
    known = sorted({each.parent.parent.name for each in STUDIES.glob(f"*/*/{FILE}")})
    hint = f"studies named {', '.join(known)}" if known else "no studies yet"
    raise InputError(
        f"{name}: neither a study's file, nor a directory with a {FILE}, nor a study run from "
        f"here ({STUDIES} has {hint})"
    )


def read_study(path: Path, *, metrics: Sequence[str], statistic: str) -> StudyData:
    """Read a study's file for the report.

    Args:
        path: the file.
        metrics: names to report; none: those the study names, or the mean RMS error of the last
            window.
        statistic: a key of `STATISTICS`.

    A metric that the study names and no run has is left out, and is in `missing`.

    Raises:
        InputError: this is not a study's file, it has no runs, or none has a metric of `metrics`.
    """
    from testbed.reports.study import StudyData
    from testbed.studies.table import read_table

    table = read_table(path)
    if not len(table.columns["run"]):
        raise InputError(f"{path}: no run has ended yet, so there is nothing to report")
    config = _study_config(table)
    flights = _flights(table, config)
    commands = dict(zip(flights.run.tolist(), table.columns["command"].tolist(), strict=True))
    head = config.study if config else None
    of_study = head.shown_metrics if head else ()
    selected, missing = _select_metrics(path, flights, metrics, of_study)
    return StudyData(
        name=table.metadata.get("study.name", path.stem),
        file=path.name,
        question=head.question if head else "",
        scenario=_scenario_names(config),
        design=(head.design or "factorial") if head and config and config.vary else "",
        metrics=selected,
        missing=missing,
        statistic=statistic,
        flights=flights,
        planned=table.planned,
        uneven=head is not None and head.until is not None,
        versions={key: str(value) for key, value in table.json("versions.json").items()},
        files={name: table.metadata.get(name, "") for name in ("study.yaml", "scenario.yaml")},
        command=lambda run: str(commands[run]),
        refined_metric=head.refine.metric if head and head.refine else "",
        contour=head.refine.contour if head and head.refine else None,
        repeat="testbed sweep study.yaml",
    )


def _study_config(table: StudyTable) -> StudyConfig | None:
    """Read the study's YAML; None if this version cannot read it."""
    from testbed.scenario.problems import ScenarioError
    from testbed.scenario.validate import validate
    from testbed.scenario.yaml_io import parse
    from testbed.studies.study_schema import StudyConfig

    try:
        return validate(parse(table.metadata["study.yaml"], "study.yaml", Path.cwd()), StudyConfig)
    except (ScenarioError, KeyError):
        return None


def _scenario_names(config: StudyConfig | None) -> str:
    if config is None:
        return "its scenario"
    of_cases = [str(case["scenario"]) for case in config.cases.values() if "scenario" in case]
    own = [config.study.scenario] if len(of_cases) < max(len(config.cases), 1) else []
    return ", ".join(dict.fromkeys((*own, *of_cases)))


def _flights(table: StudyTable, config: StudyConfig | None) -> StudyFlights:
    import numpy as np

    from testbed.pool.flight_task import COMPLETED
    from testbed.reports.study import StudyFlights
    from testbed.studies.journal import METRICS, SET

    columns = table.columns
    outcome = [str(each) for each in columns["outcome"].tolist()]
    return StudyFlights(
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
        completed=np.array([each == COMPLETED for each in outcome], dtype=np.bool_),
        case_label=config.case_labels if config else {},
        key_label=config.key_labels if config else {},
    )


def _select_metrics(
    path: Path, flights: StudyFlights, requested: Sequence[str], of_study: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the metrics to report, and those of the study that no run has.

    Raises:
        InputError: no run has a requested one.
    """
    from testbed.studies.journal import default_metric
    from testbed.studies.plan_check import describe_unknown

    known = tuple(flights.metrics)
    for name in requested:
        if name not in known:
            raise InputError(f"{path}: --metric: {describe_unknown(name, known)}")
    names = tuple(dict.fromkeys(requested or of_study))
    missing = tuple(name for name in names if name not in known)
    found = tuple(name for name in names if name in known)
    return found or default_metric(known) or known[:1], missing


def _document(study: StudyData) -> dict[str, Any]:
    """Convert all tables to JSON values."""
    from testbed.reports.study import study_tables

    return {
        "schema": 3,
        "study": study.name,
        "runs": study.flights.run.size,
        "planned": study.planned,
        "statistic": study.statistic,
        "missing_metrics": list(study.missing),
        "tables": {
            table.name: [
                {
                    heading: _json_value(cell)
                    for heading, cell in zip(table.columns, row, strict=True)
                }
                for row in table.rows
            ]
            for table in study_tables(study)
        },
    }


def _json_value(cell: Cell) -> Any:  # noqa: ANN401 - a number, a text or a map
    from testbed.reports.study.study_data import IntervalEstimate

    if isinstance(cell, IntervalEstimate):
        numbers = {"value": cell.value, "low": cell.low, "high": cell.high}
        return {name: _json_value(value) for name, value in numbers.items()} | {"count": cell.count}
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
