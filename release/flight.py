"""Fly an installed testbed from an empty folder, as its users do: scenario, aircraft, law, check.

usage: python release/flight.py PROGRAM FOLDER

PROGRAM is the installed command `formation-testbed`; FOLDER is created. Standard library only: it
also runs where only the wheel is installed, on any system.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

DURATION_S = 20
MASS = '<pointmass name="camera"><weight unit="KG"> 0.3 </weight><location unit="IN">'
PLACE = "<x> 37.4 </x><y> 0 </y><z> 0 </z></location></pointmass>"
SCENARIO = f"""
extends: simulation-3
scenario:
  name: mine
  duration_s: {DURATION_S}
  windows: {{settled: [10, {DURATION_S}], rectangles: null, circles: null}}
  published: null
fleet:
  - {{name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]}}
  - {{name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]}}
  - {{name: uav3, aircraft: ./mine_rascal, start_m: [-5, -5, 4]}}
controller: {{law: my_law:Pursuit, options: {{gain: 0.3}}}}
"""
LAW = '''
import numpy as np

from testbed.law import command_from_velocity


class Pursuit:
    """Fly at the leader's velocity, and towards the slot."""

    def __init__(self, config, *, gain):
        self.config, self.gain = config, gain

    def start(self, own):
        return None

    def step(self, now, own, inbox, memory):
        received = np.isfinite(inbox.stamp_s[:, :1])
        leader = np.where(received, inbox.velocity_ned[:, 0], own.velocity_ned)
        ahead = leader / np.linalg.norm(leader, axis=1, keepdims=True)
        right = np.cross([0.0, 0.0, 1.0], ahead)
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        axes = np.stack([ahead, right, np.cross(ahead, right)], axis=2)
        offset = np.einsum("nij,nj->ni", axes, self.config.offsets[self.config.agents])
        error = np.where(received, inbox.position_ned[:, 0] + offset - own.position_ned, 0.0)
        velocity = leader + self.gain * error
        return command_from_velocity(self.config, own, velocity), memory
'''


class FlightError(Exception):
    """Command with another result than expected."""


def main(arguments: list[str]) -> int:
    """Fly; return 1 if a command has another result than expected."""
    program, folder = Path(arguments[0]).absolute(), Path(arguments[1])
    folder.mkdir(parents=True)
    try:
        for line in fly(program, folder):
            print(line, flush=True)
    except FlightError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def fly(program: Path, folder: Path) -> Iterator[str]:
    """Fly from an empty folder; yield a line for each step.

    Args:
        program: `formation-testbed` of an environment without extras.
        folder: an empty folder.

    Raises:
        FlightError: a command has another result than expected.
    """
    words = ("run", "simulation-3", "--duration", str(DURATION_S), "--out", "run")
    table = call(program, folder, *words)
    if "RMS error" in table or "smallest separation" not in table:
        raise FlightError(f"unexpected table of {DURATION_S} s:\n{table}")
    check_outcome(folder / "run")
    if [each.name for each in folder.iterdir()] != ["run"]:
        raise FlightError("the flight wrote more than its run")
    yield f"{DURATION_S} s of Simulation 3 flown by name from an empty directory"
    write_own(program, folder)
    call(program, folder, "validate", "mine.yaml")
    call(program, folder, "run", "mine.yaml", "--quiet", "--out", "mine")
    check_outcome(folder / "mine")
    reason = ("--update", "--reason", "first flights", "--seeds", "3")
    call(program, folder, "check", "mine.yaml", *reason)
    call(program, folder, "check", "mine.yaml")
    slower = (folder / "mine.yaml").read_text(encoding="utf-8").replace("gain: 0.3", "gain: 0.2")
    (folder / "mine.yaml").write_text(slower, encoding="utf-8")
    changed = call(program, folder, "check", "mine.yaml", code=3)
    if "controller.options.gain from 0.3 to 0.2" not in changed:
        raise FlightError(f"check does not name the changed gain:\n{changed}")
    yield "an own scenario, aircraft and law flown, and checked against an own golden table"


def check_missing(program: Path, folder: Path) -> str:
    """Check that a command whose extra is missing names it; return a line about it."""
    text = call(program, folder, "view", "run", "--rrd", "run.rrd", code=2)
    expected = 'rerun is not installed; write pip install "formation-testbed[view]"'
    if not text.rstrip().endswith(expected):
        raise FlightError(f"view without its extra prints:\n{text}")
    return "without extras: no viewer, and an error line that names its extra"


def check_extras(program: Path, folder: Path) -> str:
    """Use each extra once on the flight in `folder`; return a line about it."""
    call(program, folder, "view", "run", "--rrd", "run.rrd")
    call(program, folder, "report", "run")
    call(program, folder, "export", "run", "--format", "parquet")
    study = (
        "study: {schema: 1, name: two, scenario: mine.yaml, seeds: 1, design: factorial}\n"
        "vary: {controller.options.gain: [0.2, 0.3]}\n"
    )
    (folder / "two.yaml").write_text(study, encoding="utf-8")
    call(program, folder, "sweep", "two.yaml", "--out", "two")
    call(program, folder, "study-report", "two")
    words = ("run", "simulation-3", "--duration", "1", "--quiet", "--out", "linked")
    call(program, folder, *words, "--mavlink", "14999", "--pace", "0")
    made = ("run.rrd", "run/report.html", "run/run.parquet", "two/report.html", "linked/run.mcap")
    if missing := [each for each in made if not (folder / each).is_file()]:
        raise FlightError(f"not written: {', '.join(missing)}")
    return "with all extras: recording, reports, a study, Parquet and MAVLink links"


def write_own(program: Path, folder: Path) -> None:
    """Write an own aircraft, law and scenario."""
    python = next(program.parent.glob("python*"))
    code = "from testbed.scenario import find_aircraft; print(find_aircraft('rascal110'))"
    found = call(python, folder, "-c", code).strip()
    shutil.copytree(found, folder / "mine_rascal")
    model = folder / "mine_rascal" / "mine_rascal.xml"
    (folder / "mine_rascal" / "rascal110.xml").rename(model)
    text = model.read_text(encoding="utf-8")
    model.write_text(text.replace("</mass_balance>", f"{MASS}{PLACE}</mass_balance>"), "utf-8")
    (folder / "my_law.py").write_text(LAW, encoding="utf-8")
    (folder / "mine.yaml").write_text(SCENARIO, encoding="utf-8")


def check_outcome(run: Path) -> None:
    """Check that a run was completed."""
    numbers = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    if numbers["outcome"] != "completed":
        raise FlightError(f"outcome of {run.name}: {numbers['outcome']}")


def call(program: Path, folder: Path, *words: str, code: int = 0) -> str:
    """Run a command without the variables of this Python; return what it prints.

    Raises:
        FlightError: its exit code is not `code`.
    """
    variables = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        (str(program), *words),
        cwd=folder,
        env={**variables, "COLUMNS": "120", "PYTHONUTF8": "1"},
        capture_output=True,
        encoding="utf-8",
    )
    output = done.stdout + done.stderr
    if done.returncode != code:
        raise FlightError(f"{' '.join(words)}: exit code {done.returncode}\n{output}")
    return output


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
