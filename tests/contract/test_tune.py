"""The tune: its page, its flights, what it leaves, and whoever flies them."""

import json
from contextlib import contextmanager

import pytest
from commands import call_command

from testbed.scenario import (
    ScenarioError,
    find_tuning,
    gains_of,
    list_tunings,
    load,
    load_middle_loop,
)
from testbed.study import tune as room
from testbed.study.crew import Flown, fly
from testbed.study.tune import Tuner, tune_gains
from testbed.study.tune_page import load_tune

METRIC = "portions.rectangles.mean_rms_m"
PAGE = """study:
  schema: 1
  name: small
  scenario: simulation-3
  duration_s: 100
  seeds: [1, 2]
cases: {calm: {}, windy: {air.wind.speed_mps: 3}}
gains:
  controller.gains.course.p: {from: 1, to: 9, scale: log}
  formation.k: {from: 1, to: 5}
objective: {metric: portions.rectangles.mean_rms_m, robust: mean}
search: {flights: 52, population: 4, held_out: [7, 8, 9]}
"""


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(PAGE)
    return path


def made_up(task):
    """A flight that is best at course.p = 3 and k = 2.5, worse in wind, and different by seed."""
    flown = task.page
    course, k = gains_of(flown, "rascal110").course.p, flown.formation.k
    wind, seed = flown.air.wind.speed_mps, flown.scenario.seed
    value = 0.2 + (course - 3.0) ** 2 + (k - 2.5) ** 2 + 0.1 * wind + 0.01 * seed
    document = {"outcome": "flown", "portions": {"rectangles": {"mean_rms_m": value}}}
    return Flown(task.number, "flown", "", document | {"lost_at_s": {}})


@pytest.fixture
def hand_over(monkeypatch):
    """Has flights flown here, by anything and in any order, and stops after some, if asked to."""

    def give(how=made_up, *, backwards=False, stop_after=None):
        done = []

        class Ours:
            def fly(self, tasks):
                for task in reversed(list(tasks)) if backwards else tasks:
                    if stop_after is not None and len(done) >= stop_after:
                        raise KeyboardInterrupt
                    done.append(task)
                    yield how(task)

        @contextmanager
        def crew(*, jobs=None):
            yield Ours()

        monkeypatch.setattr(room, "crew", crew)
        return done

    return give


def test_what_comes_out_does_not_depend_on_who_flies_when(page, tmp_path, hand_over):
    found = []
    for name, backwards in (("a", False), ("b", True)):
        (tmp_path / name).mkdir()
        flown = hand_over(backwards=backwards)
        found.append(tune_gains(Tuner(load_tune(page)), tmp_path / name))
        # 4 as it was, 3 generations of 4 x 4, and 3 seeds x 2 cases twice
        assert len(flown) == 4 + 48 + 12 and found[-1].flights == 52
    assert found[0].trials == found[1].trials
    for file in ("trials.csv", "middle_loop.yaml", "result.json"):
        assert (tmp_path / "a" / file).read_text() == (tmp_path / "b" / file).read_text()
    assert found[0].judgement.better
    assert found[0].best.gains == pytest.approx((3.0, 2.5), abs=1.0)


def test_the_command_leaves_gains_that_a_run_flies(page, tmp_path, hand_over):
    hand_over()
    done = call_command(
        "tune", page, "--out", "out", "--json", "-", cwd=tmp_path, code=0, columns=120
    )
    found = json.loads(done.stdout)
    assert found["judgement"]["better"] and found["seeds"] == [1, 2]
    assert found["gains"]["controller.gains.course.p"]["before"] == 4.0  # of the profile
    assert found["gains"]["formation.k"]["before"] == 3.0
    assert "generation 3 of 3" in done.stderr and "better on seeds it was not tuned" in done.stderr
    tuned = load(tmp_path / "out" / "tuned.yaml")
    course = gains_of(tuned, "rascal110").course.p
    assert course == found["gains"]["controller.gains.course.p"]["after"] != 4.0
    assert tuned.formation.k == found["gains"]["formation.k"]["after"]
    assert tuned.controller.gains == {} and tuned.name == "small-tuned"
    own = gains_of(tuned, "rascal110").model_dump()
    paper = load_middle_loop("rascal110", "paper").model_dump()
    assert {key for key in own if own[key] != paper[key]} == {"course"}
    lines = (tmp_path / "out" / "trials.csv").read_text().splitlines()
    assert len(lines) == 2 + 12 and len(set(map(len, (row.split(",") for row in lines)))) == 1


def test_a_search_that_is_interrupted_keeps_what_it_has(page, tmp_path, hand_over):
    hand_over(stop_after=25)  # in the second generation
    done = call_command("tune", page, "--out", "out", cwd=tmp_path, code=130, columns=120)
    assert "interrupted: what was found is in out; best so far: tuned.yaml" in done.stderr
    assert len((tmp_path / "out/trials.csv").read_text().splitlines()) == 2 + 4
    assert "not held to other seeds" in (tmp_path / "out/middle_loop.yaml").read_text()
    load(tmp_path / "out/tuned.yaml")


