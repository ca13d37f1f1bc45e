"""The metrics document: completed by the runner, read by others, written as metrics.json."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from testbed.core.files import report_write_errors, write_text_file
from testbed.metrics.expectations import check_expectations, compares_flights
from testbed.metrics.model import Metrics

SEPARATION_LOST = "loss of separation"
_OTHER = re.compile(rf"{SEPARATION_LOST}: \S+ m from (\S+) ")  # the second aircraft of a pair
# first words of the events of exceeded limits
LIMIT_EVENTS = ("overspeed", "stalled", "lost its formation", SEPARATION_LOST)
EXCEEDED = ("envelope_exceeded", "formation_lost", "separation_lost")
BOUND_VIOLATED = "bound_violated"  # the run was ended by `limits.on_violation: stop`
OUTCOMES = ("completed", "lost", *EXCEEDED, BOUND_VIOLATED, "interrupted", "failed")


_WALL_CLOCK_KEYS = ("wall_s", "real_time_factor")


def finalise(
    summary: Metrics,
    *,
    network: Mapping[str, Any] | None,
    external: Mapping[str, Any],
    outcome: str,
    wall_s: float,
    expect: Mapping[str, Any] | None = None,
) -> Metrics:
    """Complete the summary of the samples: network, external programs, and how the run ended.

    `wall_s`, `real_time_factor`, `pace` and `mavlink` are the only numbers that differ between two
    runs of the same scenario and seed; `commanded` is there, empty or not, only in a run that
    external programs may command.

    Args:
        summary: of the samples.
        network: statistics by sender and receiver in `links`, of all links in `all`; None: there
            are no followers, and so no links.
        external: of external programs, if there were any: `pace`, `mavlink`, `arduplane` and
            `commanded`.
        outcome: one of `OUTCOMES`.
        wall_s: duration of the run.
        expect: bounds of the scenario, whose comparison is then in `expect`.

    Raises:
        ValueError: the outcome is none of `OUTCOMES`.
    """
    if outcome not in OUTCOMES:
        raise ValueError(f"outcome {outcome!r} is none of {', '.join(OUTCOMES)}")
    flown_s = summary["simulated_s"] - summary.get("begin_s", 0.0)
    factor = flown_s / wall_s if wall_s > 0 else None
    document: dict[str, Any] = {
        **summary,
        "age_of_information_s": {
            name: _age(network or {"links": {}}, name) for name in summary["age_of_information_s"]
        },
        "network": None if network is None else dict(network),
        **external,
        "outcome": outcome,
        "wall_s": wall_s,
        "real_time_factor": factor,
    }
    if expect and compares_flights(expect):
        document["expect"] = check_expectations(document, expect)
    return cast("Metrics", document)


def _age(network: Mapping[str, Any], follower: str) -> dict[str, float | None]:
    """Age, s, of the messages a follower used, over all control steps and senders."""
    links = network["links"].values()
    ages = [to[follower]["age_s"] for to in links if to.get(follower, {}).get("age_s")]
    uses = sum(age["uses"] for age in ages)
    return {
        "mean": sum(age["mean"] * age["uses"] for age in ages) / uses if uses else None,
        "max": max((age["max"] for age in ages), default=None),
    }


def losses(document: Mapping[str, Any]) -> list[str]:
    """Describe which aircraft were lost and when, in the order of time."""
    lost = {name: at for name, at in document["lost_at_s"].items() if at is not None}
    return [f"{name} at {lost[name]:.1f} s" for name in sorted(lost, key=lambda name: lost[name])]


def exceedances(document: Mapping[str, Any]) -> list[str]:
    """Describe which aircraft exceeded a limit without a fault, when first, and how often."""
    found: dict[tuple[str, str], list[float]] = {}
    for event in document["events"]:
        what = event["text"].partition(":")[0]
        if event["level"] == "error" and what in LIMIT_EVENTS:
            other = _OTHER.search(event["text"])
            names = f"{event['source']} and {other[1]}" if other else event["source"]
            found.setdefault((names, what), []).append(event["time_s"])
    return [
        f"{name} {what} at {times[0]:.1f} s" + (f", {len(times)} times" if times[1:] else "")
        for (name, what), times in found.items()
    ]


def initial_warnings(document: Mapping[str, Any]) -> list[str]:
    """Return source and text of the warnings from before the flight."""
    return [
        f"{event['source']}: {event['text']}"
        for event in document.get("events", ())
        if event["level"] == "warning" and not event["time_s"]
    ]


def errors(document: Mapping[str, Any]) -> list[tuple[float, str]]:
    """Return time, s, and text of the errors, in order of time."""
    found = [each for each in document["events"] if each["level"] == "error"]
    return [(each["time_s"], f"{each['source']}: {each['text']}") for each in found]


def to_json(document: Mapping[str, Any]) -> str:
    """Return the document as text, keys in their own order.

    Raises:
        ValueError: a number is NaN or infinite, which JSON has not.
    """
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def timeless_json(document: Mapping[str, Any]) -> str:
    """Return the text of a log's metrics: wall-clock numbers, which differ by run, are null."""
    timeless = {**document, **{key: None for key in _WALL_CLOCK_KEYS if key in document}}
    return json.dumps(timeless, indent=2, ensure_ascii=False, allow_nan=False)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write the document; a file is replaced whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    text = to_json(document)
    with report_write_errors(path), write_text_file(path) as file:
        file.write(text)
