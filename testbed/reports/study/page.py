"""The report of a study: its page, and its summary on the terminal."""

from __future__ import annotations

from html import escape

from rich.console import Console
from rich.padding import Padding

from testbed.core.version import __version__
from testbed.metrics.summary import count_out_of_slot
from testbed.reports.html import (
    Page,
    PageSection,
    cards_html,
    figure_html,
    file_html,
    rows_to_html,
    text_table_to_html,
    to_html,
)
from testbed.reports.study import tables
from testbed.reports.study.figures import study_figures
from testbed.reports.study.report_table import ReportTable, format_cell, format_number
from testbed.reports.study.study_data import StudyData, metric_words

MAX_CARDS = 6  # in the head: metrics, or cases and laws


def study_page(study: StudyData) -> Page:
    """Make the page of a study."""
    boundary, effects, cases, worse = (
        make(study) for make in (tables.boundary, tables.effects, tables.cases, tables.side_effects)
    )
    results = _table_html(tables.overview(study)) + "".join(
        _table_html(each, 3) for each in (boundary, effects) if each
    )
    return Page(
        title=study.name,
        head=_head(study),
        sections=(
            PageSection("results", "Results", results),
            PageSection("figures", "Figures", _figures_html(study)),
            PageSection("cases", "Cases", _table_html(cases) if cases else ""),
            PageSection("side-effects", "What got worse", _table_html(worse) if worse else ""),
            PageSection(
                "points", "Points", "".join(_table_html(each, 3) for each in tables.points(study))
            ),
            PageSection("losses", "How flights ended", _table_html(tables.losses(study))),
            PageSection("worst", "Worst runs", _worst_html(tables.worst(study))),
            PageSection("repeat", "To repeat this study", _repeat(study)),
        ),
        footer=f"Made by testbed {__version__} from {study.file}.",
    )


def _figures_html(study: StudyData) -> str:
    note = ""
    if study.is_map:
        note = (
            "<p>Figures of all points of a case together are left out: a map has more points where"
            " the number changes, so they would show these points, not the area. Cases are compared"
            " point by point.</p>"
        )
    return "".join(map(figure_html, study_figures(study))) + note


_ENDS = {
    "left the formation": ("formation_lost",),
    "lost separation": ("separation_lost",),
    "in overspeed or stall": ("envelope_exceeded",),
    "ended with a violated bound": ("bound_violated",),
}  # outcomes of flights that went on, by text


def print_summary(study: StudyData, console: Console) -> None:
    """Print the tables of a study, without those of points."""
    console.print(f" [bold]{study.name}[/] · {' · '.join(_facts(study))}", soft_wrap=True)
    if study.missing:
        console.print(f" {_missing(study)}", style="yellow", soft_wrap=True, markup=False)
    shown = [
        tables.overview(study),
        tables.boundary(study),
        tables.effects(study),
        tables.cases(study),
        tables.side_effects(study),
    ]
    if not study.flights.completed.all():
        shown.append(tables.losses(study))
    for table in shown:
        if table is None:
            continue
        console.print(f"\n[bold]{table.title.lower()}[/]")
        for metric, part in table.by_metric():
            if metric:
                console.print(f" {metric}", style="dim", soft_wrap=True)
            rich = part.to_rich()
            # a narrow terminal breaks its lines, because broken cells cannot be read
            whole = console.measure(rich, options=console.options.update_width(10_000)).maximum
            if whole < console.width:
                console.print(Padding(rich, (0, 0, 0, 1)))
            else:
                rich.width = whole
                console.print(rich, crop=False)
        if table.name == "side-effects":
            console.print(f" {table.note}", style="dim", soft_wrap=True, markup=False)
    console.print("\n[bold]worst runs[/]")
    for number, outcome, value, command in tables.worst(study).rows:
        line = f" {number}  {outcome}  {format_cell(value)}"
        console.print(line, soft_wrap=True, markup=False)
        console.print(f"   {command}", soft_wrap=True, markup=False)
    console.print()


def _missing(study: StudyData) -> str:
    """Name the metrics of the study that no flight has."""
    return f"no flight has a number {', '.join(study.missing)}: left out"


