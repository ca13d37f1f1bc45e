"""Violated bounds of a scenario's `expect`, with the place of each bound in its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.metrics.expectations import bound_key, describe_violation
from testbed.scenario import (
    FilePosition,
    Scenario,
    ScenarioError,
    find_places,
    unchecked,
    unreached_windows,
)


def bound_places(
    bounds: Sequence[Mapping[str, Any]], scenario: str | Path, overrides: Sequence[str] = ()
) -> list[FilePosition | None]:
    """Return the place of each bound in the files of a scenario; None where it has changed since.

    Args:
        bounds: of a metrics document.
        scenario: name or path, as it was loaded.
        overrides: settings with which it was loaded.
    """
    if not bounds:
        return []
    try:
        return find_places([("expect", *each["key"]) for each in bounds], scenario, overrides)
    except ScenarioError:
        return [None] * len(bounds)


@dataclass(frozen=True, slots=True)
class BoundResult:
    """One bound of a scenario and the numbers of all flights compared with it.

    Args:
        key: `expect.rms_m.circles.max`.
        place: of the bound in its file; None where the file has changed since.
        checked: number of comparisons.
        violations: seed and description of each number outside.
    """

    key: str
    place: FilePosition | None
    checked: int
    violations: tuple[tuple[int, str], ...]

    @property
    def texts(self) -> list[str]:
        """The violations with their seeds, those of several seeds with the same number once."""
        seeds: dict[str, list[str]] = {}
        for seed, text in self.violations:
            seeds.setdefault(text, []).append(str(seed))
        return [
            f"seed{'s' * (len(own) > 1)} {', '.join(own)}, {text}" for text, own in seeds.items()
        ]

    @property
    def lines(self) -> list[str]:
        """The violations, one on a line, with place and key of the bound."""
        start = ": ".join((*([str(self.place)] if self.place else []), self.key))
        return [f"{start}: {text}" for text in self.texts]


def bound_results(
    flights: Mapping[int, Mapping[str, Any]], scenario: str | Path, overrides: Sequence[str] = ()
) -> tuple[BoundResult, ...]:
    """Collect the comparisons with each bound.

    Args:
        flights: metrics documents by seed.
        scenario: name or path, as it was loaded.
        overrides: settings with which it was loaded.
    """
    found: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for seed, metrics in flights.items():
        for each in metrics.get("expect", {}).get("bounds", ()):
            found.setdefault(bound_key(each), []).append((seed, each))
    places = bound_places([own[0][1] for own in found.values()], scenario, overrides)
    return tuple(
        BoundResult(
            key,
            place,
            len(own),
            tuple((seed, describe_violation(each)) for seed, each in own if not each["met"]),
        )
        for (key, own), place in zip(found.items(), places, strict=True)
    )


def violation_lines(
    violated: Sequence[Mapping[str, Any]], scenario: str | Path, overrides: Sequence[str] = ()
) -> list[str]:
    """Describe violated bounds, one on a line: place and key of the bound, name, value, bound."""
    places = bound_places(violated, scenario, overrides)
    return [
        ": ".join([*([str(place)] if place else []), bound_key(each), describe_violation(each)])
        for each, place in zip(violated, places, strict=True)
    ]


def unchecked_bounds(scenario: Scenario, duration_s: float) -> list[str]:
    """Describe the bounds that a run of this duration, s, does not check, one on a line."""
    unreached = unreached_windows(scenario, duration_s)
    return [
        f"{key} is not checked: the run ends at {duration_s:g} s, before "
        f"{', '.join(unreached.values())}"
        for key in unchecked(scenario.expect, scenario.scenario.windows, unreached)
    ]
