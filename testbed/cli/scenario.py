"""The command that lists what can be used by name: scenarios, studies, laws, aircraft, runs."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.table import Table

from testbed.cli.options import JsonFile
from testbed.cli.output import PipeSafeConsole, result_console, write_json_output
from testbed.core.errors import InputError
from testbed.core.files import format_bytes
from testbed.core.input_files import read_bounded
from testbed.scenario.control import BUILT_IN

# What each scenario shows, in at most 36 characters, which leave the table within 80 columns.
GROUPS: Final[Mapping[str, Mapping[str, str]]] = {
    "start here": {
        "simulation-3": "the paper's formation of three",
        "simulation-3-pixhawk": "the same with hobby sensors, an EKF",
        "packet-loss-30": "the same with 30 % of messages lost",
        "engine-out-uav2": "an aircraft loses its engine",
    },
    "the paper": {
        "simulation-1": "leader's position for uav1 only",
        "simulation-2": "position of the aircraft ahead only",
        "experiment-1": "two Skywalker X8s at 10 Hz, in wind",
        "experiment-2": "X8s above and below their leader",
        "experiment-3": "the same with the horizontal law",
        "ideal-figure-eight": "the law on its own unicycle model",
    },
    "variants of simulation-3": {
        "simulation-3-improved": "improved middle loop and estimates",
        "simulation-3-30deg": "corners at 30 degrees of bank",
        "simulation-3-hard": "a path beyond the aircraft's limits",
        "simulation-3-wide": "slots of 10 m, a separation filter",
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
        "late-radio-loss": "half of the messages lost from 300 s",
    },
    "wind": {
        "wind-8ms": "steady wind of 8 m/s",
        "turbulence-moderate": "moderate turbulence, a common field",
        "gust-front": "a gust front crosses the formation",
        "close-formation-wake": "followers in the leader's wake",
    },
    "sensors and faults": {
        "gps-degraded": "degraded GPS reception",
        "airspeed-blocked": "a blocked pitot tube",
    },
    "your own law": {
        "own-law-leader-follower": "a textbook leader-follower law",
        "own-law-integral": "integral action and the paper's law",
        "own-law-repulsion": "repulsion between two aircraft",
        "own-functions": "a control function and a barrier",
        "ideal-own-speed-model": "ideal vehicles, drag and a propeller",
    },
    "other fleets": {
        "hold-slot": "one follower, for training policies",
        "mixed-fleet": "different aircraft in one formation",
        "vee-30": "a vee of thirty",
        "vee-100": "a vee of a hundred",
    },
}
OTHERS: Final = "others"  # the group of scenarios that are in no other
# The names that `testbed list` shows without --all.
FIRST: Final = (
    "simulation-3",
    "simulation-3-pixhawk",
    "packet-loss-30",
    "simulation-3-latency",
    "bursty-wifi",
    "turbulence-moderate",
    "gust-front",
    "engine-out-uav2",
    "own-law-leader-follower",
    "experiment-2",
    "mixed-fleet",
    "vee-30",
)
FIRST_STUDIES: Final = ("what-matters-most", "radio-and-wind")

STUDIES: Final[Mapping[str, str]] = {
    "radio-and-wind": "loss and wind together",
    "what-matters-most": "delay, loss, wind and gusts compared",
    "loss-to-1-cm": "errors known to a centimetre",
    "map-delay-and-loss": "error over message delay and loss",
    "map-wind-and-turbulence": "error over wind and turbulence",
    "map-bank-and-climb": "manoeuvres that can be followed",
    "map-margins": "damping over two gains, predicted",
    "convergence": "rates of the flight models",
    "convergence-seeds": "the same in turbulence, saturation",
    "convergence-others": "rates of autopilot, control, samples",
    "leader-acceleration": "the leader's acceleration, estimated",
    "leader-turn-acceleration": "differences of the turn rates",
    "table-1": "the set-up that gives Table 1",
    "table-1-ages": "old messages and own states",
    "table-1-causes": "single causes of such errors",
    "table-1-laps": "leader's acceleration left out",
    "table-1-authors": "the authors' gains with old states",
    "joint-fit": "sets of numbers that give Table 2",
    "as-flown": "experiments, one set of parameters",
    "turn-direction": "the leader turns the other way",
    "laws": "the laws of the library compared",
    "gap-budget-0": "the aircraft alone, without troubles",
    "gap-budget-1": "reasons for errors of experiment 1",
    "gap-budget-2": "reasons for errors of experiment 2",
    "gap-budget-3": "reasons for errors of experiment 3",
}
TUNES: Final[Mapping[str, str]] = {
    "x8-middle-loop": "gains of the X8's middle loop",
    "law-leader-follower": "gains of a law of the library",
    "law-virtual-structure": "the same",
    "law-track-pid": "the same",
    "law-plane-follow": "the same",
    "law-mpc": "the same",
}

AIRCRAFT_WIDTH, TIME_WIDTH = 3, 7  # columns of `testbed list`


def list_command(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="A scenario, study or tuning file: print its question, expectation and file.",
            show_default=False,
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="List every name, scenarios grouped by purpose.")
    ] = False,
    runs: Annotated[
        bool,
        typer.Option("--runs", help="List the runs in logs/, or in the folder NAME, with sizes."),
    ] = False,
    json: JsonFile = None,
) -> None:
    """List the scenarios, studies, tuning files, laws and aircraft to begin with, or the runs.

    Scenarios have the number of their aircraft and the simulated time. --json writes every name.
    """
    if everything and (name is not None or runs):
        raise InputError("--all: lists every name; leave out NAME and --runs")
    if runs:
        _list_runs(Path(name or "logs"), json)
        return
    if name is not None:
        if json:
            raise InputError(f"--json: lists all names; leave out {name}, or write --runs")
        _describe(name)
        return
    write_json_output(json, _names_document() if json else {})
    _list_names(result_console(json), everything)


def _list_names(console: PipeSafeConsole, everything: bool) -> None:
    """List the names to begin with, or all."""
    from testbed.scenario import list_aircraft

    console.write_line("scenario, number of aircraft, simulated time, what it shows", "dim")
    console.print()
    groups = (_all_scenarios(), _all_studies()) if everything else (_first_names(),)
    for title, table in chain(*groups):
        console.write_line(title, "bold")
        console.print(table)
        console.print()
    title, table = _laws()
    console.write_line(title, "bold")
    console.print(table)
    console.print()
    console.write_line("aircraft", "bold")
    for each in list_aircraft():
        console.write_line(each)
    console.print()
    if not everything:
        console.write_line(_left_out(), "dim")
    console.write_line(
        "testbed list NAME prints its question; testbed run NAME flies a scenario.",
        "dim",
    )


def _left_out() -> str:
    from testbed.scenario import list_scenarios, list_studies

    scenarios, studies = set(list_scenarios()) - {*FIRST}, set(list_studies()) - {*FIRST_STUDIES}
    return (
        f"testbed list --all has {len(scenarios)} more scenarios and {len(studies)} more studies."
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
        "laws": [{"name": name, "subject": subject} for name, subject in _law_subjects()],
        "aircraft": [{"name": name} for name in list_aircraft()],
    }


def _first_names() -> Iterator[tuple[str, Table]]:
    """Yield the tables of a short list: title, and names with what they show."""
    lines = {name: line for group in GROUPS.values() for name, line in group.items()}
    yield "scenarios (testbed run)", _scenario_table({name: lines[name] for name in FIRST})
    # the numbers of runs are left out: to count them takes longer than all the rest
    table = _plain_table(_name_width(), (AIRCRAFT_WIDTH + TIME_WIDTH + 1,))
    for name in FIRST_STUDIES:
        table.add_row(name, "", STUDIES[name])
    yield "studies (testbed sweep)", table
    yield _tuning_files()


def _all_scenarios() -> Iterator[tuple[str, Table]]:
    from testbed.scenario import list_scenarios

    grouped = {each for group in GROUPS.values() for each in group}
    others = {each: "" for each in list_scenarios() if each not in grouped}
    for title, group in {**GROUPS, OTHERS: others}.items():
        if (table := _scenario_table(group)).row_count:
            yield title, table


def _scenario_table(group: Mapping[str, str]) -> Table:
    """Return the table of the scenarios of a group that exist."""
    from testbed.scenario import list_scenarios, load_scenario

    names = list_scenarios()
    table = _plain_table(_name_width(), (AIRCRAFT_WIDTH, TIME_WIDTH))
    for name, line in group.items():
        if name in names:
            loaded = load_scenario(name)
            duration = f"{loaded.scenario.duration_s:,.0f} s"
            line = line or loaded.scenario.question
            table.add_row(name, str(len(loaded.aircraft_names)), duration, line)
    return table


def _all_studies() -> Iterator[tuple[str, Table]]:
    from testbed.scenario import list_studies
    from testbed.studies.plan import Plan, load_study

    table = _plain_table(_name_width(), (AIRCRAFT_WIDTH + TIME_WIDTH + 1,))
    for name in sorted(list_studies(), key=lambda each: (each not in STUDIES, each)):
        study = load_study(name)
        line = STUDIES.get(name) or study.config.study.question
        most = "≤ " if study.config.study.chooses_runs else ""
        table.add_row(name, f"{most}{len(Plan(study)):,} runs", line)
    yield "studies (testbed sweep)", table
    yield _tuning_files()


def _laws() -> tuple[str, Table]:
    table = _plain_table(_name_width(), ())
    for row in _law_subjects():
        table.add_row(*row)
    return "laws (controller.law)", table


def _law_subjects() -> list[tuple[str, str]]:
    """Return the laws by name with the first line of their files, the paper's first."""
    from testbed.scenario import find_law, list_laws

    found = [(BUILT_IN, "the paper's law")]
    for name in list_laws():
        text = ast.get_docstring(ast.parse(read_bounded(find_law(name)))) or ""
        found.append((name, text.partition("\n")[0].rstrip(".")))
    return found


def _tuning_files() -> tuple[str, Table]:
    from testbed.scenario import list_tunings

    table = _plain_table(_name_width(), ())
    for name in list_tunings():
        table.add_row(name, TUNES.get(name) or _tuning_question(name))
    return "tuning files (testbed tune)", table


def _tuning_question(name: str) -> str:
    from testbed.tuning.tune_schema import load_tune  # takes longer than the rest of a short list

    return load_tune(name).config.study.question


def _name_width() -> int:
    """Return the width of the longest scenario's name, in characters."""
    from testbed.scenario import list_scenarios

    return max(map(len, list_scenarios()), default=0)


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
    from testbed.tuning.tune_schema import load_tune

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
