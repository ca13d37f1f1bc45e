"""The tables of a study: results, effects of parameters, cases, points, losses, worst flights."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from testbed.core.files import write_text_file
from testbed.core.records import Array, BoolArray
from testbed.metrics.side_effects import better_sign, describe_change
from testbed.reports.study.map_points import LOST_SHARE, MapPoints, map_axes, map_points
from testbed.reports.study.report_table import Cell, ReportTable, rounding_of
from testbed.reports.study.study_data import (
    MAX_LEVELS,
    PERCENT,
    IntervalEstimate,
    Parameter,
    StudyData,
    estimate_of,
    format_level,
    rank_correlation,
    variance_share,
    wilson,
)

MAX_POINTS = 60  # rows of the table of all points
MAX_WORST = 12
GROUPS = 4  # of a parameter with many numbers
UNEVEN_MAP = (
    "Of the points flown. There is no median or mean over them, because a map has more points where"
    " the number changes: it would be one of these points, not of the area."
)


def study_tables(study: StudyData) -> Iterator[ReportTable]:
    """Yield the tables for which the study has data."""
    yield overview(study)
    for table in (boundary(study), effects(study), cases(study), side_effects(study)):
        if table is not None:
            yield table
    yield from points(study)
    yield losses(study)
    yield worst(study)


def table_file(table: ReportTable) -> str:
    """Return the name of the CSV file of a table."""
    return re.sub(r"[^\w.-]+", "-", table.name) + ".csv"


def write_tables(tables: Iterable[ReportTable], folder: Path) -> list[Path]:
    """Write tables as CSV to a folder, which is made if needed; return the files.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for table in tables:
        paths.append(folder / table_file(table))
        with write_text_file(paths[-1]) as file:
            file.write(table.to_csv())
    return paths


