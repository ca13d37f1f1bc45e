"""What a downwash that varies along a wing does to it, by Prandtl's lifting line.

The wing is elliptic, so that the series of its circulation takes the downwash term by term
(H. Glauert, "The Elements of Aerofoil and Airscrew Theory", chapters X and XI). Its section's lift
slope is the one with which it has the lift slope of the whole airframe.

The rolling moment of a wake is a coefficient of its own, not the roll rate of air that would roll
the aircraft as much, because the damping in an airframe's data need not be its wing's: the
Rascal's says −0.40 per unit of p b/(2 V), the lifting line −0.52.
"""

from __future__ import annotations

import numpy as np

from testbed.errors import InputError
from testbed.state import Array


def nodes(count: int) -> tuple[Array, Array]:
    """Where to sample a wing, and the weights of a mean over it that its chord weighs.

    Gauss's quadrature for the weight √(1 − x²), Chebyshev's polynomials of the second kind: exact
    for polynomials up to the order 2 count − 1.

    Returns:
        (count,) places along the span in half spans, from the right tip to the left, and (count,)
        weights, which add up to one.
    """
    theta = np.arange(1, count + 1) * np.pi / (count + 1)
    return np.cos(theta), 2.0 / (count + 1) * np.sin(theta) ** 2


def roll_gain(aspect_ratio: Array, lift_slope: Array) -> Array:
    """How a wing answers the first moment of its downwash: (π A/2) μ/(1 + 2 μ).

    With μ = a₀/(π A) and the section's lift slope a₀ from C_Lα = a₀/(1 + μ).

    Args:
        aspect_ratio: A (...,).
        lift_slope: C_Lα (...,) per rad, of the airframe.

    Raises:
        InputError: no section gives a wing such a lift slope.
    """
    most = np.pi * aspect_ratio
    for aspect, slope in np.broadcast(aspect_ratio, lift_slope):
        if not 0.0 < slope < np.pi * aspect:
            raise InputError(
                f"no wing of aspect ratio {aspect:g} has the lift slope {slope:g} per rad: "
                f"give the airframe one between 0 and {np.pi * aspect:.3g}"
            )
    mu = lift_slope / (most - lift_slope)
    return np.asarray(0.5 * most * mu / (1.0 + 2.0 * mu))


def roll_coefficient(downwash: Array, airspeed: Array, gain: Array) -> Array:
    """Rolling-moment coefficient (...,), right wing down, of a downwash along the span.

    The second term of the series alone rolls: C_l = (π A/4) μ/(1 + 2 μ) (2/π) ∫ (w/V) sin θ sin 2θ
    dθ over 0..π at y = (b/2) cos θ.

    Args:
        downwash: w (..., M) m/s at the `nodes`, across the flight direction, down.
        airspeed: V (...,) m/s.
        gain: `roll_gain` (...,).
    """
    points, weights = nodes(downwash.shape[-1])
    return np.asarray(gain * (downwash * weights * points).sum(axis=-1) / airspeed)
