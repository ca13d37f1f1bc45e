"""Followers to draw, each one or of many a band and the worst; curves with fewer samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.reports.run_data import RunData
from testbed.views.panels import BLACK, DASHED, GREY, ON_WHITE, Band, Line

BUCKETS = 240  # about four pixels wide on the page


def decimate(*columns: Array, buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Select the samples that draw the same curves.

    Time is cut into buckets of equal length. Each keeps its first, last, smallest and largest
    value, and the start of every stretch of NaN: no extreme is lost, and gaps stay gaps.

    Args:
        columns: (K,) each, of curves that are drawn together.
        buckets: number of buckets; up to four times as many samples are all kept.

    Returns:
        Indices in order.
    """
    samples = len(columns[0])
    if samples <= 4 * buckets:
        return np.arange(samples)
    width = -(-samples // buckets)
    # the last bucket is filled up with the last sample
    index = np.minimum(np.arange(width * -(-samples // width)), samples - 1).reshape(-1, width)
    chosen: list[NDArray[Any]] = [index[:, 0], index[:, -1]]
    rows = np.arange(len(index))
    for column in columns:
        values = column[index]
        missing = np.isnan(values)
        low = np.where(missing, np.inf, values).argmin(axis=1)
        high = np.where(missing, -np.inf, values).argmax(axis=1)
        chosen += [index[rows, low], index[rows, high]]
        absent = np.isnan(column)
        chosen.append(np.flatnonzero(absent[1:] & ~absent[:-1]) + 1)
    return np.unique(np.concatenate(chosen))


def percentiles(values: Array, shares: Sequence[float]) -> Array:
    """Compute percentiles (len(shares), K) of the finite values in each row, interpolated.

    Args:
        values: (K, n), of n aircraft; a row of NaN has NaN as percentiles.
        shares: 0..1.
    """
    ordered = np.sort(values, axis=1)  # NaN comes last
    count = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(values))
    out = np.empty((len(shares), len(values)))
    for k, share in enumerate(shares):
        position = share * np.maximum(count - 1, 0)
        low = np.floor(position).astype(np.intp)
        high = np.minimum(low + 1, np.maximum(count - 1, 0))
        weight = position - low
        out[k] = (1.0 - weight) * ordered[rows, low] + weight * ordered[rows, high]
    return out


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
