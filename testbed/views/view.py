"""The observer that shows a run: in a live viewer on this machine, an .rrd file, or memory.

A live viewer is fed by a process of its own, `feeder_process`, because Rerun's client blocks for
ever when a viewer freezes, and for seconds when one is closed. The run writes batches to a pipe;
batches that the feeding process does not take in time are dropped from the view.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from testbed.core.errors import describe_error, memory_shortage
from testbed.core.files import check_writable, write_file
from testbed.core.records import Event, RunInfo, Sample
from testbed.views.sample_columns import Collector, ViewBatch
from testbed.views.scene import Scene, scene_of
from testbed.views.viewer import HOST, PORT, unavailable_reason

if TYPE_CHECKING:
    from testbed.views.rerun_backend import RerunRecording


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
                log.warning("The view cannot be saved: %s", error.strerror or describe_error(error))
            self._sink = None

    def _send(self) -> None:
        assert self._sink is not None
        try:
            self._sink.send(self._collector.take())
        except Exception as error:  # no failure of a view may stop a run
            reason = memory_shortage(error) or describe_error(error)
            log.warning("The view stops here, the run goes on: %s", reason)
            self._sink = None


CLOSE_S = 0.5  # the longest wait for the view at the end of a live run
LOSSLESS_CLOSE_S = 60.0
QUEUE_BATCHES = 64  # half a minute of batches while a viewer starts
EXIT_REASONS = {  # by exit code of the feeding process
    10: "the viewer did not start; is there a working graphics driver?",
    11: "the viewer was closed or takes no more data",
}


class ViewSink(Protocol):
    """An open view."""

    def send(self, batch: ViewBatch) -> None:
        """Show consecutive samples."""

    def close(self) -> None:
        """Finish."""


class ViewTarget(Protocol):
    """A destination of views."""

    def open(self, scene: Scene) -> ViewSink | None:
        """Open a view of one run; None, after a warning, if there is no viewer."""


@dataclass(frozen=True, slots=True)
class LiveViewer:
    """A Rerun viewer on this machine, started if there is none.

    Attributes:
        port: of 127.0.0.1; no other address is used.
        lossless: wait for a slow viewer (a replay) instead of dropping samples (a live run).
        at_s: time at which the viewer's cursor is left, s; None: where the viewer puts it.
    """

    port: int = PORT
    lossless: bool = False
    at_s: float | None = None

    @property
    def address(self) -> str:
        """The viewer and its address in words."""
        return f"a Rerun viewer on {HOST}:{self.port}, which this machine alone reaches"

    def open(self, scene: Scene) -> ViewSink | None:
        """Start the process that feeds the viewer, or warn that there will be no view."""
        reason = unavailable_reason(self.port)
        if reason is not None:
            log.warning(
                "No live view, the run goes on without it: %s. Next time, `--view web` shows the "
                "flight in a browser, also on another machine. Afterwards `testbed view RUN --web` "
                "does, `testbed shot RUN --out FILE.png` makes a picture, and `testbed view RUN "
                "--rrd FILE.rrd` a recording for `rerun FILE.rrd` elsewhere.",
                reason,
            )
            return None
        return Feeder(scene, port=self.port, lossless=self.lossless, at_s=self.at_s)


@dataclass(frozen=True, slots=True)
class RrdFile:
    """A file that `rerun FILE` opens."""

    path: Path

    def open(self, scene: Scene) -> ViewSink:
        """Collect the view in memory; `close` writes the file.

        Raises:
            OSError: It cannot be written; also from `close`.
        """
        check_writable(self.path)
        return _RrdSink(scene, self.path)


class _RrdSink:
    """A recording in memory that becomes a file: Rerun only logs that it cannot write one."""

    def __init__(self, scene: Scene, path: Path) -> None:
        from testbed.views.rerun_backend import RerunRecording

        self._path = path
        self._recording = RerunRecording(scene, live=False)
        self._recording.open(None)

    def send(self, batch: ViewBatch) -> None:
        self._recording.send(batch)

    def close(self) -> None:
        with write_file(self._path) as file:
            file.write(self._recording.drain())
        self._recording.close()


@dataclass(slots=True)
class InMemory:
    """A recording in memory, for tests.

    Attributes:
        recording: of the last run; `recording.calls` counts calls of Rerun.
    """

    recording: RerunRecording | None = field(default=None, init=False)

    def open(self, scene: Scene) -> ViewSink:
        """Start a recording."""
        from testbed.views.rerun_backend import RerunRecording

        self.recording = RerunRecording(scene, live=False)
        self.recording.open(None)
        return self.recording


@dataclass(frozen=True, slots=True)
class Opening:
    """The first message to the feeding process."""

    scene: Scene
    live: bool
    at_s: float | None  # time at which the viewer's cursor is left, s


class Feeder:
    """The run's end of the pipe to the feeding process."""

    def __init__(
        self, scene: Scene, *, port: int, lossless: bool, at_s: float | None = None
    ) -> None:
        """Start the feeding process; returns at once."""
        self._lossless = lossless
        self._dropped = 0  # samples
        root = str(Path(__file__).parents[2])
        paths = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            # -P: a file in the current directory must not replace one of our modules
            [sys.executable, "-P", "-m", "testbed.views.feeder_process", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": paths, "RUST_LOG": "off"},
            start_new_session=True,  # Ctrl-C is for the run
        )
        self._queue: queue.Queue[ViewBatch | Opening | None] = queue.Queue(QUEUE_BATCHES)
        self._queue.put(Opening(scene, live=not lossless, at_s=at_s))
        self._thread = threading.Thread(target=self._write, name="view", daemon=True)
        self._thread.start()

    def send(self, batch: ViewBatch) -> None:
        """Queue a batch; drop it if the queue is full, unless lossless."""
        while self._thread.is_alive():
            try:
                self._queue.put(batch, timeout=0.2 if self._lossless else 0.0)
            except queue.Full:
                if self._lossless:
                    continue
                self._dropped += len(batch)
            return

    def close(self) -> None:
        """Wait a moment for the viewer to take the rest; the process then ends by itself."""
        deadline = time.monotonic() + (LOSSLESS_CLOSE_S if self._lossless else CLOSE_S)
        if self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=max(0.0, deadline - time.monotonic()))
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            log.info("The viewer is slow; it may miss the end of the flight.")
        if self._dropped:
            log.warning("The viewer was too slow: %d samples are not shown.", self._dropped)

    def _write(self) -> None:
        pipe = self.process.stdin
        assert pipe is not None
        try:
            with pipe:
                while (message := self._queue.get()) is not None:
                    pickle.dump(message, pipe, pickle.HIGHEST_PROTOCOL)
                    pipe.flush()
        except OSError:  # the process has ended; its exit code has the reason
            pass
        code = self.process.wait()
        if code != 0:
            reason = EXIT_REASONS.get(
                code, "the viewer is frozen, or the process that feeds it failed"
            )
            log.warning("The live view ends here, the run is not disturbed: %s", reason)
