"""Flights of one process after another are those of `testbed.run`, whatever was flown before."""

import pytest
import small_study
from run_flight import small_grids

import testbed
from testbed.core.errors import FlightError, InputError
from testbed.pool.flight_task import FlightTask, run_task
from testbed.runs import repeated
from testbed.runs.repeated import RepeatedFlights
from testbed.scenario import load_scenario, set_duration, set_seed

NOISY = ("fleet.*.sensors=gps-ins", "network.loss=0.1")
GUSTY = ("air.turbulence={model: coherent, intensity: moderate}", "air.wind.speed_mps=3")
CLOCKS = ("wall_s", "real_time_factor")


def load(*changes, name="simulation-3", duration_s=2.0):
    return set_duration(load_scenario(name, changes), duration_s)


def numbers(metrics):
    return {key: value for key, value in metrics.items() if key not in CLOCKS}


def flown(scenario):
    return numbers(testbed.run(scenario, write=False).metrics)


@pytest.fixture
def built(monkeypatch):
    """Seeds of the flights that are built to be kept."""
    seeds = []

    class Counted(testbed.Batch):
        def __init__(self, scenario, **named):
            seeds.append(scenario.scenario.seed)
            super().__init__(scenario, **named)

    monkeypatch.setattr(repeated, "Batch", Counted)
    return seeds


@pytest.mark.parametrize("changes", [NOISY, GUSTY], ids=["noisy", "gusty"])
def test_kept_flights_are_runs_of_their_seeds(changes, built, monkeypatch):
    small_grids(monkeypatch)
    scenario, flights = load(*changes), RepeatedFlights()
    seeds = 3, 1, 1, 3
    found = [flights.fly(set_seed(scenario, seed)) for seed in seeds]
    assert built == [3]
    expected = {seed: flown(set_seed(scenario, seed)) for seed in seeds}
    assert [numbers(metrics) for metrics, _ in found] == [expected[seed] for seed in seeds]
    assert expected[3] != expected[1] | {"seed": 3} and all(random for _, random in found)


def test_other_scenarios_are_built_anew(built):
    flights = RepeatedFlights()
    scenarios = load(*NOISY, duration_s=1.0), load(*NOISY), load(*NOISY, "formation.k=2")
    order = (0, 1), (1, 1), (1, 1), (2, 1), (0, 2)
    for k, seed in order:
        scenario = set_seed(scenarios[k], seed)
        assert numbers(flights.fly(scenario)[0]) == flown(scenario)
    assert built == [1, 1, 1, 2]


@pytest.mark.parametrize("engine", ["compiled", "jsbsim"])
def test_flights_no_seed_changes_are_built_anew(engine, built):
    """So that a check of two seeds finds a random number that `World.is_random` denies."""
    scenario, flights = load(f"scenario.engine={engine}"), RepeatedFlights()
    found = [flights.fly(set_seed(scenario, seed)) for seed in (1, 2)]
    assert built == [1, 2]
    assert [random for _, random in found] == [False, False]
    assert [numbers(metrics) for metrics, _ in found] == [
        flown(set_seed(scenario, seed)) for seed in (1, 2)
    ]


@pytest.mark.parametrize("engine", ["compiled", "jsbsim"])
def test_noisy_flights_of_both_engines_are_runs(engine):
    scenario, flights = load(*NOISY, f"scenario.engine={engine}"), RepeatedFlights()
    for seed in (1, 2):
        of_seed = set_seed(scenario, seed)
        assert numbers(flights.fly(of_seed)[0]) == flown(of_seed)


@pytest.mark.parametrize("kind", ["external", "law"])
def test_flights_beyond_a_batch_are_runs(kind, built, tmp_path):
    """The seed may change them: what a program or a law does is not known."""
    (tmp_path / "torn.py").write_text(small_study.TORN_LAW)
    path = tmp_path / "mine.yaml"
    path.write_text("extends: simulation-3\ncontroller: {law: 'torn:Torn'}\n")
    changes = ["fleet.uav1.commanded_by=external"] if kind == "external" else []
    name = path if kind == "law" else "simulation-3"
    scenario = load(*changes, name=name, duration_s=0.4)
    metrics, random = RepeatedFlights().fly(scenario)
    assert numbers(metrics) == flown(scenario) and random and not built


def test_an_error_drops_the_kept_flight(built, monkeypatch):
    scenario, flights = load(*NOISY), RepeatedFlights()
    flights.fly(scenario)

    def fail(batch):
        batch.step(0.5)
        raise FlightError("torn")

    with monkeypatch.context() as patch:
        patch.setattr(repeated.Batch, "run", fail)
        with pytest.raises(FlightError, match="torn"):
            flights.fly(scenario)
    assert numbers(flights.fly(scenario)[0]) == flown(scenario)
    assert len(built) == 2


def test_tasks_after_a_failing_law_are_right(tmp_path):
    (tmp_path / "torn.py").write_text(small_study.TORN_LAW)
    path = tmp_path / "mine.yaml"
    path.write_text("extends: simulation-3\ncontroller: {law: 'torn:Torn'}\n")
    noisy, torn, wrong = load(*NOISY), load(name=path), load("formation.leader_gains.uav1=0")
    tasks = [noisy, torn, set_seed(noisy, 2), wrong, set_seed(noisy, 3)]
    results = [run_task(FlightTask(k, each)) for k, each in enumerate(tasks)]
    assert [each.outcome for each in results] == [
        *("completed", "failed", "completed", "invalid", "completed")
    ]
    for k, outcome in ((1, "failed"), (3, "invalid")):
        with pytest.raises(InputError) as caught:
            testbed.run(tasks[k], write=False)
        assert results[k].error == f"{outcome}: {caught.value}"
    for k in (0, 2, 4):
        assert numbers(results[k].metrics) == flown(tasks[k])
