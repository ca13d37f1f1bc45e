"""The trend of golden numbers over commits, which `testbed check --trend` shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from testbed.cli.figure_options import FigureLook
from testbed.cli.output import MISSING, PipeSafeConsole, result_console, write_json_output
from testbed.cli.report import check_figures, write_figures

if TYPE_CHECKING:
    from testbed.golden.golden_trend import Trend
    from testbed.reports.figure_spec import Figure

COLUMNS = 3  # of the newest commits
STYLES = {"better": "green", "worse": "red", "": ""}


def show_trend(
    folder: Path,
    scenarios: Sequence[str],
    *,
    json: Path | None,
    figures: Path | None,
    ending: str,
    look: FigureLook,
) -> None:
    """Print the numbers of kept results as tables, and draw them.

    Args:
        folder: of files of `testbed check --json`.
        scenarios: names; none: all.
        json: file of --json.
        figures: folder of --figures.
        ending: of the figures' files.
        look: of the figures.

    Raises:
        InputError: a file cannot be read or written.
    """
    from testbed.golden.golden_table import RULES
    from testbed.golden.golden_trend import read_trend, to_document
    from testbed.reports.trend_figures import TrendCurve, trend_figures
    from testbed.scenario.expect import WINDOW_QUANTITIES

    trend = read_trend(folder, scenarios)
    drawn: list[Figure] = []
    for name in trend.scenarios if figures else ():
        by_label: dict[str, list[TrendCurve]] = {}
        for row in trend.of(name):
            quantity, *where = row.key.split("/")
            label = f"{RULES[quantity].label}, {row.unit}"
            window = where.pop(0) if quantity in WINDOW_QUANTITIES else ""
            curve = TrendCurve(window, " ".join(where), row.measured, row.golden)
            by_label.setdefault(label, []).append(curve)
        drawn += trend_figures(name, trend.labels, by_label)
    check_figures(drawn, figures, ending, look)
    write_json_output(json, to_document(trend))
    console = result_console(json)
    for name in trend.scenarios:
        _print_scenario(trend, name, console)
    if figures:
        write_figures(drawn, figures, ending, console, look)


def _print_scenario(trend: Trend, name: str, console: PipeSafeConsole) -> None:
    """Print the oldest and the newest numbers of a scenario, and the change between them."""
    from testbed.golden.golden_report import format_number
    from testbed.golden.golden_table import row_label

    newest = range(max(len(trend.labels) - COLUMNS, 1), len(trend.labels))
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for k in (0, *newest):
        table.add_column(trend.labels[k].rpartition("-")[2], justify="right", no_wrap=True)
    table.add_column("change", justify="right", no_wrap=True)
    table.add_column("")
    for row in trend.of(name):
        shown = [row.measured[k] for k in (0, *newest)]
        cells = [MISSING if each is None else format_number(each) for each in shown]
        change = MISSING if row.change is None else f"{row.change:+.1f} %"
        style = STYLES[row.direction]
        label = f"{row_label(row.key)}, {row.unit}"
        table.add_row(label, *cells, Text(change, style), Text(row.direction, style))
    console.write_line(f" {name} · {len(trend.labels)} results", "bold")
    console.print(table)
    console.write_line()
