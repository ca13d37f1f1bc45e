"""The bounded gradient ρ that turns a formation error into a velocity, [HBH23] eqs. (5), (13)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Record, Values

MU = np.dtype(
    [
        ("spline", "?"),
        *((name, "f8") for name in ("nu1", "nu2", "m", "flat", "far", "bound")),
    ],
    align=True,
)


class ControlFunction(NamedTuple):
    """The scalar function μ of [HBH23] eq. (5): `example_1`, `EXAMPLE_2` or `EXAMPLE_3`.

    Examples 2 and 3 are the spline μ(z) = 1 up to `flat`, a cubic up to `far`, then z^(−1/2).
    """

    spline: bool
    nu1: float  # example 1, m²; spline: coefficient of (z − flat)²
    nu2: float  # example 1; spline: coefficient of (z − flat)³
    m: float  # example 1, exponent
    flat: float  # spline, m²
    far: float  # spline, m²
    bound: float  # ρ̄ = sup √z μ(z), (C2)


def example_1(nu1: float, nu2: float, m: float) -> ControlFunction:
    """Make μ(z) = (ν1 + ν2 z)^(−m), [HBH23] example 1.

    Args:
        nu1: ν1 > 0, m²; near zero error the gain is ν1^(−m).
        nu2: ν2 > 0.
        m: exponent in [0.5, 1].

    Raises:
        ValueError: (C1) or (C2) does not hold.
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
    """Make examples 2 and 3; the cubic equals z^(−1/2) at `far` in value and slope."""
    width = far - flat
    value, slope = far**-0.5 - 1.0, -0.5 * far**-1.5
    nu1 = (3.0 * value / width - slope) / width
    nu2 = (slope - 2.0 * value / width) / width**2
    return ControlFunction(True, nu1, nu2, 0.5, flat, far, 1.0)


EXAMPLE_2 = _spline(flat=0.5, far=1.5)
EXAMPLE_3 = _spline(flat=0.1, far=0.4)


@kernel
def mu(function: Record, z: float) -> Values:
    """Return μ(z) and μ'(z) for z = ‖x‖² >= 0, m²; `function` is a record of MU."""
    if not function.spline:
        base = function.nu1 + function.nu2 * z
        value = base**-function.m
        return value, (-function.m * function.nu2) * value / base
    if z > function.far:
        value = z**-0.5
        return value, -0.5 * value**3
    past = max(z - function.flat, 0.0)
    return (
        1.0 + past * past * (function.nu1 + function.nu2 * past),
        past * (2.0 * function.nu1 + 3.0 * function.nu2 * past),
    )
