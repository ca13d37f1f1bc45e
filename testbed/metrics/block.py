"""Frames as they are folded: some of them together, and what of them counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, Truths

Ticks = NDArray[np.int64]
NEVER = -1  # a tick that has not happened


@dataclass(frozen=True, slots=True)
class Block:
    """K frames of N aircraft, n = N − 1 of them followers."""

    tick: Ticks  # (K,) of the base rate
    position_ned: Array  # (K, N, 3) m
    bank: Array  # (K,) of the leader, rad
    error_ned: Array  # (K, n, 3) m, position − slot
    slot_ned: Array  # (K, n, 3) m
    place: Array  # (K, n) whose slot that is
    guards: Ticks  # (K, n)
    saturations: Ticks  # (K, n)
    wind_ned: Array  # (K, N, 3) m/s
    roll_coefficient: Array  # (K, N) of wakes
    throttle: Array  # (K, N) commanded, 0..1
    lost: Truths  # (K, N)
    believed_ned: Array  # (K, n, 3) m, the error as everyone believes it to be
    off: Sequence[Array]  # (K, N, ...) as of `estimates.fold`; empty: all estimates are exact


def first_lost(block: Block, before: Ticks) -> Ticks:
    """The ticks (N,) at which aircraft were lost, from those before this block, or NEVER."""
    now = block.tick[block.lost.argmax(axis=0)]
    first: Ticks = np.where((before == NEVER) & block.lost.any(axis=0), now, before)
    return first


def without_slot(lost: Truths) -> Truths:
    """Which followers (K, n) have no error: lost themselves, or behind a lost leader."""
    return lost[:, 1:] | lost[:, :1]


def without_lost(block: Block, since: Ticks) -> Block:
    """The block in which lost aircraft add nothing to sums, maxima and counts.

    The frame at which an aircraft was lost, at the ticks `since` (N,), still tells how close it
    came to another: else a collision would be missing from the distances.
    """
    lost, gone = block.lost, without_slot(block.lost)
    passed = (since != NEVER) & (block.tick[:, None] > since)
    return replace(
        block,
        position_ned=np.where(passed[..., None], np.nan, block.position_ned),
        bank=np.where(lost[:, 0], 0.0, block.bank),
        error_ned=np.where(gone[..., None], 0.0, block.error_ned),
        slot_ned=np.where(gone[..., None], np.nan, block.slot_ned),
        guards=np.where(lost[:, 1:], 0, block.guards),
        saturations=np.where(lost[:, 1:], 0, block.saturations),
        wind_ned=np.where(lost[..., None], 0.0, block.wind_ned),
        roll_coefficient=np.where(lost, 0.0, block.roll_coefficient),
        throttle=np.where(lost, 0.0, block.throttle),
        believed_ned=np.where(gone[..., None], 0.0, block.believed_ned),
    )
