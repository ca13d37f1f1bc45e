"""Time the compiled flight model beside JSBSim's own step, in turns.

The compiled model is called from compiled code, as in a flight, for 4 steps, as between two ticks
of the autopilot; JSBSim runs bare. What counts is the ratio: both are measured in turns in one
process, so that other load slows both.

`--share` prints which share of the time of many flights these steps are: 8 rows of Simulation 3 at
200 Hz on one thread, with metrics.

usage: python benchmarks/compiled.py [--share | AIRCRAFT ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

import testbed
from testbed.compiled import CompiledAircraft
from testbed.core.call_list import Call, CallList
from testbed.core.records import NedOrigin
from testbed.scenario import load_scenario, set_duration
from testbed.vehicle.jsbsim_adapter import load, trim_aircraft
from testbed.vehicle.trim import TrimPoint

ROOT = Path(__file__).parents[1]
RATE_HZ, TICKS, TURNS, CALLS = 200, 4, 30, 200
FLEETS = (1, 4, 1000)  # aircraft
RASCAL = "rascal110"
ROWS, FLIGHT_S, SHARE_TURNS = 8, 60.0, 7


def place(folder: Path):  # noqa: ANN201 - JSBSim's model
    """Place an aircraft in trim, with what `row_of` needs."""
    origin = NedOrigin()
    trimmed = trim_aircraft(folder, TrimPoint(20.0, altitude=700.0), origin)
    model = load(folder, RATE_HZ)
    aircraft = CompiledAircraft(folder, model)
    aircraft.watch(model)
    model.locate((0.0, 0.0, -400.0), origin)
    model.place(trimmed.placement, trimmed.controls, spin=True)
    return aircraft, model


def bind_steps(aircraft: CompiledAircraft, start: np.ndarray, number: int) -> Callable[[], float]:
    """Return a function that steps some aircraft from a start: s per aircraft and step."""
    state = np.tile(start, (number, 1))
    wind, status = np.zeros((number, 7)), np.zeros(number, dtype=np.uint8)
    names = (f"fcs/{each}-cmd-norm" for each in ("aileron", "elevator", "rudder", "throttle"))
    controls = np.tile(start[[aircraft.columns[name] for name in names]], (number, 1))
    inputs = state, wind, controls, controls, np.ones(2, dtype=bool), 1.0 / RATE_HZ
    calls = max(1, CALLS // number)
    call = Call(aircraft.run_rows, *inputs, np.array([TICKS]), np.arange(number), status)
    many = CallList([call] * calls)
    many.run(0, 0.0)

    def step() -> float:
        state[:] = start
        begun = perf_counter()
        many.run(0, 0.0)
        spent = perf_counter() - begun
        assert not status.any()
        return spent / (calls * number * TICKS)

    return step


def measure(folder: Path) -> None:
    """Print the cost of a step of an aircraft in fleets of several sizes."""
    aircraft, model = place(folder)
    start, run = aircraft.row_of(model), model.fdm.run
    print(f"{folder.name}: {len(start)} columns")
    for number in FLEETS:
        step = bind_steps(aircraft, start, number)
        ours, jsbsim, ratios = [], [], []
        for _ in range(TURNS):
            ours.append(step())
            begun = perf_counter()
            for _ in range(100):
                run()
            jsbsim.append((perf_counter() - begun) / 100)
            ratios.append(jsbsim[-1] / ours[-1])
        print(
            f"  {number:5d} aircraft: {1e9 * min(ours):5.0f} ns per aircraft and step, JSBSim "
            f"{1e9 * min(jsbsim):5.0f} ns; ratio {np.median(ratios):.1f}"
        )


def measure_share() -> None:
    """Print the share of the flight models' steps in many flights of Simulation 3."""
    changes = [f"rates.physics_hz={RATE_HZ}"]
    scenario = set_duration(load_scenario("simulation-3", changes), FLIGHT_S)
    aircraft, model = place(ROOT / "aircraft" / RASCAL)
    fleet = len(scenario.aircraft)
    step = bind_steps(aircraft, aircraft.row_of(model), fleet)
    batch = testbed.Batch(scenario, seeds=range(1, ROWS + 1), threads=1)
    batch.run()  # compiles
    steps, turns = ROWS * fleet * FLIGHT_S * RATE_HZ, []
    for _ in range(SHARE_TURNS):
        batch.reset()
        alone = float(np.median([step() for _ in range(TURNS)]))
        begun = perf_counter()
        batch.run()
        turns.append((alone, (perf_counter() - begun) / steps))
    alone_ns, whole_ns = 1e9 * np.median(turns, axis=0)
    shares = [100 * one / whole for one, whole in turns]
    print(
        f"{ROWS} rows of {fleet} aircraft: {whole_ns:.0f} ns per aircraft and step, the flight "
        f"model {alone_ns:.0f} ns: {np.median(shares):.0f} % "
        f"({min(shares):.0f} to {max(shares):.0f})"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("aircraft", nargs="*", default=[RASCAL, "skywalker_x8"])
    parser.add_argument("--share", action="store_true")
    chosen = parser.parse_args()
    if chosen.share:
        measure_share()
    else:
        for name in chosen.aircraft:
            measure(ROOT / "aircraft" / name)
