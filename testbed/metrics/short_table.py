"""A metrics document as a short table, for notebooks and the interpreter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from testbed.metrics.document import Document
from testbed.metrics.facts import select_largest, shown

MAX_FOLLOWERS = 4  # of more, those with the largest errors
MAX_WINDOWS = 4

Row = Sequence[str]


def table_text(metrics: Document, place: str = "") -> str:
    """Return at most ten lines: outcome, RMS error by follower and window, separation.

    Args:
        metrics: of a run.
        place: of its files; "": none.
    """
    rows = list(_rows(metrics))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    table = ("  ".join(_aligned(row, widths)).rstrip() for row in rows)
    return "\n".join([_heading(metrics), *table, *_ending(metrics, place)])


def table_html(metrics: Document, place: str = "") -> str:
    """Return the same as HTML, for `_repr_html_`."""
    head, *body = (
        "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)
        for tag, row in zip(("th", *["td"] * 99), _rows(metrics), strict=False)
    )
    lines = "".join(f"<tr>{row}</tr>" for row in body)
    ending = "<br>".join(map(escape, _ending(metrics, place)))
    return (
        f"<p>{escape(_heading(metrics))}</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{lines}</tbody></table><p>{ending}</p>"
    )


def _heading(metrics: Document) -> str:
    parts = (
        metrics["scenario"],
        metrics["outcome"].replace("_", " "),
        f"{metrics['simulated_s']:g} s",
        f"seed {metrics['seed']}",
    )
    return " · ".join(parts)


def _rows(metrics: Document) -> Iterator[Row]:
    """Yield the cells of the table, its heading first."""
    errors = metrics["max_error_m"]
    windows = {name: window for name, window in list(metrics["windows"].items())[:MAX_WINDOWS]}
    more = len(metrics["windows"]) - len(windows)

    def largest(name: str) -> float:
        values = [each["rms_m"][name] for each in windows.values()] or [errors[name]]
        return max((each for each in values if each is not None), default=float("inf"))

    listed = select_largest(errors, largest, MAX_FOLLOWERS)
    kind = "" if len(listed) == len(errors) else f", {len(listed)} worst"
    if not windows:
        yield (f"largest error{kind}, m", "whole flight")
        for name in listed:
            yield (name, shown(errors[name], "{:.2f}"))
    else:
        yield (f"RMS error{kind}, m", *windows, *[f"and {more} more"] * bool(more))
        rest = [""] * bool(more)
        for name in listed:
            cells = (shown(each["rms_m"][name], "{:.2f}") for each in windows.values())
            yield (name, *cells, *rest)
        means = (shown(each["mean_rms_m"], "{:.2f}") for each in windows.values())
        yield (f"mean of {len(errors)}", *means, *rest)


def _ending(metrics: Document, place: str) -> list[str]:
    lines = []
    if (separation := metrics["min_separation_m"]) is not None:
        lines.append(f"smallest separation {separation:.2f} m")
    return [*lines, *[place] * bool(place)]


def _aligned(row: Row, widths: Sequence[int]) -> Iterator[str]:
    """Pad a name to the left and numbers to the right."""
    for k, (cell, width) in enumerate(zip(row, widths, strict=True)):
        yield cell.rjust(width) if k else cell.ljust(width)