def test_gains_that_the_page_had_are_in_the_file_and_not_twice(page, tmp_path, hand_over):
    hand_over()
    own = "extends: simulation-3\nscenario: {name: own}\n"
    (tmp_path / "own.yaml").write_text(own + "controller: {gains: {course: {p: 5}, eta_bank: 0.2}}")
    changed = PAGE.replace("simulation-3", "own.yaml").replace(
        "  seeds:", "  set: {controller.gains.speed.i: 0.03}\n  seeds:"
    )
    page.write_text(changed)
    out = tmp_path / "out"
    out.mkdir()
    tuned = tune_gains(Tuner(load_tune(page)), out)
    assert tuned.trials[0].gains[0] == 5.0
    flown = load(out / "tuned.yaml")
    gains = gains_of(flown, "rascal110")
    assert flown.controller.gains == {}
    assert (gains.course.p, gains.eta_bank, gains.speed.i) == (tuned.best.gains[0], 0.2, 0.03)


def test_gains_that_are_no_better_are_left_as_they_were(page, tmp_path, hand_over):
    def worse(task):
        flown = made_up(task)
        changed = gains_of(task.page, "rascal110").course.p != 4.0
        flown.metrics["portions"]["rectangles"]["mean_rms_m"] += 50.0 * changed
        return flown

    hand_over(worse)
    done = call_command("tune", page, "--out", "out", cwd=tmp_path, code=0, columns=120)
    assert "nothing better was found" in done.stdout
    assert not (tmp_path / "out/middle_loop.yaml").exists()
    assert json.loads((tmp_path / "out/result.json").read_text())["judgement"] is None


def test_real_flights_are_counted(page, tmp_path, hand_over):
    small = PAGE.replace("duration_s: 100", "duration_s: 6").replace("seeds: [1, 2]", "seeds: 1")
    small = small.replace("cases: {calm: {}, windy: {air.wind.speed_mps: 3}}\n", "")
    ideal = "{fleet.*.vehicle: ideal, scenario.published: null, "
    ideal += "scenario.portions: {rectangles: [2, 6]}}"
    small = small.replace("  seeds: 1\n", f"  seeds: 1\n  set: {ideal}\n")
    page.write_text(small.replace("flights: 52", "flights: 5"))
    hand_over(fly)
    tuned = tune_gains(Tuner(load_tune(page)), tmp_path)
    assert len(tuned.trials) == 5
    assert all(0.0 < trial.cost < tuned.bound for trial in tuned.trials)
    assert len({trial.cost for trial in tuned.trials}) == 5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("from: 1, to: 9", "from: 9, to: 1"),
            "small.yaml:9:44: gains.controller.gains.course.p.to",
        ),
        (("from: 1, to: 9", "from: 0, to: 9"), "write a number above 0, or scale: linear"),
        (("controller.gains.course.p", "controller.gains.curse.p"), "did you mean 'course'"),
        (("formation.k", "fleet.0.start_m"), "is not one number of the page"),
        (("formation.k", "formation.offsets_m"), "is not one number of the scenario"),
        (("formation.k: {from: 1", "formation.k: {from: -1"), "simulation-3 cannot be flown there"),
        (("[7, 8, 9]", "[2, 8, 9]"), "has seeds of study.seeds"),
        (("[7, 8, 9]", "[8, 8, 9]"), "has a seed twice"),
        (("robust: mean", "robust: {quantile: 2}"), "objective.robust"),
        (("robust: mean", "robust: best"), "objective.robust"),
        (("flights: 52", "flights: 19"), "write 20 at least"),
        ((METRIC, "portions.rectangle.mean_rms_m"), f"did you mean '{METRIC}'"),
        (("simulation-3", "mixed-fleet"), "gains of a middle loop are one airframe's"),
        (("search:", "serch:"), "serch"),
    ],
)
def test_what_cannot_be_tuned_is_refused_with_its_place(page, tmp_path, hand_over, change, said):
    hand_over()
    page.write_text(PAGE.replace(*change))
    done = call_command("tune", page, "--out", "out", cwd=tmp_path, code=2, columns=200)
    assert said in done.stderr


def test_the_tunes_that_come_along_can_be_flown():
    assert list_tunings()
    for name in list_tunings():
        tune = load_tune(name)
        assert tune.study.name == name == find_tuning(name).stem
        Tuner(tune)


def test_gains_of_the_page_are_over_those_of_the_profile():
    changes = ["controller.gains.course.p=3.3", "controller.gains.eta_bank=0.05"]
    ours = gains_of(load("simulation-3", changes), "rascal110")
    paper = load_middle_loop("rascal110", "paper")
    assert (ours.course.p, ours.eta_bank) == (3.3, 0.05)
    assert (ours.course.i, ours.speed) == (paper.course.i, paper.speed)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["controller.gains.curse.p=3"], "controller.gains.curse: is not a key of this part: did"),
        (["controller.gains.course.p=-3"], "controller.gains.course.p: is -3 (write a number at"),
        (["controller.gains.course=3"], "controller.gains.course: is 3 (write a map"),
        (["controller.middle_loop=nowhere.yaml"], "there is no file"),
    ],
)
def test_gains_that_are_wrong_are_named(changes, said):
    with pytest.raises(ScenarioError, match=r"controller\.") as refusal:
        load("simulation-3", changes)
    assert said in str(refusal.value)


def test_one_file_of_gains_is_for_one_airframe(tmp_path):
    file = find_tuning(list_tunings()[0]).parents[3] / "aircraft/rascal110/middle_loop.yaml"
    ours = load("simulation-3", [f"controller.middle_loop={file}", "controller.profile=authors"])
    assert gains_of(ours, "rascal110") == load_middle_loop("rascal110", "authors")
    with pytest.raises(ScenarioError, match="is for one airframe, and the fleet has"):
        load("mixed-fleet", [f"controller.middle_loop={file}"])
