"""Stretches of flight in which nobody tells the flight models anything.

Between two periods of the autopilots surfaces and air stay as they are, so that a flight model can
run to the next period in one go, which is cheaper than many short runs of models that are large.
What its motion was on the way is written down where somebody will ask for it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from testbed.state import Truths

LONGEST = 16  # legs that are flown in one go


class Leg(NamedTuple):
    """A part of such a stretch, up to the next moment at which anything happens."""

    ticks: int
    wanted: tuple[bool, ...] | None = None  # (N,) whose motion is asked for; None: everyone's


class Program(NamedTuple):
    """What N flight models have to do for some legs."""

    asked: Truths  # (legs, N) whose motion is asked for at the end of each
    # of each aircraft, one after the other: ticks, and the leg at whose end it is written down
    parts: tuple[tuple[tuple[int, int], ...], ...]


@lru_cache(maxsize=1024)
def program(legs: tuple[Leg, ...], aircraft: int) -> Program:
    """The program of at most LONGEST legs; at the end of the last everyone is written down."""
    everyone = (True,) * aircraft
    asked = np.array([everyone if leg.wanted is None else leg.wanted for leg in legs])
    asked[-1] = True
    ends = np.cumsum([leg.ticks for leg in legs])
    parts = []
    for row in asked.T:
        (at,) = row.nonzero()
        parts.append(tuple(zip(np.diff(ends[at], prepend=0).tolist(), at.tolist(), strict=True)))
    return Program(asked, tuple(parts))


@lru_cache(maxsize=1024)
def those_of(legs: tuple[Leg, ...], rows: tuple[int, ...]) -> tuple[Leg, ...]:
    """The same legs for some of the aircraft."""
    return tuple(
        Leg(ticks, wanted if wanted is None else tuple(wanted[row] for row in rows))
        for ticks, wanted in legs
    )
