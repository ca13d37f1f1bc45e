"""Schema of a study file: scenario, varying keys, and seeds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from fractions import Fraction
from statistics import NormalDist
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, WithJsonSchema, model_validator
from pydantic_core import PydanticCustomError

from testbed.scenario.fields import (
    SMALLEST,
    Degrees,
    KeyPath,
    Name,
    Number,
    Seconds,
    Section,
    Whole,
    raise_findings,
)
from testbed.studies.sequential_interval import MIN_VALUES

MAX_RUNS = 1_000_000
MAX_SEEDS = 100_000
MAX_LEVELS = 8  # of a map: cells of 256 points a side
CASE_SCENARIO = "scenario"  # the key of a case that names a scenario, and changes no key of one
CASE_LABEL = "label"  # the same, of what stands for it in figures and tables
MAX_LABEL = 80  # letters

Value = bool | int | float | str
"""A value of a scenario key."""
KeyProblem = tuple[KeyPath, str]
"""The path of a key in the file, and what is wrong with it."""

_FORMS = "a list, {from, to, count}, {from, to, step}, {uniform: [a, b]}, {log_uniform: [a, b]}, "
_FORMS += "{normal: [mean, sd]} or {choice: [...]}"
_SEED = "scenario.seed"


def _check_level(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    if isinstance(value, bool | int | float | str):
        return value
    raise PydanticCustomError(
        "level", "must be a number, a word, true or false (maps and lists are for cases)"
    )


def _list_as_choice(value: Any) -> Any:  # noqa: ANN401
    return {"choice": value} if isinstance(value, list | tuple) else value


def _expand_seeds(value: Any) -> Any:  # noqa: ANN401
    """Expand a number n to the seeds 1 to n."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MAX_SEEDS:
            raise PydanticCustomError("seeds", f"must be 1 to {MAX_SEEDS:,}, or a list of seeds")
        return tuple(range(1, value + 1))
    if isinstance(value, list | tuple):
        return tuple(value)
    raise PydanticCustomError("seeds", "must be the number of seeds (5 is 1 to 5), or their list")


Level = Annotated[
    Any, BeforeValidator(_check_level), WithJsonSchema({"type": ["number", "string", "boolean"]})
]
"""One value of a key: a number, a word, true or false."""
Seed = Annotated[Whole, Field(ge=0, lt=2**63)]
Pair = tuple[Number, Number]


class Variation(Section):
    """Values of one scenario key: a list of levels, or a distribution."""

    model_config = ConfigDict(populate_by_name=True)

    choice: tuple[Level, ...] | None = Field(
        None, min_length=1, description="These values; a bare list means the same."
    )
    start: Number | None = Field(None, alias="from", description="First of evenly spaced numbers.")
    to: Number | None = Field(None, description="Last of evenly spaced numbers.")
    count: Whole | None = Field(None, ge=2, le=100_000, description="Number of evenly spaced ones.")
    step: Number | None = Field(
        None, ge=SMALLEST, description="Difference of neighbouring numbers."
    )
    uniform: Pair | None = Field(None, description="Uniform distribution over [low, high].")
    log_uniform: Pair | None = Field(
        None, description="Distribution over [low, high] whose logarithm is uniform."
    )
    normal: Pair | None = Field(None, description="Normal distribution, [mean, sd].")
    label: str | None = Field(
        None, description="What stands for the key in figures and tables of the report."
    )

    @property
    def is_distribution(self) -> bool:
        """Return whether values are drawn from a distribution, without levels."""
        return any(each is not None for each in (self.uniform, self.log_uniform, self.normal))

    @property
    def level_count(self) -> int:
        """Number of levels; 1 for a distribution."""
        if self.choice is not None:
            return len(self.choice)
        if self.start is None or self.to is None:
            return 1
        if self.count is not None:
            return self.count
        assert self.step is not None
        return math.floor((_exact(self.to) - _exact(self.start)) / _exact(self.step)) + 1

    def level(self, index: int) -> Value:
        """Return the level at an index from 0.

        Evenly spaced numbers are computed from the decimals in the file, so that 0 to 1 by 0.1 has
        exactly 0.3; they are integers if start and step are.
        """
        if self.choice is not None:
            return self.choice[index]  # type: ignore[no-any-return]
        assert self.start is not None and self.to is not None
        start, to = _exact(self.start), _exact(self.to)
        if self.count is not None:
            step = (to - start) / (self.count - 1)
        else:
            assert self.step is not None
            step = _exact(self.step)
        whole = start.denominator == 1 and step.denominator == 1
        value = start + index * step
        return int(value) if whole else float(value)

    def quantile(self, probability: float) -> Value:
        """Return the quantile of the distribution; levels have equal probabilities.

        Args:
            probability: from 0 to below 1.
        """
        if self.uniform is not None:
            low, high = self.uniform
            return low + probability * (high - low)
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return min(low * math.pow(high / low, probability), high)
        if self.normal is not None:
            # in place of 0, whose quantile is minus infinity: half the resolution of a draw
            return NormalDist(*self.normal).inv_cdf(probability or 2.0**-54)
        return self.level(min(int(probability * self.level_count), self.level_count - 1))


