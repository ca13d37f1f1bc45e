"""Measure the cost of a whole run relative to bare JSBSim steps.

Both are measured in one process, alternating, on the same aircraft files. Bare: the same aircraft
in trim with constant controls, and nothing but `run()` at 200 Hz with JSBSim's default integrators,
in the order of a flight; it restarts every minute of flight, so that no aircraft reaches the
ground. Full: `testbed.run` with the log and without a viewer, at the scenario's rate and at 200 Hz.
Building the simulation is measured separately.
"""

from __future__ import annotations

import gc
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.core.records import Event, Observer, RunInfo, Sample
from testbed.plan.world import build
from testbed.runs.run import run
from testbed.scenario import Scenario, with_values
from testbed.vehicle.environment import EULER
from testbed.vehicle.fleet import JsbsimFleet

SEGMENT_S, BARE_HZ = 60.0, 200


@dataclass(frozen=True, slots=True)
class Cost:
    """Wall-clock seconds, and processor seconds of this process."""

    wall_s: float
    processor_s: float

    def __add__(self, other: Cost) -> Cost:
        """Add both times."""
        return Cost(self.wall_s + other.wall_s, self.processor_s + other.processor_s)

    def __truediv__(self, other: Cost) -> Cost:
        """Return both ratios."""
        return Cost(self.wall_s / other.wall_s, self.processor_s / other.processor_s)


def now() -> Cost:
    """Return both clocks; only differences have a meaning."""
    return Cost(time.perf_counter(), time.process_time())


def since(began: Cost) -> Cost:
    """Return the time spent since then."""
    ended = now()
    return Cost(ended.wall_s - began.wall_s, ended.processor_s - began.processor_s)


class Stopwatch(Observer):
    """Measure the flight, without building and closing."""

    zero_copy = True  # keeps no array of a sample

    def begin(self, info: RunInfo) -> None:
        """Start the clock."""
        self.cost = Cost(0.0, 0.0)
        self._began = now()

    def observe(self, sample: Sample) -> None:
        """Do nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Stop the clock."""
        self.cost = since(self._began)


def at_rate(scenario: Scenario, rate_hz: int, *, log: bool = True) -> Scenario:
    """Return the scenario with another rate of the flight models, and with or without a log."""
    changes = [(("rates", "physics_hz"), rate_hz), (("log", "mcap"), log)]
    return with_values(scenario, changes)


def bare(scenario: Scenario, seconds: float) -> Cost:
    """Measure the flight models' steps alone.

    Args:
        scenario: scenario with the aircraft.
        seconds: duration of the flight, s.
    """
    spent, changes = Cost(0.0, 0.0), [(("scenario", "engine"), "jsbsim")]
    scenario = with_values(at_rate(scenario, BARE_HZ), changes)
    # of one aircraft before the next, as in a run
    steps_per_period = BARE_HZ // scenario.rates.autopilot_hz
    rounds = round(seconds * scenario.rates.autopilot_hz)
    most = round(SEGMENT_S * scenario.rates.autopilot_hz)
    while rounds > 0:
        fleet = build(scenario).fleet
        if not isinstance(fleet, JsbsimFleet):
            raise SystemExit(f"{scenario.name}: has no flight model")
        runs, steps = fleet.bare_runs(), range(steps_per_period)
        for step in runs:
            for state in ("rate", "position"):  # JSBSim's defaults, which cost least
                step.__self__[f"simulation/integrator/{state}/rotational"] = EULER
        gc.collect()
        began = now()
        for _ in range(min(rounds, most)):
            for step in runs:
                for _ in steps:
                    step()
        spent += since(began)
        rounds -= most
    return spent


def full(scenario: Scenario, *watching: Observer) -> tuple[Cost, float]:
    """Measure a flight, and the wall-clock seconds of building and closing, s."""
    watch, last_s = Stopwatch(), scenario.scenario.duration_s - 1.0
    with tempfile.TemporaryDirectory() as folder:
        gc.collect()
        began = now()
        out, watchers = Path(folder) / "run", [watch, *watching]
        flown = run(scenario, out=out, observers=watchers)
        whole = since(began)
    if any(flown.metrics["lost_at_s"].values()) or flown.metrics["simulated_s"] < last_s:
        raise SystemExit(f"{scenario.name}: {flown.outcome}: a lost aircraft costs nothing")
    return watch.cost, whole.wall_s - watch.cost.wall_s


@dataclass(frozen=True, slots=True)
class Turn:
    """Flights between two halves of the bare loop, against drift."""

    bare: Cost
    full: Cost
    at_bare_hz: Cost  # the flight at the rate of the bare loop
    no_log: Cost  # the same without a log
    build_s: float

    @property
    def ratio(self) -> Cost:
        """Full / bare."""
        return self.full / self.bare


def turn(scenario: Scenario) -> Turn:
    """Measure one turn."""
    half = scenario.scenario.duration_s / 2.0
    before = bare(scenario, half)
    cost, built = full(scenario)
    at_bare_hz, _ = full(at_rate(scenario, BARE_HZ))
    no_log, _ = full(at_rate(scenario, BARE_HZ, log=False))
    return Turn(before + bare(scenario, half), cost, at_bare_hz, no_log, built)


def flight_models(scenario: Scenario) -> int:
    """Return how many of the aircraft are flight models."""
    leads = scenario.leader.path.kind == "mission" and scenario.leader.vehicle == "jsbsim"
    return int(leads) + sum(each.vehicle == "jsbsim" for each in scenario.fleet)


def median(costs: Sequence[Cost]) -> Cost:
    """Return the medians of both times."""
    return Cost(
        statistics.median(each.wall_s for each in costs),
        statistics.median(each.processor_s for each in costs),
    )
