"""Stretches of flight in which nobody tells the flight models anything.

Between two periods of the autopilots surfaces and air stay as they are, so that a flight model can
run to the next period in one go, which is cheaper than many short runs of models that are large.
What its motion was on the way is written down where somebody will ask for it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from testbed.state import Truths

LONGEST = 16  # legs that are flown in one go
# Of one aircraft: ticks, and the leg at whose end its motion is written down.
Parts: TypeAlias = tuple[tuple[int, int], ...]


class Leg(NamedTuple):
    """A part of such a stretch, up to the next moment at which anything happens."""

    ticks: int
    wanted: tuple[bool, ...] | None = None  # (N,) whose motion is asked for; None: everyone's


@lru_cache(maxsize=256)
def wanted_of(legs: tuple[Leg, ...], aircraft: int) -> Truths:
    """(legs, N) whose motion is asked for at the end of each; of the last leg everyone's."""
    everyone = (True,) * aircraft
    wanted = np.array([everyone if leg.wanted is None else leg.wanted for leg in legs])
    wanted[-1] = True
    return wanted


@lru_cache(maxsize=256)
def parts_of(legs: tuple[Leg, ...], rows: tuple[int, ...]) -> tuple[Parts, ...]:
    """What each of these aircraft runs through, one part after the other."""
    return tuple(_parts(legs, row) for row in rows)


def _parts(legs: tuple[Leg, ...], row: int) -> Parts:
    parts, ticks, last = [], 0, len(legs) - 1
    for number, leg in enumerate(legs):
        ticks += leg.ticks
        if number == last or leg.wanted is None or leg.wanted[row]:
            parts.append((ticks, number))
            ticks = 0
    return tuple(parts)


@lru_cache(maxsize=256)
def those_of(legs: tuple[Leg, ...], rows: tuple[int, ...]) -> tuple[Leg, ...]:
    """The same legs for some of the aircraft."""
    return tuple(
        Leg(ticks, wanted if wanted is None else tuple(wanted[row] for row in rows))
        for ticks, wanted in legs
    )
