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
    DASHES,
    DOTTED,
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
WIDTHS = 2.2, 1.2  # of the curves of the first and the last follower, points
LEAST = 1e-3  # of the largest amplitude: what is drawn
LEAST_RANGE = 0.2  # of gains per hop: smaller differences would look large
INCHES = (13.0, 5.0)


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
    one = Line(np.array(limits), np.ones(2), BLACK, "no growth", 1.2, dashes=DOTTED)
    panels = [
        Panel(
            "",
            "frequency, Hz",
            data.quantity,
            _lines(data, amplitude, LEAST * largest),
            x_log=True,
            y_log=True,
            x_limits=limits,
        ),
        Panel(
            "",
            "frequency, Hz",
            "gain per hop",
            [one, *_lines(data, per_hop, 0.0)] if _known(per_hop) else [],
            x_log=True,
            x_limits=limits,
            y_limits=_limits(per_hop),
            note="no follower receives from another one",
        ),
    ]
    return PanelGrid(data.title, data.subtitle, [panels], (1.0, 1.0), INCHES)


def _limits(curves: Sequence[tuple[Array, Array]]) -> tuple[float, float] | None:
    """Return limits of gains per hop, around 1 if they hardly differ."""
    drawn = np.concatenate([np.ravel(each) for pair in curves for each in pair])
    drawn = np.append(drawn[np.isfinite(drawn)], 1.0)
    low, high = float(drawn.min()), float(drawn.max())
    return None if high - low >= LEAST_RANGE else (1.0 - LEAST_RANGE, 1.0 + LEAST_RANGE)


def _known(curves: Sequence[tuple[Array, Array]]) -> bool:
    return any(bool(np.isfinite(each).any()) for each, _ in curves)


def _lines(data: ResponseCurves, curves: Sequence[tuple[Array, Array]], least: float) -> list[Line]:
    lines = []
    for k, (each, (predicted, flown)) in enumerate(zip(data.followers, curves, strict=True)):
        shown = np.where(predicted > least, predicted, np.nan)
        dashes, marker = DASHES[k % len(DASHES)], MARKERS[k]
        # of several equal curves the broader ones are seen below the others
        lines.append(
            Line(
                data.frequency_hz,
                shown,
                COLOURS[k],
                each.name,
                WIDTHS[0] - (WIDTHS[0] - WIDTHS[1]) * k / max(len(curves) - 1, 1),
                dashes=dashes,
                marker=marker,
                marker_phase=k / len(curves),
                marks=5,
            )
        )
        if len(data.flown_hz) and np.isfinite(flown).any():
            points = np.where(flown > least, flown, np.nan)
            label = f"{each.name}, flown"
            lines.append(Line(data.flown_hz, points, COLOURS[k], label, dots=True, marker=marker))
    return lines
