"""What a study names is looked for before its first flight: metrics, laws, files."""

import json
import shlex

import pytest
import small_study
from commands import call_command, times_of_files

import testbed
from testbed.core.errors import InputError
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.scenario import load_scenario, loads, set_duration
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan, number_names
from testbed.studies.sweep import sweep
from testbed.studies.table import read_rows
from testbed.tuning.tuning import Tuning

BAD_INPUT = 2
HEAD = "study: {{schema: 1, name: s, scenario: simulation-3, duration_s: 3, metrics: [{}]}}\n"
LAW = """
class Plain:
    def __init__(self, config):
        self.builtin = config.hbh23

    def start(self, own):
        return self.builtin.start(own)

    def step(self, now, own, inbox, memory):
        return self.builtin.step(now, own, inbox, memory)
"""


def check(folder, text):
    (folder / "s.yaml").write_text(text)
    return check_plan(Plan(load_study(folder / "s.yaml")))


@pytest.mark.parametrize(
    ("name", "error"),
    [
        (
            "max_error_m",
            "(write for example max_error_m.uav1, max_error_m.uav2, max_error",
        ),
        ("min_separaton_m", "did you mean 'min_separation_m'?"),
        ("windows.circle.mean_rms_m", "did you mean 'windows.circles.mean_rms_m'?"),
        ("windows.circles.rms_m.uav4", "did you mean 'windows.circles.rms_m.uav"),
        (
            "nonsense",
            "(write for example windows.rectangles.mean_rms_m, windows.circles",
        ),
    ],
)
def test_unknown_metric_is_an_error_before_flight(tmp_path, name, error):
    (tmp_path / "s.yaml").write_text(HEAD.format(f"max_error_m.uav1, {name}"))
    before = times_of_files(tmp_path)
    done = call_command("sweep", "s.yaml", "--quiet", cwd=tmp_path, code=BAD_INPUT, columns=200)
    assert done.stderr.startswith(
        f"error: s.yaml:1:96: study.metrics.1: no run has a number '{name}'"
    )
    assert error in done.stderr and done.stderr.count("\n") == 1
    assert times_of_files(tmp_path) == before


def test_metric_of_any_case_or_window_is_known(tmp_path):
    """Also one of a window that the duration of the study drops: a warning names it."""
    names = "windows.circles.rms_m.uav3, windows.laps.mean_rms_m, network.all.lost.faded"
    cases = "cases:\n  a: {}\n  b: {scenario: mine.yaml}\n"
    (tmp_path / "mine.yaml").write_text(
        "extends: simulation-3\nscenario: {windows: {laps: [1, 2]}, published: null}\n"
    )
    check(tmp_path, HEAD.format(names) + cases)


def test_metric_of_a_tune_is_checked(tmp_path):
    text = """
study: {schema: 1, name: t, scenario: simulation-3, duration_s: 100}
gains: {formation.k: {from: 1, to: 5}, controller.gains.course.p: {from: 1, to: 9}}
objective: {metric: windows.rectangle.mean_rms_m}
search: {max_flights: 52}
"""
    (tmp_path / "t.yaml").write_text(text)
    with pytest.raises(InputError, match=r"t.yaml:4:21: objective.metric: no run has a number"):
        Tuning(tmp_path / "t.yaml")
    (tmp_path / "t.yaml").write_text(text.replace("rectangle.", "rectangles."))
    Tuning(tmp_path / "t.yaml")


@pytest.mark.parametrize(
    "settings",
    [["network.loss=0.3"], ["fleet.*.sensors=gps-ins"], ["expect.min_separation_m.min=1"]],
    ids=["loss", "sensors", "bounds"],
)
def test_known_numbers_are_those_of_a_flight(settings):
    """Every number of a flight is known; those that are known are its own but where null."""
    scenario = set_duration(load_scenario("ideal-figure-eight", settings), 1.0)
    known = set(number_names(scenario))
    numbers = set(flatten_metrics(testbed.run(scenario, write=False).metrics))
    assert numbers - known == set()
    nulls = {each for each in known - numbers if each.startswith(("network.all.", "begin_s"))}
    assert known - numbers == nulls


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ("controller.law: nowhere:Plain", r"cases.b.controller.law: no module 'nowhere'"),
        ("controller.law: plain:Plane", r"cases.b.controller.law: .* has no class 'Plane'"),
        (
            "controller.law: plain:Plain, controller.options: {gain: 2}",
            r"cases.b.controller.options: Plain\(config\) cannot be built: .*'gain'",
        ),
        (
            "formation.barrier: {example: own, function: nowhere:h}",
            r"cases.b.formation.barrier: .*no module 'nowhere'",
        ),
    ],
)
def test_code_that_cannot_be_built_is_an_error(tmp_path, change, error):
    (tmp_path / "plain.py").write_text(LAW)
    cases = f"cases:\n  a: {{}}\n  b: {{{change}}}\n"
    with pytest.raises(InputError, match=rf"s\.yaml:4:\d+: {error}"):
        check(tmp_path, HEAD.format("min_separation_m") + cases)


