"""The observer that shows a run."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from testbed.core.records import Event, RunInfo, Sample
from testbed.views.batch import Collector
from testbed.views.scene import scene_of
from testbed.views.sinks import LiveViewer, ViewSink, ViewTarget

PERIOD_S = 0.5  # wall time between batches
BATCH_SAMPLES = 1000  # at most in a batch: a fast run may reach it within the period
# For runs faster than real time: samples per simulated second, and the period, s. Each batch costs
# a fixed number of Rerun calls.
FAST_HZ, FAST_PERIOD_S = 12.5, 1.0
log = logging.getLogger(__name__)


class RerunView:
    """Show a run in batches.

    If the view fails after the run has started, the logger `testbed.views` warns once and the run
    goes on without the view.
    """

    zero_copy = True  # copies what it needs

    def __init__(
        self,
        target: ViewTarget | None = None,
        *,
        max_hz: float | None = None,
        follow: str | None = None,
    ) -> None:
        """Choose where and how often to show a run.

        Args:
            target: by default a viewer on this machine, found or started.
            max_hz: shown samples per simulated second, at most; `FAST_HZ` suits runs faster than
                real time. None: every sample of the log. Every event is shown.
            follow: name of the aircraft that the first camera stays near; None: it keeps all
                aircraft in sight.
        """
        self._follow = follow
        self._target: ViewTarget = target or LiveViewer()
        self._max_hz = max_hz
        self._period_s = PERIOD_S if max_hz is None else FAST_PERIOD_S
        self._sink: ViewSink | None = None

    def begin(self, info: RunInfo) -> None:
        """Open the view.

        Raises:
            OSError: An .rrd file cannot be written. A missing viewer is a warning.
        """
        wanted_hz = self._max_hz or info.sample_rate_hz
        self._stride = max(1, round(info.sample_rate_hz / wanted_hz))
        self._skip = 0  # samples until the next shown one
        shown_hz = info.sample_rate_hz / self._stride
        self._sink = self._target.open(
            replace(scene_of(info, self._follow), sample_rate_hz=shown_hz)
        )
        self._collector = Collector(BATCH_SAMPLES)
        self._next_send = time.perf_counter() + self._period_s

    def observe(self, sample: Sample) -> None:
        """Copy one sample of each stride; send a batch after each period."""
        if self._sink is None:
            return
        if self._skip:
            self._skip -= 1
            if sample.events:
                self._collector.add_events(sample.events)
            return
        self._skip = self._stride - 1
        self._collector.add(sample)
        if self._collector.full or time.perf_counter() >= self._next_send:
            self._send()
            self._next_send = time.perf_counter() + self._period_s

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Send the rest and close the view; a live viewer delays this by less than a second."""
        if self._sink is None:
            return
        self._collector.add_events(events)
        self._send()
        if self._sink is not None:
            try:
                self._sink.close()
            except OSError as error:  # no failure of a view may stop a run
                log.warning("The view cannot be saved: %s", error.strerror or error)
            self._sink = None

    def _send(self) -> None:
        assert self._sink is not None
        try:
            self._sink.send(self._collector.take())
        except Exception as error:  # no failure of a view may stop a run
            log.warning("The view stops here, the run goes on: %s", error)
            self._sink = None
