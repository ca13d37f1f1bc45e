"""Constraints of a tune: what is measured for a candidate, and how far it misses them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from testbed.pool.flight_task import COMPLETED, FlightResult
from testbed.tuning.tune_schema import Constraint

if TYPE_CHECKING:
    from testbed.scenario import Scenario

NOT_STEADY = 2.0  # shortfall of each number where there is none; the largest of any
UNSTABLE = 0.1  # negative damping ratio that counts as a shortfall of 1
DAMPING, AT_GAIN, AT_LATENCY, SETTLING = KEYS = (
    "damping", "damping_at_roll_gain", "damping_at_roll_latency", "settling_s",
)  # fmt: skip
REQUIRED = dict(zip(KEYS, ("damping", "roll_gain", "roll_latency_s", "settling_s"), strict=True))

Measure = Callable[["Scenario"], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class ConstraintResult:
    """What a candidate has of one constraint.

    Args:
        constraint: of the tune file.
        problem: why nothing was measured; "": it was.
        measured: of `KEYS` those that are required; None: longer than the record.
    """

    constraint: Constraint
    problem: str
    measured: Mapping[str, float | None]

    def required(self) -> Iterator[tuple[str, float]]:
        """Yield the keys of what is required, with the numbers of the tune file."""
        for key, name in REQUIRED.items():
            value = getattr(self.constraint, name)
            if value is not None:
                yield key, value

    @property
    def shortfall(self) -> float:
        """Sum of the shortfalls of its numbers as shares of what is required; 0: it is met."""
        if self.problem:
            return sum(NOT_STEADY for _ in self.required())
        return sum(_shortfall(key, value, self.measured[key]) for key, value in self.required())

    def describe(self) -> str:
        """Return the numbers and what is required as text."""
        here = f"at {self.constraint.bank_deg:g}°"
        if self.problem:
            return f"{here} {self.problem}"
        parts = []
        for key, value in self.required():
            number, met = self.measured[key], _shortfall(key, value, self.measured[key]) == 0.0
            missed = "" if met else " (missed)"
            if key == DAMPING:
                parts.append(f"damping {number:.3f} of {value:g}{missed}")
            elif key == SETTLING:
                settled = "too long" if number is None else f"{number:.1f} s"
                parts.append(f"settling {settled} of {value:g} s{missed}")
            else:
                what = f"{1000.0 * value:g} ms" if key == AT_LATENCY else f"factor {value:g}"
                parts.append(f"damping {number:.3f} with {what}{missed}")
        return f"{here} {', '.join(parts)}"


def _shortfall(key: str, required: float, measured: float | None) -> float:
    if measured is None:
        return NOT_STEADY
    if key == DAMPING:
        missing = (required - measured) / required
    elif key == SETTLING:
        missing = (measured - required) / required
    else:  # it decays: any positive damping ratio; 0 is a limit cycle
        missing = 0.0 if measured > 0.0 else max(-measured / UNSTABLE, 1e-3)
    return min(max(missing, 0.0), NOT_STEADY)


def measurements(constraints: Sequence[Constraint]) -> list[Measure]:
    """Return what is measured of one scenario, constraint by constraint."""
    return [
        partial(_measure, constraint.model_dump(), bank_deg)
        for constraint in constraints
        for bank_deg in _directions(constraint)
    ]


def constraint_results(
    constraints: Sequence[Constraint], results: Sequence[FlightResult]
) -> tuple[ConstraintResult, ...]:
    """Return the worst of all measurements of one candidate.

    Args:
        constraints: of the tune file.
        results: of `measurements`, for one scenario after the other.
    """
    each = sum(len(_directions(constraint)) for constraint in constraints)
    found, begin = [], 0
    for constraint in constraints:
        count = len(_directions(constraint))
        of = [result for k in range(begin, len(results), each) for result in results[k:][:count]]
        found.append(_worst(constraint, of))
        begin += count
    return tuple(found)


def _worst(constraint: Constraint, results: Sequence[FlightResult]) -> ConstraintResult:
    measured: dict[str, float | None] = {}
    for result in results:
        if result.outcome != COMPLETED or result.metrics is None:
            return ConstraintResult(constraint, result.error, {})
        if result.metrics["problem"]:
            return ConstraintResult(constraint, result.metrics["problem"], {})
        for key in KEYS:
            if key in result.metrics:
                values = result.metrics[key], measured.get(key, result.metrics[key])
                if key == SETTLING:
                    measured[key] = None if None in values else max(values)
                else:
                    measured[key] = min(values)
    return ConstraintResult(constraint, "", measured)


def _directions(constraint: Constraint) -> tuple[float, ...]:
    return (constraint.bank_deg, -constraint.bank_deg) if constraint.bank_deg else (0.0,)


def _measure(requirement: Mapping[str, Any], bank_deg: float, scenario: Scenario) -> dict[str, Any]:
    """Measure in a worker; the parent process does not simulate."""
    from testbed.linear.flown_margins import Requirement, measure_required

    return measure_required(scenario, Requirement(**requirement), bank_deg)
