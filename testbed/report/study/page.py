"""The page of a study, its figures and tables as files, and what the terminal is told."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path

from rich.console import Console
from rich.padding import Padding

from testbed import __version__
from testbed.report.shell import (
    cards,
    document,
    draw_all,
    figure_html,
    saved,
    write_text,
)
from testbed.report.study import tables
from testbed.report.study.figures import figures_of
from testbed.report.study.grid import Grid, number, shown
from testbed.report.study.rows import Study
from testbed.report.tables import rows_to_html, to_html

PARTS = (
    ("results", "Results"),
    ("figures", "Figures"),
    ("cases", "Cases"),
    ("points", "Points"),
    ("endings", "How flights ended"),
    ("worst", "Worst runs"),
    ("again", "To repeat this study"),
)


def write_page(study: Study, path: Path) -> None:
    """Write the report; the same file gives the same bytes.

    Raises:
        OSError: it cannot be written.
    """
    write_text(page_of(study), path)


def write_figures(study: Study, folder: Path, ending: str) -> list[Path]:
    """Write every figure into a folder, made if need be, and return their files.

    Raises:
        OSError: one cannot be written.
    """
    return draw_all(figures_of(study), folder, ending)


def write_tables(study: Study, folder: Path) -> list[Path]:
    """Write every table as CSV into a folder, made if need be, and return their files.

    Raises:
        OSError: one cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for grid in grids_of(study):
        name = re.sub(r"[^\w.-]+", "-", grid.name)
        paths.append(folder / f"{name}.csv")
        write_text(grid.to_csv(), paths[-1])
    return paths


def grids_of(study: Study) -> Iterator[Grid]:
    """Every table that there is something for."""
    yield tables.overview(study)
    for grid in (tables.effects(study), tables.cases(study)):
        if grid is not None:
            yield grid
    yield from tables.points(study)
    yield tables.losses(study)
    yield tables.worst(study)


def page_of(study: Study) -> str:
    """The page as text."""
    effects, compared = tables.effects(study), tables.cases(study)
    parts = {
        "results": _html(tables.overview(study)) + (_html(effects, 3) if effects else ""),
        "figures": "".join(map(figure_html, figures_of(study))),
        "cases": _html(compared) if compared else "",
        "points": "".join(_html(grid, 3) for grid in tables.points(study)),
        "endings": _html(tables.losses(study)),
        "worst": _worst(tables.worst(study)),
        "again": _again(study),
    }
    return document(
        study.name,
        head=_head(study),
        parts=parts,
        titles=PARTS,
        foot=f"Made by testbed {__version__} from {study.file}.",
    )


def summary(study: Study, console: Console) -> None:
    """Tell a terminal what came out."""
    console.print(f" [bold]{study.name}[/] · {' · '.join(_facts(study))}", soft_wrap=True)
    grids = [tables.overview(study), tables.effects(study), tables.cases(study)]
    if not study.rows.good.all():
        grids.append(tables.losses(study))
    for grid in grids:
        if grid is None:
            continue
        console.print(f"\n[bold]{grid.title.lower()}[/]")
        for metric, part in grid.by_metric():
            if metric:
                console.print(f" {metric}", style="dim", soft_wrap=True)
            console.print(Padding(part.to_rich(), (0, 0, 0, 1)))
    console.print("\n[bold]worst runs[/]")
    for row in tables.worst(study).rows:
        console.print(f" {row[0]}  {row[1]}  {shown(row[2])}", soft_wrap=True, markup=False)
        console.print(f"   {row[3]}", soft_wrap=True, markup=False)
    console.print()


def _facts(study: Study) -> list[str]:
    rows = study.rows
    out = [f"{rows.run.size:,} of {study.planned:,} flights of {study.scenario}"]
    if len(rows.cases) > 1:
        out.append(f"{len(rows.cases)} cases")
    count = len(set(rows.seed.tolist()))
    out.append(f"{count} seed{'s' * (count != 1)}")
    bad = int((~rows.good).sum())
    return [*out, f"{bad} lost or failed"]


def _head(study: Study) -> str:
    rows = study.rows
    out = [f"<h1>{escape(study.name)}</h1>"]
    if study.question:
        out.append(f'<p class="question">{escape(study.question)}</p>')
    out.append(f'<p class="meta">{escape(" · ".join(_facts(study)))}</p>')
    if rows.run.size < study.planned:
        out.append("<p>The study has not ended: these are the flights that have been flown.</p>")
    keys = [f"{each.key} ({len(each.levels)})" for each in rows.parameters]
    if keys:
        out.append(f"<p>Varied, {escape(study.design)}: {escape(', '.join(keys))}.</p>")
    few = []
    for metric in study.metrics[:3]:
        found = study.estimate(metric, rows.case_index == 0, f"all/{rows.cases[0]}")
        of = f", {rows.cases[0]}" if len(rows.cases) > 1 else ""
        what = f"{metric}, {study.statistic}{shown(found).removeprefix(number(found.value))}{of}"
        few.append((number(found.value), escape(what), ""))
    few.append((f"{int(rows.good.sum()):,}", "flights flown to their end with everybody", ""))
    bad = int((~rows.good).sum())
    ill = "they are in no number: see how flights ended" if bad else ""
    few.append((f"{bad:,}", "lost or failed", ill))
    out.append(cards(few))
    return "".join(out)


def _html(grid: Grid, heading: int = 0) -> str:
    title = f"<h{heading}>{escape(grid.title)}</h{heading}>" if heading else ""
    note = f"<p>{escape(grid.note)}</p>" if grid.note else ""
    return f"{title}{to_html(grid.to_rich())}{note}"


def _worst(grid: Grid) -> str:
    head = "".join(f'<th scope="col">{escape(each)}</th>' for each in grid.columns)
    body = "".join(
        f'<tr><th scope="row">{escape(shown(row[0]))}</th><td>{escape(shown(row[1]))}</td>'
        f"<td>{escape(shown(row[2]))}</td><td><code>{escape(shown(row[3]))}</code></td></tr>"
        for row in grid.rows
    )
    note = f"<p>{escape(grid.note)}</p>" if grid.note else ""
    return (
        f'<div class="wide"><table class="facts"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>{note}"
    )


def _again(study: Study) -> str:
    out = [rows_to_html([*study.versions.items()])] if study.versions else []
    if study.repeat:
        out.append(f"<pre>{escape(study.repeat)}</pre>")
    for name, text in study.pages.items():
        if text:
            out.append(f'<p class="screen">{saved(name, "text/yaml", text.encode())}</p>')
            out.append(f'<pre class="page">{escape(text)}</pre>')
    return "".join(out)
