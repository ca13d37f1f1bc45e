"""A tune's page: a study whose metric is to become small, and the gains that may change for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from testbed.scenario import find_tuning
from testbed.scenario.fields import Number, Section, Whole, refuse
from testbed.scenario.yaml_door import read, validated
from testbed.study.cma_door import FEWEST
from testbed.study.page import Seed, StudyPage
from testbed.study.page_checks import Problem
from testbed.study.plan import Study
from testbed.study.tune_cost import Robust

GAINS = "controller.gains."  # keys below it go into the gains file
HELD_OUT = 8  # seeds, where the page names none
FEWEST_HELD_OUT = 3  # of which an interval can be made


class Bounds(Section):
    """Between which numbers a gain is sought."""

    model_config = ConfigDict(populate_by_name=True)

    low: Number = Field(alias="from", description="Smallest.")
    high: Number = Field(alias="to", description="Largest.")
    scale: Literal["linear", "log"] = Field(
        "linear", description="Whether steps are differences or ratios."
    )
    start: Number | None = Field(
        None, description="Where the search begins; by default at what the scenario has."
    )


class Objective(Section):
    """What is to become small."""

    metric: str = Field(
        min_length=1, description="A number of metrics.json, its keys joined by dots."
    )
    robust: Robust = Field(
        "worst",
        description="How the flights of one set of gains are one number: worst, mean, "
        "{mean_plus_sd: 1} or {quantile: 0.9}.",
    )
    bound: Number | None = Field(
        None,
        gt=0,
        description="Metric beyond which more hardly matters, in its unit; by default ten times the"
        " worst flight's with the gains as they were.",
    )


class Search(Section):
    """How long and how wide is sought, and what is kept apart."""

    flights: Whole = Field(ge=1, description="Flights of the search at most.")
    step: Number = Field(
        0.2, gt=0, le=0.5, description="First standard deviation, as a share of the bounds."
    )
    population: Whole | None = Field(
        None, ge=4, le=1000, description="Sets of gains in a generation; by default 4 + 3 ln n."
    )
    seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of the search.")
    held_out: tuple[Seed, ...] | None = Field(
        None,
        min_length=FEWEST_HELD_OUT,
        description="Seeds that the search does not see; by default the eight after the largest.",
    )


class TunePage(StudyPage):
    """One page: everything that decides which gains come out."""

    gains: Mapping[str, Bounds] = Field(
        min_length=FEWEST, description="Keys of the scenario, and where they are sought."
    )
    objective: Objective = Field(description="What is to become small.")
    search: Search = Field(description="How it is sought.")

    @model_validator(mode="after")
    def _cross_check_tune(self) -> Self:
        refuse(_checks(self))
        return self

    @property
    def held_out(self) -> tuple[int, ...]:
        """Seeds that the search does not see."""
        after = max(self.study.seeds) + 1
        return self.search.held_out or tuple(range(after, after + HELD_OUT))


@dataclass(frozen=True, slots=True)
class Tune:
    """A tune's page, and the study it flies."""

    page: TunePage
    study: Study


def load_tune(name_or_path: str | Path) -> Tune:
    """Read a tune by name or path and return it, checked as far as it needs no scenario.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    path = find_tuning(name_or_path)
    tree = read(path)
    page = validated(tree, TunePage)
    return Tune(page, Study(page, path, path.read_text(encoding="utf-8-sig"), tree))


def _checks(page: TunePage) -> Iterator[Problem]:
    for key, bounds in page.gains.items():
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
            yield (
                here,
                "is not one number of the page (write for example controller.gains.course.p)",
            )
        every = (page.study.set, page.vary, *page.cases.values())
        if any(key in each for each in every):
            yield here, "is set or varied, too (write it in one place)"
    seen = set(page.search.held_out or ())
    if seen & set(page.study.seeds):
        yield ("search", "held_out"), "has seeds of study.seeds (write others)"
    elif len(seen) < len(page.search.held_out or ()):
        yield ("search", "held_out"), "has a seed twice (write it once)"
    robust = page.objective.robust
    if not isinstance(robust, str) and hasattr(robust, "quantile"):
        if not 0.0 <= robust.quantile <= 1.0:
            yield ("objective", "robust"), "has a quantile that is not from 0 to 1"
