"""A small study of unicycle vehicles, and a worker pool that flies it in this process."""

import pickle
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from unittest.mock import patch

import pytest
from cases import ALL

from testbed.plan.world import versions
from testbed.pool.flight_task import FlightResult, FlightTask, run_task

STUDY = """
study:
  schema: 1
  name: small
  scenario: ideal-figure-eight
  duration_s: 1
  set: {rates: {physics_hz: 50, autopilot_hz: 50, control_hz: 25, broadcast_hz: 25, log_hz: 25}}
  design: factorial
  seeds: [3, 1]
  metrics: [windows.approach.mean_rms_m]
vary:
  network.loss: [0, 0.4]
cases:
  near: {}
  far: {"fleet.uav1.start_m": [-90, 30, 0]}
"""
RUNS = 8


def write(folder, text=STUDY, name="small"):
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def as_by_a_process(value):
    """Copy a task or a result as a worker process receives or returns it."""
    return pickle.loads(pickle.dumps(value))


@dataclass
class InThisProcess:
    """Worker pool that flies in this process, and records the numbers of its tasks."""

    finished: list[int] = field(default_factory=list)
    every_seed: bool = False  # may change the numbers of each point
    fly: Callable[[FlightTask], FlightResult] = run_task

    def capacity(self):
        return 1

    def submit(self, task):
        self.finished.append(task.number)
        future = Future()
        if self.fly is run_task:  # a made-up result costs less than the copies
            result = as_by_a_process(run_task(as_by_a_process(task)))
        else:
            result = self.fly(task)
        future.set_result(replace(result, depends_on_seed=True) if self.every_seed else result)
        return future

    def lost_worker(self, error):
        return False

    def shutdown(self):
        pass


@dataclass
class FlownOnce(InThisProcess):
    """Workers that fly a scenario once: that it repeats to the bit is claimed by `test_sweep`."""

    results: dict[tuple[int, str], FlightResult] = field(default_factory=dict)

    def __post_init__(self):
        self.fly = self._fly_once

    def _fly_once(self, task):
        key = task.number, task.scenario.model_dump_json()
        if key not in self.results:
            self.results[key] = as_by_a_process(run_task(as_by_a_process(task)))
        return self.results[key]


def in_this_process():
    """Fly what a command flies in this process until the block ends: workers start in seconds."""
    return patch("testbed.pool.flight_pool._open_workers", lambda *_: InThisProcess())


def use(monkeypatch, workers):
    """Fly with these workers in place of processes, and return them."""
    monkeypatch.setattr("testbed.pool.flight_pool._open_workers", lambda *_: workers)
    return workers


def check_little(patch):
    """Before a study is flown, read few of its scenarios and build none: tests of plans do."""
    patch.setattr("testbed.studies.plan_check.MAX_CHECKED", 3)
    patch.setattr("testbed.studies.plan_check.MAX_BUILT", 0)


@pytest.fixture(scope="module", autouse=not ALL)
def few_checked():
    """For all tests of a module that imports it."""
    with pytest.MonkeyPatch.context() as each:
        check_little(each)
        yield


@dataclass
class Backwards(InThisProcess):
    """Workers of several flights at once, of which the last one always ends first."""

    size: int = 3
    held: list[tuple[Future, FlightTask]] = field(default_factory=list)

    def capacity(self):
        for future, task in reversed(self.held):
            self.finished.append(task.number)
            future.set_result(self.fly(task))
        self.held.clear()
        return self.size

    def submit(self, task):
        future = Future()
        self.held.append((future, task))
        return future


def made_result(task, number, outcome="completed", *, depends_on_seed=True):
    """Return a made-up result of a task, with a number as mean RMS error of the approach."""
    metrics = {"versions": versions(), "windows": {"approach": {"mean_rms_m": number}}}
    error = "" if outcome == "completed" else f"{outcome}: uav1 at 3.0 s"
    return FlightResult(task.number, outcome, error, metrics, 0.0, depends_on_seed)


def content(table):
    """Return the columns to the bit, and the metadata: what must not depend on the workers."""
    columns = {
        name: (values.dtype, [repr(value) for value in values.tolist()])
        for name, values in table.columns.items()
    }
    return columns, dict(table.metadata)


# A law that fails in flight.
TORN_LAW = """
class Torn:
    def __init__(self, config):
        self.builtin = config.hbh23

    def start(self, own):
        return self.builtin.start(own)

    def step(self, now, own, inbox, memory):
        if now > 0.5:
            raise RuntimeError("torn")
        return self.builtin.step(now, own, inbox, memory)
"""
