"""Lines of text on a metrics document, for the terminal and the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.text import Text

from testbed.core.frames import wind_from_deg
from testbed.metrics.document import SEPARATION_LOST, exceedances, losses
from testbed.metrics.model import (
    Expectations,
    LinkMetrics,
    MavlinkTraffic,
    Metrics,
    NetworkMetrics,
    PaceMetrics,
)
from testbed.metrics.summary import CALM_MPS

ABSENT = "–"
MAX_LISTED = 12  # aircraft that are named in a line
DELAY_RESOLUTION_S = 1e-6  # smaller differences of delays are rounding
PACE_TOLERANCE = 0.01  # a pace this close to the requested one counts as achieved

Numbers = Mapping[str, float | None]

_ESTIMATE_LINES = (
    (("horizontal_m", "horizontal {:.2f} m"), ("height_m", "height {:.2f} m")),
    (("velocity_mps", "velocity {:.2f} m/s"), ("airspeed_mps", "airspeed {:.2f} m/s")),
    (("tilt_deg", "tilt {:.1f}°"), ("heading_deg", "heading {:.1f}°")),
)
LOSSES = {
    "lost": "random",
    "faded": "out of range",
    "corrupted": "corrupted",
    "queue": "queue full",
    "blackout": "blackout",
    "partition": "partition",
    "listed": "drop list",
}
_REJECTED = {
    "unsigned": "not signed",
    "forged": "signed with another key",
    "replayed": "received before",
    "outdated": "signed too long ago",
}


def facts(metrics: Metrics) -> list[tuple[str, str | Text]]:
    """Return names and texts, some of several lines, of what no table shows."""
    rows: list[tuple[str, str | Text]] = []
    if lost := losses(metrics):
        rows.append(("lost", _listed(lost, "; counted until then")))
    if exceeded := exceedances(metrics):
        rows.append(("limit exceeded", _listed(exceeded)))
    if bounds := metrics.get("expect"):
        rows.append(("expected", _expected(bounds)))
    rows.append(("smallest separation", _separation(metrics)))
    rows.append(("leader bank", shown(metrics["leader_bank_deg"], "max {:.1f}°")))
    if metrics["joined_at_s"]:
        rows.append(("kappa measured", _kappa(metrics)))
    errors = describe_estimates(metrics["estimate_error"], metrics["relative_position_error_m"])
    rows.append(("estimate error, RMS", "\n".join(errors)))
    if not metrics.get("recorded"):
        rows.append(("wind", "\n".join(describe_wind(metrics["wind"]))))
    if any(each["max_wake_delta_cl"] for each in metrics["wind"].values()):
        throttle: Mapping[str, Any] = metrics["mean_throttle"]
        shares = [f"{name} {100.0 * each:.1f}" for name, each in throttle.items()]
        rows.append(("mean throttle, %", ", ".join(shares[: MAX_LISTED + 1])))
    rows.append(("network", "\n".join(describe_network(metrics["network"]))))
    if left := {name: each for name, each in metrics["left_speed_set"].items() if each["times"]}:
        rows.append(("left the speed set", _left(left)))
    if "pace" in metrics:
        rows.append(("pace", describe_pace(metrics["pace"])))
    if "mavlink" in metrics:
        rows.append(("MAVLink", describe_mavlink(metrics["mavlink"])))
    rows.append(("ArduPlane", describe_arduplanes(metrics.get("arduplane") or {})))
    rows.append(("external commands", describe_commands(metrics.get("commanded") or {})))
    return [row for row in rows if str(row[1])]


def select_largest(
    names: Iterable[str], size: Callable[[str], float | tuple[float, ...]], count: int
) -> list[str]:
    """Return the `count` names of largest size, or fewer, in their order."""
    names = list(names)
    largest = set(sorted(names, key=size, reverse=True)[:count])
    return [name for name in names if name in largest]


def shown(value: float | None, form: str) -> str:
    """Format a number; a dash stands for None."""
    return ABSENT if value is None else form.format(value)


def percent(share: float | None) -> str:
    """Format a share; 100 % and 0 % are printed only if exact."""
    if share is None:
        return ABSENT
    text = f"{100.0 * share:.1f}"
    if text == "100.0" and share < 1.0:
        return "> 99.9 %"
    return "< 0.1 %" if text == "0.0" and share > 0.0 else f"{text} %"


def exact(errors: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether all estimates equalled the truth, given `estimate_error` of the document."""
    return not any(each != 0.0 for numbers in errors.values() for each in numbers.values())


