"""Which steps are too long for the modes of an aircraft.

A step dt is compared with the eigenvalues λ of the aircraft in trim. Adams and Bashforth's second
order is stable on the real axis for |λ| dt < 1, and Euler's method, by which JSBSim integrates the
propeller's speed, for |λ| dt < 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from testbed.vehicle.linearize import Mode

STABLE = 1.0  # |λ| dt
PROPELLER_STABLE = 2.0  # |λ| dt
# |λ| dt. A Skywalker X8's responses to commands of 1 Hz are up to 3 % off at 0.59, and up to 0.7 %
# at 0.3; at 1.05 it diverges (docs/speed.md).
ACCURATE = 0.5


class CoarseStep(NamedTuple):
    """A step that is too long for a mode."""

    mode: Mode
    product: float  # |λ| dt
    limit: float  # which the product exceeds: of accuracy or of stability
    stable: bool
    rate_hz: int  # that suits


def find_coarse_step(modes: Sequence[Mode], rate_hz: int, multiple_hz: int) -> CoarseStep | None:
    """Return the mode for which steps are too long, an unstable one first; None: there is none.

    Args:
        modes: of the aircraft at its start.
        rate_hz: steps per second.
        multiple_hz: of which the suggested rate is a multiple.
    """
    if not modes:
        return None
    fastest = max(modes, key=lambda mode: mode.frequency)
    suits = multiple_hz * math.ceil(fastest.frequency / ACCURATE / multiple_hz)
    for mode in modes:
        limit = PROPELLER_STABLE if mode.name == "propeller" else STABLE
        if (product := mode.frequency / rate_hz) >= limit:
            return CoarseStep(mode, product, limit, stable=False, rate_hz=suits)
    if (product := fastest.frequency / rate_hz) > ACCURATE:
        return CoarseStep(fastest, product, ACCURATE, stable=True, rate_hz=suits)
    return None
