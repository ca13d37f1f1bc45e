"""The observer that shows a run."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from testbed.state import Event, Frame, RunInfo
from testbed.views.batch import Collector
from testbed.views.scene import scene_of
from testbed.views.sinks import LiveViewer, Outlet, Sink

PERIOD_S = 0.5  # wall clock between batches
BATCH_FRAMES = 1000  # at most in a batch: a fast run may reach it before the period is over
# Of a flight that is faster than anyone looks: frames per simulated second, and its period, s. Each
# batch costs its calls of Rerun, however few frames it holds.
FAST_HZ, FAST_PERIOD_S = 12.5, 1.0
log = logging.getLogger(__name__)


class RerunView:
    """An observer that streams a run to a sink in batches.

    Trouble with the sink after the run has begun is one warning of the logger `testbed.views`; the
    run goes on without the view.
    """

    borrows = True  # a frame is copied at once

    def __init__(self, sink: Sink | None = None, *, most_hz: float | None = None) -> None:
        """Show runs in `sink`: by default a viewer on this machine, found or started.

        Args:
            sink: where it is shown.
            most_hz: frames per simulated second that are shown at most, Hz: `FAST_HZ` for a flight
                that nobody paces; None shows every frame of the log. Every event is shown.
        """
        self._sink: Sink = sink or LiveViewer()
        self._most_hz = most_hz
        self._period_s = PERIOD_S if most_hz is None else FAST_PERIOD_S
        self._outlet: Outlet | None = None

    def begin(self, info: RunInfo) -> None:
        """Open the sink.

        Raises:
            OSError: an .rrd file cannot be written. A missing viewer raises nothing.
        """
        wanted = self._most_hz or info.frame_rate_hz
        self._stride = max(1, round(info.frame_rate_hz / wanted))
        self._until_next = 0  # frames
        shown_hz = info.frame_rate_hz / self._stride
        self._outlet = self._sink.open(replace(scene_of(info), frame_rate_hz=shown_hz))
        self._collector = Collector(BATCH_FRAMES)
        self._due = time.perf_counter() + self._period_s

    def observe(self, frame: Frame) -> None:
        """Copy one frame of each stride; now and then pass a batch on."""
        if self._outlet is None:
            return
        if self._until_next:
            self._until_next -= 1
            if frame.events:
                self._collector.add_events(frame.events)
            return
        self._until_next = self._stride - 1
        self._collector.add(frame)
        if self._collector.full or time.perf_counter() >= self._due:
            self._pass_on()
            self._due = time.perf_counter() + self._period_s

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Pass on what is left and close the sink; a live viewer costs less than a second."""
        if self._outlet is None:
            return
        self._collector.add_events(events)
        self._pass_on()
        if self._outlet is not None:
            self._outlet.close()
            self._outlet = None

    def _pass_on(self) -> None:
        assert self._outlet is not None
        try:
            self._outlet.send(self._collector.take())
        except Exception as error:  # whatever is wrong with a view, the flight is not to blame
            log.warning("The view stops here, the run goes on: %s", error)
            self._outlet = None
