"""Control a running viewer."""

from __future__ import annotations

import math
import time

from rerun.experimental import ViewerClient

from testbed.views.rerun_backend.blueprint import TIMELINE
from testbed.views.rerun_backend.recording import address


class RemoteViewer:
    """One recording in the viewer on a port of this machine."""

    def __init__(self, port: int, recording_id: str) -> None:
        self._client = ViewerClient.connect(address(port))
        self._id = recording_id

    def pause_at(self, time_s: float, timeout_s: float) -> None:
        """Wait until the recording reaches a time, s, and hold the viewer's cursor there.

        Raises:
            TimeoutError: The recording does not reach it.
        """
        deadline = time.monotonic() + timeout_s
        while (reached := self._reached()) < time_s - 1e-6:
            if time.monotonic() > deadline:
                raise TimeoutError(f"the viewer has {reached:g} s of {time_s:g} s")
            time.sleep(0.05)
        self._client.set_time(TIMELINE, duration=time_s, play_state="paused")

    def hide_menu(self) -> None:
        """Hide the menu bar."""
        self._client.run_command("ui.toggle_top_panel")

    def wait_until_drawn(self, timeout_s: float) -> None:
        """Wait until the viewer has drawn once.

        Raises:
            TimeoutError: It has not drawn in this time, s.
        """
        self._draw(timeout_s, max_size=16)

    def screenshot(self, timeout_s: float) -> tuple[bytes, list[str]]:
        """Return what the viewer shows as PNG, and the errors that its views report.

        Raises:
            TimeoutError: It has not drawn in this time, s.
        """
        picture = self._draw(timeout_s)
        views = self._client.get_state().views
        return picture, [
            f"{view.name}: {report.summary}" for view in views for report in view.reports
        ]

    def _draw(self, timeout_s: float, max_size: int | None = None) -> bytes:
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return self._client.take_screenshot(max_size=max_size)
            except TimeoutError:  # the client's timeout is shorter than ours
                if time.monotonic() > deadline:
                    raise

    def _reached(self) -> float:
        try:
            state = self._client.get_state()
        except TimeoutError:  # the client's timeout is shorter than ours
            return -math.inf
        ends = (
            line.end
            for recording in state.recordings
            if self._id in str(recording.store_id)
            for line in recording.timelines
            if line.name == TIMELINE and line.end is not None
        )
        return max((1e-9 * end for end in ends), default=-math.inf)
