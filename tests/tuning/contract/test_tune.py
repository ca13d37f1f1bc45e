"""`testbed tune`: its file, its flights and its output files."""

import csv
import json
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from unittest.mock import MagicMock

import pytest
from cases import ALL
from commands import call_command
from small_study import few_checked  # noqa: F401 - for all tests
from snapshot import check_snapshot

from testbed.pool.flight_pool import FlightWorkers
from testbed.pool.flight_task import FlightResult
from testbed.scenario import (
    ScenarioError,
    find_tuning,
    list_tunings,
    load_middle_loop,
    load_scenario,
    middle_loop_gains,
)
from testbed.studies.predicted_numbers import predict_numbers
from testbed.tuning import tune
from testbed.tuning.tune import tune_gains
from testbed.tuning.tune_schema import load_tune
from testbed.tuning.tuning import Tuning

PROFILE_COURSE_P = middle_loop_gains(load_scenario("simulation-3"), "rascal110").course.p
METRIC = "windows.rectangles.mean_rms_m"
TUNE = """study:
  schema: 1
  name: small
  scenario: simulation-3
  duration_s: 100
  seeds: [1, 2]
cases: {calm: {}, windy: {air.wind.speed_mps: 3}}
gains:
  controller.gains.course.p: {from: 1, to: 9, scale: log}
  formation.k: {from: 1, to: 5}
objective: {metric: windows.rectangles.mean_rms_m, aggregate: mean}
search: {max_flights: 52, population: 4, held_out_seeds: [7, 8, 9]}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(TUNE)
    return path


def is_prediction(task):
    """Whether margins are to be predicted."""
    return task.measure is not None and task.measure.func is predict_numbers


def artificial_flight(task):
    """Return a metric with its minimum at course.p = 2 and k = 2.5, larger in wind."""
    scenario = task.scenario
    course, k = middle_loop_gains(scenario, "rascal110").course.p, scenario.formation.k
    wind, seed = scenario.air.wind.speed_mps, scenario.scenario.seed
    if is_prediction(task):
        margins = {"roll_latency_s": 0.8 / course, "damping": 0.3}
        return FlightResult(task.number, "completed", "", {"margins": margins})
    value = 0.2 + (course - 2.0) ** 2 + (k - 2.5) ** 2 + 0.1 * wind + 0.01 * seed
    metrics = {"outcome": "completed", "windows": {"rectangles": {"mean_rms_m": value}}}
    return FlightResult(task.number, "completed", "", metrics | {"lost_at_s": {}})


def replace_flights(patch, function=artificial_flight, *, reverse=False, stop_after=None):
    """Replace flights by a function, in any order, interrupted after some; return the tasks."""
    done = []

    class Pool:
        def run_groups(self, groups):
            tasks = chain.from_iterable(groups)
            for task in reversed(list(tasks)) if reverse else tasks:
                if stop_after is not None and len(done) >= stop_after:
                    raise KeyboardInterrupt
                done.append(task)
                yield function(task)

    @contextmanager
    def pool(_, *, keep=False):
        yield Pool()

    patch.setattr(FlightWorkers, "pool", pool)
    return done


@pytest.fixture
def fly_with(monkeypatch):
    """See `replace_flights`."""
    return partial(replace_flights, monkeypatch)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """Return what a search prints, and the folder that it writes."""
    folder = tmp_path_factory.mktemp("searched")
    (folder / "small.yaml").write_text(TUNE)
    words = ("tune", folder / "small.yaml", "--out", "out", "--json", "-")
    with pytest.MonkeyPatch.context() as patch:
        replace_flights(patch)
        done = call_command(*words, cwd=folder, code=0, columns=120)
    return done, folder / "out"


def test_tune_result_is_independent_of_the_order(searched, file, tmp_path, fly_with):
    results = fly_with(reverse=True)
    found = tune_gains(Tuning(file), tmp_path)
    # 4 with the scenario's gains, 3 generations of 4 x 4, and 3 seeds x 2 cases twice, and
    # the margins of 2 cases twice
    assert len(results) == 4 + 48 + 12 + 4 and found.flights == 52
    for name in ("candidates.csv", "middle_loop.yaml", "result.json"):
        assert (tmp_path / name).read_text() == (searched[1] / name).read_text()
    assert found.held_out.comparison.better
    assert found.best.gains == pytest.approx((2.0, 2.5), abs=1.0)


def test_tune_writes_a_scenario_with_the_gains(searched):
    done, folder = searched
    check_snapshot("tune", done.stderr)
    found = json.loads(done.stdout)
    assert found["comparison"]["better"] and found["seeds"] == [1, 2]
    assert found["gains"]["controller.gains.course.p"]["before"] == PROFILE_COURSE_P
    assert found["gains"]["formation.k"]["before"] == 3.0
    tuned = load_scenario(folder / "tuned.yaml")
    course = middle_loop_gains(tuned, "rascal110").course.p
    assert course == found["gains"]["controller.gains.course.p"]["after"] != PROFILE_COURSE_P
    assert tuned.formation.k == found["gains"]["formation.k"]["after"]
    assert tuned.controller.gains == {} and tuned.name == "small-tuned"
    own = middle_loop_gains(tuned, "rascal110").model_dump()
    profile = load_middle_loop("rascal110", "tuned").model_dump()
    assert {key for key in own if own[key] != profile[key]} == {"course"}
    lines = (folder / "candidates.csv").read_text().splitlines()
    assert len(lines) == 2 + 12 and len(set(map(len, (row.split(",") for row in lines)))) == 1


def test_tune_interrupted_has_the_best_so_far(file, tmp_path, fly_with):
    fly_with(stop_after=25)  # in the second generation
    done = call_command("tune", file, "--out", "out", cwd=tmp_path, code=130, columns=120)
    assert "interrupted" in done.stderr and "tuned.yaml" in done.stderr
    assert len((tmp_path / "out/candidates.csv").read_text().splitlines()) == 2 + 4
    assert "not compared on held-out seeds" in (tmp_path / "out/middle_loop.yaml").read_text()
    load_scenario(tmp_path / "out/tuned.yaml")


def test_tune_ended_between_its_files_mixes_no_gains(file, tmp_path, fly_with, monkeypatch):
    """A scenario is never beside the gains file of another candidate."""
    write, written = tune.SearchLog._write, []

    def end_before_second_scenario(log, name, text):
        written.append(name)
        if written.count("tuned.yaml") == 2:
            raise KeyboardInterrupt
        write(log, name, text)

    monkeypatch.setattr(tune.SearchLog, "_write", end_before_second_scenario)
    fly_with()
    call_command("tune", file, "--out", "out", cwd=tmp_path, code=130, columns=120)
    assert (tmp_path / "out/middle_loop.yaml").exists()
    assert not (tmp_path / "out/tuned.yaml").exists()


def test_tune_gains_of_the_scenario_move_to_the_file(file, tmp_path, fly_with):
    """They are in the gains file, and no longer in the scenario."""
    fly_with()
    own = "extends: simulation-3\nscenario: {name: own}\n"
    (tmp_path / "own.yaml").write_text(own + "controller: {gains: {course: {p: 5}, eta_bank: 0.2}}")
    changed = TUNE.replace("simulation-3", "own.yaml").replace(
        "  seeds:", "  set: {controller.gains.speed.i: 0.03}\n  seeds:"
    )
    file.write_text(changed)
    out = tmp_path / "out"
    out.mkdir()
    result = tune_gains(Tuning(file), out)
    assert result.candidates[0].gains[0] == 5.0
    tuned = load_scenario(out / "tuned.yaml")
    gains = middle_loop_gains(tuned, "rascal110")
    assert tuned.controller.gains == {}
    assert (gains.course.p, gains.eta_bank, gains.speed.i) == (result.best.gains[0], 0.2, 0.03)


CONSTRAINTS = "constraints: [{bank_deg: 0, damping: 0.2}, {bank_deg: 45, damping: 0.4}]"


def damped_flight(task):
    """Return a damping ratio that falls as course.p rises: 0.4 needs 1.875 or less."""
    result = artificial_flight(task)
    if task.measure is None or is_prediction(task):
        return result
    bank_deg = task.measure.args[1]
    damping = 0.75 / middle_loop_gains(task.scenario, "rascal110").course.p
    measured = {"problem": "", "damping": damping + (0.05 if bank_deg > 0.0 else 0.0)}
    return FlightResult(task.number, "completed", "", measured)


def test_tune_constraint_moves_the_optimum(searched, file, tmp_path, fly_with):
    """To its bound; without it the optimum is at 2, which misses it."""
    text = TUNE.replace("max_flights: 52", "max_flights: 46").replace("[1, 2]", "1")
    text = text.replace("cases: {calm: {}, windy: {air.wind.speed_mps: 3}}\n", "")
    file.write_text(f"{text}{CONSTRAINTS}\n")
    fly_with(damped_flight)
    done = call_command("tune", file, "--out", "bound", cwd=tmp_path, code=0, columns=120)
    found = {
        folder.name: json.loads((folder / "result.json").read_text())
        for folder in (searched[1], tmp_path / "bound")
    }
    free, bound = (each["gains"]["controller.gains.course.p"]["after"] for each in found.values())
    assert free == pytest.approx(2.0, abs=0.3) and 1.5 < bound <= 1.875
    assert found["out"]["constraints"] == []
    straight, turn = found["bound"]["constraints"]
    before = pytest.approx(0.75 / PROFILE_COURSE_P)
    assert straight["before"] == {"met": True, "problem": "", "damping": before}
    assert turn["required"] == {"damping": 0.4} and turn["after"]["met"]
    assert turn["after"]["damping"] == pytest.approx(0.75 / bound)  # the worse direction
    assert not turn["before"]["met"]
    assert f"before at 45° damping {0.75 / PROFILE_COURSE_P:.3f} of 0.4 (missed)" in done.stdout
    head, first, *_ = (tmp_path / "bound/candidates.csv").read_text().splitlines()
    assert head.endswith(
        "damping at 0 deg,shortfall at 0 deg,damping at 45 deg,shortfall at 45 deg"
    )
    assert [float(cell) for cell in first.split(",")[-4:]] == pytest.approx(
        [0.75 / PROFILE_COURSE_P, 0.0, 0.75 / PROFILE_COURSE_P, 1.0 - 0.75 / PROFILE_COURSE_P / 0.4]
    )
    assert "# at 45° damping 0." in (tmp_path / "bound/middle_loop.yaml").read_text()


def test_tune_constraints_unmet_are_said(file, tmp_path, fly_with):
    """Also of flights that are not steady; nearer candidates are cheaper."""

    def unsteady(task):
        result = damped_flight(task)
        course = middle_loop_gains(task.scenario, "rascal110").course.p
        banked = task.measure is not None and not is_prediction(task) and task.measure.args[1]
        if banked and course > 2.5:
            return replace(result, metrics={"problem": "not steady: rings"})
        return result

    file.write_text(TUNE + "constraints: [{bank_deg: 45, damping: 0.95}]\n")
    fly_with(unsteady)
    done = call_command("tune", file, "--out", "out", cwd=tmp_path, code=0, columns=120)
    assert "no candidate meets the constraints" in done.stdout
    assert "at 45° not steady: rings" in done.stdout  # before
    with (tmp_path / "out/candidates.csv").open() as rows:
        rows = list(csv.DictReader(rows))
    costs = {float(row["cost"]): float(row["controller.gains.course.p"]) for row in rows}
    steady = [costs[cost] for cost in sorted(costs) if costs[cost] <= 2.5]
    assert steady == sorted(steady) and len(steady) > 3  # less course.p is more damping
    assert costs[max(costs)] > 2.5


def test_tune_nothing_better_writes_no_gains(file, tmp_path, fly_with):
    def worse(task):
        result = artificial_flight(task)
        changed = middle_loop_gains(task.scenario, "rascal110").course.p != PROFILE_COURSE_P
        if not is_prediction(task):
            result.metrics["windows"]["rectangles"]["mean_rms_m"] += 50.0 * changed
        return result

    file.write_text(TUNE.replace("max_flights: 52", "max_flights: 20"))
    fly_with(worse)
    done = call_command("tune", file, "--out", "out", cwd=tmp_path, code=0, columns=120)
    assert "no better gains were found" in done.stdout
    assert not (tmp_path / "out/middle_loop.yaml").exists()
    assert json.loads((tmp_path / "out/result.json").read_text())["comparison"] is None


WRONG = (
    ("from: 1, to: 9", "from: 9, to: 1"),
    ("from: 1, to: 9", "from: 0, to: 9"),
    ("controller.gains.course.p", "controller.gains.curse.p"),
    ("formation.k", "fleet.0.start_m"),
    ("formation.k", "formation.offsets_m"),
    ("formation.k: {from: 1", "formation.k: {from: -1"),
    ("[7, 8, 9]", "[2, 8, 9]"),
    ("[7, 8, 9]", "[8, 8, 9]"),
    ("aggregate: mean", "aggregate: {quantile: 2}"),
    ("aggregate: mean", "aggregate: best"),
    ("max_flights: 52", "max_flights: 19"),
    (METRIC, "windows.rectangle.mean_rms_m"),
    ("simulation-3", "mixed-fleet"),
    ("search:", "serch:"),
    ("search:", "constraints: [{bank_deg: 30}]\nsearch:"),
    ("search:", "constraints: [{bank_deg: 0, damping: 1.2}]\nsearch:"),
    ("  seeds:", "  set: {fleet.*.vehicle: unicycle}\n  seeds:"),
    (TUNE, "a text"),
)


def test_tune_bad_input_exits_2_with_its_place(file, tmp_path, fly_with):
    fly_with()
    rows = []
    for old, new in WRONG:
        text = TUNE.replace(old, new)
        if "unicycle" in new:
            text = text.replace("search:", "constraints: [{bank_deg: 0, damping: 0.2}]\nsearch:")
        file.write_text(text)
        error = call_command("tune", file, "--out", "out", cwd=tmp_path, code=2, columns=200).stderr
        rows += [new, error.replace(str(tmp_path), ".")[:300], ""]
    check_snapshot("wrong_tunes", "\n".join(rows))


def test_tune_library_files_are_valid(monkeypatch):
    names = list_tunings()
    assert names
    for name in names:
        loaded = load_tune(name)
        assert loaded.study.name == name == find_tuning(name).stem
    Tuning("x8-middle-loop")
    if not ALL:  # others compile their law; their keys are read all the same
        monkeypatch.setattr("testbed.tuning.tuning.FlownScenarios", MagicMock())
        monkeypatch.setattr(Tuning, "_check_bounds", MagicMock())
    for name in names:
        Tuning(name)


def test_gains_of_a_scenario_override_the_profile():
    changes = ["controller.gains.course.p=3.3", "controller.gains.eta_bank=0.05"]
    gains = middle_loop_gains(load_scenario("simulation-3", changes), "rascal110")
    profile = load_middle_loop("rascal110", "tuned")
    assert (gains.course.p, gains.eta_bank) == (3.3, 0.05)
    assert (gains.course.i, gains.speed) == (profile.course.i, profile.speed)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("gains.curse.p=3", "controller.gains.curse: is not a key of this section: did"),
        ("gains.course.p=-3", "controller.gains.course.p: is -3 (write a number at"),
        ("gains.course=3", "controller.gains.course: is 3 (write a map"),
        ("middle_loop=nowhere.yaml", "there is no file"),
    ],
)
def test_gains_invalid_keys_and_values_are_named(change, message):
    with pytest.raises(ScenarioError, match=r"controller\.") as error:
        load_scenario("simulation-3", [f"controller.{change}"])
    assert message in str(error.value)


def test_gains_file_is_for_one_airframe():
    file = find_tuning(list_tunings()[0]).parents[3] / "aircraft/rascal110/middle_loop.yaml"
    changes = [f"controller.middle_loop={file}", "controller.profile=authors"]
    gains = middle_loop_gains(load_scenario("simulation-3", changes), "rascal110")
    assert gains == load_middle_loop("rascal110", "authors")
    with pytest.raises(ScenarioError, match="is for one airframe, and the fleet has"):
        load_scenario("mixed-fleet", [f"controller.middle_loop={file}"])
