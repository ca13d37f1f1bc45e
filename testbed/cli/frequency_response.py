"""The command that finds how inputs act on a formation by their frequency: frequency-response."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

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
    positive_option,
    split_list,
    value_option,
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
    from testbed.core.records import Array
    from testbed.linear.pooled_response import Question, StringResponse
    from testbed.scenario import Scenario

MOST_ROWS = 12  # of a table
SMALLEST_SHOWN = 1e-6  # m per unit of the input; less is rounding
LOWEST_HZ, HIGHEST_HZ = 0.005, 2.0  # of flights


class InputName(StrEnum):
    """What swings."""

    LEADER_SPEED = "leader-speed"
    LEADER_WEAVE = "leader-weave"
    LEADER_HEIGHT = "leader-height"
    GUST_FORWARD = "gust-forward"
    GUST_RIGHT = "gust-right"
    GUST_DOWN = "gust-down"
    MESSAGE_FORWARD = "message-forward"
    MESSAGE_RIGHT = "message-right"
    MESSAGE_DOWN = "message-down"


class OutputName(StrEnum):
    """What is measured of each follower."""

    SLOT_ERROR = "slot-error"
    POSITION = "position"


_UNITS = {"leader": "m of the leader", "gust": "m/s of the gust", "message": "m of the message"}


@draws_figures("plot")
def frequency_response_command(
    scenario: ScenarioName,
    input: Annotated[
        InputName,
        value_option(
            "INPUT",
            "What swings: leader-speed, leader-weave or leader-height; gust-forward, "
            "gust-right or gust-down; or the position in messages, message-forward, "
            "message-right or message-down.",
        ),
    ] = InputName.LEADER_SPEED,
    output: Annotated[
        OutputName,
        typer.Option(
            help="The distance from the slot, or the deviation of the position along the axis of "
            "the input."
        ),
    ] = OutputName.SLOT_ERROR,
    sender: Annotated[
        str | None,
        value_option("AIRCRAFT", "Whose messages swing.  \\[default: those of the leader]"),
    ] = None,
    flown: Annotated[
        str | None,
        list_option(
            "HZ,...",
            "Measure the response by flights at these frequencies, too.",
            LOWEST_HZ,
            HIGHEST_HZ,
            f"frequencies of {LOWEST_HZ:g} to {HIGHEST_HZ:g} Hz, such as 0.02,0.1,0.3",
        ),
    ] = None,
    factor: Annotated[
        float,
        positive_option(
            "FACTOR",
            "Factor of the amplitudes of the flights, to see where responses are no longer "
            "proportional.",
            "--amplitude-factor",
        ),
    ] = 1.0,
    overrides: Overrides = None,
    jobs: Jobs = None,
    plot: Annotated[
        Path | None,
        figure_option("Draw amplitudes and gains per hop over frequency, as .png, .pdf or .svg."),
    ] = None,
    json: JsonFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Find how a formation answers its leader, gusts and messages by their frequency.

    The followers fly straight behind a virtual leader at the speed of the scenario's, with the
    scenario's controller, network and latencies. There their control periods are linearised, as
    for `testbed margins`. The input is a sinusoid; the amplitudes of the followers are per metre of
    the leader's position or of a message's, or per m/s of a gust.

    The gain per hop is the amplitude over that of the follower ahead. What a follower passes on is
    its answer to deviations of other followers alone: the largest gain of sinusoids (L2) and of
    largest deviations (L∞). At most 1: no disturbance of one aircraft grows along the string. It
    is 1 or less where the leader's share of the follower's gains is at least the one needed.
    """
    from testbed.cli.progress import progress_counter
    from testbed.linear.pooled_response import Question, response_of, to_document
    from testbed.pool.flight_pool import open_flight_pool

    if factor != 1.0 and flown is None:
        raise InputError(
            f"--amplitude-factor {factor:g}: is for flights (write --flown 0.02,0.1,0.3, too)"
        )
    loaded = load_scenario(scenario, overrides)
    asked = Question(
        input.value,
        output.value,
        _sender_row(loaded, input, sender),
        tuple(split_list(flown)) if flown else (),
        factor,
    )
    messages = message_console()
    with (
        error_places(scenario, overrides),
        open_flight_pool(jobs=jobs, report=lambda text: messages.write_line(f" {text}")) as pool,
        progress_counter("linearised and flown") as progress,
    ):
        found = response_of(loaded, asked, pool, progress)
    if not (found.predicted.amplitude >= SMALLEST_SHOWN).any():
        raise InputError(f"--input {input.value}: no follower uses what swings")
    write_json_output(json, to_document(loaded, asked, found))
    unit = _UNITS[input.value.partition("-")[0]]
    console = result_console(json)
    console.write_heading(loaded.name, f" · {input.value} · {output.value}, m per {unit}")
    rows = _worst_rows(found)
    console.print_table(_table(found, rows))
    if len(rows) < len(found.followers):
        console.write_line(
            f" the {len(rows)} largest of {len(found.followers)} followers; --json has all"
        )
    if plot is not None:
        _plot(plot, loaded, asked, found, f"{output.value.replace('-', ' ')}, m per {unit}", look)
        console.write_line(f" figure: {plot}")


