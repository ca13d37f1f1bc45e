"""What a law costs that is an FMU: flights in turn with the built-in law, and the bare step.

Builds the FMUs of the tests with the C compiler of this machine.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "shared"))
import numba
from c_fmus import law_fmu  # type: ignore[import-not-found]

import testbed
from testbed.core.call_list import CallList
from testbed.formation import fmu_step
from testbed.plan.fmu_law import FmuLaw
from testbed.plan.world import build
from testbed.scenario import load_scenario

Array: TypeAlias = Any  # of NumPy
FLIGHT_S, TURNS, CALLS = 100.0, 5, 20_000
LAWS: dict[str, dict[str, Any]] = {
    "two": {},
    "three": {"version": 3, "aircraft": 3},
    "stateless": {"state": False},
}


def main() -> None:
    """Print processor times of 100 s of Simulation 3, and of a step of one follower."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        files = {}
        for law, how in LAWS.items():
            law_fmu(folder / f"{law}.fmu", **how)
            scenario = folder / f"{law}.yaml"
            scenario.write_text(
                "extends: own-law-leader-follower\n"
                f"scenario: {{name: {law}}}\n"
                f"controller: {{law: {law}.fmu, options: {{field_per_m: 0.03}}}}\n"
            )
            files[law] = str(scenario)
        _fly({"hbh23": "simulation-3", "class": "own-law-leader-follower", **files})
        for law, file in files.items():
            whole, bare = _step_us(file)
            print(f"{law}: {whole:.3f} us for a step of one follower; inputs, step, outputs {bare}")


def _fly(scenarios: dict[str, str]) -> None:
    flights = {law: testbed.Simulation(each) for law, each in scenarios.items()}
    for each in flights.values():
        each.step(until=2.0)
    found: dict[str, list[float]] = {law: [] for law in flights}
    for turn in range(TURNS):
        for law, flight in flights.items():
            begin = time.thread_time()
            flight.step(until=2.0 + FLIGHT_S * (turn + 1))
            found[law].append(time.thread_time() - begin)
    for law, times in found.items():
        ratio = min(times) / min(found["hbh23"])
        shown = ", ".join(f"{each:.3f}" for each in times)
        print(f"{law}: {shown} s for {FLIGHT_S:g} s; {ratio:.2f} times the built-in law")


def _bare_calls(words: Array, numbers: Array, count: int) -> int:
    """Set the inputs, step, and get the outputs of an FMU of FMI 2.0."""
    at, failed = numbers.ctypes.data, 0
    f, instance = words[fmu_step.FUNCTIONS :], words[fmu_step.INSTANCES]
    values, found = at + 8 * words[fmu_step.VALUES_AT], at + 8 * words[fmu_step.FOUND_AT]
    n, refs = words[fmu_step.INPUT_COUNT], words[fmu_step.INPUT_REFS]
    m, outputs = words[fmu_step.OUTPUT_COUNT], words[fmu_step.OUTPUT_REFS]
    for k in range(count):
        failed += fmu_step._call_4(f[fmu_step.SET_REAL], instance, refs, n, values)
        failed += fmu_step._step_2(f[fmu_step.DO_STEP], instance, 0.04 * k, 0.04, 1)
        failed += fmu_step._call_4(f[fmu_step.GET_REAL], instance, outputs, m, found)
    return failed


_bare: Any = numba.njit(_bare_calls)


def _step_us(file: str) -> tuple[float, str]:
    world = build(load_scenario(file), in_process=True)
    law = world.formation.control.groups[0].law
    assert isinstance(law, FmuLaw), "an FMU"
    law.own.velocity_ned[:, 0] = 20.0
    calls = CallList([law.call] * CALLS)  # from compiled code, as in flight
    calls.run(0, 0.0)
    begin = time.thread_time()
    for k in range(TURNS):
        calls.run(0, 0.04 * k)
    whole = (time.thread_time() - begin) / (TURNS * CALLS * len(law.own.airspeed)) * 1e6
    words, numbers = law._fmu.words[1], law._fmu.numbers[1]
    if words[fmu_step.VERSION] != 2:
        return whole, "not measured"
    assert _bare(words, numbers, 1) == 0, "all have worked"
    begin = time.thread_time()
    _bare(words, numbers, CALLS)
    return whole, f"{(time.thread_time() - begin) / CALLS * 1e6:.3f} us"


if __name__ == "__main__":
    main()
