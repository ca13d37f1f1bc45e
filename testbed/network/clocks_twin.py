"""The compiled twin of `clocks.show`."""

# The numpy function carries the docstring and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import floor

from testbed.compiled import twin


@twin
def show(offset, drift, resolution, measured_s, rows, shown_s, ahead_s):
    for s in range(len(rows)):
        sender = rows[s]
        measured = measured_s[sender]
        shown = measured + offset[sender] + drift[sender] * measured
        grain = resolution[sender]
        if grain > 0.0:
            shown = floor(shown / grain) * grain
        shown_s[s] = shown
        for i in range(len(ahead_s)):
            ahead_s[i, s] = offset[i + 1] + drift[i + 1] * measured
