"""Report comparisons with golden tables: on a terminal of 80 columns, and as JSON."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from testbed.golden.golden import UpdateResult
from testbed.golden.golden_compare import RowComparison, Verdict, Violation
from testbed.golden.golden_table import RULES, row_label
from testbed.runs.bounds import BoundResult

MAX_CHANGES = 12  # lines of each kind, on the terminal
MAX_PROBLEMS = 12
MAX_ROWS = 16
MAX_VIOLATIONS = 8
MAX_COMMANDS = 3
OUTSIDE = (
    "outside the bounds of the scenario: correct the bound in expect, or the scenario; "
    "--ignore-bounds writes the table as it is"
)


# text of numbers and violations


def format_number(value: float) -> str:
    """Format with three decimals, or with three digits where the decimals would be zeros."""
    return f"{value:.3f}" if value == 0.0 or abs(value) >= 0.01 else f"{value:.3g}"


def format_seeds(seeds: Sequence[int]) -> str:
    """Format as `seed 3`, `seeds 1, 2`, or `seeds 1 to 16`."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    if len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[-1] + 1)):
        return f"seeds {seeds[0]} to {seeds[-1]}"
    return f"seeds {', '.join(map(str, seeds))}"


def run_command(verdict: Verdict, seed: int) -> str:
    """Return the command that repeats a flight."""
    settings = [word for each in verdict.overrides for word in ("--set", each)]
    return shlex.join(["testbed", "run", verdict.name, *settings, "--seed", str(seed)])


def failing_seeds(verdict: Verdict) -> list[int]:
    """Return the seeds whose flights fail: problems, then bounds, then the largest violations."""
    seeds = [each.seed for each in verdict.problems if each.seed is not None]
    seeds += [seed for bound in verdict.bounds for seed, _ in bound.violations]
    seeds += [each.seeds[0] for each in verdict.violations]
    return list(dict.fromkeys(seeds or verdict.seeds[:1]))


def violation_line(violation: Violation, verdict: Verdict) -> str:
    """Describe a violation on one line: row, seeds, number, bounds, direction, deviation."""
    rule = RULES[violation.key.split("/")[0]]
    same_seed = verdict.table.same_seed(violation.key, violation.seeds[0]) is not None
    bounds = _describe_limits(violation, same_seed=same_seed)
    mean = "mean of " if verdict.table.random and len(violation.seeds) > 1 else ""
    direction = "better" if violation.better else "worse"
    return (
        f"{row_label(violation.key)}, {mean}{format_seeds(violation.seeds)}: "
        f"{format_number(violation.measured)} {rule.unit}, {bounds}, {direction} "
        f"({violation.deviation:.1f} x)"
    )


def _describe_limits(violation: Violation, *, same_seed: bool) -> str:
    low, golden, high = violation.low, violation.golden, violation.high
    if math.isinf(low):
        limits = f"at most {format_number(high)}"
    elif math.isinf(high):
        limits = f"at least {format_number(low)}"
    elif same_seed and math.isclose(high - golden, golden - low, rel_tol=1e-6):
        return f"golden {format_number(golden)} ± {high - golden:.1g}"
    else:
        limits = f"{format_number(low)} to {format_number(high)}"
        return f"golden {format_number(golden)}, {limits}" if same_seed else f"band {limits}"
    return f"golden {format_number(golden)}, {limits}"


def improvement_line(row: RowComparison) -> str:
    """Describe an improved number on one line: row, golden and measured number, change."""
    assert row.measured is not None
    return (
        f"{row_label(row.key)}: {format_number(row.golden)} to {format_number(row.measured)} "
        f"{row.rule.unit} ({format_change(row)})"
    )


def format_change(row: RowComparison) -> str:
    """Format the change of a row's mean, in percent where there is one."""
    assert row.measured is not None
    change = row.measured - row.golden
    return f"{100.0 * change / row.golden:+.1f} %" if row.golden else f"{change:+.3f}"


def update_command(verdicts: Sequence[Verdict]) -> str:
    """Return the command that writes the numbers of scenarios into their tables."""
    names = shlex.join(verdict.name for verdict in verdicts)
    return f"testbed check {names} --update --reason TEXT"


def change_lines(verdict: Verdict) -> list[str]:
    """Describe what changed since the table was written: scenario, files, versions."""
    return [
        *(f"the scenario changed: {change}" for change in verdict.changes),
        *(f"version: {change}" for change in verdict.versions),
        *([f"code: {verdict.code}"] if verdict.code and not verdict.passed else []),
    ]


# terminal


