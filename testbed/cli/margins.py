"""The command that finds damping and margins of a formation: margins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import (
    Jobs,
    JsonFile,
    Overrides,
    ScenarioName,
    error_places,
    figure_option,
    list_option,
    load_scenario,
    split_list,
)
from testbed.cli.output import (
    MISSING,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.linear.flown_margins import Margins
    from testbed.linear.linear_system import LinearSystem
    from testbed.linear.predicted_margins import Prediction
    from testbed.scenario import Scenario
    from testbed.views.panels import PanelGrid


class Method(StrEnum):
    """How margins are found."""

    PREDICTED = "predicted"
    FLOWN = "flown"
    BOTH = "both"


class FigureKind(StrEnum):
    """What a figure shows."""

    POLES = "poles"
    BODE = "bode"
    NYQUIST = "nyquist"
    ROOT_LOCUS = "root-locus"


class CommandName(StrEnum):
    """A command of a follower."""

    ROLL = "roll"
    PITCH = "pitch"
    THROTTLE = "throttle"


DEFAULT_BANKS_DEG = (0.0, 30.0, 45.0)
COMMAND = "\ncommand"  # column
LOWEST_HZ = 0.01  # of loops that are drawn
FACTORS = 0.02, 10.0, 120  # of a root locus: lowest above 0, highest, number
NOTHING_STEADY = "--plot: no bank has poles to draw, because none is steady"


@draws_figures("plot")
def margins_command(
    scenario: ScenarioName,
    bank: Annotated[
        str | None,
        list_option(
            "DEG,...",
            "Banks of the steady flights, degrees, of the follower that banks most; 0: "
            "straight.  \\[default: 0,30,45, at most 2 below the limit of the bank]",
            0.0,
            60.0,
            "banks of 0 to 60 degrees, such as 0,30,45",
        ),
    ] = None,
    climb: Annotated[
        float,
        typer.Option(
            metavar="M/S",
            min=-20.0,
            max=20.0,
            help="Climb rate of the steady flights; descending if negative.",
        ),
    ] = 0.0,
    overrides: Overrides = None,
    method: Annotated[
        Method,
        typer.Option(
            help="Predict the numbers from the linearised formation, measure them by kicks in "
            "flight, or do both."
        ),
    ] = Method.PREDICTED,
    jobs: Jobs = None,
    json: JsonFile = None,
    plot: Annotated[
        Path | None, figure_option("Draw a figure, with a panel for each bank: .png, .pdf or .svg.")
    ] = None,
    figure: Annotated[
        FigureKind,
        typer.Option(
            help="The figure of --plot: poles; or of the loop opened at a command its Bode or "
            "Nyquist diagram, or its poles over a factor of 0 to 10."
        ),
    ] = FigureKind.POLES,
    command: Annotated[
        CommandName | None,
        typer.Option(help="The command at which that loop is opened.  \\[default: roll]"),
    ] = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Find the damping and the margins of a formation in steady flight.

    The followers fly behind a virtual leader at the speed of the scenario's, straight or in circles
    in both directions, level or climbing, with the scenario's controller, network and latencies,
    but in still air, without faults and with exact estimates.

    There the control period of each follower is linearised. Least damped is the oscillation with
    the lowest damping ratio. The margins are those of one command of one follower: the factor at
    which oscillations no longer decay, the additional latency, the phase, and the distance, the
    least of |1 + L| of the open loop L. Of both directions each number is the worse one. Followers
    that receive from each other have a margin of message delay, in straight flight.

    --method flown measures by flights: the least damped oscillation of bank and pitch after a kick
    of 0.02° of one follower's commands; the time until 5 % are left of a displacement of 1 m to the
    right and down; and the largest factor and additional latency of one command of one follower
    with which oscillations still decay.
    """
    from testbed.cli.progress import progress_counter
    from testbed.linear.pooled_margins import margins_of, predicted_margins_of, to_document
    from testbed.linear.steady_flight import suitable_banks
    from testbed.pool.flight_pool import open_flight_pool

    if figure is not FigureKind.POLES and not plot:
        raise InputError(f"--figure {figure}: is of --plot FILE (write a file, too)")
    if command is not None and figure is FigureKind.POLES:
        raise InputError(f"--command {command}: is of loops (write --figure bode, too)")
    if plot and method is Method.FLOWN:
        raise InputError("--plot: nothing is predicted to draw (write --method both)")
    loaded = load_scenario(scenario, overrides)
    banks: Sequence[float] = DEFAULT_BANKS_DEG if bank is None else split_list(bank)
    with error_places(scenario, overrides):
        banks = suitable_banks(loaded, banks, asked=bank is not None)
    cases = [(loaded, each) for each in banks]
    messages = message_console()
    predicted: Sequence[Prediction] = ()
    measured: Sequence[Margins] = ()
    with (
        error_places(scenario, overrides),
        open_flight_pool(jobs=jobs, report=lambda text: messages.write_line(f" {text}")) as pool,
    ):
        if method is not Method.FLOWN:
            with progress_counter("linearised flights") as progress:
                predicted = predicted_margins_of(cases, pool, progress, climb)
        if method is not Method.PREDICTED:
            with progress_counter("steady flights") as progress:
                measured = margins_of(cases, pool, progress, climb)
    write_json_output(json, to_document(loaded, predicted, measured))
    console = result_console(json)
    console.write_heading(loaded.name, f" · profile {loaded.controller.profile}")
    if any(each.followers for each in predicted):
        console.print_table(_predicted_table(predicted))
    for each in predicted:
        if each.problem:
            console.write_line(f" at {each.bank_deg:g}°: {each.problem}", "yellow")
        elif not each.bank_deg:
            for line in _delay_lines(each):
                console.write_line(line)
    for note in dict.fromkeys(each.note for each in predicted if each.note):
        console.write_line(f" {note}")
    if predicted and measured:
        console.write_line()
    if any(each.followers for each in measured):
        console.print_table(_table(measured, predicted))
    for one in measured:
        for text, style in ((one.problem, "yellow"), (one.note, "")):
            if text:
                console.write_line(f" at {one.bank_deg:g}°: {text}", style)
    if plot and figure is FigureKind.POLES:
        _draw(loaded, predicted, plot, look)
    elif plot:
        steady = [each.bank_deg for each in predicted if each.followers]
        with error_places(scenario, overrides):
            grid = _loop_figure(loaded, steady, climb, figure, command or CommandName.ROLL)
        look.save(grid, plot)


