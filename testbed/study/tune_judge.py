"""Whether tuned gains are better on flights that the search did not see."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.intervals import student


@dataclass(frozen=True, slots=True)
class Judgement:
    """Before and after on the same seeds.

    Args:
        pairs: flights that were flown well both times.
        seeds: that have such a pair.
        before: mean of the metric over these seeds.
        after: the same with the tuned gains.
        difference: after less before: mean, low and high of Student's interval over seeds.
        lost_before: flights that were lost or failed before.
        lost_after: and after.
    """

    pairs: int
    seeds: int
    before: float
    after: float
    difference: tuple[float, float, float]
    lost_before: int
    lost_after: int

    @property
    def better(self) -> bool:
        """Whether it is shown: the whole interval is below 0, and no more flights are lost."""
        return self.difference[2] < 0.0 and self.lost_after <= self.lost_before

    @property
    def verdict(self) -> str:
        """In a sentence."""
        mean, low, high = self.difference
        if not self.pairs:
            return "not shown to be better: no flight was flown well both times"
        if math.isnan(low):
            return f"not shown to be better: {self.seeds} seeds are too few to tell"
        share = f"{abs(100.0 * mean / self.before):.0f} %" if self.before > 0.0 else "–"
        if self.better:
            return f"better on seeds it was not tuned on, by {share}"
        if low > 0.0:
            return f"worse on seeds it was not tuned on, by {share}"
        if self.lost_after > self.lost_before:
            return f"not shown to be better: {self.lost_after} lost, {self.lost_before} before"
        return "not shown to be better on seeds it was not tuned on: the interval holds 0"


Found = Mapping[int, Sequence[float | None]]


def judge(before: Found, after: Found) -> Judgement:
    """Compare flight by flight.

    A seed is a unit: of its pairs of flights the mean difference counts.

    Args:
        before: by seed, the metric of each flight; None of one that was lost or failed.
        after: the same seeds and flights with other gains.
    """
    units: list[tuple[float, float]] = []
    pairs = 0
    for seed, values in before.items():
        both = [
            (old, new)
            for old, new in zip(values, after[seed], strict=True)
            if old is not None and new is not None
        ]
        pairs += len(both)
        if both:
            units.append(
                (statistics.fmean(b for b, _ in both), statistics.fmean(a for _, a in both))
            )
    lost = [
        sum(each is None for own in found.values() for each in own) for found in (before, after)
    ]
    if not units:
        nothing = (math.nan, math.nan, math.nan)
        return Judgement(0, 0, math.nan, math.nan, nothing, lost[0], lost[1])
    return Judgement(
        pairs,
        len(units),
        statistics.fmean(old for old, _ in units),
        statistics.fmean(new for _, new in units),
        student(np.array([new - old for old, new in units])),
        lost[0],
        lost[1],
    )
