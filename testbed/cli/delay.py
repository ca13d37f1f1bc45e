"""The command that finds where late messages leave the followers: delay."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.margins import Method
from testbed.cli.options import (
    JsonFile,
    Overrides,
    ScenarioName,
    error_places,
    figure_option,
    list_option,
    load_scenario,
    split_list,
    value_option,
)
from testbed.cli.output import MISSING, result_console, ruled_table, write_json_output
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.linear.delay_flight import SteadyErrors
    from testbed.scenario import Scenario
    from testbed.views.delay_figure import FollowerOffsets

LONGEST_DELAY_S, LARGEST_BANK_DEG = 5.0, 60.0
AXES = ("forward", "right", "down")


def _read_bank(parameter: typer.CallbackParam, bank: float) -> float:
    if not -LARGEST_BANK_DEG <= bank <= LARGEST_BANK_DEG:
        raise InputError(
            f"--bank {bank:g}: write -{LARGEST_BANK_DEG:g} to {LARGEST_BANK_DEG:g} degrees; 0 is "
            "straight"
        )
    return bank


@dataclass(frozen=True, slots=True)
class _DelayRow:
    """The offsets with one delay and one origin of the extrapolation."""

    delay_s: float
    extrapolate_from: str
    predicted: SteadyErrors | None
    flown: SteadyErrors | None


@draws_figures("plot")
def delay_command(
    scenario: ScenarioName,
    delays: Annotated[
        str,
        list_option(
            "S,...",
            "Delays of all messages, seconds.",
            0.0,
            LONGEST_DELAY_S,
            f"delays of 0 to {LONGEST_DELAY_S:g} s, such as 0.1,0.2,0.5",
        ),
    ] = "0.1,0.2,0.5",
    bank: Annotated[
        float,
        value_option(
            "DEG",
            "Bank of the steady turn, degrees, clockwise if positive; 0: straight.",
            check=_read_bank,
        ),
    ] = 0.0,
    overrides: Overrides = None,
    method: Annotated[
        Method,
        typer.Option(help="Predict the offsets, measure them in steady flights, or do both."),
    ] = Method.PREDICTED,
    json: JsonFile = None,
    plot: Annotated[
        Path | None, figure_option("Draw the offsets over the delay: .png, .pdf or .svg.")
    ] = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Find how far late messages leave the followers from their slots in steady flight.

    The followers fly behind a virtual leader at the speed of the scenario's, straight or in a level
    circle, in still air, without faults and with exact estimates. An offset is the difference of
    the slot error from that with a perfect network: forward, right and down of the leader's course.

    Each delay is taken twice: with messages extrapolated from their receipt, as in the paper, which
    leaves the delay as it is, and from the time of measurement, which compensates it. A law of your
    own receives messages as they are, if controller.extrapolate_from is not set. Losses of
    network.loss count too.

    Predicted offsets are the equilibrium of the paper's law with messages of that age. Flown are
    the same flights with the scenario's aircraft and middle loop; those of a law of your own are
    always flown.
    """
    from testbed.cli.progress import progress_counter
    from testbed.linear.delay_flight import is_known_law, origins

    loaded = load_scenario(scenario, overrides)
    if not is_known_law(loaded):
        method = Method.FLOWN
    times = split_list(delays)
    with error_places(scenario, overrides):
        if method is Method.PREDICTED:
            rows = list(_rows(loaded, times, bank, method))
        else:
            with progress_counter("steady flights") as progress:
                rows = []
                for row in _rows(loaded, times, bank, method):
                    rows.append(row)
                    progress(len(rows), len(times) * len(origins(loaded)))
    write_json_output(json, _document(loaded, bank, rows))
    console = result_console(json)
    turn = f"at {bank:g}° of bank" if bank else "straight"
    profile = loaded.controller.profile
    console.write_heading(loaded.name, f" · profile {profile} · {turn}")
    console.print_table(_table(loaded.aircraft_names[1:], rows))
    if not is_known_law(loaded):
        console.write_line(" flown, because the equilibrium of a law of your own is not known")
    for row in rows:
        for how, found in (("predicted", row.predicted), ("flown", row.flown)):
            if found is not None and (found.problem or found.note):
                about = f" {how}, {row.delay_s:g} s, from {row.extrapolate_from}: "
                colour = "yellow" if found.problem else ""
                console.write_line(about + (found.problem or found.note), colour)
    if plot:
        _draw(loaded, bank, rows, plot, look)


