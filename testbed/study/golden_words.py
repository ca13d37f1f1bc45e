"""Words and lines for what a comparison found, shared by the terminal, JSON and JUnit."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from testbed.study.golden_compare import Comparison, Offence, Verdict
from testbed.study.golden_table import RULES


def row_name(key: str) -> str:
    """A row of the table: what, then which portion and follower."""
    quantity, *where = key.split("/")
    label = RULES[quantity].label if quantity in RULES else quantity
    return " ".join((*where, label)) if where else label


def seeds_text(seeds: Sequence[int]) -> str:
    """`seed 3`, `seeds 1, 2`, or `seeds 1 to 16`."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    if len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[-1] + 1)):
        return f"seeds {seeds[0]} to {seeds[-1]}"
    return f"seeds {', '.join(map(str, seeds))}"


def repeat(verdict: Verdict, seed: int) -> str:
    """The command that flies an offender again."""
    return f"testbed run {shlex.quote(verdict.name)} --seed {seed}"


def offence_line(offence: Offence, verdict: Verdict) -> str:
    """An offender on one line: where, which seed, the number, what it is held to, which way."""
    rule = verdict.table.rules[offence.key.split("/")[0]]
    middle, half = 0.5 * (offence.low + offence.high), 0.5 * (offence.high - offence.low)
    if verdict.table.same_seed(offence.key, offence.seeds[0]) is not None:
        held = f"golden {shown(middle)} ± {half:.1g}"
    else:
        held = f"band {shown(offence.low)} to {shown(offence.high)}"
    drawn = "mean of " if verdict.table.random and len(offence.seeds) > 1 else ""
    return (
        f"{row_name(offence.key)}, {drawn}{seeds_text(offence.seeds)}: {shown(offence.now)} "
        f"{rule.unit}, {held}, {way(offence)} ({offence.outside:.1f} x)"
    )


def shown(value: float) -> str:
    """A number with three decimals, or three digits where these would be zeros."""
    return f"{value:.3f}" if value == 0.0 or abs(value) >= 0.01 else f"{value:.3g}"


def way(offence: Offence) -> str:
    """Whether the move is for the better."""
    return "better" if offence.better else "worse"


def changed(verdict: Verdict) -> list[str]:
    """What is not as it was when the table was written: page, files, versions."""
    return [
        *(f"the page changed: {change}" for change in verdict.changes),
        *(f"version: {change}" for change in verdict.versions),
    ]


def to_document(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Everything as plain data for JSON; nothing in it depends on the clock."""
    return {
        "schema": 1,
        "passed": all(verdict.passed for verdict in verdicts),
        "scenarios": [_scenario(verdict) for verdict in verdicts],
    }


def _scenario(verdict: Verdict) -> dict[str, Any]:
    return {
        "scenario": verdict.name,
        "passed": verdict.passed,
        "seeds": list(verdict.seeds),
        "changes": list(verdict.changes),
        "versions": list(verdict.versions),
        "faults": [{"seed": fault.seed, "text": fault.text} for fault in verdict.faults],
        "notes": list(verdict.notes),
        "rows": {row.key: _row(row) for row in verdict.rows},
        "offenders": [
            {
                "row": each.key,
                "seeds": list(each.seeds),
                "now": each.now,
                "low": each.low,
                "high": each.high,
                "outside": each.outside,
                "better": each.better,
                "repeat": repeat(verdict, each.seeds[0]),
            }
            for each in verdict.offences
        ],
    }


def _row(row: Comparison) -> dict[str, Any]:
    return {
        "passed": row.passed,
        "unit": row.rule.unit,
        "seeds": list(row.seeds),
        "golden": row.golden,
        "now": row.now,
        "band": list(row.band) if row.band else None,
        "tolerance": row.rule.allowed(row.golden),
    }
