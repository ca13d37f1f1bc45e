"""The bounded gradient ρ that turns a formation error into a velocity, [HBH23] eqs. (5), (13)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reference.formation_arrays import dot, scale
from testbed.core.records import Array
from testbed.formation.control_function import ControlFunction


def per_agent(functions: Sequence[ControlFunction]) -> ControlFunction:
    """One function for each of n agents: fields (n,)."""
    return ControlFunction(*(np.array(column) for column in zip(*functions, strict=True)))


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
