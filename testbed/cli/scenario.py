"""The commands that read scenarios without running them: validate, list, schema."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from testbed.cli.options import Overrides, ScenarioName, load_scenario
from testbed.cli.output import result_console


def validate_command(
    scenario: ScenarioName,
    overrides: Overrides = None,
    resolved: Annotated[
        bool, typer.Option("--resolved", help="Print the scenario with every default written out.")
    ] = False,
) -> None:
    """Check a scenario without running it: its keys, aircraft, formation and control law.

    Warns about each assumption of the paper that the scenario does not meet. Tests a control law of
    your own with a few calls.
    """
    from testbed.scenario import dump
    from testbed.sim.build import build

    loaded = load_scenario(scenario, overrides)
    for event in build(loaded).initial_events:
        typer.echo(f"{event.level}: {event.source}: {event.text}", err=True)
    typer.echo(dump(loaded) if resolved else f"{scenario}: valid")


def list_command() -> None:
    """List the scenarios, studies, tunes and aircraft that can be used by name."""
    from testbed.scenario import list_aircraft, list_scenarios, list_studies, list_tunings, load
    from testbed.studies.plan import load_study
    from testbed.studies.tune_schema import load_tune

    questions = {
        "scenario": {name: load(name).scenario.question for name in list_scenarios()},
        "study": {name: load_study(name).config.study.question for name in list_studies()},
        "tune": {name: load_tune(name).config.study.question for name in list_tunings()},
    }
    console = result_console()
    for kind, by_name in questions.items():
        table = Table(box=None, pad_edge=False, header_style="bold")
        table.add_column(kind, no_wrap=True)
        table.add_column("question")
        for name, question in by_name.items():
            table.add_row(name, question)
        console.print(table)
        console.print()
    console.write_line("aircraft", "bold")
    for name in list_aircraft():
        console.write_line(name)


def schema_command() -> None:
    """Print the JSON schema of scenario files, for editors."""
    import json

    from testbed.scenario import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