def _exact(number: float) -> Fraction:
    """Return the decimal number that is written in the file."""
    return Fraction(repr(number))


class Predicted(Section):
    """What is predicted of each point, without flying it."""

    margins_at_deg: Degrees = Field(
        ge=0,
        le=60,
        description="Margins in steady flight at this bank of the follower that banks most, "
        "degrees; 0: straight.",
    )


class Until(Section):
    """The section `until`: how well a number is to be known at each point."""

    metric: str = Field(
        min_length=1, description="A number of metrics.json, its keys joined by dots."
    )
    half_width: Number = Field(
        ge=SMALLEST,
        description="A point is flown with further seeds until the interval of the mean is within "
        "plus or minus this, in the unit of the metric.",
    )
    confidence: Number = Field(
        0.95,
        ge=0.5,
        le=0.9999,
        description="That the mean is within the interval at whatever number of flights it is "
        "looked at.",
    )
    statistic: Literal["mean"] = Field("mean", description="Over the seeds of a point: mean.")


class Refine(Section):
    """The section `refine`: where a map of two keys is flown in detail."""

    metric: str = Field(
        min_length=1, description="The number of the map: of metrics.json, keys joined by dots."
    )
    levels: Whole = Field(
        ge=1,
        le=MAX_LEVELS,
        description="How often a cell of the first grid, with every 2^levels-th value of each key, "
        "can be halved.",
    )
    contour: Number | None = Field(
        None, description="A value of the metric whose contour is flown in detail."
    )


class StudySettings(Section):
    """The section `study`: what is flown, and how often."""

    model_config = ConfigDict(populate_by_name=True)

    schema_version: Literal[1] = Field(alias="schema", description="Version of the file format: 1.")
    name: Name = Field(description="Name of the study, and of the folder of its results.")
    question: str = Field("", description="The question the study answers.")
    scenario: str = Field(
        min_length=1, description="Name of a scenario, or a path relative to the study file."
    )
    duration_s: Seconds | None = Field(
        None,
        ge=SMALLEST,
        le=86_400,
        description="End of the flights, instead of the scenario's, s.",
    )
    set: Mapping[str, Any] = Field({}, description="Scenario keys to change, as with --set.")
    design: Literal["factorial", "latin-hypercube", "monte-carlo", "map"] | None = Field(
        None,
        description="How points are made of vary: factorial, all combinations, is the default.",
    )
    refine: Refine | None = Field(
        None, description="Which points of design map are flown, from the results of others."
    )
    samples: Whole | None = Field(
        None, ge=1, le=MAX_RUNS, description="Points of latin-hypercube and monte-carlo."
    )
    design_seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of the drawn points.")
    seeds: Annotated[tuple[Seed, ...], BeforeValidator(_expand_seeds)] = Field(
        (1,), min_length=1, description="Seeds of the flights: their number, or a list."
    )
    until: Until | None = Field(
        None,
        description="When a point has been flown often enough; seeds is then the largest number.",
    )
    metrics: tuple[str, ...] = Field(
        (), description="Numbers of metrics.json to show first, their keys joined by dots."
    )
    predict: Predicted | None = Field(
        None, description="Numbers to predict from the linearised formation in place of flights."
    )

    @property
    def shown_metrics(self) -> tuple[str, ...]:
        """The numbers to show first: `metrics`, or else the one that decides what is flown."""
        return self.metrics or tuple(name for _, name in self.deciding_metrics[:1])

    @property
    def deciding_metrics(self) -> tuple[tuple[KeyPath, str], ...]:
        """The numbers on which it depends what is flown, with their places in the file."""
        sections = {"until": self.until, "refine": self.refine}
        return tuple(
            (("study", name, "metric"), each.metric) for name, each in sections.items() if each
        )

    @property
    def chooses_runs(self) -> bool:
        """Whether results decide which runs of the plan are flown."""
        return bool(self.deciding_metrics)


