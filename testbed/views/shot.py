"""A picture of a recorded run at a moment, without a screen."""

from __future__ import annotations

import time
from pathlib import Path

from testbed.views.batch import parts, whole
from testbed.views.scene import scene_of
from testbed.views.view import BATCH_FRAMES, Replayable
from testbed.views.viewer import free_port, headless

SIZE = (1600, 900)  # pixels
LOADED_S = 60.0  # a long run on a slow machine
DRAWN_S = 1.0  # the viewer lays out and draws a few times, and does not say when it is done


class ViewTroubleError(RuntimeError):
    """A view of the viewer complains about what it was given: a fault of ours."""


def shoot(run: Replayable, at_s: float, path: Path, *, size: tuple[int, int] = SIZE) -> None:
    """Save what the viewer shows of a run.

    Args:
        run: a log.
        at_s: time within the run, s.
        path: of the PNG.
        size: width and height of the viewer's window, pixels.

    Raises:
        InputError: there is no viewer that draws without a screen.
        ViewTroubleError: a view complains; the picture is there all the same.
    """
    from testbed.views.rerun_door import Recording, Remote

    port, still = free_port(), scene_of(run.info)
    with headless(port, size):
        recording = Recording(still, live=False)
        recording.open(port)
        for part in parts(whole(run, run.events), BATCH_FRAMES):
            recording.send(part)
        recording.flush(LOADED_S)
        remote = Remote(port, still.recording_id)
        remote.stop_at(at_s, LOADED_S)
        time.sleep(DRAWN_S)
        complaints = remote.picture(path)
        recording.close()
    if complaints:
        raise ViewTroubleError(f"{path}: views complain: {'; '.join(complaints)}")
