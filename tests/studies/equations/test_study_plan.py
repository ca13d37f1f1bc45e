"""Studies: levels, points and seeds of a plan, invalid files, rows and the journal."""

import math
import os
import statistics
from functools import cache

import numpy as np
import pytest
from cases import ALL

from testbed.atmosphere.turbulence_field import make_field
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.scenario import ScenarioError, list_studies, load_scenario
from testbed.studies.journal import Journal, JournalRow
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan
from testbed.studies.study_schema import Variation
from testbed.studies.table import column_type

HEAD = "study: {schema: 1, name: s, scenario: simulation-3, "


def study(tmp_path, text):
    path = tmp_path / "s.yaml"
    path.write_text(text)
    return load_study(path)


def levels(**keys):
    values = Variation.model_validate(keys)
    return [values.level(k) for k in range(values.level_count)]


def test_levels_are_exact_decimals():
    assert levels(**{"from": 0, "to": 1, "step": 0.1})[3] == 0.3
    assert len(levels(**{"from": 0, "to": 1, "step": 0.1})) == 11
    assert levels(**{"from": 0, "to": 1, "step": 0.3}) == [0, 0.3, 0.6, 0.9]
    eighths = levels(**{"from": 0, "to": 8, "count": 3})
    assert eighths == [0, 4, 8] and all(isinstance(each, int) for each in eighths)
    assert levels(**{"from": 0, "to": 1, "count": 4}) == [0, 1 / 3, 2 / 3, 1]
    assert levels(choice=["a", 2, True]) == ["a", 2, True]


@pytest.mark.parametrize(
    ("keys", "column"),
    [
        ({"choice": [1, 2]}, "int64"),
        ({"choice": [1, 2.5]}, "double"),
        ({"choice": [True, False]}, "bool"),
        ({"choice": ["a", 1]}, "string"),
        ({"choice": [True, 1]}, "string"),
        ({"uniform": (0, 1)}, "double"),
        ({"from": 0, "to": 8, "count": 3}, "int64"),
    ],
)
def test_column_type_fits_all_levels(keys, column):
    assert column_type(Variation.model_validate(keys)) == column


def test_distributions_have_their_quantiles():
    uniform, log, normal = (
        Variation.model_validate(each)
        for each in ({"uniform": (2, 4)}, {"log_uniform": (0.01, 100)}, {"normal": (5, 2)})
    )
    assert uniform.quantile(0.25) == 2.5
    assert log.quantile(0.5) == pytest.approx(1.0, rel=1e-12)
    assert log.quantile(0.0) == 0.01
    assert normal.quantile(0.5) == 5.0
    assert normal.quantile(statistics.NormalDist().cdf(1.5)) == pytest.approx(8.0, rel=1e-12)
    assert math.isfinite(normal.quantile(0.0))
    thirds = Variation.model_validate({"choice": ("a", "b", "c")})
    assert [thirds.quantile(share) for share in (0, 0.33, 0.34, 0.999999)] == ["a", "a", "b", "c"]


FACTORIAL = (
    HEAD
    + """design: factorial, seeds: [7, 3], set: {network.delay_s: 0.05}, duration_s: 90}
vary:
  network.loss: [0, 0.1, 0.3]
  air.wind.speed_mps: {from: 0, to: 8, count: 2}
cases:
  plain: {}
  noisy: {fleet.*.sensors: gps-ins}
"""
)


def test_plan_factorial_runs_in_order(tmp_path):
    plan = Plan(study(tmp_path, FACTORIAL))
    assert len(plan) == 2 * 3 * 2 * 2
    runs = list(plan)
    assert [run.number for run in runs] == list(range(24))
    assert [run.case for run in runs] == ["plain"] * 12 + ["noisy"] * 12
    assert [run.seed for run in runs[:4]] == [7, 3, 7, 3]
    points = [tuple(run.point.values()) for run in runs[:12:2]]
    assert points == [(0, 0), (0, 8), (0.1, 0), (0.1, 8), (0.3, 0), (0.3, 8)]
    assert plan[23] == runs[23]
    assert runs[23].command == (
        "testbed run simulation-3 --set network.delay_s=0.05 --set 'fleet.*.sensors=gps-ins' "
        "--set network.loss=0.3 --set air.wind.speed_mps=8 --duration 90 --seed 3"
    )
    with pytest.raises(IndexError):
        plan[24]


