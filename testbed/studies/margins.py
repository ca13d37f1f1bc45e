"""Margins of a scenario's followers at several banks, measured by the workers of a pool."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from testbed.core.errors import InputError
from testbed.scenario import Scenario
from testbed.studies.flight_pool import FlightPool
from testbed.studies.flight_task import COMPLETED, FlightTask
from testbed.trials.margins import Margins, directions, measure_margins, worse_of


def _measure(bank_deg: float, scenario: Scenario) -> dict[str, Any]:
    return {"margins": measure_margins(scenario, bank_deg)}


def margins_of(
    cases: Sequence[tuple[Scenario, float]],
    pool: FlightPool,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Margins]:
    """Measure scenarios at banks, each in both directions of turn.

    Args:
        cases: a scenario, and the highest bank of a follower, degrees, 0 or more.
        pool: whose workers measure.
        progress: called with the number of directions measured, and their total.

    Raises:
        InputError: something cannot be measured.
    """
    parts = [(i, bank) for i, (_, of) in enumerate(cases) for bank in directions(of)]

    def tasks() -> Iterator[FlightTask]:
        for number, (i, bank) in enumerate(parts):
            yield FlightTask(number, cases[i][0], measure=partial(_measure, bank))

    found: dict[int, Margins] = {}
    for result in pool.run(tasks()):
        if result.outcome != COMPLETED or result.metrics is None:
            raise InputError(result.error.removeprefix("invalid: "))
        found[result.number] = result.metrics["margins"]
        progress(len(found), len(parts))
    return [
        worse_of([found[number] for number, part in enumerate(parts) if part[0] == i])
        for i in range(len(cases))
    ]


def to_document(scenario: Scenario, found: Sequence[Margins]) -> dict[str, Any]:
    """Return margins as plain data for JSON."""
    return {"schema": 1, "scenario": scenario.name, "banks": [asdict(each) for each in found]}
