"""Verdicts as JUnit XML, the subset that GitHub's, GitLab's and Jenkins' readers share.

A suite per scenario; in it a case for its flights as such, and one per row of the golden table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as xml

from testbed.errors import InputError
from testbed.study.golden_compare import Comparison, Verdict
from testbed.study.golden_words import changed, offence_line, row_name

# Characters that XML 1.0 cannot hold, not even escaped.
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def to_junit(verdicts: Sequence[Verdict], problems: Sequence[str] = ()) -> str:
    """The document of these verdicts; `problems` are what kept everything from flying."""
    root = xml.Element("testsuites", name="testbed check")
    suites = [_suite(root, verdict) for verdict in verdicts]
    if problems:
        suites.append(_input(root, problems))
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
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"--junit {path}: {error.strerror}") from error


def _suite(root: xml.Element, verdict: Verdict) -> xml.Element:
    suite = xml.SubElement(root, "testsuite", name=_clean(verdict.name))
    classname = _clean(f"golden.{verdict.name}")
    cases = [xml.SubElement(suite, "testcase", classname=classname, name="flights")]
    if verdict.faults:
        _fail(cases[0], str(verdict.faults[0]), "\n".join(map(str, verdict.faults)))
    for row in verdict.rows:
        cases.append(xml.SubElement(suite, "testcase", classname=classname, name=row_name(row.key)))
        _judge(cases[-1], row, verdict)
    seconds = verdict.wall_s / len(cases)
    for case in cases:  # the flights are shared by all cases
        case.set("time", f"{seconds:.3f}")
    context = changed(verdict)
    if context:
        xml.SubElement(suite, "system-out").text = _clean("\n".join(context))
    return _counted(suite, verdict.wall_s)


def _judge(case: xml.Element, row: Comparison, verdict: Verdict) -> None:
    if row.missing:
        _fail(case, "missing: no flight has this number")
    elif row.offences:
        worst = sorted(row.offences, key=lambda each: -each.outside)
        lines = [offence_line(each, verdict) for each in worst]
        _fail(case, lines[0], "\n".join(lines))
    elif row.now is None:
        xml.SubElement(case, "skipped", message="no sound flight to compare: see flights")


def _input(root: xml.Element, problems: Sequence[str]) -> xml.Element:
    suite = xml.SubElement(root, "testsuite", name="input")
    for index, problem in enumerate(problems, 1):
        case = xml.SubElement(
            suite, "testcase", classname="golden.input", name=f"input {index}", time="0.000"
        )
        xml.SubElement(case, "error", message=_clean(problem), type="InputError")
    return _counted(suite, 0.0)


def _counted(suite: xml.Element, wall_s: float) -> xml.Element:
    suite.set("tests", str(len(suite.findall("testcase"))))
    for count, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(count, str(len(suite.findall(f"testcase/{tag}"))))
    suite.set("time", f"{wall_s:.3f}")
    return suite


def _fail(case: xml.Element, message: str, text: str = "") -> None:
    """The message is repeated in the text: some readers show only the one or the other."""
    failure = xml.SubElement(case, "failure", message=_clean(message), type="regression")
    failure.text = _clean(text or message)


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("�", text)
