"""What the parts of a study's page demand of one another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from testbed.study.levels import count_levels

if TYPE_CHECKING:
    from testbed.study.page import Spread, StudyPage

Problem = tuple[tuple[str | int, ...], str]

_FORMS = "a list, {from, to, count}, {from, to, step}, {uniform: [a, b]}, {log_uniform: [a, b]}, "
_FORMS += "{normal: [mean, sd]} or {choice: [...]}"
_SEED = "scenario.seed"


def cross_check(page: StudyPage) -> list[Problem]:
    """What is wrong with a page whose parts are right, each with the path to it."""
    problems = [each for key, spread in page.vary.items() for each in _of_spread(key, spread)]
    if problems:
        return problems
    return [*_of_design(page), *_of_keys(page), *_of_lists(page)]


def _of_spread(key: str, spread: Spread) -> Iterator[Problem]:
    here = ("vary", key)
    names = ("choice", "uniform", "log_uniform", "normal")
    forms = [name for name in names if getattr(spread, name) is not None]
    row = {"from": spread.start, "to": spread.to, "count": spread.count, "step": spread.step}
    some = [name for name, value in row.items() if value is not None]
    if len(forms) + bool(some) != 1:
        yield here, f"must be one of several forms (write {_FORMS})"
    elif some and {"from", "to"} - set(some):
        yield here, "a row of numbers has from and to, and count or step"
    elif some and (spread.count is None) == (spread.step is None):
        yield here, "a row of numbers has either count or step"
    elif spread.start is not None and spread.to is not None and not spread.start < spread.to:
        yield (*here, "to"), f"is {spread.to:g} (write a number above from, {spread.start:g})"
    elif spread.choice is not None:
        seen = [(isinstance(value, str | bool), value) for value in spread.choice]
        twice = [value for k, (_, value) in enumerate(seen) if seen[k] in seen[:k]]
        if twice:
            yield here, f"has {twice[0]!r} twice (write it once)"
    else:
        yield from _of_distribution(here, spread)


def _of_distribution(here: tuple[str, ...], spread: Spread) -> Iterator[Problem]:
    for name in ("uniform", "log_uniform"):
        pair = getattr(spread, name)
        if pair is not None and not pair[0] < pair[1]:
            yield (*here, name), f"is [{pair[0]:g}, {pair[1]:g}] (write [low, high])"
        elif name == "log_uniform" and pair is not None and pair[0] <= 0.0:
            yield (*here, name), f"is [{pair[0]:g}, {pair[1]:g}] (write numbers above 0)"
    if spread.normal is not None and not spread.normal[1] > 0.0:
        yield (*here, "normal"), "has no spread (write [mean, standard deviation above 0])"


def _of_design(page: StudyPage) -> Iterator[Problem]:
    head = page.study
    random = head.design in ("latin-hypercube", "monte-carlo")
    if page.vary and head.design is None:
        yield ("study",), "has no design (write design: factorial, latin-hypercube or monte-carlo)"
    if head.design is not None and not page.vary:
        yield ("study", "design"), "has nothing to vary (write vary, or leave design out)"
    if random and head.samples is None:
        yield ("study",), f"design {head.design} takes a number of points (write samples: 40)"
    for key in ("samples", "design_seed"):
        if not random and key in head.model_fields_set:
            yield (
                ("study", key),
                "is for latin-hypercube and monte-carlo (leave it out, or change design)",
            )
    if head.design == "factorial":
        for key, spread in page.vary.items():
            if spread.drawn:
                yield (
                    ("vary", key),
                    "is a distribution, which a factorial design cannot have (write its levels, as "
                    "{from: 0, to: 1, count: 5}, or design: latin-hypercube)",
                )


def _of_keys(page: StudyPage) -> Iterator[Problem]:
    every: list[tuple[tuple[str, ...], Mapping[str, Any]]] = [
        (("study", "set"), page.study.set),
        (("vary",), page.vary),
    ]
    every += [(("cases", name), page.cases[name]) for name in page.cases]
    for here, keys in every:
        for key in keys:
            if key == _SEED:
                yield (*here, key), "a study gives seeds by itself (write study.seeds)"
            elif not all(key.split(".")):
                yield (*here, key), "is no key of a page (write for example network.delay_s)"
            elif here != ("vary",) and key in page.vary:
                yield (*here, key), "is varied, too (write it in one place)"
    for name, case in page.cases.items():
        scenario = case.get("scenario")
        if "scenario" in case and not (isinstance(scenario, str) and scenario):
            yield ("cases", name, "scenario"), "must be the name or the path of a scenario"


def _of_lists(page: StudyPage) -> Iterator[Problem]:
    from testbed.study.page import MOST_RUNS

    head = page.study
    for key, values in (("seeds", head.seeds), ("metrics", head.metrics)):
        if len(set(values)) < len(values):
            yield ("study", key), "has something twice (write it once)"
    points = head.samples or math.prod(map(count_levels, page.vary.values()))
    runs = points * max(1, len(page.cases)) * len(head.seeds)
    if runs > MOST_RUNS:
        yield ("study",), f"asks for {runs:,} runs (write fewer than {MOST_RUNS:,})"
