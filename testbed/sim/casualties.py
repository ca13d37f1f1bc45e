"""Who is lost: on the ground, beyond what a flight model can do, or collided."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.sim.breakdowns import Breakdowns
from testbed.sim.limits import Proximity
from testbed.state import Array, Event, Truths
from testbed.vehicle.ideal import LOWEST


def _cause(position_ned: Array) -> str:
    """Why an aircraft at this place (3,) moves no more."""
    if -position_ned[2] < LOWEST:
        return f"on the ground, at {-position_ned[2]:.1f} m"
    return "its motion was no longer a number, or beyond what its flight model can do"


class Casualties:
    """Remembers who of N aircraft is lost, and what the run makes of it.

    An aircraft of which the page has broken something may be lost while it is broken: a run that
    flies on without it has flown.
    """

    def __init__(
        self,
        names: Sequence[str],
        proximity: Proximity,
        breakdowns: Breakdowns | None,
        *,
        fly_on: bool,
    ) -> None:
        """Nobody is lost yet; breakdowns: of the page; fly_on: the run goes on without the lost."""
        self._names, self._proximity, self._fly_on = names, proximity, fly_on
        self._breakdowns = breakdowns
        self.gone: Truths = np.zeros(len(names), dtype=bool)
        self.over = False  # the run ends here
        self._unforeseen = False
        self._told = self.gone.tobytes()  # who was down at the last look

    def changes(self, now: float, position_ned: Array, down: Truths) -> list[Event]:
        """What has happened since the last call, in events; `gone` follows.

        Args:
            now: s
            position_ned: (N, 3) m
            down: (N,) on the ground, or beyond what their flight models can do.
        """
        told = down.tobytes()
        if told == self._told and not self._proximity.watches:
            return []
        self._told = told
        events = [
            Event(now, "error", self._names[row], f"lost: {_cause(position_ned[row])}")
            for row in np.flatnonzero(down & ~self.gone).tolist()
        ]
        close, collided = self._proximity.changes(now, position_ned, self.gone | down)
        gone = self.gone | down | collided
        new = gone & ~self.gone
        if new.any():
            foreseen = self._breakdowns.broken if self._breakdowns else self.gone
            self._unforeseen |= bool((new & ~foreseen).any())
            self.gone = gone  # a new array: observers keep the old one
            self.over = bool(gone.all()) or not self._fly_on
        return [*events, *close]

    @property
    def outcome(self) -> str:
        """How a run has ended that came to its end: "lost" or "flown"."""
        return "lost" if self.over or self._unforeseen else "flown"
