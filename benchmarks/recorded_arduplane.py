"""Write how the virtual autopilot follows the recording of one ArduPlane in tests/data.

usage: make arduplane

Replays its commands with our airframe, with that of the recording, and with other laws of the
elevator's drag; and fast manoeuvres with both airframes.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from inputs import Inputs
from tables import add_output_arguments, publish, row

from testbed.autopilot.parameters import AutopilotTiming
from testbed.commissioning.replay_commands import respond
from testbed.core.frames import GRAVITY
from testbed.core.records import Array
from testbed.vehicle.environment import JSBSIM_DEFAULT_INTEGRATORS

ROOT = Path(__file__).parent.parent
RASCAL = ROOT / "aircraft" / "rascal110"
# Tune and middle loop of the four ArduPlanes that flew through the link
LINKED_TUNE = ROOT / "tests" / "data" / "arduplane_simulation_3.param"
LINKED_GAINS = ROOT / "tests" / "data" / "arduplane_simulation_3_gains.yaml"
RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
MARK, DRAG_MARK = "make arduplane, recording", "make arduplane, drag"
FAST_MARK = "make arduplane, fast manoeuvres"
_FILES = (
    RECORDING.relative_to(ROOT).as_posix(),
    *(
        each.relative_to(ROOT).as_posix()
        for each in sorted(RASCAL.rglob("*"))
        if each.suffix in (".xml", ".param")
    ),
)
INPUTS = {mark: Inputs(files=_FILES) for mark in (MARK, FAST_MARK, DRAG_MARK)}
# The recording is of SITL with physics at 200 Hz, which has a gyro filter of 4 Hz.
SITL = AutopilotTiming(sitl_physics_hz=200.0)
PROMPT = replace(SITL, command_latency=0.0)
BEGIN_S, END_S = 2.0, 150.0  # in its first second the propeller had no torque on the airframe
# Of commit 428ace9; docs/autopilot.md has the differences.
EARLIER_DEG = ("0.34", "0.40")
TURNS = (
    ("right, 45° commanded; 30 % throttle", 40.0, 50.0),
    ("left, 45° commanded; 30 % throttle", 50.0, 60.0),
    ("right, 40° and 8° of pitch commanded; 50 % throttle", 130.0, 145.0),
)


class Manoeuvres(NamedTuple):
    """Random commands: turns of 30 to 50°, to alternating sides; one in seven is level."""

    name: str
    hold_s: tuple[float, float]
    pitch_deg: tuple[float, float]
    throttle: tuple[float, float]
    earlier_deg: tuple[str, str]  # RMS differences with commit 428ace9


FAST = (
    Manoeuvres("turns, held for 3 to 8 s", (3.0, 8.0), (-2.0, 6.0), (0.3, 0.6), ("0.97", "0.53")),
    Manoeuvres(
        "descending turns, held for 3 to 8 s",
        (3.0, 8.0),
        (-10.0, 0.0),
        (0.2, 0.5),
        ("0.72", "1.20"),
    ),
    Manoeuvres(
        "turns with climbs, held for 1.5 to 5 s",
        (1.5, 5.0),
        (-8.0, 12.0),
        (0.2, 0.7),
        ("1.13", "0.60"),
    ),
)
SEEDS = (1, 2, 3, 4)
_DEFLECTION = "<property> fcs/elevator-pos-rad </property>"
# Laws of the elevator's drag: the lines in place of those of the square.
SIGNED = f"<value> 0.1 </value> {_DEFLECTION}"
MAGNITUDE = f"<value> 0.1 </value> <abs> {_DEFLECTION} </abs>"
# Power of a control here, at Mach 0 and at Mach 2.
_POWERS = {"left-aileron": ("0.1273", "0.13", "0.057"), "elevator": ("-0.5", "-0.5", "-0.275")}


def _power(surface: str, value: str) -> str:
    return f"<property> fcs/{surface}-pos-rad </property> {value}"


def _replace(page: Path, old: str, new: str) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.count(old) == 1
    page.write_text(text.replace(old, new), encoding="utf-8")


def make_linked_airframe(folder: Path) -> Path:
    """Copy the Rascal, as it was when ArduPlanes flew it: aileron power, tune and middle loop."""
    copy = shutil.copytree(RASCAL, folder / RASCAL.name)
    shutil.copy(LINKED_TUNE, copy / "autopilot.param")
    shutil.copy(LINKED_GAINS, copy / "middle_loop.yaml")
    ours, then, _ = (f"<value> {value} </value>" for value in _POWERS["left-aileron"])
    _replace(copy / "rascal110.xml", _power("left-aileron", ours), _power("left-aileron", then))
    return copy


def make_airframe(folder: Path, drag: str) -> Path:
    """Copy the Rascal into a folder, with another drag of the elevator."""
    copy = folder / RASCAL.name
    shutil.copytree(RASCAL, copy)
    page = copy / "rascal110.xml"
    lines = page.read_text(encoding="utf-8").split("\n")
    (square,) = (k for k, line in enumerate(lines) if "0.33333333" in line)
    assert [line.strip() for line in lines[square + 1 : square + 3]] == [_DEFLECTION] * 2
    lines[square : square + 3] = [drag]
    page.write_text("\n".join(lines), encoding="utf-8")
    return copy


def make_recorded_airframe(folder: Path) -> Path:
    """Copy the Rascal, with the four differences of the recorded one that ORIGIN.md lists."""
    copy = make_airframe(folder, SIGNED)
    page, propeller = copy / "rascal110.xml", copy / "Engines" / "propeller_18in.xml"
    for surface, (ours, zero, two) in _POWERS.items():
        mach = "<independentVar> velocities/mach </independentVar>"
        by_mach = f"<table>{mach}<tableData>\n0 {zero}\n2 {two}\n</tableData></table>"
        _replace(page, _power(surface, f"<value> {ours} </value>"), _power(surface, by_mach))
    _replace(propeller, ' version="1.1"', "")
    return copy


def read(file: Path) -> Array:
    """Read a recording or a response, by column."""
    return np.genfromtxt(file, delimiter=",", names=True)


def replay(airframe: Path, timing: AutopilotTiming = SITL, commands: Path = RECORDING) -> Array:
    """Replay commands, and return the response by column."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.csv"
        respond(
            airframe,
            commands,
            out,
            timing=timing,
            integrators=JSBSIM_DEFAULT_INTEGRATORS,
        )
        return read(out)


