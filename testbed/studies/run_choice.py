"""Runs of a plan that are flown: all of them, or those that its rules choose from the rows so far.

A plan numbers all possible runs. Which of them are needed depends on the rows only, never on which
flight ends first: the content of a result file is the same for any workers and interruptions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from testbed.pool.flight_task import COMPLETED
from testbed.studies.journal import JournalRow
from testbed.studies.map_refinement import points_to_add
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

    @property
    def round_text(self) -> str:
        """What is flown next, where that is decided in rounds; else empty."""

    def needs(self, run: int) -> bool:
        """Return whether a run is needed."""

    def open_points(self) -> Sequence[int]:
        """Return the points of which runs are needed that have no row, in order."""

    def add(self, row: JournalRow) -> None:
        """Add a row, of a run that may turn out not to be needed."""


class AllRuns:
    """Every run of a plan."""

    round_text = ""

    def __init__(self, plan: Plan) -> None:
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


class ChosenRuns:
    """Runs that the rules of a study choose, round by round.

    A round is a set of points: all points; or of a map the next ones by what the points of earlier
    rounds gave. It ends when each of its points has as many seeds as its numbers ask for.
    """

    def __init__(self, plan: Plan) -> None:
        settings = plan.study.config.study
        self._until, self._refine = settings.until, settings.refine
        self._metric = settings.deciding_metrics[0][1]
        self._seeds = len(plan.seeds)
        self._shape = (len(plan.cases), *plan.level_counts)
        self._count = len(plan.cases) * plan.point_count
        self._points: dict[int, PointRuns] = {}  # of this round and the earlier ones
        self._open: dict[int, None] = {}  # points that are not finished, in order
        self._waiting: dict[int, list[JournalRow]] = {}  # of later rounds of a resumed study
        self._round = 0
        self.total = self.done = 0
        self._begin_rounds()

    @property
    def round_text(self) -> str:
        """What a map flies in this round; empty without rounds."""
        if self._refine is None:
            return ""
        return (
            f"round {self._round}: {len(self._open):,} points, with which the map has "
            f"{len(self._points):,} of {self._count:,}"
        )

    def needs(self, run: int) -> bool:
        """Return whether a run is one of the first seeds that its point needs."""
        point, seed = divmod(run, self._seeds)
        return point in self._points and seed < self._points[point].needed

    def open_points(self) -> Sequence[int]:
        """Return the points of this round that are not finished."""
        return tuple(self._open)

    def add(self, row: JournalRow) -> None:
        """Add a row, which may decide what else is needed."""
        point = row.run // self._seeds
        if point in self._points:
            self._add(row)
            self._begin_rounds()
        else:
            self._waiting.setdefault(point, []).append(row)

    def _add(self, row: JournalRow) -> None:
        point, seed = divmod(row.run, self._seeds)
        number: float | None = None  # the flight was not completed
        if row.outcome == COMPLETED:
            found = row.metrics.get(self._metric)
            number = math.nan if found is None else found
        with self._counted(point) as runs:
            runs.add(seed, number)
            if row.any_seed:
                runs.settle()

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

    def _begin_rounds(self) -> None:
        """Begin the next round, if this one has ended; and as many as have their rows already."""
        while not self._open and (points := self._next_points()):
            self._round += 1
            for point in points:
                self._points[point] = runs = PointRuns(self._seeds, self._until)
                self._open[point] = None
                self.total += runs.needed
            for point in points:
                for row in self._waiting.pop(point, ()):
                    self._add(row)

    def _next_points(self) -> Sequence[int]:
        """Return the points of the next round; none after the last one."""
        if self._refine is None:
            return () if self._points else range(self._count)
        if len(self._points) == self._count:
            return ()
        values = np.full(self._count, math.nan)
        flown, completed = np.zeros((2, self._count), dtype=np.bool_)
        for point, runs in self._points.items():
            values[point], flown[point] = runs.mean, True
            completed[point] = 2 * runs.completed > runs.needed  # most of its flights
        refine, shape = self._refine, self._shape
        of_cases = zip(
            *(values.reshape(shape), flown.reshape(shape), completed.reshape(shape)), strict=True
        )
        wanted = [points_to_add(refine.levels, *each, refine.contour) for each in of_cases]
        found: list[int] = np.flatnonzero(wanted).tolist()
        return found


def choose_runs(plan: Plan) -> RunChoice:
    """Return the choice of a plan's runs, without rows."""
    return ChosenRuns(plan) if plan.study.config.study.chooses_runs else AllRuns(plan)
