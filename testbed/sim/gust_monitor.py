"""Report which aircraft discrete gusts have reached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.records import BoolArray, Event


class GustMonitor:
    """Report when a gust reaches an aircraft.

    Args:
        gusts: G names of gusts.
        names: N names of aircraft.
    """

    def __init__(self, gusts: Sequence[str], names: Sequence[str]) -> None:
        """See the class."""
        self._gusts, self._names = gusts, names
        self._active: BoolArray = np.zeros((len(gusts), len(names)), dtype=bool)

    def changes(self, now: float, active: BoolArray) -> Iterator[Event]:
        """Return an event for each gust that has reached an aircraft since the last call.

        Args:
            now: s
            active: (G, N) which gust acts on which aircraft now.
        """
        for gust, reached in zip(self._gusts, active & ~self._active, strict=True):
            if reached.all():
                yield Event(now, "info", "run", f"gust {gust} reaches all aircraft")
                continue
            for i in np.flatnonzero(reached).tolist():
                yield Event(now, "info", self._names[i], f"gust {gust} reaches it")
        self._active = active
