"""A control function μ and a barrier h in place of the paper's examples."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def mu(z: Array) -> Array:
    """Close errors at tanh(‖x‖ / 7 m): μ(z) = tanh(√z / 7) / √z, so that ρ̄ = 1."""
    r = np.sqrt(np.maximum(z, 1e-6)) / 7.0
    value: Array = np.tanh(r) / (7.0 * r)
    return value


def h(s: Array, s_min: float, s_max: float) -> Array:
    """Be 1 in the middle of the speed set, with a slope that falls everywhere: fact 2 holds."""
    t = (2.0 * s - s_min - s_max) / (s_max - s_min)
    value: Array = 1.0 - t**4
    return value
