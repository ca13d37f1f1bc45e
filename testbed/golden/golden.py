"""Golden tables: find them, fly their scenarios, compare, and write them on request."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.core.errors import InputError
from testbed.golden.golden_compare import (
    RULES_ALONE,
    FlightProblem,
    GoldenFlight,
    Verdict,
    compare,
    flight_problems,
)
from testbed.golden.golden_table import (
    MIN_BAND_VALUES,
    GoldenTable,
    is_table,
    make_table,
    read_table,
    table_numbers,
    write_table,
)
from testbed.golden.golden_tolerance import Change, Tolerances
from testbed.plan.code_check import check_code
from testbed.pool.flight_pool import Progress, Report, group_numbers, open_flight_pool
from testbed.pool.flight_task import FlightTask
from testbed.pool.scenario_snapshot import read_inputs
from testbed.runs.bounds import BoundResult, bound_results
from testbed.scenario import (
    Scenario,
    find_scenario,
    library,
    load_scenario,
    place_of_key,
    set_seed,
)

CHECKED_SEEDS = 4  # of a table's seeds, flown by a check
RANDOM_SEEDS = 16  # in a table of a scenario whose numbers depend on the seed: enough for a band
NO_TOLERANCES: Mapping[str, Change] = {}
DETERMINISTIC_SEEDS = 2  # in a table of any other scenario: enough to detect random numbers


@dataclass(frozen=True, slots=True)
class GoldenCase:
    """A scenario and its table."""

    name: str  # as the user wrote it, or as a command would name it
    source: Path  # of the scenario
    scenario: Scenario
    path: Path  # of the table
    table: GoldenTable | None  # None: missing, or unreadable
    table_error: str = ""  # of an unreadable table
    overrides: tuple[str, ...] = ()  # settings of `--set`


@dataclass(frozen=True, slots=True)
class UpdateResult:
    """Result of updating a table.

    Args:
        case: with the table before the update.
        verdict: comparison of the flights with that table; None if there was none.
        problems: of flights, for which no table was written; empty if one was.
        bounds: comparisons with the bounds of the scenario.
        table: as written; None: it was not, because of problems or of violated bounds.
    """

    case: GoldenCase
    verdict: Verdict | None
    problems: tuple[FlightProblem, ...]
    bounds: tuple[BoundResult, ...]
    table: GoldenTable | None


def find_cases(
    names: Sequence[str], *, folder: Path | None, new: bool, overrides: Sequence[str] = ()
) -> list[GoldenCase]:
    """Find scenarios and their tables; without names, all that have a table.

    The table of `<folder>/<scenario>.yaml` is `<folder>/golden/<scenario>.json`.

    Args:
        names: names or paths, as for `testbed run`.
        folder: of the tables; default `golden` next to each scenario.
        new: whether tables may be missing or unreadable.
        overrides: settings of every scenario, as for `testbed run --set`.

    Raises:
        InputError: everything that cannot be read or is missing, one line each.
    """
    if folder and not os.path.isdir(folder) and not (new and names):
        raise InputError(f"--golden {folder}: there is no such folder")
    if not names:
        tables = folder or library() / "scenarios" / "golden"
        names = [_scenario_of(path) for path in sorted(tables.glob("*.json"))]
        if not names:
            raise InputError(
                f"{tables}: no golden tables (name a scenario; --update --reason TEXT writes one)"
            )
    cases, problems = [], []
    for name in dict.fromkeys(names):
        try:
            cases.append(_find_case(name, folder, new, tuple(overrides)))
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("\n".join(problems))
    return cases


def _scenario_of(table: Path) -> str:
    """Return the scenario of a table, in the library or the folder above."""
    neighbour = table.absolute().parent.parent / f"{table.stem}.yaml"
    in_library = library() / "scenarios" / neighbour.name
    if in_library.is_file() or not neighbour.is_file():
        return table.stem
    return str(_relative(neighbour))


def _relative(path: Path) -> Path:
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _find_case(name: str, folder: Path | None, new: bool, overrides: tuple[str, ...]) -> GoldenCase:
    source = find_scenario(name)
    path = _relative((folder or source.parent / "golden") / f"{source.stem}.json")
    scenario = load_scenario(source, overrides)
    try:
        check_code(scenario)
    except InputError as error:
        place = place_of_key(str(error), source, overrides)
        raise InputError(f"{place}: {error}" if place else str(error)) from None
    if not scenario.scenario.windows:
        raise InputError(
            f"{_relative(source)}:1:1: has no scenario.windows, so there is nothing to compare"
        )
    if not os.path.isfile(path) and not new:
        raise InputError(
            f"{_relative(source)}:1:1: there is no golden table {path} (testbed check {name} "
            "--update --reason TEXT writes it)"
        )
    if not os.path.isfile(path):
        return GoldenCase(name, source, scenario, path, None)
    try:
        return GoldenCase(name, source, scenario, path, read_table(path), overrides=overrides)
    except InputError as error:
        if not new:
            raise InputError(f"{error} (write a new one with --update --reason TEXT)") from None
        if not is_table(path):
            raise InputError(
                f"{path}: is no golden table, so --update does not replace it (move it, or name "
                "another folder with --golden)"
            ) from None
        return GoldenCase(name, source, scenario, path, None, table_error=str(error))


def check(
    cases: Sequence[GoldenCase],
    *,
    seeds: int | None,
    jobs: int,
    progress: Progress,
    report: Report = lambda line: None,
    tolerances: Mapping[str, Change] = NO_TOLERANCES,
) -> list[Verdict]:
    """Fly scenarios and compare each with its table; nothing is written.

    Args:
        cases: all with a table.
        seeds: flights of each: the table's seeds in order, then the numbers that follow. Default:
            `CHECKED_SEEDS` of the table's.
        jobs: processes at once.
        progress: called with the number of finished flights and of all.
        report: called with a line when kernels are compiled.
        tolerances: in place of those of the scenarios' `expect`; see `parse_tolerances`.
    """
    tables = [case.table for case in cases if case.table]
    chosen = [
        _choose_seeds(table.seeds, seeds or min(CHECKED_SEEDS, len(table.seeds)))
        for table in tables
    ]
    flights = _fly_seeds(cases, chosen, jobs, progress, report)
    return [
        _compare(case, table, own, Tolerances(tolerances, case.scenario.expect.model_dump()))
        for case, table, own in zip(cases, tables, flights, strict=True)
    ]


def _choose_seeds(available: Sequence[int], count: int) -> list[int]:
    following = range(available[-1] + 1, available[-1] + 1 + max(0, count - len(available)))
    return [*available[:count], *following]


def _compare(
    case: GoldenCase,
    table: GoldenTable,
    flights: Sequence[GoldenFlight],
    tolerances: Tolerances = RULES_ALONE,
) -> Verdict:
    documents = {flight.seed: flight.metrics for flight in flights if flight.metrics}
    return compare(
        case.name,
        table,
        flights,
        inputs=read_inputs(case.scenario, case.source.parent),
        bounds=bound_results(documents, case.source, case.overrides),
        overrides=case.overrides,
        tolerances=tolerances,
    )


def update_tables(
    cases: Sequence[GoldenCase],
    *,
    seeds: int | None,
    jobs: int,
    reason: str,
    ignore_bounds: bool = False,
    progress: Progress,
    report: Report = lambda line: None,
) -> list[UpdateResult]:
    """Fly scenarios and write their tables; no other function writes one.

    A scenario that gives the same numbers for two seeds needs no more; the others fly all seeds.
    No table is written if a flight has a problem, or if a number is outside the bounds of its
    scenario.

    Args:
        cases: with a table or without.
        seeds: number of seeds where they change the numbers; default `RANDOM_SEEDS`.
        jobs: processes at once.
        reason: why the numbers are accepted; stored in the tables.
        ignore_bounds: write tables of numbers outside the bounds, too.
        progress: called with the number of finished flights and of all.
        report: called with a line when kernels are compiled.

    Raises:
        InputError: too few seeds, or a table cannot be written.
    """
    count = seeds or RANDOM_SEEDS
    if count < MIN_BAND_VALUES:
        raise InputError(f"--seeds {count}: a table needs {MIN_BAND_VALUES} or more")
    seeds_from = [case.scenario.scenario.seed for case in cases]
    first = [range(seed, seed + DETERMINISTIC_SEEDS) for seed in seeds_from]
    flights = _fly_seeds(cases, first, jobs, progress, report)
    random = [_depends_on_seed(own) for own in flights]
    rest = [
        range(seed + DETERMINISTIC_SEEDS, seed + (count if is_random else DETERMINISTIC_SEEDS))
        for seed, is_random in zip(seeds_from, random, strict=True)
    ]
    others = _fly_seeds(cases, rest, jobs, progress, report)
    for own, more in zip(flights, others, strict=True):
        own += more
    return [
        _update_table(case, own, is_random, reason, ignore_bounds=ignore_bounds)
        for case, own, is_random in zip(cases, flights, random, strict=True)
    ]


def _fly_seeds(
    cases: Sequence[GoldenCase],
    seeds: Sequence[Sequence[int]],
    jobs: int,
    progress: Progress,
    report: Report,
) -> list[list[GoldenFlight]]:
    """Fly each case with its own seeds, all at the same time."""
    wanted = [(case.scenario, s) for case, own in zip(cases, seeds, strict=True) for s in own]
    results = iter(fly_all(wanted, jobs=jobs, progress=progress, report=report))
    return [[next(results) for _ in own] for own in seeds]


def _depends_on_seed(flights: Sequence[GoldenFlight]) -> bool:
    """Return whether the seed changes any number, to the last bit, in valid flights."""
    valid = [
        table_numbers(each.metrics)
        for each in flights
        if each.metrics and not flight_problems(each)
    ]
    return any(numbers != valid[0] for numbers in valid[1:])


def _update_table(
    case: GoldenCase,
    flights: Sequence[GoldenFlight],
    random: bool,
    reason: str,
    *,
    ignore_bounds: bool,
) -> UpdateResult:
    verdict = _compare(case, case.table, flights) if case.table else None
    problems = tuple(problem for flight in flights for problem in flight_problems(flight))
    documents = {flight.seed: flight.metrics for flight in flights if flight.metrics}
    bounds = verdict.bounds if verdict else bound_results(documents, case.source, case.overrides)
    outside = any(bound.violations for bound in bounds)
    if problems or (outside and not ignore_bounds):
        return UpdateResult(case, verdict, problems, bounds, None)
    table = make_table(
        documents,
        scenario=case.scenario.name,
        reason=reason,
        random=random,
        inputs=read_inputs(case.scenario, case.source.parent),
    )
    write_table(case.path, table)
    return UpdateResult(case, verdict, (), bounds, table)


def fly_all(
    wanted: Sequence[tuple[Scenario, int]],
    *,
    jobs: int,
    progress: Progress = lambda done, total: None,
    report: Report = lambda line: None,
) -> list[GoldenFlight]:
    """Fly scenarios with seeds, without files, and return the flights in this order.

    Args:
        wanted: scenarios and seeds.
        jobs: processes at once; the results do not depend on it.
        progress: called with the number of finished flights and of all.
        report: called with a line when kernels are compiled.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM was received; all worker processes have ended.
    """
    if not wanted:
        return []
    progress(0, len(wanted))

    def tasks(numbers: Iterable[int]) -> Iterator[FlightTask]:
        return (FlightTask(number, set_seed(*wanted[number])) for number in numbers)

    groups = group_numbers(id(scenario) for scenario, _ in wanted)
    flights: dict[int, GoldenFlight] = {}
    with open_flight_pool(jobs=min(jobs, len(wanted)), report=report) as pool:
        for result in pool.run_groups(map(tasks, groups)):
            problem = result.error if result.metrics is None else ""
            seed = wanted[result.number][1]
            flights[result.number] = GoldenFlight(seed, result.metrics, problem, result.wall_s)
            progress(len(flights), len(wanted))
    return [flights[number] for number in range(len(wanted))]
