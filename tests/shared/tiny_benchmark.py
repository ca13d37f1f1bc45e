"""A benchmark of two tasks of 8 s and few seeds, flown in this process's copies, for tests."""

import hashlib
import json
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from cases import ALL

from testbed.benchmark import campaign, probes, result, verify
from testbed.benchmark.campaign import Campaign, fly_campaign, practice_seeds
from testbed.benchmark.entry import open_entries
from testbed.benchmark.limited_flight import FlightLimits
from testbed.benchmark.seeds import PRACTICE
from testbed.benchmark.task import default_folder
from testbed.pool.flight_task import run_task

LIMITS = FlightLimits(cpu_s=30, wall_s=60)
SEEDS = PRACTICE if ALL else PRACTICE[:2]
FLIGHTS = 2 * len(SEEDS)  # of an entry
LAW = '''"""{doc}"""
import numpy as np
from testbed.law import FbwaCommand
{top}

class Law:
    def __init__(self, config, roll=0.0):
        self.config = config

    def start(self, own):
        return None

    def step(self, now, own, inbox, memory):
        {step}
        n = len(own.airspeed)
        trim = self.config.trim_throttle * np.ones(n)
        return FbwaCommand(np.zeros(n), np.zeros(n), trim), memory
'''
TASK = """task:
  schema: 1
  name: {name}
  question: Does it fly?
  scenario: four.yaml
  duration_s: 8
  window_s: [4, 8]
  set: {{leader.path.bank_limit_deg: {bank}}}

levels:
  - draw:
      starts_m: [4, 4, 2]
      legs_m: [200, 250]
      turns_deg: [40, 50]
      sides: both
      climbs_m: [0, 0]
      wind_mps: [0, 1]
"""


class Here:
    """A pool that flies in this process, up to a number of flights.

    Attributes:
        flown: tasks.
        most: so many tasks until it is interrupted.
        results: of the flights, each with all that it is flown with.
        known: results of flights that need not be flown.
    """

    def __init__(self, most=10_000):
        self.flown, self.most = [], most
        self.results, self.known = [], []

    def run(self, tasks):
        for task in tasks:
            if len(self.flown) == self.most:
                raise KeyboardInterrupt
            self.flown.append(task)
            given = task.measure.func, task.measure.args
            found = [result for flight, result in self.known if flight == given]
            result = replace(found[0], number=task.number) if found else run_task(task)
            self.results.append((given, result))
            yield result


def fly_here(patch, here=None) -> Here:
    """Let campaigns fly these seeds in a pool of this process, without margins of the entries."""
    here = here or Here()
    for module in (campaign, verify):
        patch.setattr(module, "open_flight_pool", lambda **_: nullcontext(here))
    for module in (campaign, result):
        patch.setattr(module, "PRACTICE", SEEDS)
    patch.setattr(probes, "BANKS_DEG", ())  # of which test_probes has one
    return here


def write_tasks(folder: Path) -> Path:
    """Write the benchmark."""
    folder.mkdir()
    shutil.copy(default_folder() / "four.yaml", folder)
    for name, bank in (("gentle", 20), ("steep", 40), ("tuning", 30)):
        (folder / f"{name}.yaml").write_text(TASK.format(name=name, bank=bank))
    files = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("*.yaml"))
    }
    manifest = {
        "benchmark": "tiny 1.0",
        "tasks": ["gentle", "steep"],
        "tuning_tasks": ["tuning"],
        "files": files,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def write_law(path: Path, *, top="", step="pass", doc="Fly straight on.") -> str:
    """Write a law that flies straight on; return its word on a command line."""
    path.write_text(LAW.format(top=top, step=step, doc=doc))
    return f"{path}:Law"


def fly(words, folder, tasks, *, limits=LIMITS, settings=(), only=(), report=print):
    """Fly entries on the tiny benchmark, and return their results by name."""
    entries = open_entries(words, settings)
    campaign = Campaign(entries, practice_seeds(), folder, limits=limits, tasks=tasks, only=only)
    return {each.entry.name: each for each in fly_campaign(campaign, report=report)}
