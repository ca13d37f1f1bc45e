"""Selection of the followers to draw: each one, or of many a band and the worst."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.reports.decimate import decimate, percentiles
from testbed.reports.run_data import RunData
from testbed.views.palette import ON_WHITE
from testbed.views.panels import BLACK, DASHED, GREY, Band, Line

MAX_SINGLE = 6  # followers drawn one by one; of more, a band and the worst
WORST = 3
# colours and markers; those from `MAX_SINGLE` on are of no follower
STYLES = tuple(zip(ON_WHITE.values(), "os^DvP<>X*", strict=True))
LEADER_COLOUR = BLACK
BAND = (0.05, 0.95)
BAND_LABEL = "5 to 95 % of all"


@dataclass(frozen=True, slots=True)
class DrawnFollower:
    """A follower with its own curve."""

    row: int  # 0..n − 1
    name: str
    colour: str
    marker: str
    phase: float  # of its markers, so that those of different curves do not coincide


@dataclass(frozen=True, slots=True)
class PlotSelection:
    """The followers of a run as they are drawn."""

    drawn: tuple[DrawnFollower, ...]
    in_band: int  # followers summarised by a band; 0: all are drawn one by one

    @property
    def note(self) -> str:
        """Sentence of the caption on band and median; "" if all followers are drawn."""
        if not self.in_band:
            return ""
        names = ", ".join(each.name for each in self.drawn)
        return (
            f" Of {self.in_band} followers, the band shows 5 to 95 % at each time and the grey line"
            f" the median; separate curves: the {len(self.drawn)} with the largest RMS error over"
            f" the time drawn, {names}."
        )

    @property
    def worst_note(self) -> str:
        """Sentence of the caption of a figure without a band; "" if all followers are drawn."""
        if not self.in_band:
            return ""
        return f" Of {self.in_band} followers, those with the largest RMS error are drawn."


def select_followers(run: RunData) -> PlotSelection:
    """Select all followers, or of more than `MAX_SINGLE` those with the largest RMS error."""
    names = run.followers
    rows = list(range(len(names)))
    if len(names) > MAX_SINGLE:
        counted = np.maximum((~run.without_slot).sum(axis=0), 1)
        mean_square = np.nansum(run.error**2, axis=0) / counted
        rows = sorted(np.argsort(-mean_square, kind="stable")[:WORST].tolist())
    drawn = tuple(
        DrawnFollower(row, names[row], *STYLES[k], phase=k / len(rows))
        for k, row in enumerate(rows)
    )
    return PlotSelection(drawn, len(names) if len(names) > MAX_SINGLE else 0)


def follower_curves(
    time: Array, values: Array, selection: PlotSelection, *, width: float = 1.2
) -> Iterator[Line]:
    """Yield the decimated curves of values (K, n) over times (K,), and the median of many."""
    if selection.in_band:
        median = percentiles(values, (0.5,))[0]
        at = decimate(median)
        yield Line(time[at], median[at], GREY, "median of all", 1.2)
    for each in selection.drawn:
        own = values[:, each.row]
        at = decimate(own)
        yield Line(
            time[at], own[at], each.colour, each.name, width,
            marker=each.marker, marker_phase=each.phase,
        )  # fmt: skip


def desired_curves(time: Array, values: Array, selection: PlotSelection) -> Iterator[Line]:
    """Yield dashed curves of desired values (K, n) of the followers with their own curves."""
    for each in selection.drawn:
        own = values[:, each.row]
        at = decimate(own)
        yield Line(time[at], own[at], each.colour, width=0.9, dashes=DASHED)


def percentile_bands(time: Array, values: Array, selection: PlotSelection) -> tuple[Band, ...]:
    """Make the band of 5 to 95 % of values (K, n); none if all followers are drawn."""
    if not selection.in_band:
        return ()
    low, high = percentiles(values, BAND)
    at = decimate(low, high)
    return (Band(time[at], low[at], high[at], GREY, BAND_LABEL),)
