"""The figure of `testbed margins`: the poles of the followers at each bank."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import BLACK, GREY, ON_WHITE, Line, Panel, PanelGrid, Word

COLOURS = tuple(ON_WHITE.values())
MARKERS = ("s", "x", "o", "^", "v", "D")  # hollow: seen over each other, where poles are equal
FASTEST_HZ = 3.0  # faster poles are those of filters
SLOWEST_PER_S, RIGHT_PER_S = -8.0, 0.8  # real parts drawn
AXES = "real part, 1/s", "frequency of oscillations, Hz"
RATIOS = (0.1, 0.2, 0.3)  # of damping, at which lines are drawn
NAMED_AT = 0.91  # of their height
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
    panels = [_panel(each) for each in banks]
    size = max(len(panels), 2) * width, HEADER_INCHES + height
    return PanelGrid(title, subtitle, [panels], (1.0,) * len(panels), size)


def _panel(bank: PolesAtBank) -> Panel:
    lines, words = damping_lines()
    for k, (name, poles) in enumerate(bank.poles.items()):
        shown = poles[
            (poles.imag > 0.0)
            & (poles.imag < 2.0 * math.pi * FASTEST_HZ)
            & (poles.real > SLOWEST_PER_S)
        ]
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        lines.append(
            Line(
                shown.real,
                shown.imag / (2.0 * math.pi),
                colour,
                name,
                dots=True,
                hollow=True,
                marker=marker,
            )
        )
    return Panel(bank.title, *AXES, lines, words=words, x_limits=(SLOWEST_PER_S, RIGHT_PER_S))


def damping_lines() -> tuple[list[Line], list[Word]]:
    """Return the lines of equal damping, their names, and the limit of stability."""
    frequency = np.linspace(0.0, FASTEST_HZ, 2)
    slopes = {each: -2.0 * math.pi * each / math.sqrt(1.0 - each**2) for each in RATIOS}
    lines = [Line(slope * frequency, frequency, GREY, width=0.8) for slope in slopes.values()]
    high = NAMED_AT * FASTEST_HZ
    words = [Word(slope * high, high, f"{each:g}") for each, slope in slopes.items()]
    lines[0] = replace(lines[0], label="lines of equal damping ratio")
    return [*lines, Line(np.zeros(2), frequency, BLACK, "unstable to the right")], words
