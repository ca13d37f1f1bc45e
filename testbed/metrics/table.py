"""The metrics document as tables for people: 80 columns, readable without colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.formation.flags import Saturation
from testbed.metrics import estimates, network, outside, wind
from testbed.metrics.document import losses, upsets
from testbed.metrics.error_table import (
    ABREAST,
    NOTHING,
    Document,
    beside_published,
    error_table,
    new_table,
    show,
)

FOLLOWERS = 12  # followers listed one by one; of more, the worst are shown
EVENTS = 6
OUTCOME_STYLES = {"flown": "bold green"} | dict.fromkeys(("lost", "upset", "failed"), "bold red")
EVENT_STYLES = {"error": "red", "warning": "yellow"}


def render_table(metrics: Document, console: Console, *, log: Path | None = None) -> None:
    """Print a metrics document; `log` is the recording to name at the end."""
    console.print(_headline(metrics))
    portions = list(metrics["portions"])
    exact = not any(metrics["relative_position_m"].values())
    listed = worst_followers(metrics)
    for first in range(0, len(portions), ABREAST):
        console.print()
        console.print(error_table(metrics, portions[first : first + ABREAST], listed, exact=exact))
    if beside := beside_published(metrics):
        console.print(Text(f" {beside}", style="dim"))
    if metrics["engaged_at_s"]:
        console.print()
        console.print(follower_table(metrics, listed))
    console.print()
    console.print(_grid(facts(metrics)))
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


def follower_table(metrics: Document, names: Sequence[str]) -> Table:
    """What happened to these followers: when each engaged, what limited it, its news' age."""
    table = new_table()
    table.add_column(Text("\nfollower", style="bold"), no_wrap=True)
    table.add_column("engaged\nat, s", justify="right")
    table.add_column("guarded\nfor, s", justify="right")
    table.add_column("at limit\nfor, s", justify="right")
    for limit in Saturation:
        table.add_column(f"{str(limit.name).lower()}\n%", justify="right", style="dim")
    table.add_column("at limit\nlast, s", justify="right")
    table.add_column("news\nage, ms", justify="right")
    simulated = float(metrics["simulated_s"])
    for name in names:
        engaged = metrics["engaged_at_s"][name]
        guards, limits = metrics["guards"][name], metrics["saturations"][name]
        frame_s = limits["seconds"] / limits["frames"] if limits["frames"] else 0.0
        seen = simulated / frame_s + 1.0 if frame_s else 1.0  # frames, the first and the last too
        shares = [100.0 * limits["by_kind"][k] / seen for k in limits["by_kind"]]
        age = metrics["age_of_information_s"][name]["mean"]
        table.add_row(
            name,
            Text("never", style="red") if engaged is None else f"{engaged:.1f}",
            _seconds(guards["seconds"]),
            _seconds(limits["seconds"]),
            *(_share(share) for share in shares),
            show(metrics["recovery"][name]["last_saturated_s"], "{:.1f}"),
            NOTHING if age is None else f"{1e3 * age:.0f}",
        )
    return table


def facts(metrics: Document) -> list[tuple[str, str | Text]]:
    """What else is to be said of the run: names and texts, some of several lines."""
    rows: list[tuple[str, str | Text]] = []
    separation = show(metrics["min_separation_m"], "{:.2f} m")
    between = metrics["min_separation_between"]
    if between:
        separation += f", {between[0]} and {between[1]} at {metrics['min_separation_at_s']:.1f} s"
    lost = losses(metrics)
    if lost:
        rows.append(("lost", _named(lost, "; counted until then")))
    if upset := upsets(metrics):
        rows.append(("upset", _named(upset)))
    rows.append(("smallest separation", separation))
    rows.append(("leader's bank", show(metrics["leader_bank_deg"], "{:.1f}° at most")))
    if metrics["engaged_at_s"]:
        rows.append(("kappa measured", _kappa(metrics)))
    believed = estimates.describe(metrics["estimate_error"], metrics["relative_position_m"])
    if believed:
        rows.append(("estimates err by", "\n".join(believed)))
    felt = wind.describe(metrics["wind"])
    if felt:
        rows.append(("wind felt", felt))
    if any(each["wake_roll_coefficient"] for each in metrics["wind"].values()):
        shares = [f"{name} {100.0 * each:.1f}" for name, each in metrics["mean_throttle"].items()]
        rows.append(("mean throttle, %", ", ".join(shares[: FOLLOWERS + 1])))
    radio = network.describe(metrics["network"])
    if radio:
        rows.append(("network", "\n".join(radio)))
    left = {name: each for name, each in metrics["left_speed_set"].items() if each["times"]}
    if left:
        rows.append(("left the speed set", _left(left)))
    if "pace" in metrics:
        rows.append(("pace", outside.describe_pace(metrics["pace"])))
    if "mavlink" in metrics:
        rows.append(("MAVLink", outside.describe_mavlink(metrics["mavlink"])))
    if metrics.get("arduplane"):
        rows.append(("ArduPlane", outside.describe_arduplanes(metrics["arduplane"])))
    if metrics.get("commanded"):
        rows.append(("from outside", outside.describe_commands(metrics["commanded"])))
    return rows


def _grid(rows: Sequence[tuple[str, str | Text]]) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(width=20)
    table.add_column()
    for name, text in rows:
        table.add_row(f" {name}", text)
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


def _named(troubles: Sequence[str], note: str = "") -> Text:
    """The first of these in full."""
    more = [f"{len(troubles) - FOLLOWERS} more"] if len(troubles) > FOLLOWERS else []
    return Text(", ".join([*troubles[:FOLLOWERS], *more]) + note, style="red")


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
    # errors before anything else, for they are why a run is not to be believed
    first = sorted(range(len(loud)), key=lambda i: loud[i]["level"] != "error")[:EVENTS]
    lines = [
        Text(
            f" {event['level']:<8}{event['time_s']:>9.2f} s  {event['source']}: {event['text']}",
            style=EVENT_STYLES.get(event["level"], ""),
        )
        for event in (loud[i] for i in sorted(first))
    ]
    if len(loud) > EVENTS:
        lines.append(Text(f" … and {len(loud) - EVENTS} more in the log", style="dim"))
    return lines


def worst_followers(metrics: Document) -> list[str]:
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


def _seconds(value: float) -> str:
    return f"{value:.1f}" if value else "0"


def _share(percent: float) -> str:
    return f"{percent:.1f}" if percent else "0"


def _factor(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"