def _rows(
    scenario: Scenario, delays: Sequence[float], bank: float, method: Method
) -> Iterator[_DelayRow]:
    from testbed.linear.delay_flight import (
        fly_errors,
        origins,
        predict_errors,
        with_network,
        without_network,
    )

    perfect = without_network(scenario)
    finds = {}
    if method is not Method.FLOWN:
        finds["predicted"] = predict_errors
    if method is not Method.PREDICTED:
        finds["flown"] = fly_errors
    bases = {how: find(perfect, bank) for how, find in finds.items()}
    for delay_s in delays:
        for origin in origins(scenario):
            late = with_network(scenario, delay_s, origin)
            found = {how: _differ(find(late, bank), bases[how]) for how, find in finds.items()}
            yield _DelayRow(delay_s, origin or "law", found.get("predicted"), found.get("flown"))


def _differ(late: SteadyErrors, perfect: SteadyErrors) -> SteadyErrors:
    from testbed.linear.delay_flight import SteadyErrors

    offset = late.error_m - perfect.error_m
    return SteadyErrors(offset, late.problem or perfect.problem, late.note or perfect.note)


def _table(names: Sequence[str], rows: Sequence[_DelayRow]) -> Table:
    present = [how for how in ("predicted", "flown") if getattr(rows[0], how) is not None]
    numbers = [
        f"{'' if k else f'{how}, m'}\n{axis}" for how in present for k, axis in enumerate(AXES)
    ]
    lead = ("delay\ns", "extrapol.\nfrom", "\nfollower")
    table = ruled_table(*lead, *numbers, left=lead[1:])
    table.columns[0].justify = "right"
    for row in rows:
        for i, name in enumerate(names):
            cells: list[str] = []
            for how in present:
                found: SteadyErrors = getattr(row, how)
                texts = [f"{value:.2f}" for value in (found.error_m[i] + 0.0).tolist()]
                cells += [MISSING] * len(AXES) if found.problem else [_plain(t) for t in texts]
            first = (f"{row.delay_s:g}", row.extrapolate_from) if i == 0 else ("", "")
            table.add_row(*first, name, *cells, end_section=i == len(names) - 1)
    return table


def _plain(text: str) -> str:
    """Return a number without the sign of a zero."""
    return text.removeprefix("-") if float(text) == 0.0 else text


def _document(scenario: Scenario, bank: float, rows: Sequence[_DelayRow]) -> dict[str, Any]:
    """Return offsets as plain data for JSON."""
    names = scenario.aircraft_names[1:]

    def plain(found: SteadyErrors | None) -> dict[str, Any] | None:
        if found is None:
            return None
        return {
            "problem": found.problem,
            "note": found.note,
            "offset_m": {
                name: None if found.problem else dict(zip(AXES, each, strict=True))
                for name, each in zip(names, found.error_m.tolist(), strict=True)
            },
        }

    return {
        "schema": 1,
        "scenario": scenario.name,
        "bank_deg": bank,
        "offsets": [
            {
                "delay_s": each.delay_s,
                "extrapolate_from": each.extrapolate_from,
                "predicted": plain(each.predicted),
                "flown": plain(each.flown),
            }
            for each in rows
        ],
    }


def _draw(
    scenario: Scenario, bank: float, rows: Sequence[_DelayRow], file: Path, look: FigureLook
) -> None:
    from testbed.views.delay_figure import delay_figure

    turn = f"at {bank:g}° of bank" if bank else "straight"
    subtitle = f"offset by late messages, {turn}, profile {scenario.controller.profile}"
    followers = [_of_follower(name, i, rows) for i, name in enumerate(scenario.aircraft_names[1:])]
    look.save(delay_figure(scenario.name, subtitle, followers), file)


def _of_follower(name: str, i: int, rows: Sequence[_DelayRow]) -> FollowerOffsets:
    import numpy as np

    from testbed.views.delay_figure import FollowerOffsets

    origins = dict.fromkeys(each.extrapolate_from for each in rows)

    def values(how: str, origin: str) -> Any:  # noqa: ANN401 - an array
        chosen = [getattr(each, how) for each in rows if each.extrapolate_from == origin]
        missing = np.full(3, np.nan)
        return np.array(
            [missing if each is None or each.problem else each.error_m[i] for each in chosen]
        )

    delays = [each.delay_s for each in rows if each.extrapolate_from == next(iter(origins))]
    return FollowerOffsets(
        name,
        np.array(delays),
        {origin: values("predicted", origin) for origin in origins},
        {origin: values("flown", origin) for origin in origins},
    )
