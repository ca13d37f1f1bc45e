"""Figures of control functions μ and barriers h: Figs. 1 and 2 of [HBH23]."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from testbed.formation.barrier import SpeedBarrier, UserBarrier, barrier_curve
from testbed.formation.control_function import (
    ControlFunction,
    UserControlFunction,
    control_function_curve,
)
from testbed.reports.figure_spec import Figure, FigureSpec, make_figure
from testbed.reports.plot_selection import STYLES
from testbed.views.panels import BLACK, Line, Panel

Functions = Mapping[str, ControlFunction | UserControlFunction]
Barriers = Mapping[str, tuple[SpeedBarrier | UserBarrier, float, float]]  # with s_lo and s_hi, m/s
POINTS = 601
NEAR = 2.0  # m/s, how far outside the speed bounds barriers are drawn


def law_figures(functions: Functions, barriers: Barriers, subtitle: str) -> Iterator[Figure]:
    """Yield the figures of control functions and of barriers, by label."""
    yield make_figure("control-functions", _functions(functions), subtitle)
    yield make_figure("barriers", _barriers(barriers), subtitle)


def _functions(functions: Functions) -> FigureSpec:
    # up to where all are close to their largest closing speed
    end = 3.0 * max(half_way(each) for each in functions.values())
    x = np.linspace(0.0, end, POINTS)
    scalar, length = [], []
    for k, (label, function) in enumerate(functions.items()):
        colour, marker = STYLES[k % len(STYLES)]
        more: Any = {"marker": marker, "marker_phase": k / len(functions)}
        value, _ = control_function_curve(function, x * x)
        scalar.append(Line(x * x, value, colour, label, 1.4, **more))
        length.append(Line(x, x * value, colour, label, 1.4, **more))
    return FigureSpec(
        "Control functions",
        "Left: μ of (5) over the squared length of the formation error. Right: the length of ρ,"
        " which times k is the speed at which an error is closed.",
        [[Panel("", "z = ‖ξ‖², m²", "μ(z)", scalar), Panel("", "‖ξ‖, m", "‖ρ(ξ)‖", length)]],
        4.2,
    )


def _barriers(barriers: Barriers) -> FigureSpec:
    value_lines, slope_lines = [], []
    bounds = sorted({bound for _, *both in barriers.values() for bound in both})
    for k, (label, (barrier, low, high)) in enumerate(barriers.items()):
        colour, marker = STYLES[k % len(STYLES)]
        more: Any = {"marker": marker, "marker_phase": k / len(barriers)}
        s = np.linspace(max(low - NEAR, 0.0), high + NEAR, POINTS)
        value, slope = barrier_curve(barrier, s, low, high)
        value_lines.append(Line(s, value, colour, label, 1.4, **more))
        slope_lines.append(Line(s, slope, colour, label, 1.4, **more))
    marks = [(bound, BLACK) for bound in bounds]
    left = Panel("", "s, m/s", "h(s)", value_lines, marks=marks)
    right = Panel("", "s, m/s", "h'(s), s/m", slope_lines, marks=marks)
    return FigureSpec(
        "Barriers",
        "h of (14) and its derivative over the ground speed; dotted vertical lines: the speed"
        " bounds.",
        [[left, right]],
        4.2,
    )


def half_way(function: ControlFunction | UserControlFunction) -> float:
    """Return the smallest length of an error, m, with half of the largest ‖ρ‖."""
    x = np.geomspace(1e-3, 1e5, 2001)
    value, _ = control_function_curve(function, x * x)
    return float(x[np.argmax(x * value >= 0.5 * function.bound)])
