"""The speeds at which an aircraft flies level: trims from the slowest to the fastest.

The slowest level flight has the wing at its largest lift or a control at its end; the fastest has
full throttle. Both are found to 2 % by halving. A glider descends at each speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from testbed.core.records import NedOrigin
from testbed.vehicle.jsbsim_adapter import airframe, trim_aircraft
from testbed.vehicle.trim import TrimError, TrimResult

_GROWTH = 1.2  # from one speed to the next
_LEAST, _MOST = 0.3, 3.0  # of the cruise: the search ends there
_HALVINGS = 3  # of a step: 2 %


@dataclass(frozen=True, slots=True)
class Envelope:
    """Trims of level flight in the order of their speeds; at least the cruise."""

    trims: tuple[TrimResult, ...]
    cruise: TrimResult

    @property
    def lowest(self) -> float:
        """The slowest level flight, m/s, true."""
        return self.trims[0].point.airspeed

    @property
    def highest(self) -> float:
        """The fastest level flight, m/s, true."""
        return self.trims[-1].point.airspeed

    @property
    def glides(self) -> bool:
        """Whether the aircraft has no engine: what is level of others is a descent."""
        return not self.cruise.has_engine


def find_envelope(
    folder: Path,
    cruise: TrimResult,
    origin: NedOrigin,
) -> Envelope:
    """Find the slowest and the fastest level flight of the aircraft in a folder.

    Args:
        folder: of the aircraft.
        cruise: a trim, from which the search begins.
        origin: of the trims.
    """
    stall = airframe(folder).stall_angle
    found = [cruise]

    def flies(airspeed: float) -> bool:
        point = replace(cruise.point, airspeed=airspeed)
        try:
            result = trim_aircraft(folder, point, origin)
        except TrimError:
            return False
        if result.alpha > stall:
            return False
        found.append(result)
        return True

    for factor in (1.0 / _GROWTH, _GROWTH):
        good = cruise.point.airspeed
        while _LEAST <= good * factor / cruise.point.airspeed <= _MOST:
            if not flies(good * factor):
                bad = good * factor
                for _ in range(_HALVINGS):
                    middle = math.sqrt(good * bad)
                    good, bad = (middle, bad) if flies(middle) else (good, middle)
                break
            good *= factor
    return Envelope(tuple(sorted(found, key=lambda each: each.point.airspeed)), cruise)
