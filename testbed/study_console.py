"""What `testbed sweep` does on the terminal, and its exit codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.options import refuse_below_one
from testbed.outputs import Paper, is_stdout, put_json, refuse_files
from testbed.progress import counting
from testbed.study.crew import FLOWN
from testbed.study.summary import Group, Summary, summarise, to_document
from testbed.study.sweep import Swept, sweep

GOOD, LOST = 0, 1
NOTHING = "–"


def sweep_and_show(
    study: str,
    *,
    out: Path | None,
    jobs: int | None,
    resume: bool,
    backend: str,
    scheduler: str | None,
    json: Path | None,
    quiet: bool,
) -> int:
    """Fly a study, print how it ended, and return the exit code.

    Raises:
        InputError: the page or an option cannot be used.
        KeyboardInterrupt: Ctrl-C; what was flown is kept.
    """
    refuse_below_one(jobs=jobs)
    refuse_files(json=json)
    speech = Console(stderr=True, highlight=False)

    def tell(text: str) -> None:
        if not quiet or text.startswith("warning"):
            speech.print(Text(text), soft_wrap=True)

    count = (0, 0)

    def progress(done: int, of: int) -> None:
        nonlocal count
        count = (done, of)
        show(done, of)

    try:
        with counting("runs", hidden=quiet) as show:
            swept = sweep(
                study,
                out,
                jobs=jobs,
                resume=resume,
                backend=backend,
                scheduler=scheduler,
                progress=progress,
                tell=tell,
            )
    except KeyboardInterrupt:
        if count[1]:
            tell(f"interrupted; {count[0]:,} of {count[1]:,} runs are kept: go on with --resume")
        raise
    summary = summarise(swept)
    if not quiet:
        show_summary(swept, summary, Paper(stderr=is_stdout(json), highlight=False))
    put_json(json, to_document(swept, summary))
    return GOOD if swept.good else LOST


def show_summary(swept: Swept, summary: Summary, console: Console) -> None:
    """Print how a study ended."""
    console.print()
    console.print(_headline(swept))
    if summary.groups and summary.metrics:
        console.print()
        console.print(_table(summary))
    for name, hint in summary.unknown.items():
        console.print(Text(f" no run has a number {name!r}{hint}", style="yellow"), soft_wrap=True)
    for each in summary.troubles:
        console.print()
        console.print(Text(f" run {each['run']}: {each['error']}", style="red"), soft_wrap=True)
        console.print(Text(f" {each['command']}", style="dim"), soft_wrap=True)
    left = sum(n for outcome, n in swept.outcomes.items() if outcome != FLOWN)
    if left > len(summary.troubles):
        console.print(Text(f"\n … and {left - len(summary.troubles)} more", style="dim"))
    console.print()
    console.print(Text(f" file  {swept.path}"), soft_wrap=True)


def _headline(swept: Swept) -> Text:
    line = Text(" ")
    line.append(swept.study.name, style="bold")
    runs = sum(swept.outcomes.values())
    line.append(f" · {runs:,} runs")
    if swept.flown < runs:
        line.append(f", {swept.flown:,} of them now")
    for outcome, count in swept.outcomes.items():
        if count:
            style = "bold green" if outcome == FLOWN else "bold red"
            line.append(" · ")
            line.append(f"{count:,} {outcome}", style=style)
    return line


def _table(summary: Summary) -> Table:
    """A line for each group: what it is, how many runs, and each number's median and range."""
    cased = any(group.case for group in summary.groups)
    keys = list(summary.groups[0].point)
    # the numbers' names are long, and their heads may break at each dot
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 1), header_style="bold")
    if cased:
        table.add_column("case", no_wrap=True)
    for key in keys:
        table.add_column(_broken(key), justify="right")
    table.add_column("runs", justify="right", style="dim")
    for name in summary.metrics:
        table.add_column(_broken(name), justify="right", no_wrap=False)
    for group in summary.groups:
        table.add_row(
            *([group.case] if cased else []),
            *(_value(group.point[key]) for key in keys),
            str(group.runs) if group.flown == group.runs else f"{group.flown} of {group.runs}",
            *(_spread(group, name) for name in summary.metrics),
        )
    table.caption = " median (smallest to largest)"
    table.caption_justify = "left"
    return table


def _broken(name: str) -> str:
    """A name with a line for each of its parts."""
    return name.replace(".", ".\n")


def _value(value: Any) -> str:  # noqa: ANN401 - a level
    return f"{value:g}" if isinstance(value, float) else str(value)


def _spread(group: Group, name: str) -> str:
    spread = group.numbers[name]
    if spread is None:
        return NOTHING
    median, low, high = spread
    digits = "{:.3g}" if max(abs(low), abs(high)) < 1000.0 else "{:.0f}"
    texts = [digits.format(each) for each in (median, low, high)]
    return f"{texts[0]} ({texts[1]} to {texts[2]})" if low < high else texts[0]
