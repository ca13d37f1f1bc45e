"""A recorded run for its report: log, metrics and scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array, BoolArray
from testbed.logs.read import RunLog, read_log, replay, scenario_of, select_window
from testbed.logs.run_directory import find_run
from testbed.metrics.document_check import check_metrics
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver
from testbed.scenario import Scenario
from testbed.views.quantities import PLOTTED


@dataclass(frozen=True, slots=True)
class RunData:
    """A run of N aircraft and K samples; n = N − 1 of the aircraft are followers."""

    path: Path  # of the log
    log: RunLog  # the samples and events that figures draw
    metrics: Metrics  # of the whole run
    scenario: Scenario | None  # None: this version cannot read it
    part: str = ""  # of the run that figures draw, as "40 to 75 s"; "": all of it

    @property
    def followers(self) -> tuple[str, ...]:
        """Names of the followers (n,)."""
        return self.log.info.names[1:]

    @property
    def without_slot(self) -> BoolArray:
        """(K, n) whether a follower or the leader is lost, so that the follower has no slot."""
        lost: BoolArray = self.log.lost[:, 1:] | self.log.lost[:, :1]
        return lost

    @property
    def error(self) -> Array:
        """‖q̃_i‖ (K, n), m; NaN for followers without a slot."""
        return self.mask_lost(PLOTTED["error"].values(self.log))

    def mask_lost(self, values: Array) -> Array:
        """Set values (K, N) to NaN where an aircraft is lost, (K, n) where there is no slot."""
        every = values.shape[1] == len(self.log.info.names)
        return np.where(self.log.lost if every else self.without_slot, np.nan, values)

    @property
    def outcome(self) -> str:
        """Outcome of the run; "cut short" if its log ends before the run did."""
        return str(self.metrics["outcome"] or "cut short")


def read_run(
    run: str | Path, *, begin_s: float | None = None, end_s: float | None = None
) -> RunData:
    """Read the log of a run, named as for `find_run`.

    The metrics are those in the log, equal to metrics.json. A run that was killed left none; they
    are computed from the samples in its log.

    Args:
        run: as for `find_run`.
        begin_s: of the part that figures draw; None: the start.
        end_s: of the part that figures draw; None: the end.

    Raises:
        LogError: there is no such run, its log is damaged, or that part has no samples.
        InputError: the run ended before its first sample, or its metrics are of another shape.
    """
    path = find_run(run)
    log = read_log(path)
    if not log.tick.size:
        raise InputError(f"{path}: the log has no samples, so there is nothing to report")
    scenario = scenario_of(log)
    if log.metrics:
        check_metrics(log.metrics, log.info, str(path))
    metrics = log.metrics or _compute_metrics(log, scenario)
    if begin_s is None and end_s is None:
        return RunData(path, log, metrics, scenario)
    log = select_window(
        log, -math.inf if begin_s is None else begin_s, math.inf if end_s is None else end_s
    )
    part = f"{log.time_s[0]:g} to {log.time_s[-1]:g} s"
    return RunData(path, log, metrics, scenario, part)


def _compute_metrics(log: RunLog, scenario: Scenario | None) -> Metrics:
    observer = MetricsObserver(published=scenario.published if scenario else None)
    return observer.summary(replay(log, [observer]))