def _draw(
    scenario: Scenario, predicted: Sequence[Prediction], file: Path, look: FigureLook
) -> None:
    """Draw the poles of the followers at the banks that have numbers."""
    import numpy as np

    from testbed.views.poles_figure import PolesAtBank, poles_figure

    banks = [
        PolesAtBank(
            _title(at.bank_deg),
            {each.name: np.array([mode.pole for mode in each.modes]) for each in at.followers},
        )
        for at in predicted
        if at.followers
    ]
    if not banks:
        raise InputError(NOTHING_STEADY)
    subtitle = f"poles of the linearised formation, profile {scenario.controller.profile}"
    look.save(poles_figure(scenario.name, subtitle, banks), file)


def _title(bank_deg: float) -> str:
    return f"{bank_deg:g}° of bank" if bank_deg else "straight"


def _distance(loop: LinearSystem) -> tuple[bool, float]:
    """Return by what the worse one of two loops is found: stability, then the distance from -1."""
    margins = loop.margins()
    return margins.gain > 1.0, margins.distance


def _loop_figure(
    scenario: Scenario, banks: Sequence[float], climb: float, kind: FigureKind, command: CommandName
) -> PanelGrid:
    """Draw the loops of a command at banks, of up to `MAX_LOOPS` followers, evenly selected.

    Of both directions of turn each follower has the worse one, as in the table.

    Raises:
        InputError: there is no bank.
    """
    import numpy as np

    from testbed.linear.flown_margins import directions
    from testbed.linear.linearise import linearise
    from testbed.linear.loop_margins import FREQUENCIES
    from testbed.views.loop_figures import (
        MAX_LOOPS,
        LoopCurves,
        LoopsAtBank,
        bode_figure,
        nyquist_figure,
        root_locus_figure,
    )

    if not banks:
        raise InputError(NOTHING_STEADY)
    followers = scenario.aircraft_names[1:]
    count = min(len(followers), MAX_LOOPS)
    rows = np.unique(np.linspace(0, len(followers) - 1, count).round().astype(int)).tolist()
    # 0 and 1 are marked
    factors = np.unique(np.concatenate(([0.0, 1.0], np.geomspace(*FACTORS))))
    factors = factors if kind is FigureKind.ROOT_LOCUS else factors[:0]
    drawn = []
    for bank in banks:
        systems = [linearise(scenario, bank_deg=each, climb_mps=climb) for each in directions(bank)]
        loops = []
        for row in rows:
            name = f"{followers[row]}.{command}"
            loop = min((each.loop(name) for each in systems), key=_distance)
            hz = FREQUENCIES * (0.5 / loop.dt)
            hz = hz[hz >= LOWEST_HZ]
            response = loop.frequency_response(hz)[:, 0, 0]
            poles = loop.poles_with_factors(factors)
            loops.append(LoopCurves(followers[row], hz, response, factors, poles))
        drawn.append(LoopsAtBank(_title(bank), loops))
    draw = {
        FigureKind.BODE: bode_figure,
        FigureKind.NYQUIST: nyquist_figure,
        FigureKind.ROOT_LOCUS: root_locus_figure,
    }[kind]
    words = (
        "poles over a factor of the" if kind is FigureKind.ROOT_LOCUS else "loop L opened at the"
    )
    return draw(scenario.name, f"{words} {command} command", drawn)


