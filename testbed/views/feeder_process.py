"""The process that feeds a viewer from a pipe: `python -m testbed.views.feeder_process PORT`.

It reads ahead, so that a run never waits while a viewer starts. It ends when the pipe is closed
and everything was sent, when the viewer was closed, or when the viewer is frozen.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import queue
import sys
import threading
from typing import Any, BinaryIO

from testbed.views.viewer import is_listening, start_viewer

FLUSH_S = 10.0  # a viewer that needs longer for one batch is frozen
QUEUE_BATCHES = 256  # in memory while the viewer is slow; then the pipe fills up
NO_VIEWER, VIEWER_CLOSED = 10, 11  # exit codes


def read_messages(pipe: BinaryIO, messages: queue.Queue[Any]) -> None:
    """Move messages from the pipe to the queue, and None at its end."""
    try:
        while True:
            messages.put(pickle.load(pipe))
    except (EOFError, pickle.UnpicklingError):  # also when the run was killed within a message
        messages.put(None)


def feed(port: int) -> int:
    """Send the batches from standard input to the viewer at `port`; return the exit code."""
    messages: queue.Queue[Any] = queue.Queue(QUEUE_BATCHES)
    threading.Thread(target=read_messages, args=(sys.stdin.buffer, messages), daemon=True).start()
    if not is_listening(port) and not start_viewer(port):
        return NO_VIEWER
    from testbed.views.rerun_backend import RemoteViewer, RerunRecording

    opening = messages.get()
    recording = RerunRecording(opening.scene, live=opening.live)
    recording.open(port)
    with open(os.devnull, "w") as null:
        while (batch := messages.get()) is not None:
            # the client can block outside Python, where only this ends the process
            faulthandler.dump_traceback_later(2.0 * FLUSH_S, exit=True, file=null)
            try:
                recording.send(batch)
                recording.flush(FLUSH_S)
            except RuntimeError:
                return VIEWER_CLOSED
            faulthandler.cancel_dump_traceback_later()
        if opening.at_s is not None:
            faulthandler.dump_traceback_later(2.0 * FLUSH_S, exit=True, file=null)
            RemoteViewer(port, opening.scene.recording_id).pause_at(opening.at_s, FLUSH_S)
    return 0


if __name__ == "__main__":
    # without Rerun's exit handler, which waits for viewers that were closed
    os._exit(feed(int(sys.argv[1])))
