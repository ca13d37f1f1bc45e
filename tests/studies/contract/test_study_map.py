"""Maps: studies that fly a grid of two keys in detail where the results differ."""

from dataclasses import replace

import numpy as np
import pytest
import small_study
from cases import ALL, in_full
from commands import call_command
from small_study import few_checked, use  # noqa: F401 - checks of all tests

from testbed.cli.study_report import read_study
from testbed.reports.html import render_page
from testbed.reports.study import study_page
from testbed.scenario import ScenarioError
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan
from testbed.studies.sequential_interval import MIN_VALUES
from testbed.studies.sweep import sweep
from testbed.studies.table import read_table

ERROR = "windows.approach.mean_rms_m"
STUDY = """
study:
  schema: 1
  name: map
  scenario: ideal-figure-eight
  duration_s: 1
  design: map
  refine: {metric: windows.approach.mean_rms_m, levels: 2, contour: 1.4}
vary:
  network.loss: {from: 0, to: 0.8, count: 17}
  network.delay_s: {from: 0, to: 0.4, count: 9}
"""
CASES = """cases:
  near: {}
  far: {"fleet.uav1.start_m": [-90, 30, 0]}
"""
GRID = (17, 9)
SMALL = STUDY.replace("count: 9", "count: 5").replace("count: 17", "count: 9")


def fly(task):
    """Make up a map: a smooth number with a contour, and lost flights in a corner."""
    network = task.scenario.network
    loss, delay = network.loss.probability / 0.8, network.delay_s / 0.4
    seed = task.scenario.scenario.seed
    noise = 0.05 * loss * float(np.random.default_rng(seed).normal()) if seed > 1 else 0.0
    outcome = "formation_lost" if loss + delay > 1.6 else "completed"
    number = 1.0 + loss**2 * delay + noise
    return small_study.made_result(task, number, outcome, depends_on_seed=loss > 0.0)


TOLD, SEEN = [], []  # by the sweep of the map


def fly_whole(folder, text, **options):
    """Write a map to a folder, and its result with one flight at a time."""
    small_study.write(folder, text, "map")
    with pytest.MonkeyPatch.context() as patch:
        use(patch, small_study.InThisProcess(fly=fly))
        patch.chdir(folder)
        sweep("map.yaml", "whole.parquet", **options)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the map, and its result with one flight at a time."""
    told = {"report": TOLD.append, "progress": lambda *numbers: SEEN.append(numbers)}
    return fly_whole(tmp_path_factory.mktemp("map"), STUDY, **told)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A folder with a smaller map, and its result with one flight at a time."""
    return fly_whole(tmp_path_factory.mktemp("small"), STUDY if ALL else SMALL)


def content(path):
    return small_study.content(read_table(path))


def test_map_is_flown_where_results_differ(folder):
    """In full at the contour and at the boundary of lost flights, coarse elsewhere."""
    table = read_table(folder / "whole.parquet")
    assert table.complete and table.planned == len(table.columns["run"])
    flown = np.zeros(GRID, dtype=bool)
    flown.reshape(-1)[table.columns["run"]] = True
    loss, delay = np.meshgrid(*(np.linspace(0, 1, size) for size in GRID), indexing="ij")
    lost = loss + delay > 1.6 + 1e-9
    for inside, where in ((loss**2 * delay > 0.4, ~lost), (lost, np.ones_like(lost))):
        cells = 0
        for i, k in np.ndindex(GRID[0] - 1, GRID[1] - 1):
            here = slice(i, i + 2), slice(k, k + 2)
            if where[here].all() and inside[here].any() and not inside[here].all():
                assert flown[here].all()
                cells += 1
        assert cells > 4
    assert flown[::4, ::4].all() and flown.mean() < 0.7
    assert "design: map" in table.metadata["study.yaml"]


