"""Detect lost aircraft: on the ground, outside their flight model, or in a collision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.records import Array, BoolArray, Event
from testbed.sim.faults import FaultManager
from testbed.sim.proximity import ProximityMonitor
from testbed.vehicle.fleet import LOWEST


def _cause(position_ned: Array) -> str:
    """Describe why an aircraft at this position (3,) is lost."""
    if -position_ned[2] < LOWEST:
        return f"on the ground, at {-position_ned[2]:.1f} m"
    return "its motion is not finite, or outside the range of its flight model"


class LossMonitor:
    """Report aircraft that are lost, and whether the run ends.

    A run that continues completes if all lost aircraft had an active fault of the scenario.

    Attributes:
        lost: (N,) a new array when it changes, because observers keep the old one.
        terminate: the run ends now.
    """

    def __init__(
        self,
        names: Sequence[str],
        proximity: ProximityMonitor,
        faults: FaultManager | None,
        *,
        fly_on: bool,
    ) -> None:
        """Start without lost aircraft.

        Args:
            names: N aircraft.
            proximity: reports collisions.
            faults: of the scenario; None: it has none.
            fly_on: the run continues without lost aircraft.
        """
        self._names, self._proximity, self._faults = names, proximity, faults
        self._fly_on = fly_on
        self.lost: BoolArray = np.zeros(len(names), dtype=bool)
        self.terminate = False
        self._unexpected = False  # an aircraft without an active fault was lost
        self._last_down = self.lost.tobytes()

    def changes(self, now: float, position_ned: Array, down: BoolArray) -> list[Event]:
        """Return an event for each aircraft lost since the last call; update `lost`.

        Args:
            now: s.
            position_ned: (N, 3) m.
            down: (N,) on the ground, or outside their flight models.
        """
        bits = down.tobytes()
        if bits == self._last_down and not self._proximity.enabled:
            return []
        self._last_down = bits
        events = [
            Event(now, "error", self._names[row], f"lost: {_cause(position_ned[row])}")
            for row in np.flatnonzero(down & ~self.lost).tolist()
        ]
        faulty = self._faults.active if self._faults else None
        close, collided = self._proximity.changes(now, position_ned, self.lost | down, faulty)
        lost = self.lost | down | collided
        new = lost & ~self.lost
        if new.any():
            expected = self._faults.active if self._faults else self.lost
            self._unexpected |= bool((new & ~expected).any())
            self.lost = lost
            self.terminate = bool(lost.all()) or not self._fly_on
        return [*events, *close]

    @property
    def outcome(self) -> str:
        """Outcome of a run that has ended: "lost" or "completed"."""
        return "lost" if self.terminate or self._unexpected else "completed"
