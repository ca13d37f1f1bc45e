"""`testbed.Tuning`: the flights of a tuning file for other optimisers."""

import importlib.util
import json
import re

import numpy as np
import pytest
from commands import call_command
from places import ROOT
from small_study import InThisProcess, in_this_process

import testbed
from testbed.core.errors import InputError
from testbed.pool.flight_task import FlightResult, run_task

FILE = """study:
  schema: 1
  name: short
  scenario: simulation-3
  duration_s: 6
  set:
    fleet.*.vehicle: unicycle
    scenario.published: null
    scenario.windows: {rectangles: [2, 6]}
gains:
  formation.k: {from: 1, to: 5}
  controller.gains.course.p: {from: 1, to: 9, scale: log, start: 3}
objective: {metric: windows.rectangles.mean_rms_m}
search: {max_flights: 5, population: 4, held_out_seeds: [7, 8, 9]}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(FILE)
    return path


@pytest.fixture
def workers(monkeypatch):
    """Fly in this process; the tasks that were flown."""
    found = InThisProcess()
    monkeypatch.setattr("testbed.pool.flight_pool._open_workers", lambda *_: found)
    return found


def test_space_has_bounds_scale_and_start(file):
    tuning = testbed.Tuning(file)
    space = tuning.space
    assert space.names == ("formation.k", "controller.gains.course.p")
    assert space.bounds.tolist() == [[1.0, 5.0], [1.0, 9.0]]
    assert space.scale == ("linear", "log")
    assert space.start.tolist() == [tuning.before[0], 3.0] == [3.0, 3.0]
    assert space.point([3.0, 3.0]) == pytest.approx([0.5, 0.5])
    assert space.gains([0.5, 0.5]) == (3.0, 3.0)
    assert tuning.flights == 0


def test_evaluate_is_what_the_command_flies(file, workers, tmp_path):
    """Of every candidate, to the bit; one set of gains or several."""
    with in_this_process():
        options = ("--out", "out", "--json", "-")
        call_command("tune", file, *options, cwd=tmp_path, code=0, columns=120)
    lines = (tmp_path / "out/candidates.csv").read_text().splitlines()[1:]
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    tuning = testbed.Tuning(file)
    found = tuning.evaluate(rows[:, 3:5])
    assert found.costs.tolist() == rows[:, 2].tolist()
    assert len(rows) == len(set(found.costs)) == 5 and (found.costs > 0.0).all()
    assert (found.costs < 100.0).all()  # as of a flight without an end
    assert found.constraints.shape == (len(rows), 0)
    assert json.loads((tmp_path / "out/result.json").read_text())["flights"] == tuning.flights
    one = tuning.evaluate(rows[1, 3:5])
    assert (one.costs, one.constraints.shape) == (found.costs[1], (0,))
    assert tuning.flights == len(workers.finished) == len(rows)  # none of them again


def test_evaluate_has_the_shortfall_of_constraints(tmp_path, workers):
    path = tmp_path / "constrained.yaml"
    constraints = "constraints: [{bank_deg: 0, damping: 0.1}, {bank_deg: 0.5, damping: 0.9}]"
    path.write_text(FILE.replace("    fleet.*.vehicle: unicycle\n", "") + constraints)

    def fly(task):
        damping = {0.0: 0.3, 0.5: 0.45, -0.5: 0.36}
        if task.measure is None:
            return run_task(task)
        measured = {"problem": "", "damping": damping[task.measure.args[1]]}
        return FlightResult(task.number, "completed", "", measured)

    workers.fly = fly
    costs, missed = testbed.Tuning(path).evaluate([[3.0, 3.0], [2.0, 3.0]])
    assert costs.shape == (2,) and (costs < 100.0).all()  # without the constraints
    assert missed == pytest.approx(np.array([[0.0, 0.6], [0.0, 0.6]]))


def test_compare_tests_on_held_out_seeds(file, workers):
    with testbed.Tuning(file) as tuning:
        found = tuning.compare([3.0, 1.5])
        assert tuning.flights == 1 + 2 * 3  # the scenario's gains for the cost, and three seeds
    assert found.comparison.change.one_flight and found.comparison.pairs == 3
    (straight,) = found.margins
    assert "write jsbsim" in straight.problem
    assert str(found).startswith(found.comparison.verdict)
    assert "margins in straight flight are not predicted" in str(found)


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ([1.0], r"^gains: write 2 numbers, of formation.k, controller.gains.course.p, or a list"),
        ([], "^gains: write 2 numbers"),
        ([[[1.0, 2.0]]], "^gains: write 2 numbers"),
        ("ab", "^gains: write 2 numbers"),
        ([3.0, 9.1], r"^gains: controller.gains.course.p is 9.1 \(write a number from 1 to 9\)"),
        ([3.0, float("nan")], "^gains: controller.gains.course.p is nan"),
    ],
)
def test_wrong_gains_are_named(file, gains, message):
    with pytest.raises(InputError, match=message):
        testbed.Tuning(file).evaluate(gains)


def test_rounding_at_a_bound_is_none(file, workers):
    """As of an optimiser that works with logarithms."""
    found = testbed.Tuning(file).evaluate([[5.0, np.exp(np.log(9.0)) * (1 + 1e-15)], [5.0, 9.0]])
    assert found.costs[0] == found.costs[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"jobs": 0}, "^jobs: is 0"),
        ({"report": 3}, "^report: is 3"),
        ({"progress": "x"}, "^progress: is 'x'"),
    ],
)
def test_wrong_arguments_of_tuning_are_named(file, arguments, message):
    with pytest.raises(InputError, match=message):
        testbed.Tuning(file, **arguments)


def test_option_without_a_value_has_its_remedy(file):
    """The default in the code of a law is no value of the scenario."""
    text = FILE.replace(
        "  formation.k: {from: 1, to: 5}", "  controller.options.gain: {from: 0, to: 1}"
    )
    law = "    controller.law: leader_follower:LeaderFollower\n"
    file.write_text(text.replace("    scenario.published", law + "    scenario.published"))
    with pytest.raises(
        InputError, match=r"there is no key 'gain' \(write its present value"
    ) as error:
        testbed.Tuning(file)
    assert "controller: {options: {gain: 1}}" in str(error.value)


def made_up(task):
    """Return a number with its minimum at k = 2 in place of a flight."""
    if task.measure is not None:
        return run_task(task)
    windows = {"rectangles": {"mean_rms_m": 1.0 + (task.scenario.formation.k - 2.0) ** 2}}
    metrics = {"outcome": "completed", "windows": windows, "lost_at_s": {}}
    return FlightResult(task.number, "completed", "", metrics, depends_on_seed=False)


def test_scipy_example_finds_better_gains(file, workers, capsys):
    """Of made-up flights: that real ones are the command's is claimed above."""
    workers.fly = made_up
    path = ROOT / "examples" / "tune_with_scipy.py"
    spec = importlib.util.spec_from_file_location("tune_with_scipy", path)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.main(file, "1")
    printed = capsys.readouterr().out
    k = re.search(r"^formation.k: 3 before, (\S+) after$", printed, re.M)[1]
    assert abs(float(k) - 2.0) < 0.5 and "better in one flight" in printed
