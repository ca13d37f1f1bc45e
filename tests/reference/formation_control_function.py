"""The bounded gradient ρ that turns a formation error into a velocity, [HBH23] eqs. (5), (13)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reference.formation_arrays import dot, scale
from testbed.core.records import Array, BoolArray


class ControlFunction(NamedTuple):
    """The scalar function μ of [HBH23] eq. (5): `example_1`, `EXAMPLE_2` or `EXAMPLE_3`.

    Examples 2 and 3 are the spline μ(z) = 1 up to `flat`, a cubic up to `far`, then z^(−1/2).
    Fields are numbers for all agents, or arrays (n,) with one for each: `per_agent`.
    """

    spline: bool | BoolArray
    nu1: float | Array  # example 1, m²; spline: coefficient of (z − flat)²
    nu2: float | Array  # example 1; spline: coefficient of (z − flat)³
    m: float | Array  # example 1, exponent
    flat: float | Array  # spline, m²
    far: float | Array  # spline, m²
    bound: float | Array  # ρ̄ = sup √z μ(z), (C2)


def per_agent(functions: Sequence[ControlFunction]) -> ControlFunction:
    """One function for each of n agents."""
    return ControlFunction(*(np.array(column) for column in zip(*functions, strict=True)))


def example_1(nu1: float, nu2: float, m: float) -> ControlFunction:
    """μ(z) = (ν1 + ν2 z)^(−m), [HBH23] example 1.

    Args:
        nu1: ν1 > 0, m²; near zero error the gain is ν1^(−m).
        nu2: ν2 > 0.
        m: exponent in [0.5, 1].

    Raises:
        ValueError: (C1) or (C2) is broken.
    """
    if not (nu1 > 0.0 and nu2 > 0.0 and 0.5 <= m <= 1.0):
        raise ValueError(
            "control function example 1 needs nu1 > 0, nu2 > 0 and m in [0.5, 1], "
            f"not nu1 = {nu1}, nu2 = {nu2}, m = {m}"
        )
    if m == 0.5:
        bound = nu2**-0.5
    else:
        # the maximum of √z (ν1 + ν2 z)^(−m) lies where z ν2 (2m − 1) = ν1
        z = nu1 / (nu2 * (2.0 * m - 1.0))
        bound = z**0.5 * (nu1 + nu2 * z) ** -m
    return ControlFunction(False, float(nu1), float(nu2), float(m), 0.0, 1.0, float(bound))


def _spline(flat: float, far: float) -> ControlFunction:
    """Examples 2 and 3; the cubic meets z^(−1/2) at `far` in value and slope."""
    width = far - flat
    value, slope = far**-0.5 - 1.0, -0.5 * far**-1.5
    nu1 = (3.0 * value / width - slope) / width
    nu2 = (slope - 2.0 * value / width) / width**2
    return ControlFunction(True, nu1, nu2, 0.5, flat, far, 1.0)


EXAMPLE_2 = _spline(flat=0.5, far=1.5)
EXAMPLE_3 = _spline(flat=0.1, far=0.4)


def mu(function: ControlFunction, z: Array) -> tuple[Array, Array]:
    """μ(z) and its derivative μ'(z) for z = ‖x‖² >= 0 (n,)."""
    past = np.minimum(np.maximum(z - function.flat, 0.0), function.far - function.flat)
    beyond = np.maximum(z, function.far) ** -0.5
    outside = z > function.far
    base = np.where(function.spline, 1.0, function.nu1 + function.nu2 * z)
    power = base**-function.m
    value = np.where(
        function.spline,
        np.where(outside, beyond, 1.0 + past * past * (function.nu1 + function.nu2 * past)),
        power,
    )
    slope = np.where(
        function.spline,
        np.where(
            outside,
            -0.5 * beyond**3,
            past * (2.0 * function.nu1 + 3.0 * function.nu2 * past),
        ),
        (-function.m * function.nu2) * power / base,
    )
    return value, slope


def rho_and_rate(function: ControlFunction, x: Array, x_rate: Array) -> tuple[Array, Array]:
    """ρ(x), [HBH23] eq. (5), and its time derivative ρ'(x) ẋ by (13), for vectors x (n, 3)."""
    value, slope = mu(function, dot(x, x))
    return scale(value, x), scale(value, x_rate) + scale(2.0 * slope * dot(x, x_rate), x)
