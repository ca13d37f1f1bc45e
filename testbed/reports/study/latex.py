"""A LaTeX table of a study: its metrics by case and point, with intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.core.errors import InputError
from testbed.reports.latex import tabular
from testbed.reports.study.report_table import format_cell
from testbed.reports.study.study_data import (
    PERCENT,
    StudyData,
    format_level,
    metric_words,
)
from testbed.reports.study.tables import MAX_POINTS


def latex_table(study: StudyData) -> str:
    """Return a `tabular` with a row for each case and point, and a column for each metric.

    The rows are those of the table of points; of a study with drawn points, or with more than
    `MAX_POINTS` of them, those of cases and laws. It needs no package.

    Raises:
        InputError: the study is a map.
    """
    if study.is_map:
        raise InputError(
            "a table of a map would have one number for each case, over points that are not even: "
            "there are more where the number changes (write --tables DIR for its boundary and its "
            "points, --figures DIR for the map)"
        )
    flights = study.flights
    parameters = flights.parameters
    places = sorted({*zip(flights.case_index.tolist(), flights.point.tolist(), strict=True)})
    by_point = not study.random and bool(parameters) and len(places) <= MAX_POINTS
    several = len(flights.cases) > 1 if by_point else bool(flights.groups_title)
    head = [flights.groups_title.capitalize() or "Case"] if several and not by_point else []
    head += ["Case"] if several and by_point else []
    rows: list[list[str]] = []
    if by_point:
        head += [each.label for each in parameters]
        for case, point in places:
            here = (flights.case_index == case) & (flights.point == point)
            one = int(np.flatnonzero(here)[0])
            values = [format_level(each.levels[each.index[one]]) for each in parameters]
            name = f"point/{flights.cases[case]}/{'/'.join(values)}"
            cells = [format_cell(study.estimate(m, here, name)) for m in study.metrics]
            rows.append([*([flights.case_labels[case]] if several else []), *values, *cells])
    else:
        for group in flights.groups:
            name = f"all/{group.name or flights.cases[0]}"
            cells = [format_cell(study.estimate(m, group.flights, name)) for m in study.metrics]
            rows.append([*([group.label] if several else []), *cells])
    units = [f"{words} ({unit})" if unit else words for words, unit in map(_words, study.metrics)]
    columns = "l" * len(head) + "r" * len(units)
    note = (
        f"{study.name}: {study.statistic} over {study.unit_name} [{PERCENT} % interval], "
        f"{int(flights.completed.sum())} of {study.planned} flights"
    )
    return tabular(note, columns, [*head, *units], [rows])


def _words(metric: str) -> Sequence[str]:
    words, unit = metric_words(metric)
    return words[0].upper() + words[1:], unit