def overview(study: StudyData) -> ReportTable:
    """Tabulate each metric by case and law, over all completed flights."""
    flights = study.flights
    out: list[tuple[Cell, ...]] = []
    titles = [flights.groups_title] if flights.groups_title else []
    for metric in study.metrics:
        values = flights.metrics[metric]
        for group in flights.groups:
            known = values[group.flights & flights.completed & np.isfinite(values)]
            spread = np.quantile(known, [0.05, 0.95]) if known.size else [math.nan, math.nan]
            name = group.name or flights.cases[0]
            least, largest = (
                (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
            )
            head: tuple[Cell, ...] = (metric, *([group.label] if titles else []), known.size)
            if study.is_map:
                out.append((*head, least, largest))
            else:
                centre = study.estimate(metric, group.flights, f"all/{name}")
                out.append((*head, centre, least, float(spread[0]), float(spread[1]), largest))
    if study.is_map:
        columns = ("metric", *titles, "flights", "least", "largest")
        return ReportTable("overview", "Overview", columns, out, UNEVEN_MAP)
    heading = f"{study.statistic} [{PERCENT} %]"
    note = (
        f"The {study.statistic} over {study.unit_name}, of the mean over the flights of each, with"
        f" its {PERCENT} % interval (bootstrap). Lost and failed flights are excluded."
    )
    columns = ("metric", *titles, "flights", heading, "least", "5 %", "95 %", "largest")
    return ReportTable("overview", "Overview", columns, out, note)


def boundary(study: StudyData) -> ReportTable | None:
    """Tabulate between which points of a map flights are no longer completed."""
    axes, flights = map_axes(study), study.flights
    if axes is None or not study.metrics:
        return None
    metric, titles = study.metrics[0], [flights.groups_title] if flights.groups_title else []
    found = {
        group.label: map_points(study, metric, axes, group.flights) for group in flights.groups
    }
    across = [(name, *each) for name, of in found.items() for each in _crossings(of.x, of.y, of)]
    up = [(name, *each) for name, of in found.items() for each in _crossings(of.y, of.x, of)]
    # along the first axis, if at least as many levels of the other one have a boundary
    crossed, of_other = (len({row[:2] for row in rows}) for rows in (across, up))
    (along, other), rows = (axes, across) if crossed >= of_other else (axes[::-1], up)
    if not rows:
        return None
    note = (
        f"Neighbouring points along {along.label} of which one is completed, and of the other at"
        " least half of the flights are not."
    )
    columns = (
        *titles,
        other.label,
        f"completed at {along.label}",
        "not completed at",
        "most ended",
    )
    out = [row if titles else row[1:] for row in rows]
    return ReportTable("boundary", "Boundary of completed flights", columns, out, note)


def _crossings(along: Array, other: Array, points: MapPoints) -> Iterator[tuple[str, ...]]:
    """Yield neighbours of which one is completed: level of the other axis, both, and the end.

    Args:
        along: (P,) values on the axis along which neighbours are looked for.
        other: (P,) values on the other axis.
        points: of the map.
    """
    for level in np.unique(other).tolist():
        row = np.flatnonzero(other == level)
        row = row[np.argsort(along[row])]
        kept = points.lost[row] < LOST_SHARE
        for k in np.flatnonzero(kept[1:] != kept[:-1]).tolist():
            both = row[[k, k + 1]] if kept[k] else row[[k + 1, k]]
            numbers = (level, *along[both].tolist())
            yield (*map(format_level, numbers), points.outcomes[both[1]].replace("_", " "))


def points(study: StudyData) -> Iterator[ReportTable]:
    """Tabulate every point of a factorial study with up to `MAX_POINTS`, metric by metric."""
    flights = study.flights
    if study.random or not flights.parameters:
        return
    groups = sorted({*zip(flights.case_index.tolist(), flights.point.tolist(), strict=True)})
    if len(groups) > MAX_POINTS:
        return
    case_column = len(flights.cases) > 1
    for metric in study.metrics:
        out: list[tuple[Cell, ...]] = []
        for case, point in groups:
            here = (flights.case_index == case) & (flights.point == point)
            values = _levels(study, here)
            name = f"point/{flights.cases[case]}/{'/'.join(values)}"
            estimate = study.estimate(metric, here, name)
            incomplete = int((here & ~flights.completed).sum())
            case_cell = [flights.case_labels[case]] if case_column else []
            out.append((*case_cell, *values, int(here.sum()), incomplete, estimate))
        names = (*(["case"] if case_column else []), *(each.label for each in flights.parameters))
        columns = (*names, "flights", "lost or failed", f"{study.statistic} [{PERCENT} %]")
        yield ReportTable(f"points-{metric}", f"{metric} at every point", columns, out)


def cases(study: StudyData) -> ReportTable | None:
    """Tabulate the differences of the cases from the first one."""
    flights = study.flights
    if len(flights.cases) < 2:
        return None
    if study.is_map:
        return _cases_of_map(study)
    out: list[tuple[Cell, ...]] = []
    for metric in study.metrics:
        for k, case in enumerate(flights.cases):
            centre = study.estimate(metric, flights.case_index == k, f"all/{case}")
            label = flights.case_labels[k]
            if not k:
                out.append((metric, label, centre, "", "", centre.count))
                continue
            change = study.change(metric, k)
            verdict = describe_change(metric, change, rounding_of(change.before, change.after))
            out.append((metric, label, centre, estimate_of(change), verdict, change.units))
    first, unit = flights.case_labels[0], study.unit_name
    note = (
        f"Difference: the mean over {unit} of a case minus {first}, paired by point and seed where"
        f" both flights were completed, with Student's {PERCENT} % interval. It is not corrected"
        " for the number of cases. Where no seed changes a flight, or there is one seed, there is"
        " no interval: a change of more than the printed rounding is named, as one of one flight."
    )
    centre_heading = f"{study.statistic} [{PERCENT} %]"
    difference_heading = f"difference from {first} [{PERCENT} %]"
    columns = ("metric", "case", centre_heading, difference_heading, "verdict", unit)
    ends = frozenset(range(len(flights.cases) - 1, len(out), len(flights.cases)))
    return ReportTable("cases", "Cases", columns, out, note, ends)


def _cases_of_map(study: StudyData) -> ReportTable:
    """Count the points of a map at which a case differs from the first one."""
    flights, first = study.flights, study.flights.cases[0]
    out: list[tuple[Cell, ...]] = []
    for metric in study.metrics:
        better = better_sign(metric)
        for k, case in enumerate(flights.cases[1:], 1):
            changes = [study.change(metric, k, here) for _, here in _shared_points(study, k)]
            signs = [each.sign(rounding_of(each.before, each.after)) for each in changes]
            larger, smaller = signs.count(1), signs.count(-1)
            counts = (smaller, larger) if better < 0 else (larger, smaller)
            out.append((metric, case, len(changes), *counts))
    note = (
        f"Points that were flown both with {first} and with the case, and at how many of them the"
        f" number changes beyond noise: of one seed by more than its printed rounding, of several"
        f" if the {PERCENT} % interval of their differences excludes 0. There is no mean over the"
        " points, because a map has more of them where the number changes."
    )
    words = ("better", "worse") if all(map(better_sign, study.metrics)) else ("larger", "smaller")
    columns = ("metric", "case", "points of both", *words)
    return ReportTable("cases", f"Cases beside {first}", columns, out, note)


def _shared_points(study: StudyData, case: int) -> list[tuple[int, BoolArray]]:
    """Return the points, and their flights (R,), at which a case and the first one were flown."""
    flights = study.flights
    shared = sorted(set(flights.point[flights.pairs(case)[1]].tolist()))
    return [(point, flights.point == point) for point in shared]


def side_effects(study: StudyData) -> ReportTable | None:
    """Tabulate what is worse in a case than in the first one; None: nothing is."""
    flights = study.flights
    if len(flights.cases) < 2:
        return None
    if study.is_map:
        return _side_effects_of_map(study)
    first, out, bases = flights.cases[0], [], []
    for k, case in enumerate(flights.cases[1:], 1):
        found = study.side_effects(k)
        margins = study.margins.get(case)
        for each in (*found.worse, *(margins.worse if margins else ())):
            change = each.change
            numbers = change.before, change.after, estimate_of(change)
            out.append((case, each.quantity.label, *numbers))
        if found:
            bases.append(f"{case}: {found.basis}")
        if margins:
            bases.append(f"{case}: margins in straight flight, {margins.basis}")
        if problem := study.unpredicted.get(case):
            bases.append(f"{case}: margins are not predicted: {problem}")
    if not bases:
        return None
    note = (
        f"Numbers that are worse than those of {first} beyond noise, whatever the metric is;"
        f" {'; '.join(bases)}. Means over the pairs of flights."
    )
    columns = ("case", "worse", first, "this case", f"difference [{PERCENT} %]")
    return ReportTable("side-effects", "What got worse", columns, out, note)


def _side_effects_of_map(study: StudyData) -> ReportTable | None:
    """Count the points of a map at which something is worse, and name the worst."""
    flights, first = study.flights, study.flights.cases[0]
    keys = [each.key for each in flights.parameters]
    out: list[tuple[Cell, ...]] = []
    for k, case in enumerate(flights.cases[1:], 1):
        points = _shared_points(study, k)
        found = [(here, each) for _, here in points for each in study.side_effects(k, here).worse]
        for quantity in dict.fromkeys(each.quantity for _, each in found):
            of = [(here, each.change) for here, each in found if each.quantity == quantity]
            here, most = max(of, key=lambda each: abs(each[1].mean))
            at = ", ".join(
                f"{key} {level}" for key, level in zip(keys, _levels(study, here), strict=True)
            )
            count = f"{len(of)} of {len(points)}"
            out.append((case, quantity.label, count, at, most.before, most.after))
    if not out:
        return None
    note = (
        f"Points flown both with {first} and with the case at which a number is worse beyond noise,"
        " whatever the metric is, and the one at which it is worse by most."
    )
    columns = ("case", "worse", "points", "most at", first, "this case")
    return ReportTable("side-effects", "What got worse", columns, out, note)


def _levels(study: StudyData, here: BoolArray) -> list[str]:
    one = int(np.flatnonzero(here)[0])
    return [format_level(each.levels[each.index[one]]) for each in study.flights.parameters]


def effects(study: StudyData) -> ReportTable | None:
    """Tabulate the effect of each parameter on each metric."""
    flights = study.flights
    if not flights.parameters or study.is_map:  # more points where the metric changes
        return None
    out: list[tuple[Cell, ...]] = []
    titles = [flights.groups_title] if flights.groups_title else []
    for metric in study.metrics:
        for each in flights.parameters:
            # the law's own effect is among all flights of a case
            for group in flights.by_case if each is flights.law else flights.groups:
                name = [group.label or "all"] if titles else []
                out.append(
                    (metric, *name, each.label, *_effect(study, metric, each, group.flights))
                )
    note = (
        f"Smallest and largest {study.statistic} among the levels of the parameter, over all other"
        f" parameters; of a parameter with more than {MAX_LEVELS} numbers, among {GROUPS} groups of"
        " equal size. The share of the variance that lies between the levels (η²) measures the"
        " effect of the parameter alone, without interactions. The rank correlation is Spearman's:"
        " 1 or -1 where the metric always rises or falls with the parameter."
    )
    if titles:
        note += f" Each {flights.groups_title.replace(', ', ' and ')} has numbers of its own."
    numbers = ("smallest", "largest", "variance, %", "rank correlation")
    columns = ("metric", *titles, "parameter", *numbers)
    return ReportTable("effects", "What matters", columns, out, note)


def _effect(
    study: StudyData, metric: str, parameter: Parameter, where: BoolArray
) -> tuple[float, float, float, float]:
    """Return smallest and largest centre, share of the variance, %, and rank correlation."""
    values = study.flights.metrics[metric]
    known = where & study.flights.completed & np.isfinite(values)
    share = rank = math.nan
    if not parameter.continuous:
        share = 100.0 * variance_share(values[known], parameter.index[known])
    if parameter.numeric and known.any():
        rank = rank_correlation(parameter.numbers[parameter.index][known], values[known])
    return (*_range(study, metric, parameter, where), share, rank)


def _range(
    study: StudyData, metric: str, parameter: Parameter, where: BoolArray
) -> tuple[float, float]:
    centres = [study.centre(metric, here & where) for _, here in level_groups(parameter)]
    known = [each for each in centres if math.isfinite(each)]
    return (min(known), max(known)) if known else (math.nan, math.nan)


def level_groups(parameter: Parameter) -> Iterator[tuple[str, BoolArray]]:
    """Yield the levels and their flights (R,); of many numbers, groups of equal size."""
    if not parameter.continuous:
        for k, level in enumerate(parameter.levels):
            yield format_level(level), parameter.index == k
        return
    x = parameter.numbers[parameter.index]
    edges = np.quantile(x, np.linspace(0.0, 1.0, GROUPS + 1))
    group = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, GROUPS - 1)
    for k in range(GROUPS):
        yield f"{edges[k]:.2g} to {edges[k + 1]:.2g}", group == k


