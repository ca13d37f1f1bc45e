"""The compiled twin of `upsets.beyond`."""

# The numpy function carries the docstring and the types.
# ruff: noqa: ANN001, ANN201, D103
# mypy: ignore-errors

from __future__ import annotations

from math import sqrt

from testbed.compiled import twin


@twin
def beyond(airspeed, alpha, error_ned, limits, closest_m):
    out = False
    for i in range(len(airspeed)):
        if airspeed[i] > limits[0, i] or alpha[i] > limits[1, i]:
            out = True
    closest_m[0] = 0.0
    for i in range(len(error_ned)):
        x, y, z = error_ned[i]
        distance = sqrt(x * x + y * y + z * z)
        if distance < closest_m[i + 1]:
            closest_m[i + 1] = distance
        if distance > limits[2, i + 1] + closest_m[i + 1]:
            out = True
    return out
