"""Margins of a scenario's followers at several banks, found by the workers of a pool."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, TypeVar

from testbed.core.errors import InputError
from testbed.linear.delay_margin import DelayMargin
from testbed.linear.flown_margins import (
    FlownMargins,
    Margins,
    directions,
    measure_margins,
    worse_of,
)
from testbed.linear.linear_system import Mode
from testbed.linear.loop_margins import CommandMargins
from testbed.linear.predicted_margins import (
    NotLinearisable,
    Prediction,
    predict_margins,
    worse_prediction,
)
from testbed.pool.flight_pool import FlightPool
from testbed.pool.flight_task import COMPLETED, FlightTask
from testbed.scenario import Scenario

T = TypeVar("T")


def _predict(bank_deg: float, climb_mps: float, scenario: Scenario) -> dict[str, Any]:
    try:
        return {"margins": predict_margins(scenario, bank_deg, climb_mps)}
    except NotLinearisable as error:
        raise NotLinearisable(error.problem, f"{error.remedy}, or --method flown") from error


def _measure(bank_deg: float, climb_mps: float, scenario: Scenario) -> dict[str, Any]:
    return {"margins": measure_margins(scenario, bank_deg, climb_mps)}


def predicted_margins_of(
    cases: Sequence[tuple[Scenario, float]],
    pool: FlightPool,
    progress: Callable[[int, int], None] = lambda done, total: None,
    climb_mps: float = 0.0,
) -> list[Prediction]:
    """Predict the margins of scenarios at banks; see `margins_of`."""
    return _of_both_directions(cases, pool, progress, climb_mps, _predict, worse_prediction)


def margins_of(
    cases: Sequence[tuple[Scenario, float]],
    pool: FlightPool,
    progress: Callable[[int, int], None] = lambda done, total: None,
    climb_mps: float = 0.0,
) -> list[Margins]:
    """Measure scenarios at banks, each in both directions of turn.

    Args:
        cases: a scenario, and the highest bank of a follower, degrees, 0 or more.
        pool: whose workers measure.
        progress: called with the number of directions measured, and their total.
        climb_mps: of the leader, m/s.

    Raises:
        InputError: something cannot be measured.
    """
    return _of_both_directions(cases, pool, progress, climb_mps, _measure, worse_of)


def _of_both_directions(
    cases: Sequence[tuple[Scenario, float]],
    pool: FlightPool,
    progress: Callable[[int, int], None],
    climb_mps: float,
    measure: Callable[[float, float, Scenario], dict[str, Any]],
    worse: Callable[[Sequence[T]], T],
) -> list[T]:
    parts = [(i, bank) for i, (_, of) in enumerate(cases) for bank in directions(of)]

    def tasks() -> Iterator[FlightTask]:
        for number, (i, bank) in enumerate(parts):
            yield FlightTask(number, cases[i][0], measure=partial(measure, bank, climb_mps))

    found: dict[int, T] = {}
    for result in pool.run(tasks()):
        if result.outcome != COMPLETED or result.metrics is None:
            raise InputError(result.error.removeprefix("invalid: "))
        found[result.number] = result.metrics["margins"]
        progress(len(found), len(parts))
    return [
        worse([found[number] for number, part in enumerate(parts) if part[0] == i])
        for i in range(len(cases))
    ]


def to_document(
    scenario: Scenario, predicted: Sequence[Prediction], flown: Sequence[Margins]
) -> dict[str, Any]:
    """Return margins as plain data for JSON; what is beyond the largest value tried is null."""
    return {
        "schema": 3,
        "scenario": scenario.name,
        **({"predicted": [_plain(asdict(each)) for each in predicted]} if predicted else {}),
        **({"flown": [_plain(asdict(each)) for each in flown]} if flown else {}),
    }


def _plain(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, Mode):
        return {
            "frequency_hz": value.frequency_hz,
            "damping": value.damping,
            "pole_per_s": [value.pole.real, value.pole.imag],
            "follower": value.follower,
            "motion": value.motion,
        }
    if isinstance(value, CommandMargins | DelayMargin | FlownMargins):
        return _plain(value._asdict())
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
