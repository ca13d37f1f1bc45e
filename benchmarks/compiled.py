"""Time the compiled flight model beside JSBSim's own step, in turns.

The compiled model is called from compiled code, as in a flight, for 4 steps, as between two ticks
of the autopilot; JSBSim runs bare. What counts is the ratio: both are measured in turns in one
process, so that other load slows both.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from testbed.core.call_list import Call, CallList
from testbed.core.records import NedOrigin
from testbed.vehicle.compiled import CompiledAircraft
from testbed.vehicle.jsbsim_adapter import load, trim_aircraft
from testbed.vehicle.trim import TrimPoint

ROOT = Path(__file__).parents[1]
RATE_HZ, TICKS, TURNS, CALLS = 200, 4, 30, 200
FLEETS = (1, 4, 1000)  # aircraft


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


def measure(folder: Path) -> None:
    """Print the cost of a step of an aircraft in fleets of several sizes."""
    aircraft, model = place(folder)
    start = aircraft.row_of(model)
    changed, run = np.ones(2, dtype=bool), model.fdm.run
    print(f"{folder.name}: {len(start)} columns")
    for number in FLEETS:
        state = np.tile(start, (number, 1))
        wind, status = np.zeros((number, 7)), np.zeros(number, dtype=np.uint8)
        controls = np.tile(
            start[
                [
                    aircraft.columns[f"fcs/{each}-cmd-norm"]
                    for each in ("aileron", "elevator", "rudder", "throttle")
                ]
            ],
            (number, 1),
        )
        args = (
            state,
            wind,
            controls,
            controls,
            changed,
            1.0 / RATE_HZ,
            np.array([TICKS]),
            aircraft.clearance,
        )
        calls = max(1, CALLS // number)
        call = Call(aircraft.run_rows, *args, np.arange(number), status)
        many = CallList([call] * calls)
        many.run(0, 0.0)
        ours, jsbsim, ratios = [], [], []
        for _ in range(TURNS):
            begun = perf_counter()
            many.run(0, 0.0)
            ours.append((perf_counter() - begun) / (calls * number * TICKS))
            state[:] = start
            begun = perf_counter()
            for _ in range(100):
                run()
            jsbsim.append((perf_counter() - begun) / 100)
            ratios.append(jsbsim[-1] / ours[-1])
        assert not status.any()
        print(
            f"  {number:5d} aircraft: {1e9 * min(ours):5.0f} ns per aircraft and step, JSBSim "
            f"{1e9 * min(jsbsim):5.0f} ns; ratio {np.median(ratios):.1f}"
        )


if __name__ == "__main__":
    for name in sys.argv[1:] or ("rascal110", "skywalker_x8"):
        measure(ROOT / "aircraft" / name)
