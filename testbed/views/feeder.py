"""A live viewer is fed from a process of its own, so that nothing it does reaches the run.

Rerun's client blocks for ever when a viewer freezes, and for seconds when one is gone. The run
hands its batches to a pipe; the process at the other end (`feeder_process`) finds or starts the
viewer and does the sending. What it cannot take is left out of the view.
"""

from __future__ import annotations

import logging
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from testbed.views.batch import Batch
from testbed.views.scene import Scene

CLOSE_S = 0.5  # the most a run waits for its view at the end
PATIENT_CLOSE_S = 60.0
QUEUE_BATCHES = 64  # half a minute of batches while a viewer starts
ENDINGS = {  # exit codes of the feeding process
    10: "the viewer did not start; is there a working graphics driver?",
    11: "the viewer was closed or takes no more data",
}
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Opening:
    """The first word to the process that feeds a viewer."""

    still: Scene
    live: bool
    at_s: float | None  # where the viewer's cursor is left, s


class Feeder:
    """The run's end of the pipe."""

    def __init__(
        self, still: Scene, *, port: int, patient: bool, at_s: float | None = None
    ) -> None:
        """Start the feeding process; returns at once."""
        self._patient = patient
        self._left_out = 0
        root = str(Path(__file__).parents[2])
        paths = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            # -P: a file in the current directory must not pass for one of our modules
            [sys.executable, "-P", "-m", "testbed.views.feeder_process", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": paths, "RUST_LOG": "off"},
            start_new_session=True,  # Ctrl-C is the run's to handle
        )
        self._queue: queue.Queue[Batch | Opening | None] = queue.Queue(QUEUE_BATCHES)
        self._queue.put(Opening(still, live=not patient, at_s=at_s))
        self._thread = threading.Thread(target=self._write, name="view", daemon=True)
        self._thread.start()

    def send(self, batch: Batch) -> None:
        """Queue a batch; a full queue leaves it out unless this feeder is patient."""
        while self._thread.is_alive():
            try:
                self._queue.put(batch, timeout=0.2 if self._patient else 0.0)
            except queue.Full:
                if self._patient:
                    continue
                self._left_out += len(batch)
            return

    def close(self) -> None:
        """Let the viewer have the rest, for a moment; the process then finishes by itself."""
        deadline = time.monotonic() + (PATIENT_CLOSE_S if self._patient else CLOSE_S)
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=max(0.0, deadline - time.monotonic()))
                break
            except queue.Full:
                break
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            log.info("The viewer is slow; it may miss the end of the flight.")
        if self._left_out:
            log.warning("The viewer was too slow: %d frames are not shown.", self._left_out)

    def _write(self) -> None:
        pipe = self.process.stdin
        assert pipe is not None
        try:
            with pipe:
                while (message := self._queue.get()) is not None:
                    pickle.dump(message, pipe, pickle.HIGHEST_PROTOCOL)
                    pipe.flush()
        except OSError:  # the process is gone; its exit code says why
            pass
        code = self.process.wait()
        if code != 0:
            reason = ENDINGS.get(
                code, "the viewer stands still, or the process that feeds it failed"
            )
            log.warning("The live view ends here, the run is not disturbed: %s", reason)