def test_design_is_factorial_by_default(tmp_path):
    text = HEAD + "}\nvary: {network.loss: [0, 0.5], network.delay_s: [0, 0.1, 0.2]}"
    plan = Plan(study(tmp_path, text))
    assert [plan.point(k) for k in range(plan.point_count)] == [
        {"network.loss": loss, "network.delay_s": delay}
        for loss in (0, 0.5)
        for delay in (0, 0.1, 0.2)
    ]
    with pytest.raises(
        ScenarioError, match=r"a distribution, which a factorial design cannot have"
    ):
        study(tmp_path, HEAD + "}\nvary: {network.loss: {uniform: [0, 1]}}")


def test_plan_scenario_is_that_of_the_command(tmp_path):
    from testbed.scenario import set_duration

    plan = Plan(study(tmp_path, FACTORIAL))
    run = plan[23]
    ours = plan.scenario(run)
    assert ours == set_duration(
        load_scenario("simulation-3", [*run.overrides, "scenario.seed=3"]), 90
    )
    assert (ours.network.loss.probability, ours.scenario.seed) == (0.3, 3)


def test_case_values_of_any_type_are_kept(tmp_path):
    text = (
        HEAD
        + "}\n"
        + """
cases:
  all:
    scenario.question: "yes, # it: is"
    air.turbulence: {model: coherent, intensity: moderate}
    formation.offsets_m.uav1: [-1.0e-7, 5, 0]
    scenario.expectation: "07"
"""
    )
    scenario = Plan(study(tmp_path, text)).case_scenario(0)
    assert scenario.scenario.question == "yes, # it: is"
    assert scenario.scenario.expectation == "07"
    assert scenario.air.turbulence.model == "coherent"
    assert scenario.formation.offsets_m["uav1"] == (-1e-7, 5, 0)


def drawn(tmp_path, design, *more):
    keys = {"network.loss": "{uniform: [0, 1]}", "air.wind.speed_mps": "{normal: [5, 1]}"}
    keys |= dict(more)
    text = f"{HEAD}design: {design}, samples: 40, design_seed: 2}}\nvary:\n"
    text += "".join(f"  {key}: {value}\n" for key, value in keys.items())
    plan = Plan(study(tmp_path, text))
    points = [plan.point(k) for k in range(plan.point_count)]
    return {key: [point[key] for point in points] for key in keys}


def test_latin_hypercube_one_point_in_each_part(tmp_path):
    values = drawn(tmp_path, "latin-hypercube")
    assert sorted(int(40 * value) for value in values["network.loss"]) == list(range(40))
    shares = [statistics.NormalDist(5, 1).cdf(v) for v in values["air.wind.speed_mps"]]
    assert sorted(int(40 * share) for share in shares) == list(range(40))
    assert values["network.loss"] != sorted(values["network.loss"])
    assert abs(statistics.correlation(*values.values())) < 0.5


