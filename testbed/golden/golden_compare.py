"""Compare flights of a scenario with its golden table: structure first, then numbers."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from testbed.core.errors import InputError
from testbed.core.records import join_names
from testbed.golden.golden_table import (
    FALSE_ALARM,
    RULES,
    SCHEMA,
    GoldenTable,
    Rule,
    metric_names,
    prediction_band,
    table_numbers,
)
from testbed.golden.golden_tolerance import Tolerances
from testbed.metrics.document import errors
from testbed.pool.flight_code import describe_code
from testbed.pool.flight_task import COMPLETED
from testbed.pool.scenario_snapshot import (
    Inputs,
    differences,
    file_differences,
    scenario_differences,
)
from testbed.runs.bounds import BoundResult

RULES_ALONE = Tolerances()


@dataclass(frozen=True, slots=True)
class GoldenFlight:
    """Metrics of a flight with one seed, or the problem that prevented it."""

    seed: int
    metrics: Mapping[str, Any] | None
    problem: str = ""
    wall_s: float = 0.0


@dataclass(frozen=True, slots=True)
class FlightProblem:
    """A reason why a flight, or with seed None all of them, cannot be compared."""

    seed: int | None
    text: str

    def __str__(self) -> str:
        """Format on one line."""
        return self.text if self.seed is None else f"seed {self.seed}: {self.text}"


@dataclass(frozen=True, slots=True)
class Violation:
    """A number outside its limits: of one seed, or the mean over several.

    Args:
        key: of its row.
        seeds: of the flights.
        measured: the number.
        golden: the number of the table; the middle of a band.
        low: the lowest that passes; minus infinity: every one below `golden` does.
        high: the highest that passes; infinity: every one above `golden` does.
        better: whether the number is better than that of the table.
    """

    key: str
    seeds: tuple[int, ...]
    measured: float
    golden: float
    low: float
    high: float
    better: bool

    @property
    def deviation(self) -> float:
        """Distance from the golden number in tolerances; above 1."""
        limit = self.low if self.measured < self.golden else self.high
        return (self.measured - self.golden) / (limit - self.golden)


@dataclass(frozen=True, slots=True)
class RowComparison:
    """A row of the table and the same number of the flights."""

    key: str
    rule: Rule
    seeds: tuple[int, ...]  # that have the number
    golden: float  # mean over the seeds that both have; else over all seeds of the table
    measured: float | None  # mean over the seeds that both have; else over the others; None: none
    band: tuple[float, float] | None
    missing: bool
    violations: tuple[Violation, ...]
    better: bool  # than the table, by more than the rule allows, in the mean over its seeds

    @property
    def passed(self) -> bool:
        """Return whether the row passes; one without valid flights is a problem."""
        return not self.missing and not self.violations

    @property
    def inside_band(self) -> bool:
        """Return whether the mean is inside the band for one more seed."""
        if self.band is None or self.measured is None:
            return False
        return self.band[0] <= self.measured <= self.band[1]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a comparison."""

    name: str  # of the scenario, as the user wrote it
    overrides: tuple[str, ...]  # settings of `--set`
    table: GoldenTable
    seeds: tuple[int, ...]
    wall_s: float
    changes: tuple[str, ...]  # of the scenario and its files
    versions: tuple[str, ...]  # that differ
    code: str  # that wrote the table, and this one; empty: they are the same
    problems: tuple[FlightProblem, ...]
    notes: tuple[str, ...]
    rows: tuple[RowComparison, ...]
    bounds: tuple[BoundResult, ...]

    @property
    def passed(self) -> bool:
        """Return whether flights agree with the table and the scenario's bounds."""
        within = not any(each.violations for each in self.bounds)
        return within and not self.problems and all(row.passed for row in self.rows)

    @property
    def violations(self) -> list[Violation]:
        """Violations of all rows, the largest deviation first."""
        found = [violation for row in self.rows for violation in row.violations]
        return sorted(found, key=lambda each: (-each.deviation, each.key, each.seeds))

    @property
    def improved(self) -> list[RowComparison]:
        """Rows that pass and are better than the table."""
        return [row for row in self.rows if row.passed and row.better]


