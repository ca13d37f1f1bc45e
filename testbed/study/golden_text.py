"""What a comparison found, for a terminal or the log of a CI: 80 columns, no colour needed."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from testbed.study.golden import Renewal
from testbed.study.golden_compare import Comparison, Verdict
from testbed.study.golden_words import changed, offence_line, repeat, row_name, seeds_text, shown

CONTEXT = 12  # lines of what changed on the page
FAULTS = 12
ROWS = 16
OFFENDERS = 8
COMMANDS = 3


def show_check(verdicts: Sequence[Verdict], console: Console) -> None:
    """Print every verdict and a last line that sums them up."""
    for verdict in verdicts:
        show_verdict(verdict, console)
    failed = [verdict for verdict in verdicts if not verdict.passed]
    # of a flight that was lost or never engaged no table is written
    sound = [v for v in failed if all(fault.seed is None for fault in v.faults)]
    console.print()
    if not failed:
        _line(console, f" {len(verdicts)} good: every flight is the one of its table", "green")
        return
    _line(console, f" {len(failed)} failed, {len(verdicts) - len(failed)} good", "bold red")
    if sound:
        names = shlex.join(verdict.name for verdict in sound)
        _line(console, f" If this is meant: testbed check {names} --update --reason TEXT", "dim")


def show_verdict(verdict: Verdict, console: Console, *, bad: str = "FAILED") -> None:
    """Print a verdict: context, structure, values, offenders."""
    moved = [row for row in verdict.rows if row.offences]
    count = f"{len(verdict.rows)} numbers"
    head = Text.assemble(" ", (verdict.name, "bold"), " · ")
    if verdict.passed:
        head.append("good", "bold green")
        head.append(f" · {seeds_text(verdict.seeds)} · {count}")
    else:
        head.append(bad, "bold red")
        head.append(f" · {seeds_text(verdict.seeds)} · {len(moved)} of {count} moved")
    console.print(head, soft_wrap=True)
    if verdict.passed:
        _some(console, [f"the page changed: {each}" for each in verdict.changes], CONTEXT, "yellow")
        _some(console, verdict.notes, CONTEXT, "dim")
        return
    _line(console, f"   golden: {verdict.table.reason}", "dim")
    _some(console, changed(verdict), CONTEXT, "yellow")
    _some(console, [str(fault) for fault in verdict.faults], FAULTS, "red")
    faulty = dict.fromkeys(fault.seed for fault in verdict.faults if fault.seed is not None)
    for seed in list(faulty)[:1]:
        _line(console, f"     {repeat(verdict, seed)}", "cyan")
    _some(console, verdict.notes, CONTEXT, "dim")
    if moved:
        _show_moved(moved, console)
        _show_offenders(verdict, console)


def _show_moved(moved: Sequence[Comparison], console: Console) -> None:
    """Means over the seeds: then, now, by how much, which way."""
    _line(
        console, f"   {'moved, mean over seeds':<38}{'golden':>9}{'now':>9}{'change':>10}", "bold"
    )
    for row in moved[:ROWS]:
        assert row.now is not None
        change = row.now - row.golden
        share = f"{100.0 * change / row.golden:+.1f} %" if row.golden else f"{change:+.3f}"
        name = f"{row_name(row.key)}, {row.rule.unit}"
        better = all(each.better for each in row.offences)
        worse = not any(each.better for each in row.offences)
        word = "better" if better else "worse" if worse else "both ways"
        text = f"   {name:<38}{shown(row.golden):>9}{shown(row.now):>9}{share:>10} {word}"
        _line(console, text, "" if better else "red")
    _more(console, len(moved) - ROWS)


def _show_offenders(verdict: Verdict, console: Console) -> None:
    offences = verdict.offences
    worst = offences[:OFFENDERS]
    _line(console, "   offenders, the farthest outside first, in tolerances", "bold")
    for each in worst:
        _line(console, f"   {offence_line(each, verdict)}")
    _more(console, len(offences) - OFFENDERS)
    for seed in list(dict.fromkeys(each.seeds[0] for each in worst))[:COMMANDS]:
        _line(console, f"     {repeat(verdict, seed)}", "cyan")
    banded = [row for row in verdict.rows if row.offences and row.band]
    if banded and all(row.inside_band for row in banded):
        text = "the RMS errors that moved stay where another seed might be: a small change"
        _line(console, f"   {text}, or other dice", "dim")


def show_renewals(renewals: Sequence[Renewal], console: Console) -> None:
    """Print what moved beside each old table, and whether the new one was written."""
    for renewal in renewals:
        verdict, case = renewal.verdict, renewal.case
        if case.unread:
            _line(console, f" {case.name}: taken as without a table: {case.unread}", "yellow")
        if verdict and not verdict.passed:
            show_verdict(verdict, console, bad="moved")
        if renewal.table is None:
            head = Text.assemble(" ", (case.name, "bold"), " · ", ("NOT WRITTEN", "bold red"))
            console.print(head, soft_wrap=True)
            if not verdict:
                _some(console, [str(fault) for fault in renewal.faults], FAULTS, "red")
            continue
        table = renewal.table
        kind = "with dice" if table.random else "the same for every seed"
        unmoved = ", nothing moved" if verdict and verdict.passed else ""
        head = Text.assemble(" ", (case.name, "bold"), " · ", ("written", "bold green"))
        head.append(f" · {seeds_text(table.seeds)}, {kind} · {len(table.rows)} numbers{unmoved}")
        console.print(head, soft_wrap=True)
        _line(console, f"   {case.path}")


def _some(console: Console, lines: Sequence[str], most: int, style: str) -> None:
    for line in lines[:most]:
        _line(console, f"   {line}", style)
    _more(console, len(lines) - most)


def _more(console: Console, count: int) -> None:
    if count > 0:
        _line(console, f"   … and {count} more: --json FILE has them all", "dim")


def _line(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style=style), soft_wrap=True)
