"""Write how the virtual autopilot follows the recording of one ArduPlane in tests/data.

usage: make arduplane

Replays its commands with our airframe, with that of the recording, and with other laws of the
elevator's drag.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from tables import insert_parts, row

from testbed.autopilot.parameters import AutopilotTiming
from testbed.core.frames import GRAVITY
from testbed.core.records import Array
from testbed.vehicle.replay_commands import respond

ROOT = Path(__file__).parent.parent
RASCAL = ROOT / "aircraft" / "rascal110"
RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
MARK, DRAG_MARK = "make arduplane, recording", "make arduplane, drag"
BEGIN_S, END_S = 2.0, 150.0  # in its first second the propeller had no torque on the airframe
# Of the control law without limits that turn with the attitude (commit 428ace9).
EARLIER_DEG = ("0.34", "0.40")
TURNS = (
    ("right, 45° commanded; 30 % throttle", 40.0, 50.0),
    ("left, 45° commanded; 30 % throttle", 50.0, 60.0),
    ("right, 40° and 8° of pitch commanded; 50 % throttle", 130.0, 145.0),
)
_DEFLECTION = "<property> fcs/elevator-pos-rad </property>"
# Laws of the elevator's drag: the lines in place of those of the square.
SIGNED = f"<value> 0.1 </value> {_DEFLECTION}"
MAGNITUDE = f"<value> 0.1 </value> <abs> {_DEFLECTION} </abs>"
_POWER_BY_MACH = {"left-aileron": ("0.13", "0.057"), "elevator": ("-0.5", "-0.275")}  # Mach 0, 2


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
    text = page.read_text(encoding="utf-8")
    for surface, (zero, two) in _POWER_BY_MACH.items():
        power = f"<property> fcs/{surface}-pos-rad </property> <value> {zero} </value>"
        assert text.count(power) == 1
        mach = "<independentVar> velocities/mach </independentVar>"
        by_mach = f"<table>{mach}<tableData>\n0 {zero}\n2 {two}\n</tableData></table>"
        text = text.replace(power, power.replace(f"<value> {zero} </value>", by_mach))
    page.write_text(text, encoding="utf-8")
    version = ' version="1.1"'
    assert version in propeller.read_text(encoding="utf-8")
    propeller.write_text(propeller.read_text(encoding="utf-8").replace(version, ""))
    return copy


def read(file: Path) -> Array:
    """Read a recording or a response, by column."""
    return np.genfromtxt(file, delimiter=",", names=True)


def replay(airframe: Path, timing: AutopilotTiming | None = None) -> Array:
    """Replay the commands of the recording, and return the response by column."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.csv"
        respond(airframe, RECORDING, out, timing=timing)
        return read(out)


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
    parser.add_argument("--into", type=Path, nargs="*", default=(), help="Markdown files")
    options = parser.parse_args()
    recorded, ours = read(RECORDING), replay(RASCAL)
    with tempfile.TemporaryDirectory() as folder:
        airframe = make_recorded_airframe(Path(folder) / "recorded")
        same = replay(airframe, AutopilotTiming(command_latency=0.0))
        by_drag = {
            name: replay(make_airframe(Path(folder) / name, drag))
            for name, drag in (("magnitude", MAGNITUDE), ("signed", SIGNED))
        }
    flights = {"recorded": recorded, "ours": ours, "airframe of the recording": same}
    pitch = {
        name: rms_deg(flight, recorded, "theta_rad")
        for name, flight in ({"square": ours} | by_drag).items()
    }
    parts = {MARK: "\n".join(recording_text(flights)), DRAG_MARK: drag_text(pitch)}
    print(*parts.values(), sep="\n\n")
    insert_parts(options.into, parts)


if __name__ == "__main__":
    main()
