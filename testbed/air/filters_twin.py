"""The compiled twin of `filters.write_filters`, part by part."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import exp, expm1, pi, sqrt

import numpy as np

from testbed.air.filters import MIXTURES, PARTED, SERIES
from testbed.compiled import twin

_SERIES = tuple(SERIES[::-1].tolist())
_TINY = float(np.finfo(np.float64).tiny)
# cos 15° and sin 15°
_BASIS = ((sqrt(3.0) + 1.0) / (2.0 * sqrt(2.0)), (sqrt(3.0) - 1.0) / (2.0 * sqrt(2.0)))


def write_filters(spectrum, distance, sigma, length, span, filters):
    _write(*MIXTURES[spectrum], distance, sigma, length, span, *filters)


@twin
def _transition(step, corner):
    """The six numbers of Φ that are not zero, row by row."""
    decay, fast = exp(-step), exp(-corner * step)
    gap = corner - 1.0
    once = -max(decay, fast) * expm1(-abs(gap) * step) / abs(gap)
    if abs(gap * step) < 0.05:
        series = 0.0
        for each in _SERIES:
            series = each + series * (gap * step)
        twice = step * step * decay * series
    else:
        twice = (step * decay - once) / gap
    coupling = -2.0 * sqrt(corner)
    return decay, -2.0 * step * decay, decay, coupling * (once - 2.0 * twice), coupling * once, fast


@twin
def _root(phi, step, corner):
    """The six numbers of the root that are not zero, row by row."""
    q11 = -expm1(-2.0 * step)
    q22 = q11 - phi[1] ** 2
    q33 = -expm1(-2.0 * corner * step) - phi[3] ** 2 - phi[4] ** 2
    first = sqrt(q11)
    a = -phi[1] * phi[0] / max(first, _TINY)
    b = -phi[3] * phi[0] / max(first, _TINY)
    second = sqrt(max(q22 - a * a, 0.0))
    c = (-(phi[1] * phi[3] + phi[2] * phi[4]) - a * b) / max(second, _TINY)
    return first, a, second, b, c, sqrt(max(q33 - b * b - c * c, 0.0))


@twin
def _rate(corner):
    a, root3 = corner, sqrt(3.0)
    third = a**2 * (root3 * a - 1.0) / (sqrt(2.0 * a) * (1.0 + a) ** 2)
    first = a * (1.0 + root3) / (2.0 * sqrt(2.0) * (1.0 + a))
    return first, (root3 * a - sqrt(2.0 * a) * third) / sqrt(2.0) - first, third


@twin
def _write_lower(out, i, axis, m, six):
    k = 0
    for row in range(3):
        for column in range(row + 1):
            out[i, axis, m, row, column] = six[k]
            k += 1


@twin
def _write(
    shares,
    lengths,
    distance,
    sigma,
    length,
    span,
    keep,
    fresh,
    gain,
    transition,
    root,
    speed,
    rate,
):
    parts = len(shares)
    for i in range(len(span)):
        b = span[i]
        for m in range(parts + 1):
            if m < parts:
                pole = 1.0 / (length[i, 0] * lengths[m])
                gain[i, m] = sigma[i, 0] * sqrt(shares[m])
            else:
                pole = pi / (4.0 * b)
                rolling = (pi * length[i, 2] / (4.0 * b)) ** (1.0 / 3.0)
                level = sigma[i, 2] ** 2 / length[i, 2] * 0.8 * rolling
                gain[i, m] = sqrt(level * pi**2 / (8.0 * b))
            keep[i, m] = exp(-distance[i] * pole)
            fresh[i, m] = sqrt(-expm1(-2.0 * distance[i] * pole))
        for axis in range(2):
            for m in range(parts):
                strength = sigma[i, 1 + axis] * sqrt(shares[m])
                long = length[i, 1 + axis] * lengths[m]
                corner = pi * long / ((3.0 + axis) * b)
                if abs(corner - 1.0) < PARTED:
                    corner = 1.0 + PARTED
                step = distance[i] / long
                phi = _transition(step, corner)
                _write_lower(transition, i, axis, m, phi)
                _write_lower(root, i, axis, m, _root(phi, step, corner))
                for k in range(2):
                    speed[i, axis, m, k] = strength * _BASIS[k]
                slope = strength / long * (1.0 - 2.0 * axis)
                turns = _rate(corner)
                for k in range(3):
                    rate[i, axis, m, k] = slope * turns[k]
