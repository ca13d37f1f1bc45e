"""Row of a study: a run's outcome, and its metrics by name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

METRICS = "metrics."  # prefix of columns with numbers of metrics.json
SET = "set."  # prefix of columns with the keys that vary

# Metrics without a column: settings, texts and lists of varying length, and numbers that depend
# on the machine, on the wall clock or on external programs.
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
    ("expect", "bounds"),
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
    """Result of one run.

    Args:
        run: its number in the plan.
        outcome: one of `flight_task.OUTCOMES`.
        error: reason for any outcome but "completed", or the violated bounds of a completed run.
        metrics: numbers by name, as `windows.circles.mean_rms_m`; None for null.
    """

    run: int
    outcome: str
    error: str
    metrics: Numbers


def flatten_metrics(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the reproducible numbers of a metrics document, by name.

    A name is the keys joined by dots; elements of a list are counted from 0.
    """
    return dict(_leaves(metrics, ()))


def default_metric(names: Iterable[str]) -> tuple[str, ...]:
    """Return the name of the last window's mean RMS error, if any."""
    errors = [name for name in names if name.startswith("windows.") and name.endswith(_ERROR)]
    return tuple(errors[-1:])


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
