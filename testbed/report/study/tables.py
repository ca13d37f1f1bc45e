"""The tables of a study: what came out, how cases differ, what matters, and what was lost."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from testbed.report.study.grid import Cell, Grid
from testbed.report.study.numbers import (
    PERCENT,
    Estimate,
    rank_correlation,
    student,
    variance_share,
    wilson,
)
from testbed.report.study.rows import MANY, Parameter, Study, said
from testbed.state import Truths

MOST_POINTS = 60  # rows of the table of all points
MOST_WORST = 12
BINS = 4  # of a parameter with many numbers


def overview(study: Study) -> Grid:
    """Each metric, case by case, over all flights that were flown well."""
    rows, out = study.rows, []
    for metric in study.metrics:
        values = rows.metrics[metric]
        for k, case in enumerate(rows.cases):
            mine = rows.case_index == k
            good = values[mine & rows.good & np.isfinite(values)]
            spread = np.quantile(good, [0.05, 0.95]) if good.size else [math.nan, math.nan]
            out.append(
                (
                    metric,
                    *([case] if len(rows.cases) > 1 else []),
                    good.size,
                    study.estimate(metric, mine, f"all/{case}"),
                    float(good.min()) if good.size else math.nan,
                    float(spread[0]),
                    float(spread[1]),
                    float(good.max()) if good.size else math.nan,
                )
            )
    middle = f"{study.statistic} [{PERCENT} %]"
    columns = ("metric", *(["case"] if len(rows.cases) > 1 else []), "flights", middle)
    note = (
        f"The {study.statistic} over {study.unit_name} with its {PERCENT} % interval (bootstrap);"
        f" of one of the {study.unit_name} it takes the mean over all else. Lost and failed"
        " flights are not in it."
    )
    return Grid("overview", "Overview", (*columns, "least", "5 %", "95 %", "largest"), out, note)


def points(study: Study) -> Iterator[Grid]:
    """Every point of a factorial study that is not too large, metric by metric."""
    rows = study.rows
    if study.random or not rows.parameters:
        return
    groups = sorted({*zip(rows.case_index.tolist(), rows.point.tolist(), strict=True)})
    if len(groups) > MOST_POINTS:
        return
    cased = len(rows.cases) > 1
    for metric in study.metrics:
        out: list[tuple[Cell, ...]] = []
        for case, point in groups:
            here = (rows.case_index == case) & (rows.point == point)
            one = int(np.flatnonzero(here)[0])
            values = [said(each.levels[each.index[one]]) for each in rows.parameters]
            found = study.estimate(metric, here, f"point/{rows.cases[case]}/{'/'.join(values)}")
            bad = int((here & ~rows.good).sum())
            case_cell = [rows.cases[case]] if cased else []
            out.append((*case_cell, *values, int(here.sum()), bad, found))
        names = (*(["case"] if cased else []), *(each.key for each in rows.parameters))
        columns = (*names, "flights", "lost or failed", f"{study.statistic} [{PERCENT} %]")
        yield Grid(f"points-{metric}", f"{metric} at every point", columns, out)


def cases(study: Study) -> Grid | None:
    """Every case against the first, flight by flight."""
    rows = study.rows
    if len(rows.cases) < 2:
        return None
    out: list[tuple[Cell, ...]] = []
    for metric in study.metrics:
        for k, case in enumerate(rows.cases):
            mine = rows.case_index == k
            centre = study.estimate(metric, mine, f"all/{case}")
            if not k:
                out.append((metric, case, centre, "", "", 0))
                continue
            found = student(study.differences(metric, k))
            out.append((metric, case, centre, found, verdict(found), found.count))
    first = rows.cases[0]
    unit = study.unit_name
    note = (
        f"Difference: the mean over {unit} of a case less {first}, flight by flight of the same"
        f" point and seed where both were flown well, with Student's {PERCENT} % interval. It is"
        " not corrected for how many cases there are."
    )
    middle = f"{study.statistic} [{PERCENT} %]"
    columns = ("metric", "case", middle, f"less {first} [{PERCENT} %]", "", unit)
    ends = frozenset(range(len(rows.cases) - 1, len(out), len(rows.cases)))
    return Grid("cases", "Cases", columns, out, note, ends)


def verdict(found: Estimate) -> str:
    """Whether an interval of a difference tells it from 0."""
    if math.isnan(found.low):
        return "too few"
    return "larger" if found.low > 0.0 else "smaller" if found.high < 0.0 else "not told apart"


def effects(study: Study) -> Grid | None:
    """How much each parameter moves each metric."""
    rows = study.rows
    if not rows.parameters:
        return None
    out: list[tuple[Cell, ...]] = []
    for metric in study.metrics:
        values = rows.metrics[metric]
        good = rows.good & np.isfinite(values)
        for each in rows.parameters:
            x = each.numbers[each.index]
            share = math.nan
            if not each.continuous:
                share = 100.0 * variance_share(values[good], each.index[good])
            rank = rank_correlation(x[good], values[good]) if each.numeric and good.any() else None
            low, high = _range(study, metric, each)
            out.append((metric, each.key, low, high, share, math.nan if rank is None else rank))
    note = (
        f"Smallest and largest {study.statistic} among the levels of the parameter, over all else;"
        f" of a parameter with more than {MANY} numbers, among {BINS} groups of equally many. The"
        " share of the variance that the means of the levels have (η²) counts what the parameter"
        " does alone, not with others. The rank correlation is Spearman's: 1 or -1 where the metric"
        " always grows or falls with it."
    )
    columns = ("metric", "parameter", "smallest", "largest", "variance, %", "rank correlation")
    return Grid("effects", "What matters", columns, out, note)


def _range(study: Study, metric: str, parameter: Parameter) -> tuple[float, float]:
    found = [study.centre(metric, here) for _, here in levels_of(parameter)]
    known = [each for each in found if math.isfinite(each)]
    return (min(known), max(known)) if known else (math.nan, math.nan)


def levels_of(parameter: Parameter) -> Iterator[tuple[str, Truths]]:
    """The levels and which flights have them (R,); of many numbers, groups of equally many."""
    if not parameter.continuous:
        for k, level in enumerate(parameter.levels):
            yield said(level), parameter.index == k
        return
    x = parameter.numbers[parameter.index]
    edges = np.quantile(x, np.linspace(0.0, 1.0, BINS + 1))
    group = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    for k in range(BINS):
        yield f"{edges[k]:.2g} to {edges[k + 1]:.2g}", group == k


def losses(study: Study) -> Grid:
    """How flights ended, by case and level."""
    rows = study.rows
    kinds = [each for each in dict.fromkeys(rows.outcome)]
    outcome = np.array(rows.outcome, dtype=object)
    everyone = np.ones(rows.run.size, dtype=np.bool_)
    groups: list[tuple[str, str, Truths]] = [("all", "", everyone)]
    if len(rows.cases) > 1:
        groups += [("case", name, rows.case_index == k) for k, name in enumerate(rows.cases)]
    for each in rows.parameters:
        groups += [(each.key, level, here) for level, here in levels_of(each)]
    out: list[tuple[Cell, ...]] = []
    ends = set()
    for i, (what, level, here) in enumerate(groups):
        counts = [int((here & (outcome == kind)).sum()) for kind in kinds]
        bad = wilson(int((here & ~rows.good).sum()), int(here.sum()))
        share = Estimate(100.0 * bad.value, 100.0 * bad.low, 100.0 * bad.high, bad.count)
        out.append((what, level, int(here.sum()), *counts, share))
        if i + 1 < len(groups) and groups[i + 1][0] != what:
            ends.add(i)
    note = (
        f"Lost or failed, with Wilson's {PERCENT} % interval of a share, as if flights were"
        " independent."
    )
    columns = ("", "level", "flights", *kinds, f"lost or failed, % [{PERCENT} %]")
    return Grid("losses", "How flights ended", columns, out, note, frozenset(ends))


def worst(study: Study) -> Grid:
    """What went wrong, then the largest of the first metric, each with what repeats it."""
    rows = study.rows
    metric = study.metrics[0] if study.metrics else ""
    values = rows.metrics[metric] if metric else np.full(rows.run.size, math.nan)
    bad = np.flatnonzero(~rows.good)[: MOST_WORST // 2]
    known = np.flatnonzero(rows.good & np.isfinite(values))
    high = known[np.argsort(-values[known], kind="stable")][: MOST_WORST - len(bad)]
    out: list[tuple[Cell, ...]] = []
    for i in (*bad.tolist(), *high.tolist()):
        ending = rows.error[i] or rows.outcome[i]
        number = int(rows.run[i])
        out.append((str(number), ending, float(values[i]), study.command(number)))
    left = int((~rows.good).sum()) - len(bad)
    note = f"{left} more were lost or failed: column outcome of the file." if left else ""
    columns = ("run", "outcome", metric or "metric", "repeats it")
    return Grid("worst", "Worst runs", columns, out, note, code=True)