@pytest.mark.parametrize("design", ["latin-hypercube", "monte-carlo"])
def test_design_new_key_changes_no_other_values(tmp_path, design):
    before = drawn(tmp_path, design)
    after = drawn(tmp_path, design, ("network.delay_s", "{log_uniform: [0.01, 1]}"))
    assert {key: after[key] for key in before} == before
    assert drawn(tmp_path, design) == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "design: factorial}", "study.design: has nothing to vary"),
        (HEAD + "desing: factorial}", "did you mean 'design'?"),
        (HEAD + "design: latin}\nvary: {a.b: [1]}", "latin-hypercube, monte-carlo or map"),
        (HEAD + "seeds: 0}", "study.seeds: must be 1 to 100,000"),
        (HEAD + "seeds: [1, 1]}", "study.seeds: has an element twice"),
        (HEAD + "samples: 3}", "study.samples: is for latin-hypercube"),
        (HEAD + "design: monte-carlo}\nvary: {a.b: [1]}", "write samples: 40"),
        (HEAD + "set: {scenario.seed: 3}}", "study.set.scenario.seed: the study sets the seeds"),
        (
            HEAD + "design: factorial}\nvary:\n  network.loss: {uniform: [0, 1]}",
            "s.yaml:3:17: vary.network.loss: is a distribution",
        ),
        (
            HEAD + "design: factorial}\nvary: {a.b: {from: 0, to: 1}}",
            "either count or step",
        ),
        (HEAD + "design: factorial}\nvary: {a.b: {from: 1, to: 0, step: 1}}", "above from, 1"),
        (HEAD + "design: factorial}\nvary: {a.b: {form: 1}}", "did you mean 'from'?"),
        (HEAD + "design: factorial}\nvary: {a.b: [0, 0.0]}", "has 0.0 twice"),
        (HEAD + "design: factorial}\nvary: {a.b: [[1, 2]]}", "must be a number, a word"),
        (HEAD + "design: factorial}\nvary: {a.b: {uniform: [2, 1]}}", "write [low, high]"),
        (HEAD + "design: factorial}\nvary: {a.b: {log_uniform: [0, 1]}}", "above 0"),
        (
            HEAD + "design: factorial}\nvary: {a.b: [1]}\ncases: {x: {a.b: 2}}",
            "cases.x.a.b: is also in vary",
        ),
        (
            HEAD + '}\ncases:\n  x: {label: ""}',
            "s.yaml:3:14: cases.x.label: must be a text of one line",
        ),
        (HEAD + "}\ncases: {x: {label: 3}}", "cases.x.label: must be a text of one line"),
        (
            HEAD + "}\ncases: {x: {label: law y}, y: {label: law y}}",
            "cases.x.label: is also what stands for y",
        ),
        (
            HEAD + "design: factorial}\nvary: {a.b: {choice: [1], label: c.d}, c.d: [2]}",
            "vary.a.b.label: is also what stands for c.d",
        ),
        (HEAD + f"}}\ncases: {{x: {{label: {'x' * 81}}}}}", "has 81 letters (write at most 80)"),
        (
            HEAD + "design: factorial, seeds: 1000}\nvary: {a.b: {from: 0, to: 9999, step: 1}}",
            "has 10,000,000 runs",
        ),
    ],
)
def test_study_file_invalid_keys_are_refused(tmp_path, text, message):
    with pytest.raises(ScenarioError) as error:
        study(tmp_path, text)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            HEAD + "design: factorial}\nvary:\n  network.loss: [0, 2]",
            "s.yaml:3:17: vary.network.loss: network.loss=2: network.loss",
        ),
        (
            HEAD + "}\ncases:\n  a: {}\n  b: {network.los: 1}",
            "s.yaml:4:20: cases.b.network.los: network.los=1: network.los: is not a key",
        ),
        (HEAD + "set: {fleet.uav9.sensors: truth}}", "s.yaml:1:"),
        (
            HEAD + "design: monte-carlo, samples: 5}\nvary:\n  network.loss: {uniform: [2, 3]}",
            "s.yaml:3:17: vary.network.loss: network.loss=2.",
        ),
        (
            HEAD + "}\ncases:\n  x: {scenario: nowhere}",
            "s.yaml:3:17: cases.x.scenario: there is no scenario 'nowhere'",
        ),
    ],
)
def test_check_plan_invalid_scenario_has_its_place(tmp_path, text, message):
    with pytest.raises(ScenarioError) as error:
        check_plan(Plan(study(tmp_path, text)))
    assert message in str(error.value)


ALIKE = ("gap-budget-2", "gap-budget-3")  # the keys of gap-budget-1


@cache
def small_field():
    return make_field(1, np.ones(3), np.full(3, 100.0), path_m=1000.0)


def one_field(*_, **__):
    """Return the same field of turbulence for all: nothing is flown."""
    return small_field()


