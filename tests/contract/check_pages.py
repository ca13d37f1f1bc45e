"""Short pages with portions, and flights of them, for the tests of golden tables."""

import copy

import testbed
from testbed.scenario import loads
from testbed.study.flights import Flight
from testbed.study.golden_page import digests, page_kept

FOLLOWERS = ("uav1", "uav2", "uav3")
# Aircraft start in their slots: engaged from the first frame on.
PAGE = """
extends: simulation-3
scenario:
  name: {name}
  duration_s: 14
  portions: {{rectangles: [4, 8], circles: [8, 14]}}
  published: null
fleet:
  - {{name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]{sensors}}}
  - {{name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]{sensors}}}
  - {{name: uav3, aircraft: rascal110, start_m: [-5, -5, 4]{sensors}}}
"""
LESS_GAIN = "controller: {gain_scale: 0.9}"
# A slot below the ground, and the leader not far above it.
INTO_THE_GROUND = """
leader:
  start: {altitude_m: 20}
  path: {legs: [{kind: waypoints, points_m: [[640, 640, 20], [640, 2000, 20]]}]}
formation: {offsets_m: {uav1: [-5, 5, 40]}}
"""


def write(folder, name, *more, noisy=False):
    """A page in this folder, with more sections."""
    text = PAGE.format(name=name, sensors=", sensors: gps-ins" if noisy else "")
    path = folder / f"{name}.yaml"
    path.write_text("\n".join((text, *more)))
    return path


def page(*changes, noisy=False):
    text = PAGE.format(name="short", sensors=", sensors: gps-ins" if noisy else "")
    return loads(text, ["log.mcap=false", *changes])


def fly(seed, *changes, noisy=False):
    flown = testbed.run(page(f"scenario.seed={seed}", *changes, noisy=noisy), write=False)
    return Flight(seed, flown.metrics)


def context(*changes, noisy=False, folder):
    chosen = page(*changes, noisy=noisy)
    return {"page": page_kept(chosen, folder), "files": digests(chosen)}


def edited(flight, edit, *, seed=None):
    """The flight with its metrics changed by `edit`."""
    metrics = copy.deepcopy(flight.metrics)
    edit(metrics)
    return Flight(seed or flight.seed, metrics)


def files(folder):
    """Every file below a folder, and when it was last written."""
    found = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in found}
