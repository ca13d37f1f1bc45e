"""The numbers of a metrics document by name: the keys joined by dots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

# Settings, texts and lists of varying length, and numbers that depend on the machine, on the wall
# clock or on external programs.
_LEFT_OUT = (
    ("schema",),
    ("scenario",),
    ("seed",),
    ("versions",),
    ("engine",),
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
Numbers = Mapping[str, float | None]


def flatten_metrics(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the reproducible numbers of a metrics document, by name.

    A name is the keys joined by dots; elements of a list are counted from 0.
    """
    return dict(_leaves(metrics, ()))


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
