"""The command that tries an ArduPlane and explains a parameter file: arduplane."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from json import dumps as quote
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import JsonFile, value_option
from testbed.cli.output import (
    PipeSafeConsole,
    message_console,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from testbed.core.records import Array, Event, RunInfo, Sample
    from testbed.runs.external_options import ExternalOptions
    from testbed.runs.run import Run

FLOWN_S, SETTLED_S = 20.0, 5.0
# RMS differences from the virtual autopilot; ArduPlane 4.8.0-dev had 0.1 m and 0.2 degrees
MOST_M, MOST_DEG = 5.0, 3.0
_SHOWN = 8  # names of a kind of parameters
# A corner with a climb, at 7 s; the follower is there because a formation needs one.
_SCENARIO = """
scenario: {{schema: 2, name: arduplane-check, duration_s: {seconds:g}}}
rates: {{physics_hz: 200}}
leader:
  aircraft: {aircraft}
  tune: {tune}
  {autopilot}
  path:
    kind: mission
    airspeed_mps: {airspeed:g}
    legs: [{{kind: waypoints, points_m: [[{corner:g}, 0, 100], [{corner:g}, 2000, 200]]}}]
fleet: [{{name: uav1, aircraft: {aircraft}, vehicle: unicycle, start_m: [-50, 0, 0]}}]
formation: {{offsets_m: {{uav1: [-50, 0, 0]}}, leader_gains: {{uav1: 1}}}}
"""


class Action(str, Enum):
    """What to do."""

    check = "check"
    params = "params"


def arduplane_command(
    action: Annotated[
        Action,
        typer.Argument(
            help="check: start one ArduPlane and fly 20 s with it. params: show how a parameter "
            "file is used by ArduPlane and by the virtual autopilot."
        ),
    ],
    param: Annotated[
        str,
        typer.Argument(
            metavar="[FILE]", help="Parameters: a tune of the aircraft, or a .param file."
        ),
    ] = "autopilot",
    aircraft: Annotated[
        str, value_option("AIRCRAFT", "Name or folder of the aircraft.", "--aircraft")
    ] = "rascal110",
    arduplane: Annotated[
        Path | None,
        value_option("PATH", "ArduPlane binary.  \\[default: the environment variable ARDUPLANE]"),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Try an ArduPlane, or explain a parameter file.

    check: exit code 0 if it flies like the virtual autopilot, 1 if it does not, 2 if it cannot be
    started, 5 if it ends or does not answer.
    """
    from testbed.scenario import find_aircraft, find_tune

    folder = find_aircraft(aircraft)
    tune = find_tune(folder, param).resolve()
    if action is Action.params:
        _show_params(tune, json)
        return
    document = check_arduplane(folder.resolve(), tune, arduplane, message_console().write_line)
    write_json_output(json, document)
    _show_check(document, result_console(json))
    if not document["ok"]:
        raise typer.Exit(ExitCode.AIRCRAFT_LOST)


class _Track:
    """Keep the leader's motion, and when its flight began on the wall clock."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, Array, Array]] = []
        self.events: list[Event] = []
        self.began_s = self.ended_s = 0.0

    def begin(self, info: RunInfo) -> None:
        """Need nothing of the run."""

    def observe(self, sample: Sample) -> None:
        """Keep a sample."""
        self.ended_s = time.monotonic()
        self.began_s = self.began_s or self.ended_s
        self.events += sample.events
        truth = sample.truth
        self.rows.append((sample.time_s, truth.position_ned[0], truth.euler[0]))

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Keep the last events."""
        self.events += events


def check_arduplane(
    folder: Path, tune: Path, arduplane: Path | None, announce: Callable[[str], None]
) -> dict[str, Any]:
    """Fly an aircraft with ArduPlane and with the virtual autopilot; return a JSON document.

    Args:
        folder: of the aircraft.
        tune: parameter file of both.
        arduplane: the program; None: that of the environment.
        announce: receives the ports.

    Raises:
        InputError: there is no program, or it cannot be started or flown with the parameters.
        ExternalProgramLost: it ends, or does not answer.
    """
    from testbed.ardupilot.sitl_parameters import tune_report
    from testbed.ardupilot.sitl_process import find_binary
    from testbed.autopilot.parameters import read_params
    from testbed.runs.external_options import ExternalOptions

    binary = find_binary(arduplane)
    airspeed = read_params(tune).airspeed_cruise
    external = ExternalOptions(arduplane=binary, announce=announce)
    real, virtual = _Track(), _Track()
    own = "autopilot: {kind: virtual, gyro_filter: sitl}"
    _fly(folder, tune, airspeed, own, virtual, external)
    started_s = time.monotonic()
    result = _fly(folder, tune, airspeed, "autopilot: ardupilot", real, external)
    use = tune_report(tune).use
    document: dict[str, Any] = {
        "binary": str(binary),
        "version": result.metrics["arduplane"]["leader"],
        "parameters": {kind: len(names) for kind, names in use._asdict().items()},
        "outcome": result.outcome,
        "startup_s": real.began_s - started_s,
        "flown_s": real.rows[-1][0],
        "real_time_factor": real.rows[-1][0] / max(real.ended_s - real.began_s, 1e-9),
        "warnings": [e.text for e in real.events if e.level == "warning" and e.source == "leader"],
        "difference": _difference(real, virtual),
    }
    difference = document["difference"]
    document["ok"] = (
        result.outcome == "completed"
        and not document["warnings"]
        and difference["track_m"] <= MOST_M
        and max(difference["roll_deg"], difference["pitch_deg"]) <= MOST_DEG
    )
    return document


