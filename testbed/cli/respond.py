"""The command that compares a recorded flight with the model, and fits the model to it: respond."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from testbed.cli.exit_codes import ExitCode
from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import (
    AircraftName,
    JsonFile,
    figure_option,
    finite_option,
    require_finite,
    value_option,
)
from testbed.cli.output import (
    check_output_path,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.cli.output import PipeSafeConsole
    from testbed.commissioning.airframe_fit import AirframeFit
    from testbed.commissioning.command_files import Commands
    from testbed.commissioning.replay_commands import ReplaySetup
    from testbed.commissioning.response_comparison import ResponseComparison

RECORDED, AUTOPILOT = "recorded", "autopilot"  # tunes
LOOSE_SHARE = 0.5  # half width of an interval, of its value, beyond which nothing was found out
CORRELATED = 0.9  # correlation of two parameters that the recording hardly tells apart
LONGEST_LATENCY_S = 1.0


def _check_not_negative(parameter: typer.CallbackParam, value: float) -> float:
    require_finite(parameter, value)
    if value < 0.0:
        raise InputError(f"{parameter.opts[0]} {value:g}: write 0 or more")
    return value


def _check_latency(parameter: typer.CallbackParam, value: float) -> float:
    if _check_not_negative(parameter, value) > LONGEST_LATENCY_S:
        raise InputError(f"--latency {value:g}: write 0 to {LONGEST_LATENCY_S:g} (s)")
    return value


def _check_new_folder(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
    if path is not None and path.exists():
        raise InputError(f"{parameter.opts[0]} {path}: it exists; remove it or write another name")
    return check_output_path(parameter, path)


@draws_figures("plot")
def respond_command(
    aircraft: AircraftName,
    commands: Annotated[
        Path,
        typer.Argument(
            metavar="COMMANDS.csv",
            help="Columns t_s, theta_cmd_rad, phi_cmd_rad, throttle_cmd, and recorded ones to "
            "compare with. The flight starts with airspeed_mps, altitude_m and psi_rad of the "
            "first row.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT.csv",
            help="Write the response, with the same columns and times.",
            callback=check_output_path,
        ),
    ] = None,
    param: Annotated[
        str | None,
        value_option(
            "FILE",
            "Autopilot parameters: a tune of the aircraft, or a .param file.  \\[default: "
            "recorded, or autopilot where the aircraft has no recorded.param]",
        ),
    ] = None,
    airspeed: Annotated[
        float | None,
        finite_option(
            "M/S", "True airspeed at the start.  \\[default: airspeed_mps of the first row, or 22]"
        ),
    ] = None,
    altitude: Annotated[
        float | None,
        finite_option(
            "M", "Altitude above the origin.  \\[default: altitude_m of the first row, or 100]"
        ),
    ] = None,
    origin_elevation: Annotated[
        float, finite_option("M", "Elevation of the origin above sea level.")
    ] = 300.0,
    latency: Annotated[
        float, value_option("S", "Delay of the commands, s.", check=_check_latency)
    ] = 0.02,
    sitl_rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            min=1.0,
            callback=require_finite,
            help="The recording is of SITL with this SIM_RATE_HZ: the virtual autopilot has its "
            "gyro filter.  \\[default: that of an aircraft]",
        ),
    ] = None,
    skip: Annotated[
        float,
        value_option(
            "S",
            "Time at the start that is neither compared nor fitted, s.",
            check=_check_not_negative,
        ),
    ] = 2.0,
    plot: Annotated[
        Path | None, figure_option("Draw recording and model over time: .png, .pdf or .svg.")
    ] = None,
    fit: Annotated[
        str | None,
        value_option(
            "NAMES",
            "Fit these to the recording, with 95 % intervals: mass, drag, aileron, elevator, "
            "latency, with commas between them; or all.",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        value_option(
            "FOLDER", "Write the fitted aircraft to this new folder.", check=_check_new_folder
        ),
    ] = None,
    json: JsonFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Replay a recorded flight with one aircraft, and compare the two.

    The recorded fly-by-wire-A commands are flown with the virtual autopilot; what the differences
    point to is printed. With --fit the model is fitted to the recording.
    """
    from testbed.autopilot.parameters import AutopilotTiming, read_params
    from testbed.commissioning.command_files import read_commands, write_response
    from testbed.commissioning.replay_commands import (
        AircraftLost,
        ReplaySetup,
        check_flown,
        replay_one,
    )
    from testbed.commissioning.response_comparison import compare_response
    from testbed.scenario import find_aircraft

    names = _fit_names(fit)
    if write is not None and not names:
        raise InputError("--write: what is written is fitted (add --fit, as in --fit mass,drag)")
    folder = find_aircraft(aircraft)
    recording = read_commands(commands)
    tune = _find_tune(folder, param)
    timing = AutopilotTiming(command_latency=latency, sitl_physics_hz=sitl_rate)
    setup = ReplaySetup(read_params(tune), airspeed, altitude, origin_elevation, timing)
    messages = message_console()
    response = replay_one(
        folder, recording, setup, lambda text: messages.write_line(f"warning: {text}")
    )
    if output is not None:
        with report_write_errors(str(output)):
            write_response(output, recording, response)
    messages.write_line(_gyro_filter_text(sitl_rate))
    try:
        check_flown(recording, response)
    except AircraftLost as loss:
        typer.echo(f"lost: {loss}", err=True)
        raise typer.Exit(ExitCode.AIRCRAFT_LOST) from None

    comparison = compare_response(recording, response, skip)
    if plot is not None:
        _plot(plot, f"{folder.name} · {commands.name}", comparison, look)
    console = result_console(json)
    headline = f" · {commands.name} · tune {tune.stem} · latency {latency:g} s"
    console.write_line(Text.assemble(" ", (folder.name, "bold"), headline))
    _print_comparison(console, comparison, skip)
    document = {
        "aircraft": folder.name,
        "commands": str(commands),
        "tune": str(tune),
        "latency_s": latency,
        "sitl_rate_hz": sitl_rate,
        "skip_s": skip,
        **_comparison_document(comparison),
    }
    if names:
        found = _fit(folder, recording, setup, names, skip)
        _print_fit(console, folder, found)
        document["fit"] = _fit_document(found)
        if write is not None:
            _write(console, folder, found, write, commands.name)
    write_json_output(json, document)


