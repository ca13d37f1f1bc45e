"""Measure what an aircraft as an FMU costs beside JSBSim alone.

Turns of one `fmi2DoStep` of many periods, flight model and autopilot, and of as many frames of the
same aircraft in JSBSim, which has no autopilot there. Processor time for 0.02 s of flight.

usage: python benchmarks/fmu.py [--aircraft NAME] [--airspeed M/S] [--turns N]
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
import tempfile
import time
import zipfile
from pathlib import Path

from testbed.core.library import library
from testbed.core.records import NedOrigin
from testbed.fmi.aircraft_fmu import AircraftFmu, make_fmu
from testbed.fmi.targets import THIS, targets
from testbed.vehicle.fleet import place_model
from testbed.vehicle.trim import InitialState

PERIODS, PERIOD_S, PHYSICS_HZ = 3000, 0.02, 100


class Flight:
    """An instance of an FMU whose aircraft flies its trim."""

    def __init__(self, data: bytes, name: str, folder: Path) -> None:
        """Unpack the FMU into a folder, and initialise an instance."""
        (folder / "it.fmu").write_bytes(data)
        with zipfile.ZipFile(folder / "it.fmu") as archive:
            archive.extractall(folder)
        target = targets()[THIS]
        path = folder / "binaries" / target.folder / f"{name}{target.suffix}"
        self._library = ctypes.CDLL(str(path))
        self._library.fmi2Instantiate.restype = ctypes.c_void_p
        guid = (folder / "modelDescription.xml").read_text("utf-8").partition('guid="')[2]
        found = self._library.fmi2Instantiate(
            b"it", 1, guid.partition('"')[0].encode(), b"", None, 0, 0
        )
        self._component = ctypes.c_void_p(found)
        self.begin()

    def begin(self) -> None:
        """Return to the start."""
        for name in ("Reset", "EnterInitializationMode", "ExitInitializationMode"):
            assert getattr(self._library, f"fmi2{name}")(self._component) == 0, name

    def fly(self, steps: int) -> float:
        """Fly PERIODS in some steps; return the processor time, s."""
        step, seconds = PERIODS // steps * PERIOD_S, 0.0
        self.begin()
        for k in range(steps):
            now = ctypes.c_double(k * step), ctypes.c_double(step)
            begun = time.process_time()
            status = self._library.fmi2DoStep(self._component, *now, 1)
            seconds += time.process_time() - begun
            assert status == 0
        return seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--aircraft", default="rascal110")
    parser.add_argument("--airspeed", type=float, default=20.0, help="m/s")
    parser.add_argument("--turns", type=int, default=9)
    options = parser.parse_args()
    folder = library() / "aircraft" / options.aircraft
    tune = folder / "autopilot.param"
    made = make_fmu(AircraftFmu(folder, tune, [options.airspeed], physics_hz=PHYSICS_HZ))
    start = InitialState((0.0, 0.0, -100.0), airspeed=options.airspeed)
    run = place_model(folder, start, NedOrigin(), PHYSICS_HZ).model.fdm.run
    frames = round(PERIODS * PERIOD_S * PHYSICS_HZ)
    unit, alone = list[float](), list[float]()
    with tempfile.TemporaryDirectory() as place:
        flight = Flight(made.data, options.aircraft, Path(place))
        for _ in range(options.turns):
            unit.append(1e6 * flight.fly(1) / PERIODS)
            begun = time.process_time()
            for _ in range(frames):
                run()
            alone.append(1e6 * (time.process_time() - begun) / PERIODS)
    ratios = [one / other for one, other in zip(unit, alone, strict=True)]
    print(
        f"{options.aircraft}, {PERIOD_S:g} s of flight: FMU with autopilot "
        f"{statistics.median(unit):.2f} µs ({min(unit):.2f} to {max(unit):.2f}), JSBSim alone "
        f"{statistics.median(alone):.2f} µs ({min(alone):.2f} to {max(alone):.2f}), ratio "
        f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}); "
        f"{options.turns} turns"
    )


if __name__ == "__main__":
    main()
