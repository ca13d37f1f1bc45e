"""A run of a study as one row: what it was, how it ended, and its numbers by name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from testbed.study.crew import FAILED, FLOWN, LOST, REFUSED, UPSET

METRICS = "metrics."  # before the name of a number of metrics.json
SET = "set."  # before a key that varies
OUTCOMES = (FLOWN, LOST, UPSET, FAILED, REFUSED)

# What is not of the flight but of the page, the machine or the moment; what has as many numbers
# as there are links, or keys of its own in each run; and words.
_LEFT_OUT = (
    ("schema",),
    ("scenario",),
    ("seed",),
    ("versions",),
    ("outcome",),
    ("wall_s",),
    ("real_time_factor",),
    ("published",),
    ("events",),
    ("pace",),
    ("mavlink",),
    ("arduplane",),
    ("commanded",),
    ("min_separation_between",),
    ("network", "links"),
    ("network", "all", "bursts", "lengths"),
)
_ERROR = ".mean_rms_m"
Numbers = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Row:
    """What came of one run.

    Args:
        run: its number in the plan.
        outcome: one of `OUTCOMES`.
        error: what went wrong; empty where nothing did.
        metrics: numbers by name, as `portions.circles.mean_rms_m`; None where there is none.
    """

    run: int
    outcome: str
    error: str
    metrics: Numbers


def flatten(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """The numbers of a metrics document that are the same on every machine, by their path.

    Keys are joined by dots; numbers in a list are counted from 0. What is no number is left out.
    """
    return dict(_leaves(metrics, ()))


def last_error(names: Iterable[str]) -> tuple[str, ...]:
    """The mean RMS error of the last portion, if there is one: shown where a page names nothing."""
    ours = [name for name in names if name.startswith("portions.") and name.endswith(_ERROR)]
    return tuple(ours[-1:])


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, float | None]]:  # noqa: ANN401
    if path in _LEFT_OUT:
        return
    if isinstance(value, Mapping):
        for key, child in value.items():
            yield from _leaves(child, (*path, str(key)))
    elif isinstance(value, list | tuple):
        for index, child in enumerate(value):
            yield from _leaves(child, (*path, str(index)))
    elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        yield ".".join(path), None if value is None or not math.isfinite(value) else float(value)
