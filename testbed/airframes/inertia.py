"""Checks of an inertia tensor: which no rigid body has, and which are unlikely."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array

_ROUNDING = 1e-6  # of the largest moment; a flat plate has J1 + J2 = J3 exactly
# An aircraft is nearly flat, so that J1 + J2 is little more than J3. With errors of a fifth, as of
# moments from radii of gyration of similar aircraft, the sum falls short by up to 0.8 / 1.2 of J3.
_SMALLEST_SUM = 0.8 / 1.2  # of J3
_AXES = ((0, 0, "Jxx"), (1, 1, "Jyy"), (2, 2, "Jzz"), (0, 1, "Jxy"), (0, 2, "Jxz"), (1, 2, "Jyz"))


def impossible_inertia(tensor: Array) -> str | None:
    """Return why an inertia tensor (3, 3), kg m², is refused, or None.

    The principal moments J1 ≤ J2 ≤ J3 are integrals of y² + z², x² + z² and x² + y² over a mass
    without negative density: they are positive, and none exceeds the sum of the others. What falls
    short of that by less than a third is an error of estimates: see `unlikely_inertia`.
    """
    if not np.isfinite(tensor).all():
        return f"{_elements(tensor)} kg m²: they must be finite"
    first, second, third = _principal(tensor)
    if not first > 0.0:
        return f"{_words(tensor)}, and J1 > 0 fails: the tensor must be positive definite"
    if first + second < third * _SMALLEST_SUM:
        return f"{_words(tensor)}, and J1 + J2 ≥ J3 fails: {first + second:.4g} < {third:.4g}"
    return None


def unlikely_inertia(tensor: Array) -> str:
    """Return why a possible inertia tensor (3, 3), kg m², is inexact; "" if it need not be."""
    first, second, third = _principal(tensor)
    if first + second >= third * (1.0 - _ROUNDING):
        return ""
    short = 1.0 - (first + second) / third
    return (
        f"{_words(tensor)}, and J1 + J2 is {100.0 * short:.2g} % less than J3: a moment of inertia "
        "is inexact; it is flown as it is"
    )


def _principal(tensor: Array) -> tuple[float, float, float]:
    first, second, third = np.linalg.eigvalsh(0.5 * (tensor + tensor.T)).tolist()
    return first, second, third


def _elements(tensor: Array) -> str:
    return ", ".join(
        f"{name} {tensor[i, j]:.4g}" for i, j, name in _AXES if i == j or tensor[i, j] != 0.0
    )


def _words(tensor: Array) -> str:
    first, second, third = _principal(tensor)
    principal = f"J1 {first:.4g}, J2 {second:.4g}, J3 {third:.4g}"
    return f"{_elements(tensor)} kg m²: the principal moments are {principal}"