def _sender_row(scenario: Scenario, input: InputName, sender: str | None) -> int:
    names = scenario.aircraft_names
    if sender is None:
        return 0
    if not input.value.startswith("message"):
        raise InputError(
            f"--sender {sender}: is for messages (write --input message-forward, message-right or "
            "message-down)"
        )
    if sender not in names:
        raise InputError(f"--sender {sender}: write one of {', '.join(names)}")
    return names.index(sender)


def _worst_rows(found: StringResponse) -> list[int]:
    """Return the rows of the followers with the largest peaks, in the order of the fleet."""
    peaks = found.predicted.amplitude.max(axis=0)
    rows: list[int] = sorted((-peaks).argsort(kind="stable")[:MOST_ROWS].tolist())
    return rows


def _table(found: StringResponse, rows: list[int]) -> Table:
    from testbed.linear.pooled_response import largest_differences

    titles = ["\nfollower", "\nahead", "\npeak", "at\nHz", "per\nhop", "passed\non L2", "\nL∞"]
    titles += ["leader\nshare", "\nneeds"]
    differences = [] if found.flown is None else largest_differences(found)
    if differences:
        titles += ["flown\n%", "hop\n%"]
    table = ruled_table(*titles, left=titles[1:2])
    table.columns[1].header = Text(titles[1], "bold")
    frequency = found.predicted.frequency_hz
    for i in rows:
        hop = found.hops[i]
        cells = [*_peak(found.predicted.amplitude[:, i], frequency)]
        cells += _peak(found.predicted.per_hop[:, i], frequency)[:1]
        if hop is None:
            cells += [MISSING] * 4
        else:
            cells += [f"{hop.gain:.2f}", f"{hop.peak_gain:.2f}"]
            cells += [f"{hop.leader_share:.2f}", f"{hop.needed_share:.2f}"]
        if differences:
            cells += [
                f"{100.0 * each:+.1f}" if math.isfinite(each) else MISSING
                for each in differences[i]
            ]
        table.add_row(found.followers[i], found.ahead[i], *cells)
    return table


def _peak(values: Array, frequency_hz: Array) -> tuple[str, str]:
    """Return the largest value and its frequency as text."""
    import numpy as np

    if not np.isfinite(values).any():
        return MISSING, MISSING
    if np.nanmax(values) < SMALLEST_SHOWN:
        return "0", MISSING
    at = int(np.nanargmax(values))
    return f"{values[at]:.3g}", f"{frequency_hz[at]:.2g}"


def _plot(
    file: Path,
    scenario: Scenario,
    asked: Question,
    found: StringResponse,
    quantity: str,
    look: FigureLook,
) -> None:
    import numpy as np

    from testbed.views.frequency_response_figure import (
        COLOURS,
        FollowerCurves,
        ResponseCurves,
        frequency_response_figure,
    )

    n = len(found.followers)
    rows = np.unique(np.linspace(0, n - 1, min(n, len(COLOURS))).round().astype(int)).tolist()
    nothing = np.empty((0, n))
    flown = found.flown
    picture = ResponseCurves(
        f"{scenario.name}: {asked.input}",
        f"{n} followers, profile {scenario.controller.profile}, straight flight; lines predicted"
        + (", points flown" if flown else ""),
        quantity,
        found.predicted.frequency_hz,
        flown.frequency_hz if flown else np.empty(0),
        [
            FollowerCurves(
                found.followers[i],
                found.predicted.amplitude[:, i],
                found.predicted.per_hop[:, i],
                (flown.amplitude if flown else nothing)[:, i],
                (flown.per_hop if flown else nothing)[:, i],
            )
            for i in rows
        ],
    )
    look.save(frequency_response_figure(picture), file)