def test_check_finds_a_missing_law_before_flight(tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "extends: simulation-3\ncontroller: {law: nowhere:Plain}\nscenario: {published: null}\n"
    )
    arguments = ("check", "mine.yaml", "--update", "--reason", "x")
    done = call_command(*arguments, cwd=tmp_path, code=BAD_INPUT, columns=200)
    assert done.stderr.startswith("error: mine.yaml:2:19: controller.law: no module 'nowhere'")


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder of a study that is not the current one, and flights in this process."""
    workers = small_study.InThisProcess()
    monkeypatch.setattr("testbed.pool.flight_pool._open_workers", lambda *_: workers)
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "elsewhere"


def test_law_beside_the_study_is_found_and_repeated(elsewhere, tmp_path):
    (elsewhere / "plain.py").write_text(LAW)
    text = small_study.STUDY.replace("near: {}", "near: {controller.law: plain:Plain}")
    study = small_study.write(elsewhere, text.replace("far:", "# far:"))
    lines = []
    sweep(study, tmp_path / "s.parquet", report=lines.append)
    assert lines[-1] == (
        "all seeds of 1 further point were flown, and gave the same numbers (write fewer seeds)"
    )
    row = read_rows(tmp_path / "s.parquet")[3]
    assert row["outcome"] == "completed"
    words = shlex.split(row["command"])
    assert f'controller.law="{elsewhere}/plain.py:Plain"' in words
    out = tmp_path / "metrics.json"
    call_command(*words[1:], "--json", out, "--quiet", cwd=tmp_path, code=0, columns=80)
    again = flatten_metrics(json.loads(out.read_text()))
    assert again["max_error_m.uav3"] == row["metrics.max_error_m.uav3"]


def test_paths_of_a_study_are_beside_it_first(elsewhere):
    """The current directory comes second; the command names what was found."""
    tune = "vary:\n  leader.tune: [a.param, b.param]\n"
    source = testbed.scenario.find_tune("rascal110", "autopilot").read_text()
    for file in (elsewhere / "a.param", elsewhere.parent / "here" / "a.param"):
        file.write_text(source)
    (elsewhere.parent / "here" / "b.param").write_text(source)
    (elsewhere / "s.yaml").write_text(HEAD.format("min_separation_m") + tune)
    plan = Plan(load_study(elsewhere / "s.yaml"))
    check_plan(plan)
    found = [plan.scenario(run).leader.tune for run in plan]
    assert found == [f"{elsewhere}/a.param", f"{elsewhere.parent}/here/b.param"]
    words = [shlex.split(run.command)[4] for run in plan]
    assert words == [f"leader.tune={elsewhere}/a.param", "leader.tune=b.param"]
    (elsewhere.parent / "here" / "b.param").unlink()
    with pytest.raises(InputError, match=r"s.yaml:3:\d+: vary.leader.tune: .* no file .*/b.param"):
        check_plan(Plan(load_study(elsewhere / "s.yaml")))


def test_begin_of_a_scenario_is_beside_it(elsewhere):
    (elsewhere / "first.yaml").write_text("extends: simulation-3\n")
    mine = elsewhere / "mine.yaml"
    mine.write_text("extends: simulation-3\nscenario: {begin: {scenario: first.yaml, at_s: 10}}\n")
    assert load_scenario(mine).scenario.begin.scenario == f"{elsewhere}/first.yaml"
    mine.write_text(mine.read_text().replace("first.yaml", "simulation-2"))
    assert load_scenario(mine).scenario.begin.scenario == "simulation-2"
    mine.write_text(mine.read_text().replace("simulation-2", "second.yaml"))
    with pytest.raises(InputError, match=r"mine.yaml:2:\d+: scenario.begin.scenario: .* no file"):
        load_scenario(mine)
    with pytest.raises(InputError, match="no file"):
        loads("extends: simulation-3\nscenario: {begin: {scenario: first.yaml, at_s: 10}}\n")
