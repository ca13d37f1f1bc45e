"""What the slots asked of the followers' speeds, and who left its speed set: a fold like `tally`.

A slot's velocity q̇_g + χ̇_i is the central difference of `slot_ned` over the frames before and
after: its mean over two frames. While the leader turns by x from frame to frame it comes out small
by the factor sin(x)/x, at 25 Hz and 0.25 rad/s by 2e-5. The first and the last frame have none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.metrics.block import NEVER, Ticks
from testbed.state import Array, Truths


@dataclass(frozen=True, slots=True)
class Speeds:
    """What remains of the frames folded so far.

    Of ‖q̇_g + χ̇_i‖ (m/s) the smallest is kept, and of its negative: row 0 and row 1.
    """

    smallest: Array  # (2, P, n) by portion; infinite: none yet
    smallest_ever: Array  # (2, n)
    smallest_tick: Ticks  # (2, n)
    left: Ticks  # (n,) times that the speed left its set
    first_left: Ticks  # (n,)
    tick: Ticks  # (2,) or fewer: of the last frames
    slot_ned: Array  # (2, n, 3) or fewer: m, of the last frames
    place: Array  # (2, n) or fewer: whose slots those are
    outside: Truths  # (1, n) or none: in the last frame the speed was outside its set


def empty(portions: int, followers: int) -> Speeds:
    """Of no frames."""
    return Speeds(
        smallest=np.full((2, portions, followers), np.inf),
        smallest_ever=np.full((2, followers), np.inf),
        smallest_tick=np.full((2, followers), NEVER, dtype=np.int64),
        left=np.zeros(followers, dtype=np.int64),
        first_left=np.full(followers, NEVER, dtype=np.int64),
        tick=np.zeros(0, dtype=np.int64),
        slot_ned=np.zeros((0, followers, 3)),
        place=np.zeros((0, followers)),
        outside=np.zeros((0, followers), dtype=np.bool_),
    )


def fold(
    speeds: Speeds,
    *,
    tick: Ticks,
    slot_ned: Array,
    place: Array,
    outside: Truths,
    spans: Sequence[tuple[float, float]],
    base_rate_hz: int,
    medium_ned: Array,
) -> Speeds:
    """The numbers with some frames added; no argument is changed.

    Args:
        speeds: of the frames before.
        tick: (K,) of the base rate, K > 0.
        slot_ned: (K, n, 3) m.
        place: (K, n) whose slots they are; who goes to another has no speed to keep up with.
        outside: (K, n) the speed was outside its set.
        spans: start and end of each portion, s.
        base_rate_hz: ticks in a second.
        medium_ned: (3,) m/s, what speeds are measured against: zero for the ground.
    """
    ticks = np.concatenate((speeds.tick, tick))
    slots = np.concatenate((speeds.slot_ned, slot_ned))
    places = np.concatenate((speeds.place, place))
    inside = ~np.concatenate((speeds.outside, outside))
    leaving = inside[:-1] & ~inside[1:]
    at, both = _both_ways(ticks, slots, places, base_rate_hz, medium_ned)
    smallest, ever, ever_tick = speeds.smallest, speeds.smallest_ever, speeds.smallest_tick
    if at.size:
        time_s = at / base_rate_hz
        smallest = smallest.copy()
        for p, (start, end) in enumerate(spans):
            within = both[:, (time_s >= start) & (time_s < end)]
            smallest[:, p] = np.minimum(smallest[:, p], within.min(axis=1, initial=np.inf))
        now = both.min(axis=1)
        ever_tick = np.where(now < ever, at[both.argmin(axis=1)], ever_tick)
        ever = np.minimum(ever, now)
    return Speeds(
        smallest=smallest,
        smallest_ever=ever,
        smallest_tick=ever_tick,
        left=speeds.left + leaving.sum(axis=0),
        first_left=np.where(
            (speeds.first_left == NEVER) & leaving.any(axis=0),
            ticks[-len(leaving) :][leaving.argmax(axis=0)] if len(leaving) else NEVER,
            speeds.first_left,
        ),
        tick=ticks[-2:],
        slot_ned=slots[-2:].copy(),  # a view would keep the whole block
        place=places[-2:].copy(),
        outside=outside[-1:],
    )


def _both_ways(
    tick: Ticks, slot_ned: Array, place: Array, base_rate_hz: int, medium_ned: Array
) -> tuple[Ticks, Array]:
    """The ticks (K − 2,) with a frame on either side, and ± ‖q̇_g + χ̇_i‖ (2, K − 2, n) there.

    A slot that is not a number, behind a lost leader, or another's before, never is the smallest.
    """
    period = (tick[2:] - tick[:-2]) / base_rate_hz
    velocity = (slot_ned[2:] - slot_ned[:-2]) / period[:, None, None] - medium_ned
    speed = np.sqrt(np.sum(velocity**2, axis=-1))
    both = np.stack((speed, -speed))
    return tick[1:-1], np.where(np.isnan(both) | (place[2:] != place[:-2]), np.inf, both)