def _fly(
    folder: Path,
    tune: Path,
    airspeed: float,
    autopilot: str,
    track: _Track,
    external: ExternalOptions,
) -> Run:
    from testbed.runs.run import run
    from testbed.scenario import loads

    text = _SCENARIO.format(
        seconds=FLOWN_S,
        aircraft=quote(str(folder)),
        tune=quote(str(tune)),
        autopilot=autopilot,
        airspeed=airspeed,
        corner=7.0 * airspeed,
    )
    return run(loads(text), write=False, observers=[track], external=external)


def _difference(real: _Track, virtual: _Track) -> dict[str, float]:
    """Compute RMS differences from 5 s on."""
    import numpy as np

    pairs = [
        (mine[1] - other[1], mine[2] - other[2])
        for mine, other in zip(real.rows, virtual.rows, strict=False)
        if mine[0] >= SETTLED_S
    ]
    track, euler = (np.array(each) for each in zip(*pairs, strict=True))
    roll, pitch = np.degrees(np.sqrt(np.mean(np.square(euler[:, :2]), axis=0))).tolist()
    distance = float(np.sqrt(np.mean(np.sum(np.square(track), axis=1))))
    return {"track_m": distance, "roll_deg": roll, "pitch_deg": pitch}


def _show_check(document: Mapping[str, Any], console: PipeSafeConsole) -> None:
    counts, difference = document["parameters"], document["difference"]
    given = counts["both"] + counts["arduplane"]
    lines = {
        "ArduPlane": f"{document['version']}, {document['binary']}",
        "parameters": (
            f"{given} of the file, {counts['hardware']} left out, {counts['link']} replaced by the "
            f"link, {counts['renamed']} with older names"
        ),
        "startup": f"{document['startup_s']:.1f} s",
        "flight": (
            f"{document['flown_s']:g} s at {document['real_time_factor']:.1f} × real time: "
            f"{document['outcome']}"
        ),
        "against virtual": (
            f"track {difference['track_m']:.2f} m, roll {difference['roll_deg']:.2f}°, pitch "
            f"{difference['pitch_deg']:.2f}° RMS from {SETTLED_S:g} s on"
        ),
    }
    for title, text in lines.items():
        console.write_line(f" {title:<17}{text}")
    for text in document["warnings"]:
        console.write_line(f" {'warning':<17}{text}", "yellow")
    limits = f"{MOST_M:g} m, {MOST_DEG:g}°"
    if document["ok"]:
        console.write_line(f" {'result':<17}flies like the virtual autopilot (within {limits})")
    else:
        console.write_line(
            f" {'result':<17}does not fly like the virtual autopilot (within {limits}, without "
            "warnings)",
            "red",
        )


def _show_params(tune: Path, json: Path | None) -> None:
    from testbed.ardupilot.sitl_parameters import tune_report

    report = tune_report(tune)
    use = report.use
    lists = {each: getattr(report, each) for each in ("unknown", "differences", "notes")}
    write_json_output(json, {"file": str(tune), **use._asdict(), **lists})
    console = result_console(json)
    console.write_line(f" {tune}")
    for old, new in use.renamed.items():
        console.write_line(f" {'older name':<22}{old} is {new}")
    for title, names in (
        ("both autopilots", use.both),
        ("ArduPlane only", use.arduplane),
        ("set by the link", use.link),
        ("left out: hardware", use.hardware),
    ):
        console.write_line(f" {title:<22}{_some(names)}")
    for text in report.differences:
        console.write_line(f" {'difference':<22}{text}")
    if report.unknown:
        console.write_line(
            f" {'not known':<22}{_some(report.unknown)}: may make ArduPlane fly differently",
            "yellow",
        )
    for text in report.notes:
        console.write_line(f" {'note':<22}{text}", "yellow")


def _some(names: Sequence[str]) -> str:
    more = f", … {len(names)} in all" if len(names) > _SHOWN else ""
    return (", ".join(names[:_SHOWN]) or "none") + more