def describe_estimates(errors: Mapping[str, Mapping[str, Any]], relative: Numbers) -> list[str]:
    """Describe the errors of estimates; no lines where they were exact.

    Numbers are RMS over the aircraft whose estimates differ from the truth.

    Args:
        errors: `estimate_error` of the metrics document.
        relative: its `relative_position_error_m`.
    """
    if exact(errors):
        return []
    known = {name: each for name, each in errors.items() if None not in each.values()}
    inexact = [each for each in known.values() if any(each.values())]
    lines = []
    if inexact:
        for forms in _ESTIMATE_LINES:
            rms = {key: _rms([each[key] for each in inexact]) for key, _ in forms}
            lines.append(", ".join(form.format(rms[key]) for key, form in forms if rms[key]))
        between = {name: each for name, each in relative.items() if each is not None}
        if any(between.values()):
            worst = max(between, key=lambda name: between[name])
            most = f", max {between[worst]:.2f} m ({worst})" if len(between) > 1 else ""
            lines.append(f"relative to leader {_rms(between.values()):.2f} m{most}")
        if len(inexact) < len(errors):
            lines.append(f"over the {len(inexact)} of {len(errors)} aircraft with errors")
    if len(known) < len(errors):
        lines.append(f"NaN: {', '.join(name for name in errors if name not in known)}")
    return [line for line in lines if line]