def write_manoeuvres(file: Path, each: Manoeuvres, seed: int) -> None:
    """Write commands of 150 s at 25 Hz, from level flight 400 m above the origin."""
    random, time = np.random.default_rng(seed), np.arange(0.0, END_S, 0.04)
    pitch, roll, throttle = np.zeros_like(time), np.zeros_like(time), np.full_like(time, 0.4)
    begin_s, side = 3.0, 1.0
    while begin_s < END_S - 4.0:
        end_s, side = begin_s + random.uniform(*each.hold_s), -side
        rows = (time >= begin_s) & (time < end_s)
        bank = side * np.radians(random.uniform(30.0, 50.0))
        roll[rows] = bank if random.random() > 1.0 / 7.0 else 0.0
        pitch[rows] = np.radians(random.uniform(*each.pitch_deg))
        throttle[rows], begin_s = random.uniform(*each.throttle), end_s
    columns = {"t_s": time, "theta_cmd_rad": pitch, "phi_cmd_rad": roll, "throttle_cmd": throttle}
    start = {"airspeed_mps": 24.6, "altitude_m": 400.0, "psi_rad": 0.0}
    columns |= {name: np.full_like(time, value) for name, value in start.items()}
    table = np.column_stack(list(columns.values()))
    np.savetxt(file, table, fmt="%.6f", delimiter=",", header=",".join(columns), comments="")


def fly_manoeuvres(folder: Path, airframe: Path, each: Manoeuvres) -> tuple[Array, Array, Array]:
    """Fly manoeuvres with our airframe and with that of the recording, for all seeds.

    Args:
        folder: for the commands.
        airframe: of `make_recorded_airframe`.
        each: the manoeuvres.

    Returns:
        Responses by column, (seeds, K): ours with the default latency of commands, and that of the
        other airframe without latency and with the default one.
    """
    flights: list[tuple[Array, Array, Array]] = []
    for seed in SEEDS:
        commands = folder / f"manoeuvres-{seed}.csv"
        write_manoeuvres(commands, each, seed)
        prompt = replay(airframe, PROMPT, commands)
        flights.append(
            (replay(RASCAL, commands=commands), prompt, replay(airframe, commands=commands))
        )
    ours, prompt, late = (np.array(each) for each in zip(*flights, strict=True))
    return ours, prompt, late


def rms_deg(response: Array, recorded: Array, column: str) -> float:
    """Compute the RMS difference of an angle, deg."""
    window = (recorded["t_s"] >= BEGIN_S) & (recorded["t_s"] <= END_S)
    difference = (response[column] - recorded[column])[window]
    return float(np.degrees(np.sqrt(np.mean(np.square(difference)))))


