"""Running sums over the frames of a run, as a pure fold: tally + block of frames -> tally.

Frames are folded in blocks of `BLOCK` counted from the first, so that sums run in one order and a
run gives the same bits however it is observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.formation.flags import Guard, Saturation
from testbed.metrics import estimates, speeds, wind
from testbed.metrics.block import NEVER, Block, Ticks, first_lost, without_lost, without_slot
from testbed.metrics.estimates import Estimates
from testbed.metrics.speeds import Speeds
from testbed.metrics.wind import Wind
from testbed.state import Array

BLOCK = 1024
ENGAGED_RADIUS_M = 5.0
ENGAGED_HOLD_S = 5.0


@dataclass(frozen=True, slots=True)
class Windows:
    """The portions of a run: t0 <= t < t1, start inside and end outside."""

    names: tuple[str, ...]
    start_s: Array  # (P,)
    end_s: Array  # (P,)

    @property
    def spans(self) -> list[tuple[float, float]]:
        """Start and end of each."""
        return list(zip(self.start_s.tolist(), self.end_s.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class Tally:
    """What remains of the frames folded so far."""

    last_tick: int
    alive: Ticks  # (N,) frames in which an aircraft was not lost
    paired: Ticks  # (n,) in which neither a follower nor the leader was
    lost: Ticks  # (N,) when it was, or NEVER
    count: Ticks  # (P,) frames inside the portion
    counted: Ticks  # (P, n) of these, those in which neither a follower nor the leader was lost
    square: Array  # (P, n) sum of ‖q̃‖², m²
    believed: Array  # (P, n) the same of what everyone believes, m²
    square_ratio: Array  # (P, n) sum of (‖q̃‖ / ‖χ‖)²
    largest: Array  # (P, n) ‖q̃‖, m
    bank: Array  # (P,) largest |bank| of the leader, rad
    largest_ever: Array  # (n,) ‖q̃‖, m
    bank_ever: float  # rad
    separation: float  # m
    separation_tick: int
    separation_pair: tuple[int, int]
    inside_since: Ticks  # (n,) start of the present stretch inside the radius, or NEVER
    engaged: Ticks  # (n,) start of the first stretch that lasted
    guarded: Ticks  # (n,) frames with any guard
    guards: Ticks  # (n, guards) frames with this guard
    saturated: Ticks  # (n,) frames with any saturation
    saturations: Ticks  # (n, saturations) frames with this one
    last_saturated: Ticks  # (n,)
    speeds: Speeds
    wind: Wind
    throttle: Array  # (N,) sum over the frames
    estimates: Estimates


def empty(portions: int, followers: int) -> Tally:
    """The tally of no frames."""

    def never() -> Ticks:
        return np.full(followers, NEVER, dtype=np.int64)

    def zeros(*shape: int) -> Any:  # noqa: ANN401 - int or float, as the dtype says
        return np.zeros(shape, dtype=np.int64)

    return Tally(
        last_tick=NEVER,
        alive=zeros(followers + 1),
        paired=zeros(followers),
        lost=np.full(followers + 1, NEVER, dtype=np.int64),
        count=zeros(portions),
        counted=zeros(portions, followers),
        square=np.zeros((portions, followers)),
        believed=np.zeros((portions, followers)),
        square_ratio=np.zeros((portions, followers)),
        largest=np.zeros((portions, followers)),
        bank=np.zeros(portions),
        largest_ever=np.zeros(followers),
        bank_ever=0.0,
        separation=np.inf,
        separation_tick=NEVER,
        separation_pair=(NEVER, NEVER),
        inside_since=never(),
        engaged=never(),
        guarded=zeros(followers),
        guards=zeros(followers, len(Guard)),
        saturated=zeros(followers),
        saturations=zeros(followers, len(Saturation)),
        last_saturated=never(),
        speeds=speeds.empty(portions, followers),
        wind=wind.empty(followers + 1),
        throttle=np.zeros(followers + 1),
        estimates=estimates.empty(followers + 1),
    )


def fold(
    tally: Tally, block: Block, *, windows: Windows, base_rate_hz: int, medium_ned: Array
) -> Tally:
    """The tally with the frames of a block added; neither argument is changed."""
    if not block.tick.size:
        return tally
    tick, lost = block.tick, block.lost
    gone = without_slot(lost)
    since = first_lost(block, tally.lost)
    if lost.any():
        block = without_lost(block, since)
    error = _length(block.error_ned)
    offset = _length(block.slot_ned - block.position_ned[:, :1])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(gone, 0.0, error / offset)
    bank = np.abs(block.bank)
    inside = (error <= ENGAGED_RADIUS_M) & ~gone

    # frames come in order of time, so that those of a portion are neighbours
    cuts = np.searchsorted(tick / base_rate_hz, windows.spans).tolist()
    parts = [slice(first, last) for first, last in cuts]
    separation, row, pair = _closest(block.position_ned)
    closer = separation < tally.separation
    inside_since, engaged = _engage(tally, tick, inside, base_rate_hz)
    saturated = block.saturations != 0
    square = believed = _sums(error**2, parts)
    if block.off:
        # by the same steps as the error's, so that what is as believed gives the same bits
        believed = _sums(_length(block.believed_ned) ** 2, parts)
    return Tally(
        last_tick=int(tick[-1]),
        alive=tally.alive + (~lost).sum(axis=0),
        paired=tally.paired + (~gone).sum(axis=0),
        lost=since,
        count=tally.count + np.array([last - first for first, last in cuts], dtype=np.int64),
        counted=tally.counted + _sums(~gone, parts).astype(np.int64),
        square=tally.square + square,
        believed=tally.believed + believed,
        square_ratio=tally.square_ratio + _sums(ratio**2, parts),
        largest=np.maximum(tally.largest, _largest(error, parts)),
        bank=np.maximum(tally.bank, _largest(bank, parts)),
        largest_ever=np.maximum(tally.largest_ever, error.max(axis=0)),
        bank_ever=float(np.maximum(tally.bank_ever, bank.max())),
        separation=separation if closer else tally.separation,
        separation_tick=int(tick[row]) if closer else tally.separation_tick,
        separation_pair=pair if closer else tally.separation_pair,
        inside_since=inside_since,
        engaged=engaged,
        guarded=tally.guarded + (block.guards != 0).sum(axis=0),
        guards=tally.guards + _count_bits(block.guards, Guard),
        saturated=tally.saturated + saturated.sum(axis=0),
        saturations=tally.saturations + _count_bits(block.saturations, Saturation),
        last_saturated=np.maximum(tally.last_saturated, _last(tick, saturated)),
        speeds=speeds.fold(
            tally.speeds,
            tick=tick,
            slot_ned=block.slot_ned,
            place=block.place,
            outside=block.guards & int(Guard.OUTSIDE_SPEED_SET) != 0,
            spans=windows.spans,
            base_rate_hz=base_rate_hz,
            medium_ned=medium_ned,
        ),
        wind=wind.fold(tally.wind, block.wind_ned, block.roll_coefficient),
        throttle=tally.throttle + block.throttle.sum(axis=0),
        estimates=(
            estimates.fold(tally.estimates, block.off, lost) if block.off else tally.estimates
        ),
    )


def _length(vectors: Array) -> Array:
    """Lengths (...) of vectors (..., 3)."""
    length: Array = np.sqrt(np.sum(vectors**2, axis=-1))
    return length


def _sums(values: NDArray[Any], parts: Sequence[slice]) -> Array:
    """Sums over the frames of each portion (P, ...) of values (K, ...)."""
    sums = np.array([values[part].sum(axis=0) for part in parts])
    return sums.reshape(len(parts), *values.shape[1:])


def _largest(values: Array, parts: Sequence[slice]) -> Array:
    """Largest in each portion (P, ...) of values (K, ...) that are not negative."""
    largest = np.array([values[part].max(axis=0, initial=0.0) for part in parts])
    return largest.reshape(len(parts), *values.shape[1:])


def _count_bits(flags: Ticks, bits: type[IntFlag]) -> Ticks:
    """Frames in which each bit was set (n, bits), from flags (K, n)."""
    counts: Ticks = np.count_nonzero(flags[..., None] & [int(bit) for bit in bits], axis=0)
    return counts


def _last(tick: Ticks, happened: NDArray[np.bool_]) -> Ticks:
    """Tick at which something (K, n) last happened (n,), NEVER if it did not."""
    last: Ticks = np.where(happened, tick[:, None], NEVER).max(axis=0, initial=NEVER)
    return last


def _engage(
    tally: Tally, tick: Ticks, inside: NDArray[np.bool_], base_rate_hz: int
) -> tuple[Ticks, Ticks]:
    """When the present stretch inside began and when the first that lasted began, (n,) each."""
    frames = tick.size
    index = np.arange(frames)[:, None]
    last_outside = np.maximum.accumulate(np.where(inside, -1, index), axis=0)
    following = np.append(tick[1:], NEVER)[last_outside]
    carried = np.where(tally.inside_since == NEVER, tick[0], tally.inside_since)
    since = np.where(last_outside == -1, carried, following)
    since = np.where(inside, since, NEVER)
    lasted = inside & (tick[:, None] - since >= ENGAGED_HOLD_S * base_rate_hz)
    first = since[lasted.argmax(axis=0), np.arange(inside.shape[1])]
    engaged = np.where((tally.engaged == NEVER) & lasted.any(axis=0), first, tally.engaged)
    return since[-1], engaged


def _closest(position_ned: Array) -> tuple[float, int, tuple[int, int]]:
    """Smallest distance between any two aircraft (K, N, 3): metres, frame, who.

    Positions that are not numbers are skipped: a lost aircraft does not hide the others.
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
        other, frame = divmod(at, square.shape[1])
        if distance < best or (distance == best and frame < row):
            best, row, pair = distance, frame, (i, i + 1 + other)
    return best, row, pair
