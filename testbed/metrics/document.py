"""The metrics document as a file: finished by the runner, written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from testbed.errors import InputError

UPSETS = ("overspeed", "stalled", "lost its formation")  # how their events begin
OUTCOMES = ("flown", "lost", "upset", "interrupted", "failed")


def complete(
    summary: Mapping[str, Any],
    *,
    network: Mapping[str, Any],
    outside: Mapping[str, Any],
    outcome: str,
    wall_s: float,
) -> dict[str, Any]:
    """The summary with what only the runner knows: what the radio did, and how the run ended.

    `wall_s`, `real_time_factor` and what is in `pace` and `mavlink` are the only numbers that
    differ between two runs of the same scenario and seed.

    Args:
        summary: of the frames.
        network: numbers of all links: by sender and receiver in `links`, together in `all`.
        outside: of programs outside, where there were any: `pace`, `mavlink`, `arduplane` and
            `commanded`.
        outcome: one of `OUTCOMES`.
        wall_s: how long the run took.

    Raises:
        ValueError: The outcome is none of `OUTCOMES`.
    """
    if outcome not in OUTCOMES:
        raise ValueError(f"outcome {outcome!r} is none of {', '.join(OUTCOMES)}")
    factor = summary["simulated_s"] / wall_s if wall_s > 0 else None
    return {
        **summary,
        "age_of_information_s": {
            name: _age(network, name) for name in summary["age_of_information_s"]
        },
        "network": dict(network),
        **outside,
        "outcome": outcome,
        "wall_s": wall_s,
        "real_time_factor": factor,
    }


def _age(network: Mapping[str, Any], follower: str) -> dict[str, float | None]:
    """How old what a follower used was, s, over the control steps and the aircraft heard."""
    links = network["links"].values()
    ages = [to[follower]["age_s"] for to in links if to.get(follower, {}).get("age_s")]
    uses = sum(age["uses"] for age in ages)
    return {
        "mean": sum(age["mean"] * age["uses"] for age in ages) / uses if uses else None,
        "max": max((age["max"] for age in ages), default=None),
    }


def losses(document: Mapping[str, Any]) -> list[str]:
    """Who was lost when, in words and in order of time."""
    lost = {name: at for name, at in document["lost_at_s"].items() if at is not None}
    return [f"{name} at {lost[name]:.1f} s" for name in sorted(lost, key=lambda name: lost[name])]


def upsets(document: Mapping[str, Any]) -> list[str]:
    """Who was beyond a limit that no fault explains: what, when first, and how often; in words."""
    found: dict[tuple[str, str], list[float]] = {}
    for event in document["events"]:
        what = event["text"].partition(":")[0]
        if event["level"] == "error" and what in UPSETS:
            found.setdefault((event["source"], what), []).append(event["time_s"])
    return [
        f"{name} {what} at {times[0]:.1f} s" + (f", {len(times)} × in all" if times[1:] else "")
        for (name, what), times in found.items()
    ]


def errors(document: Mapping[str, Any]) -> list[tuple[float, str]]:
    """What went wrong in flight: when, s, and of whom what; in order of time."""
    found = [each for each in document["events"] if each["level"] == "error"]
    return [(each["time_s"], f"{each['source']}: {each['text']}") for each in found]


def to_json(document: Mapping[str, Any]) -> str:
    """The document as text, keys in their own order.

    Raises:
        ValueError: A number is infinite or not a number, which JSON cannot say.
    """
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write the document beside its place, then put it there in one move.

    Raises:
        InputError: The folder is missing, full or not writable.
    """
    text = to_json(document)
    try:
        with replacing(path) as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"{path}: cannot write the metrics: {error.strerror}") from error


@contextmanager
def replacing(path: Path) -> Iterator[TextIO]:
    """A file to write that takes its place whole when the block ends well, and else is gone."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes files only the owner can read; the document is as public as its folder
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