def describe_wind(wind: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Describe mean wind and gusts of all aircraft; no lines in still air.

    Gusts are the RMS over the aircraft of the difference from each one's own mean wind.
    """
    each = list(wind.values())
    if any(one["max_mps"] is None for one in each):
        return ["NaN"]
    if max(one["max_mps"] for one in each) < CALM_MPS:
        return []
    mean = np.mean([one["mean_ned_mps"] for one in each], axis=0)
    speed = math.hypot(*mean[:2])
    lines = [f"{speed:.1f} m/s"]
    if speed >= 0.05:
        lines[0] += f" from {round(float(wind_from_deg(mean))) % 360}°"
    gusts = np.sqrt(np.mean(np.square([one["gusts_rms_ned_mps"] for one in each]), axis=0))
    if gusts.any():
        level = math.sqrt(0.5 * (gusts[0] ** 2 + gusts[1] ** 2))
        lines.append(f"gusts {level:.2f} m/s horizontal, {gusts[2]:.2f} m/s vertical (RMS)")
    return lines


def describe_network(network: NetworkMetrics | None) -> list[str]:
    """Describe losses and delays of all messages; no lines if all arrived without delay.

    Args:
        network: of the metrics document; None before the run has ended.
    """
    if network is None:
        return []
    total, lines = network["all"], []
    if total["lost"] or total["muted"]:
        share = percent(total["delivered_share"])
        lines.append(f"{share} of {total['sent']:,} delivered{_worst(network['links'])}")
    lost = ", ".join(
        f"{LOSSES[reason]} {count:,}" for reason, count in total["lost"].items() if count
    )
    others = [f"{total[key]:,} {key}" for key in ("overtaken", "duplicated") if total[key]]
    lines.append("; ".join(filter(None, (f"lost: {lost}" if lost else "", ", ".join(others)))))
    if total["muted"]:
        lines.append(f"{total['muted']:,} not sent: transmitter off or sender lost")
    timing = []
    if total["bursts"]["longest"] > 1:
        bursts = total["bursts"]
        timing.append(f"loss bursts: mean {bursts['mean']:.1f}, max {bursts['longest']:,}")
    delay = total["delay_s"]
    if delay and delay["p95"] > DELAY_RESOLUTION_S:
        timing.append(f"delay {1e3 * delay['p50']:.3g} ms")
        if delay["p95"] - delay["p50"] > DELAY_RESOLUTION_S:
            timing[-1] += f", p95 {1e3 * delay['p95']:.3g} ms"
    lines.append("; ".join(timing))
    return [line for line in lines if line]


def describe_pace(pace: PaceMetrics) -> Text:
    """Describe requested and achieved pace, and the lateness of ticks."""
    if pace["achieved"] is None:
        return Text("no ticks")
    achieved = pace["achieved"] >= (1.0 - PACE_TOLERANCE) * pace["requested"]
    late = (f"{name} {1e3 * pace['late_s'][name]:.1f} ms" for name in ("mean", "p99", "max"))
    rate = f"{pace['achieved']:.3f} of {pace['requested']:g} × real time"
    return Text(f"{rate}\nticks late: {', '.join(late)}", style="" if achieved else "yellow")


def describe_mavlink(links: MavlinkTraffic) -> Text:
    """Describe the traffic over MAVLink links."""
    clients = ", ".join(links["clients"]) or "none"
    text = f"{links['frames_sent']} frames sent, {links['frames_received']} received"
    text += f"; clients: {clients}"
    rejected = ", ".join(
        f"{count} {_REJECTED[reason]}" for reason, count in links["rejected"].items() if count
    )
    text += f"; rejected: {rejected}" if rejected else ""
    return Text(text, style="yellow" * bool(rejected))


def describe_arduplanes(versions: Mapping[str, str]) -> Text:
    """Describe which ArduPlane version flew which aircraft."""
    alike: dict[str, list[str]] = {}
    for name, version in versions.items():
        alike.setdefault(version, []).append(name)
    return Text("\n".join(f"{version}: {', '.join(names)}" for version, names in alike.items()))


def describe_commands(commanded: Mapping[str, Mapping[str, int]]) -> Text:
    """Describe the external commands by aircraft: the scenario alone does not repeat the run."""
    lines = [
        f"{name}: " + ", ".join(f"{kind} {count}" for kind, count in each.items())
        for name, each in commanded.items()
    ]
    return Text("\n".join(lines), style="yellow")


def _listed(texts: Sequence[str], note: str = "") -> Text:
    more = [f"{len(texts) - MAX_LISTED} more"] if len(texts) > MAX_LISTED else []
    return Text(", ".join([*texts[:MAX_LISTED], *more]) + note, style="red")


def _expected(bounds: Expectations) -> Text:
    """Count the bounds of the scenario that are met or violated."""
    checked, violated = bounds["checked"], bounds["violated"]
    if violated:
        return Text(f"{violated} of {checked} numbers outside their bounds", style="red")
    return Text(f"{checked} numbers within their bounds", style="green" if checked else "yellow")


def _separation(metrics: Metrics) -> Text:
    """Describe the smallest separation; red where it was below the minimum without a fault."""
    text, between = (
        shown(metrics["min_separation_m"], "{:.2f} m"),
        metrics["min_separation_between"],
    )
    if between:
        text += f", {between[0]} and {between[1]} at {metrics['min_separation_at_s']:.1f} s"
    lost = any(
        each["level"] == "error" and each["text"].startswith(SEPARATION_LOST)
        for each in metrics["events"]
    )
    return Text(text, style="red" if lost else "")


def _kappa(metrics: Metrics) -> Text:
    """Describe the follower with the smallest margin to the κ that the scenario assumes."""
    assumed = metrics["kappa_assumed_mps"]
    measured = {name: kappa for name, kappa in metrics["kappa_mps"].items() if kappa is not None}
    margins = {name: kappa - assumed[name] for name, kappa in measured.items()}
    if not margins:
        return Text(ABSENT)
    name = min(margins, key=lambda each: margins[each])
    style = "red" if measured[name] <= 0.0 else "yellow" if margins[name] <= 0.0 else ""
    return Text(
        f"{measured[name]:.2f} m/s, {name} at {metrics['kappa_at_s'][name]:.1f} s; "
        f"assumed {assumed[name]:g}",
        style=style,
    )


def _left(left: Mapping[str, Mapping[str, Any]]) -> Text:
    """Describe the follower that left its speed set first, and count the others that did."""
    name = min(left, key=lambda each: float(left[each]["first_s"]))
    times = left[name]["times"]
    text = f"{name} at {left[name]['first_s']:.1f} s, {times} time{'s' * (times != 1)}"
    others = f"; {len(left) - 1} more" if len(left) > 1 else ""
    return Text(text + others, style="yellow")


def _worst(links: Mapping[str, Mapping[str, LinkMetrics]]) -> str:
    """Name the link that delivered least; "" if all delivered the same share."""
    shares = {
        f"{sender} > {receiver}": link["delivered_share"]
        for sender, receivers in links.items()
        for receiver, link in receivers.items()
        if link["delivered_share"] is not None
    }
    if len(set(shares.values())) < 2:
        return ""
    worst = min(shares, key=lambda name: float(shares[name]))
    return f"; worst {worst} {percent(shares[worst])}"


def _rms(values: Collection[float | None]) -> float:
    return math.sqrt(sum(each**2 for each in values if each is not None) / len(values))
