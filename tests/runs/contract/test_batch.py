"""Flights of a batch are those of `testbed.run`, whatever flies beside them."""

import math

import numpy as np
import pytest

import testbed
from testbed.core.errors import InputError
from testbed.scenario import load_scenario, set_duration, set_seed

BUSY = [
    "air.wind={speed_mps: 4, from_deg: 30}",
    "air.turbulence={model: dryden, intensity: moderate}",
    "fleet.*.sensors=pixhawk",
    "network.loss=0.2",
    "network.jitter={distribution: normal, spread_s: 0.02}",
]
CLOCKS = ("wall_s", "real_time_factor")


@pytest.fixture(scope="module")
def scenario():
    return set_duration(load_scenario("simulation-3", BUSY), 2.0)


def numbers(metrics):
    """Metrics as text, without what the clock on the wall measures."""
    return str({key: value for key, value in metrics.items() if key not in CLOCKS})


def test_rows_fly_as_runs_of_their_seeds(scenario):
    """In one and in two threads, in steps and at once."""
    seeds = [1, 2, 3]
    runs = [testbed.run(set_seed(scenario, each), write=False) for each in seeds]
    expected = [numbers(each.metrics) for each in runs]
    assert len(set(expected)) == 3
    for threads in (1, 2):
        batch = testbed.Batch(scenario, seeds=seeds, threads=threads)
        batch.step(1.0)
        assert batch.times_s.tolist() == [1.0] * 3 and batch.outcomes == [None] * 3
        assert [numbers(each) for each in batch.run()] == expected
        assert batch.outcomes == ["completed"] * 3
    batch.reset([1], seeds=[3])
    assert [numbers(each) for each in batch.run()] == [expected[k] for k in (0, 2, 2)]


def test_rows_have_overrides_and_live_records():
    rows = [["network.loss=0"], ["network.loss=1"], ["fleet.uav1.start_m=[-20, 5, 0]"]]
    batch = testbed.Batch(
        "simulation-1",
        ["scenario.duration_s=20", "scenario.windows={}", "scenario.published=null"],
        rows=rows,
    )
    assert batch.aircraft.shape == (3, 4) and batch.followers.shape == (3, 3)
    start = batch.aircraft["truth"]["position_ned"].copy()
    assert not np.array_equal(start[0, 1], start[2, 1])
    batch.step(10.0)
    moved = batch.aircraft["truth"]["position_ned"]
    assert (np.linalg.norm(moved - start, axis=-1) > 100.0).all()
    assert not np.array_equal(moved[0, 1], moved[1, 1])


def test_commands_of_rows_are_those_of_steps():
    changes = [
        "fleet.uav1.commanded_by=external",
        "scenario.duration_s=4",
        "scenario.windows={}",
        "scenario.published=null",
    ]
    batch = testbed.Batch("simulation-1", changes, rows=[[], []])
    batch.commands[:, 1] = [(0.1, 0.2, 0.5), (0.0, -0.2, 0.4)]
    batch.step(2.0)
    for row, command in enumerate(batch.commands[:, 1].tolist()):
        simulation = testbed.Simulation("simulation-1", changes)
        simulation.step({"uav1": command}, until=2.0)
        truth = simulation.state.truth.position_ned
        np.testing.assert_array_equal(batch.aircraft[row]["truth"]["position_ned"], truth)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"seeds": []}, "rows, seeds: "),
        ({"seeds": [1, 2], "rows": [[]]}, "rows, seeds: "),
        ({"seeds": 3}, "seeds: is 3 (write a list"),
        ({"rows": ["a"]}, "rows[0]: "),
        ({"threads": 0}, "threads"),
        ({"rows": [[], ["leader.name=other"]]}, "rows[1]: has other aircraft"),
        ({"overrides": ["fleet.uav1.autopilot=ardupilot"]}, "uav1 has autopilot: ardupilot"),
    ],
)
def test_wrong_arguments_of_a_batch_are_named(arguments, text):
    with pytest.raises(InputError) as caught:
        testbed.Batch("simulation-1", **arguments)
    assert text in str(caught.value)


def test_rows_stay_where_they_are(scenario):
    """A time that has passed moves no row; rows have times of their own."""
    batch = testbed.Batch(scenario, rows=None, seeds=[1, 2], threads=1)
    batch.step([0.5, 1.5])
    assert batch.times_s.tolist() == [0.5, 1.5]
    before = batch.aircraft.tobytes()
    batch.step(0.5)
    batch.step(np.array([0.1, 1.0]))
    assert batch.times_s.tolist() == [0.5, 1.5] and batch.aircraft.tobytes() == before
    batch.step(1.0)
    assert batch.times_s.tolist() == [1.0, 1.5]


@pytest.fixture(scope="module")
def hold_slot():
    return testbed.Batch("hold-slot", seeds=[1, 2], threads=1)


@pytest.mark.parametrize(
    "until", [-1.0, math.nan, 1e9, [1.0], [1.0, -1.0], "1", [None, 1.0], np.zeros((2, 1)), {}]
)
def test_wrong_times_of_rows_are_refused(until, hold_slot):
    with pytest.raises(InputError, match="until: is "):
        hold_slot.step(until)
    assert hold_slot.times_s.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "value"), [("pitch", 2.0), ("roll", math.nan), ("throttle", -0.1), ("throttle", 40.0)]
)
def test_wrong_commands_of_rows_are_refused(name, value):
    batch = testbed.Batch("hold-slot", ["fleet.uav1.commanded_by=external"], seeds=[1, 2])
    batch.commands[name][:, 0] = math.nan  # of the leader, which takes none
    batch.step(0.1)
    batch.commands[name][1, 1] = value
    with pytest.raises(InputError, match=rf"commands\[1, 1\], of uav1: {name}: is {value} \(write"):
        batch.step(0.5)
    assert batch.times_s.tolist() == [0.1, 0.1]


def test_row_that_cannot_be_built_again_stays(scenario, monkeypatch):
    """Here with random phases, for which a row is built anew."""
    changed = set_duration(load_scenario("experiment-1"), 3.0)
    batch = testbed.Batch(changed, seeds=[1, 2], threads=1)
    batch.step(1.0)
    before = batch.aircraft.tobytes()

    def fail(*_, **__):
        raise InputError("no file")

    with monkeypatch.context() as patched:
        patched.setattr("testbed.runs.batch.build", fail)
        with pytest.raises(InputError, match="no file"):
            batch.reset([1], [5])
    assert batch.aircraft.tobytes() == before and batch.seeds == [1, 2]
    assert [numbers(each) for each in batch.run()] == [
        numbers(testbed.run(set_seed(changed, seed), write=False).metrics) for seed in (1, 2)
    ]


def test_rows_can_be_scenarios(scenario):
    scenarios = [set_seed(scenario, 4), set_duration(scenario, 1.5)]
    batch = testbed.Batch(scenarios)
    assert [numbers(each) for each in batch.run()] == [
        numbers(testbed.run(each, write=False).metrics) for each in scenarios
    ]
    for wrong in ([], [scenario, "simulation-1"]):
        with pytest.raises(InputError, match="write"):
            testbed.Batch(wrong)
