"""What everything around the flight model costs: a whole run against bare JSBSim stepping.

Both are measured in one process, in turns, on the same aircraft files at the same rate, for the
same number of steps in the same order. Bare is the same aircraft, trimmed, their controls left
alone, and nothing but `run()`; it starts anew every minute of flight so that no uncontrolled
aircraft reaches the ground. Full is `testbed.run` with the log on and no viewer, everything
included but the building of the world, which is told apart.
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

from rooms import Rooms

from testbed.scenario import Scenario
from testbed.sim.run import run
from testbed.sim.world import build
from testbed.state import Event, Frame, Observer, RunInfo
from testbed.vehicle.crew import crew_of

SEGMENT_S = 60.0


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds by the clock on the wall, and of this process's processor time."""

    wall_s: float
    processor_s: float

    def __add__(self, other: Cost) -> Cost:
        """One after the other."""
        return Cost(self.wall_s + other.wall_s, self.processor_s + other.processor_s)

    def __truediv__(self, other: Cost) -> Cost:
        """Both ratios."""
        return Cost(self.wall_s / other.wall_s, self.processor_s / other.processor_s)


def now() -> Cost:
    """What was spent until now, from moments that mean nothing."""
    return Cost(time.perf_counter(), time.process_time())


def since(began: Cost) -> Cost:
    """What was spent since then."""
    ended = now()
    return Cost(ended.wall_s - began.wall_s, ended.processor_s - began.processor_s)


class Stopwatch(Observer):
    """Measures the flight, without building and closing."""

    borrows = True  # keeps no array of a frame: copies would be made for it

    def begin(self, info: RunInfo) -> None:
        """Start."""
        self.cost = Cost(0.0, 0.0)
        self._began = now()

    def observe(self, frame: Frame) -> None:
        """Nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Stop."""
        self.cost = since(self._began)


def bare(page: Scenario, seconds: float, *, held: bool = False) -> Cost:
    """What nothing but the flight models' steps costs, for so many seconds of flight.

    Args:
        page: whose aircraft.
        seconds: of flight.
        held: controls are set, at their trim, and motions read as often as autopilots do it: what
            any loop round these models costs at least.
    """
    rate, spent = page.rates.physics_hz, Cost(0.0, 0.0)
    abreast = rate // page.rates.autopilot_hz  # steps of one aircraft before the next, as in a run
    rounds = round(seconds * page.rates.autopilot_hz)
    most = round(SEGMENT_S * page.rates.autopilot_hz)
    while rounds > 0:
        fleet = build(page).fleet
        if fleet is None:
            raise SystemExit(f"{page.name}: no flight model in it to compare with")
        runs, steps, trimmed = fleet.bare_runs(), range(abreast), fleet.trimmed
        gc.collect()
        began = now()
        for _ in range(min(rounds, most)):
            if held:
                fleet.look()
                fleet.step(trimmed, abreast)
                continue
            for step in runs:
                for _ in steps:
                    step()
        spent += since(began)
        rounds -= most
    return spent


def full(page: Scenario, *watching: Observer, processes: int = 1) -> tuple[Cost, float]:
    """What a flight costs, and the wall-clock seconds of building its world and closing its log."""
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        gc.collect()
        began = now()
        out, watchers = Path(folder) / "run", [watch, *watching]
        flown = run(page, out=out, observers=watchers, processes=processes)
        whole = since(began)
    if flown.outcome != "flown":
        raise SystemExit(f"{page.name}: {flown.outcome}, and what is lost costs nothing")
    return watch.cost, whole.wall_s - watch.cost.wall_s


@dataclass(frozen=True, slots=True)
class Turn:
    """A flight, and one that is looked at, between two halves of the bare loop: machines drift."""

    bare: Cost
    full: Cost
    looked_at: Cost
    build_s: float
    held: Cost  # the bare loop with controls set and motions read
    crewed: Cost | None  # stepped by as many processes as are best; None: that is one

    @property
    def ratio(self) -> Cost:
        """Full over bare."""
        return self.full / self.bare


def turn(page: Scenario, rooms: Rooms) -> Turn:
    """Measure once; in the second flight it is looked which room takes the time."""
    half, processes = page.scenario.duration_s / 2.0, crew_of(flight_models(page))
    before = bare(page, half)
    cost, built = full(page)
    with rooms.within():
        looked_at, _ = full(page, rooms)
    crewed = full(page, processes=processes)[0] if processes > 1 else None
    held = bare(page, 2.0 * half, held=True)
    return Turn(before + bare(page, half), cost, looked_at, built, held, crewed)


def flight_models(page: Scenario) -> int:
    """How many of the aircraft are flight models."""
    leads = page.leader.path.kind == "mission" and page.leader.vehicle == "jsbsim"
    return int(leads) + sum(each.vehicle == "jsbsim" for each in page.fleet)


def median(costs: Sequence[Cost]) -> Cost:
    """Of each of the two."""
    return Cost(
        statistics.median(each.wall_s for each in costs),
        statistics.median(each.processor_s for each in costs),
    )
