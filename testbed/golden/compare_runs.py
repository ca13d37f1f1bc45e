"""Compare two runs: scenarios, metrics, samples, and the positions of their aircraft."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import InputError
from testbed.core.records import Array
from testbed.golden.golden_table import RULES, row_label, table_numbers
from testbed.logs.read import RunLog
from testbed.metrics.document_check import check_metrics
from testbed.metrics.model import Metrics
from testbed.metrics.side_effects import SideEffects, flight_numbers, side_effects, to_columns
from testbed.pool.scenario_snapshot import differences
from testbed.scenario import loads
from testbed.scenario.arguments import check_not_negative

# metrics that depend on the wall clock, or are compared separately
_LEFT_OUT = ("wall_s", "real_time_factor", "pace", "mavlink", "events", "versions", "published")


@dataclass(frozen=True, slots=True)
class MetricPair:
    """A metric of both runs; None: null, or missing."""

    key: str  # windows/rectangles/rms_m/uav1
    first: Any
    second: Any

    def agrees(self, tolerance: float) -> bool:
        """Return whether the values are equal, or numbers within a relative tolerance."""
        if isinstance(self.first, bool) or isinstance(self.second, bool):
            return self.first is self.second
        if isinstance(self.first, int | float) and isinstance(self.second, int | float):
            return math.isclose(self.first, self.second, rel_tol=tolerance)
        return bool(self.first == self.second)


@dataclass(frozen=True, slots=True)
class PositionDifference:
    """Distance between the positions of an aircraft in both runs, over the common samples."""

    name: str
    largest_m: float | None  # None: never a finite number
    at_s: float  # time of the largest
    first_s: float | None  # when any part of its motion first differed; None: never


@dataclass(frozen=True, slots=True)
class RunDifference:
    """Differences between two runs."""

    scenario: tuple[str, ...]  # a line for each key
    versions: tuple[str, ...]
    rows: tuple[tuple[str, MetricPair], ...]  # the numbers of golden tables, by label
    compared: int  # number of metrics
    differing: tuple[MetricPair, ...]
    sample_counts: tuple[int, int]
    same_samples: bool  # to the last bit
    same_events: bool
    shared_s: Array  # (K,) times of the common samples
    positions: tuple[PositionDifference, ...]
    tolerance: float | None  # relative, of metrics; None: runs must be equal to the last bit
    side_effects: SideEffects  # what is worse in the second run

    @property
    def same(self) -> bool:
        """Return whether the runs agree: the exit code of `testbed compare --numbers`."""
        exact = self.same_samples and self.same_events
        return not self.differing and (exact or self.tolerance is not None)


def compare_runs(first: RunLog, second: RunLog, *, tolerance: float | None = None) -> RunDifference:
    """Compare two runs; versions and durations on the wall clock are listed, but decide nothing.

    Args:
        first: a log with metrics.
        second: another.
        tolerance: by which metrics may differ, relative to the larger; None: metrics, samples and
            events must be equal.

    Raises:
        InputError: a run has no metrics, because it was killed; or the tolerance is wrong.
    """
    if tolerance is not None:
        check_not_negative("tolerance", tolerance)
    documents = [_metrics(log) for log in (first, second)]
    pairs = _pairs(*(_leaves(document) for document in documents))
    numbers = [table_numbers(document) for document in documents]
    # no tolerance: times are ticks over the base rate, equal ones are equal to the bit
    common: Any = np.intersect1d(first.time_s, second.time_s, return_indices=True)
    i, j = common[1:]
    return RunDifference(
        scenario=_scenario_differences(first, second),
        versions=differences(first.info.versions, second.info.versions),
        rows=tuple((_label(pair.key), pair) for pair in _pairs(*numbers)),
        compared=len(pairs),
        differing=tuple(pair for pair in pairs if not pair.agrees(tolerance or 0.0)),
        sample_counts=(first.time_s.size, second.time_s.size),
        same_samples=_same_samples(first, second),
        same_events=first.events == second.events,
        shared_s=first.time_s[i],
        positions=_position_differences(first, second, i, j),
        tolerance=tolerance,
        side_effects=run_side_effects(*documents),
    )


def run_side_effects(first: Metrics, second: Metrics) -> SideEffects:
    """Return what is worse in the second run, of one flight each."""
    one = np.zeros(1, dtype=np.int64)
    old, new = (to_columns([flight_numbers(each)]) for each in (first, second))
    return side_effects(old, new, one, one)


def _metrics(log: RunLog) -> Metrics:
    if log.metrics is None:
        raise InputError(
            f"{log.info.scenario_name}: this run has no metrics, because it was killed"
        )
    check_metrics(log.metrics, log.info, log.info.scenario_name)
    return log.metrics


def _leaves(value: Any, path: str = "") -> dict[str, Any]:  # noqa: ANN401 - plain data
    """Return the value at each key of nested maps and lists."""
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, Mapping):
        return {path: value}
    found: dict[str, Any] = {}
    for key, each in value.items():
        if path or key not in _LEFT_OUT:
            found |= _leaves(each, f"{path}/{key}" if path else str(key))
    return found


def _pairs(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[MetricPair, ...]:
    keys = dict.fromkeys((*first, *second))
    return tuple(MetricPair(key, first.get(key), second.get(key)) for key in keys)


def _label(key: str) -> str:
    return f"{row_label(key)}, {RULES[key.split('/')[0]].unit}"


def _scenario_differences(first: RunLog, second: RunLog) -> tuple[str, ...]:
    code = _code_differences(first.info.code, second.info.code)
    yaml = [log.info.scenario_yaml for log in (first, second)]
    if yaml[0] == yaml[1]:
        return code
    try:
        scenarios = [loads(text, check_files=False).model_dump(mode="json") for text in yaml]
    except InputError:
        return ("differs, but this version cannot read both scenarios", *code)
    for scenario in scenarios:  # published numbers do not affect the flight
        scenario["scenario"].pop("published")
    return (*differences(*scenarios), *code)


def _code_differences(first: Mapping[str, bytes], second: Mapping[str, bytes]) -> tuple[str, ...]:
    """List the code files of both runs whose content differs."""
    shared = [name for name in first if name in second]
    return tuple(f"code {name} differs" for name in shared if first[name] != second[name])


def _same_samples(first: RunLog, second: RunLog) -> bool:
    records = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")
    return (
        first.info.names == second.info.names
        and np.array_equal(first.time_s, second.time_s)
        and np.array_equal(first.lost, second.lost)
        and all(
            np.array_equal(own, other, equal_nan=True)
            for name in records
            for own, other in zip(getattr(first, name), getattr(second, name), strict=True)
        )
    )


def _position_differences(
    first: RunLog, second: RunLog, i: NDArray[np.intp], j: NDArray[np.intp]
) -> tuple[PositionDifference, ...]:
    """Compare positions in samples i (K,) of one run, j (K,) of another."""
    time_s = first.time_s[i]
    if not time_s.size:
        return ()
    out = []
    for a, name in enumerate(first.info.names):
        if name not in second.info.names:
            continue
        b = second.info.names.index(name)
        differs = np.zeros(time_s.size, dtype=bool)
        for own, other in zip(first.truth, second.truth, strict=True):
            one, two = own[i, a].reshape(time_s.size, -1), other[j, b].reshape(time_s.size, -1)
            differs |= ((one != two) & ~(np.isnan(one) & np.isnan(two))).any(axis=1)
        offset = first.truth.position_ned[i, a] - second.truth.position_ned[j, b]
        distance = np.linalg.norm(offset, axis=-1)
        finite = np.isfinite(distance)
        k = int(np.where(finite, distance, -1.0).argmax())
        largest = float(distance[k]) if finite[k] else None
        start = float(time_s[differs.argmax()]) if differs.any() else None
        out.append(PositionDifference(name, largest, float(time_s[k]), start))
    return tuple(out)
