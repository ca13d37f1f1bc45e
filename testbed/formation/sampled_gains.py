"""Gains that do not suit the control period, or are too small to act."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array
from testbed.formation.assumptions import Finding

RATE_LIMIT = 0.5  # gain of a rate times the control period; from 2 on a sampled loop diverges
SLOWEST = 1e-3  # smallest gain that acts within minutes, in 1/s, m/s or as a weight


def check_rate(key: str, gain: Array, control_hz: int) -> list[Finding]:
    """Check that a gain in 1/s suits the control period; the number is the gain.

    Args:
        key: of the scenario.
        gain: (n,) 1/s.
        control_hz: steps of the law per second.
    """
    most = RATE_LIMIT * control_hz
    fast = [
        Finding(
            i,
            key,
            float(gain[i]),
            f"{key} has a gain of {gain[i]:.4g} 1/s; times the control period of 1/{control_hz} s "
            f"it is {gain[i] / control_hz:.3g}, and above {RATE_LIMIT:g} the law overshoots "
            f"(write at most {most:g} 1/s, or a higher rates.control_hz)",
        )
        for i in np.flatnonzero(gain > most).tolist()
    ]
    return fast + check_not_tiny(key, gain, " 1/s")


def check_not_tiny(key: str, gain: Array, unit: str) -> list[Finding]:
    """Check that a gain is large enough to act in a flight; the number is the gain."""
    return [
        Finding(
            i,
            key,
            float(gain[i]),
            f"{key} has a gain of {gain[i]:.3g}{unit}: too small to act within minutes (write "
            f"{SLOWEST:g} or more)",
        )
        for i in np.flatnonzero((gain > 0.0) & (gain < SLOWEST)).tolist()
    ]
