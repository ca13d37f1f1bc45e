"""The commands that read scenarios without running them: validate, list, schema."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table

from testbed.cli.options import (
    JsonFile,
    Overrides,
    ScenarioName,
    error_places,
    load_scenario,
)
from testbed.cli.output import result_console, write_json_output
from testbed.core.errors import InputError, escape_controls
from testbed.core.files import format_bytes

if TYPE_CHECKING:
    from testbed.flight.world import World
    from testbed.scenario import Scenario

MAX_LINE = 38  # characters, which leave the table of `testbed list` within 80 columns

GROUPS: Final[Mapping[str, Mapping[str, str]]] = {
    "start here": {
        "simulation-3": "the paper's formation of three",
        "simulation-3-pixhawk": "the same with hobby sensors and an EKF",
        "packet-loss-30": "the same with 30 % of messages lost",
        "engine-out-uav2": "an aircraft loses its engine",
    },
    "the paper": {
        "simulation-1": "leader's position for uav1 only",
        "simulation-2": "position of the aircraft ahead only",
        "experiment-1": "two Skywalker X8s at 10 Hz, in wind",
        "experiment-2": "three X8s, above and below the leader",
        "experiment-3": "the same with the horizontal law",
        "ideal-figure-eight": "the law on its own unicycle model",
    },
    "variants of simulation-3": {
        "simulation-3-improved": "improved middle loop and estimates",
        "simulation-3-30deg": "corners at 30 degrees of bank",
        "simulation-3-hard": "a path beyond the aircraft's limits",
        "simulation-3-noise": "noise of a GPS/INS estimate",
        "simulation-3-recorded-leader": "behind a recorded flight",
        "simulation-3-ardupilot": "ArduPlane flies every aircraft",
    },
    "network": {
        "simulation-3-latency": "messages 0.1 s old, clocks agree",
        "latency-500ms": "messages 0.5 s old",
        "bursty-wifi": "bursts of loss on a crowded WiFi",
        "loss-and-latency": "loss and latency together",
        "telemetry-radio": "one shared radio with MAVLink frames",
        "partition-and-heal": "formation divided, then whole again",
        "leader-silent": "no messages from the leader",
        "late-radio-loss": "half of the messages lost from 300 s on",
    },
    "wind": {
        "wind-8ms": "steady wind of 8 m/s",
        "turbulence-moderate": "moderate turbulence, one field for all",
        "gust-front": "a gust front crosses the formation",
        "close-formation-wake": "followers in the leader's wake",
    },
    "sensors and faults": {
        "gps-degraded": "degraded GPS reception",
        "airspeed-blocked": "a blocked pitot tube",
    },
    "your own law": {
        "own-law-leader-follower": "a textbook leader-follower law",
        "own-law-integral": "integral action around the paper's law",
        "own-law-repulsion": "repulsion between two aircraft",
        "own-functions": "a control function and a barrier",
        "ideal-own-speed-model": "ideal vehicles with drag and a propeller",
    },
    "other fleets": {
        "hold-slot": "one follower, for training policies",
        "mixed-fleet": "different aircraft in one formation",
        "vee-30": "a vee of thirty",
        "vee-100": "a vee of a hundred",
    },
}
OTHERS: Final = "others"  # the group of scenarios that are in no other

STUDIES: Final[Mapping[str, str]] = {
    "radio-and-wind": "loss and wind together",
    "what-matters-most": "delay, loss, wind and gusts compared",
    "convergence": "rates of the flight models",
    "convergence-seeds": "the same, in turbulence and saturation",
    "convergence-others": "rates of autopilots, control, samples",
    "leader-acceleration": "the leader's acceleration, estimated",
    "leader-turn-acceleration": "differences of the turn rates",
    "table-1": "the set-up that gives Table 1",
    "table-1-ages": "old messages and own states",
    "table-1-causes": "single causes of such errors",
    "table-1-laps": "leader's acceleration left out",
    "table-1-authors": "the authors' gains with old states",
    "joint-fit": "sets of numbers that give Table 2",
    "as-flown": "the experiments, one set of parameters",
    "turn-direction": "the leader turns the other way",
    "gap-budget-0": "the aircraft alone, without troubles",
    "gap-budget-1": "reasons for the errors of experiment 1",
    "gap-budget-2": "reasons for the errors of experiment 2",
    "gap-budget-3": "reasons for the errors of experiment 3",
}
TUNES: Final[Mapping[str, str]] = {"x8-middle-loop": "gains of the X8's middle loop"}


AIRCRAFT_WIDTH, TIME_WIDTH = 3, 7  # columns of `testbed list`


def validate_command(
    scenario: ScenarioName,
    overrides: Overrides = None,
    resolved: Annotated[
        bool, typer.Option("--resolved", help="Print the scenario with every default written out.")
    ] = False,
    stages: Annotated[
        bool, typer.Option("--stages", help="Print what a flight does at each tick, in order.")
    ] = False,
) -> None:
    """Check a scenario without running it: its keys, aircraft, formation and control law.

    Warns about each assumption of the paper that the scenario does not meet. Tests a control law of
    your own with a few calls. Names the code and the programs that a run would start.
    """
    from testbed.plan.world import build
    from testbed.scenario import dump

    loaded = load_scenario(scenario, overrides)
    with error_places(scenario, overrides):
        world = build(loaded)
    for event in world.initial_events:
        typer.echo(escape_controls(f"{event.level}: {event.source}: {event.text}"), err=True)
    for line in (*_programs(loaded), *_engines(world)):
        typer.echo(escape_controls(line), err=True)
    if stages:
        _print_stages(world)
    elif resolved:
        typer.echo(dump(loaded))
    else:
        typer.echo(f"{scenario}: valid")


def _engines(world: World) -> Iterator[str]:
    """Describe what steps the flight models."""
    if world.fleet is not None:
        yield f"engine: {world.fleet.describe_engine()}"


def _print_stages(world: World) -> None:
    """Print the stages of a flight as a table."""
    from testbed.runs.run import list_stages

    rows = [("part", "when", "stage", "runs"), *list_stages(world)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        typer.echo("  ".join(cells).rstrip())


def _programs(scenario: Scenario) -> Iterator[str]:
    """Describe the programs that a run starts; laws are among the events."""
    from testbed.autopilot.sitl_process import VARIABLE
    from testbed.scenario.aircraft import ArduPlane

    for aircraft in scenario.aircraft:
        if isinstance(aircraft.autopilot, ArduPlane) and aircraft.autopilot.start:
            yield (
                f"info: {aircraft.name}: a run starts the program of --arduplane or {VARIABLE} "
                f"({os.environ.get(VARIABLE) or 'not set'})"
            )


def list_command(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="A scenario, study or tuning file: print its question, expectation and file.",
            show_default=False,
        ),
    ] = None,
    runs: Annotated[
        bool,
        typer.Option("--runs", help="List the runs in logs/, or in the folder NAME, with sizes."),
    ] = False,
    json: JsonFile = None,
) -> None:
    """List the scenarios, studies, tuning files and aircraft that can be used by name, or the runs.

    Scenarios are grouped by purpose, with the number of their aircraft and the simulated time.
    """
    from testbed.scenario import list_aircraft

    if runs:
        _list_runs(Path(name or "logs"), json)
        return
    if name is not None:
        if json:
            raise InputError(f"--json: lists all names; leave out {name}, or write --runs")
        _describe(name)
        return
    write_json_output(json, _names_document() if json else {})
    console = result_console(json)
    console.write_line("scenario, number of aircraft, simulated time, what it shows", "dim")
    console.print()
    for title, table in (*_scenario_groups(), *_study_groups()):
        console.write_line(title, "bold")
        console.print(table)
        console.print()
    console.write_line("aircraft", "bold")
    for each in list_aircraft():
        console.write_line(each)
    console.print()
    console.write_line(
        "testbed list NAME prints its question; testbed run NAME flies a scenario.",
        "dim",
    )


def _list_runs(folder: Path, json: Path | None) -> None:
    """List the runs in a folder.

    Raises:
        InputError: there is no such folder, or the file of --json cannot be written.
    """
    from testbed.cli.runs import print_runs, runs_document
    from testbed.logs.run_list import list_runs

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; run this where the runs are")
    runs = list_runs(folder)
    write_json_output(json, {"runs": runs_document(runs)})
    console = result_console(json)
    print_runs(runs, console)
    total = format_bytes(sum(each.size for each in runs))
    count = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
    console.write_line(f"{count}, {total}; testbed prune deletes old ones", "dim")


def _names_document() -> dict[str, Any]:
    """Return all names with their main properties, for --json."""
    from testbed.scenario import (
        list_aircraft,
        list_scenarios,
        list_studies,
        list_tunings,
        load_scenario,
    )
    from testbed.studies.plan import Plan, load_study

    scenarios = {name: load_scenario(name) for name in list_scenarios()}
    studies = {name: load_study(name) for name in list_studies()}
    return {
        "scenarios": [
            {
                "name": name,
                "aircraft": len(each.aircraft_names),
                "duration_s": each.scenario.duration_s,
                "question": each.scenario.question,
            }
            for name, each in scenarios.items()
        ],
        "studies": [
            {"name": name, "runs": len(Plan(each)), "question": each.config.study.question}
            for name, each in studies.items()
        ],
        "tunes": [{"name": name} for name in list_tunings()],
        "aircraft": [{"name": name} for name in list_aircraft()],
    }


def _scenario_groups() -> Iterator[tuple[str, Table]]:
    from testbed.scenario import list_scenarios, load_scenario

    names = list_scenarios()
    grouped = {each for group in GROUPS.values() for each in group}
    others = {each: "" for each in names if each not in grouped}
    width = max(map(len, names), default=0)
    for title, group in {**GROUPS, OTHERS: others}.items():
        table = _plain_table(width, (AIRCRAFT_WIDTH, TIME_WIDTH))
        for name, line in group.items():
            if name in names:
                loaded = load_scenario(name)
                duration = f"{loaded.scenario.duration_s:,.0f} s"
                line = line or loaded.scenario.question
                table.add_row(name, str(len(loaded.aircraft_names)), duration, line)
        if table.row_count:
            yield title, table


def _study_groups() -> Iterator[tuple[str, Table]]:
    from testbed.scenario import list_scenarios, list_studies, list_tunings
    from testbed.studies.plan import Plan, load_study
    from testbed.studies.tune_schema import load_tune

    width = max(map(len, list_scenarios()), default=0)
    table = _plain_table(width, (AIRCRAFT_WIDTH + TIME_WIDTH + 1,))
    for name in sorted(list_studies(), key=lambda each: (each not in STUDIES, each)):
        study = load_study(name)
        line = STUDIES.get(name) or study.config.study.question
        table.add_row(name, f"{len(Plan(study)):,} runs", line)
    yield "studies (testbed sweep)", table
    table = _plain_table(width, ())
    for name in list_tunings():
        table.add_row(name, TUNES.get(name) or load_tune(name).config.study.question)
    yield "tuning files (testbed tune)", table


def _plain_table(width: int, numbers: Sequence[int]) -> Table:
    """Make a table without rules: a name, right-aligned numbers of these widths, and a text."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, min_width=width)
    for each in numbers:
        table.add_column(justify="right", no_wrap=True, min_width=each)
    table.add_column()
    return table


