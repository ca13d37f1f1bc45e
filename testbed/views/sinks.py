"""Where a view goes: a viewer on this machine, an .rrd file, or memory for tests."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from testbed.views.batch import Batch
from testbed.views.scene import Scene

if TYPE_CHECKING:
    from testbed.views.rerun_door import Recording

PORT = 9876  # where a Rerun viewer listens unless told otherwise
log = logging.getLogger(__name__)


class Outlet(Protocol):
    """An opened sink."""

    def send(self, batch: Batch) -> None:
        """Take consecutive frames."""

    def close(self) -> None:
        """Finish."""


class Sink(Protocol):
    """A place for a view, not yet opened."""

    def open(self, still: Scene) -> Outlet | None:
        """Open it for one run; None if there is nothing to show it on, which was said."""


@dataclass(frozen=True, slots=True)
class LiveViewer:
    """The Rerun viewer that listens on a port of this machine, started if there is none.

    Attributes:
        port: of 127.0.0.1; nothing else is ever listened on or connected to.
        patient: wait for a slow viewer (a replay) instead of leaving frames out (a run).
        at_s: where its cursor is left, s; None: where the viewer puts it.
    """

    port: int = PORT
    patient: bool = False
    at_s: float | None = None

    @property
    def address(self) -> str:
        """Where it listens, in words."""
        from testbed.views.viewer import HOST

        return f"a Rerun viewer on {HOST}:{self.port}, which this machine alone reaches"

    def open(self, still: Scene) -> Outlet | None:
        """Start the process that feeds the viewer, or say why there will be no view."""
        from testbed.views.feeder import Feeder
        from testbed.views.viewer import obstacle

        trouble = obstacle(self.port)
        if trouble is not None:
            log.warning(
                "No live view, the run goes on without it: %s. Afterwards `testbed shot RUN --out "
                "FILE.png` makes a picture, and `testbed view RUN --rrd FILE.rrd` a recording for "
                "`rerun FILE.rrd` elsewhere.",
                trouble,
            )
            return None
        return Feeder(still, port=self.port, patient=self.patient, at_s=self.at_s)


@dataclass(frozen=True, slots=True)
class RrdFile:
    """A file that `rerun FILE` opens."""

    path: Path

    def open(self, still: Scene) -> Outlet:
        """Create the file.

        Raises:
            OSError: it cannot be written.
        """
        from testbed.views.rerun_door import Recording

        recording = Recording(still, live=False)
        recording.open(self.path)
        return recording


@dataclass(slots=True)
class InMemory:
    """Keeps the last run's recording in memory, for tests.

    Attributes:
        recording: of the run that was shown; `recording.calls` counts calls of Rerun.
    """

    recording: Recording | None = field(default=None, init=False)

    def open(self, still: Scene) -> Outlet:
        """Start a recording."""
        from testbed.views.rerun_door import Recording

        self.recording = Recording(still, live=False)
        self.recording.open(None)
        return self.recording
