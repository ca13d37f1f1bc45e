"""Figures of an open loop L of `testbed margins`: Bode, Nyquist, and root locus over a factor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from testbed.core.records import Array
from testbed.views.panels import (
    BLACK,
    DASHES,
    DOTTED,
    GREY,
    ON_WHITE,
    Line,
    Panel,
    PanelGrid,
)
from testbed.views.poles_figure import (
    AXES,
    FASTEST_HZ,
    RIGHT_PER_S,
    SLOWEST_PER_S,
    damping_lines,
)

MAX_LOOPS = 6  # drawn
STYLES = tuple(zip(tuple(ON_WHITE.values())[:MAX_LOOPS], "os^DvP", strict=True))
PANEL_INCHES = (4.6, 2.9)  # width and height
SQUARE_INCHES = 4.2
HEADER_INCHES = 1.5
NYQUIST_RADIUS = 2.0  # around -1, beyond which the curve is left out
LEAST_SHOWN = 1e-2  # of |L|


@dataclass(frozen=True, slots=True)
class LoopCurves:
    """The loop of one follower, open and closed.

    Args:
        name: of the follower.
        frequency_hz: (F,).
        response: (F,) complex L, from the command given to minus that computed.
        factors: (G,) of the command, in order, 0 and 1 among them.
        poles: (G, n) complex, 1/s, of the closed loop with each.
    """

    name: str
    frequency_hz: Array
    response: Array
    factors: Array
    poles: Array


@dataclass(frozen=True, slots=True)
class LoopsAtBank:
    """The loops at one bank; `title` is of their panel."""

    title: str
    loops: Sequence[LoopCurves]


def bode_figure(title: str, subtitle: str, banks: Sequence[LoopsAtBank]) -> PanelGrid:
    """Lay out magnitude and phase of the loops, a column for each bank."""
    rows = [[_magnitude(each) for each in banks], [_phase(each) for each in banks]]
    return _grid(title, subtitle, rows, PANEL_INCHES)


def nyquist_figure(title: str, subtitle: str, banks: Sequence[LoopsAtBank]) -> PanelGrid:
    """Lay out the loops in the complex plane around -1, a panel for each bank."""
    return _grid(title, subtitle, [[_nyquist(each) for each in banks]], (SQUARE_INCHES,) * 2)


def root_locus_figure(title: str, subtitle: str, banks: Sequence[LoopsAtBank]) -> PanelGrid:
    """Lay out the poles of the closed loops over the factor, a panel for each bank."""
    return _grid(title, subtitle, [[_root_locus(each) for each in banks]], (SQUARE_INCHES,) * 2)


def _grid(
    title: str, subtitle: str, rows: Sequence[Sequence[Panel]], inches: tuple[float, float]
) -> PanelGrid:
    width, height = inches
    count = len(rows[0])
    size = max(count, 1.5) * width, HEADER_INCHES + len(rows) * height
    return PanelGrid(title, subtitle, rows, (1.0,) * count, size)


def _curves(bank: LoopsAtBank, x: Callable[..., Array], y: Callable[..., Array]) -> list[Line]:
    """Return a curve of each loop, by functions of a LoopCurves."""
    lines = []
    for k, each in enumerate(bank.loops):
        colour, marker = STYLES[k]
        more: dict[str, Any] = {"marker": marker, "marker_phase": k / len(bank.loops), "marks": 6}
        dashes = DASHES[k % len(DASHES)]
        lines.append(Line(x(each), y(each), colour, each.name, 1.4, dashes=dashes, **more))
    return lines


def _frequencies(bank: LoopsAtBank) -> dict[str, Any]:
    hz = bank.loops[0].frequency_hz
    return {"x_log": True, "x_limits": (float(hz[0]), float(hz[-1]))}


def _level(bank: LoopsAtBank, value: float, label: str = "") -> Line:
    hz = bank.loops[0].frequency_hz[[0, -1]]
    return Line(hz, np.full(2, value), BLACK, label, 1.2, dashes=DOTTED)


def _magnitude(bank: LoopsAtBank) -> Panel:
    def size(loop: LoopCurves) -> Array:
        found: Array = np.abs(loop.response)
        return np.where(found >= LEAST_SHOWN, found, np.nan)

    lines = [_level(bank, 1.0), *_curves(bank, lambda loop: loop.frequency_hz, size)]
    axes = _frequencies(bank)
    return Panel(bank.title, "frequency, Hz", "magnitude of L", lines, y_log=True, **axes)


def _phase(bank: LoopsAtBank) -> Panel:
    lines = _curves(bank, lambda loop: loop.frequency_hz, _phase_deg)
    line = _level(bank, -180.0)
    axes = _frequencies(bank)
    return Panel(
        bank.title, "frequency, Hz", "phase of L, °", [line, *lines], y_degrees=True, **axes
    )


def _phase_deg(loop: LoopCurves) -> Array:
    """Return the phase (F,) without jumps, from -360° to 0° where |L| is nearest to 1."""
    phase = np.degrees(np.unwrap(np.angle(loop.response)))
    size = np.abs(loop.response)
    at = phase[np.argmin(np.abs(np.log(np.maximum(size, 1e-9))))]
    whole: Array = phase - 360.0 * (np.floor(at / 360.0) + 1.0)
    return np.where(size >= LEAST_SHOWN, whole, np.nan)


def _nyquist(bank: LoopsAtBank) -> Panel:
    def shown(values: Callable[[Array], Array]) -> Callable[[LoopCurves], Array]:
        def near(loop: LoopCurves) -> Array:
            inside = np.abs(loop.response + 1.0) <= NYQUIST_RADIUS
            return np.where(inside, values(loop.response), np.nan)

        return near

    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    circle = Line(np.cos(angle), np.sin(angle), GREY, "|L| = 1", 0.8, dashes=DOTTED)
    lines = _curves(bank, shown(np.real), shown(np.imag))
    mirrored = [
        replace(each, y=-each.y, label="", width=0.7, marker="", dashes="-") for each in lines
    ]
    point = Line(np.full(1, -1.0), np.zeros(1), BLACK, "−1", dots=True, marker="x")
    drawn = [circle, *mirrored, *lines, point]
    return Panel(bank.title, "real part of L", "imaginary part of L", drawn, equal=True)


def _root_locus(bank: LoopsAtBank) -> Panel:
    lines, words = damping_lines()
    ends: list[Line] = []
    for k, each in enumerate(bank.loops):
        colour, _ = STYLES[k]
        paths = _branches(each.poles)
        inside = (paths.real > SLOWEST_PER_S) & (paths.real < RIGHT_PER_S)
        inside &= (paths.imag >= 0.0) & (paths.imag < 2.0 * math.pi * FASTEST_HZ)
        hz = np.where(inside, paths.imag / (2.0 * math.pi), np.nan)
        first = True
        for n in np.flatnonzero(inside.any(axis=0)).tolist():
            dashes, label = DASHES[k % len(DASHES)], each.name if first else ""
            lines.append(Line(paths.real[:, n], hz[:, n], colour, label, 1.3, dashes=dashes))
            first = False
        for factor, marker in ((0.0, "x"), (1.0, "o")):
            row = int(np.argmin(np.abs(each.factors - factor)))
            label = "" if k else f"factor {factor:g}"
            dot = Line(paths[row].real, hz[row], BLACK, label, dots=True, hollow=True)
            ends.append(replace(dot, marker=marker))
    return Panel(
        bank.title,
        *AXES,
        [*lines, *ends],
        words=words,
        x_limits=(SLOWEST_PER_S, RIGHT_PER_S),
        y_limits=(0.0, FASTEST_HZ),
    )


def _branches(poles: Array) -> Array:
    """Return poles (G, n) in columns that change least from row to row."""
    out = poles.copy()
    for row in range(1, len(out)):
        far = np.abs(out[row - 1][:, np.newaxis] - out[row][np.newaxis])
        _, order = linear_sum_assignment(far)
        out[row] = out[row][order]
    return out
