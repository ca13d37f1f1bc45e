"""The commands that analyse one aircraft: trim, linearize, step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from testbed.cli.options import AircraftName, JsonFile, ParamFile, finite_option, value_option
from testbed.cli.output import (
    MISSING,
    message_console,
    result_console,
    ruled_table,
    write_json_output,
)
from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.commissioning.identify import FirstOrder
    from testbed.commissioning.speed_step import SpeedStep
    from testbed.core.records import NedOrigin
    from testbed.vehicle.linearize import NaturalMode
    from testbed.vehicle.trim import TrimPoint, TrimResult

ABOVE_GROUND = 1000.0  # m: height in trims, where the ground has no effect
ALTITUDE_RANGE = (-430.0, 11000.0)  # m: the shore of the Dead Sea, the top of the troposphere
LIMITED_SHARE = 0.1  # of the step response: above it the throttle limit shapes the response
PARTICIPATION = 0.1  # states with a larger share in a mode are listed
# [HBH23] calls them time constants, but f = −0.64 s, g = 0.64 shows that they are poles.
PAPER_POLES = {"Rascal 110, simulation": 0.64, "Skywalker X8, flight": 0.4}


def _check_altitude(parameter: typer.CallbackParam, altitude: float) -> float:
    low, high = ALTITUDE_RANGE
    if not low <= altitude <= high:
        raise InputError(f"--altitude {altitude:g}: write {low:g} to {high:g} (m)")
    return altitude


Airspeed = Annotated[float, finite_option("M/S", "True airspeed, m/s.")]
Climb = Annotated[float, finite_option("DEG", "Flight path angle, degrees; negative in a descent.")]
Bank = Annotated[float, finite_option("DEG", "Bank angle, degrees; right wing down > 0.")]
Altitude = Annotated[
    float, value_option("M", "Altitude above sea level, m.", check=_check_altitude)
]


def trim_command(
    aircraft: AircraftName,
    airspeed: Airspeed,
    climb: Climb = 0.0,
    bank: Bank = 0.0,
    altitude: Altitude = 400.0,
    json: JsonFile = None,
) -> None:
    """Find the steady flight of an aircraft: attitude, controls, propeller speed, residual."""
    from testbed.scenario import find_aircraft
    from testbed.vehicle.jsbsim_adapter import trim_or_suggest

    folder = find_aircraft(aircraft)
    point, origin = _trim_point(airspeed, climb, bank, altitude)
    _show_warnings(folder)
    result = trim_or_suggest(folder, point, origin)
    document = {"aircraft": folder.name, **trim_document(result)}
    _write_result(json, document, result, _trim_table(result))


def linearize_command(
    aircraft: AircraftName,
    airspeed: Airspeed,
    climb: Climb = 0.0,
    bank: Bank = 0.0,
    altitude: Altitude = 400.0,
    json: JsonFile = None,
) -> None:
    """Linearise an aircraft about its trim and print its natural modes."""
    from testbed.scenario import find_aircraft
    from testbed.vehicle.jsbsim_adapter import linearize_aircraft
    from testbed.vehicle.linearize import CONTROLS, STATES, UNITS, find_modes

    folder = find_aircraft(aircraft)
    point, origin = _trim_point(airspeed, climb, bank, altitude)
    _show_warnings(folder)
    linear = linearize_aircraft(folder, point, origin)
    modes = find_modes(linear.a, linear.states)
    units = dict(zip(STATES, UNITS, strict=True))
    document = {
        "aircraft": folder.name,
        "trim": trim_document(linear.trim),
        "states": {state: units[state] for state in linear.states},
        "controls": list(CONTROLS),
        "a": linear.a.tolist(),
        "b": linear.b.tolist(),
        "modes": [_mode_document(mode) for mode in modes],
    }
    _write_result(json, document, linear.trim, _modes_table(modes))


def _show_warnings(folder: Path) -> None:
    from testbed.vehicle.jsbsim_adapter import airframe_warnings

    for text in airframe_warnings(folder):
        message_console().write_line(f"warning: {text}")


def _write_result(
    json: Path | None, document: Mapping[str, Any], trim: TrimResult, table: Table
) -> None:
    point, flight_path = trim.point, round(math.degrees(trim.flight_path_angle), 2)
    line = f" · {point.airspeed:g} m/s · flight path {flight_path:g}°"
    line += f" · bank {math.degrees(point.bank):g}° · altitude {point.altitude:g} m"
    write_json_output(json, document)
    console = result_console(json)
    console.write_heading(document["aircraft"], line)
    console.print_table(table)


def step_command(
    aircraft: AircraftName,
    airspeed: Annotated[
        float | None,
        finite_option("M/S", "Airspeed before the step.  \\[default: the profile's trim airspeed]"),
    ] = None,
    step: Annotated[float, finite_option("M/S", "Step of the airspeed command.")] = 2.0,
    profile: Annotated[
        str, value_option("NAME", "Gains of the middle loop: a profile of middle_loop.yaml.")
    ] = "tuned",
    param: ParamFile = "autopilot",
    json: JsonFile = None,
) -> None:
    """Step the airspeed command in level flight and fit the speed model of the formation law."""
    from testbed.autopilot.parameters import read_params
    from testbed.commissioning.speed_step import speed_step
    from testbed.scenario import find_aircraft, find_tune, load_middle_loop

    folder = find_aircraft(aircraft)
    gains = load_middle_loop(folder, profile)
    params = read_params(find_tune(folder, param))
    before = gains.trim_airspeed_mps if airspeed is None else airspeed
    _show_warnings(folder)
    response = speed_step(
        folder,
        gains,
        params,
        airspeed=before,
        step=step,
        warn=lambda text: message_console().write_line(f"warning: {text}"),
    )
    document = {
        "aircraft": folder.name,
        "profile": profile,
        "tune": param,
        "airspeed_mps": before,
        "step_mps": step,
        "model": _model_document(response.model, step),
        "model_with_free_gain": _model_document(response.free, step),
        "paper_poles_per_s": PAPER_POLES,
        "settled_at_steps": response.settled,
        "altitude_change_m": response.altitude_change,
        "throttle_limited_s": response.limited_s,
        "time_s": response.time.tolist(),
        "ground_speed_mps": response.speed.tolist(),
        "throttle": response.throttle.tolist(),
    }
    write_json_output(json, document)
    console = result_console(json)
    settings = f" · {before:g} {step:+g} m/s · profile {profile} · tune {Path(param).stem}"
    console.write_heading(folder.name, settings)
    console.print_table(_step_table(response))
    console.write_line()
    console.print_table(_step_facts(response))
    if response.limited_s > LIMITED_SHARE * response.time[-1]:
        line = " the throttle was at a limit: the pole is that of the motor, not of the loop"
        console.write_line(line, "yellow")


def trim_document(result: TrimResult) -> dict[str, Any]:
    """Convert a trim to JSON values."""
    point, controls = result.point, result.controls
    return {
        "airspeed_mps": point.airspeed,
        "climb_deg": math.degrees(result.flight_path_angle),
        "climb_mps": point.airspeed * math.sin(result.flight_path_angle),
        "altitude_m": point.altitude,
        "bank_deg": math.degrees(result.placement.roll),
        "pitch_deg": math.degrees(result.placement.pitch),
        "alpha_deg": math.degrees(result.alpha),
        "beta_deg": math.degrees(result.beta),
        "turn_rate_deg_s": math.degrees(result.turn_rate),
        "turn_radius_m": _turn_radius(result),
        "load_factor": _load_factor(result),
        "elevator": controls.elevator,
        "aileron": controls.aileron,
        "rudder": controls.rudder if result.has_rudder else None,
        "throttle": controls.throttle if result.has_engine else None,
        "propeller_rpm": None if math.isnan(result.propeller_rps) else 60.0 * result.propeller_rps,
        "residual": result.residual,
    }


def _trim_point(
    airspeed: float, climb: float, bank: float, altitude: float
) -> tuple[TrimPoint, NedOrigin]:
    from testbed.core.records import NedOrigin
    from testbed.vehicle.trim import TrimPoint

    point = TrimPoint(airspeed, math.radians(climb), math.radians(bank), altitude)
    return point, NedOrigin(elevation_m=altitude - ABOVE_GROUND)


def _trim_table(result: TrimResult) -> Table:
    values = trim_document(result)
    radius = values["turn_radius_m"]
    table = Table.grid(padding=(0, 2))
    for _ in range(4):
        table.add_column(justify="left", no_wrap=True)
    rows = [
        ("angle of attack", "alpha_deg", "elevator"),
        ("sideslip", "beta_deg", "aileron"),
        ("pitch", "pitch_deg", "rudder"),
        ("bank", "bank_deg", "throttle"),
    ]
    for label, angle, control in rows:
        position = "none" if values[control] is None else f"{values[control]:+.4f}"
        table.add_row(f" {label}", f"{values[angle]:.3f}°", control, position)
    turn = f"{values['turn_rate_deg_s']:.3f}°/s"
    rpm = values["propeller_rpm"]
    propeller = "none" if rpm is None else f"{rpm:.0f} rpm"
    table.add_row(" turn rate", turn, "propeller", propeller)
    turn_radius = MISSING if radius is None else f"{radius:.1f} m"
    table.add_row(" turn radius", turn_radius, "load factor", f"{values['load_factor']:.4f}")
    bound = 10.0 ** math.ceil(math.log10(max(result.residual, 1e-15)))
    climb = f"{values['climb_mps']:.2f} m/s"
    table.add_row(" climb rate", climb, "residual", f"below {bound:.0e} m/s², rad/s²")
    return table


def _turn_radius(result: TrimResult) -> float | None:
    level = result.point.airspeed * math.cos(result.flight_path_angle)
    return level / abs(result.turn_rate) if result.turn_rate else None


def _load_factor(result: TrimResult) -> float:
    """Aerodynamic and propeller force over the weight."""
    from testbed.core.frames import GRAVITY

    level = result.point.airspeed * math.cos(result.flight_path_angle)
    return math.hypot(1.0, result.turn_rate * level / GRAVITY)


def _modes_table(modes: tuple[NaturalMode, ...]) -> Table:
    titles = ("\nmode", "eigenvalue\n1/s", "freq.\nrad/s", "damp.\nratio", "time\nconst. s")
    table = ruled_table(*titles, "½ or ×2\nin s", "\nstates", left=["\nstates"])
    table.columns[-1].style = "dim"
    for mode in modes:
        unstable = mode.eigenvalue.real > 0.0
        states = sorted(mode.participation, key=lambda state: -mode.participation[state])
        value = f"{mode.eigenvalue.real:.3f}"
        table.add_row(
            Text(mode.name, style="yellow" if mode.name == "unclassified" else ""),
            f"{value} ± {mode.eigenvalue.imag:.3f}i" if mode.oscillates else value,
            _format(mode.frequency if mode.oscillates else None, "{:.3f}"),
            _format(mode.damping, "{:.3f}"),
            _format(mode.time_constant, "{:.3f}"),
            Text(
                _format(mode.half_or_double, "×2 {:.2f}" if unstable else "½ {:.2f}"),
                style="red" if unstable else "",
            ),
            " ".join(state for state in states if mode.participation[state] > PARTICIPATION),
        )
    return table


def _mode_document(mode: NaturalMode) -> dict[str, Any]:
    return {
        "name": mode.name,
        "eigenvalue_per_s": [mode.eigenvalue.real, mode.eigenvalue.imag],
        "natural_frequency_rad_s": mode.frequency if mode.oscillates else None,
        "damping_ratio": mode.damping,
        "period_s": mode.period,
        "time_constant_s": mode.time_constant,
        "half_or_double_s": mode.half_or_double,
        "grows": mode.eigenvalue.real > 0.0,
        "participation": mode.participation,
    }


def _step_table(response: SpeedStep) -> Table:
    titles = ("pole\n1/s", "time const.\ns", "delay\ns", "gain\n", "fit error\nrms, %")
    table = ruled_table("\nspeed model", *titles)
    for label, model in (("gain 1", response.model), ("gain fitted", response.free)):
        numbers = (model.pole, model.time_constant, model.delay, model.gain)
        table.add_row(label, *(f"{number:.3f}" for number in numbers), f"{100.0 * model.rms:.1f}")
    table.add_section()
    for label, pole in PAPER_POLES.items():
        cells = (f"{pole:.3f}", f"{1.0 / pole:.3f}", "0", "1", MISSING)
        table.add_row(Text(label, style="dim"), *(Text(cell, style="dim") for cell in cells))
    return table


def _step_facts(response: SpeedStep) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row(" final value", f"{100.0 * response.settled:.0f} % of the step")
    table.add_row(" largest altitude change", f"{response.altitude_change:.1f} m")
    limited = f"{response.limited_s:.2f} s" if response.limited_s else "never"
    table.add_row(" throttle at a limit", limited)
    return table


def _model_document(model: FirstOrder, step: float) -> dict[str, Any]:
    return {
        "pole_per_s": model.pole,
        "time_constant_s": model.time_constant,
        "delay_s": model.delay,
        "gain": model.gain,
        "fit_error_rms_mps": model.rms * abs(step),
        "fit_error_rms_steps": model.rms,
    }


def _format(value: float | None, pattern: str) -> str:
    return MISSING if value is None else pattern.format(value)
