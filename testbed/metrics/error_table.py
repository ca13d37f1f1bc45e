"""The RMS errors of a metrics document as tables for people, portions side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

Document = Mapping[str, Any]
ABREAST = 3  # portions that fit side by side in 80 columns
NOTHING = "–"


def new_table() -> Table:
    """Rules and no frame; the margin of one column is the padding's."""
    return Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")


def error_table(
    metrics: Document, portions: Sequence[str], names: Sequence[str], *, exact: bool
) -> Table:
    """RMS errors of some portions side by side, each beside the published ones.

    Args:
        metrics: the document.
        portions: of its portions, as many as fit.
        names: of its followers, those to show.
        exact: estimates are the truth, so that nothing else is believed.
    """
    published = metrics.get("published") or {}
    beside = [name for name in portions if name in compared(metrics)]
    table = new_table()
    table.add_column(Text("\nRMS error, m", style="bold"), no_wrap=True)
    for name in portions:
        start, end = metrics["portions"][name]["window_s"]
        title = Text.assemble((name, "bold cyan"), f"\n{start:g}–{end:g} s", justify="right")
        table.add_column(title, justify="right", no_wrap=True)
        if name in beside:
            table.add_column(Text("\npaper"), justify="right", style="dim", no_wrap=True)
            table.add_column(Text("\nratio"), justify="right", no_wrap=True)
    followers = list(metrics["engaged_at_s"])
    for name in names:
        cells: list[Text | str] = [name]
        for portion in portions:
            ours = metrics["portions"][portion]["rms_m"][name]
            theirs = _nth(published.get("rms_m", {}).get(portion), followers.index(name))
            theirs = None if _lost_within(metrics, portion, name) else theirs
            cells += _cells(ours, theirs, "{:.2f}", portion in beside)
        table.add_row(*cells)
    if len(names) < len(followers):
        table.add_row(Text(f"(the worst of {len(followers)})", style="dim"))
    table.add_section()
    averages = (("mean", "mean_rms_m", "{:.2f}"), ("error, %", "percent_error", "{:.0f}"))
    for label, key, form in averages:
        cells = [Text(label, style="bold")]
        for portion in portions:
            theirs = published.get(key, {}).get(portion)
            ours = metrics["portions"][portion][key]
            theirs = None if _lost_within(metrics, portion, *followers) else theirs
            cells += _cells(ours, theirs, form, portion in beside)
        table.add_row(*cells)
    extremes = [("largest, m", _largest, "{:.2f}"), ("leader bank, °", _bank, "{:.1f}")]
    if not exact:
        extremes.insert(0, ("mean believed", _believed, "{:.2f}"))
    if len(names) < len(followers):
        extremes.insert(0, ("median", _median, "{:.2f}"))
    for label, value, form in extremes:
        cells = [Text(label, style="dim")]
        for portion in portions:
            cells.append(Text(show(value(metrics["portions"][portion]), form), style="dim"))
            cells += ["", ""] if portion in beside else []
        table.add_row(*cells)
    if not all(metrics["portions"][name]["complete"] for name in portions):
        cells = [Text("flown, s", style="yellow")]
        for portion in portions:
            cells.append(Text(flown_part(metrics, portion), style="yellow"))
            cells += ["", ""] if portion in beside else []
        table.add_row(*cells)
    return table


def compared(metrics: Document) -> list[str]:
    """The portions to hold against published numbers: those that have some, flown to their end."""
    published = metrics.get("published") or {}
    found = metrics["portions"]
    return [name for name in found if found[name]["complete"] and _has(published, name)]


def published_mean(metrics: Document, portion: str) -> float | None:
    """The mean RMS error that was published of a portion, m, if there is one to compare with."""
    if portion not in compared(metrics) or _lost_within(metrics, portion, *metrics["max_error_m"]):
        return None
    mean = metrics["published"].get("mean_rms_m", {}).get(portion)
    return None if mean is None else float(mean)


def beside_published(metrics: Document) -> str:
    """Where the published numbers are from, and what is not held against them; "" of none."""
    published = metrics.get("published") or {}
    found = metrics["portions"]
    known = [name for name in found if _has(published, name)]
    cut = [name for name in known if not found[name]["complete"]]
    said = [f"published: {published['source']}"] if len(cut) < len(known) else []
    if cut:
        said.append(f"not flown to the end, so not compared: {', '.join(cut)}")
    return "; ".join(said)


def flown_part(metrics: Document, portion: str) -> str:
    """Which part of a window the run flew, s: "all", "none", or from when to when."""
    start, end = metrics["portions"][portion]["window_s"]
    if metrics["portions"][portion]["complete"]:
        return "all"
    until = min(float(metrics["simulated_s"]), end)
    return f"{start:g}–{until:g}" if metrics["portions"][portion]["covered_s"] else "none"


def _lost_within(metrics: Document, portion: str, *names: str) -> bool:
    """Whether one of these, or the leader, was lost before a window ended."""
    lost, end = metrics["lost_at_s"], metrics["portions"][portion]["window_s"][1]
    times = [lost.get(name) for name in (next(iter(lost), ""), *names)]
    return any(at is not None and at < end for at in times)


def _cells(ours: float | None, theirs: float | None, form: str, compared: bool) -> list[Text | str]:
    value = Text(show(ours, form))
    if not compared:
        return [value]
    if ours is None or not theirs:
        return [value, show(theirs, "{:g}"), NOTHING]
    ratio = ours / theirs
    style = "green" if ratio <= 1.0 else "red"
    value.stylize(style)
    return [value, f"{theirs:g}", Text(f"{ratio:.2f}", style=style)]


def _has(published: Mapping[str, Any], portion: str) -> bool:
    keys = ("rms_m", "mean_rms_m", "percent_error")
    return any(portion in (published.get(key) or {}) for key in keys)


def _nth(values: Sequence[float] | None, index: int) -> float | None:
    return values[index] if values is not None and index < len(values) else None


def _largest(portion: Mapping[str, Any]) -> float | None:
    errors = [error for error in portion["max_error_m"].values() if error is not None]
    return max(errors, default=None)


def _median(portion: Mapping[str, Any]) -> float | None:
    errors = [error for error in portion["rms_m"].values() if error is not None]
    return median(errors) if errors else None


def _believed(portion: Mapping[str, Any]) -> float | None:
    mean = portion["believed_mean_rms_m"]
    return None if mean is None else float(mean)


def _bank(portion: Mapping[str, Any]) -> float | None:
    bank = portion["leader_bank_deg"]
    return None if bank is None else float(bank)


def show(value: float | None, form: str) -> str:
    """A number, or what stands for none."""
    return NOTHING if value is None else form.format(value)
