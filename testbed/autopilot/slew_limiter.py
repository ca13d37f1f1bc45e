"""Reduce P and D of a rate loop while they oscillate fast: ArduPlane's RLL_RATE_SMAX.

Written from ArduPlane's documentation of the parameter and its published constants.
"""

from __future__ import annotations

from math import exp, pi, radians

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Record, Records

# ArduPlane takes the slope of 45 times P + D in radians; full output is 45 degrees.
UNITS = 45.0 * radians(45.0)
CUTOFF_HZ = 25.0  # of the slope
HOLD_S = 0.3  # half a period of the slowest oscillation; steepest slopes are held as long
CYCLE_S = 3.0 * HOLD_S  # an oscillation exceeds the limit twice up and twice down within it
DECAY_S = 1.0  # time constant of older slopes; their mean rises with half of it
GAIN = 1.5  # reduction per excess over the limit
STEEPEST = 10.0  # slopes count up to this many times the limit
NEVER = -(1 << 40)  # number of a period long before the first

# State of the slew limiters of roll and pitch, in this order; the second axis is the direction of
# the slope, up and down.
SLEW = np.dtype(
    [
        ("pd", "f8", (2,)),  # P + D of the last period, reduced, part of full output
        ("pd_before", "f8", (2,)),  # of the period before
        ("slope", "f8", (2,)),  # deg/s, low-passed
        ("steepest", "f8", (2, 2)),  # deg/s, positive
        ("steepest_at", "i8", (2, 2)),  # period of the steepest slope
        ("exceeded_at", "i8", (2, 2)),  # period when the limit was exceeded last
        ("exceeded_before", "i8", (2, 2)),  # and the time before
        ("side", "i8", (2,)),  # of the limit exceeded last; 1: up, -1: down
        ("oscillation", "f8", (2,)),  # deg/s, mean of both steepest slopes, low-passed
    ],
    align=True,
)


def start_slew_limiters(slew: Records) -> None:
    """Start the slew limiters of N autopilots, (N,) of SLEW: no limit was ever exceeded."""
    slew["exceeded_at"] = slew["exceeded_before"] = NEVER


@kernel
def slew_factor(s: Record, axis: int, limit: float, period: int, dt: float) -> float:
    """Compute the factor of P and D in this period from those of earlier periods.

    Args:
        s: record of SLEW; written, except for `pd`.
        axis: 0: roll, 1: pitch.
        limit: RLL_RATE_SMAX or PTCH_RATE_SMAX, deg/s; 0: no limit.
        period: number of this period.
        dt: period, s.

    Returns:
        At most 1, and at least 0.07 while the limit stays.
    """
    if limit <= 0.0:
        return 1.0
    slope = (s.pd[axis] - s.pd_before[axis]) * UNITS / dt
    s.pd_before[axis] = s.pd[axis]
    s.slope[axis] += dt / (dt + 0.5 / (pi * CUTOFF_HZ)) * (slope - s.slope[axis])
    hold = int(HOLD_S / dt + 1e-9)
    decay = min(dt / DECAY_S, 1.0)
    for direction in range(2):
        sign = 1 - 2 * direction
        slope = sign * s.slope[axis]
        if slope > limit and s.side[axis] != sign:
            s.side[axis] = sign
            s.exceeded_before[axis, direction] = s.exceeded_at[axis, direction]
            s.exceeded_at[axis, direction] = period
        if slope > s.steepest[axis, direction]:
            s.steepest[axis, direction] = min(slope, STEEPEST * limit)
            s.steepest_at[axis, direction] = period
        elif period - s.steepest_at[axis, direction] > hold:
            s.steepest[axis, direction] *= 1.0 - decay
    mean = 0.5 * (s.steepest[axis, 0] + s.steepest[axis, 1])
    # A single fast slope, as after a step of the command, is no oscillation.
    oldest = min(s.exceeded_before[axis, 0], s.exceeded_before[axis, 1])
    excess = (period - oldest) * dt - CYCLE_S
    if excess > 0.0:
        mean *= exp(-excess / DECAY_S)
    smoothed = s.oscillation[axis] + min(2.0 * decay, 1.0) * (mean - s.oscillation[axis])
    oscillation: float = min(smoothed, mean)
    s.oscillation[axis] = oscillation
    return limit / (limit + GAIN * max(oscillation - limit, 0.0))