def flight_problems(flight: GoldenFlight) -> list[FlightProblem]:
    """List why a flight cannot be compared: incomplete, a follower not joined.

    Such flights have numbers too, which may even repeat.
    """
    if flight.metrics is None:
        return [FlightProblem(flight.seed, flight.problem)]
    metrics = flight.metrics
    if metrics["outcome"] != COMPLETED:
        why = "".join(f"; {what}" for _, what in errors(metrics)[:3])
        text = f"{metrics['outcome']} at {metrics['simulated_s']:g} s{why}"
        return [FlightProblem(flight.seed, text)]
    never = [name for name, time_s in metrics["joined_at_s"].items() if time_s is None]
    problems = []
    if never:
        text = f"never reached its slot: {', '.join(never)}"
        problems.append(FlightProblem(flight.seed, text))
    for name, window in metrics["windows"].items():
        if not window["complete"]:
            start, end = window["window_s"]
            text = f"window {name} covers {window['covered_s']:g} s of {end - start:g} s"
            problems.append(FlightProblem(flight.seed, text))
    return problems


def compare(
    name: str,
    table: GoldenTable,
    flights: Sequence[GoldenFlight],
    *,
    inputs: Inputs,
    bounds: Sequence[BoundResult] = (),
    overrides: Sequence[str] = (),
    tolerances: Tolerances = RULES_ALONE,
) -> Verdict:
    """Compare flights of a scenario with its table.

    The number of a seed in the table is compared with the table's number of that seed. Where the
    seed changes numbers, other seeds are compared with the band, one by one and in the mean.

    Args:
        name: of the scenario, as the user wrote it.
        table: the reference.
        flights: one per seed.
        inputs: of the scenario, to describe changes.
        bounds: comparisons with the bounds of the scenario.
        overrides: settings of the scenario.
        tolerances: beside those of `RULES`.
    """
    problems = [problem for flight in flights for problem in flight_problems(flight)]
    invalid = {problem.seed for problem in problems}
    valid = {
        flight.seed: flight.metrics
        for flight in flights
        if flight.metrics is not None and flight.seed not in invalid
    }
    numbers = {seed: table_numbers(metrics) for seed, metrics in valid.items()}
    notes: list[str] = []
    if valid:
        structure, notes = _compare_structure(table, list(valid.values()))
        problems += [FlightProblem(None, text) for text in structure]
    versions: Mapping[str, str] = next(
        (flight.metrics["versions"] for flight in flights if flight.metrics), {}
    )
    return Verdict(
        name=name,
        overrides=tuple(overrides),
        table=table,
        seeds=tuple(flight.seed for flight in flights),
        wall_s=sum(flight.wall_s for flight in flights),
        changes=(
            *scenario_differences(table.scenario_digests, inputs),
            *file_differences(table.files, table.value_digests, inputs),
        ),
        versions=differences(table.versions, versions) if versions else (),
        code=_describe_code(table),
        problems=tuple(problems),
        notes=tuple(notes),
        rows=tuple(_compare_row(table, key, numbers, tolerances) for key in table.rows),
        bounds=tuple(bounds),
    )


def _compare_structure(
    table: GoldenTable, flights: Sequence[Mapping[str, Any]]
) -> tuple[list[str], list[str]]:
    """List windows, followers and numbers that are missing or new; and notes on new metrics."""
    problems: list[str] = []
    explained: set[str] = set()
    keys = list(dict.fromkeys(key for metrics in flights for key in table_numbers(metrics)))
    for what, level in (("window", 1), ("follower", 2)):
        old, new = _key_parts(table.rows, level), _key_parts(keys, level)
        for name in (*(n for n in old if n not in new), *(n for n in new if n not in old)):
            problems.append(f"{what} {name} is {'missing' if name in old else 'new'}")
            explained.add(name)
    for key in (*table.rows, *keys):
        if (key in table.rows) != (key in keys) and not explained & set(key.split("/")):
            problems.append(f"number {key} is {'missing' if key in table.rows else 'new'}")
    if not table.random and any(
        table_numbers(each) != table_numbers(flights[0]) for each in flights
    ):
        problems.append("the seed changes the numbers, which it did not when the table was made")
    names = metric_names(flights[0])
    missing = [f"metric {name} is missing" for name in table.metrics if name not in names]
    notes = []
    if table.schema_version == SCHEMA:
        problems += missing
    else:  # metrics may have gone or have another name since
        notes = [f"the table is of schema {table.schema_version}", *missing]
    notes += [f"metric {name} is new" for name in names if name not in table.metrics]
    return list(dict.fromkeys(problems)), notes


def _describe_code(table: GoldenTable) -> str:
    """Return the code that wrote a table and the present one; empty if they are the same."""
    now = describe_code()
    if table.code == now:
        return ""
    return (
        f"the table is of {table.code or 'a testbed whose code it does not state'}; this is {now}"
    )


def _key_parts(keys: Sequence[str] | Mapping[str, Any], level: int) -> list[str]:
    """Return the windows (level 1) or followers (2) in keys of RMS errors."""
    split = [key.split("/") for key in keys if key.startswith("rms_m/")]
    return list(dict.fromkeys(parts[level] for parts in split))


