"""Flights of one point with several seeds: their results, and how many of them are needed."""

from __future__ import annotations

import math

from testbed.studies.sequential_interval import MIN_VALUES, RunningMean
from testbed.studies.study_schema import Until


class PointRuns:
    """Seeds of a point in their order, and what they have given so far.

    With `until` the number that is needed depends on the first flights in the order of the seeds
    only: it is the same whichever flights end first, and however many are flown at the same time.
    Flights without the number are in no mean. A point whose first `MIN_VALUES` flights all lack it,
    such as one beyond what the formation bears, is given up.
    """

    def __init__(self, seeds: int, until: Until | None) -> None:
        """Begin without flights.

        Args:
            seeds: largest number of flights.
            until: when fewer are enough; None: never.
        """
        self.needed = seeds
        self.done = 0  # of those that are needed
        self._until = until
        self._numbers: dict[int, float | None] = {}
        self._begin()

    @property
    def finished(self) -> bool:
        """Return whether all flights that are needed have ended."""
        return self.done == self.needed

    @property
    def values(self) -> int:
        """Number of completed flights that have the metric."""
        return self._mean.count

    @property
    def mean(self) -> float:
        """Mean of the metric over the completed flights that have it; NaN without any."""
        return self._mean.mean

    @property
    def half_width(self) -> float:
        """Half width of the interval of the mean; 0 where no seed changes it."""
        return 0.0 if self._settled else self._mean.half_width

    @property
    def precise(self) -> bool:
        """Return whether the interval is as narrow as `until` asks for."""
        # as long as all numbers are equal they are no measure of scatter
        narrow = self._until is not None and 0.0 < self._mean.half_width <= self._until.half_width
        return narrow or self._settled

    def add(self, seed: int, number: float | None) -> None:
        """Add a flight.

        Args:
            seed: its index in the order of the seeds.
            number: the metric; NaN: the flight has none; None: it was not completed.
        """
        self._numbers[seed] = number
        self.done += seed < self.needed
        self._count()

    def settle(self) -> None:
        """Take note that no seed changes the point: with `until` one flight is enough."""
        if self._until:
            self.needed = 1
            self.done = int(0 in self._numbers)
            self._begin()
            self._settled = True
            self._count()

    def _begin(self) -> None:
        self._mean = RunningMean(self._until.confidence if self._until else 0.0)
        self._next = 0  # first seed that is not counted
        self._settled = False
        self.completed = 0  # of the counted flights

    def _count(self) -> None:
        """Count the flights in the order of their seeds, up to the first that is missing."""
        while self._next < self.needed and self._next in self._numbers:
            number = self._numbers[self._next]
            self._next += 1
            self.completed += number is not None
            if number is not None and math.isfinite(number):
                self._mean.add(number)
            hopeless = self._until and self._next == MIN_VALUES and not self.values
            if (self.precise or hopeless) and not self._settled:
                self.done = self.needed = self._next
