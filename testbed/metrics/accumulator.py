"""Blocks of consecutive samples, and sums, extremes and counts over the samples of a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import IntFlag
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.frames import wrap_pi
from testbed.core.records import Array, BoolArray
from testbed.core.samples import SampleRows
from testbed.metrics.ringing import RingingMonitor

Ticks = NDArray[np.int64]
NEVER = -1  # the tick of what has not happened


class SampleBlock(NamedTuple):
    """K consecutive samples of N aircraft, n = N − 1 of them followers."""

    tick: Ticks  # (K,) of the base rate
    position_ned: Array  # (K, N, 3) m
    bank: Array  # (K, N) rad
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
    exact: BoolArray  # (K,) whether all estimates equal the truth
    # estimate minus truth
    position_difference: Array  # (K, N, 3) m
    velocity_difference: Array  # (K, N, 3) m/s
    euler_difference: Array  # (K, N, 3) rad
    airspeed_difference: Array  # (K, N) m/s

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
        return self._replace(
            position_ned=np.where(after[..., None], np.nan, self.position_ned),
            bank=np.where(lost, 0.0, self.bank),
            error_ned=np.where(no_slot[..., None], 0.0, self.error_ned),
            slot_ned=np.where(no_slot[..., None], np.nan, self.slot_ned),
            limiter_flags=np.where(lost[:, 1:], 0, self.limiter_flags),
            saturations=np.where(lost[:, 1:], 0, self.saturations),
            wind_ned=np.where(lost[..., None], 0.0, self.wind_ned),
            wake_delta_cl=np.where(lost, 0.0, self.wake_delta_cl),
            throttle=np.where(lost, 0.0, self.throttle),
            estimated_error_ned=np.where(no_slot[..., None], 0.0, self.estimated_error_ned),
        )


def make_block(samples: SampleRows) -> SampleBlock:
    """Make a block of some samples, whose arrays are copied."""
    columns, exact = samples.columns, ~samples.inexact

    def difference(field: str) -> Array:
        found = np.zeros(columns[f"truth.{field}"].shape)
        rows = samples.inexact
        with np.errstate(invalid="ignore"):  # an aircraft beyond its model's range may be inf
            found[rows] = columns[f"estimate.{field}"][rows] - columns[f"truth.{field}"][rows]
        return found

    error_ned = np.array(columns["formation.error_ned"])
    return SampleBlock(
        tick=np.array(samples.ticks),
        position_ned=np.array(columns["truth.position_ned"]),
        bank=np.array(columns["truth.euler"][..., 0]),
        error_ned=error_ned,
        slot_ned=np.array(columns["formation.slot_ned"]),
        slot_index=np.array(columns["formation.slot_index"]),
        limiter_flags=columns["formation.limiter_flags"].astype(np.int64),
        saturations=columns["formation.saturations"].astype(np.int64),
        wind_ned=np.array(columns["air.wind_ned"]),
        wake_delta_cl=np.array(columns["air.wake_delta_cl"]),
        throttle=np.array(columns["command.throttle"]),
        lost=np.array(columns["lost"]),
        estimated_error_ned=np.where(
            exact[:, None, None], error_ned, columns["formation.estimated_error_ned"]
        ),
        exact=exact,
        position_difference=difference("position_ned"),
        velocity_difference=difference("velocity_ned"),
        euler_difference=difference("euler"),
        airspeed_difference=difference("airspeed"),
    )


def _join(blocks: Sequence[SampleBlock]) -> SampleBlock:
    return SampleBlock(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True)))


def _cut(block: Iterable[Any], samples: slice) -> SampleBlock:
    return SampleBlock(*(array[samples] for array in block))


SPAN = 1024  # samples of up to four aircraft
JOIN_RADIUS_M = 5.0  # a follower this close to its slot is in it,
JOIN_HOLD_S = 5.0  # and has joined after so long
ESTIMATE_KEYS = (
    "horizontal_m",
    "height_m",
    "velocity_mps",
    "tilt_deg",
    "heading_deg",
    "airspeed_mps",
)


def _span_samples(aircraft: int) -> int:
    """Return the samples that are summed together; fewer of many aircraft, to fit the caches."""
    return min(SPAN, max(4 * SPAN // aircraft, 32))


class Accumulator:
    """Sums, extremes and counts over samples of N aircraft, n of them followers.

    Samples are added in the order of time, in blocks of any length. They are summed in spans of one
    length, which are counted from 0 s, so that a run gives the same bits however it is observed,
    and the same in a window as one that begins later. A lost aircraft counts until it was lost.

    The velocity of a slot, q̇_g + χ̇_i, is the central difference of its position over the samples
    before and after, which is its mean over two samples: while the leader turns by x from sample
    to sample it is too small by the factor sin(x)/x, at 25 Hz and 0.25 rad/s by 2e-5.

    Args:
        windows: P spans of time, start inside and end outside, s.
        followers: n.
        base_rate_hz: ticks in a second.
        sample_rate_hz: samples in a second.
        medium_ned: (3,) m/s, what speeds of slots are measured against: zero for the ground.
    """

    def __init__(
        self,
        windows: Mapping[str, tuple[float, float]],
        followers: int,
        *,
        base_rate_hz: int,
        sample_rate_hz: int,
        medium_ned: Array,
    ) -> None:
        self._spans = list(windows.values())
        self._base_rate_hz, self._medium_ned = base_rate_hz, medium_ned
        p, n = len(windows), followers
        self._span = self._missing = _span_samples(n + 1)  # samples of the next span
        self._sample_ticks = max(1, base_rate_hz // sample_rate_hz)
        self._waiting: list[SampleBlock] = []  # samples of the next span
        self.first_tick = self.last_tick = NEVER
        self.lost_tick = _never(n + 1)
        self.samples = _counts(n + 1)  # in which an aircraft was not lost
        self.slot_samples = _counts(n)  # in which a follower had a slot
        # formation errors by window
        self.window_samples = _counts(p)
        self.window_slot_samples = _counts(p, n)
        self.square_error = np.zeros((p, n))  # sum of ‖q̃‖², m²
        self.square_estimated_error = np.zeros((p, n))  # m², computed from the estimates
        self.square_error_ratio = np.zeros((p, n))  # sum of (‖q̃‖ / ‖χ‖)²
        self.window_max_error = np.zeros((p, n))  # m
        self.window_max_bank = np.zeros(p)  # |bank| of the leader, rad
        # formation errors of the whole run
        self.max_error = np.zeros(n)  # m
        self.max_bank = 0.0  # rad
        self.in_slot_since = _never(n)  # start of the present stretch in the slot
        self.joined_tick = _never(n)  # start of the first stretch of `JOIN_HOLD_S`
        # distance between aircraft
        self.min_separation = np.inf  # m
        self.min_separation_tick = NEVER
        self.min_separation_pair = (NEVER, NEVER)  # rows of the aircraft
        self.window_min_separation = np.full(p, np.inf)  # m
        self.min_separation_outside = np.inf  # m, of the samples in no window
        # limits
        self.limited_samples = _counts(n)  # with any limiter flag
        self.limiter_samples = _counts(n, len(LimiterFlag))
        self.saturated_samples = _counts(n)  # with any command saturated
        self.saturation_samples = _counts(n, len(Saturation))
        self.last_saturated_tick = _never(n)
        # speed of the slots ‖q̇_g + χ̇_i‖, m/s
        self.window_min_speed = np.full((p, n), np.inf)
        self.window_max_speed = np.full((p, n), -np.inf)
        self.min_speed = np.full(n, np.inf)
        self.max_speed = np.full(n, -np.inf)
        self.min_speed_tick = _never(n)
        self.max_speed_tick = _never(n)
        self.left_speed_set = _counts(n)  # times that a follower's speed left its set
        self.first_left_tick = _never(n)
        self.ringing = RingingMonitor(n, base_rate_hz)
        # the last two samples, for central differences and transitions
        self._recent_tick: Ticks = np.zeros(0, dtype=np.int64)
        self._recent_slot_ned: Array = np.zeros((0, n, 3))
        self._recent_slot_index: Array = np.zeros((0, n))
        self._recent_bank: Array = np.zeros((0, n))
        self._recent_wind_ned: Array = np.zeros((0, n, 3))
        self._recent_exact: BoolArray = np.zeros(0, dtype=np.bool_)
        self._recent_outside: BoolArray = np.zeros((0, n), dtype=np.bool_)
        # air and commands
        self.wind_sum = np.zeros((n + 1, 3))  # m/s
        self.wind_square = np.zeros((n + 1, 3))  # m²/s²
        self.max_wind = np.zeros(n + 1)  # m/s
        self.max_wake_delta_cl = np.zeros(n + 1)
        self.throttle_sum = np.zeros(n + 1)
        # estimate minus truth
        self.estimate_square = np.zeros((n + 1, len(ESTIMATE_KEYS)))  # m², m²/s², rad²
        self.max_horizontal = np.zeros(n + 1)  # m
        self.relative_square = np.zeros(n)  # of the position relative to the leader, m²

    @property
    def is_empty(self) -> bool:
        """Whether no sample was added."""
        return self.first_tick == NEVER and not any(len(each.tick) for each in self._waiting)

    def precede(self, block: SampleBlock) -> None:
        """Set the sample before the first one, which has a part in no sum."""
        if block.lost.any():
            block = block.exclude_lost(block.first_lost(self.lost_tick))
        self._recent_tick = block.tick
        self._recent_slot_ned, self._recent_slot_index = block.slot_ned, block.slot_index
        self._recent_bank, self._recent_wind_ned = block.bank[:, 1:], block.wind_ned[:, 1:]
        self._recent_exact = block.exact

    def add(self, block: SampleBlock) -> None:
        """Add a block of samples."""
        if self.is_empty and len(block.tick):
            number = int(block.tick[0]) // self._sample_ticks
            self._missing = self._span - number % self._span
        self._waiting.append(block)
        if sum(len(each.tick) for each in self._waiting) >= self._missing:
            joined = _join(self._waiting)
            self._accumulate(_cut(joined, slice(self._missing)))
            rest = _cut(joined, slice(self._missing, None))
            self._waiting, self._missing = [], self._span
            self.add(rest)

    def finish(self) -> None:
        """Sum also the samples of an incomplete span, after which no more are added."""
        if any(len(each.tick) for each in self._waiting):
            self._accumulate(_join(self._waiting))

    def _accumulate(self, block: SampleBlock) -> None:
        lost, no_slot = block.lost, block.without_slot
        self.lost_tick = block.first_lost(self.lost_tick)
        if lost.any():
            block = block.exclude_lost(self.lost_tick)
        if self.first_tick == NEVER:
            self.first_tick = int(block.tick[0])
        self.last_tick = int(block.tick[-1])
        self.samples += (~lost).sum(axis=0)
        self.slot_samples += (~no_slot).sum(axis=0)
        # samples are in the order of time, so those of a window are neighbours
        cuts = np.searchsorted(block.tick / self._base_rate_hz, self._spans).tolist()
        parts = [slice(first, last) for first, last in cuts]
        self._add_errors(block, no_slot, parts)
        self._add_separation(block, parts)
        self._add_limits(block)
        self._add_slot_motion(block)
        self._add_wind(block)
        self.throttle_sum += block.throttle.sum(axis=0)
        if not block.exact.all():
            self._add_estimates(block, lost)

    def _add_errors(self, block: SampleBlock, no_slot: BoolArray, parts: Sequence[slice]) -> None:
        error = _length(block.error_ned)
        offset = _length(block.slot_ned - block.position_ned[:, :1])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(no_slot, 0.0, error / offset)
        bank = np.abs(block.bank[:, 0])
        self.window_samples += np.array([each.stop - each.start for each in parts], dtype=np.int64)
        self.window_slot_samples += _sums(~no_slot, parts).astype(np.int64)
        square = square_estimated = _sums(error**2, parts)
        if not block.exact.all():
            # by the same steps as the error, so that exact estimates give the same bits
            square_estimated = _sums(_length(block.estimated_error_ned) ** 2, parts)
        self.square_error += square
        self.square_estimated_error += square_estimated
        self.square_error_ratio += _sums(ratio**2, parts)
        self.window_max_error = np.maximum(self.window_max_error, _largest(error, parts))
        self.window_max_bank = np.maximum(self.window_max_bank, _largest(bank, parts))
        self.max_error = np.maximum(self.max_error, error.max(axis=0))
        self.max_bank = float(np.maximum(self.max_bank, bank.max()))
        self._add_joining(block.tick, (error <= JOIN_RADIUS_M) & ~no_slot)

    def _add_joining(self, tick: Ticks, inside: BoolArray) -> None:
        """Update since when followers are in their slots, and when they joined."""
        index = np.arange(tick.size)[:, None]
        last_outside = np.maximum.accumulate(np.where(inside, -1, index), axis=0)
        following = np.append(tick[1:], NEVER)[last_outside]
        carried = np.where(self.in_slot_since == NEVER, tick[0], self.in_slot_since)
        since = np.where(last_outside == -1, carried, following)
        since = np.where(inside, since, NEVER)
        held = inside & (tick[:, None] - since >= JOIN_HOLD_S * self._base_rate_hz)
        first = since[held.argmax(axis=0), np.arange(inside.shape[1])]
        joining = (self.joined_tick == NEVER) & held.any(axis=0)
        self.joined_tick = np.where(joining, first, self.joined_tick)
        self.in_slot_since = since[-1]

    def _add_separation(self, block: SampleBlock, parts: Sequence[slice]) -> None:
        ends = {0, len(block.tick), *(end for each in parts for end in (each.start, each.stop))}
        for first, last in pairwise(sorted(ends)):
            separation, row, pair = _closest(block.position_ned[first:last])
            if separation < self.min_separation:
                self.min_separation, self.min_separation_pair = separation, pair
                self.min_separation_tick = int(block.tick[first + row])
            within = [k for k, each in enumerate(parts) if each.start <= first < each.stop]
            for k in within:
                self.window_min_separation[k] = min(self.window_min_separation[k], separation)
            if not within:
                self.min_separation_outside = min(self.min_separation_outside, separation)

    def _add_limits(self, block: SampleBlock) -> None:
        saturated = block.saturations != 0
        self.limited_samples += (block.limiter_flags != 0).sum(axis=0)
        self.limiter_samples += _count_bits(block.limiter_flags, LimiterFlag)
        self.saturated_samples += saturated.sum(axis=0)
        self.saturation_samples += _count_bits(block.saturations, Saturation)
        last = np.where(saturated, block.tick[:, None], NEVER).max(axis=0, initial=NEVER)
        self.last_saturated_tick = np.maximum(self.last_saturated_tick, last)

    def _add_slot_motion(self, block: SampleBlock) -> None:
        outside = block.limiter_flags & int(LimiterFlag.OUTSIDE_SPEED_SET) != 0
        ticks = np.concatenate((self._recent_tick, block.tick))
        slots = np.concatenate((self._recent_slot_ned, block.slot_ned))
        indices = np.concatenate((self._recent_slot_index, block.slot_index))
        bank = np.concatenate((self._recent_bank, block.bank[:, 1:]))
        wind_ned = np.concatenate((self._recent_wind_ned, block.wind_ned[:, 1:]))
        exact = np.concatenate((self._recent_exact, block.exact))
        inside = ~np.concatenate((self._recent_outside, outside))
        leaving = inside[:-1] & ~inside[1:]
        if len(leaving):
            first = (self.first_left_tick == NEVER) & leaving.any(axis=0)
            left = ticks[-len(leaving) :][leaving.argmax(axis=0)]
            self.first_left_tick = np.where(first, left, self.first_left_tick)
            self.left_speed_set += leaving.sum(axis=0)
        if ticks.size > 2:
            self._add_speed_extremes(ticks, slots, indices)
            self.ringing.add(ticks, bank, slots, indices, wind_ned, exact)
        self._recent_tick = ticks[-2:]
        self._recent_slot_ned = slots[-2:].copy()  # a view would hold the whole block
        self._recent_slot_index = indices[-2:].copy()
        self._recent_bank, self._recent_wind_ned = bank[-2:].copy(), wind_ned[-2:].copy()
        self._recent_exact = exact[-2:].copy()
        self._recent_outside = outside[-1:]

    def _add_speed_extremes(self, ticks: Ticks, slots: Array, indices: Array) -> None:
        period = (ticks[2:] - ticks[:-2]) / self._base_rate_hz
        velocity = (slots[2:] - slots[:-2]) / period[:, None, None] - self._medium_ned
        speed = np.sqrt(np.sum(velocity**2, axis=-1))
        # a change of slots is not a velocity; behind a lost leader there are no slots
        unknown = np.isnan(speed) | (indices[2:] != indices[:-2])
        low, high = np.where(unknown, np.inf, speed), np.where(unknown, -np.inf, speed)
        at = ticks[1:-1]
        time_s = at / self._base_rate_hz
        for p, (start, end) in enumerate(self._spans):
            within = (time_s >= start) & (time_s < end)
            lowest = low[within].min(axis=0, initial=np.inf)
            highest = high[within].max(axis=0, initial=-np.inf)
            self.window_min_speed[p] = np.minimum(self.window_min_speed[p], lowest)
            self.window_max_speed[p] = np.maximum(self.window_max_speed[p], highest)
        lowest, highest = low.min(axis=0), high.max(axis=0)
        slower, faster = lowest < self.min_speed, highest > self.max_speed
        self.min_speed_tick = np.where(slower, at[low.argmin(axis=0)], self.min_speed_tick)
        self.max_speed_tick = np.where(faster, at[high.argmax(axis=0)], self.max_speed_tick)
        self.min_speed = np.minimum(self.min_speed, lowest)
        self.max_speed = np.maximum(self.max_speed, highest)

    def _add_wind(self, block: SampleBlock) -> None:
        square = block.wind_ned**2
        speed = np.sqrt(square.sum(axis=2))
        self.wind_sum += block.wind_ned.sum(axis=0)
        self.wind_square += square.sum(axis=0)
        self.max_wind = np.maximum(self.max_wind, speed.max(axis=0))
        largest = np.abs(block.wake_delta_cl).max(axis=0)
        self.max_wake_delta_cl = np.maximum(self.max_wake_delta_cl, largest)

    def _add_estimates(self, block: SampleBlock, lost: BoolArray) -> None:
        """Add errors of the estimates.

        A formation is not affected by an error that a follower has in common with its leader, so
        that of the position relative to the leader is summed, too.
        """
        position = block.position_difference
        roll, pitch, yaw = np.moveaxis(wrap_pi(block.euler_difference), -1, 0)
        north, east, down = np.moveaxis(position, -1, 0)
        horizontal = north**2 + east**2
        speed, airspeed = np.sum(block.velocity_difference**2, axis=-1), block.airspeed_difference
        square = np.stack(
            (horizontal, down**2, speed, roll**2 + pitch**2, yaw**2, airspeed**2), axis=-1
        )
        relative = np.sum((position[:, 1:] - position[:, :1]) ** 2, axis=-1)
        if lost.any():
            square[lost] = 0.0
            relative[lost[:, 1:] | lost[:, :1]] = 0.0
        self.estimate_square += square.sum(axis=0)
        self.max_horizontal = np.maximum(self.max_horizontal, np.sqrt(square[..., 0]).max(axis=0))
        self.relative_square += relative.sum(axis=0)


def _never(count: int) -> Ticks:
    return np.full(count, NEVER, dtype=np.int64)


def _counts(*shape: int) -> Ticks:
    return np.zeros(shape, dtype=np.int64)


def _length(vectors: Array) -> Array:
    """Lengths (...) of vectors (..., 3)."""
    length: Array = np.sqrt(np.sum(vectors**2, axis=-1))
    return length


def _sums(values: NDArray[Any], parts: Sequence[slice]) -> Array:
    """Sums over the samples of each window (P, ...) of values (K, ...)."""
    sums = np.array([values[part].sum(axis=0) for part in parts])
    return sums.reshape(len(parts), *values.shape[1:])


def _largest(values: Array, parts: Sequence[slice]) -> Array:
    """Largest in each window (P, ...) of values (K, ...) that are not negative."""
    largest = np.array([values[part].max(axis=0, initial=0.0) for part in parts])
    return largest.reshape(len(parts), *values.shape[1:])


def _count_bits(flags: Ticks, bits: type[IntFlag]) -> Ticks:
    """Samples in which each bit was set (n, bits), from flags (K, n)."""
    counts: Ticks = np.count_nonzero(flags[..., None] & [int(bit) for bit in bits], axis=0)
    return counts


def _closest(position_ned: Array) -> tuple[float, int, tuple[int, int]]:
    """Smallest distance between any two aircraft (K, N, 3): metres, sample, rows of the two.

    Positions that are NaN, of lost aircraft, are skipped.
    """
    best, row, pair = np.inf, 0, (NEVER, NEVER)
    axes = np.ascontiguousarray(np.moveaxis(position_ned, (0, 1), (2, 1)))
    for i in range(axes.shape[1] - 1):
        north, east, down = axes[:, i + 1 :] - axes[:, i : i + 1]
        square = north * north + east * east + down * down
        if np.isnan(square).any():
            square = np.where(np.isnan(square), np.inf, square)
        at = int(square.argmin())
        distance = float(np.sqrt(square.flat[at]))
        other, sample = divmod(at, square.shape[1])
        if distance < best or (distance == best and sample < row):
            best, row, pair = distance, sample, (i, i + 1 + other)
    return best, row, pair
