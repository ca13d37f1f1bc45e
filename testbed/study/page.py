"""A study's page: a scenario, what of it is varied, and with which seeds each point is flown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from testbed.scenario.fields import Name, Number, Seconds, Section, Whole, refuse
from testbed.study.page_checks import cross_check

MOST_RUNS = 1_000_000
MOST_SEEDS = 100_000
CASE_SCENARIO = "scenario"  # the key of a case that is no key of a scenario's page


def _level(value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
    if isinstance(value, bool | int | float | str):
        return value
    raise PydanticCustomError(
        "level", "must be a number, a word, true or false (maps and lists are for cases)"
    )


def _spread(value: Any) -> Any:  # noqa: ANN401
    """A list is a choice."""
    return {"choice": value} if isinstance(value, list | tuple) else value


def _seeds(value: Any) -> Any:  # noqa: ANN401
    """A number stands for the seeds from 1 to it."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST_SEEDS:
            raise PydanticCustomError("seeds", f"must be 1 to {MOST_SEEDS:,}, or a list of seeds")
        return tuple(range(1, value + 1))
    if isinstance(value, list | tuple):
        return tuple(value)
    raise PydanticCustomError(
        "seeds", "must be how many seeds there are (5 is 1 to 5), or a list of them"
    )


Level = Annotated[
    Any, BeforeValidator(_level), WithJsonSchema({"type": ["number", "string", "boolean"]})
]
"""One value of a key: a number, a word, true or false."""
Seed = Annotated[Whole, Field(ge=0, lt=2**63)]
Pair = tuple[Number, Number]


class Spread(Section):
    """The values of one key: levels, or a distribution to draw from."""

    model_config = ConfigDict(populate_by_name=True)

    choice: tuple[Level, ...] | None = Field(
        None, min_length=1, description="These values; a bare list means the same."
    )
    start: Number | None = Field(None, alias="from", description="The first of a row of numbers.")
    to: Number | None = Field(None, description="The last of a row of numbers.")
    count: Whole | None = Field(None, ge=2, le=100_000, description="How many, evenly spaced.")
    step: Number | None = Field(None, gt=0, description="From one number of the row to the next.")
    uniform: Pair | None = Field(None, description="Drawn between [low, high].")
    log_uniform: Pair | None = Field(
        None, description="Drawn between [low, high], its logarithm evenly."
    )
    normal: Pair | None = Field(None, description="Drawn with [mean, standard deviation].")

    @property
    def drawn(self) -> bool:
        """Whether it is a distribution, which has no levels."""
        return any(each is not None for each in (self.uniform, self.log_uniform, self.normal))


class StudyHeader(Section):
    """What the study asks, what it flies, and how often."""

    model_config = ConfigDict(populate_by_name=True)

    schema_version: Literal[1] = Field(alias="schema", description="Version of the page: 1.")
    name: Name = Field(description="Name of the study; its results are kept under this name.")
    question: str = Field("", description="The question the study answers.")
    scenario: str = Field(
        min_length=1, description="Name of a scenario, or a path from the study's page."
    )
    duration_s: Seconds | None = Field(
        None, gt=0, le=86_400, description="End the flights earlier or later, s."
    )
    set: Mapping[str, Any] = Field({}, description="Keys of the scenario, as for --set.")
    design: Literal["factorial", "latin-hypercube", "monte-carlo"] | None = Field(
        None, description="How points are made of vary."
    )
    samples: Whole | None = Field(
        None, ge=1, le=MOST_RUNS, description="Points of latin-hypercube and monte-carlo."
    )
    design_seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of what is drawn.")
    seeds: Annotated[tuple[Seed, ...], BeforeValidator(_seeds)] = Field(
        (1,), min_length=1, description="Seeds of the flights: how many, or a list."
    )
    metrics: tuple[str, ...] = Field(
        (), description="Numbers of metrics.json to show first, their keys joined by dots."
    )


class StudyPage(Section):
    """One page: everything that decides the rows of a study."""

    study: StudyHeader = Field(description="What the study is.")
    vary: Mapping[str, Annotated[Spread, BeforeValidator(_spread)]] = Field(
        {}, description="Keys of the scenario and their values."
    )
    cases: Mapping[Name, Mapping[str, Any]] = Field(
        {}, description="Named changes; each is flown with every point of vary."
    )

    @model_validator(mode="after")
    def _cross_check(self) -> Self:
        refuse(cross_check(self))
        return self
