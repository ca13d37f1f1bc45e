"""A flight is a list of stages: printed as documented, with those of the user."""

import re
from functools import partial

import numpy as np
import pytest
from places import ROOT

import testbed
from testbed.core.call_list import NOW, Call, CallList
from testbed.core.compile import entry
from testbed.core.errors import InputError
from testbed.plan.world import build
from testbed.runs.run import list_stages
from testbed.scenario import load_scenario, set_duration

DOCS = ROOT / "docs"


def short(duration_s=3.0):
    return set_duration(load_scenario("simulation-3"), duration_s)


def stages_of(name):
    return list_stages(build(load_scenario(name)))


def test_documented_stages_are_those_of_the_flight():
    text = (DOCS / "contributing" / "architecture.md").read_text(encoding="utf-8")
    block = re.search(r"\$ testbed validate simulation-3 --stages\n(.*?)```", text, re.DOTALL)[1]
    rows = [tuple(re.split(r" {2,}", line)) for line in block.splitlines()[1:]]
    assert rows == stages_of("simulation-3")


@pytest.mark.parametrize(
    ("scenario", "stage"),
    [
        ("engine-out-uav2", "begin and end faults"),
        ("turbulence-moderate", "sample the wind"),
        ("simulation-3-pixhawk", "advance sensors and estimates"),
        ("ideal-figure-eight", "steer ideal vehicles"),
    ],
)
def test_part_of_a_scenario_has_its_stage(scenario, stage):
    assert stage in [name for _, _, name, _ in stages_of(scenario)]
    assert stage not in [name for _, _, name, _ in stages_of("simulation-3")]


def test_stage_of_the_user_runs_after_its_stage():
    seen = []

    def look(now, records):
        seen.append(now)
        records.aircraft["surfaces"]["throttle"][1] = 0.0

    still = testbed.UserStage("no thrust", "fly by wire", look)
    testbed.run(short(), write=False, stages=[still])
    assert np.allclose(seen, np.arange(len(seen)) / 50.0) and seen[-1] == 3.0
    with testbed.Simulation(short(), stages=[still]) as simulation:
        simulation.step()
        simulation.step()
        assert simulation.state.surfaces.throttle[1] == 0.0


def test_stage_without_its_place_is_refused():
    lost = testbed.UserStage("mine", "fly by wires", print)
    with pytest.raises(InputError, match=r"mine: this flight has no stage 'fly by wires' .*fly by"):
        testbed.run(short(), write=False, stages=[lost])
    for wrong in ([print], 5, None, "fly", [testbed.UserStage(1, "fly by wire", print)]):
        for call in (testbed.Simulation, partial(testbed.run, write=False)):
            with pytest.raises(InputError, match=r"write a list of testbed\.UserStage"):
                call(short(), stages=wrong)


def test_error_of_the_users_stage_ends_the_flight():
    def fail(now, records):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        testbed.run(
            short(), write=False, stages=[testbed.UserStage("mine", "write messages", fail)]
        )


@entry
def _add(values: np.ndarray, share: float, count: int, on: bool, pair: tuple, now: float) -> int:
    """Add to values; return how many are above 10."""
    found = 0
    for k in range(len(values)):
        if on:
            values[k] += share * count + pair[0] - pair[1] + now
        if values[k] > 10.0:
            found += 1
    return found


@entry
def _halve(values: np.ndarray) -> None:
    """Halve the values."""
    for k in range(len(values)):
        values[k] *= 0.5


def test_calls_run_until_one_asks_for_python():
    """Arrays with strides, numbers, booleans and tuples arrive as they are."""
    values = np.zeros((3, 4))[:, 1]
    add = Call(_add, values, 0.5, 3, True, (2.0, 0.25), NOW)
    calls = CallList([add, Call(_halve, values), None, add, add])
    assert calls.run(0, 1.0) == 2 and calls.found[0] == 0
    assert np.array_equal(values, [2.125] * 3)
    values[:] = 0.0
    assert calls.run(3, 0.0) == 5  # 3.25 twice
    assert np.array_equal(values, [6.5] * 3)
    assert calls.run(3, 1.0) == 3 and calls.found[0] == 3  # 10.75
    assert calls.run(4, 0.0) == 4
    assert np.array_equal(values, [14.0] * 3)
    assert add(0.0) == 3


def test_rebound_call_has_its_new_arguments():
    one, other = np.zeros(2), np.full(2, 8.0)
    call = Call(_halve, one)
    calls = CallList([call])
    calls.run(0, 0.0)
    call.rebind(other)
    calls.run(0, 0.0)
    assert np.array_equal(other, [4.0, 4.0]) and np.array_equal(one, [0.0, 0.0])
