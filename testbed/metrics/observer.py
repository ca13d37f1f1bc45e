"""The observer that measures a run."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.records import Event, RunInfo
from testbed.core.samples import BlockObserver
from testbed.metrics.accumulator import Accumulator, make_block
from testbed.metrics.final_bounds import is_violated
from testbed.metrics.model import Metrics
from testbed.metrics.summary import summarise


class MetricsObserver(BlockObserver):
    """Measure a run while it flies; `summary` can be called at any moment.

    Args:
        windows: span (start, end) in s by name, start inside and end outside. Default: those of
            the run.
        published: numbers published for this scenario, copied to the summary: `source`, `rms_m`,
            `mean_rms_m` and `percent_error` by window.
        stop_at: bounds as of `expect`; the flight ends when one is violated whatever follows.
    """

    def __init__(
        self,
        windows: Mapping[str, tuple[float, float]] | None = None,
        published: Mapping[str, Any] | None = None,
        stop_at: Mapping[str, Any] | None = None,
    ) -> None:
        self._own_windows = windows
        self._published = published
        self._stop_at = stop_at
        self._info: RunInfo | None = None
        self._events: list[Event] = []

    def add_events(self, events: Sequence[Event]) -> None:
        """See `BlockObserver`."""
        self._events.extend(events)

    def take_block(self) -> None:
        """Accumulate the new samples of the buffer."""
        if self._accumulator.is_empty and self._earlier is not None:
            self._accumulator.precede(make_block(self._earlier))
        self._accumulator.add(make_block(self._take()))
        if self._stop_at and self._info is not None:
            self.ends_flight = is_violated(
                self._accumulator, self._windows, self._info, self._stop_at
            )

    def begin(self, info: RunInfo) -> None:
        """Allocate the accumulator."""
        self._info = info
        self._windows = dict(info.windows if self._own_windows is None else self._own_windows)
        self._accumulator = Accumulator(
            self._windows,
            len(info.names) - 1,
            base_rate_hz=info.base_rate_hz,
            sample_rate_hz=info.sample_rate_hz,
            medium_ned=np.array(info.bounded_in_ned),
        )
        self._events = []
        self.ends_flight = False
        self._begin_blocks(info)

    def reseed(self, seed: int) -> None:
        """Set the seed that the summary shows, after `begin`."""
        assert self._info is not None, "the run has begun"
        self._info = replace(self._info, seed=seed)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing: `summary` includes the samples of an incomplete block."""

    def summary(self, after: Sequence[Event] = ()) -> Metrics:
        """Summarise the samples observed so far, ready for JSON; more may follow.

        Args:
            after: events since the last sample.

        Raises:
            RuntimeError: no run has begun.
        """
        if self._info is None:
            raise RuntimeError("there is nothing to summarise: begin() was not called")
        self.take_block()
        total = copy.deepcopy(self._accumulator)
        total.finish()
        return summarise(
            total,
            windows=self._windows,
            info=self._info,
            events=[*self._events, *after],
            published=self._published,
        )
