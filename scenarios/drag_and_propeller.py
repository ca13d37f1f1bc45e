"""f and g of the speed model ṡ = f + g u, (2), of an aircraft with drag and a propeller."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81  # m/s²
LIFT_TO_DRAG, SPEED = 10.0, 16.0  # the best glide ratio, and its speed, m/s
POWER = 60.0  # W/kg of the propeller at full throttle


def f(s: Array) -> Array:
    """Return the deceleration by drag without lift and with it, m/s²."""
    square = (s / SPEED) ** 2
    value: Array = -0.5 * GRAVITY / LIFT_TO_DRAG * (square + 1.0 / square)
    return value


def g(s: Array) -> Array:
    """Return the acceleration at full throttle, m/s²: power over speed; u is 0 to 1."""
    value: Array = POWER / s
    return value
