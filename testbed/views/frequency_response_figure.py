"""The figure of `testbed frequency-response`: amplitudes and gains per hop over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import (
    BLACK,
    BLUE,
    BROWN,
    DASHED,
    GREEN,
    ORANGE,
    PINK,
    VIOLET,
    Line,
    Panel,
    PanelGrid,
)

COLOURS = (BLUE, ORANGE, GREEN, PINK, VIOLET, BROWN)
MARKERS = ("o", "s", "^", "D", "v", "P")  # of flights, for readers without colours
LEAST = 1e-3  # of the largest amplitude: what is drawn
INCHES = (13.0, 6.0)


@dataclass(frozen=True, slots=True)
class FollowerCurves:
    """Curves of one follower, predicted at F frequencies and flown at K."""

    name: str
    amplitude: Array  # (F,)
    per_hop: Array  # (F,) NaN: the leader is ahead
    flown_amplitude: Array  # (K,)
    flown_per_hop: Array  # (K,)


@dataclass(frozen=True, slots=True)
class ResponseCurves:
    """What is drawn, of at most as many followers as there are COLOURS."""

    title: str
    subtitle: str
    quantity: str  # with its unit
    frequency_hz: Array  # (F,)
    flown_hz: Array  # (K,)
    followers: Sequence[FollowerCurves]


def frequency_response_figure(data: ResponseCurves) -> PanelGrid:
    """Lay out amplitudes and gains per hop beside each other."""
    amplitude = [(each.amplitude, each.flown_amplitude) for each in data.followers]
    per_hop = [(each.per_hop, each.flown_per_hop) for each in data.followers]
    largest = max(float(each.max()) for each, _ in amplitude)
    limits = float(data.frequency_hz[0]), float(data.frequency_hz[-1])
    one = Line(np.array(limits), np.ones(2), BLACK, "no growth", 1.0, dashes=DASHED)
    panels = [
        Panel(
            data.quantity,
            "frequency, Hz",
            "",
            _lines(data, amplitude, LEAST * largest),
            x_log=True,
            y_log=True,
            x_limits=limits,
        ),
        Panel(
            "gain per hop: over the follower ahead",
            "frequency, Hz",
            "",
            [one, *_lines(data, per_hop, 0.0)] if _known(per_hop) else [],
            x_log=True,
            x_limits=limits,
            note="no follower receives from another one",
        ),
    ]
    return PanelGrid(data.title, data.subtitle, [panels], (1.0, 1.0), INCHES)


def _known(curves: Sequence[tuple[Array, Array]]) -> bool:
    return any(bool(np.isfinite(each).any()) for each, _ in curves)


def _lines(data: ResponseCurves, curves: Sequence[tuple[Array, Array]], least: float) -> list[Line]:
    lines = []
    for k, (each, (predicted, flown)) in enumerate(zip(data.followers, curves, strict=True)):
        shown = np.where(predicted > least, predicted, np.nan)
        lines.append(Line(data.frequency_hz, shown, COLOURS[k], each.name, 1.6))
        if len(data.flown_hz) and np.isfinite(flown).any():
            points = np.where(flown > least, flown, np.nan)
            label = f"{each.name}, flown"
            lines.append(
                Line(data.flown_hz, points, COLOURS[k], label, dots=True, marker=MARKERS[k])
            )
    return lines
