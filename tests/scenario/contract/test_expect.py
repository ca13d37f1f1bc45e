"""Bounds of a scenario's numbers: what applies, what is violated, and what commands do then."""

import json
import re

import golden_scenarios as samples
import pytest
from commands import call_command
from small_study import in_this_process

from testbed.metrics.expectations import check_expectations, describe_violation, violations
from testbed.runs.bounds import unchecked_bounds
from testbed.scenario import load_scenario, set_duration

DIFFERENT = 3
RMS = "  rms_m: {max: 2, circles: {max: 1, uav2: {min: 0.001, max: 0.01}}}"
EXPECT = f"""
expect:
{RMS}
  min_separation_m: {{min: 5}}
"""


def document(**rms):
    """The parts of a metrics document that bounds refer to."""
    windows = {
        name: {"covered_s": 5.0, "rms_m": errors, "mean_rms_m": 1.0} for name, errors in rms.items()
    }
    names = next(iter(rms.values()))
    return {
        "windows": windows,
        "min_separation_m": 6.0,
        "joined_at_s": dict.fromkeys(names, 1.0),
        "lost_at_s": dict.fromkeys(names),
    }


def bounds(found, side="max"):
    return {
        (each["window"], each["follower"]): each["bound"]
        for each in found["bounds"]
        if each["side"] == side
    }


def test_most_specific_bound_applies():
    result = document(turn={"uav1": 1.0, "uav2": 1.0}, straight={"uav1": 1.0, "uav2": 1.0})
    expect = {"max": 3.0, "min": 0.5, "turn": {"max": 4.0, "uav2": {"max": 5.0}}}
    found = check_expectations(result, {"rms_m": expect})
    assert bounds(found) == {
        ("turn", "uav1"): 4.0,
        ("turn", "uav2"): 5.0,
        ("straight", "uav1"): 3.0,
        ("straight", "uav2"): 3.0,
    }
    assert set(bounds(found, "min").values()) == {0.5}
    assert (found["checked"], found["violated"]) == (8, 0)
    both = {"max": 9.0, "turn": {"max": 2.0}, "uav1": {"max": 0.9}}
    found = check_expectations(result, {"rms_m": both})
    violated = [each["key"] for each in found["bounds"] if not each["met"]]
    assert violated == [["rms_m", "uav1", "max"]] * 2  # in the turn the window's holds as well
    assert found["checked"] == 5


@pytest.mark.parametrize(
    ("change", "expect", "texts"),
    [
        ({}, {"min_separation_m": {"min": 6.0}}, []),  # a bound itself is inside
        ({}, {"min_separation_m": {"min": 7.0}}, ["6 m, below 7 m"]),
        ({}, {"mean_rms_m": {"turn": {"max": 0.5}}}, ["in turn: 1 m, above 0.5 m"]),
        (
            {"joined_at_s": {"uav1": None, "uav2": 9.0}},
            {"joined_at_s": {"max": 8}},
            ["uav1: no value, not within 8 s", "uav2: 9 s, above 8 s"],
        ),
        (
            {"joined_at_s": {"uav1": None, "uav2": 1.0}, "lost_at_s": {"uav1": 2.0, "uav2": None}},
            {"joined_at_s": {"max": 8}},
            [],  # an aircraft that was lost has no number
        ),
    ],
)
def test_violations_name_follower_window_and_value(change, expect, texts):
    result = document(turn={"uav1": 1.0, "uav2": 1.0}) | change
    found = {"expect": check_expectations(result, expect)}
    assert [describe_violation(each) for each in violations(found)] == texts


def test_window_that_was_not_reached_is_not_compared():
    result = document(turn={"uav1": None}, straight={"uav1": 1.0})
    result["windows"]["turn"]["covered_s"] = 0.0
    found = check_expectations(result, {"rms_m": {"max": 2.0}})
    assert bounds(found) == {("straight", "uav1"): 2.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("expect")
    samples.write(folder, "mine", EXPECT)
    return folder


def test_run_violated_bound_exits_3_with_its_line(folder):
    options = ("--set", "log.mcap=false", "--out", "run")
    done = call_command("run", "mine.yaml", *options, cwd=folder, code=DIFFERENT, columns=100)
    line = 1 + (folder / "mine.yaml").read_text().splitlines().index(RMS)
    (last,) = [each for each in done.stdout.splitlines() if each.startswith("mine.yaml:")]
    assert last.startswith(f"mine.yaml:{line}:")
    assert ": expect.rms_m.circles.uav2.max: uav2 in circles: 0." in last
    assert last.endswith(" m, above 0.01 m")
    assert re.search(r"expected +1 of 8 numbers outside their bounds", done.stdout)
    metrics = json.loads((folder / "run" / "metrics.json").read_text())
    assert (metrics["expect"]["checked"], metrics["expect"]["violated"]) == (8, 1)


def test_sweep_violated_bound_exits_3_with_its_line(folder):
    (folder / "study.yaml").write_text(
        "study: {schema: 1, name: study, scenario: mine.yaml, set: {log.mcap: false}}\n"
        "vary: {expect.rms_m.circles.uav2.max: [0.01, 1]}\n"
    )
    words = ("sweep", "study.yaml", "--out", "study", "--json", "found.json")
    with in_this_process():
        done = call_command(*words, cwd=folder, code=DIFFERENT, columns=100)
    assert "warning: run 0: --set expect.rms_m.circles.uav2.max=0.01: expect.rms_m" in done.stderr
    assert "1 completed with numbers outside the bounds of the scenario" in done.stdout
    found = json.loads((folder / "found.json").read_text())
    assert (found["outcomes"]["completed"], found["unexpected"]) == (2, 1)
    (failure,) = found["failures"]
    assert failure["run"] == 0 and failure["command"].startswith("testbed run mine.yaml --set")


def test_sweep_of_flights_that_end_early_exits_3(folder):
    (folder / "early.yaml").write_text(
        "study: {schema: 1, name: early, scenario: mine.yaml, set: {log.mcap: false, "
        "scenario.duration_s: 60, limits.on_violation: stop}}\n"
        "vary: {expect.rms_m.circles.uav2.max: [0.001, 1]}\n"
    )
    words = ("sweep", "early.yaml", "--out", "early", "--json", "early.json")
    with in_this_process():
        call_command(*words, cwd=folder, code=DIFFERENT, columns=100)
    found = json.loads((folder / "early.json").read_text())
    assert (found["outcomes"]["completed"], found["outcomes"]["bound_violated"]) == (1, 1)
    assert found["failures"][0]["error"].startswith("expect.rms_m.circles.uav2.max: uav2")


def test_shorter_run_warns_of_bounds_it_does_not_check(folder):
    whole = load_scenario(folder / "mine.yaml")
    assert unchecked_bounds(whole, 14.0) == []
    text = "is not checked: the run ends at 7 s, before circles (8 to 14 s)"
    assert unchecked_bounds(whole, 7.0) == [f"expect.rms_m.circles {text}"]
    assert set_duration(whole, 7.0).expect.model_dump() == {
        "rms_m": {"max": 2.0},
        "min_separation_m": {"min": 5.0},
    }
    assert set_duration(whole, 3.0).expect.model_dump() == {"min_separation_m": {"min": 5.0}}
    assert [line.split()[0] for line in unchecked_bounds(whole, 3.0)] == ["expect.rms_m"]
