"""The metrics document as tables for people: 80 columns, readable without colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.formation.flags import Saturation
from testbed.metrics import network, wind

Document = Mapping[str, Any]
ABREAST = 3  # portions that fit side by side in 80 columns
FOLLOWERS = 12  # followers listed one by one; of more, the worst are shown
EVENTS = 6
OUTCOME_STYLES = {"flown": "bold green", "lost": "bold red", "failed": "bold red"}
EVENT_STYLES = {"error": "red", "warning": "yellow"}
NOTHING = "–"


def render_table(metrics: Document, console: Console, *, log: Path | None = None) -> None:
    """Print a metrics document; `log` is the recording to name at the end."""
    console.print(_headline(metrics))
    portions = list(metrics["portions"])
    for first in range(0, len(portions), ABREAST):
        console.print()
        console.print(_errors(metrics, portions[first : first + ABREAST]))
    source = (metrics.get("published") or {}).get("source")
    if source and portions:
        console.print(Text(f" published: {source}", style="dim"))
    if metrics["engaged_at_s"]:
        console.print()
        console.print(_agents(metrics))
    console.print()
    console.print(_facts(metrics))
    for line in _events(metrics["events"]):
        console.print(line)
    if log is not None:
        # never wrapped by us: a path broken over two lines cannot be copied
        console.print(Text(f" {'log':<20}{log}"), soft_wrap=True)


def _headline(metrics: Document) -> Text:
    outcome = metrics["outcome"] or "in flight"
    line = Text(" ")
    line.append(str(metrics["scenario"]), style="bold")
    line.append(" · ")
    line.append(outcome, style=OUTCOME_STYLES.get(outcome, "bold yellow"))
    line.append(f" · {metrics['simulated_s']:.0f} s simulated")
    if metrics["wall_s"] is not None:
        line.append(f" in {metrics['wall_s']:.1f} s")
    if metrics["real_time_factor"] is not None:
        line.append(f" ({_factor(metrics['real_time_factor'])} × real time)")
    line.append(f" · seed {metrics['seed']}")
    return line


def _table() -> Table:
    """Rules and no frame; the margin of one column is the padding's."""
    return Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")


def _errors(metrics: Document, portions: Sequence[str]) -> Table:
    """RMS errors of some portions side by side, each beside the published ones."""
    published = metrics.get("published") or {}
    table = _table()
    table.add_column(Text("\nRMS error, m", style="bold"), no_wrap=True)
    for name in portions:
        start, end = metrics["portions"][name]["window_s"]
        title = Text.assemble((name, "bold cyan"), f"\n{start:g}–{end:g} s", justify="right")
        table.add_column(title, justify="right", no_wrap=True)
        if _has(published, name):
            table.add_column(Text("\npaper"), justify="right", style="dim", no_wrap=True)
            table.add_column(Text("\nratio"), justify="right", no_wrap=True)
    names = _listed(metrics)
    followers = list(metrics["engaged_at_s"])
    for name in names:
        cells: list[Text | str] = [name]
        for portion in portions:
            ours = metrics["portions"][portion]["rms_m"][name]
            theirs = _nth(published.get("rms_m", {}).get(portion), followers.index(name))
            cells += _cells(ours, theirs, "{:.2f}", _has(published, portion))
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
            cells += _cells(ours, theirs, form, _has(published, portion))
        table.add_row(*cells)
    extremes = (("largest, m", _largest, "{:.2f}"), ("leader bank, °", _bank, "{:.1f}"))
    for label, value, form in extremes:
        cells = [Text(label, style="dim")]
        for portion in portions:
            cells.append(Text(_show(value(metrics["portions"][portion]), form), style="dim"))
            cells += ["", ""] if _has(published, portion) else []
        table.add_row(*cells)
    if not all(metrics["portions"][name]["complete"] for name in portions):
        cells = [Text("covered, s", style="yellow")]
        for portion in portions:
            covered = metrics["portions"][portion]["covered_s"]
            cells.append(Text(f"{covered:g}", style="yellow"))
            cells += ["", ""] if _has(published, portion) else []
        table.add_row(*cells)
    return table


def _agents(metrics: Document) -> Table:
    """What happened to each follower: when it engaged, what limited it, how old its news was."""
    table = _table()
    table.add_column(Text("\nfollower", style="bold"), no_wrap=True)
    table.add_column("engaged\nat, s", justify="right")
    table.add_column("guarded\nfor, s", justify="right")
    table.add_column("at limit\nfor, s", justify="right")
    for limit in Saturation:
        table.add_column(f"{str(limit.name).lower()}\n%", justify="right", style="dim")
    table.add_column("at limit\nlast, s", justify="right")
    table.add_column("news\nage, ms", justify="right")
    simulated = max(float(metrics["simulated_s"]), 1e-9)
    for name in _listed(metrics):
        engaged = metrics["engaged_at_s"][name]
        guards, limits = metrics["guards"][name], metrics["saturations"][name]
        frame_s = limits["seconds"] / limits["frames"] if limits["frames"] else 0.0
        shares = [100.0 * limits["by_kind"][k] * frame_s / simulated for k in limits["by_kind"]]
        age = metrics["age_of_information_s"][name]["mean"]
        table.add_row(
            name,
            Text("never", style="red") if engaged is None else f"{engaged:.1f}",
            _seconds(guards["seconds"]),
            _seconds(limits["seconds"]),
            *(_share(share) for share in shares),
            _show(metrics["recovery"][name]["last_saturated_s"], "{:.1f}"),
            NOTHING if age is None else f"{1e3 * age:.0f}",
        )
    return table


