"""The figure that compares two runs: distances from the slots over time, in a column's width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from testbed.core.errors import InputError
from testbed.reports.figure_spec import TIME_LABEL, WIDTH_IN, samples_on_axis
from testbed.reports.plot_selection import MAX_SINGLE, STYLES, WORST, decimate
from testbed.reports.run_data import RunData
from testbed.views.figure_style import TITLES_IN
from testbed.views.panels import DASHED, Line, Panel, PanelGrid

COLUMN_IN = 3.5  # width of a column of a paper, inches
PANEL_IN, AROUND_IN = 1.65, 0.5  # height of a panel; of the axis below, with text of 12 points
WIDTH_PT = 1.35  # of the curves, with text of 12 points


def compared_followers(first: RunData, second: RunData) -> list[str]:
    """Return the followers of both runs; of more than `MAX_SINGLE`, those with the largest errors.

    Raises:
        InputError: the runs have no follower in common.
    """
    names = [name for name in first.followers if name in second.followers]
    if not names:
        raise InputError(f"{first.path}, {second.path}: no follower is in both runs")
    if len(names) <= MAX_SINGLE:
        return names

    def largest(name: str) -> float:
        errors = (each.error[:, each.followers.index(name)] for each in (first, second))
        squares = [error[np.isfinite(error)] ** 2 for error in errors]
        return max((float(square.mean()) for square in squares if square.size), default=0.0)

    worst = sorted(names, key=largest, reverse=True)[:WORST]
    return [name for name in names if name in worst]


def compare_figure(first: RunData, second: RunData, labels: Sequence[str]) -> PanelGrid:
    """Draw the distance of each follower from its slot in both runs, one panel for each.

    The axes show the time that both runs cover, and fit the errors after all followers joined.

    Args:
        first: drawn solid.
        second: drawn dashed.
        labels: of the two.

    Raises:
        InputError: the runs have no follower, or no time, in common.
    """
    runs = first, second
    begin = max(float(each.log.time_s[0]) for each in runs)
    end = min(float(each.log.time_s[-1]) for each in runs)
    if begin >= end:
        raise InputError(f"{first.path}, {second.path}: the runs have no time in common")
    panels, highest = [], 0.0
    for name in compared_followers(first, second):
        lines = []
        for run, label, dashes, (colour, _) in zip(
            runs, labels, ("-", DASHED), STYLES[:2], strict=True
        ):
            row, time = run.followers.index(name), run.log.time_s
            error = run.error[:, row]
            at = decimate(error)
            lines.append(Line(time[at], error[at], colour, label, WIDTH_PT, dashes=dashes))
            fits = samples_on_axis(run)[0][:, row] & (time >= begin) & (time <= end)
            highest = max(highest, float(error.max(initial=0.0, where=fits & np.isfinite(error))))
        panels.append(
            Panel(name, TIME_LABEL, "distance from slot, m", lines, x_limits=(begin, end))
        )
    limits = (0.0, 1.08 * highest or 1.0)  # the same for all, so that they can be compared
    panels = [replace(each, y_limits=limits) for each in panels]
    inches = WIDTH_IN, PANEL_IN * len(panels) + AROUND_IN + TITLES_IN
    return PanelGrid("", "", [[each] for each in panels], (1.0,), inches)


def run_labels(first: RunData, second: RunData, names: Sequence[str]) -> tuple[str, str]:
    """Return the names of two runs: their scenarios, or as they were given if these are equal.

    Args:
        first: a run.
        second: another.
        names: of both, as the user wrote them.
    """
    one, two = (each.log.info.scenario_name for each in (first, second))
    return (one, two) if one != two else (names[0], names[1])
