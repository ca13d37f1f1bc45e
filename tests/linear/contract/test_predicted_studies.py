"""Studies that predict margins in place of flights: rows, commands that repeat them, errors."""

import json
import shlex

import pytest
import small_study
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command

from testbed.core.errors import InputError
from testbed.studies.predicted_numbers import predicted_names
from testbed.studies.sweep import sweep
from testbed.studies.table import read_rows

STUDY = """
study:
  schema: 1
  name: predicted
  scenario: simulation-3
  predict: {margins_at_deg: 0}
  set: {rates: {control_hz: 10, broadcast_hz: 10}}
  metrics: [margins.damping]
vary: {formation.speed_pole_per_s: [0.64, 9]}
"""


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Rows of the study, flown in this process."""
    folder = tmp_path_factory.mktemp("predicted")
    with pytest.MonkeyPatch.context() as patch:
        workers = small_study.InThisProcess()
        patch.setattr("testbed.pool.flight_pool._open_workers", lambda *_: workers)
        patch.chdir(folder)
        # the first flight is steady before, and the second one never
        patch.setattr("testbed.linear.steady_flight.LONGEST_SETTLE_S", 60.0)
        result = sweep(small_study.write(folder, STUDY), folder / "out.parquet")
        return list(read_rows(result.path))


def test_command_of_a_row_has_its_numbers(rows, tmp_path):
    """The worst follower of `testbed margins`, which is a command of the row."""
    row = rows[0]
    arguments = shlex.split(row["command"])[1:]
    assert row["outcome"] == "completed" and arguments[0] == "margins"
    with small_study.in_this_process():
        done = call_command(*arguments, "--json", "-", cwd=tmp_path, code=0, columns=80)
    ((case),) = json.loads(done.stdout)["predicted"]
    followers = case["followers"]
    assert row["metrics.margins.damping"] == min(
        each["least_damped"]["damping"] for each in followers
    )
    for name, key, most in (("factor", "gain", 10.0), ("latency_s", "latency_s", 1.0)):
        for command in ("pitch", "roll", "throttle"):
            found = [each["commands"][command][key] for each in followers]
            # null: beyond the largest value that is tried
            worst = min(most if each is None else each for each in found)
            # linear algebra differs in the last digits with the number of threads
            assert row[f"metrics.margins.{command}_{name}"] == pytest.approx(worst, rel=1e-6)


def test_row_has_every_number(rows):
    names = [f"metrics.{name}" for name in predicted_names()]
    assert [name for name in rows[0] if name.startswith("metrics.")] == names
    assert len(names) == 14 and None not in [rows[0][name] for name in names]


def test_flight_that_is_not_steady_is_a_row(rows):
    row = rows[1]
    assert row["outcome"] == "failed"
    assert row["error"].startswith("failed: not steady: ")
    assert row["metrics.margins.damping"] is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("margins_at_deg: 0", "margins_at_deg: 70", "margins_at_deg: is 70"),
        ("predict: {", "duration_s: 9\n  predict: {", "study.duration_s: is of flights, and stu"),
        ("predict: {", "seeds: 3\n  predict: {", "study.seeds: are 3, and no seed changes"),
        ("margins.damping", "margins.damp", "no run has a number 'margins.damp': did you mean"),
        ("margins.damping", "min_separation_m", "no run has a number 'min_separation_m'"),
    ],
)
def test_wrong_key_of_a_prediction_is_refused(tmp_path, monkeypatch, old, new, message):
    monkeypatch.chdir(tmp_path)
    path = small_study.write(tmp_path, STUDY.replace(old, new))
    with pytest.raises(InputError) as error:
        sweep(path, tmp_path / "out.parquet")
    assert message in str(error.value)