def _compare_row(
    table: GoldenTable,
    key: str,
    flights: Mapping[int, Mapping[str, float | None]],
    tolerances: Tolerances,
) -> RowComparison:
    rule, row = RULES[key.split("/")[0]], table.rows[key]
    values = {seed: value for seed, rows in flights.items() if (value := rows.get(key)) is not None}
    references = {seed: table.same_seed(key, seed) for seed in values}
    golden = {seed: value for seed, value in references.items() if value is not None}
    violations: list[Violation] = []

    def judge(
        seeds: tuple[int, ...], measured: float, golden: float, low: float, high: float
    ) -> None:
        limits = tolerances.limits(key, golden, low, high)
        violations.extend(_outside(key, rule, seeds, measured, golden, *limits))

    for seeds in _seed_groups(table, values, golden):
        value, allowed = golden[seeds[0]], rule.allowed(golden[seeds[0]])
        judge(seeds, values[seeds[0]], value, value - allowed, value + allowed)
    new_seeds = tuple(seed for seed in values if seed not in golden)
    if row.band:
        middle = 0.5 * sum(row.band)
        for seed in new_seeds:
            judge((seed,), values[seed], middle, *row.band)
        if len(new_seeds) > 1:
            low, high = prediction_band(
                row.by_seed,
                false_alarm=FALSE_ALARM,
                min_half_width=rule.allowed(statistics.fmean(row.by_seed)),
                new_values=len(new_seeds),
            )
            over_new = statistics.fmean(values[seed] for seed in new_seeds)
            judge(new_seeds, over_new, 0.5 * (low + high), low, high)
    # means over the seeds of both, unless only seeds that the table does not have violate it
    violating = {seed for violation in violations for seed in violation.seeds}
    common = tuple(golden) if golden and not (violating and violating.isdisjoint(golden)) else ()
    shown = common or new_seeds
    mean = statistics.fmean([golden[seed] for seed in common] or row.by_seed)
    measured = statistics.fmean([values[seed] for seed in shown]) if shown else None
    gain = 0.0
    if common and measured is not None:
        gain = mean - measured if rule.better == "lower" else measured - mean
    return RowComparison(
        key=key,
        rule=rule,
        seeds=tuple(values),
        golden=mean,
        measured=measured,
        band=row.band,
        missing=bool(flights) and not values,
        violations=tuple(violations),
        better=gain > rule.allowed(mean),
    )


def _seed_groups(
    table: GoldenTable, values: Mapping[int, float], golden: Mapping[int, float]
) -> list[tuple[int, ...]]:
    """Group seeds: one by one, or all if seeds change no number."""
    if not table.random and golden and len(set(values.values())) == 1:
        return [tuple(golden)]
    return [(seed,) for seed in golden]


def _outside(
    key: str,
    rule: Rule,
    seeds: tuple[int, ...],
    measured: float,
    golden: float,
    low: float,
    high: float,
) -> list[Violation]:
    """Return one violation, or none. The limits themselves are inside, despite rounding."""
    slack = 1e-9 * max(abs(each) for each in (low, high, golden) if math.isfinite(each))
    if low - slack <= measured <= high + slack and math.isfinite(measured):
        return []
    better = (measured < golden) == (rule.better == "lower")
    return [Violation(key, seeds, measured, golden, low, high, better)]


def compare_numbers(
    golden: Mapping[str, float],
    measured: Mapping[str, float],
    tolerances: Tolerances = RULES_ALONE,
) -> list[Violation]:
    """Compare numbers of one flight with golden ones, without a table and its flights.

    Args:
        golden: by row key, `QUANTITY/WHERE`, such as `mean_rms_m/circles`; quantities are those of
            `RULES`, in their units.
        measured: by the same keys.
        tolerances: beside those of `RULES`.

    Returns:
        A violation for each number outside its limits, in order of `golden`; [] if all agree. A
        number that is not finite is outside. Violations have no seeds.

    Raises:
        InputError: a number is missing or new, or its quantity has no rule.
    """
    if single := sorted(golden.keys() ^ measured.keys()):
        raise InputError(f"{join_names(single)}: in one of two tables; write the same keys in both")
    if unknown := sorted(key for key in golden if key.split("/")[0] not in RULES):
        raise InputError(f"{join_names(unknown)}: no rule (write one of {', '.join(RULES)})")
    found: list[Violation] = []
    for key, value in golden.items():
        limits = tolerances.limits(key, value)
        found += _outside(key, RULES[key.split("/")[0]], (), measured[key], value, *limits)
    return found
