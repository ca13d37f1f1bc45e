"""A viewer that does as it is told."""

from __future__ import annotations

import math
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from testbed.views.rerun_door.blueprint import TIMELINE
from testbed.views.rerun_door.recording import address


class Remote:
    """One recording in the viewer on a port of this machine."""

    def __init__(self, port: int, recording_id: str) -> None:
        """Take hold of the viewer."""
        self._client = ViewerClient.connect(address(port))
        self._id = recording_id

    def stop_at(self, time_s: float, patience_s: float) -> None:
        """Wait until the recording reaches a time, s; move the viewer's cursor there and hold it.

        Raises:
            TimeoutError: it does not get there.
        """
        deadline = time.monotonic() + patience_s
        while (reached := self._reached()) < time_s - 1e-6:
            if time.monotonic() > deadline:
                raise TimeoutError(f"the viewer has {reached:g} s of {time_s:g} s")
            time.sleep(0.05)
        self._client.set_time(TIMELINE, duration=time_s, play_state="paused")

    def hide_menu(self) -> None:
        """Take the bar with the menu out of the window."""
        self._client.run_command("ui.toggle_top_panel")

    def draw(self) -> None:
        """Wait until the viewer has drawn, whatever it is."""
        self._client.take_screenshot(max_size=16)

    def picture(self, path: Path) -> list[str]:
        """Save what the viewer shows as PNG; what its views complain of."""
        self._client.save_screenshot(str(path.absolute()))
        views = self._client.get_state().views
        return [f"{view.name}: {report.summary}" for view in views for report in view.reports]

    def _reached(self) -> float:
        try:
            state = self._client.get_state()
        except TimeoutError:  # it waits for less than our patience
            return -math.inf
        ends = (
            line.end
            for recording in state.recordings
            if self._id in str(recording.store_id)
            for line in recording.timelines
            if line.name == TIMELINE and line.end is not None
        )
        return max((1e-9 * end for end in ends), default=-math.inf)