def losses(study: StudyData) -> ReportTable:
    """Tabulate the outcomes of flights by case and level."""
    flights = study.flights
    kinds = list(dict.fromkeys(flights.outcome))
    outcome = np.array(flights.outcome, dtype=object)
    groups: list[tuple[str, str, BoolArray]] = [
        ("all", "", np.ones(flights.run.size, dtype=np.bool_))
    ]
    if len(flights.cases) > 1:
        groups += [
            ("case", name, flights.case_index == k) for k, name in enumerate(flights.case_labels)
        ]
    for each in flights.parameters:
        groups += [(each.label, level, here) for level, here in level_groups(each)]
    out: list[tuple[Cell, ...]] = []
    ends = set()
    for i, (group, level, here) in enumerate(groups):
        counts = [int((here & (outcome == kind)).sum()) for kind in kinds]
        share = wilson(int((here & ~flights.completed).sum()), int(here.sum()))
        percent = IntervalEstimate(
            100.0 * share.value, 100.0 * share.low, 100.0 * share.high, share.count
        )
        shares = [] if study.is_map else [percent]  # of a map's points it would be none of the area
        out.append((group, level, int(here.sum()), *counts, *shares))
        if i + 1 < len(groups) and groups[i + 1][0] != group:
            ends.add(i)
    note = (
        f"Share of lost and failed flights with Wilson's {PERCENT} % interval, which assumes"
        " independent flights."
    )
    columns: tuple[str, ...] = ("group", "level", "flights", *kinds)
    if study.is_map:
        return ReportTable("losses", "How flights ended", columns, out, "", frozenset(ends))
    columns = (*columns, f"lost or failed, % [{PERCENT} %]")
    return ReportTable("losses", "How flights ended", columns, out, note, frozenset(ends))


def worst(study: StudyData) -> ReportTable:
    """Tabulate lost and failed flights, then the largest of the first metric, with commands."""
    flights = study.flights
    metric = study.metrics[0] if study.metrics else ""
    values = flights.metrics[metric] if metric else np.full(flights.run.size, math.nan)
    incomplete = np.flatnonzero(~flights.completed)[: MAX_WORST // 2]
    known = np.flatnonzero(flights.completed & np.isfinite(values))
    order = np.argsort(-values[known], kind="stable")
    largest = known[order][: MAX_WORST - len(incomplete)]
    out: list[tuple[Cell, ...]] = []
    for i in (*incomplete.tolist(), *largest.tolist()):
        number = int(flights.run[i])
        outcome = flights.error[i] or flights.outcome[i]
        out.append((str(number), outcome, float(values[i]), study.command(number)))
    more = int((~flights.completed).sum()) - len(incomplete)
    note = (
        f"{more} more flights were lost or failed; see the column outcome of the file."
        if more
        else ""
    )
    columns = ("run", "outcome", metric or "metric", "command")
    return ReportTable("worst", "Worst runs", columns, out, note, code=True)
