"""Parameters and gains that the flights of a scenario assume, as files to load or to compare.

The parameters of real aircraft, as their ground stations save them, are compared with those of the
flights: a verdict holds for no aircraft that flies with others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from testbed.autopilot.param_file import read_param_file
from testbed.autopilot.parameters import FbwaParams
from testbed.core.errors import InputError
from testbed.core.records import join_names
from testbed.plan.fleet import FormationPlan, PlannedAircraft, PlannedFollower
from testbed.pool.scenario_snapshot import differences
from testbed.scenario import Scenario, dump_middle_loop, load_middle_loop

OWN_TUNE = "autopilot.param"  # of an aircraft
SINGLE = 1e-6  # relative: ArduPlane has parameters in single precision


@dataclass(frozen=True, slots=True)
class AssumedFile:
    """Parameters or gains of some aircraft.

    Attributes:
        name: of the file.
        text: of the file.
        aircraft: names of the aircraft that have them.
        differences: from those of the aircraft's folder.
    """

    name: str
    text: str
    aircraft: tuple[str, ...]
    differences: tuple[str, ...]


def assumed_files(scenario: Scenario, fleet: FormationPlan) -> list[AssumedFile]:
    """Return the autopilot parameters and the gains of the middle loop, equal ones once."""
    with_models = [each for each in fleet.aircraft if each.has_model]
    found = [_parameters(scenario, group) for group in _groups(with_models)]
    followers = [each for each in fleet.followers if each.has_model]
    return [*found, *(_gains(scenario, group) for group in _groups(followers))]


@dataclass(frozen=True, slots=True)
class ComparedFile:
    """Parameters of real aircraft beside those of the flights.

    Attributes:
        file: as it was given.
        aircraft: names of the aircraft that are compared with it.
        differences: of their parameters from those of the file.
    """

    file: str
    aircraft: tuple[str, ...]
    differences: tuple[str, ...]


def compared_files(given: Sequence[str], fleet: FormationPlan) -> list[ComparedFile]:
    """Compare the parameters of the flights with those of real aircraft.

    Args:
        given: texts `FILE`, of all aircraft with a flight model, or `NAME=FILE`, of one of them.
        fleet: the aircraft of the flights.

    Raises:
        InputError: a file cannot be read, or there is no such aircraft.
    """
    found = []
    for text in given:
        path, aircraft = _split(text, [each for each in fleet.aircraft if each.has_model])
        values = {name: each.value for name, each in read_param_file(path).values.items()}
        by_difference: dict[str, list[str]] = {}
        for each in aircraft:
            for difference in _differences(each.params, values, path.name):
                by_difference.setdefault(difference, []).append(each.name)
        names = tuple(each.name for each in aircraft)
        differences = tuple(
            difference if len(of) == len(names) else f"{join_names(of)}: {difference}"
            for difference, of in by_difference.items()
        )
        found.append(ComparedFile(str(path), names, differences))
    return found


def _split(text: str, aircraft: list[PlannedAircraft]) -> tuple[Path, list[PlannedAircraft]]:
    if not aircraft:
        raise InputError(f"--param {text}: no aircraft here has a flight model (leave it out)")
    name, equals, file = text.partition("=")
    if not equals or Path(text).is_file():
        return Path(text), aircraft
    of_name = [each for each in aircraft if each.name == name]
    if not of_name:
        known = join_names([each.name for each in aircraft])
        raise InputError(f"--param {text}: there is no aircraft {name} (write {known})")
    return Path(file), of_name


def _differences(params: FbwaParams, values: dict[str, float], file: str) -> Iterator[str]:
    for field in fields(FbwaParams):
        name, flown = field.name.upper(), float(getattr(params, field.name))
        if name not in values:
            yield f"{name} {flown:g}: not in {file}"
        elif not math.isclose(flown, values[name], rel_tol=SINGLE, abs_tol=1e-12):
            yield f"{name} {flown:g}: {values[name]:g} in {file}"


def _groups(aircraft: Sequence[PlannedAircraft]) -> list[list[PlannedAircraft]]:
    groups: dict[object, list[PlannedAircraft]] = {}
    for each in aircraft:
        groups.setdefault((each.folder, each.tune_file), []).append(each)
    return list(groups.values())


def _parameters(scenario: Scenario, group: Sequence[PlannedAircraft]) -> AssumedFile:
    first = group[0]
    own = first.folder / OWN_TUNE
    given = read_param_file(first.tune_file).values
    of_aircraft = read_param_file(own).values if own.is_file() else {}
    names, lines, differing = tuple(each.name for each in group), list[str](), list[str]()
    source = f"{first.folder.name}/{first.tune_file.name}"
    for field in fields(FbwaParams):
        name, value = field.name.upper(), getattr(first.params, field.name)
        default = name not in given
        lines.append(f"{name} {value:g}" + ("  # default: not in the file" if default else ""))
        if default:
            differing.append(f"{name} {value:g}: ArduPlane's default, not in {source}")
        elif name not in of_aircraft:
            differing.append(f"{name} {value:g}: not in {own.name}")
        elif of_aircraft[name].value != given[name].value:
            differing.append(f"{name} {value:g}: {of_aircraft[name].value:g} in {own.name}")
    head = (
        f"# Parameters of fly-by-wire A and guidance that the flights of {scenario.name} assume\n"
        f"# for {join_names(names)}, from {source}\n"
    )
    return AssumedFile(
        f"{_file_name(group)}.param", head + "\n".join(lines) + "\n", names, tuple(differing)
    )


def _gains(scenario: Scenario, group: Sequence[PlannedAircraft]) -> AssumedFile:
    first = group[0]
    assert isinstance(first, PlannedFollower)
    profile = scenario.controller.profile
    own = load_middle_loop(first.folder, profile, file=scenario.controller.middle_loop)
    return AssumedFile(
        f"{_file_name(group)}-middle_loop.yaml",
        dump_middle_loop({profile: first.gains}),
        tuple(each.name for each in group),
        differences(own.model_dump(mode="json"), first.gains.model_dump(mode="json")),
    )


def _file_name(group: Sequence[PlannedAircraft]) -> str:
    first = group[0]
    tune = "" if first.tune_file.name == OWN_TUNE else f"-{first.tune_file.stem}"
    return f"{first.folder.name}{tune}"
