"""Report comparisons with golden tables as JUnit XML."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as xml

from testbed.core.files import report_write_errors, write_text_file
from testbed.studies.golden_compare import RowComparison, Verdict
from testbed.studies.golden_report import MAX_COMMANDS, change_lines, run_command, violation_line
from testbed.studies.golden_table import row_label

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
    """Add a failure; the text repeats the message, as some readers show only one of them."""
    failure = xml.SubElement(case, "failure", message=_printable(lines[0]), type="regression")
    commands = [run_command(verdict, seed) for seed in dict.fromkeys(seeds)][:MAX_COMMANDS]
    failure.text = _printable("\n".join((*lines, "", "To repeat it:", *commands)))


def _printable(text: str) -> str:
    return _FORBIDDEN.sub("�", text)