def _describe(name: str) -> None:
    """Print question, expectation and file of a scenario, study or tuning file."""
    from testbed.scenario import (
        find_scenario,
        find_study,
        find_tuning,
        list_studies,
        list_tunings,
        load_scenario,
    )
    from testbed.studies.plan import load_study
    from testbed.studies.tune_schema import load_tune

    console = result_console()
    if name in list_studies():
        path, header = find_study(name), load_study(name).config.study
        rows = {"question": header.question, "run": f"testbed sweep {name}"}
    elif name in list_tunings():
        path, header = find_tuning(name), load_tune(name).config.study
        rows = {"question": header.question, "run": f"testbed tune {name}"}
    else:
        loaded = load_scenario(name)
        path = find_scenario(name)
        rows = {
            "question": loaded.scenario.question,
            "expectation": loaded.scenario.expectation,
            "aircraft": ", ".join(loaded.aircraft_names),
            "run": f"testbed run {name}",
        }
    rows = {title: text for title, text in rows.items() if text}
    width = max(map(len, rows))
    table = Table.grid(padding=(0, 2))
    for title, text in rows.items():
        table.add_row(title, text)
    console.write_line(name, "bold")
    console.print(table)
    console.write_line(f"{'file':<{width}}  {path}")


def schema_command() -> None:
    """Print the JSON schema of scenario files, for editors."""
    import json

    from testbed.scenario import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
