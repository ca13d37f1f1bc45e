"""The observer that measures a run."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from testbed.core.records import Event, RunInfo, Sample
from testbed.core.samples import SampleBuffer
from testbed.metrics.accumulator import Accumulator, block_samples, make_block
from testbed.metrics.model import Metrics
from testbed.metrics.summary import summarise


class MetricsObserver:
    """Measure a run while it flies; `summary` can be called at any moment.

    Args:
        windows: span (start, end) in s by name, start inside and end outside. Default: those of
            the run.
        published: numbers published for this scenario, copied to the summary: `source`, `rms_m`,
            `mean_rms_m` and `percent_error` by window.
    """

    zero_copy = True  # holds no array of a sample
    takes_blocks = "metrics"

    def __init__(
        self,
        windows: Mapping[str, tuple[float, float]] | None = None,
        published: Mapping[str, Any] | None = None,
    ) -> None:
        """See the class."""
        self._own_windows = windows
        self._published = published
        self._info: RunInfo | None = None
        self._events: list[Event] = []
        self._buffer: SampleBuffer | None = None

    def share(self, aircraft: int) -> SampleBuffer:
        """See `BlockObserver`."""
        self._buffer = SampleBuffer(block_samples(aircraft), aircraft)
        return self._buffer

    def add_events(self, events: Sequence[Event]) -> None:
        """See `BlockObserver`."""
        self._events.extend(events)

    def take_block(self) -> None:
        """Accumulate the samples of the buffer, and empty it."""
        assert self._buffer is not None, "there is a buffer from `share` or `begin` on"
        buffer = self._buffer
        self._accumulator.accumulate(make_block(buffer.ticks, buffer.columns(), buffer.inexact))
        buffer.clear()

    def begin(self, info: RunInfo) -> None:
        """Allocate the accumulator and the rows of one block."""
        self._info = info
        self._windows = dict(info.windows if self._own_windows is None else self._own_windows)
        self._accumulator = Accumulator(
            self._windows,
            len(info.names) - 1,
            base_rate_hz=info.base_rate_hz,
            medium_ned=np.array(info.bounded_in_ned),
        )
        self._events = []
        if self._buffer is None:
            self.share(len(info.names))

    def reseed(self, seed: int) -> None:
        """Set the seed that the summary shows, after `begin`."""
        assert self._info is not None, "the run has begun"
        self._info = replace(self._info, seed=seed)

    def observe(self, sample: Sample) -> None:
        """Copy what is measured; accumulate the block when it is full."""
        buffer = self._buffer
        assert buffer is not None, "the run has begun"
        buffer.append(sample)
        self._events.extend(sample.events)
        if len(buffer) == buffer.capacity:
            self.take_block()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing: `summary` includes the samples of an incomplete block."""

    def summary(self, after: Sequence[Event] = ()) -> Metrics:
        """Summarise the samples observed so far, ready for JSON; the state does not change.

        Args:
            after: events since the last sample.

        Raises:
            RuntimeError: no run has begun.
        """
        if self._info is None or self._buffer is None:
            raise RuntimeError("there is nothing to summarise: begin() was not called")
        total, buffer = self._accumulator, self._buffer
        if len(buffer):
            total = copy.deepcopy(total)
            total.accumulate(make_block(buffer.ticks, buffer.columns(), buffer.inexact))
        return summarise(
            total,
            windows=self._windows,
            info=self._info,
            events=[*self._events, *after],
            published=self._published,
        )
