"""The compiled twin of `upsets.beyond`."""

# The numpy function carries the docstring and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import sqrt

from testbed.compiled import twin


@twin
def beyond(airspeed, alpha, error_ned, limits):
    for i in range(len(airspeed)):
        if airspeed[i] > limits[0, i] or alpha[i] > limits[1, i]:
            return True
    for i in range(len(error_ned)):
        x, y, z = error_ned[i]
        if sqrt(x * x + y * y + z * z) > limits[2, i + 1]:
            return True
    return False