def _fit_names(text: str | None) -> tuple[str, ...]:
    """Return the names of --fit.

    Raises:
        InputError: a name is unknown or there twice.
    """
    from testbed.commissioning.airframe_fit import PARAMETERS

    if text is None:
        return ()
    if text.strip() == "all":
        return PARAMETERS
    names = tuple(each.strip() for each in text.split(","))
    for name in names:
        if name not in PARAMETERS or names.count(name) > 1:
            reason = "is there twice" if name in PARAMETERS else "cannot be fitted"
            known = ", ".join(PARAMETERS)
            raise InputError(f"--fit: {name!r} {reason} (write some of {known}, or all)")
    return names


def _find_tune(folder: Path, param: str | None) -> Path:
    from testbed.scenario import find_tune

    if param is not None:
        return find_tune(folder, param)
    if (folder / f"{RECORDED}.param").is_file():
        return find_tune(folder, RECORDED)
    text = f"tune: {AUTOPILOT}, as {folder.name} has no {RECORDED}.param (--param names another)"
    message_console().write_line(text)
    return find_tune(folder, AUTOPILOT)


def _gyro_filter_text(sitl_rate: float | None) -> str:
    if sitl_rate is None:
        return (
            "gyro filter: INS_GYRO_FILTER, as on an aircraft (for a recording of SITL write "
            "--sitl-rate, its SIM_RATE_HZ)"
        )
    return f"gyro filter: that of SITL at {sitl_rate:g} Hz"


def _print_comparison(
    console: PipeSafeConsole, comparison: ResponseComparison, skip: float
) -> None:
    if not comparison.quantities:
        text = (
            " nothing to compare with: the file has no recorded columns, such as phi_rad, or no "
            f"row after {skip:g} s (--skip)"
        )
        console.write_line(text, "yellow")
        return
    time = comparison.time_s
    console.write_line(f" model minus recording, {time[0]:g} to {time[-1]:g} s")
    console.write_line()
    titles = ("\nquantity", "\nunit", "\nrms", "\nmean", "\nlargest", "at\ns")
    table = ruled_table(*titles, left=titles[1:2])
    for each in comparison.quantities.values():
        row = each.largest_row
        table.add_row(
            each.name,
            each.unit,
            f"{each.rms:.2f}",
            f"{each.mean:+.2f}",
            f"{each.difference[row]:+.2f}",
            f"{time[row]:.1f}",
        )
    console.print_table(table)
    console.write_line()
    for line in comparison.findings:
        console.write_line(f" {line}")
    if not comparison.findings:
        console.write_line(" no difference that points to latency, control power or trim")


