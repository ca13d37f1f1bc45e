"""External processes that fly aircraft of a run, as the ArduPlane adapter implements them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from testbed.core.records import Event


class ExternalProcess(Protocol):
    """A process that the run cannot fly without."""

    def check(self) -> None:
        """Check that the program exists, before anything is started or written.

        Raises:
            InputError: it does not.
        """

    def start(
        self, check_stop: Callable[[], None], announce: Callable[[str], None] = lambda text: None
    ) -> None:
        """Start it and wait until it is ready, before the first tick.

        Args:
            check_stop: called repeatedly in every wait for the process, also in flight; raises
                `RunStopped` when the run is to end.
            announce: receives messages to the user: ports, and a warning about open ones.

        Raises:
            InputError: it cannot be started.
            RunStopped: the run is to end.
        """

    def pop_events(self, now: float) -> list[Event]:
        """Return its messages and state changes since the last call; at the autopilot rate."""

    def summary(self) -> Mapping[str, Any]:
        """Describe the processes for the metrics, by name of the aircraft."""

    def close(self) -> None:
        """Stop what was started, however far that came; called once, however the run ends."""
