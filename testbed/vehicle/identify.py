"""A first-order model of a step response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.state import Array

_POLES = (0.02, 20.0)  # 1/s, the range looked at
_GRID = 61
_ROUNDS = 8
_ZOOM = 0.15  # share of the range that the next round looks at


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """K p / (s + p) exp(−T s)."""

    pole: float  # p, 1/s
    delay: float  # T, s
    gain: float  # K
    rms: float  # of what it leaves, in steps

    @property
    def time_constant(self) -> float:
        """1/p, s."""
        return 1.0 / self.pole

    def response(self, time: Array) -> Array:
        """To a unit step at 0 s."""
        after = np.maximum(np.asarray(time) - self.delay, 0.0)
        answer: Array = self.gain * (1.0 - np.exp(-self.pole * after))
        return answer


def fit_first_order(time: Array, response: Array, *, gain: float | None = None) -> FirstOrder:
    """The model of least square error, by a grid of poles and delays refined about its best.

    Args:
        time: (k,) s after the step, increasing.
        response: (k,) what moved, in steps.
        gain: K if it is known; a formation law's speed model ṡ = p (u − s) has 1.

    Raises:
        ValueError: if there are fewer than ten samples.
    """
    if len(time) < 10:
        raise ValueError(f"{len(time)} samples are too few for a fit")
    low = np.array([np.log(_POLES[0]), 0.0])
    high = np.array([np.log(_POLES[1]), 0.5 * time[-1]])
    least, most = low.copy(), high.copy()
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
        low, high = np.maximum(middle - half, least), np.minimum(middle + half, most)
    return best
