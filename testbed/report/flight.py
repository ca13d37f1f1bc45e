"""A run as the report needs it: log, numbers and page together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed.errors import InputError
from testbed.metrics import MetricsObserver
from testbed.record.read import Log, page_of, read_log, replay
from testbed.record.rundir import find_run
from testbed.scenario import Scenario
from testbed.state import Array, Truths

Numbers = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Flight:
    """A flown run of N aircraft and K frames, n = N − 1 of them followers."""

    path: Path  # of the log
    log: Log
    metrics: Numbers
    page: Scenario | None  # None: this version cannot read it any more

    @property
    def followers(self) -> tuple[str, ...]:
        """Their names (n,)."""
        return self.log.info.names[1:]

    @property
    def gone(self) -> Truths:
        """(K, n) followers that are lost, or whose leader is: they have no slot."""
        lost: Truths = self.log.lost[:, 1:] | self.log.lost[:, :1]
        return lost

    @property
    def error(self) -> Array:
        """‖q̃_i‖ (K, n), m; not a number for those that are gone."""
        error = np.sqrt(np.sum(self.log.formation.error_ned**2, axis=-1))
        return np.where(self.gone, np.nan, error)

    @property
    def outcome(self) -> str:
        """How it ended; a log that ends before its run does says so."""
        return str(self.metrics["outcome"] or "cut short")


def read_flight(run: str | Path) -> Flight:
    """Read a run, named as for `find_run`.

    The numbers are those that the log holds, which are those of metrics.json. Of a run that left
    none, because it was killed, they are counted again from the frames there are.

    Raises:
        LogError: there is no such run, or its log is damaged.
        InputError: it ended before its first frame.
    """
    path = find_run(run)
    log = read_log(path)
    if not log.tick.size:
        raise InputError(f"{path}: no frame was logged, so that there is nothing to report")
    page = page_of(log)
    return Flight(path, log, log.metrics or _counted(log, page), page)


def _counted(log: Log, page: Scenario | None) -> Numbers:
    published = page.scenario.published if page else None
    meter = MetricsObserver(published=published.model_dump() if published else None)
    return meter.summary(replay(log, [meter]))
