"""Tables in LaTeX: a `tabular` that needs no package, and that of a run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from testbed.core.errors import InputError
from testbed.metrics.facts import shown
from testbed.metrics.printed_tables import published_note, published_numbers
from testbed.reports.run_data import RunData

MAX_FOLLOWERS = 8  # with a column of their own
_SPECIAL = {each: f"\\{each}" for each in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "²": r"\textsuperscript{2}",
}
_END = "\\end{tabular}\n"


def tabular(
    note: str, columns: str, head: Sequence[str], groups: Sequence[Sequence[Sequence[str]]]
) -> str:
    """Return a `tabular` below a comment.

    Args:
        note: of the comment.
        columns: their alignments, "l" or "r" each.
        head: texts of the first row.
        groups: texts of the further rows, in groups with a line below each.
    """
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\hline"]
    for group in ([head], *groups):
        lines += [" & ".join(map(_escaped, row)) + r" \\" for row in group]
        lines.append(r"\hline")
    return "\n".join((f"% {_one_line(note)}", *lines, _END))


def run_latex(run: RunData) -> str:
    """Return the RMS errors of a run over its windows, with the published ones below each.

    A row has the errors of up to `MAX_FOLLOWERS` followers, their mean, and the mean in percent of
    the formation's size, as Table 1 of [HBH23].

    Raises:
        InputError: the scenario has no windows.
    """
    metrics = run.metrics
    followers = list(metrics["joined_at_s"])
    names = followers if len(followers) <= MAX_FOLLOWERS else []
    groups = []
    for window, numbers in metrics["windows"].items():
        published = published_numbers(metrics, window)
        rows = [_row(window, "simulated", numbers, names, "{:.2f}", "{:.0f}")]
        if published:
            by_name = published.get("rms_m") or []
            paper = published | {"rms_m": dict(zip(followers, by_name, strict=False))}
            rows.append(_row("", "published", paper, names, "{:g}", "{:g}"))
        groups.append(rows)
    if not groups:
        raise InputError(f"{run.path}: the run has no windows (write metrics.windows)")
    info = run.log.info
    about = f"{info.scenario_name}, seed {info.seed}: RMS errors in m"
    note = "; ".join(filter(None, (about, published_note(metrics))))
    head = ["Window", "", *names, "Mean", "Error (%)"]
    return tabular(note, "ll" + "r" * (len(names) + 2), head, groups)


def _row(
    window: str, kind: str, numbers: Mapping[str, Any], names: Sequence[str], form: str, share: str
) -> list[str]:
    errors = numbers.get("rms_m") or {}
    return [
        window,
        kind,
        *(shown(errors.get(name), form) for name in names),
        shown(numbers.get("mean_rms_m"), form),
        shown(numbers.get("percent_error"), share),
    ]


def _escaped(text: str) -> str:
    """Write a text for LaTeX, with the mathematics of a label between $ as it is."""
    parts = re.split(r"(\$[^$]+\$)", _one_line(text))
    if parts[0].startswith("["):  # which the end of the line above would take for its option
        parts[0:1] = ["", "{[}", parts[0][1:]]
    return "".join(
        part if k % 2 else "".join(_SPECIAL.get(letter, letter) for letter in part)
        for k, part in enumerate(parts)
    )


def _one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text)
