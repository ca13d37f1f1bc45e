"""The figure of `testbed margins`: the poles of the followers at each bank."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import GREY, GRID, ON_WHITE, Line, Panel, PanelGrid

COLOURS = tuple(ON_WHITE.values())
MARKERS = ("s", "x", "o", "^", "v", "D")  # seen over each other, where poles are equal
FASTEST_HZ = 3.0  # faster poles are those of filters
SLOWEST_PER_S = -8.0
RATIOS = (0.1, 0.2, 0.3)  # of damping, at which lines are drawn
PANEL_INCHES = (4.2, 3.8)  # width and height
HEADER_INCHES = 1.6


@dataclass(frozen=True, slots=True)
class PolesAtBank:
    """The poles of followers at one bank.

    Args:
        title: of the panel.
        poles: (k,) complex, 1/s, of each follower by its name.
    """

    title: str
    poles: dict[str, Array]


def poles_figure(title: str, subtitle: str, banks: Sequence[PolesAtBank]) -> PanelGrid:
    """Lay out a panel for each bank: real parts and frequencies of oscillations."""
    width, height = PANEL_INCHES
    panels = [_panel(each, first=each is banks[0]) for each in banks]
    size = max(len(panels), 2) * width, HEADER_INCHES + height
    return PanelGrid(title, subtitle, [panels], (1.0,) * len(panels), size)


def _panel(bank: PolesAtBank, *, first: bool) -> Panel:
    frequency = np.linspace(0.0, FASTEST_HZ, 2)
    lines = [
        Line(
            -2.0 * math.pi * frequency * ratio / math.sqrt(1.0 - ratio**2),
            frequency,
            GRID if ratio != RATIOS[0] else GREY,
            f"damping ratio {', '.join(map(str, RATIOS))}" if ratio == RATIOS[0] else "",
        )
        for ratio in RATIOS
    ]
    lines.append(Line(np.zeros(2), frequency, "#000000", "unstable to the right"))
    for k, (name, poles) in enumerate(bank.poles.items()):
        shown = poles[
            (poles.imag > 0.0)
            & (poles.imag < 2.0 * math.pi * FASTEST_HZ)
            & (poles.real > SLOWEST_PER_S)
        ]
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        lines.append(
            Line(shown.real, shown.imag / (2.0 * math.pi), colour, name, dots=True, marker=marker)
        )
    return Panel(bank.title, "real part, 1/s", "frequency, Hz" if first else "", lines)