def test_map_of_each_case_is_refined_by_itself(tmp_path, monkeypatch):
    """The second case is lost nowhere, and has other points than the first one."""

    def fly_case(task):
        result = fly(task)
        far = task.number >= 45
        return replace(result, outcome="completed", error="") if far else result

    use(monkeypatch, small_study.InThisProcess(fly=fly_case))
    small_study.write(tmp_path, SMALL + CASES, "map")
    monkeypatch.chdir(tmp_path)
    sweep("map.yaml", "cases.parquet")
    table = read_table(tmp_path / "cases.parquet")
    near = table.columns["case"] == "near"
    points = table.columns["run"] % 45
    assert set(points[near]) != set(points[~near])


def test_map_rounds_are_told(folder):
    assert TOLD[0].startswith("at most 153 runs: 153 points × 1 seed; ")
    rounds = [line for line in TOLD if line.startswith("round ")]
    assert rounds[0] == "round 1: 15 points, with which the map has 15 of 153"
    rows = len(read_table(folder / "whole.parquet").columns["run"])
    assert len(rounds) >= 3 and rounds[-1].endswith(f"the map has {rows} of 153")
    assert SEEN[0] == (0, 15) and SEEN[-1] == (rows, rows)
    assert all(done <= total for done, total in SEEN)


def test_map_depends_on_no_order_of_flights(small, tmp_path, monkeypatch):
    use(monkeypatch, small_study.Backwards(size=7, fly=fly))
    monkeypatch.chdir(small)
    sweep("map.yaml", tmp_path / "a.parquet")
    assert content(tmp_path / "a.parquet") == content(small / "whole.parquet")


def interrupt_often(out, monkeypatch, after):
    """Fly the map of the current folder with stops after so many rows; return their number."""
    flown, before = 0, -1

    def stop(done, total):
        nonlocal flown
        flown += 1
        if flown > after:
            raise KeyboardInterrupt

    for stops in range(100):
        use(monkeypatch, small_study.Backwards(fly=fly))
        flown = 0
        try:
            sweep("map.yaml", out, resume=True, progress=stop)
        except KeyboardInterrupt:
            rows = len(read_table(out).columns["run"])
            assert rows > before  # no row is lost, though a round may have to be found again
            before = rows
        else:
            return stops
    raise AssertionError("does not end")


def test_map_interrupted_is_resumed_to_the_bit(small, tmp_path, monkeypatch):
    monkeypatch.chdir(small)
    assert interrupt_often(tmp_path / "a.parquet", monkeypatch, 40 if ALL else 12) >= 1
    assert content(tmp_path / "a.parquet") == content(small / "whole.parquet")


