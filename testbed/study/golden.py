"""Golden tables: find them, fly what they hold, compare, and write them when that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.errors import InputError
from testbed.scenario import Scenario, find_scenario, library, load
from testbed.study.flights import Flight, fly_all
from testbed.study.golden_band import FEWEST
from testbed.study.golden_compare import Fault, Verdict, compare, faults_of
from testbed.study.golden_page import digests, page_kept
from testbed.study.golden_table import Table, make_table, measure, read_table, write_table

CHECKED_SEEDS = 4  # flown by a check, of those the table has
KEPT_SEEDS = 16  # in a table with dice: enough for a band
EXACT_SEEDS = 2  # in a table without dice: enough to see that there are none

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Case:
    """A scenario, and where its table is or will be."""

    name: str  # as it was given, or as a command would name it
    source: Path  # of the page
    page: Scenario
    path: Path  # of the table
    table: Table | None  # None: there is none yet, or none that can be read
    unread: str = ""  # what is wrong with a table that cannot be read


@dataclass(frozen=True, slots=True)
class Renewal:
    """What came of renewing a table.

    Args:
        case: with the table as it was.
        verdict: the flights beside the old table; None if there was none.
        faults: why nothing was written; empty if the table was.
        table: as written.
    """

    case: Case
    verdict: Verdict | None
    faults: tuple[Fault, ...]
    table: Table | None


def find_cases(names: Sequence[str], *, folder: Path | None, new: bool) -> list[Case]:
    """The scenarios of these names or paths with their tables; of no names, all with a table.

    The table of `<folder>/<page>.yaml` is `<folder>/golden/<page>.json`.

    Args:
        names: as for `testbed run`.
        folder: where the tables are, in place of `golden` beside each page.
        new: whether a table may be missing, or be there and not be readable.

    Raises:
        InputError: everything that cannot be read or is missing, one line each.
    """
    if folder and not folder.is_dir() and not (new and names):
        raise InputError(f"--golden {folder}: there is no such folder")
    if not names:
        home = folder or library() / "scenarios" / "golden"
        names = [_page_of(path) for path in sorted(home.glob("*.json"))]
        if not names:
            raise InputError(
                f"{home}: no golden tables (name a scenario; --update --reason TEXT writes one)"
            )
    cases, problems = [], []
    for name in dict.fromkeys(names):
        try:
            cases.append(_case(name, folder, new))
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("\n".join(problems))
    return cases


def _page_of(table: Path) -> str:
    """The name of the page that a table belongs to: above its folder, or in the library."""
    beside = table.absolute().parent.parent / f"{table.stem}.yaml"
    kept = library() / "scenarios" / beside.name
    if kept.is_file() or not beside.is_file():
        return table.stem
    return str(_shown(beside))


def _shown(path: Path) -> Path:
    """The path as short as a reader here can use it."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _case(name: str, folder: Path | None, new: bool) -> Case:
    source = find_scenario(name)
    path = _shown((folder or source.parent / "golden") / f"{source.stem}.json")
    page = load(source)
    if not page.scenario.portions:
        raise InputError(f"{name}: has no scenario.portions, so there is nothing to compare")
    if not path.is_file() and not new:
        raise InputError(
            f"{name}: there is no golden table {path} (testbed check {name} --update --reason "
            "TEXT writes it)"
        )
    if not path.is_file():
        return Case(name, source, page, path, None)
    try:
        return Case(name, source, page, path, read_table(path))
    except InputError as error:
        if not new:
            again = "write it anew with --update --reason TEXT"
            raise InputError(f"{error} ({again})") from None
        return Case(name, source, page, path, None, unread=str(error))


def check(
    cases: Sequence[Case], *, seeds: int | None, jobs: int, progress: Progress
) -> list[Verdict]:
    """Fly the cases and hold each to its table; nothing is written.

    Args:
        cases: all with a table.
        seeds: flights of each: the table's seeds in order, then the numbers that follow. Default:
            `CHECKED_SEEDS` of the table's.
        jobs: processes at once.
        progress: told how many flights are done, of how many.
    """
    tables = [case.table for case in cases if case.table]
    plans = [_seeds(table.seeds, seeds or min(CHECKED_SEEDS, len(table.seeds))) for table in tables]
    wanted = [(case.page, s) for case, plan in zip(cases, plans, strict=True) for s in plan]
    flown = iter(fly_all(wanted, jobs=jobs, progress=progress))
    flights = [[next(flown) for _ in plan] for plan in plans]
    return [
        _verdict(case, table, own) for case, table, own in zip(cases, tables, flights, strict=True)
    ]


def _seeds(kept: Sequence[int], count: int) -> list[int]:
    following = range(kept[-1] + 1, kept[-1] + 1 + max(0, count - len(kept)))
    return [*kept[:count], *following]


def _verdict(case: Case, table: Table, flights: Sequence[Flight]) -> Verdict:
    return compare(
        case.name,
        table,
        flights,
        page=page_kept(case.page, case.source.parent),
        files=digests(case.page),
    )


def renew(
    cases: Sequence[Case], *, seeds: int | None, jobs: int, reason: str, progress: Progress
) -> list[Renewal]:
    """Fly the cases and write their tables anew: the only way that one is written.

    Two seeds that give the same numbers are a scenario without dice; the others fly more. The table
    of a flight that was lost, or whose formation never engaged, is not written.

    Args:
        cases: with a table or without.
        seeds: how many a table with dice has; default `KEPT_SEEDS`.
        jobs: processes at once.
        reason: kept in the tables: why the numbers are what they should be.
        progress: told how many flights are done, of how many.

    Raises:
        InputError: too few seeds, or a table cannot be written.
    """
    count = seeds or KEPT_SEEDS
    if count < FEWEST:
        raise InputError(f"--seeds {count}: a table needs {FEWEST} at least")
    first = [case.page.scenario.seed for case in cases]
    wanted = [(c.page, s + k) for c, s in zip(cases, first, strict=True) for k in range(2)]
    flown = iter(fly_all(wanted, jobs=jobs, progress=progress))
    flights = [[next(flown) for _ in range(EXACT_SEEDS)] for _ in cases]
    dice = [_random(own) for own in flights]
    wanted = [
        (case.page, seed + k)
        for case, seed, random in zip(cases, first, dice, strict=True)
        for k in range(EXACT_SEEDS, count if random else EXACT_SEEDS)
    ]
    flown = iter(fly_all(wanted, jobs=jobs, progress=progress))
    for own, random in zip(flights, dice, strict=True):
        own += [next(flown) for _ in range(count - EXACT_SEEDS)] if random else []
    return [
        _renewed(case, own, random, reason)
        for case, own, random in zip(cases, flights, dice, strict=True)
    ]


def _random(flights: Sequence[Flight]) -> bool:
    """Whether the seed moves any number, to the last bit; unsound flights tell nothing."""
    sound = [measure(each.metrics) for each in flights if each.metrics and not faults_of(each)]
    return any(numbers != sound[0] for numbers in sound[1:])


def _renewed(case: Case, flights: Sequence[Flight], random: bool, reason: str) -> Renewal:
    verdict = _verdict(case, case.table, flights) if case.table else None
    faults = tuple(fault for flight in flights for fault in faults_of(flight))
    if faults:
        return Renewal(case, verdict, faults, None)
    table = make_table(
        {flight.seed: flight.metrics for flight in flights if flight.metrics},
        scenario=case.page.name,
        reason=reason,
        random=random,
        files=digests(case.page),
        page=page_kept(case.page, case.source.parent),
    )
    write_table(case.path, table)
    return Renewal(case, verdict, (), table)