def print_check(verdicts: Sequence[Verdict], console: Console) -> None:
    """Print all verdicts and a summary."""
    for verdict in verdicts:
        print_verdict(verdict, console)
    failed = [verdict for verdict in verdicts if not verdict.passed]
    # an update would not write a table for the others
    updatable = [v for v in failed if not v.overrides and _needs_update(v)]
    console.print()
    improved = [v for v in verdicts if v.passed and v.improved]
    if failed:
        _line(console, f" {len(failed)} failed, {len(verdicts) - len(failed)} passed", "bold red")
        if updatable:
            text = f" If this change is intended: {update_command(updatable)}"
            _line(console, text, "dim")
    else:
        agree = "are within their tolerances" if improved else "agree with their tables"
        within = " and are within their bounds" if any(v.bounds for v in verdicts) else ""
        text = f" {len(verdicts)} passed: all flights {agree}{within}"
        _line(console, text, "green")
    if kept := [v for v in improved if not v.overrides]:
        _line(console, f" To keep what is better: {update_command(kept)}", "dim")


def _needs_update(verdict: Verdict) -> bool:
    """Return whether an update would write another table, without --ignore-bounds."""
    if any(bound.violations for bound in verdict.bounds):
        return False
    differs = bool(verdict.problems) or not all(row.passed for row in verdict.rows)
    return differs and all(problem.seed is None for problem in verdict.problems)


def print_verdict(verdict: Verdict, console: Console, *, failed: str = "FAILED") -> None:
    """Print a verdict: changes, problems, rows that differ, violations."""
    differing = [row for row in verdict.rows if row.violations]
    count = f"{len(verdict.rows)} numbers"
    head = Text.assemble(" ", (verdict.name, "bold"), " · ")
    if verdict.passed:
        head.append("passed", "bold green")
        head.append(f" · {format_seeds(verdict.seeds)} · {count}")
    else:
        head.append(failed, "bold red")
        head.append(f" · {format_seeds(verdict.seeds)} · {len(differing)} of {count} differ")
    outside = sum(bool(each.violations) for each in verdict.bounds)
    if verdict.bounds:
        total = f"{len(verdict.bounds)} bound{'s' * (len(verdict.bounds) != 1)}"
        head.append(f" · {outside} of {total} violated" if outside else f" · {total} met")
    console.print(head, soft_wrap=True)
    if verdict.passed:
        lines = [f"the scenario changed: {each}" for each in verdict.changes]
        _lines(console, lines, MAX_CHANGES, "yellow")
        _lines(console, verdict.notes, MAX_CHANGES, "dim")
        _print_improvements(verdict, console)
        return
    _line(console, f"   golden: {verdict.table.reason}", "dim")
    _lines(console, change_lines(verdict), MAX_CHANGES, "yellow")
    _lines(console, [str(problem) for problem in verdict.problems], MAX_PROBLEMS, "red")
    seeds = [problem.seed for problem in verdict.problems if problem.seed is not None]
    if seeds:
        _line(console, f"     {run_command(verdict, seeds[0])}", "cyan")
    _lines(console, verdict.notes, MAX_CHANGES, "dim")
    lines = [line for bound in verdict.bounds for line in bound.lines]
    _lines(console, lines, MAX_VIOLATIONS, "red")
    if lines and not differing:
        seed = next(each.violations[0][0] for each in verdict.bounds if each.violations)
        _line(console, f"     {run_command(verdict, seed)}", "cyan")
    if differing:
        _print_rows(differing, console)
        _print_violations(verdict, console)
    _print_improvements(verdict, console)


def _print_improvements(verdict: Verdict, console: Console) -> None:
    lines = [f"better: {improvement_line(row)}" for row in verdict.improved]
    _lines(console, lines, MAX_ROWS, "green")


def _print_rows(rows: Sequence[RowComparison], console: Console) -> None:
    """Print means over the seeds: golden, measured, change, direction."""
    heading = f"   {'mean over seeds':<38}{'golden':>9}{'measured':>9}{'change':>10}"
    _line(console, heading, "bold")
    for row in rows[:MAX_ROWS]:
        assert row.measured is not None
        relative = format_change(row)
        name = f"{row_label(row.key)}, {row.rule.unit}"
        better = all(each.better for each in row.violations)
        worse = not any(each.better for each in row.violations)
        word = "better" if better else "worse" if worse else "both ways"
        numbers = f"{format_number(row.golden):>9}{format_number(row.measured):>9}"
        _line(console, f"   {name:<38}{numbers}{relative:>10} {word}", "" if better else "red")
    _more(console, len(rows) - MAX_ROWS)