def test_map_with_until_has_both_rules(tmp_path, monkeypatch):
    """Each point has as many seeds as its mean needs, and the means decide on the points."""
    until = "seeds: 20\n  until: {metric: windows.approach.mean_rms_m, half_width: 0.04}\n  refine"
    small_study.write(tmp_path, SMALL.replace("refine", until), "map")
    use(monkeypatch, small_study.InThisProcess(fly=fly))
    monkeypatch.chdir(tmp_path)
    sweep("map.yaml", "whole.parquet")
    columns = read_table(tmp_path / "whole.parquet").columns
    points, counts = np.unique(columns["run"] // 20, return_counts=True)
    flown = dict(zip(points.tolist(), counts.tolist(), strict=True))
    last = 44
    assert flown[0] == 1  # no seed changes it
    assert flown[last] == MIN_VALUES  # formation lost in all flights
    assert flown[last - 4] > MIN_VALUES and len(points) < last
    if ALL:  # otherwise of each rule alone: above, and in `test_study_until`
        interrupt_often(tmp_path / "again.parquet", monkeypatch, 200)
        assert content(tmp_path / "again.parquet") == content(tmp_path / "whole.parquet")


@in_full  # as made-up flights above
def test_map_of_flights_is_the_same_in_any_order(tmp_path, monkeypatch):
    """Flights of the model until each mean is known; `test_sweep` has those of processes."""
    until = "seeds: 24\n  until: {metric: windows.approach.mean_rms_m, half_width: 0.05}\n  refine"
    text = STUDY.replace("count: 17", "count: 3").replace("count: 9", "count: 3")
    text = text.replace("levels: 2", "levels: 1").replace("refine", until)
    study = small_study.write(
        tmp_path, text.replace("from: 0, to: 0.8", "from: 0.3, to: 0.7"), "map"
    )
    use(monkeypatch, small_study.Backwards(fly=small_study.run_task))
    two = sweep(study, tmp_path / "two.parquet")
    use(monkeypatch, small_study.InThisProcess())
    one = sweep(study, tmp_path / "one.parquet")
    assert content(two.path) == content(one.path)
    assert 4 * MIN_VALUES <= len(read_table(one.path).columns["run"]) < 24 * 9


def test_report_of_a_map_is_made(folder):
    data = read_study(folder / "whole.parquet", metrics=(), statistic="median")
    assert data.metrics == (ERROR,) and data.design == "map" and not data.uneven
    assert data.planned == data.flights.run.size
    page = render_page(study_page(data))
    assert "The study has not ended" not in page and "Varied, map" in page


def test_sweep_of_a_map_prints_its_rounds(tmp_path, monkeypatch):
    use(monkeypatch, small_study.InThisProcess(fly=fly))
    small_study.write(tmp_path, SMALL, "map")
    done = call_command("sweep", "map.yaml", cwd=tmp_path, code=1, columns=80)
    assert "round 2: " in done.stderr and "formation lost" in done.stdout


HEAD = "study: {schema: 1, name: s, scenario: simulation-3, "
AXES = "\nvary: {network.loss: {from: 0, to: 1, count: 9}, network.delay_s: %s}"
GOOD = AXES % "{from: 0, to: 1, count: 17}"
MAP = "design: map, refine: {metric: min_separation_m, levels: 3}"


def test_map_with_right_keys_is_read(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(f"{HEAD}{MAP}}}{GOOD}")
    check_plan(Plan(load_study(path)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"design: map}}{GOOD}", "study: design map needs a section refine (write for example"),
        (f"refine: {{metric: a, levels: 1}}}}{GOOD}", "study.refine: is for design: map"),
        (f"{MAP}}}\nvary: {{a.b: {{from: 0, to: 1, count: 9}}}}", "vary: has 1 keys (write two"),
        (MAP + "}" + AXES % "[0, 1]", "vary.network.delay_s: is an axis of a map"),
        (MAP + "}" + AXES % "{from: 0, to: 1, step: 0.125}", "{from: 0, to: 1, count: 33}"),
        (MAP + "}" + AXES % "{uniform: [0, 1]}", "vary.network.delay_s: is a"),
        (
            MAP + "}" + AXES % "{from: 0, to: 1, count: 20}",
            "vary.network.delay_s.count: is 20; with levels: 3 it is a multiple of 8 plus 1 (write "
            "17 or 25)",
        ),
        (MAP + "}" + AXES % "{from: 0, to: 1, count: 5}", "plus 1 (write 9)"),
        (MAP + f", samples: 4}}{GOOD}", "study.samples: is for latin-hypercube"),
        (MAP.replace("levels: 3", "levels: 0") + f"}}{GOOD}", "study.refine.levels"),
        (MAP.replace("levels: 3", "level: 3") + f"}}{GOOD}", "did you mean 'levels'?"),
        (MAP.replace("levels: 3", "levels: 3, contour: x") + f"}}{GOOD}", "study.refine.contour"),
        (MAP.replace("_m,", "_n,") + f"}}{GOOD}", "study.refine.metric: no run has a number"),
        (
            MAP + f", seeds: 20, until: {{metric: simulated_s, half_width: 1}}}}{GOOD}",
            "study.until.metric: is not the number of the map (write min_separation_m",
        ),
    ],
)
def test_map_wrong_key_is_refused(tmp_path, text, message):
    path = tmp_path / "s.yaml"
    path.write_text(HEAD + text)
    with pytest.raises(ScenarioError) as error:
        check_plan(Plan(load_study(path)))
    assert message in str(error.value)
