"""The figure of `testbed delay`: offsets of the followers over the delay of the messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import DASHES, ON_WHITE, Line, Panel, PanelGrid

COLOURS = tuple(ON_WHITE.values())[:6]
MARKERS = ("o", "s", "^", "D", "v", "P")
TITLES = {
    "receipt": "extrapolated from receipt",
    "timestamp": "extrapolated from measurement",
    "law": "",  # a user's law alone
}
DIRECTIONS = ("forward", "right")
PANEL_INCHES = (4.8, 2.8)  # width and height
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
    """Lay out a column for each origin of the extrapolation: offsets forward, and right.

    Of more than six followers some are drawn, evenly selected. A direction without an offset of
    `LEAST_M` is left out, but for the first.
    """
    count = min(len(followers), len(COLOURS))
    rows = np.unique(np.linspace(0, len(followers) - 1, count).round().astype(int))
    drawn = [followers[k] for k in rows.tolist()]
    origins = list(drawn[0].predicted)
    panels = []
    for axis, direction in enumerate(DIRECTIONS):
        of_axis = [_lines(drawn, origin, axis) for origin in origins]
        values = [line.y[np.isfinite(line.y)] for lines in of_axis for line in lines]
        ends = np.concatenate([np.zeros(1), *values])
        if axis and np.abs(ends).max() < LEAST_M:
            continue
        margin = max(0.06 * float(np.ptp(ends)), LEAST_M)
        limits = float(ends.min()) - margin, float(ends.max()) + margin
        label = f"{direction} of the slot, m"
        panels.append(
            [
                Panel(
                    TITLES[origin],
                    "delay of messages, s",
                    label,
                    lines,
                    x_limits=(0.0, 1.05 * float(followers[0].delay_s.max()) or 1.0),
                    y_limits=limits,
                )
                for origin, lines in zip(origins, of_axis, strict=True)
            ]
        )
    width, height = PANEL_INCHES
    size = max(len(origins) * width, 1.5 * width), HEADER_INCHES + len(panels) * height
    return PanelGrid(title, subtitle, panels, (1.0,) * len(origins), size)


def _lines(followers: Sequence[FollowerOffsets], origin: str, axis: int) -> list[Line]:
    """Return the curves of a panel: predicted ones as lines, flown ones as filled marks."""
    lines = []
    for k, each in enumerate(followers):
        predicted, flown = (of[origin][:, axis] for of in (each.predicted, each.flown))
        colour, marker = COLOURS[k], MARKERS[k]
        dashes = DASHES[k % len(DASHES)]
        lines.append(
            Line(
                each.delay_s,
                predicted,
                colour,
                each.name,
                1.4,
                dashes=dashes,
                marker=marker,
                marks=0,
            )
        )
        lines.append(
            Line(each.delay_s, flown, colour, f"{each.name}, flown", dots=True, marker=marker)
        )
    return [each for each in lines if np.isfinite(each.y).any()]  # others have no mark
