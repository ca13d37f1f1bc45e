"""The pace a run kept and what went over its links, for the table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.text import Text

SLACK = 0.01  # a pace within this of what was asked has been kept
_REFUSED = {
    "unsigned": "not signed",
    "forged": "signed with another key",
    "replayed": "heard before",
}


def describe_pace(pace: Mapping[str, Any]) -> Text:
    """What was asked and achieved, and how late ticks were."""
    if pace["achieved"] is None:
        return Text("nothing was flown")
    kept = pace["achieved"] >= (1.0 - SLACK) * pace["asked"]
    late = {name: 1e3 * value for name, value in pace["late_s"].items()}
    return Text(
        f"{pace['achieved']:.3f} of {pace['asked']:g}; late by {late['mean']:.1f} ms, "
        f"99 % < {late['p99']:.1f}, most {late['max']:.1f}",
        style="" if kept else "yellow",
    )


def describe_arduplanes(versions: Mapping[str, str]) -> Text:
    """Which ArduPlane flew whom."""
    alike: dict[str, list[str]] = {}
    for name, version in versions.items():
        alike.setdefault(version, []).append(name)
    return Text("\n".join(f"{version}: {', '.join(names)}" for version, names in alike.items()))


def describe_commands(commanded: Mapping[str, Mapping[str, int]]) -> Text:
    """Who was told what: the numbers are not those of the page alone."""
    lines = [
        f"{name}: " + ", ".join(f"{kind} {count}" for kind, count in each.items())
        for name, each in commanded.items()
    ]
    return Text("\n".join(lines), style="yellow")


def describe_mavlink(links: Mapping[str, Any]) -> Text:
    """What went over the links."""
    clients = ", ".join(links["clients"]) or "nobody"
    text = f"{links['frames_sent']} frames said, {links['frames_heard']} heard; spoke: {clients}"
    refused = ", ".join(
        f"{count} {_REFUSED[why]}" for why, count in links["refused"].items() if count
    )
    return Text(text + (f"; refused: {refused}" if refused else ""), style="yellow" * bool(refused))
