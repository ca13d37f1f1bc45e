"""The process that feeds a viewer: `python -m testbed.views.feeder_process PORT`, from a pipe.

It reads eagerly, so that a run never waits while a viewer starts, and ends by itself: when the
pipe is closed and all was sent, when the viewer is gone, or when it is frozen.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import queue
import sys
import threading
from typing import Any, BinaryIO

from testbed.views.viewer import listening, start

FLUSH_S = 10.0  # a viewer that takes longer for one batch is frozen
HELD_BATCHES = 256  # in memory while the viewer is slow; then the pipe stands still
NO_VIEWER, VIEWER_GONE = 10, 11


def read(pipe: BinaryIO, into: queue.Queue[Any]) -> None:
    """Move everything from the pipe to the queue; None at its end."""
    try:
        while True:
            into.put(pickle.load(pipe))
    except (EOFError, pickle.UnpicklingError):  # also when the run was killed half way
        into.put(None)


def feed(port: int) -> int:
    """Send what the pipe brings to the viewer at `port`; the exit code."""
    messages: queue.Queue[Any] = queue.Queue(HELD_BATCHES)
    threading.Thread(target=read, args=(sys.stdin.buffer, messages), daemon=True).start()
    if not listening(port) and not start(port):
        return NO_VIEWER
    from testbed.views.rerun_door import Recording, Remote

    opening = messages.get()
    recording = Recording(opening.still, live=opening.live)
    recording.open(port)
    with open(os.devnull, "w") as nowhere:
        while (batch := messages.get()) is not None:
            # The client can block where no Python code runs: only this ends the process then.
            faulthandler.dump_traceback_later(2.0 * FLUSH_S, exit=True, file=nowhere)
            try:
                recording.send(batch)
                recording.flush(FLUSH_S)
            except RuntimeError:
                return VIEWER_GONE
            faulthandler.cancel_dump_traceback_later()
        if opening.at_s is not None:
            faulthandler.dump_traceback_later(2.0 * FLUSH_S, exit=True, file=nowhere)
            Remote(port, opening.still.recording_id).stop_at(opening.at_s, FLUSH_S)
    return 0


if __name__ == "__main__":
    # Without Rerun's own farewell, which waits for viewers that are gone.
    os._exit(feed(int(sys.argv[1])))