def _comparison_document(comparison: ResponseComparison) -> dict[str, Any]:
    return {
        "quantities": {
            name: {
                "unit": each.unit,
                "rms": each.rms,
                "mean": each.mean,
                "largest": float(each.difference[each.largest_row]),
                "largest_at_s": float(comparison.time_s[each.largest_row]),
            }
            for name, each in comparison.quantities.items()
        },
        "findings": list(comparison.findings),
    }


def _plot(file: Path, title: str, comparison: ResponseComparison, look: FigureLook) -> None:
    from testbed.views.response_figure import (
        RecordedAndModelled,
        ResponseFigureData,
        response_figure,
    )

    if not comparison.quantities:
        raise InputError("--plot: nothing recorded to draw (leave --plot out)")
    drawn = [
        RecordedAndModelled(each.name, each.unit, each.recorded, each.model, each.rms)
        for each in comparison.quantities.values()
    ]
    picture = ResponseFigureData(title, "recording and model", comparison.time_s, drawn)
    look.save(response_figure(picture), file)


def _fit(
    folder: Path, recording: Commands, setup: ReplaySetup, names: Sequence[str], skip: float
) -> AirframeFit:
    from testbed.cli.progress import progress_counter
    from testbed.commissioning.airframe_fit import MOST_STEPS, fit_airframe

    with progress_counter("fitting", total=MOST_STEPS, unit="steps at most") as update:
        return fit_airframe(
            folder,
            recording,
            setup,
            names,
            skip_s=skip,
            progress=lambda step: update(step, MOST_STEPS),
        )


def _print_fit(console: PipeSafeConsole, folder: Path, found: AirframeFit) -> None:
    from testbed.vehicle.jsbsim_adapter import airframe

    console.write_line()
    titles = ("\nfitted", "value\n", "95 % interval\n", "±\n%", "\n")
    table = ruled_table(*titles, left=titles[-1:])
    for each in found.parameters:
        share = each.half_width / abs(each.value) if each.value else float("inf")
        meaning = "s" if each.name == "latency" else "× the aircraft's"
        if each.name == "mass":
            meaning += f": {each.value * airframe(folder).mass:.3g} kg"
        table.add_row(
            each.name,
            f"{each.value:.3f}",
            f"{each.low:.3f} to {each.high:.3f}",
            f"{100.0 * share:.1f}",
            meaning,
            style="yellow" if share > LOOSE_SHARE else "",
        )
    console.print_table(table)
    console.write_line()
    for text in _notes(found):
        console.write_line(f" {text}")


def _notes(found: AirframeFit) -> list[str]:
    """Return lines about the fit: its offsets, what it left, and what it cannot tell."""
    others = found.nuisance
    start, pitch, speed = (
        others[name] for name in ("start_airspeed", "pitch_offset", "airspeed_offset")
    )
    lines = [
        f"offsets of the recording: pitch {math.degrees(pitch):+.2f}°, airspeed {speed:+.2f} m/s; "
        f"airspeed at the start {start:.2f} m/s"
    ]
    each = (f"{name} {new / old:.2f}" for name, (old, new) in found.rms.items())
    lines.append(f"rms differences that are left, as a share: {', '.join(each)}")
    names = [one.name for one in found.parameters]
    for i, name in enumerate(names):
        for k in range(i):
            if abs(found.correlation[i, k]) > CORRELATED:
                lines.append(
                    f"{names[k]} and {name} have a correlation of {found.correlation[i, k]:.2f}: "
                    "this recording hardly tells them apart"
                )
    lines += [
        f"{one.name} is not determined by this recording: its interval is wider than its value"
        for one in found.parameters
        if one.half_width > LOOSE_SHARE * abs(one.value)
    ]
    return lines


def _fit_document(found: AirframeFit) -> dict[str, Any]:
    return {
        "parameters": {
            each.name: {"value": each.value, "low": each.low, "high": each.high}
            for each in found.parameters
        },
        "correlation": found.correlation.tolist(),
        "offsets": found.nuisance,
        "rms": {name: {"before": old, "after": new} for name, (old, new) in found.rms.items()},
        "flights": found.flights,
    }


def _write(
    console: PipeSafeConsole, folder: Path, found: AirframeFit, path: Path, recording: str
) -> None:
    from testbed.commissioning.fitted_aircraft import companion_latency, write_fitted_aircraft

    with report_write_errors(f"--write {path}"):
        write_fitted_aircraft(folder, found, path, recording)
    console.write_line(f" aircraft  {path}")
    latency = companion_latency(found)
    if latency is not None:
        console.write_line(
            " the latency is no part of an aircraft: respond --latency, or in a scenario "
            f"controller.companion.command_latency_s: {latency:.3g}"
        )
