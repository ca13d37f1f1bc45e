"""What `testbed trim`, `linearize` and `step` print: one aircraft by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.frames import GRAVITY
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.scenario import find_aircraft, find_tune, load_middle_loop
from testbed.sim.speed_step import SpeedStep, speed_step
from testbed.state import Origin
from testbed.vehicle.identify import FirstOrder
from testbed.vehicle.jsbsim_door import linearize_aircraft, trim_aircraft
from testbed.vehicle.linearize import CONTROLS, STATES, UNITS
from testbed.vehicle.modes import Mode, find_modes
from testbed.vehicle.params import read_params
from testbed.vehicle.trim import TrimPoint, TrimResult

NOTHING = "–"
HIGH = 1000.0  # m: the ground lies so far below that it does not matter
LOWEST, HIGHEST = -430.0, 11000.0  # m: the shore of the Dead Sea, and the top of the troposphere
OFTEN = 0.1  # of the window after a step: longer at a limit, the throttle shapes the response
PARTAKES = 0.1  # a state with a larger share in a mode is named
# [HBH23] calls them time constants; as f = −0.64 s, g = 0.64 shows, they are poles.
PAPER_POLES = {"Rascal 110, simulation": 0.64, "Skywalker X8, flight": 0.4}

Document = Mapping[str, Any]


def show_trim(
    aircraft: str, airspeed: float, climb: float, bank: float, altitude: float, *, json: Path | None
) -> None:
    """Print a trim; m/s, degrees and m."""
    folder, point, origin = _asked(aircraft, airspeed, climb, bank, altitude)
    result = trim_aircraft(folder, point, origin)
    console = _console(json)
    console.print(_headline(folder, point))
    console.print()
    console.print(_trim_table(result))
    put_json(json, {"aircraft": folder.name, **trim_document(result)})


def show_modes(
    aircraft: str, airspeed: float, climb: float, bank: float, altitude: float, *, json: Path | None
) -> None:
    """Print the natural modes about a trim; m/s, degrees and m."""
    folder, point, origin = _asked(aircraft, airspeed, climb, bank, altitude)
    linear = linearize_aircraft(folder, point, origin)
    modes = find_modes(linear.a)
    console = _console(json)
    console.print(_headline(folder, point))
    console.print()
    console.print(_modes_table(modes))
    document = {
        "aircraft": folder.name,
        "trim": trim_document(linear.trim),
        "states": dict(zip(STATES, UNITS, strict=True)),
        "controls": list(CONTROLS),
        "a": linear.a.tolist(),
        "b": linear.b.tolist(),
        "modes": [_mode_document(mode) for mode in modes],
    }
    put_json(json, document)


def show_step(
    aircraft: str,
    airspeed: float | None,
    step: float,
    profile: str,
    param: str,
    *,
    json: Path | None,
) -> None:
    """Print what a step of the commanded speed does; m/s."""
    folder = find_aircraft(aircraft)
    gains = load_middle_loop(folder, profile)
    params = read_params(find_tune(folder, param))
    before = gains.trim_airspeed_mps if airspeed is None else airspeed
    _refuse_infinite(airspeed=before, step=step)
    flown = speed_step(folder, gains, params, airspeed=before, step=step)
    console = _console(json)
    asked = f" · {before:g} {step:+g} m/s · profile {profile} · tune {Path(param).stem}"
    console.print(Text.assemble(" ", (folder.name, "bold"), asked))
    console.print()
    console.print(_step_table(flown))
    console.print()
    console.print(_step_facts(flown))
    if flown.limited_s > OFTEN * flown.time[-1]:
        line = " the throttle stood at a limit: the pole is the motor's limit, not the loop's"
        console.print(Text(line, style="yellow"))
    document = {
        "aircraft": folder.name,
        "profile": profile,
        "tune": param,
        "airspeed_mps": before,
        "step_mps": step,
        "model": _model_document(flown.model, step),
        "model_with_free_gain": _model_document(flown.free, step),
        "paper_poles_per_s": PAPER_POLES,
        "settled_at_steps": flown.settled,
        "altitude_change_m": flown.altitude_change,
        "throttle_limited_s": flown.limited_s,
        "time_s": flown.time.tolist(),
        "ground_speed_mps": flown.speed.tolist(),
        "throttle": flown.throttle.tolist(),
    }
    put_json(json, document)


def trim_document(result: TrimResult) -> dict[str, Any]:
    """A trim for JSON."""
    point, controls = result.point, result.controls
    return {
        "airspeed_mps": point.airspeed,
        "climb_deg": math.degrees(point.flight_path_angle),
        "climb_mps": point.airspeed * math.sin(point.flight_path_angle),
        "altitude_m": point.altitude,
        "bank_deg": math.degrees(result.placement.roll),
        "pitch_deg": math.degrees(result.placement.pitch),
        "alpha_deg": math.degrees(result.alpha),
        "beta_deg": math.degrees(result.beta),
        "turn_rate_deg_s": math.degrees(result.turn_rate),
        "turn_radius_m": _radius(result),
        "load_factor": _load_factor(result),
        "elevator": controls.elevator,
        "aileron": controls.aileron,
        "rudder": controls.rudder if result.has_rudder else None,
        "throttle": controls.throttle,
        "propeller_rpm": 60.0 * result.propeller_rps,
        "residual": result.residual,
    }


def _asked(
    aircraft: str, airspeed: float, climb: float, bank: float, altitude: float
) -> tuple[Path, TrimPoint, Origin]:
    folder = find_aircraft(aircraft)
    _refuse_infinite(airspeed=airspeed, climb=climb, bank=bank, altitude=altitude)
    if not LOWEST <= altitude <= HIGHEST:
        raise InputError(f"--altitude {altitude:g}: write {LOWEST:g} to {HIGHEST:g} (m)")
    point = TrimPoint(airspeed, math.radians(climb), math.radians(bank), altitude)
    return folder, point, Origin(elevation_m=altitude - HIGH)


def _refuse_infinite(**options: float) -> None:
    for name, value in options.items():
        if not math.isfinite(value):
            raise InputError(f"--{name} {value}: write a number")


def _console(json: Path | None) -> Console:
    refuse_files(json=json)
    return Console(stderr=is_stdout(json), highlight=False)


def _headline(folder: Path, point: TrimPoint) -> Text:
    line = Text.assemble(" ", (folder.name, "bold"), f" · {point.airspeed:g} m/s")
    line.append(f" · climb {math.degrees(point.flight_path_angle):g}°")
    line.append(f" · bank {math.degrees(point.bank):g}° · altitude {point.altitude:g} m")
    return line


def _table() -> Table:
    return Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")


def _trim_table(result: TrimResult) -> Table:
    facts = trim_document(result)
    radius = facts["turn_radius_m"]
    table = Table.grid(padding=(0, 2))
    for _ in range(4):
        table.add_column(justify="left", no_wrap=True)
    rows = [
        ("angle of attack", f"{facts['alpha_deg']:.3f}°", "elevator", "elevator"),
        ("sideslip", f"{facts['beta_deg']:.3f}°", "aileron", "aileron"),
        ("pitch", f"{facts['pitch_deg']:.3f}°", "rudder", "rudder"),
        ("bank", f"{facts['bank_deg']:.3f}°", "throttle", "throttle"),
    ]
    for name, value, label, key in rows:
        amount = "none" if facts[key] is None else f"{facts[key]:+.4f}"
        table.add_row(f" {name}", value, label, amount)
    turn = f"{facts['turn_rate_deg_s']:.3f}°/s"
    table.add_row(" turn rate", turn, "propeller", f"{facts['propeller_rpm']:.0f} rpm")
    turning = NOTHING if radius is None else f"{radius:.1f} m"
    table.add_row(" turn radius", turning, "load factor", f"{facts['load_factor']:.4f}")
    climbing = f"{facts['climb_mps']:.2f} m/s"
    left = f"below {10.0 ** math.ceil(math.log10(max(result.residual, 1e-15))):.0e} m/s², rad/s²"
    table.add_row(" climb", climbing, "residual", left)
    return table


def _radius(result: TrimResult) -> float | None:
    level = result.point.airspeed * math.cos(result.point.flight_path_angle)
    return level / abs(result.turn_rate) if result.turn_rate else None


def _load_factor(result: TrimResult) -> float:
    """What aerodynamics and propeller carry together, in weights."""
    level = result.point.airspeed * math.cos(result.point.flight_path_angle)
    return math.hypot(1.0, result.turn_rate * level / GRAVITY)


def _modes_table(modes: tuple[Mode, ...]) -> Table:
    table = _table()
    table.add_column(Text("\nmode", style="bold"), no_wrap=True)
    for name in ("eigenvalue\n1/s", "freq.\nrad/s", "damp.\nratio", "time\nconst. s"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("½ or ×2\nin s", justify="right", no_wrap=True)
    table.add_column("\nstates", style="dim", no_wrap=True)
    for mode in modes:
        grows = mode.eigenvalue.real > 0.0
        moving = sorted(mode.participation, key=lambda state: -mode.participation[state])
        value = f"{mode.eigenvalue.real:.3f}"
        table.add_row(
            Text(mode.name, style="yellow" if mode.name == "unclassified" else ""),
            f"{value} ± {mode.eigenvalue.imag:.3f}i" if mode.oscillates else value,
            _show(mode.frequency if mode.oscillates else None, "{:.3f}"),
            _show(mode.damping, "{:.3f}"),
            _show(mode.time_constant, "{:.3f}"),
            Text(
                _show(mode.half_or_double, "×2 {:.2f}" if grows else "½ {:.2f}"),
                style="red" if grows else "",
            ),
            " ".join(state for state in moving if mode.participation[state] > PARTAKES),
        )
    return table


def _mode_document(mode: Mode) -> dict[str, Any]:
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


def _step_table(flown: SpeedStep) -> Table:
    table = _table()
    table.add_column(Text("\nspeed model", style="bold"), no_wrap=True)
    for name in ("pole\n1/s", "time const.\ns", "delay\ns", "gain\n", "fit error\nrms, %"):
        table.add_column(name, justify="right")
    for label, model in (("gain of 1", flown.model), ("gain fitted too", flown.free)):
        numbers = (model.pole, model.time_constant, model.delay, model.gain)
        table.add_row(label, *(f"{number:.3f}" for number in numbers), f"{100.0 * model.rms:.1f}")
    table.add_section()
    for label, pole in PAPER_POLES.items():
        cells = (f"{pole:.3f}", f"{1.0 / pole:.3f}", "0", "1", NOTHING)
        table.add_row(Text(label, style="dim"), *(Text(cell, style="dim") for cell in cells))
    return table


def _step_facts(flown: SpeedStep) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row(" settled at", f"{100.0 * flown.settled:.0f} % of the step")
    table.add_row(" altitude changed by", f"{flown.altitude_change:.1f} m at most")
    limited = f"{flown.limited_s:.2f} s" if flown.limited_s else "never"
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


def _show(value: float | None, form: str) -> str:
    return NOTHING if value is None else form.format(value)