def _print_violations(verdict: Verdict, console: Console) -> None:
    violations = verdict.violations
    largest = violations[:MAX_VIOLATIONS]
    _line(console, "   violations, largest first, in tolerances", "bold")
    for each in largest:
        _line(console, f"   {violation_line(each, verdict)}")
    _more(console, len(violations) - MAX_VIOLATIONS)
    for seed in list(dict.fromkeys(each.seeds[0] for each in largest))[:MAX_COMMANDS]:
        _line(console, f"     {run_command(verdict, seed)}", "cyan")
    with_band = [row for row in verdict.rows if row.violations and row.band]
    if with_band and all(row.inside_band for row in with_band):
        text = "the RMS errors that differ are inside the band of other seeds: a small change,"
        _line(console, f"   {text} or other random numbers", "dim")


def print_updates(updates: Sequence[UpdateResult], console: Console) -> None:
    """Print the differences from each old table, and whether a new one was written."""
    for update in updates:
        verdict, case = update.verdict, update.case
        if case.table_error:
            text = f" {case.name}: the old table is ignored: {case.table_error}"
            _line(console, text, "yellow")
        if verdict and not verdict.passed:
            print_verdict(verdict, console, failed="differs")
        if update.table is None:
            head = Text.assemble(" ", (case.name, "bold"), " · ", ("NOT WRITTEN", "bold red"))
            console.print(head, soft_wrap=True)
            outside = [line for bound in update.bounds for line in bound.lines]
            if not verdict:
                lines = [str(problem) for problem in update.problems]
                _lines(console, [*lines, *outside], MAX_PROBLEMS, "red")
            if outside and not update.problems:
                _line(console, f"   {OUTSIDE}", "dim")
            continue
        table = update.table
        kind = "random" if table.random else "the same for every seed"
        same = ", no difference" if verdict and verdict.passed else ""
        head = Text.assemble(" ", (case.name, "bold"), " · ", ("written", "bold green"))
        head.append(f" · {format_seeds(table.seeds)}, {kind} · {len(table.rows)} numbers{same}")
        console.print(head, soft_wrap=True)
        _line(console, f"   {case.path}")
        if not verdict:
            lines = [line for bound in update.bounds for line in bound.lines]
            _lines(console, lines, MAX_VIOLATIONS, "yellow")


def _lines(console: Console, lines: Sequence[str], limit: int, style: str) -> None:
    for line in lines[:limit]:
        _line(console, f"   {line}", style)
    _more(console, len(lines) - limit)


def _more(console: Console, count: int) -> None:
    if count > 0:
        _line(console, f"   … and {count} more: --json FILE has all", "dim")


def _line(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style=style), soft_wrap=True)


# JSON


def to_document(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return all verdicts as plain data for JSON, independent of the wall clock."""
    return {
        "schema": 2,
        "passed": all(verdict.passed for verdict in verdicts),
        "scenarios": [_verdict_document(verdict) for verdict in verdicts],
    }


def _verdict_document(verdict: Verdict) -> dict[str, Any]:
    return {
        "scenario": verdict.name,
        "passed": verdict.passed,
        "seeds": list(verdict.seeds),
        "changes": list(verdict.changes),
        "versions": list(verdict.versions),
        "code": verdict.code,
        "problems": [{"seed": each.seed, "text": each.text} for each in verdict.problems],
        "notes": list(verdict.notes),
        "bounds": [_bound_document(each, verdict) for each in verdict.bounds],
        "rows": {row.key: _row_document(row) for row in verdict.rows},
        "improved": [row.key for row in verdict.improved],
        "violations": [
            {
                "row": each.key,
                "seeds": list(each.seeds),
                "measured": each.measured,
                "golden": each.golden,
                "low": _finite(each.low),
                "high": _finite(each.high),
                "deviation": each.deviation,
                "better": each.better,
                "command": run_command(verdict, each.seeds[0]),
            }
            for each in verdict.violations
        ],
    }


def _finite(limit: float) -> float | None:
    """Return a limit; null where there is none."""
    return limit if math.isfinite(limit) else None


def _bound_document(bound: BoundResult, verdict: Verdict) -> dict[str, Any]:
    return {
        "key": bound.key,
        "place": str(bound.place) if bound.place else None,
        "checked": bound.checked,
        "violations": [
            {"seed": seed, "text": text, "command": run_command(verdict, seed)}
            for seed, text in bound.violations
        ],
    }


def _row_document(row: RowComparison) -> dict[str, Any]:
    return {
        "passed": row.passed,
        "unit": row.rule.unit,
        "seeds": list(row.seeds),
        "golden": row.golden,
        "measured": row.measured,
        "band": list(row.band) if row.band else None,
        "tolerance": row.rule.allowed(row.golden),
    }
