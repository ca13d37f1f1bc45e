"""docs/companion.md: its tables are those of the code, and it says what was never flown."""

import os
import re

import pytest
from places import ROOT

from testbed.companion.checks import REASONS, Ending
from testbed.companion.engagement import ASKING_S, FRESH_MODE_S, CompanionText, Engagement
from testbed.mavlink.outgoing import Severity
from testbed.scenario.companion_flight import CompanionFlight

PAGE = ROOT / "docs" / "companion.md"
MARKS = "<!-- {} -->\n\n", "\n\n<!-- end of {} -->"


def reasons():
    """The table of all reasons."""
    lines = ["| | when | before: refuses | engaged: the aircraft |", "|---|---|---|---|"]
    for reason, row in REASONS.items():
        lasts = f"; for {row.lasts_s:g} s" if row.lasts_s and "for 1 s" not in row.when else ""
        refuses = "yes" if row.refuses else "–"
        engaged = "goes on" if row.ending is Ending.NONE else row.ending.value
        lines.append(f"| {reason.value} | {row.when}{lasts} | {refuses} | {engaged} |")
    return "\n".join(lines)


def keys():
    """The table of the keys of `controller.companion.flight`."""
    lines = ["| key | default | |", "|---|---|---|"]
    for name, field in CompanionFlight.model_fields.items():
        default = field.default
        if isinstance(default, tuple):
            shown = f"[{', '.join(f'{each:g}' for each in default)}]"
        else:
            shown = "–" if default is None else f"{default:g}"
        lines.append(f"| `{name}` | {shown} | {field.description} |")
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "table"), [("reasons", reasons), ("keys of the flight", keys)], ids=["reasons", "keys"]
)
def test_tables_of_the_page_are_those_of_the_code(name, table):
    """With TESTBED_SNAPSHOTS=1 they are written anew."""
    begin, end = (each.format(name) for each in MARKS)
    text = PAGE.read_text(encoding="utf-8")
    pattern = re.compile(f"{re.escape(begin.strip())}\n.*?{re.escape(end.strip())}", re.S)
    expected, count = pattern.subn(lambda _: f"{begin}{table()}{end}", text)
    assert count == 1
    if "TESTBED_SNAPSHOTS" in os.environ:
        PAGE.write_text(expected, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == expected


def test_page_says_first_what_was_never_flown():
    head = PAGE.read_text(encoding="utf-8").partition("\n## ")[0]
    flat = " ".join(head.split())
    assert "Nothing of it was ever flown on an aircraft, on a Raspberry Pi or against" in flat
    assert "safety pilot" in flat and "rules of the place" in flat


def test_times_and_texts_of_the_page_are_true():
    flat = " ".join(PAGE.read_text(encoding="utf-8").split())
    assert f"at most {FRESH_MODE_S:g} s shows" in flat and f"within {ASKING_S:g} s, once" in flat
    assert CompanionText(Severity.INFO, "formation ready: GUIDED engages it").text in flat
    source = (ROOT / "testbed" / "companion" / "engagement.py").read_text(encoding="utf-8")
    for text in ("formation ready: GUIDED engages it", "formation left:", "formation waits:"):
        assert text in source and text in flat
    assert Engagement.__doc__
