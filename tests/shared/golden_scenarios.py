"""Short scenarios with windows, and flights of them, for the tests of golden tables."""

import copy

import testbed
from testbed.golden.golden_compare import GoldenFlight
from testbed.pool.scenario_snapshot import read_inputs
from testbed.scenario import loads

FOLLOWERS = ("uav1", "uav2", "uav3")
# Aircraft start in their slots, so they have joined in the first sample.
SCENARIO = """
extends: simulation-3
scenario:
  name: {name}
  duration_s: 14
  windows: {{rectangles: [4, 8], circles: [8, 14]}}
  published: null
fleet:
  - {{name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]{sensors}}}
  - {{name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]{sensors}}}
  - {{name: uav3, aircraft: rascal110, start_m: [-5, -5, 4]{sensors}}}
"""
LOWER_GAIN = "controller: {gain_scale: 0.9}"
# The slot of uav1 is below the ground, and the leader not far above it.
INTO_THE_GROUND = """
leader:
  start: {altitude_m: 20}
  path: {legs: [{kind: waypoints, points_m: [[640, 640, 20], [640, 2000, 20]]}]}
formation: {offsets_m: {uav1: [-5, 5, 40]}}
"""


def write(folder, name, *more, noisy=False):
    """Write a scenario with more sections into a folder, and return its path."""
    text = SCENARIO.format(name=name, sensors=", sensors: gps-ins" if noisy else "")
    path = folder / f"{name}.yaml"
    path.write_text("\n".join((text, *more)))
    return path


def scenario(*changes, noisy=False):
    text = SCENARIO.format(name="short", sensors=", sensors: gps-ins" if noisy else "")
    return loads(text, ["log.mcap=false", *changes])


def fly(seed, *changes, noisy=False):
    run = testbed.run(scenario(f"scenario.seed={seed}", *changes, noisy=noisy), write=False)
    return GoldenFlight(seed, run.metrics)


def inputs(*changes, noisy=False, folder):
    """Collect what decides the numbers of the scenario."""
    return read_inputs(scenario(*changes, noisy=noisy), folder)


def edited(flight, edit, *, seed=None):
    """Return a copy of the flight with its metrics changed by `edit`."""
    metrics = copy.deepcopy(flight.metrics)
    edit(metrics)
    return GoldenFlight(seed or flight.seed, metrics)


def files(folder):
    """Return the time of the last write of every file below a folder."""
    found = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in found}