def _facts(metrics: Document) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(width=20)
    table.add_column()
    separation = _show(metrics["min_separation_m"], "{:.2f} m")
    between = metrics["min_separation_between"]
    if between:
        separation += f", {between[0]} and {between[1]} at {metrics['min_separation_at_s']:.1f} s"
    table.add_row(" smallest separation", separation)
    table.add_row(" leader's bank", _show(metrics["leader_bank_deg"], "{:.1f}° at most"))
    if metrics["engaged_at_s"]:
        table.add_row(" kappa measured", _kappa(metrics))
    felt = wind.describe(metrics["wind"])
    if felt:
        table.add_row(" wind felt", felt)
    if any(each["wake_roll_coefficient"] for each in metrics["wind"].values()):
        shares = [f"{name} {100.0 * each:.1f}" for name, each in metrics["mean_throttle"].items()]
        table.add_row(" mean throttle, %", ", ".join(shares[: FOLLOWERS + 1]))
    radio = network.describe(metrics["network"])
    if radio:
        table.add_row(" network", "\n".join(radio))
    left = {name: each for name, each in metrics["left_speed_set"].items() if each["times"]}
    if left:
        table.add_row(" left the speed set", _left(left))
    return table


def _kappa(metrics: Document) -> Text:
    """The follower whose slot kept least of the κ that the page promises."""
    measured, assumed = metrics["kappa_mps"], metrics["kappa_assumed_mps"]
    spare = {name: kappa - assumed[name] for name, kappa in measured.items() if kappa is not None}
    if not spare:
        return Text(NOTHING)
    name = min(spare, key=lambda each: spare[each])
    style = "red" if measured[name] <= 0.0 else "yellow" if spare[name] <= 0.0 else ""
    return Text(
        f"{measured[name]:.2f} m/s, {name} at {metrics['kappa_at_s'][name]:.1f} s; "
        f"the page says {assumed[name]:g}",
        style=style,
    )


def _left(left: Mapping[str, Mapping[str, Any]]) -> Text:
    """Who left its speed set first, how often, and how many others did."""
    name = min(left, key=lambda each: float(left[each]["first_s"]))
    text = f"{name} at {left[name]['first_s']:.1f} s, {left[name]['times']} × in all"
    others = f"; {len(left) - 1} more" if len(left) > 1 else ""
    return Text(text + others, style="yellow")


def _events(events: Sequence[Mapping[str, Any]]) -> list[Text]:
    """The warnings and errors of the run, the first few in full."""
    # of the quiet ones, those that were to be said before the flight
    loud = [
        e
        for e in events
        if e["level"] in EVENT_STYLES or (e["source"] == "run" and not e["time_s"])
    ]
    lines = [
        Text(
            f" {event['level']:<8}{event['time_s']:>9.2f} s  {event['source']}: {event['text']}",
            style=EVENT_STYLES.get(event["level"], ""),
        )
        for event in loud[:EVENTS]
    ]
    if len(loud) > EVENTS:
        lines.append(Text(f" … and {len(loud) - EVENTS} more in the log", style="dim"))
    return lines


def _listed(metrics: Document) -> list[str]:
    """The followers to show: all, or of many those with the largest RMS error, in fleet order."""
    followers = list(metrics["engaged_at_s"])
    if len(followers) <= FOLLOWERS:
        return followers

    def badness(name: str) -> float:
        errors = [portion["rms_m"][name] for portion in metrics["portions"].values()]
        errors.append(None if errors else metrics["max_error_m"][name])
        return max((error for error in errors if error is not None), default=float("inf"))

    worst = set(sorted(followers, key=badness, reverse=True)[:FOLLOWERS])
    return [name for name in followers if name in worst]


def _cells(ours: float | None, theirs: float | None, form: str, compared: bool) -> list[Text | str]:
    value = Text(_show(ours, form))
    if not compared:
        return [value]
    if ours is None or not theirs:
        return [value, _show(theirs, "{:g}"), NOTHING]
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


def _bank(portion: Mapping[str, Any]) -> float | None:
    bank = portion["leader_bank_deg"]
    return None if bank is None else float(bank)


def _show(value: float | None, form: str) -> str:
    return NOTHING if value is None else form.format(value)


def _seconds(value: float) -> str:
    return f"{value:.1f}" if value else "0"


def _share(percent: float) -> str:
    return f"{percent:.1f}" if percent else "0"


def _factor(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"
