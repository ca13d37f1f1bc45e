"""Blocks of consecutive samples, as arrays that the accumulator takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array, BoolArray
from testbed.core.samples import Columns

Ticks = NDArray[np.int64]
NEVER = -1  # the tick of what has not happened

_MEASURED = (
    "truth.position_ned",
    "truth.euler",
    "formation.error_ned",
    "formation.slot_ned",
    "formation.limiter_flags",
    "formation.saturations",
    "air.wind_ned",
    "air.wake_delta_cl",
    "command.throttle",
    "lost",
    "formation.slot_index",
)
_ESTIMATED_ERROR = "formation.estimated_error_ned"


class EstimateErrors(NamedTuple):
    """Estimate minus truth in K samples of N aircraft."""

    position_ned: Array  # (K, N, 3) m
    velocity_ned: Array  # (K, N, 3) m/s
    euler: Array  # (K, N, 3) rad
    airspeed: Array  # (K, N) m/s


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """K consecutive samples of N aircraft, n = N − 1 of them followers."""

    tick: Ticks  # (K,) of the base rate
    position_ned: Array  # (K, N, 3) m
    leader_bank: Array  # (K,) rad
    error_ned: Array  # (K, n, 3) m, position − slot
    slot_ned: Array  # (K, n, 3) m
    slot_index: Array  # (K, n) number of the slot that a follower has
    limiter_flags: Ticks  # (K, n) bits of `LimiterFlag`
    saturations: Ticks  # (K, n) bits of `Saturation`
    wind_ned: Array  # (K, N, 3) m/s
    wake_delta_cl: Array  # (K, N) rolling-moment coefficient of the wakes of others
    throttle: Array  # (K, N) commanded, 0..1
    lost: BoolArray  # (K, N)
    estimated_error_ned: Array  # (K, n, 3) m, the error computed from the estimates
    estimate_errors: EstimateErrors | None  # None: all estimates equal the truth

    @property
    def without_slot(self) -> BoolArray:
        """Followers (K, n) without a slot: lost themselves, or behind a lost leader."""
        return self.lost[:, 1:] | self.lost[:, :1]

    def first_lost(self, before: Ticks) -> Ticks:
        """Return the ticks (N,) at which aircraft were lost, given those of earlier blocks."""
        now = self.tick[self.lost.argmax(axis=0)]
        first: Ticks = np.where((before == NEVER) & self.lost.any(axis=0), now, before)
        return first

    def exclude_lost(self, lost_tick: Ticks) -> SampleBlock:
        """Neutralise lost aircraft: they add nothing to sums, extremes and counts.

        Distances still include the sample in which an aircraft was lost, at `lost_tick` (N,),
        because otherwise the smallest separation would miss a collision.
        """
        lost, no_slot = self.lost, self.without_slot
        after = (lost_tick != NEVER) & (self.tick[:, None] > lost_tick)
        return replace(
            self,
            position_ned=np.where(after[..., None], np.nan, self.position_ned),
            leader_bank=np.where(lost[:, 0], 0.0, self.leader_bank),
            error_ned=np.where(no_slot[..., None], 0.0, self.error_ned),
            slot_ned=np.where(no_slot[..., None], np.nan, self.slot_ned),
            limiter_flags=np.where(lost[:, 1:], 0, self.limiter_flags),
            saturations=np.where(lost[:, 1:], 0, self.saturations),
            wind_ned=np.where(lost[..., None], 0.0, self.wind_ned),
            wake_delta_cl=np.where(lost, 0.0, self.wake_delta_cl),
            throttle=np.where(lost, 0.0, self.throttle),
            estimated_error_ned=np.where(no_slot[..., None], 0.0, self.estimated_error_ned),
        )


def make_block(tick: Sequence[int], columns: Columns, erring: Sequence[int]) -> SampleBlock:
    """Make a block of the arrays of some samples.

    Args:
        tick: (K,) of the base rate.
        columns: the arrays (K, ...), by their paths in `Sample`.
        erring: the rows whose estimates differ from the truth.
    """
    measured = {source: np.ascontiguousarray(columns[source]) for source in _MEASURED}
    error_ned = measured["formation.error_ned"]
    estimated_error_ned, estimate_errors = error_ned, None
    if erring:
        exact = np.ones(len(tick), dtype=bool)
        exact[erring] = False
        estimated_error_ned = columns[_ESTIMATED_ERROR].copy()
        estimated_error_ned[exact] = error_ned[exact]
        with np.errstate(invalid="ignore"):  # an aircraft beyond its model's range may be inf
            estimate_errors = EstimateErrors(
                *(columns[f"estimate.{f}"] - columns[f"truth.{f}"] for f in EstimateErrors._fields)
            )
        for errors in estimate_errors:
            errors[exact] = 0.0
    return SampleBlock(
        tick=np.array(tick, dtype=np.int64),
        position_ned=measured["truth.position_ned"],
        leader_bank=measured["truth.euler"][:, 0, 0],
        error_ned=error_ned,
        slot_ned=measured["formation.slot_ned"],
        slot_index=measured["formation.slot_index"],
        limiter_flags=measured["formation.limiter_flags"].astype(np.int64),
        saturations=measured["formation.saturations"].astype(np.int64),
        wind_ned=measured["air.wind_ned"],
        wake_delta_cl=measured["air.wake_delta_cl"],
        throttle=measured["command.throttle"],
        lost=measured["lost"],
        estimated_error_ned=estimated_error_ned,
        estimate_errors=estimate_errors,
    )