def _predicted_table(found: Sequence[Prediction]) -> Table:
    from testbed.linear.loop_margins import MAX_GAIN, MAX_LATENCY_S

    titles = ("\nfollower", "bank\n°", "least\ndamped, Hz", "damp.\nratio", COMMAND, "\nfactor")
    table = ruled_table(*titles, "latency\ns", "phase\n°", "dis-\ntance", left=[COMMAND])
    for at in found:
        for each in at.followers:
            mode = each.least_damped
            first = (
                each.name,
                f"{each.bank_deg:.1f}",
                MISSING if mode is None else f"{mode.frequency_hz:.2f} {mode.motion}",
                MISSING if mode is None else f"{mode.damping:.3f}",
            )
            rows = {
                name: (
                    _limited(margins.gain, MAX_GAIN, 2),
                    _limited(margins.latency_s, MAX_LATENCY_S, 3),
                    _limited(margins.phase_deg, 180.0, 0),
                    f"{margins.distance:.2f}",
                )
                for name, margins in each.commands.items()
            }
            _add_rows(table, first, rows, last=each is at.followers[-1])
    return table


def _add_rows(
    table: Table, first: Sequence[str], rows: Mapping[str, Sequence[str]], *, last: bool
) -> None:
    """Add the rows of a follower by command, after cells that only the first of them has."""
    for number, (name, cells) in enumerate(rows.items(), start=1):
        table.add_row(*first, name, *cells, end_section=last and number == len(rows))
        first = ("",) * len(first)


def _delay_lines(straight: Prediction) -> list[str]:
    """Return what the followers bear of message delay, a line for each set of them."""
    from testbed.linear.delay_margin import MAX_DELAY_S

    lines = []
    for names, delay_s in straight.message_delays:
        bears = f"{delay_s:.2f} s" if math.isfinite(delay_s) else f"> {MAX_DELAY_S:g} s"
        followers = ", ".join(names)
        lines.append(f" {followers} receive from each other: delay of messages {bears}")
    return lines or [" no followers receive from each other: stable at every message delay"]


def _limited(value: float, largest: float, digits: int) -> str:
    if math.isnan(value):  # not predicted at this bank
        return MISSING
    return f"{value:.{digits}f}" if math.isfinite(value) else f"> {largest:g}"


def _table(found: Sequence[Margins], predicted: Sequence[Prediction]) -> Table:
    """Return what was flown, with the predicted factors and latencies where there are any."""
    from testbed.linear.flown_margins import LONG_RECORD_S
    from testbed.linear.loop_margins import MAX_GAIN, MAX_LATENCY_S

    bank = () if predicted else ("bank\n°",)  # the table of the predicted ones has it
    titles = ["flown\nfollower", *bank, "oscill.\nHz", "damp.\nratio", "settl.\ns", COMMAND]
    for name, unit in (("factor", ""), ("latency", "s")):
        titles += (f"{name}\npred.", "\nflown") if predicted else (f"{name}\n{unit}",)
    table = ruled_table(*titles, left=[COMMAND])
    by_bank = {at.bank_deg: {each.name: each for each in at.followers} for at in predicted}
    for at in found:
        for each in at.followers:
            mode, other = each.least_damped, by_bank.get(at.bank_deg, {}).get(each.name)
            settling = f"> {LONG_RECORD_S:g}"
            first = (
                each.name,
                *(() if predicted else (f"{each.bank_deg:.1f}",)),
                MISSING if mode is None else f"{mode.frequency_hz:.2f}",
                MISSING if mode is None else f"{mode.damping:.3f}",
                settling if each.settling_s is None else f"{each.settling_s:.1f}",
            )
            rows = {}
            for name, margins in each.commands.items():
                pairs = [(margins.gain, margins.latency_s)]
                if predicted:
                    of = None if other is None else other.commands[name]
                    pairs.insert(0, (math.nan,) * 2 if of is None else (of.gain, of.latency_s))
                gains, latencies = zip(*pairs, strict=True)
                cells = [_limited(gain, MAX_GAIN, 2) for gain in gains]
                rows[name] = cells + [_limited(late, MAX_LATENCY_S, 3) for late in latencies]
            _add_rows(table, first, rows, last=each is at.followers[-1])
    return table
