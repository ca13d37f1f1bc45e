"""A picture of recorded runs at a moment, without a screen."""

from __future__ import annotations

import time
from pathlib import Path

from testbed.views.replay import Recorded, send, shown
from testbed.views.viewer import headless

SIZE = (1600, 900)  # pixels
LOADED_S = 60.0  # a long run on a slow machine
LIMIT_S = 120.0  # for all of it
DRAWN_S = 1.0  # the viewer lays out and draws a few times, and does not say when it is done
GREETED_S = 6.0  # for so long after it first draws it tells people in a corner that it listens


class ViewTroubleError(RuntimeError):
    """A view of the viewer complains about what it was given: a fault of ours."""


def shoot(
    path: Path,
    at_s: float,
    first: Recorded,
    second: Recorded | None = None,
    *,
    size: tuple[int, int] = SIZE,
) -> None:
    """Save what the viewer shows of a run, or of two over one another.

    Args:
        path: of the PNG.
        at_s: a time that the runs have, s.
        first: a log.
        second: another one.
        size: width and height of the viewer's window, pixels.

    Raises:
        InputError: two runs have no time in common, or there is no viewer that draws without a
            screen.
        ViewTroubleError: a view complains; the picture is there all the same.
    """
    from testbed.views.rerun_door import Recording, Remote

    still, batch = shown(first, second)
    with headless(size, limit_s=LIMIT_S) as port:
        remote = Remote(port, still.recording_id)
        remote.draw()
        greeted = time.monotonic() + GREETED_S
        recording = Recording(still, live=False, at_s=at_s)
        recording.open(port)
        send(recording, batch)
        recording.flush(LOADED_S)
        remote.stop_at(at_s, LOADED_S)
        remote.hide_menu()
        time.sleep(max(DRAWN_S, greeted - time.monotonic()))
        complaints = remote.picture(path)
        recording.close()
    if complaints:
        raise ViewTroubleError(f"{path}: views complain: {'; '.join(complaints)}")
