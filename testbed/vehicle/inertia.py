"""Check of inertia tensors."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array

_ROUNDING = 1e-6  # of the largest moment; a flat plate has J1 + J2 = J3 exactly
_AXES = ((0, 0, "Jxx"), (1, 1, "Jyy"), (2, 2, "Jzz"), (0, 1, "Jxy"), (0, 2, "Jxz"), (1, 2, "Jyz"))


def impossible_inertia(tensor: Array) -> str | None:
    """Return why no rigid body has an inertia tensor (3, 3), kg m²; None if one can.

    The principal moments J1 ≤ J2 ≤ J3 are integrals of y² + z², x² + z² and x² + y² over a mass
    without negative density: they are positive, and none exceeds the sum of the others.
    """
    elements = ", ".join(
        f"{name} {tensor[i, j]:.4g}" for i, j, name in _AXES if i == j or tensor[i, j] != 0.0
    )
    if not np.isfinite(tensor).all():
        return f"{elements} kg m²: they must be finite"
    first, second, third = np.linalg.eigvalsh(0.5 * (tensor + tensor.T)).tolist()
    principal = f"J1 {first:.4g}, J2 {second:.4g}, J3 {third:.4g}"
    if not first > 0.0:
        return (
            f"{elements} kg m²: the principal moments are {principal}, and J1 > 0 fails: the "
            f"tensor must be positive definite"
        )
    if first + second < third * (1.0 - _ROUNDING):
        return (
            f"{elements} kg m²: the principal moments are {principal}, and J1 + J2 ≥ J3 fails: "
            f"{first + second:.4g} < {third:.4g}"
        )
    return None
