"""Runs of a plan that are flown: all of them, or those that its rules choose from the rows so far.

A plan numbers all possible runs. Which of them are needed depends on the rows only, never on which
flight ends first: the content of a result file is the same for any workers and interruptions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from testbed.studies.flight_task import COMPLETED
from testbed.studies.journal import JournalRow
from testbed.studies.plan import Plan
from testbed.studies.point_runs import PointRuns


class RunChoice(Protocol):
    """The runs of a plan that are needed, as far as the rows so far decide it.

    Points are counted through all cases: point p of case c is c * plan.point_count + p, and its
    runs are those of its seeds.
    """

    @property
    def total(self) -> int:
        """Number of runs that are needed; more than there will be, where it is undecided."""

    @property
    def done(self) -> int:
        """Number of them whose rows have been added; equal to `total` at the end."""

    def needs(self, run: int) -> bool:
        """Return whether a run is needed."""

    def open_points(self) -> Sequence[int]:
        """Return the points of which runs are needed that have no row, in order."""

    def add(self, row: JournalRow) -> None:
        """Add a row, of a run that may turn out not to be needed."""

    def settle(self, run: int) -> None:
        """Take note that no seed changes the point of a run."""


class AllRuns:
    """Every run of a plan."""

    def __init__(self, plan: Plan) -> None:
        """Begin without rows."""
        self._points = range(len(plan) // len(plan.seeds))
        self.total = len(plan)
        self.done = 0

    def needs(self, run: int) -> bool:
        """Return True."""
        return True

    def open_points(self) -> Sequence[int]:
        """Return all points as long as a row is missing."""
        return self._points if self.done < self.total else ()

    def add(self, row: JournalRow) -> None:
        """Count a row."""
        self.done += 1

    def settle(self, run: int) -> None:
        """Do nothing: the other seeds have rows with the same numbers."""


class ChosenRuns:
    """Runs of all points, each with as many seeds as its numbers ask for."""

    def __init__(self, plan: Plan) -> None:
        """Begin without rows."""
        self._until = plan.study.config.study.until
        self._seeds = len(plan.seeds)
        self._points: dict[int, PointRuns] = {}
        self._open: dict[int, None] = {}  # points that are not finished, in order
        self.total = self.done = 0
        self._choose(range(len(plan) // self._seeds))

    def needs(self, run: int) -> bool:
        """Return whether a run is one of the first seeds that its point needs."""
        point, seed = divmod(run, self._seeds)
        return point in self._points and seed < self._points[point].needed

    def open_points(self) -> Sequence[int]:
        """Return the points that are not finished."""
        return tuple(self._open)

    def add(self, row: JournalRow) -> None:
        """Add a row, which may decide what else is needed."""
        point, seed = divmod(row.run, self._seeds)
        number = _number(row, self._until.metric) if self._until else None
        with self._counted(point) as runs:
            runs.add(seed, number)

    def settle(self, run: int) -> None:
        """Take note that no seed changes the point of a run."""
        with self._counted(run // self._seeds) as runs:
            runs.settle()

    def _choose(self, points: Iterable[int]) -> None:
        """Add points to be flown."""
        for point in points:
            runs = self._points[point] = PointRuns(self._seeds, self._until)
            self._open[point] = None
            self.total += runs.needed

    @contextmanager
    def _counted(self, point: int) -> Iterator[PointRuns]:
        """Change a point, and the numbers of runs with it."""
        runs = self._points[point]
        self.total -= runs.needed
        self.done -= runs.done
        yield runs
        self.total += runs.needed
        self.done += runs.done
        if runs.finished:
            self._open.pop(point, None)


def _number(row: JournalRow, metric: str) -> float | None:
    """Return a metric of a row; NaN: it has none; None: its flight was not completed."""
    if row.outcome != COMPLETED:
        return None
    number = row.metrics.get(metric)
    return math.nan if number is None else number


def choose_runs(plan: Plan) -> RunChoice:
    """Return the choice of a plan's runs, without rows."""
    return ChosenRuns(plan) if plan.study.config.study.chooses_runs else AllRuns(plan)
