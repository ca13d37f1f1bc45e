"""Report comparisons with golden tables as Markdown, for the summary of a CI job."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence

from testbed.studies.golden_compare import RowComparison, Verdict, Violation
from testbed.studies.golden_report import (
    MAX_COMMANDS,
    change_lines,
    failing_seeds,
    format_number,
    format_seeds,
    run_command,
    violation_line,
)
from testbed.studies.golden_table import row_label

BAR_CELLS = 12  # of the longest bar
MAX_TABLE_ROWS = 40
MAX_ALL_ROWS = 60
MAX_LINES = 20
MAX_CHARACTERS = 900_000  # GitHub refuses a summary above 1 MiB


def to_markdown(verdicts: Sequence[Verdict], input_errors: Sequence[str] = ()) -> str:
    """Return a Markdown document: an overview, and for each failed scenario what differs.

    Bars are text, because a job summary shows neither SVG nor images inside the document.

    Args:
        verdicts: of the scenarios.
        input_errors: reasons why nothing was flown.
    """
    failed = [each for each in verdicts if not each.passed]
    if input_errors:
        head = "nothing flown"
    elif failed:
        head = f"{len(failed)} failed, {len(verdicts) - len(failed)} passed"
    else:
        head = f"{len(verdicts)} passed"
    lines = [f"## testbed check: {head}", ""]
    lines += [f"- {_text(each)}" for each in input_errors]
    if verdicts:
        lines += _overview(verdicts)
    for verdict in failed:
        lines += ["", *_failed(verdict)]
    if verdicts:
        lines += ["", "### RMS errors and all other numbers"]
    for verdict in verdicts:
        lines += ["", *_folded(verdict.name, list(_all_numbers(verdict)))]
    text = "\n".join(lines) + "\n"
    if len(text) > MAX_CHARACTERS:
        text = text[:MAX_CHARACTERS].rpartition("\n")[0] + "\n\n… cut: the JSON file has all.\n"
    return text


def _overview(verdicts: Sequence[Verdict]) -> Iterator[str]:
    yield "| scenario | result | flights | numbers that differ | bounds violated |"
    yield "|---|---|---|--:|--:|"
    for each in verdicts:
        differing = sum(bool(row.violations) for row in each.rows)
        outside = sum(bool(bound.violations) for bound in each.bounds)
        bounds = f"{outside} of {len(each.bounds)}" if each.bounds else "–"
        result = "passed" if each.passed else "**failed**"
        name = " ".join((each.name, *(f"--set {setting}" for setting in each.overrides)))
        yield (
            f"| {_code(name)} | {result} | {format_seeds(each.seeds)} | "
            f"{differing} of {len(each.rows)} | {bounds} |"
        )


def _failed(verdict: Verdict) -> Iterator[str]:
    yield f"### {_text(verdict.name)}"
    yield ""
    yield f"Golden table: {_text(verdict.table.reason)}"
    yield from _list("Changed since then", change_lines(verdict))
    yield from _list("Flights that cannot be compared", [str(each) for each in verdict.problems])
    outside = [line for bound in verdict.bounds for line in bound.lines]
    yield from _list("Outside the bounds of the scenario", outside)
    differing = [row for row in verdict.rows if row.violations]
    if differing:
        yield ""
        yield from _table(differing)
        lines = [f"- {_text(violation_line(each, verdict))}" for each in verdict.violations]
        shown = [*lines[:MAX_LINES], *_rest(len(lines) - MAX_LINES)]
        yield ""
        yield from _folded("Largest deviations, by seed", shown)
    yield ""
    yield "To repeat it:"
    yield ""
    yield "```sh"
    for seed in failing_seeds(verdict)[:MAX_COMMANDS]:
        yield run_command(verdict, seed)
    yield "```"


def _folded(title: str, lines: Sequence[str]) -> Iterator[str]:
    """Hide lines behind a title that opens them."""
    yield f"<details><summary>{_text(title)}</summary>"
    yield ""
    yield from lines
    yield ""
    yield "</details>"


def _all_numbers(verdict: Verdict) -> Iterator[str]:
    """Table of all rows; bars of the RMS errors, as long as the largest."""
    errors = [row.measured or 0.0 for row in verdict.rows if _is_error(row)]
    largest = max(errors, default=0.0) or 1.0
    yield "| number, mean over seeds | golden | measured | RMS error |"
    yield "|---|--:|--:|---|"
    for row in verdict.rows[:MAX_ALL_ROWS]:
        measured = "–" if row.measured is None else format_number(row.measured)
        bar = _bar(row.measured / largest) if _is_error(row) and row.measured is not None else ""
        label = f"{_text(row_label(row.key))}, {row.rule.unit}"
        yield f"| {label} | {format_number(row.golden)} | {measured} | {bar} |"
    yield from ("", *_rest(len(verdict.rows) - MAX_ALL_ROWS))


def _is_error(row: RowComparison) -> bool:
    return row.key.startswith(("rms_m/", "mean_rms_m/"))


def _bar(share: float) -> str:
    """Return a bar as text; something is shown of every share."""
    return "█" * max(1, round(BAR_CELLS * share))


def _table(rows: Sequence[RowComparison]) -> Iterator[str]:
    """Table of means over the seeds, with a bar as long as the largest deviation of the row."""
    largest = max(_deviation(row.violations) for row in rows)
    yield "| number, mean over seeds | golden | measured | change | in tolerances | |"
    yield "|---|--:|--:|--:|--:|---|"
    for row in rows[:MAX_TABLE_ROWS]:
        assert row.measured is not None
        change = row.measured - row.golden
        relative = f"{100.0 * change / row.golden:+.1f} %" if row.golden else f"{change:+.3f}"
        deviation = _deviation(row.violations)
        better = all(each.better for each in row.violations)
        yield (
            f"| {_text(row_label(row.key))}, {row.rule.unit} | {format_number(row.golden)} | "
            f"{format_number(row.measured)} | {relative} {'better' if better else 'worse'} | "
            f"{deviation:.1f} | {_bar(deviation / largest)} |"
        )
    yield from ("", *_rest(len(rows) - MAX_TABLE_ROWS))


def _deviation(violations: Sequence[Violation]) -> float:
    return max(each.deviation for each in violations)


def _rest(count: int) -> list[str]:
    """Count the lines or rows that are left out."""
    return [f"- … and {count} more in the JSON file"] if count > 0 else []


def _list(title: str, lines: Sequence[str]) -> Iterator[str]:
    if not lines:
        return
    yield ""
    yield f"{title}:"
    yield ""
    for line in lines[:MAX_LINES]:
        yield f"- {_text(line)}"
    yield from _rest(len(lines) - MAX_LINES)


def _text(text: str) -> str:
    """Escape a text for Markdown, which names, numbers and paths leave as they are."""
    plain = html.escape(" ".join(text.split()), quote=False)
    return "".join(f"\\{letter}" if letter in "\\`*_[]|~#" else letter for letter in plain)


def _code(text: str) -> str:
    """Return a text as code in a cell of a table."""
    return f"<code>{_text(text)}</code>"
