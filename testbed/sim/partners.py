"""Programs outside that take part in a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from testbed.state import Event


class Stopped(Exception):
    """The run was to end while something outside was waited for."""


class Partner(Protocol):
    """Something outside that the run cannot go on without."""

    def check(self) -> None:
        """See that it can be had, before anything is begun or written.

        Raises:
            InputError: it cannot.
        """

    def begin(self, heed: Callable[[], None]) -> None:
        """Have it ready, before the first tick.

        Args:
            heed: called again and again in every wait for it, also in flight; raises `Stopped`
                when the run is to end.

        Raises:
            InputError: it is not to be had.
            Stopped: the run is to end.
        """

    def news(self, now: float) -> list[Event]:
        """What it said and did by itself since the last call; at the autopilot rate."""

    def summary(self) -> Mapping[str, Any]:
        """What took part, for the metrics: by name of an aircraft."""

    def close(self) -> None:
        """End what was begun, however far that came; once, however the run ends."""
