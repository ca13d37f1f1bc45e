"""Report comparisons with golden tables to CI: Markdown and JUnit XML."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree as xml

from testbed.core.files import report_write_errors, write_text_file
from testbed.golden.golden_compare import RowComparison, Verdict, Violation
from testbed.golden.golden_report import (
    MAX_COMMANDS,
    change_lines,
    failing_seeds,
    format_change,
    format_number,
    format_seeds,
    improvement_line,
    run_command,
    update_command,
    violation_line,
)
from testbed.golden.golden_table import row_label

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
    lines += _improved(verdicts)
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


def _improved(verdicts: Sequence[Verdict]) -> Iterator[str]:
    """List numbers that pass because they are better, and the command that keeps them."""
    improved = [each for each in verdicts if each.improved]
    if not improved:
        return
    yield ""
    yield "### Better than the golden table"
    yield ""
    for verdict in improved:
        lines = [
            f"- {_text(f'{verdict.name}: {improvement_line(row)}')}" for row in verdict.improved
        ]
        yield from (*lines[:MAX_LINES], *_rest(len(lines) - MAX_LINES))
    if kept := [each for each in improved if each.passed and not each.overrides]:
        yield ""
        yield "To keep these numbers:"
        yield ""
        yield "```sh"
        yield update_command(kept)
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
    """Make a table of means over seeds, with bars of the largest deviations."""
    largest = max(_deviation(row.violations) for row in rows)
    yield "| number, mean over seeds | golden | measured | change | in tolerances | |"
    yield "|---|--:|--:|--:|--:|---|"
    for row in rows[:MAX_TABLE_ROWS]:
        assert row.measured is not None
        relative = format_change(row)
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


# characters that XML 1.0 cannot contain, not even escaped
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def to_junit(verdicts: Sequence[Verdict], input_errors: Sequence[str] = ()) -> str:
    """Return JUnit XML, in the subset that GitHub, GitLab and Jenkins read.

    A suite per scenario; in it a case for its flights, one for each row of the golden table, and
    one for each bound of the scenario. A failure ends with the commands that repeat it.

    Args:
        verdicts: of the scenarios.
        input_errors: reasons why nothing was flown; each is an errored case.
    """
    root = xml.Element("testsuites", name="testbed check")
    suites = [_add_suite(root, verdict) for verdict in verdicts]
    if input_errors:
        suites.append(_add_input_errors(root, input_errors))
    for count in ("tests", "failures", "errors", "skipped"):
        root.set(count, str(sum(int(suite.get(count, "0")) for suite in suites)))
    root.set("time", f"{sum(verdict.wall_s for verdict in verdicts):.3f}")
    xml.indent(root)
    return xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def write_junit(path: Path, text: str) -> None:
    """Write the document.

    Raises:
        InputError: the file cannot be written.
    """
    with report_write_errors(f"--junit {path}"), write_text_file(path) as file:
        file.write(text)


def _add_suite(root: xml.Element, verdict: Verdict) -> xml.Element:
    suite = xml.SubElement(root, "testsuite", name=_printable(verdict.name))
    classname = _printable(f"golden.{verdict.name}")
    cases = [xml.SubElement(suite, "testcase", classname=classname, name="flights")]
    if verdict.problems:
        seeds = [problem.seed for problem in verdict.problems if problem.seed is not None]
        _add_failure(
            cases[0], list(map(str, verdict.problems)), verdict, seeds or verdict.seeds[:1]
        )
    for row in verdict.rows:
        name = row_label(row.key)
        cases.append(xml.SubElement(suite, "testcase", classname=classname, name=name))
        _add_row_result(cases[-1], row, verdict)
    for bound in verdict.bounds:
        cases.append(xml.SubElement(suite, "testcase", classname=classname, name=bound.key))
        if bound.violations:
            seeds = [seed for seed, _ in bound.violations]
            _add_failure(cases[-1], bound.lines, verdict, seeds)
    seconds = verdict.wall_s / len(cases)
    for case in cases:  # all cases share the flights
        case.set("time", f"{seconds:.3f}")
    changes = change_lines(verdict)
    if changes:
        xml.SubElement(suite, "system-out").text = _printable("\n".join(changes))
    return _with_counts(suite, verdict.wall_s)


def _add_row_result(case: xml.Element, row: RowComparison, verdict: Verdict) -> None:
    if row.missing:
        text = "missing: no flight has this number"
        _add_failure(case, [text], verdict, verdict.seeds[:1])
    elif row.violations:
        largest_first = sorted(row.violations, key=lambda each: -each.deviation)
        lines = [violation_line(each, verdict) for each in largest_first]
        seeds = [each.seeds[0] for each in largest_first]
        _add_failure(case, lines, verdict, seeds)
    elif row.better:
        xml.SubElement(case, "system-out").text = _printable(f"better: {improvement_line(row)}")
    elif row.measured is None:
        xml.SubElement(case, "skipped", message="no valid flight to compare: see flights")


def _add_input_errors(root: xml.Element, errors: Sequence[str]) -> xml.Element:
    suite = xml.SubElement(root, "testsuite", name="input")
    for index, error in enumerate(errors, 1):
        case = xml.SubElement(
            suite, "testcase", classname="golden.input", name=f"input {index}", time="0.000"
        )
        xml.SubElement(case, "error", message=_printable(error), type="InputError")
    return _with_counts(suite, 0.0)


def _with_counts(suite: xml.Element, wall_s: float) -> xml.Element:
    suite.set("tests", str(len(suite.findall("testcase"))))
    for count, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(count, str(len(suite.findall(f"testcase/{tag}"))))
    suite.set("time", f"{wall_s:.3f}")
    return suite


def _add_failure(
    case: xml.Element, lines: Sequence[str], verdict: Verdict, seeds: Sequence[int]
) -> None:
    """Add a failure; text and message are alike, as readers may show one."""
    failure = xml.SubElement(case, "failure", message=_printable(lines[0]), type="regression")
    commands = [run_command(verdict, seed) for seed in dict.fromkeys(seeds)][:MAX_COMMANDS]
    failure.text = _printable("\n".join((*lines, "", "To repeat it:", *commands)))


def _printable(text: str) -> str:
    return _FORBIDDEN.sub("�", text)
