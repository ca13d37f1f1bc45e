"""Schema of a tune file: study, gains, and the metric to minimise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from testbed.core.input_files import read_bounded_text
from testbed.scenario import find_tuning
from testbed.scenario.fields import (
    SMALLEST,
    Degrees,
    NotNegative,
    Number,
    Seconds,
    Section,
    Whole,
    raise_findings,
)
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import read
from testbed.studies.plan import Study
from testbed.studies.study_schema import KeyProblem, Seed, StudyConfig

GAINS = "controller.gains."  # keys below it are written into the gains file
MIN_GAINS = 2  # CMA-ES estimates a covariance
HELD_OUT_SEEDS = 8  # where the file names none
MIN_HELD_OUT_SEEDS = 3  # for an interval


class GainBounds(Section):
    """Interval in which a gain is searched."""

    model_config = ConfigDict(populate_by_name=True)

    low: Number = Field(alias="from", description="Smallest value.")
    high: Number = Field(alias="to", description="Largest value.")
    scale: Literal["linear", "log"] = Field(
        "linear", description="Whether the search steps are differences or ratios."
    )
    start: Number | None = Field(
        None, description="First value of the search; default the scenario's."
    )


class MeanPlusSd(Section):
    """Mean plus a multiple of the standard deviation."""

    mean_plus_sd: NotNegative


class Quantile(Section):
    """A quantile, 0 to 1."""

    quantile: Number


Aggregate = Literal["worst", "mean"] | MeanPlusSd | Quantile


class Objective(Section):
    """What is minimised."""

    metric: str = Field(
        min_length=1, description="A number of metrics.json, its keys joined by dots."
    )
    aggregate: Aggregate = Field(
        "worst",
        description="How the costs of all flights of a candidate are combined: worst, mean, "
        "{mean_plus_sd: 1} or {quantile: 0.9}.",
    )
    saturate_above: Number | None = Field(
        None,
        ge=SMALLEST,
        description="Metric above which the cost saturates, in its unit; default ten times the "
        "worst flight with the gains of the scenario.",
    )


class Constraint(Section):
    """What the followers need at a bank, by small kicks in steady flight; see `testbed margins`."""

    bank_deg: Degrees = Field(ge=0, lt=90, description="Highest bank of a follower, degrees.")
    damping: Number | None = Field(
        None, ge=SMALLEST, lt=1, description="Least damping ratio of an oscillation."
    )
    roll_gain: Number | None = Field(
        None, gt=1, description="Factor of the roll command with which oscillations decay."
    )
    roll_latency_s: Seconds | None = Field(
        None,
        ge=SMALLEST,
        le=1,
        description="The same, additional latency of the roll command, s.",
    )
    settling_s: Seconds | None = Field(
        None, ge=SMALLEST, description="Longest time until 5 % of a displacement are left, s."
    )


class Search(Section):
    """Extent of the search."""

    max_flights: Whole = Field(ge=1, description="Limit of the search's flights.")
    initial_step: Number = Field(
        0.2, ge=SMALLEST, le=0.5, description="First standard deviation, as a share of the bounds."
    )
    population: Whole | None = Field(
        None, ge=4, le=1000, description="Candidates of a generation; default 4 + 3 ln n."
    )
    seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of the search.")
    held_out_seeds: tuple[Seed, ...] | None = Field(
        None,
        min_length=MIN_HELD_OUT_SEEDS,
        description="Seeds that the search does not use; default the eight after its largest.",
    )


class TuneConfig(StudyConfig):
    """A tune file: everything that decides which gains are found."""

    gains: Mapping[str, GainBounds] = Field(
        min_length=MIN_GAINS, description="Scenario keys, and where they are searched."
    )
    objective: Objective = Field(description="What is minimised.")
    constraints: tuple[Constraint, ...] = Field(
        (), description="Damping and margins that the gains must have."
    )
    search: Search = Field(description="Extent of the search.")

    @model_validator(mode="after")
    def _check_tune(self) -> Self:
        raise_findings(_check(self))
        return self

    @property
    def held_out_seeds(self) -> tuple[int, ...]:
        """Seeds that the search does not use."""
        after = max(self.study.seeds) + 1
        return self.search.held_out_seeds or tuple(range(after, after + HELD_OUT_SEEDS))


@dataclass(frozen=True, slots=True)
class Tune:
    """A tune file, and the study in it."""

    config: TuneConfig
    study: Study


def load_tune(name_or_path: str | Path) -> Tune:
    """Read and validate a tune file; its scenarios are not read.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    path = find_tuning(name_or_path)
    tree = read(path)
    config = validate(tree, TuneConfig)
    return Tune(config, Study(config, path, read_bounded_text(path), tree))


def _check(config: TuneConfig) -> Iterator[KeyProblem]:
    for loc, _ in config.study.deciding_metrics:
        yield loc[:2], "is for testbed sweep: a search flies every run (leave it out)"
    for key, bounds in config.gains.items():
        here = ("gains", key)
        if not bounds.low < bounds.high:
            yield (*here, "to"), f"is {bounds.high:g} (write a number above from, {bounds.low:g})"
        elif bounds.scale == "log" and not bounds.low > 0.0:
            yield (*here, "from"), f"is {bounds.low:g} (write a number above 0, or scale: linear)"
        elif bounds.start is not None and not bounds.low <= bounds.start <= bounds.high:
            text = f"is {bounds.start:g} (write a number from {bounds.low:g} to {bounds.high:g})"
            yield (*here, "start"), text
        parts = key.split(".")
        if parts[0] == "fleet" or "*" in parts or not all(parts):
            text = "is not one number of the scenario (write for example controller.gains.course.p)"
            yield here, text
        if any(key in each for each in (config.study.set, config.vary, *config.cases.values())):
            yield here, "is also set or varied (write it in one place)"
    banks = [each.bank_deg for each in config.constraints]
    for k, each in enumerate(config.constraints):
        if each.model_fields_set == {"bank_deg"}:
            text = "requires nothing (write damping, roll_gain, roll_latency_s or settling_s)"
            yield ("constraints", k), text
        if each.bank_deg in banks[:k]:
            yield ("constraints", k, "bank_deg"), "is there twice (write one map for each bank)"
    seeds = config.search.held_out_seeds or ()
    here = ("search", "held_out_seeds")
    if set(seeds) & set(config.study.seeds):
        yield here, "has seeds of study.seeds (write others)"
    elif len(set(seeds)) < len(seeds):
        yield here, "has a seed twice (write it once)"
    aggregate = config.objective.aggregate
    if isinstance(aggregate, Quantile) and not 0.0 <= aggregate.quantile <= 1.0:
        yield ("objective", "aggregate"), "has a quantile that is not from 0 to 1"
