"""Margins that are predicted for scenarios before and after a change, and which got smaller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from testbed.metrics.flat_numbers import flatten_metrics
from testbed.metrics.side_effects import Columns, SideEffects, side_effects, to_columns
from testbed.pool.flight_pool import FlightPool
from testbed.pool.flight_task import COMPLETED, FlightResult, FlightTask
from testbed.scenario import Scenario
from testbed.studies.predicted_numbers import predict_numbers

_NOTHING = SideEffects((), "", too_few=False)


@dataclass(frozen=True, slots=True)
class MarginChange:
    """Predicted margins before and after, at one bank.

    Attributes:
        bank_deg: of the follower that banks most; 0: straight.
        side_effects: margins that got smaller.
        problem: why there are none; "": there are.
    """

    bank_deg: float
    side_effects: SideEffects
    problem: str

    @property
    def place(self) -> str:
        """The steady flight, as text."""
        return f"at {self.bank_deg:g}° of bank" if self.bank_deg else "in straight flight"


def margin_change(
    bank_deg: float, before: Sequence[FlightResult], after: Sequence[FlightResult]
) -> MarginChange:
    """Compare results of `predict_numbers`; of several cases the least margin counts."""
    for each in (*before, *after):
        if each.outcome != COMPLETED or each.metrics is None:
            return MarginChange(bank_deg, _NOTHING, each.error.partition(": ")[2] or each.error)
    one = np.zeros(1, dtype=np.int64)
    old, new = (
        _least_of(to_columns([flatten_metrics(each.metrics or {}) for each in part]))
        for part in (before, after)
    )
    found = replace(side_effects(old, new, one, one), basis="predicted by linearising")
    return MarginChange(bank_deg, found, "")


def predict_changes(scenarios: Sequence[Scenario], pool: FlightPool) -> list[MarginChange]:
    """Compare the margins of the first scenario, in straight flight, with those of each other.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM was received.
    """

    def tasks() -> Iterator[FlightTask]:
        for number, scenario in enumerate(scenarios):
            yield FlightTask(number, scenario, measure=partial(predict_numbers, 0.0))

    found = {each.number: each for each in pool.run_groups([each] for each in tasks())}
    return [margin_change(0.0, [found[0]], [found[k]]) for k in range(1, len(scenarios))]


def _least_of(numbers: Columns) -> Columns:
    return {name: np.fmin.reduce(values, keepdims=True) for name, values in numbers.items()}