class StudyConfig(Section):
    """A study file: everything that decides the rows of a study."""

    study: StudySettings = Field(description="What is flown, and how often.")
    vary: Mapping[str, Annotated[Variation, BeforeValidator(_list_as_choice)]] = Field(
        {}, description="Scenario keys and their values."
    )
    cases: Mapping[Name, Mapping[str, Any]] = Field(
        {},
        description="Named changes; each is flown with every point of vary. The key label is what "
        "stands for the case in figures and tables of the report.",
    )

    def case_changes(self, case: str) -> Mapping[str, Any]:
        """Return the scenario keys that a case changes; of no case: none."""
        own = (CASE_SCENARIO, CASE_LABEL)
        return {key: each for key, each in self.cases.get(case, {}).items() if key not in own}

    @property
    def case_labels(self) -> Mapping[str, str]:
        """Labels by the names of cases that have one."""
        return {name: each[CASE_LABEL] for name, each in self.cases.items() if each.get(CASE_LABEL)}

    @property
    def key_labels(self) -> Mapping[str, str]:
        """Labels by the keys of vary that have one."""
        return {key: each.label for key, each in self.vary.items() if each.label}

    @model_validator(mode="after")
    def _check_study(self) -> Self:
        raise_findings(_check(self))
        return self


def _check(config: StudyConfig) -> list[KeyProblem]:
    """Find what is wrong between sections that are each valid."""
    problems = [each for key, values in config.vary.items() for each in _check_values(key, values)]
    if problems:
        return problems
    return [
        *_check_design(config),
        *_check_map(config),
        *_check_keys(config),
        *_check_labels(config),
        *_check_lists(config),
        *_check_prediction(config.study),
    ]


def _check_values(key: str, values: Variation) -> Iterator[KeyProblem]:
    here = ("vary", key)
    names = ("choice", "uniform", "log_uniform", "normal")
    forms = [name for name in names if getattr(values, name) is not None]
    spaced = {"from": values.start, "to": values.to, "count": values.count, "step": values.step}
    present = [name for name, value in spaced.items() if value is not None]
    if len(forms) + bool(present) != 1:
        yield here, f"must have one form (write {_FORMS})"
    elif present and {"from", "to"} - set(present):
        yield here, "evenly spaced numbers need from and to, and count or step"
    elif present and (values.count is None) == (values.step is None):
        yield here, "evenly spaced numbers need either count or step"
    elif values.start is not None and values.to is not None and not values.start < values.to:
        yield (*here, "to"), f"is {values.to:g} (write a number above from, {values.start:g})"
    elif values.choice is not None:
        # 1 and true are equal in Python, and different in YAML
        seen = [(isinstance(value, str | bool), value) for value in values.choice]
        twice = [value for k, (_, value) in enumerate(seen) if seen[k] in seen[:k]]
        if twice:
            yield here, f"has {twice[0]!r} twice (write it once)"
    else:
        yield from _check_distribution(here, values)


def _check_distribution(here: tuple[str, ...], values: Variation) -> Iterator[KeyProblem]:
    for name in ("uniform", "log_uniform"):
        pair = getattr(values, name)
        if pair is not None and not pair[0] < pair[1]:
            yield (*here, name), f"is [{pair[0]:g}, {pair[1]:g}] (write [low, high])"
        elif name == "log_uniform" and pair is not None and pair[0] <= 0.0:
            yield (*here, name), f"is [{pair[0]:g}, {pair[1]:g}] (write numbers above 0)"
    if values.normal is not None and not values.normal[1] > 0.0:
        yield (*here, "normal"), "has no spread (write [mean, standard deviation above 0])"


def _check_design(config: StudyConfig) -> Iterator[KeyProblem]:
    settings = config.study
    drawn = settings.design in ("latin-hypercube", "monte-carlo")
    if settings.design is not None and not config.vary:
        yield ("study", "design"), "has nothing to vary (write vary, or leave design out)"
    if drawn and settings.samples is None:
        yield ("study",), f"design {settings.design} needs a number of points (write samples: 40)"
    for key in ("samples", "design_seed"):
        if not drawn and key in settings.model_fields_set:
            yield (
                ("study", key),
                "is for latin-hypercube and monte-carlo (leave it out, or change design)",
            )
    if not drawn:
        for key, values in config.vary.items():
            if values.is_distribution:
                yield (
                    ("vary", key),
                    "is a distribution, which a factorial design cannot have (write its levels, as "
                    "{from: 0, to: 1, count: 5}, or design: latin-hypercube)",
                )


