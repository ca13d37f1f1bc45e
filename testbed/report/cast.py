"""Who is drawn how: each follower by itself, or of many the worst over a band of all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.report.flight import Flight
from testbed.report.thinning import kept, percentiles
from testbed.state import Array
from testbed.views.panels import (
    BLACK,
    BLUE,
    DASHED,
    GOLD,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    Band,
    Line,
)

SINGLE = 6  # followers drawn one by one; of more, a band and the worst
WORST = 3
LOOKS = (
    (BLUE, "o"),
    (ORANGE, "s"),
    (GREEN, "^"),
    (PURPLE, "D"),
    (GOLD, "v"),
    (SKY, "P"),
)
LEADER = BLACK
BAND = (0.05, 0.95)
BAND_NAME = "5 to 95 % of all"


@dataclass(frozen=True, slots=True)
class Part:
    """A follower that is drawn by itself."""

    row: int  # of n
    name: str
    colour: str
    marker: str
    phase: float  # of its markers, so that those of all do not coincide


@dataclass(frozen=True, slots=True)
class Cast:
    """The followers of a run as they are drawn."""

    parts: tuple[Part, ...]
    crowd: int  # how many stand behind the band; 0: everybody is drawn

    @property
    def said(self) -> str:
        """A sentence on who is shown, where not everybody is."""
        if not self.crowd:
            return ""
        worst = ", ".join(part.name for part in self.parts)
        return (
            f" Of {self.crowd} followers the band holds 5 to 95 % at each moment and the grey"
            f" line is the median; drawn by themselves are the {len(self.parts)} of the largest"
            f" RMS error over the whole run: {worst}."
        )


def cast_of(flight: Flight) -> Cast:
    """Everybody, or of more than `SINGLE` followers those with the largest RMS error."""
    names = flight.followers
    rows = list(range(len(names)))
    if len(names) > SINGLE:
        counted = np.maximum((~flight.gone).sum(axis=0), 1)
        mean = np.nansum(flight.error**2, axis=0) / counted
        rows = sorted(np.argsort(-mean, kind="stable")[:WORST].tolist())
    parts = tuple(
        Part(row, names[row], *LOOKS[k], phase=k / len(rows)) for k, row in enumerate(rows)
    )
    return Cast(parts, len(names) if len(names) > SINGLE else 0)


def curves(time: Array, values: Array, cast: Cast, *, width: float = 1.2) -> Iterator[Line]:
    """The followers' curves, thinned, of values (K, n) over times (K,); the crowd's median too."""
    if cast.crowd:
        median = percentiles(values, (0.5,))[0]
        at = kept(median)
        yield Line(time[at], median[at], GREY, "median of all", 1.2)
    for part in cast.parts:
        own = values[:, part.row]
        at = kept(own)
        yield Line(
            time[at], own[at], part.colour, part.name, width,
            marker=part.marker, marker_phase=part.phase,
        )  # fmt: skip


def wishes(time: Array, values: Array, cast: Cast) -> Iterator[Line]:
    """What those who are drawn by themselves should do (K, n), dashed."""
    for part in cast.parts:
        own = values[:, part.row]
        at = kept(own)
        yield Line(time[at], own[at], part.colour, width=0.9, dashes=DASHED)


def bands(time: Array, values: Array, cast: Cast) -> tuple[Band, ...]:
    """Where most of a crowd is; nothing where everybody is drawn."""
    if not cast.crowd:
        return ()
    low, high = percentiles(values, BAND)
    at = kept(low, high)
    return (Band(time[at], low[at], high[at], GREY, BAND_NAME),)
