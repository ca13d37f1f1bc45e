"""The metric against each parameter: curves with bands over levels, scatters over many numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.report.cast import LOOKS
from testbed.report.drawing import Drawing
from testbed.report.study.numbers import PERCENT, running_quantiles
from testbed.report.study.rows import Parameter, Study, said
from testbed.state import Array, Truths
from testbed.views.panels import BLACK, DASHED, Band, Line, Panel, Space

MOST_DOTS = 1500  # of a scatter
FEWEST_RUNNING = 30  # flights of a scatter with running quantiles
WINDOW = 0.15  # share of the flights that a running quantile is of
QUANTILES = (0.1, 0.5, 0.9)
WIDE = 50.0  # ratio of the largest to the smallest number that asks for a logarithmic axis
UNITS = {
    "m": "m", "mps": "m/s", "s": "s", "deg": "°", "percent": "%", "hz": "Hz", "radps": "rad/s",
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """Flights that make one curve of a panel."""

    name: str
    here: Truths  # (R,)
    colour: str
    marker: str
    shift: float  # to the side, where levels have no numbers


def axis_of(metric: str) -> str:
    """What stands at the axis: the last name of the path that says something, and its unit."""
    parts = metric.split(".")
    for k in range(len(parts) - 1, -1, -1):
        unit = UNITS.get(parts[k].rsplit("_", 1)[-1]) if "_" in parts[k] else None
        if unit:
            return f"{'.'.join(parts[k:])}, {unit}"
    return parts[-1]


def wide(values: Array) -> bool:
    """Whether numbers, all above 0, ask for a logarithmic axis."""
    known = values[np.isfinite(values)]
    return bool(known.size and known.min() > 0.0 and known.max() > WIDE * known.min())


def fewer(count: int) -> NDArray[np.intp]:
    """Which of so many things in order are drawn: the first, the last, and evenly between."""
    if count <= MOST_DOTS:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, MOST_DOTS).round().astype(np.intp))


def parameters(study: Study, metric: str) -> Drawing | None:
    """A panel for each parameter."""
    rows = study.rows
    if not rows.parameters:
        return None
    panels: list[Panel] = []
    split: list[str] = []
    for each in rows.parameters:
        parts, by = _parts(study, each)
        split.append(by)
        draw = _scatter if each.continuous and study.random else _curves
        panels.append(draw(study, metric, each, parts))
    alone = len(panels) == 1
    lines: list[list[Panel | Space]] = [
        [*panels[k : k + (1 if alone else 2)]] for k in range(0, len(panels), 1 if alone else 2)
    ]
    text = [f"{metric} against each parameter"]
    text.append(f"; curves are {split[0]}." if split[0] else ", over everything else.")
    if any(not (each.continuous and study.random) for each in rows.parameters):
        text.append(
            f" Markers: {study.statistic} over {study.unit_name}, each taken as its mean over all"
            f" that the panel does not tell apart; shaded, or as upright lines: its {PERCENT} %"
            " interval (bootstrap). A black cross: at this level flights were lost or failed, and"
            " are not in the number."
        )
    if any(each.continuous and study.random for each in rows.parameters):
        text.append(
            f" Dots are flights, of more than {MOST_DOTS:,} evenly fewer; lines are running"
            f" quantiles, 10, 50 and 90 % (of several cases 50 % alone), each of the nearest"
            f" {WINDOW:.0%} of the flights."
        )
    if len(rows.cases) > len(LOOKS):
        text.append(f" Of {len(rows.cases)} cases the first {len(LOOKS)} are drawn.")
    height = 3.4 * len(lines) + 0.3
    widths = (1.0,) if alone else (1.0, 1.0)
    return Drawing(f"{metric} against parameters", "".join(text), lines, height, widths)


def _parts(study: Study, parameter: Parameter) -> tuple[list[Part], str]:
    """What makes a curve each, and in words: cases; of one case and two parameters, the other."""
    rows = study.rows
    others = [each for each in rows.parameters if each is not parameter]
    every = np.ones(rows.run.size, dtype=np.bool_)
    names: Sequence[str] = rows.cases
    index, by = rows.case_index, "cases"
    if len(rows.cases) == 1:
        other = others[0] if len(others) == 1 and not study.random else None
        if other is None or len(other.levels) > len(LOOKS):
            return [Part("", every, *LOOKS[0], shift=0.0)], ""
        names = [f"{other.key} {said(level)}" for level in other.levels]
        index, by = other.index, "levels of the other parameter"
    count = min(len(names), len(LOOKS))
    spread = 0.5 / max(count, 2)
    return [
        Part(names[k], index == k, *LOOKS[k], shift=spread * (k - 0.5 * (count - 1)))
        for k in range(count)
    ], by


def _curves(study: Study, metric: str, parameter: Parameter, parts: Sequence[Part]) -> Panel:
    lines: list[Line] = []
    bands: list[Band] = []
    values: list[Array] = []
    crosses: list[tuple[float, float]] = []
    for part in parts:
        found = [
            study.estimate(
                metric,
                part.here & (parameter.index == k),
                f"{parameter.key}/{said(level)}/{part.name}",
            )
            for k, level in enumerate(parameter.levels)
        ]
        x = parameter.numbers + (0.0 if parameter.numeric else part.shift)
        y, low, high = (
            np.array([getattr(each, name) for each in found]) for name in ("value", "low", "high")
        )
        values.append(y)
        if parameter.numeric:
            lines.append(Line(x, y, part.colour, part.name, 1.6, marker=part.marker, marks=0))
            if np.isfinite(low).any():
                bands.append(Band(x, low, high, part.colour))
        else:
            lines.append(Line(x, y, part.colour, part.name, dots=True, marker=part.marker))
            lines += [
                Line(np.full(2, at), np.array(ends), part.colour, width=2.0)
                for at, *ends in zip(x, low, high, strict=True)
                if np.isfinite(ends).all()
            ]
        for k, at in enumerate(x):
            bad = part.here & (parameter.index == k) & ~study.rows.good
            if bad.any() and np.isfinite(y[k]):
                crosses.append((float(at), float(y[k])))
    if crosses:
        at, y = np.array(crosses).T
        lines.append(Line(at, y, BLACK, "flights lost or failed", dots=True, marker="x"))
    ticks = [(float(k), said(level)) for k, level in enumerate(parameter.levels)]
    limits = (-0.5, len(parameter.levels) - 0.5)
    return Panel(
        "",
        parameter.key,
        axis_of(metric),
        lines,
        bands,
        x_log=parameter.logarithmic,
        y_log=wide(np.concatenate(values)),
        x_limits=None if parameter.numeric else limits,
        x_ticks=() if parameter.numeric else ticks,
        note="nothing was flown well",
    )


def _scatter(study: Study, metric: str, parameter: Parameter, parts: Sequence[Part]) -> Panel:
    x, y = parameter.numbers[parameter.index], study.rows.metrics[metric]
    lines: list[Line] = []
    drawn = study.rows.good & np.isfinite(y)
    for part in parts:
        here = np.flatnonzero(part.here & drawn)
        here = here[np.argsort(x[here], kind="stable")]
        some = here[fewer(here.size)]
        lines.append(Line(x[some], y[some], part.colour, part.name, dots=True))
        if here.size < FEWEST_RUNNING:
            continue
        window = max(int(WINDOW * here.size), FEWEST_RUNNING // 3)
        middle, found = running_quantiles(x[here], y[here], QUANTILES, window=window)
        at = fewer(middle.size)
        alone = len(parts) == 1
        for k, share in enumerate(QUANTILES):
            if alone or share == 0.5:
                colour = BLACK if alone else part.colour
                look = "-" if share == 0.5 else DASHED
                name = f"{share:.0%}" if alone else ""
                lines.append(Line(middle[at], found[k][at], colour, name, 1.8, dashes=look))
    return Panel(
        "", parameter.key, axis_of(metric), lines,
        x_log=parameter.logarithmic, y_log=wide(y[drawn]), note="nothing was flown well",
    )  # fmt: skip
