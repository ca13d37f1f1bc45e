"""A first-order model of a step response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array

_POLES = (0.02, 20.0)  # 1/s, search range
_GRID = 61
_ROUNDS = 8
_ZOOM = 0.15  # width of the next round's range, relative to this one's


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """K p / (s + p) exp(−T s)."""

    pole: float  # p, 1/s
    delay: float  # T, s
    gain: float  # K
    rms: float  # of the residual, in steps

    @property
    def time_constant(self) -> float:
        """1/p, s."""
        return 1.0 / self.pole

    def response(self, time: Array) -> Array:
        """Return the response to a unit step at 0 s."""
        after = np.maximum(np.asarray(time) - self.delay, 0.0)
        response: Array = self.gain * (1.0 - np.exp(-self.pole * after))
        return response


def fit_first_order(time: Array, response: Array, *, gain: float | None = None) -> FirstOrder:
    """Fit a model by least squares on a refined grid of poles and delays.

    Args:
        time: (k,) s after the step, increasing.
        response: (k,) in steps.
        gain: K if it is known; a formation law's speed model ṡ = p (u − s) has 1.

    Raises:
        ValueError: there are fewer than ten samples.
    """
    if len(time) < 10:
        raise ValueError(f"{len(time)} samples are too few for a fit")
    low = np.array([np.log(_POLES[0]), 0.0])
    high = np.array([np.log(_POLES[1]), 0.5 * time[-1]])
    lowest, highest = low.copy(), high.copy()
    best = FirstOrder(_POLES[0], 0.0, 0.0, np.inf)
    for _ in range(_ROUNDS):
        poles = np.exp(np.linspace(low[0], high[0], _GRID))
        for delay in np.linspace(low[1], high[1], _GRID):
            unit = 1.0 - np.exp(-poles[:, None] * np.maximum(time - delay, 0.0))
            gains = (
                unit @ response / np.sum(unit**2, axis=1) if gain is None else gain + 0.0 * poles
            )
            errors = np.sqrt(np.mean((gains[:, None] * unit - response) ** 2, axis=1))
            row = int(errors.argmin())
            if errors[row] < best.rms:
                best = FirstOrder(
                    float(poles[row]), float(delay), float(gains[row]), float(errors[row])
                )
        half = 0.5 * _ZOOM * (high - low)
        middle = np.array([np.log(best.pole), best.delay])
        low, high = np.maximum(middle - half, lowest), np.minimum(middle + half, highest)
    return best
