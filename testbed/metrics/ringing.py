"""Ringing: weakly damped oscillations of a follower's bank that its slot does not need."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.frames import turn_bank
from testbed.core.records import Array, BoolArray

MIN_SWING = math.radians(3.0)  # of the bank from one extremum to the next
HALF_PERIODS_S = (0.25, 1.0)  # from one extremum to the next: 2 to 0.5 Hz
SWINGS = 5  # successive ones of a ringing bank, 2.5 periods
MAX_DAMPING_RATIO = 0.15
MIN_SHARE = 0.5  # of the swings of the bank, in those of its difference from the needed bank
# A faster change of the wind disturbs the bank; that of a steady wind that varies with height is
# slower.
MAX_WIND_RATE = 0.5  # m/s²
MAX_SAMPLE_PERIOD_S = 0.1  # five samples in a period of 2 Hz


def needed_bank(time_s: Array, slot_ned: Array, slot_index: NDArray[Any], wind_ned: Array) -> Array:
    """Compute the banks with which followers would fly their slots exactly.

    They are those of coordinated turns: `turn_bank` of the slot's velocity through the air and its
    acceleration, by differences over three samples. Of all samples but the first and the last.

    Args:
        time_s: (K,) of the samples.
        slot_ned: (K, n, 3) m.
        slot_index: (K, n) number of the slot that a follower has.
        wind_ned: (K, n, 3) m/s at the followers.

    Returns:
        (K − 2, n) rad; NaN without a slot and where a follower changes its slot.
    """
    step = np.diff(time_s)[:, None, None]
    velocity = np.diff(slot_ned, axis=0) / step
    period = step[1:] + step[:-1]
    acceleration = 2.0 * (velocity[1:] - velocity[:-1]) / period
    through_air = (slot_ned[2:] - slot_ned[:-2]) / period - wind_ned[1:-1]
    changing = slot_index[2:] != slot_index[:-2]
    return np.where(changing, np.nan, turn_bank(through_air, acceleration))


class _Extremum(NamedTuple):
    tick: int
    bank: float  # rad
    excess: float  # rad, bank minus needed bank


class _Detector:
    """Find ringing in the bank of one follower."""

    def __init__(self, base_rate_hz: int) -> None:
        self._rate = base_rate_hz
        self._ticks = 0  # of ringing
        self._last = math.nan  # tick of the last extremum of a ringing bank
        self._swings = 0  # of a ringing bank
        self._decrement = 0.0  # sum of the logarithms of successive amplitudes' ratios
        self._ratios = 0  # in that sum
        self.interrupt()

    def interrupt(self) -> None:
        """Forget the extrema: the oscillation is not assessed across this moment."""
        self._extrema: list[_Extremum] = []  # the last one may still be exceeded
        self._rising = 0.0  # 1 or −1: the way to the last extremum; 0: unknown
        self._uncounted = 0  # swings that are not in the sums

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """Duration, last time, mean period (s) and mean damping ratio; NaN: no ringing."""
        seconds, swings = self._ticks / self._rate, self._swings
        if not swings:
            return seconds, math.nan, math.nan, math.nan
        zeta = _damping_ratio(self._decrement / self._ratios)
        return seconds, self._last / self._rate, 2.0 * seconds / swings, zeta

    def add(self, extremum: _Extremum) -> None:
        """Add a local extremum; those that turn back by less than `MIN_SWING` are skipped."""
        extrema = self._extrema
        step = extremum.bank - extrema[-1].bank if extrema else math.inf
        if self._rising * step > 0.0:
            extrema[-1] = extremum
        elif abs(step) >= MIN_SWING:
            self._rising = math.copysign(1.0, step) if extrema else 0.0
            extrema.append(extremum)
            if len(extrema) > 2:
                self._end_swing()

    def _end_swing(self) -> None:
        """Count the swing between the last two extrema that are known to be extrema."""
        extrema = self._extrema
        half_period = (extrema[-2].tick - extrema[-3].tick) / self._rate
        if not HALF_PERIODS_S[0] <= half_period <= HALF_PERIODS_S[1]:
            del extrema[:-2]
            self._uncounted = 0
            return
        self._uncounted += 1
        if len(extrema) < SWINGS + 2:
            return
        del extrema[: -SWINGS - 2]
        amplitudes = _amplitudes([each.bank for each in extrema[:-1]])
        excesses = _amplitudes([each.excess for each in extrema[:-1]])
        if any(e / a < MIN_SHARE for a, e in zip(amplitudes, excesses, strict=True)):
            return
        decrement = _decrement(amplitudes)
        if _damping_ratio(decrement / (SWINGS - 2)) >= MAX_DAMPING_RATIO:
            return
        swings = min(self._uncounted, SWINGS)
        ratios = min(swings, SWINGS - 2)
        self._ticks += extrema[-2].tick - extrema[-2 - swings].tick
        self._last = extrema[-2].tick
        self._swings += swings
        self._decrement += _decrement(amplitudes[-1 - ratios :])
        self._ratios += ratios
        self._uncounted = 0


def _amplitudes(extrema: list[float]) -> list[float]:
    """Return half the distances of extrema from the middle between their neighbours, signed.

    Of a damped oscillation about a value that changes at a constant rate they form a geometric
    series, like the oscillation's own amplitudes.
    """
    triples = zip(extrema, extrema[1:], extrema[2:], strict=False)
    return [0.5 * (middle - 0.5 * (before + after)) for before, middle, after in triples]


def _decrement(amplitudes: list[float]) -> float:
    """Logarithm of the ratio of the first amplitude to the last."""
    return math.log(abs(amplitudes[0] / amplitudes[-1]))


def _damping_ratio(decrement: float) -> float:
    """Return ζ of the logarithmic decrement δ of half a period: δ / √(π² + δ²)."""
    return decrement / math.hypot(math.pi, decrement)


class RingingMonitor:
    """Find ringing in the banks of n followers.

    A bank rings in `SWINGS` successive swings or more, from extremum to extremum, if each is
    `MIN_SWING` or larger and lasts one of `HALF_PERIODS_S`, if the logarithmic decrement of the
    amplitudes gives a damping ratio below `MAX_DAMPING_RATIO`, negative ones included, and if the
    bank leaves the needed bank by at least `MIN_SHARE` of each swing: a bank that follows an
    oscillating leader does not ring. A swing has ended when the bank turns back by `MIN_SWING`.
    Gusts and errors of estimates keep up oscillations whose decrement says nothing about damping.
    Where there are any nothing is assessed.
    """

    def __init__(self, followers: int, base_rate_hz: int) -> None:
        self._base_rate_hz = base_rate_hz
        self._detectors = [_Detector(base_rate_hz) for _ in range(followers)]
        self.assessed = np.zeros(followers, dtype=np.int64)  # samples

    def add(
        self,
        tick: NDArray[np.int64],
        bank: Array,
        slot_ned: Array,
        slot_index: NDArray[Any],
        wind_ned: Array,
        exact: BoolArray,
    ) -> None:
        """Add samples, but for the first and the last; these are only neighbours.

        Args:
            tick: (K,) of the base rate.
            bank: (K, n) rad.
            slot_ned: (K, n, 3) m; NaN: none.
            slot_index: (K, n) number of the slot.
            wind_ned: (K, n, 3) m/s at the followers.
            exact: (K,) whether all estimates equal the truth.
        """
        time_s = tick / self._base_rate_hz
        needed = needed_bank(time_s, slot_ned, slot_index, wind_ned)
        period = time_s[2:] - time_s[:-2]
        change = wind_ned[2:] - wind_ned[:-2]
        calm = np.sum(change * change, axis=2) <= (MAX_WIND_RATE * period[:, None]) ** 2
        at_rate = exact[1:-1] & (period <= 2.0 * MAX_SAMPLE_PERIOD_S + 1e-9)
        assessed = calm & at_rate[:, None] & np.isfinite(needed)
        self.assessed += assessed.sum(axis=0)
        before, after = bank[1:-1] - bank[:-2], bank[2:] - bank[1:-1]
        extreme = ((before > 0.0) & (after <= 0.0)) | ((before < 0.0) & (after >= 0.0))
        interrupted = ~assessed
        interrupted[1:] &= assessed[:-1]  # once in each stretch
        marked = (extreme & assessed) | interrupted
        excess = bank[1:-1] - needed
        for i, detector in enumerate(self._detectors):
            for k in np.flatnonzero(marked[:, i]).tolist():
                if interrupted[k, i]:
                    detector.interrupt()
                else:
                    angles = float(bank[k + 1, i]), float(excess[k, i])
                    detector.add(_Extremum(int(tick[k + 1]), *angles))

    def numbers(self) -> NDArray[np.float64]:
        """Return duration, last time, period (s) and damping ratio (n, 4); NaN: no ringing."""
        return np.array([each.numbers for each in self._detectors]).reshape(-1, 4)
