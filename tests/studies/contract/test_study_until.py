"""Studies that fly each point until its mean is known: the same file for any order of flights."""

import json
import math
import re

import numpy as np
import pytest
import small_study
from commands import call_command
from small_study import few_checked, use  # noqa: F401 - checks of all tests
from study_samples import METRIC, flights_of, study_of

from testbed.cli.study_report import read_study
from testbed.scenario import ScenarioError, find_tuning
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan
from testbed.studies.point_runs import PointRuns
from testbed.studies.sequential_interval import MIN_VALUES, relative_half_width
from testbed.studies.study_schema import Until
from testbed.studies.sweep import sweep
from testbed.studies.table import read_table
from testbed.tuning.tune_schema import load_tune

ERROR = "windows.approach.mean_rms_m"
STUDY = """
study:
  schema: 1
  name: enough
  scenario: ideal-figure-eight
  duration_s: 1
  set: {rates: {physics_hz: 50, autopilot_hz: 50, control_hz: 25, broadcast_hz: 25, log_hz: 25}}
  seeds: 24
  until: {metric: windows.approach.mean_rms_m, half_width: 0.006}
vary:
  network.loss: [0, 0.2, 0.5, 0.8]
"""
UNTIL = Until(metric=ERROR, half_width=0.5)


def fly(task):
    """Make up a number whose scatter grows with the loss; at the largest loss some are lost."""
    loss, seed = task.scenario.network.loss.probability, task.scenario.scenario.seed
    number = 1.0 + loss + loss * float(np.random.default_rng(seed).normal(0.0, 0.012))
    lost = loss == 0.8 and seed % 5 == 0
    return small_study.made_result(
        task, number, "lost" if lost else "completed", depends_on_seed=loss > 0.0
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the study, and its result with one flight at a time."""
    folder = tmp_path_factory.mktemp("until")
    small_study.write(folder, STUDY, "enough")
    with pytest.MonkeyPatch.context() as patch:
        use(patch, small_study.InThisProcess(fly=fly))
        patch.chdir(folder)
        sweep("enough.yaml", "whole.parquet")
    return folder


def content(path):
    return small_study.content(read_table(path))


def flights_by_loss(path):
    columns = read_table(path).columns
    losses, counts = np.unique(columns["set.network.loss"], return_counts=True)
    return dict(zip(losses.tolist(), counts.tolist(), strict=True))


def test_points_have_the_seeds_that_they_need(folder):
    """No seed changes the first point; the last one is at the largest number of flights."""
    table = read_table(folder / "whole.parquet")
    assert table.complete and table.planned == len(table.columns["run"])
    flights = flights_by_loss(folder / "whole.parquet")
    assert flights[0] == 1 and MIN_VALUES <= flights[0.2] < flights[0.5] < 24
    assert flights[0.8] == 24
    runs = [24 * k + seed for k, n in enumerate(flights.values()) for seed in range(n)]
    assert table.columns["run"].tolist() == runs  # numbered as if all seeds were flown
    assert table.columns["seed"].tolist() == [run % 24 + 1 for run in runs]


def test_point_stops_at_the_first_narrow_interval(folder):
    """By numpy, with all values up to there and one less."""
    columns = read_table(folder / "whole.parquet").columns
    values = columns[f"metrics.{ERROR}"][columns["set.network.loss"] == 0.5]
    widths = [
        relative_half_width(n, 0.95) * values[:n].std(ddof=1)
        for n in range(MIN_VALUES, len(values) + 1)
    ]
    assert widths[-1] <= 0.006 < min(widths[:-1])


@pytest.mark.parametrize("size", [2, 5])
def test_order_of_flights_changes_no_row(folder, tmp_path, monkeypatch, size):
    """Flights beyond the number that is needed are flown, and dropped."""
    workers = use(monkeypatch, small_study.Backwards(size=size, fly=fly))
    monkeypatch.chdir(folder)
    seen = []
    out = tmp_path / "study.parquet"
    sweep("enough.yaml", out, progress=lambda *numbers: seen.append(numbers))
    assert content(out) == content(folder / "whole.parquet")
    rows = len(read_table(out).columns["run"])
    assert seen[0] == (0, 96) and seen[-1] == (rows, rows)
    assert len(workers.finished) >= rows if size == 2 else len(workers.finished) > rows


def test_interrupted_study_is_resumed_to_the_bit(folder, tmp_path, monkeypatch):
    """Stopped again and again, also where rows that are not needed are in the journal."""
    use(monkeypatch, small_study.Backwards(fly=fly))
    monkeypatch.chdir(folder)
    out = tmp_path / "study.parquet"
    flown = 0

    def stop(done, total):
        nonlocal flown
        flown += 1
        if flown > 20:
            flown = 0
            raise KeyboardInterrupt

    for _ in range(30):
        try:
            sweep("enough.yaml", out, resume=True, progress=stop)
            break
        except KeyboardInterrupt:
            assert not read_table(out).complete
            use(monkeypatch, small_study.Backwards(fly=fly))
    assert content(out) == content(folder / "whole.parquet")
    assert sweep("enough.yaml", out, resume=True).new_runs == 0


def test_other_width_is_another_study(folder, tmp_path, monkeypatch):
    use(monkeypatch, small_study.InThisProcess(fly=fly))
    monkeypatch.chdir(folder)
    sweep("enough.yaml", tmp_path / "a.parquet")
    other = small_study.write(tmp_path, STUDY.replace("0.006", "0.02"), "enough")
    with pytest.raises(ValueError, match=r"until.half_width from 0.006 to 0.02"):
        sweep(other, tmp_path / "a.parquet", resume=True)


def test_end_of_sweep_names_flights_and_points(folder, tmp_path, monkeypatch):
    use(monkeypatch, small_study.InThisProcess(fly=fly))
    small_study.write(tmp_path, STUDY, "enough")
    done = call_command(
        "sweep", "enough.yaml", "--json", "s.json", cwd=tmp_path, code=1, columns=80
    )
    assert "at most 96 runs: 4 points × 24 seeds" in done.stderr
    assert "no seed changes 1 point: one run each" in done.stderr
    assert " within ± 0.006 at 95 % at 3 of 4 points after 1 to " in done.stdout
    assert "not within ± 0.006 with all seeds: network.loss = 0.8: ± 0." in done.stdout
    points = json.loads((tmp_path / "s.json").read_text())["until"]
    assert [each["reached"] for each in points] == [True, True, True, False]
    assert [each["flights"] for each in points] == [
        *flights_by_loss(folder / "whole.parquet").values()
    ]
    quiet = call_command("sweep", "enough.yaml", "--quiet", cwd=tmp_path, code=1, columns=80)
    assert ", 4 without the number" in done.stdout and "20 of 24" in done.stdout
    assert quiet.stderr.startswith("warning: not within ± 0.006 with all seeds: network.loss")


def test_report_of_a_chosen_study_is_complete(folder):
    data = read_study(folder / "whole.parquet", metrics=(), statistic="mean")
    assert data.metrics == (ERROR,) and data.uneven
    assert data.planned == data.flights.run.size


def fly_point(numbers, order=None, seeds=100):
    runs = PointRuns(seeds, UNTIL)
    for seed in order or range(len(numbers)):
        runs.add(seed, numbers[seed])
    return runs


def test_point_depends_on_the_order_of_seeds_only():
    random = np.random.default_rng(5)
    numbers = random.normal(3.0, 0.8, 60).tolist()
    expected = fly_point(numbers)
    assert MIN_VALUES < expected.needed < 60 and expected.precise and expected.finished
    for _ in range(20):
        runs = fly_point(numbers, random.permutation(60).tolist())
        assert (runs.needed, runs.mean, runs.half_width) == (
            *(expected.needed, expected.mean, expected.half_width),
        )


def test_lost_flights_are_in_no_mean():
    """They count as flown, and the point needs as many more."""
    numbers = np.random.default_rng(5).normal(3.0, 0.8, 60).tolist()
    expected = fly_point(numbers)
    runs = fly_point([numbers[0], None, *numbers[1:3], math.nan, *numbers[3:]])
    assert runs.needed == expected.needed + 2 and runs.mean == expected.mean
    assert (runs.values, runs.completed) == (expected.needed, expected.needed + 1)


def test_point_without_numbers_is_given_up():
    runs = fly_point([None, math.nan] * MIN_VALUES)
    assert runs.needed == MIN_VALUES and runs.finished and not runs.precise
    assert fly_point([None] * (MIN_VALUES - 1) + [1.0] + [None] * 20).needed == 100


def test_equal_numbers_stop_no_point():
    """A count that is 0 in the first flights may be 1 in the next."""
    assert fly_point([0.0] * 40).needed == 100
    runs = fly_point([0.0] * 40)
    runs.settle()
    assert runs.needed == 1 and runs.precise and runs.half_width == 0.0


def uneven(seed=6, **more):
    """Make a study of two points with 8 and 40 seeds, whose mean is 1.5 over both."""
    random = np.random.default_rng(seed)
    table = [
        ("", seed, {"network.loss": loss}, 1.0 + 10.0 * loss + random.normal(0.0, 0.1))
        for loss, seeds in ((0.0, 8), (0.1, 40))
        for seed in range(seeds)
    ]
    return study_of(flights_of(table), **more), np.ones(len(table), dtype=bool)


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_report_later_seeds_move_no_mean(statistic):
    """Half of the points have all seeds: later seeds have no larger numbers by themselves."""
    study, everywhere = uneven(uneven=True, statistic=statistic)
    assert study.estimate(METRIC, everywhere, "all").value == pytest.approx(1.5, abs=0.06)
    # the negative control: as if every point had been flown with every seed
    study, everywhere = uneven(statistic=statistic)
    assert study.estimate(METRIC, everywhere, "all").value > 1.8


def test_report_interval_is_as_wide_as_the_scatter():
    """The standard error is that of the mean of two means, of 8 and of 40 values."""
    study, everywhere = uneven(uneven=True, statistic="mean")
    estimate = study.estimate(METRIC, everywhere, "all")
    values = study.flights.metrics[METRIC]
    parts = [values[study.flights.point == k] for k in (0, 1)]
    error = 0.5 * math.sqrt(sum(each.var(ddof=1) / each.size for each in parts))
    assert estimate.high - estimate.low == pytest.approx(2 * 1.96 * error, rel=0.15)


def test_report_of_equal_numbers_of_seeds_is_unchanged():
    """The same mean as by seed; a factorial study has equal numbers."""
    random = np.random.default_rng(7)
    table = [("", s, {"a": k}, random.normal(k, 0.1)) for k in (0, 1, 2) for s in range(9)]
    everywhere = np.ones(len(table), dtype=bool)
    values = flights_of(table).metrics[METRIC]
    means = [
        study_of(flights_of(table), uneven=each).unit_means(values, everywhere)
        for each in (False, True)
    ]
    assert means[0] == pytest.approx(means[1], rel=1e-12)


HEAD = "study: {schema: 1, name: s, scenario: simulation-3, "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds: 5, until: {metric: a, half_width: 1}}", "study.seeds: has 5 seeds, the most that"),
        ("until: {metric: a, half_width: 1}}", "study.seeds: has 1 seed, the most that until may"),
        ("seeds: 50, until: {metric: a}}", "study.until.half_width: is missing"),
        ("seeds: 50, until: {metric: a, half_width: 0}}", "write a number above 0"),
        ("seeds: 50, until: {metric: a, half_width: 1, confidence: 1}}", "at most 0.9999"),
        ("seeds: 50, until: {metric: a, half_width: 1, statistic: median}}", "write mean"),
        ("seeds: 50, until: {metric: a, halfwidth: 1}}", "did you mean 'half_width'?"),
        ("seeds: 50, until: {metric: '', half_width: 1}}", "study.until.metric"),
        ("seeds: 50, until: {metric: max_error_m, half_width: 1}}", "s.yaml:1:80: study.until.m"),
    ],
)
def test_until_wrong_key_is_refused(tmp_path, text, message):
    path = tmp_path / "s.yaml"
    path.write_text(HEAD + text)
    with pytest.raises(ScenarioError) as error:
        check_plan(Plan(load_study(path)))
    assert message in str(error.value)


def test_tune_with_until_is_refused(tmp_path):
    """A search flies every run of its study."""
    text = find_tuning("x8-middle-loop").read_text()
    lines = "study:\n  until: {metric: min_separation_m, half_width: 1}\n"
    path = tmp_path / "t.yaml"
    path.write_text(re.sub(r"seeds: .*", "seeds: 9", text.replace("study:\n", lines, 1), count=1))
    with pytest.raises(ScenarioError, match="study.until: is for testbed sweep: a search flies"):
        load_tune(path)
