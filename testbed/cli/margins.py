"""The command that measures damping and margins of a formation: margins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from testbed.cli.options import (
    Jobs,
    JsonFile,
    Overrides,
    ScenarioName,
    error_places,
    load_scenario,
)
from testbed.cli.output import (
    MISSING,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError
from testbed.core.numbers import parse_number

if TYPE_CHECKING:
    from testbed.trials.margins import FollowerMargins, Margins


def _read_banks(parameter: typer.CallbackParam, text: str) -> str:
    """Check the banks of --bank; a typer callback."""
    for part in text.split(","):
        bank = parse_number(part.strip())
        if bank is None or not 0.0 <= bank < 90.0:
            raise InputError(f"--bank {text}: write banks of 0 to 90 degrees, such as 0,30,45")
    return text


def margins_command(
    scenario: ScenarioName,
    bank: Annotated[
        str,
        typer.Option(
            metavar="DEG,...",
            help="Banks of the steady flights, degrees, of the follower that banks most; 0: "
            "straight.",
            callback=_read_banks,
        ),
    ] = "0,30,45",
    overrides: Overrides = None,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Measure the damping and the margins of a formation by small kicks in steady flight.

    The followers fly behind a virtual leader at the speed of the scenario's, straight or in level
    circles in both directions, with the scenario's controller, network and latencies, but in still
    air, without faults and with exact estimates.

    The least damped oscillation (frequency, damping ratio) is that of bank and pitch after a kick
    of 1° of one follower's commands. A displacement of 1 m to the right and down has settled when
    5 % of it are left. The largest factor and the largest additional latency of one follower's roll
    command are those with which oscillations still decay. Of both directions each number is the
    worse one.
    """
    from testbed.cli.progress import progress_counter
    from testbed.studies.flight_pool import open_flight_pool
    from testbed.studies.margins import margins_of, to_document

    loaded = load_scenario(scenario, overrides)
    banks = [float(part.strip()) for part in dict.fromkeys(bank.split(","))]
    messages = message_console()
    with (
        error_places(scenario, overrides),
        open_flight_pool(jobs=jobs, report=lambda text: messages.write_line(f" {text}")) as pool,
        progress_counter("steady flights") as progress,
    ):
        found = margins_of([(loaded, each) for each in banks], pool, progress)
    write_json_output(json, to_document(loaded, found))
    console = result_console(json)
    console.write_line(
        Text.assemble(" ", (loaded.name, "bold"), f" · profile {loaded.controller.profile}")
    )
    console.write_line()
    if any(each.followers for each in found):
        console.print_table(_table(found))
    for each in found:
        for text, style in ((each.problem, "yellow"), (each.note, "")):
            if text:
                console.write_line(f" at {each.bank_deg:g}°: {text}", style)


def _table(found: Sequence[Margins]) -> Table:
    from testbed.trials.margins import MAX_ROLL_GAIN, MAX_ROLL_LATENCY_S
    from testbed.trials.steady_flight import LONG_RECORD_S

    table = ruled_table()
    table.add_column(Text("\nfollower", style="bold"), no_wrap=True)
    for name in (
        *("bank\n°", "oscillation\nHz", "damping\nratio", "settling\ns"),
        *("roll command\nfactor", "latency\ns"),
    ):
        table.add_column(name, justify="right", no_wrap=True)

    def cells(each: FollowerMargins) -> tuple[str, ...]:
        mode = each.least_damped
        return (
            f"{each.bank_deg:.1f}",
            MISSING if mode is None else f"{mode.frequency_hz:.2f}",
            MISSING if mode is None else f"{mode.damping:.3f}",
            f"> {LONG_RECORD_S:g}" if each.settling_s is None else f"{each.settling_s:.1f}",
            f"> {MAX_ROLL_GAIN:g}" if each.roll_gain is None else f"{each.roll_gain:.2f}",
            f"> {MAX_ROLL_LATENCY_S:g}"
            if each.roll_latency_s is None
            else f"{each.roll_latency_s:.3f}",
        )

    for at in found:
        for each in at.followers:
            table.add_row(each.name, *cells(each), end_section=each is at.followers[-1])
    return table
