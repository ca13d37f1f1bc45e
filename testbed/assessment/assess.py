"""Assess a scenario before a flight: its rows, kept in a folder, and the document of the page."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from testbed.assessment.assessed import Assessed
from testbed.assessment.assumed_parameters import ComparedFile, assumed_files, compared_files
from testbed.assessment.conditions import CONDITIONS
from testbed.assessment.measures import (
    FAULTS,
    OUTAGES,
    measure_condition,
    measure_faults,
    measure_margins,
    measure_nominal,
)
from testbed.assessment.verdict import (
    MIN_FACTOR,
    MIN_PHASE_DEG,
    decide,
    energy,
    shortcomings,
)
from testbed.core.compile import source_digest
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.metrics.document import to_json
from testbed.plan.measured_fleet import resolve
from testbed.plan.scenario_files import digests, referenced_files, referents
from testbed.pool.flight_code import describe_code, flight_code
from testbed.pool.flight_pool import FlightPool, open_flight_pool
from testbed.pool.flight_task import COMPLETED, FlightTask
from testbed.pool.scenario_snapshot import snapshot
from testbed.runs.bounds import unchecked_bounds
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ArduPlane, External

SCHEMA = 1
ROWS = ("nominal", "margins", *CONDITIONS, *FAULTS, *OUTAGES)
# those that take longest first, so that the processes end at about the same time
_LONGEST = ("turbulence", "gps", "wind", "loss", "airspeed", "delay", "margins")
ROW_FOLDER, PARAMETER_FOLDER, DOCUMENT = "rows", "parameters", "assessment.json"
SLOWEST_CLIMB_MPS = 0.3  # for which margins are predicted
NOT_SAID = (
    "How well the flight models are those of your aircraft: compare with its log, "
    "`testbed respond`.",
    "Take-off, landing, joining from elsewhere, terrain, obstacles, other traffic.",
    "Failsafes: the autopilot here does not detect a fault, return, land or hold its best glide.",
    "The real radio: antennas, interference, other programs on the companion computer.",
    "Ice, rain, structure, servo wear, temperatures of motor and battery.",
    "Conditions together: each row changes one, all else is as in the scenario. Faults begin at "
    "half of the flight only.",
)
Row = dict[str, Any]
Report = Callable[[str], None]


def check_assessable(scenario: Scenario) -> None:
    """Check that a scenario can be flown many times in worker processes.

    Raises:
        InputError: a program outside takes part; with the key and what to write.
    """
    for k, each in enumerate(scenario.aircraft):
        at = "leader" if k == 0 else f"fleet.{k - 1}"
        if isinstance(each.autopilot, ArduPlane):
            raise InputError(f"{at}.autopilot: assess flies no ArduPlane process (write virtual)")
        if isinstance(each.commanded_by, External):
            raise InputError(f"{at}.commanded_by: assess has no program outside (write formation)")


def assess(
    assessed: Assessed,
    folder: Path,
    *,
    jobs: int | None = None,
    only: Sequence[str] = (),
    report: Report = lambda line: None,
) -> dict[str, Any]:
    """Find the rows of an assessment that the folder does not have, and return the document.

    Args:
        assessed: the scenario.
        folder: of the rows, which are written as they are found; others there are found anew if
            they depend on something that has changed.
        jobs: processes; None: one for each processor.
        only: rows to be found; empty: all.
        report: called with a line for each row.

    Raises:
        InputError: the scenario cannot be flown, or a file not be written.
        KeyboardInterrupt: Ctrl-C or SIGTERM; the rows so far are in the folder.
    """
    scenario = assessed.scenario()
    check_assessable(scenario)
    compared = compared_files(assessed.params, resolve(scenario))
    assessed.criteria()
    whole = assessed.file.resolve(assessed.overrides)
    for line in unchecked_bounds(whole, scenario.scenario.duration_s):
        report(f"warning: {line}")
    digest = inputs_digest(assessed, scenario)
    store = _StoredRows(folder, digest)
    wanted = [name for name in ROWS if not only or name in only]
    rows = {name: row for name in ROWS if (row := store.read(name)) is not None}
    for name in rows:
        report(f"{name}: kept")
    missing = [name for name in wanted if name not in rows]
    if "nominal" not in rows and missing:  # others need it
        missing = list(dict.fromkeys(["nominal", *missing]))
    if missing:
        with open_flight_pool(jobs=jobs, report=report) as pool:
            for name, row in _measure(assessed, scenario, missing, rows, pool):
                rows[name] = row
                store.write(name, row)
                report(f"{name}: {brief(name, row)}")
    found = {name: rows[name] for name in ROWS if name in rows}
    return document(assessed, scenario, found, compared)


def _measure(
    assessed: Assessed,
    scenario: Scenario,
    missing: Sequence[str],
    known: Mapping[str, Row],
    pool: FlightPool,
) -> Iterator[tuple[str, Row]]:
    """Yield the rows as they are found: nominal, faults and outages, then what needs the first."""
    nominal = known.get("nominal")
    first = [name for name in missing if name in ("nominal", *FAULTS, *OUTAGES)]
    tasks = {
        name: measure_nominal if name == "nominal" else partial(measure_faults, name)
        for name in first
    }
    for name, row in _run(pool, assessed, scenario, tasks):
        if name == "nominal":
            nominal = row
        yield name, row
    second = [name for name in _LONGEST if name in missing]
    if not second:
        return
    assert nominal is not None
    why = nominal.get("problem") or _nominal_fails(nominal)
    if why:
        yield from ((name, _skipped(why, assessed, name)) for name in second if name in CONDITIONS)
        second = [name for name in second if name not in CONDITIONS]
    if nominal.get("problem"):
        return
    steady = list(_steady_flights(nominal)) if "margins" in second else []
    parts: dict[str, Any] = {
        f"margins {k}": partial(measure_margins, *flight) for k, flight in enumerate(steady)
    }
    parts = {
        **{name: partial(measure_condition, name) for name in second if name in CONDITIONS},
        **parts,
    }
    cases: dict[int, Row] = {}
    for name, row in _run(pool, assessed, scenario, parts):
        if name in CONDITIONS:
            yield name, row
            continue
        number = int(name.removeprefix("margins "))
        bank, climb = steady[number]
        cases[number] = {"bank_deg": bank, "climb_mps": climb, **row}
        if len(cases) == len(steady):
            cpu_s = sum(each.get("cpu_s", 0.0) for each in cases.values())
            found = {"cases": [cases[each] for each in sorted(cases)], "cpu_s": cpu_s}
            yield "margins", {**found, "command": assessed.command("margins")}


def _run(
    pool: FlightPool, assessed: Assessed, scenario: Scenario, tasks: Mapping[str, Any]
) -> Iterator[tuple[str, Row]]:
    names = list(tasks)
    flights = (
        FlightTask(number, scenario, measure=partial(tasks[name], assessed))
        for number, name in enumerate(names)
    )
    for result in pool.run(flights):
        name = names[result.number]
        if result.outcome == COMPLETED and result.metrics is not None:
            yield name, dict(result.metrics)
        else:
            problem = result.error.removeprefix("invalid: ")
            yield name, {"problem": problem, "command": assessed.command(name.partition(" ")[0])}


def _nominal_fails(nominal: Row) -> str:
    if nominal["kept"] == nominal["flights"]:
        return ""
    return "the criteria are not kept at nominal conditions"


def _skipped(why: str, assessed: Assessed, name: str) -> Row:
    return {
        "value": None,
        "skipped": why,
        "breaks": None,
        "weakest": None,
        "flown_with": "",
        "flights": 0,
        "seeds": 0,
        "command": assessed.command(name),
        "cpu_s": 0.0,
    }


def _steady_flights(nominal: Row) -> Iterator[tuple[float, float]]:
    """Yield bank, degrees, and climb, m/s: straight, the steepest turn, climb and descent."""
    yield 0.0, 0.0
    if (bank := nominal["bank_deg"] or 0.0) >= 1.0:
        yield float(round(bank)), 0.0
    if nominal["climb_mps"] >= SLOWEST_CLIMB_MPS:
        yield 0.0, round(nominal["climb_mps"], 1)
    if nominal["sink_mps"] >= SLOWEST_CLIMB_MPS:
        yield 0.0, -round(nominal["sink_mps"], 1)


def brief(name: str, row: Row) -> str:
    """Describe a row in a few words."""
    seconds = f"{row.get('cpu_s', 0.0):.0f} s of a processor"
    if row.get("problem"):
        return str(row["problem"])
    if name == "nominal":
        return f"{row['kept']} of {row['flights']} flights keep the criteria, {seconds}"
    if name in CONDITIONS:
        unit = CONDITIONS[name].unit
        value = "no value" if row["value"] is None else f"{row['value']:g} {unit}"
        return f"{value}, {row['flights']} flights, {seconds}"
    if name == "margins":
        return f"{len(row['cases'])} steady flights, {seconds}"
    return f"{len(row['flights'])} flights, {seconds}"


def inputs_digest(assessed: Assessed, scenario: Scenario) -> str:
    """Return a digest of all that decides the rows: scenario, files, code, number of flights."""
    package = Path(__file__).parents[1]
    inputs = {
        "scenario": snapshot(scenario, assessed.file.path.parent),
        "seed": scenario.scenario.seed,
        "expect": scenario.expect.model_dump(mode="json"),
        "files": digests(referenced_files(referents(scenario))),
        "command": [assessed.name, *assessed.overrides, str(assessed.duration_s)],
        "flights": assessed.flights,
        "code": [flight_code(predictions=True), source_digest(package, ("assessment",))],
    }
    return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()[:16]


class _StoredRows:
    """The rows in a folder, with what they depend on."""

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder, self._digest = folder / ROW_FOLDER, digest

    def read(self, name: str) -> Row | None:
        """Return a row; None: there is none, or it depends on something that has changed."""
        try:
            found = parse_json_map(read_bounded(self._folder / f"{name}.json"))
        except (InputError, ValueError):
            return None
        row = found.get("row")
        same = found.get("depends_on") == self._digest
        return row if same and isinstance(row, dict) else None

    def write(self, name: str, row: Row) -> None:
        """Write a row; a file is replaced whole or not at all."""
        path = self._folder / f"{name}.json"
        with report_write_errors(path):
            self._folder.mkdir(parents=True, exist_ok=True)
            with write_text_file(path) as file:
                file.write(to_json({"depends_on": self._digest, "row": row}))


def document(
    assessed: Assessed,
    scenario: Scenario,
    rows: Mapping[str, Row],
    compared: Sequence[ComparedFile] = (),
) -> dict[str, Any]:
    """Return the document of the page: rows, and what follows from them."""
    files = [asdict(each) for each in compared]
    nominal = rows.get("nominal", {})
    whole_s = assessed.file.resolve(assessed.overrides).scenario.duration_s
    charges = energy(nominal, nominal["flown_s"], whole_s) if "charge" in nominal else []
    short = shortcomings(rows, charges, files)
    seeds = assessed.seeds
    return {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "question": scenario.scenario.question,
        "verdict": decide(rows, short),
        "short": short,
        "criteria": describe_criteria(assessed, scenario),
        "flown": _describe_flight(assessed, scenario),
        "flights": assessed.flights,
        "first_seed": seeds[0],
        "duration_s": scenario.scenario.duration_s,
        "least_margins": {"factor": MIN_FACTOR, "phase_deg": MIN_PHASE_DEG, "damping": 0.0},
        "rows": dict(rows),
        "energy": charges,
        "parameters": [
            {
                "file": f"{PARAMETER_FOLDER}/{each.name}",
                "text": each.text,
                "aircraft": list(each.aircraft),
                "differences": list(each.differences),
            }
            for each in assumed_files(scenario, resolve(scenario))
        ],
        "compared": files,
        "not_said": list(NOT_SAID),
        "command": assessed.command(),
        "code": describe_code(),
        "cpu_s": sum(row.get("cpu_s", 0.0) for row in rows.values()),
    }


def describe_criteria(assessed: Assessed, scenario: Scenario) -> list[str]:
    """Return the criteria in words."""
    completed = (
        "completed: no aircraft lost, none in stall or overspeed, none out of formation, none "
        "closer to another than a wingspan or limits.min_separation_m"
    )
    settings = assessed.criteria()
    if not settings:
        bounds = _bounds(scenario.expect.model_dump(), "expect")
        return [completed, *(f"{key}: {value:g}" for key, value in bounds)]
    texts = {
        "expect.rms_m.max": "error of each follower in each window at most {} m RMS",
        "expect.min_separation_m.min": "separation at least {} m, a wingspan, at each sample",
        "expect.left_speed_set.max": "no speed that leaves its bounds (formation.speed_mps)",
    }
    found = [completed]
    for setting in settings:
        key, _, value = setting.partition("=")
        if key in texts:
            found.append(texts[key].format(value))
    return found


def _bounds(value: Mapping[str, Any], at: str) -> Iterator[tuple[str, float]]:
    for key, each in value.items():
        if isinstance(each, Mapping):
            yield from _bounds(each, f"{at}.{key}")
        elif key in ("min", "max"):
            yield f"{at}.{key}", each


def _describe_flight(assessed: Assessed, scenario: Scenario) -> list[str]:
    aircraft = dict.fromkeys(Path(str(each.aircraft)).name for each in scenario.aircraft)
    wind, turbulence = scenario.air.wind, scenario.air.turbulence
    blows = f"{wind.speed_mps:g} m/s from {wind.from_deg:g}°" if wind.speed_mps else "no wind"
    exact = [each.name for each in scenario.aircraft if each.sensors.exact]
    sensors = "exact sensors" if len(exact) == len(scenario.aircraft) else "sensors with errors"
    return [
        f"{len(scenario.aircraft)} aircraft: {', '.join(aircraft)}",
        f"{scenario.scenario.duration_s:g} s",
        "recorded wind" if wind.file else blows,
        "no turbulence" if turbulence.model == "none" else f"turbulence {turbulence.model}",
        sensors,
        f"profile {scenario.controller.profile}",
        *(f"--set {each}" for each in assessed.overrides),
    ]


def write_parameters(found: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the parameters and gains of a document to files below a folder."""
    paths = []
    for each in found["parameters"]:
        path = folder / each["file"]
        with report_write_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with write_text_file(path) as file:
                file.write(each["text"])
        paths.append(path)
    return paths


def row_names(names: Iterable[str]) -> list[str]:
    """Check names of rows.

    Raises:
        InputError: one is none.
    """
    found = list(names)
    for name in found:
        if name not in ROWS:
            raise InputError(f"--only {name}: write one of {', '.join(ROWS)}")
    return found
