"""Two runs held against each other: their pages, their numbers, and where their aircraft were."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.errors import InputError
from testbed.record.read import Log
from testbed.record.times import Indices, shared_frames
from testbed.scenario import loads
from testbed.state import Array
from testbed.study.golden_page import differences
from testbed.study.golden_table import RULES, measure
from testbed.study.golden_words import row_name

# of the wall clock, or said elsewhere
_LEFT_OUT = ("wall_s", "real_time_factor", "pace", "mavlink", "events", "versions", "published")


@dataclass(frozen=True, slots=True)
class Pair:
    """A value of the metrics in both runs; None: null, or not there."""

    key: str  # portions/rectangles/rms_m/uav1
    first: Any
    second: Any

    def agrees(self, within: float) -> bool:
        """Whether the values are the same, or numbers no farther apart than this share."""
        if isinstance(self.first, bool) or isinstance(self.second, bool):
            return self.first is self.second
        if isinstance(self.first, int | float) and isinstance(self.second, int | float):
            return math.isclose(self.first, self.second, rel_tol=within)
        return bool(self.first == self.second)


@dataclass(frozen=True, slots=True)
class Apart:
    """How far an aircraft was from where it was in the other run, over the shared frames."""

    name: str
    largest_m: float | None  # None: never a number
    at_s: float
    first_s: float | None  # when anything of its motion first differed


@dataclass(frozen=True, slots=True)
class Difference:
    """What differs between two runs."""

    page: tuple[str, ...]  # a line for each key
    versions: tuple[str, ...]
    rows: tuple[tuple[str, Pair], ...]  # what people look at first, by label
    numbers: int  # compared
    moved: tuple[Pair, ...]  # those that do not agree
    frames: tuple[int, int]
    same_frames: bool  # every number of every frame, to the bit
    same_events: bool
    shared_s: Array  # (K,) times of the frames that both have
    apart: tuple[Apart, ...]  # over these frames
    within: float | None  # None: all has to be the same

    @property
    def same(self) -> bool:
        """Whether the runs agree: what `testbed compare --numbers` exits by."""
        exact = self.same_frames and self.same_events
        return not self.moved and (exact or self.within is not None)


def compare_runs(first: Log, second: Log, *, within: float | None = None) -> Difference:
    """Hold two runs against each other; what they ran on and how fast decides nothing.

    Args:
        first: a log with metrics.
        second: another.
        within: share of the larger by which metrics may differ; None: not at all, nor frames or
            events.

    Raises:
        InputError: a run was cut short, so that it has no metrics.
    """
    documents = [_metrics(log) for log in (first, second)]
    pairs = _pairs(*(_leaves(document) for document in documents))
    measured = [measure(document) for document in documents]
    i, j = shared_frames(first.time_s, second.time_s)
    return Difference(
        page=_pages_differ(first, second),
        versions=differences(first.info.versions, second.info.versions),
        rows=tuple((_label(pair.key), pair) for pair in _pairs(*measured)),
        numbers=len(pairs),
        moved=tuple(pair for pair in pairs if not pair.agrees(within or 0.0)),
        frames=(first.time_s.size, second.time_s.size),
        same_frames=_same(first, second),
        same_events=first.events == second.events,
        shared_s=first.time_s[i],
        apart=_apart(first, second, i, j),
        within=within,
    )


def _metrics(log: Log) -> Mapping[str, Any]:
    if log.metrics is None:
        raise InputError(
            f"{log.info.scenario_name}: this run has no metrics, for it was killed before its end"
        )
    return log.metrics


def _leaves(value: Any, path: str = "") -> dict[str, Any]:  # noqa: ANN401 - plain data
    """What stands at each key of nested maps and lists."""
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, Mapping):
        return {path: value}
    found: dict[str, Any] = {}
    for key, each in value.items():
        if path or key not in _LEFT_OUT:
            found |= _leaves(each, f"{path}/{key}" if path else str(key))
    return found


def _pairs(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Pair, ...]:
    keys = dict.fromkeys((*first, *second))
    return tuple(Pair(key, first.get(key), second.get(key)) for key in keys)


def _label(key: str) -> str:
    return f"{row_name(key)}, {RULES[key.split('/')[0]].unit}"


def _pages_differ(first: Log, second: Log) -> tuple[str, ...]:
    code = _code_differs(first.info.code, second.info.code)
    yaml = [log.info.scenario_yaml for log in (first, second)]
    if yaml[0] == yaml[1]:
        return code
    try:
        pages = [loads(text, look=False).model_dump(mode="json") for text in yaml]
    except InputError:
        return ("differs, but this version cannot read both pages", *code)
    return (*differences(*pages), *code)


def _code_differs(first: Mapping[str, bytes], second: Mapping[str, bytes]) -> tuple[str, ...]:
    """Of files of code that both pages name, those that are not the same."""
    shared = [name for name in first if name in second]
    return tuple(f"{name} is other code" for name in shared if first[name] != second[name])


def _same(first: Log, second: Log) -> bool:
    records = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")
    return (
        first.info.names == second.info.names
        and np.array_equal(first.time_s, second.time_s)
        and np.array_equal(first.lost, second.lost)
        and all(
            np.array_equal(ours, theirs, equal_nan=True)
            for name in records
            for ours, theirs in zip(getattr(first, name), getattr(second, name), strict=True)
        )
    )


def _apart(first: Log, second: Log, i: Indices, j: Indices) -> tuple[Apart, ...]:
    """Each aircraft of both runs, in the frames (K,) of either at the times of both."""
    time_s = first.time_s[i]
    if not time_s.size:
        return ()
    out = []
    for a, name in enumerate(first.info.names):
        if name not in second.info.names:
            continue
        b = second.info.names.index(name)
        other = np.zeros(time_s.size, dtype=bool)
        for ours, theirs in zip(first.truth, second.truth, strict=True):
            one, two = ours[i, a].reshape(time_s.size, -1), theirs[j, b].reshape(time_s.size, -1)
            other |= ((one != two) & ~(np.isnan(one) & np.isnan(two))).any(axis=1)
        offset = first.truth.position_ned[i, a] - second.truth.position_ned[j, b]
        distance = np.linalg.norm(offset, axis=-1)
        known = np.isfinite(distance)
        k = int(np.where(known, distance, -1.0).argmax())
        largest = float(distance[k]) if known[k] else None
        began = float(time_s[other.argmax()]) if other.any() else None
        out.append(Apart(name, largest, float(time_s[k]), began))
    return tuple(out)
