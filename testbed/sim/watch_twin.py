"""The compiled twin of `watch.held`."""

# The numpy function carries the docstring and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import sqrt

from testbed.compiled import bound, twin
from testbed.metrics.tally import ENGAGED_RADIUS_M


def ready_held(error_ned, gone, awaited, since, long):
    return bound(_held, error_ned, gone, awaited, since, long, more=(0,))


@twin
def _held(error_ned, gone, awaited, since, long, tick):
    out = False
    for i in range(len(error_ned)):
        x, y, z = error_ned[i]
        inside = sqrt(x * x + y * y + z * z) <= ENGAGED_RADIUS_M
        if gone[0] or gone[i + 1] or not inside:
            since[i] = -1
        else:
            if since[i] < 0:
                since[i] = tick
            if awaited[i] and tick - since[i] >= long:
                out = True
    return out
