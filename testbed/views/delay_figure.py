"""The figure of `testbed delay`: offsets of each follower over the delay of the messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import BLUE, ORANGE, Line, Panel, PanelGrid

COLOURS = {"receipt": ORANGE, "timestamp": BLUE, "law": ORANGE}  # a user's law alone
DIRECTIONS = ("forward", "right")
PANEL_INCHES = (3.6, 2.8)  # width and height
HEADER_INCHES = 1.3
LEAST_M = 0.1  # of an axis: smaller offsets would show rounding


@dataclass(frozen=True, slots=True)
class FollowerOffsets:
    """Offsets (K, 3), m, of one follower at K delays, by the origin of the extrapolation.

    NaN: not known.
    """

    name: str
    delay_s: Array  # (K,)
    predicted: Mapping[str, Array]
    flown: Mapping[str, Array]


def delay_figure(title: str, subtitle: str, followers: Sequence[FollowerOffsets]) -> PanelGrid:
    """Lay out a column for each follower: offsets forward, and right."""
    rows = [
        [_panel(each, axis, first=each is followers[0]) for each in followers]
        for axis in range(len(DIRECTIONS))
    ]
    width, height = PANEL_INCHES
    size = max(len(followers), 2) * width, HEADER_INCHES + len(rows) * height
    return PanelGrid(title, subtitle, rows, (1.0,) * len(followers), size)


def _panel(follower: FollowerOffsets, axis: int, *, first: bool) -> Panel:
    lines = []
    for origin, of_origin in follower.predicted.items():
        colour = COLOURS[origin]
        predicted, flown = of_origin[:, axis], follower.flown[origin][:, axis]
        from_ = f"from {origin}"
        lines += [
            Line(follower.delay_s, predicted, colour, f"predicted, {from_}", 1.4),
            Line(follower.delay_s, flown, colour, f"flown, {from_}", 5.0, dots=True),
        ]
    lines = [each for each in lines if np.isfinite(each.y).any()]  # others have no mark
    largest = max((float(np.nanmax(np.abs(each.y))) for each in lines), default=0.0)
    top = axis == 0
    return Panel(
        follower.name if top else "",
        "" if top else "delay, s",
        f"{DIRECTIONS[axis]}, m" if first else "",
        lines,
        y_limits=(-LEAST_M, LEAST_M) if largest < LEAST_M else None,
    )