def rms_row(response: Array, recorded: Array) -> str:
    """Return the table row of the present control law."""
    angles = ("phi_rad", "theta_rad")
    return row("now", *(f"{rms_deg(response, recorded, angle):.2f}°" for angle in angles))


def turn_row(turn: str, name: str, flight: Array, begin_s: float, end_s: float) -> str:
    """Return the table row of a turn: bank, airspeed, and the change of specific energy."""
    time, speed = flight["t_s"], flight["airspeed_mps"]
    first, last = (int(np.argmin(np.abs(time - t))) for t in (begin_s, end_s))
    energy = flight["altitude_m"] + np.square(speed) / (2.0 * GRAVITY)
    bank = np.degrees(np.abs(flight["phi_rad"][first : last + 1])).max()
    change = f"{energy[last] - energy[first]:+.1f}".replace("-", "−")
    speeds = f"{speed[first]:.1f} to {speed[last]:.1f}"
    return row(turn, name, f"{bank:.0f}°", speeds, change)


def recording_text(flights: Mapping[str, Array]) -> Iterator[str]:
    """Return both tables of docs/autopilot.md, by lines.

    Args:
        flights: the recorded one first, then ours, by name.
    """
    recorded, ours = list(flights.values())[:2]
    yield row("control law", "roll, RMS", "pitch, RMS")
    yield "|---|--:|--:|"
    yield row("before", *(f"{each}°" for each in EARLIER_DEG))
    yield rms_row(ours, recorded)
    yield ""
    yield row(
        "turn of the recording", "", "bank reached", "true airspeed, m/s", "change of h + V²/2g, m"
    )
    yield "|---|---|--:|--:|--:|"
    for turn, begin_s, end_s in TURNS:
        title = f"{turn}, {begin_s:.0f} to {end_s:.0f} s"
        for name, flight in flights.items():
            yield turn_row(title if flight is recorded else "", name, flight, begin_s, end_s)


def fast_row(each: Manoeuvres, ours: Array, prompt: Array, late: Array) -> str:
    """Return the table row of fast manoeuvres."""
    angles = [rms_deg(ours, prompt, angle) for angle in ("phi_rad", "theta_rad")]
    cells = [f"{then}° | {now:.2f}°" for then, now in zip(each.earlier_deg, angles, strict=True)]
    slower = (prompt["airspeed_mps"] - ours["airspeed_mps"]).max()
    equal = f"{rms_deg(ours, late, 'phi_rad'):.2f}°"
    return row(each.name, *cells, f"{slower:.1f} m/s", equal)


def fast_text(pairs: Mapping[Manoeuvres, tuple[Array, Array, Array]]) -> Iterator[str]:
    """Return the table of the fast manoeuvres, by lines."""
    heads = ("roll before", "now", "pitch before", "now", "slower by", "roll, equal latency")
    yield row("manoeuvres", *heads)
    yield "|---|--:|--:|--:|--:|--:|--:|"
    for each, flights in pairs.items():
        yield fast_row(each, *flights)


def drag_text(pitch_deg: Mapping[str, float]) -> str:
    """Return the sentence of SOURCE.md."""
    return (
        "RMS difference in pitch of the replay of the recorded flight (below): with the square "
        f"{pitch_deg['square']:.2f}°, with the magnitude in its place "
        f"{pitch_deg['magnitude']:.2f}°, with the signed value, as it was flown, "
        f"{pitch_deg['signed']:.2f}°."
    )


def main() -> None:
    """Replay, and print and insert the text."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser)
    options = parser.parse_args()
    recorded, ours = read(RECORDING), replay(RASCAL)
    with tempfile.TemporaryDirectory() as folder:
        airframe = make_recorded_airframe(Path(folder) / "recorded")
        same = replay(airframe, PROMPT)
        by_drag = {
            name: replay(make_airframe(Path(folder) / name, drag))
            for name, drag in (("magnitude", MAGNITUDE), ("signed", SIGNED))
        }
        fast = {each: fly_manoeuvres(Path(folder), airframe, each) for each in FAST}
    flights = {"recorded": recorded, "ours": ours, "airframe of the recording": same}
    pitch = {
        name: rms_deg(flight, recorded, "theta_rad")
        for name, flight in ({"square": ours} | by_drag).items()
    }
    parts = {
        MARK: "\n".join(recording_text(flights)),
        FAST_MARK: "\n".join(fast_text(fast)),
        DRAG_MARK: drag_text(pitch),
    }
    sys.exit(0 if publish(options, parts, INPUTS) else 1)


if __name__ == "__main__":
    main()