def _check_prediction(settings: StudySettings) -> Iterator[KeyProblem]:
    if settings.predict is None:
        return
    if settings.duration_s is not None:
        text = "is of flights, and study.predict flies none (leave one of the two out)"
        yield ("study", "duration_s"), text
    if len(settings.seeds) > 1:
        text = f"are {len(settings.seeds)}, and no seed changes what study.predict predicts"
        yield ("study", "seeds"), f"{text} (leave seeds out)"


def _check_map(config: StudyConfig) -> Iterator[KeyProblem]:
    settings = config.study
    refine = settings.refine
    if settings.design != "map":
        if refine is not None:
            yield ("study", "refine"), "is for design: map (leave it out, or change design)"
        return
    if refine is None:
        yield (
            ("study",),
            "design map needs a section refine (write for example refine: {metric: "
            "min_separation_m, levels: 3})",
        )
        return
    if len(config.vary) != 2:
        yield ("vary",), f"has {len(config.vary)} keys (write two, the axes of the map)"
    step = 2**refine.levels
    for key, values in config.vary.items():
        if values.count is None:
            yield (
                ("vary", key),
                "is an axis of a map (write evenly spaced numbers, as {from: 0, to: 1, count: "
                f"{4 * step + 1}}})",
            )
        elif (values.count - 1) % step:
            below = (values.count - 1) // step * step + 1
            near = [str(each) for each in (below, below + step) if each > 1]
            yield (
                ("vary", key, "count"),
                f"is {values.count}; with levels: {refine.levels} it is a multiple of {step} plus "
                f"1 (write {' or '.join(near)})",
            )
    if settings.until is not None and settings.until.metric != refine.metric:
        yield (
            ("study", "until", "metric"),
            f"is not the number of the map (write {refine.metric}, that of refine)",
        )


def _check_keys(config: StudyConfig) -> Iterator[KeyProblem]:
    every: list[tuple[tuple[str, ...], Mapping[str, Any]]] = [
        (("study", "set"), config.study.set),
        (("vary",), config.vary),
    ]
    every += [(("cases", name), config.cases[name]) for name in config.cases]
    for here, keys in every:
        for key in keys:
            if key == _SEED:
                yield (*here, key), "the study sets the seeds (write study.seeds)"
            elif not all(key.split(".")):
                yield (*here, key), "is not a scenario key (write for example network.delay_s)"
            elif here != ("vary",) and key in config.vary:
                yield (*here, key), "is also in vary (write it in one place)"
    for name, case in config.cases.items():
        scenario = case.get(CASE_SCENARIO)
        if CASE_SCENARIO in case and not (isinstance(scenario, str) and scenario):
            yield ("cases", name, CASE_SCENARIO), "must be the name or the path of a scenario"


def _check_labels(config: StudyConfig) -> Iterator[KeyProblem]:
    of_cases = {k: each[CASE_LABEL] for k, each in config.cases.items() if CASE_LABEL in each}
    of_keys = {key: each.label for key, each in config.vary.items() if each.label is not None}
    sections = {"cases": (config.cases, of_cases), "vary": (config.vary, of_keys)}
    for section, (names, labels) in sections.items():
        # what stands for each of them: two of the same could not be told apart
        shown = {name: labels.get(name, name) for name in names}
        for name, label in labels.items():
            here = (section, name, "label")
            if not isinstance(label, str) or not label.strip() or "\n" in label:
                yield here, "must be a text of one line"
            elif len(label) > MAX_LABEL:
                yield here, f"has {len(label)} letters (write at most {MAX_LABEL})"
            elif others := [each for each in shown if shown[each] == label and each != name]:
                yield here, f"is also what stands for {others[0]} (write another one)"


def _check_lists(config: StudyConfig) -> Iterator[KeyProblem]:
    settings = config.study
    for key, values in (("seeds", settings.seeds), ("metrics", settings.metrics)):
        if len(set(values)) < len(values):
            yield ("study", key), "has an element twice (write it once)"
    points = settings.samples or math.prod(each.level_count for each in config.vary.values())
    runs = points * max(1, len(config.cases)) * len(settings.seeds)
    if runs > MAX_RUNS:
        yield ("study",), f"has {runs:,} runs (write fewer than {MAX_RUNS:,})"
    if settings.until is not None and len(settings.seeds) < MIN_VALUES:
        few = f"{len(settings.seeds)} seed{'s' * (len(settings.seeds) > 1)}"
        yield (
            ("study", "seeds"),
            f"has {few}, the most that until may fly at a point (write {MIN_VALUES} or more, for "
            "example 200)",
        )