@pytest.mark.parametrize("name", list_studies())
def test_check_plan_library_studies_are_valid(name, monkeypatch):
    """Every level of every key; with TESTBED_STUDIES=1 up to 2,000 points."""
    if not os.environ.get("TESTBED_STUDIES"):
        monkeypatch.setattr("testbed.studies.plan_check.MAX_CHECKED", 20 if ALL else 3)
        monkeypatch.setattr("testbed.plan.air.make_field", one_field)
        if name in ALIKE and not ALL:  # one of them shows that its keys act in a flight
            monkeypatch.setattr("testbed.studies.plan_check.MAX_BUILT", 0)
        if name == "laws" and not ALL:  # tests/formation builds the laws of the library
            monkeypatch.setattr("testbed.studies.plan_check.MAX_BUILT", 0)
            monkeypatch.setattr("testbed.studies.plan_check.check_code", lambda scenario: None)
    chosen = load_study(name)
    assert chosen.name == name and chosen.config.study.question
    checked = check_plan(Plan(chosen))
    assert checked.invalid == 0


def test_check_plan_invalid_drawn_value_is_counted(tmp_path):
    text = HEAD + "design: latin-hypercube, samples: 4}\nvary: {network.loss: {uniform: [-1, 1]}}"
    checked = check_plan(Plan(study(tmp_path, text)))
    assert (checked.checked, checked.invalid) == (4, 2)
    assert "network.loss" in checked.example


def test_check_plan_many_points_reads_every_level(tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.studies.plan_check.MAX_CHECKED", 10)
    text = HEAD + "design: factorial}\nvary:\n"
    text += "  network.loss: {from: 0, to: 0.5, count: 6}\n  network.delay_s: [0, 0.1, 0.2, -1]\n"
    with pytest.raises(ScenarioError, match="network.delay_s=-1"):
        check_plan(Plan(study(tmp_path, text)))


def test_flatten_metrics_only_numbers_of_the_flight():
    document = {
        "schema": 1,
        "seed": 4,
        "versions": {"schema": "1", "jsbsim": "1"},
        "wall_s": 3.0,
        "windows": {"laps": {"rms_m": {"uav1": 1.5, "uav2": None}, "complete": True}},
        "slot_speed_mps": {"uav1": [20, 25.0]},
        "min_separation_between": ["leader", "uav1"],
        "network": {"links": {"a": {"b": {"sent": 1}}}, "all": {"sent": 2}},
        "events": [{"time_s": 1.0}],
    }
    assert flatten_metrics(document) == {
        "windows.laps.rms_m.uav1": 1.5,
        "windows.laps.rms_m.uav2": None,
        "slot_speed_mps.uav1.0": 20.0,
        "slot_speed_mps.uav1.1": 25.0,
        "network.all.sent": 2.0,
    }


def test_journal_is_read_back_in_order_of_runs(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"study": {"n": 1}})
    rows = [
        JournalRow(2, "completed", "", {"a.b": 0.1 + 0.2, "c": None}),
        JournalRow(0, "lost", "lost: é", {"d": 1e-300}),
        JournalRow(5, "failed", "why", {}),
        JournalRow(1, "completed", "", {"a": None, "c": 3.0}),
    ]
    for row in rows:
        journal.add(row)
    journal.close()
    path.write_bytes(path.read_bytes() + b'{"run":7,"outco')
    again = Journal(path)
    assert again.inputs == {"study": {"n": 1}}
    assert list(again.rows()) == sorted(rows, key=lambda row: row.run)
    assert again.names() == ("d", "c", "a.b")  # what is below a stands for a
    assert 7 not in again and 5 in again
    again.add(JournalRow(7, "completed", "", {"d": 2.0}))
    again.close()
    last = Journal(path)
    assert [row.run for row in last.rows()] == [0, 1, 2, 5, 7]
    last.close()


def test_journal_damaged_line_is_refused(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"study": {"n": 1}})
    for run in range(3):
        journal.add(JournalRow(run, "completed", "", {"a": 1.0}))
    journal.close()
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], b"{\n", *lines[3:]]))
    with pytest.raises(ValueError, match=r"j:3: is not a line of a journal"):
        Journal(path)