def _facts(study: StudyData) -> list[str]:
    flights = study.flights
    out = [f"{flights.run.size:,} of {study.planned:,} flights of {study.scenario}"]
    if len(flights.cases) > 1:
        out.append(f"{len(flights.cases)} cases")
    count = len(set(flights.seed.tolist()))
    same = ", which change no number" if study.same_flights else ""
    out.append(f"{count} seed{'s' * (count != 1)}{same}")
    return [*out, *_ends(study)]


def _ends(study: StudyData) -> list[str]:
    """Count the flights that were not completed, by how they ended, and those out of slot."""
    flights = study.flights
    counts = {
        text: sum(outcome in kinds for outcome in flights.outcome) for text, kinds in _ENDS.items()
    }
    lost = int((~flights.completed).sum()) - sum(counts.values())
    left = count_out_of_slot(flights.metrics, flights.completed)
    counts["completed with a follower out of its slot at the end"] = left
    return [f"{lost:,} lost or failed", *(f"{n:,} {text}" for text, n in counts.items() if n)]


def _head(study: StudyData) -> str:
    flights = study.flights
    out = [f"<h1>{escape(study.name)}</h1>"]
    if study.question:
        out.append(f'<p class="question">{escape(study.question)}</p>')
    out.append(f'<p class="meta">{escape(" · ".join(_facts(study)))}</p>')
    if flights.run.size < study.planned:
        out.append("<p>The study has not ended; the report has the flights that have.</p>")
    if study.missing:
        text = _missing(study)
        out.append(f"<p>{escape(text[0].upper() + text[1:])}.</p>")
    keys = [f"{each.label} ({len(each.levels)})" for each in flights.parameters]
    if keys:
        out.append(f"<p>Varied, {escape(study.design)}: {escape(', '.join(keys))}.</p>")
    cards = []
    groups = flights.groups
    # several cases or laws: all of them with the first metric, rather than one with several
    shown = [(m, g) for m in study.metrics[: MAX_CARDS if len(groups) == 1 else 1] for g in groups]
    if study.is_map:  # there is no number of all its points
        shown = []
    for metric, group in shown[:MAX_CARDS]:
        estimate = study.estimate(metric, group.flights, f"all/{group.name or flights.cases[0]}")
        value = format_number(estimate.value)
        interval = format_cell(estimate).removeprefix(value)
        case = f"; {group.label}" if group.label else ""
        words, unit = metric_words(metric)
        meaning = f"{words}: {study.statistic}{interval}{case}"
        cards.append((f"{value} {unit}".rstrip(), escape(meaning), ""))
    completed = int(flights.completed.sum())
    cards.append((f"{completed:,}", "flights completed without losing an aircraft", ""))
    incomplete = flights.run.size - completed
    problem = "excluded from all other numbers: see How flights ended" if incomplete else ""
    meaning = "lost or failed" if not incomplete else f"not completed: {', '.join(_ends(study))}"
    cards.append((f"{incomplete:,}", escape(meaning), problem))
    out.append(cards_html(cards))
    return "".join(out)


def _table_html(table: ReportTable, heading: int = 0) -> str:
    title = f"<h{heading}>{escape(table.title)}</h{heading}>" if heading else ""
    return f"{title}{to_html(table.to_rich())}{_note(table)}"


def _note(table: ReportTable) -> str:
    return f"<p>{escape(table.note)}</p>" if table.note else ""


def _worst_html(table: ReportTable) -> str:
    rows = []
    for row in table.rows:
        number, outcome, value, command = (escape(format_cell(cell)) for cell in row)
        rows.append(
            f'<th scope="row">{number}</th><td>{outcome}</td><td>{value}</td>'
            f"<td><code>{command}</code></td>"
        )
    return text_table_to_html(table.columns, rows) + _note(table)


def _repeat(study: StudyData) -> str:
    out = [rows_to_html([*study.versions.items()])] if study.versions else []
    if study.repeat:
        out.append(f"<pre>{escape(study.repeat)}</pre>")
    for name, text in study.files.items():
        if text:
            out.append(file_html(name, "text/yaml", text.encode()))
    return "".join(out)
