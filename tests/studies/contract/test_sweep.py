"""`testbed sweep`: one result file, the same to the bit for any workers and interruptions."""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time

import pytest
import small_study
from cases import ALL, in_full
from commands import call_command, environment, refuse_all
from full_disk import full_disk
from rich.console import Console
from snapshot import check_snapshot
from waiting import TIMEOUT_S, until

from testbed.cli.progress import progress_counter
from testbed.cli.sweep import summary_tables
from testbed.core.errors import InputError
from testbed.metrics.flat_numbers import flatten_metrics
from testbed.studies.journal import Journal
from testbed.studies.study_summary import RunGroup, Summary
from testbed.studies.sweep import sweep
from testbed.studies.table import find_output, read_rows, read_table

WHOLE = os.environ.get("TESTBED_STUDIES")
LOST, BAD_INPUT, INTERRUPTED = 1, 2, 130
ERROR = "windows.approach.mean_rms_m"
TOLD, SEEN = [], []  # by the sweep of the whole study
FLIGHTS = small_study.FlownOnce()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the small study, and its result without interruptions."""
    folder = tmp_path_factory.mktemp("study")
    small_study.write(folder)
    out = folder / "whole.parquet"

    def progress(done, total):
        SEEN.append((done, len(read_table(out).columns["run"])))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("testbed.studies.sweep.MAX_WRITE_SHARE", 1e9)  # no limit
        small_study.use(patch, FLIGHTS)
        patch.chdir(folder)
        sweep(folder / "small.yaml", out, refresh_s=0.0, progress=progress, report=TOLD.append)
    return folder


@pytest.fixture
def workers(monkeypatch, folder):
    """Workers in this process, and the folder as current directory."""
    monkeypatch.chdir(folder)
    if not ALL:
        small_study.check_little(monkeypatch)
    return small_study.use(monkeypatch, small_study.FlownOnce(results=FLIGHTS.results))


@pytest.fixture(scope="module")
def begun(folder, tmp_path_factory):
    """The result file of a study that was interrupted after a run."""
    out = tmp_path_factory.mktemp("begun") / "study.parquet"
    with pytest.MonkeyPatch.context() as patch:
        small_study.use(patch, small_study.FlownOnce(results=FLIGHTS.results))
        small_study.check_little(patch)
        patch.chdir(folder)
        interrupt(out, 1)
    return out


def same(folder, path):
    whole = small_study.content(read_table(folder / "whole.parquet"))
    return small_study.content(read_table(path)) == whole


def test_sweep_file_has_a_row_for_each_run(folder):
    table = read_table(folder / "whole.parquet")
    assert table.complete
    assert table.columns["run"].tolist() == list(range(small_study.RUNS))
    assert list(table.columns)[:7] == [
        *("run", "case", "seed", "set.network.loss", "outcome", "error", "command")
    ]
    rows = read_rows(folder / "whole.parquet")
    assert [(r["case"], r["set.network.loss"], r["seed"]) for r in rows[:5]] == [
        *(("near", 0, 3), ("near", 0, 1), ("near", 0.4, 3), ("near", 0.4, 1), ("far", 0, 3))
    ]
    assert {row["outcome"] for row in rows} == {"completed"}
    assert rows[0][f"metrics.{ERROR}"] < rows[4][f"metrics.{ERROR}"]
    assert rows[2][f"metrics.{ERROR}"] != rows[3][f"metrics.{ERROR}"]  # other random numbers
    assert rows[0]["metrics.joined_at_s.uav1"] is None
    assert not any("wall" in name or "version" in name for name in table.columns)
    assert table.metadata["study.yaml"] == small_study.STUDY
    assert "duration_s: 1.0" in table.metadata["scenario.far.yaml"]
    assert json.loads(table.metadata["versions.json"])["jsbsim"]
    assert {path.name for path in folder.iterdir()} == {"small.yaml", "whole.parquet"}


def test_sweep_command_of_a_row_repeats_its_numbers(folder, tmp_path):
    """To the bit."""
    row = read_rows(folder / "whole.parquet")[7]
    words = shlex.split(row["command"])
    assert words[:3] == ["testbed", "run", "ideal-figure-eight"]
    call_command(*words[1:], "--out", "run", "--quiet", cwd=tmp_path, code=0, columns=80)
    again = flatten_metrics(json.loads((tmp_path / "run/metrics.json").read_text()))
    row = {name.removeprefix("metrics."): value for name, value in row.items()}
    assert {name: row[name] for name in again} == again


@in_full  # workers that are processes are those of the pool's tests, and another kind is below
def test_sweep_processes_give_the_same_file(folder, tmp_path, monkeypatch):
    """Flights that end in another order are those of `test_study_map`."""
    monkeypatch.chdir(folder)
    seen = []
    result = sweep(
        "small.yaml", tmp_path / "new", jobs=2, progress=lambda *numbers: seen.append(numbers)
    )
    assert same(folder, result.path)
    assert result.new_runs == small_study.RUNS and result.completed
    assert seen == [(k, small_study.RUNS) for k in range(small_study.RUNS + 1)]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["study.parquet"]


@pytest.mark.filterwarnings("ignore")  # warnings inside Dask
def test_sweep_dask_cluster_gives_the_same_file(folder, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="the extra dask of pyproject.toml")
    monkeypatch.chdir(folder)
    kind = {"n_workers": 2, "threads_per_worker": 1, "processes": bool(WHOLE)}
    with distributed.LocalCluster(**kind, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        out = tmp_path / "dask.parquet"
        sweep("small.yaml", out, backend="dask", scheduler=address)
    assert same(folder, out)


def interrupt(out, after, **options):
    """Stop the study after some runs."""

    def progress(done, total):
        if done == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep("small.yaml", out, progress=progress, **options)


def test_sweep_interrupted_is_resumed_to_the_bit(folder, workers, tmp_path):
    """Before the first run, between the runs of a point that is flown once, and after a point.

    The file of the finished runs is readable; a cut line of the journal is dropped.
    """
    out = tmp_path / "study.parquet"
    interrupt(out, 0)
    assert len(read_table(out).columns["run"]) == 0
    interrupt(out, 1, resume=True)
    assert read_table(out).columns["run"].tolist() == [0] == workers.finished
    interrupt(out, 3, resume=True)
    part = read_table(out)
    assert not part.complete and part.columns["run"].tolist() == [0, 1, 2]
    with (tmp_path / "study.journal").open("ab") as journal:
        journal.write(b'{"run":3,"outcome":"flo')  # as after a power failure
    with pytest.raises(InputError, match="write --resume to continue it"):
        sweep("small.yaml", out)
    result = sweep("small.yaml", out, resume=True)
    assert result.new_runs == small_study.RUNS - 3
    assert workers.finished == [0, 1, 2, 3, 4, 6, 7]  # without loss a point is flown once
    assert same(folder, out)
    assert [path.name for path in tmp_path.iterdir()] == ["study.parquet"]
    assert sweep("small.yaml", out, resume=True).new_runs == 0


def test_sweep_file_is_readable_during_the_study(folder):
    assert SEEN == [(0, 0), *((done, done - 1) for done in range(1, small_study.RUNS + 1))]


def test_sweep_flies_a_point_no_seed_changes_once(folder, tmp_path, monkeypatch):
    """The file is that of a study that flies every seed, as a noisy point is flown."""
    assert FLIGHTS.finished == [0, 2, 3, 4, 6, 7]
    assert TOLD[-1] == "no seed changes 2 points: 2 runs with the numbers of a flown one"
    monkeypatch.chdir(folder)
    every = small_study.use(monkeypatch, small_study.InThisProcess(every_seed=True))
    lines = []
    sweep("small.yaml", tmp_path / "every.parquet", report=lines.append)
    assert every.finished == list(range(small_study.RUNS)) and "no seed" not in lines[-1]
    assert same(folder, tmp_path / "every.parquet")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda text: text.replace("0.4]", "0.4, 0.5]"),
            r"the study file changed.*vary.network.lo",
        ),
        (lambda text: text.replace("[3, 1]", "[3, 1, 2]"), r"study.seeds from \[3, 1\]"),
        (
            lambda text: text.replace("ideal-figure-eight", "mine.yaml"),
            "study.scenario from ideal-figure-eight to mine.yaml",
        ),
    ],
    ids=["levels", "seeds", "scenario"],
)
def test_resume_changed_study_is_refused(begun, workers, tmp_path, change, message):
    """The journal stays as it is."""
    journal = begun.with_suffix(".journal")
    before = journal.read_bytes()
    (tmp_path / "mine.yaml").write_text("extends: ideal-figure-eight\n")
    other = small_study.write(tmp_path, change(small_study.STUDY))
    with pytest.raises(InputError, match=message):
        sweep(other, begun, resume=True)
    assert journal.read_bytes() == before


def test_resume_changed_versions_are_refused(begun, workers, tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.studies.sweep.versions", lambda: {"jsbsim": "0.9"})
    with pytest.raises(InputError, match=r"the versions changed.*jsbsim from .* to 0.9"):
        sweep("small.yaml", begun, resume=True)
    with pytest.raises(InputError, match="by a worker of other versions: .*jsbsim"):
        sweep("small.yaml", tmp_path / "new")


def test_resume_changed_code_is_refused(folder, begun, workers, monkeypatch):
    """Whether the study was interrupted or complete: its runs were flown by other code."""
    monkeypatch.setattr("testbed.pool.flight_code.source_digest", lambda *_: "0123456789abcdef")
    for out in (begun, folder / "whole.parquet"):
        with pytest.raises(InputError, match=r"the code changed.*testbed from \w+ to 0123456789ab"):
            sweep("small.yaml", out, resume=True)


def test_sweep_journal_in_use_is_refused(workers, tmp_path):
    out = tmp_path / "study.parquet"

    def progress(done, total):
        with pytest.raises(InputError, match="another sweep is writing it"):
            sweep("small.yaml", out, resume=True)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep("small.yaml", out, progress=progress)


def test_sweep_two_started_at_once_write_one_file(folder, workers, tmp_path, monkeypatch):
    """Neither has seen the other's file; and a complete study is not resumed by the other."""
    out = tmp_path / "study.parquet"
    output = find_output("small", out, resume=False)

    def progress(done, total):
        if done not in (0, 4, total):
            return
        with pytest.raises(InputError, match=r"study\.journal: another sweep is writing it"):
            sweep("small.yaml", out)
        with pytest.raises(InputError, match=r"study\.journal: another sweep has just created it"):
            Journal(output.journal, {})

    close = Journal.close

    def check_and_close(journal):
        assert not journal.path.exists()
        close(journal)

    with monkeypatch.context() as patch:
        patch.setattr("testbed.studies.sweep.find_output", lambda *_, **__: output)
        patch.setattr(Journal, "close", check_and_close)
        sweep("small.yaml", out, progress=progress)
    assert same(folder, out)


FAILURES = """
study:
  {schema: 1, name: bad, scenario: ideal-figure-eight, duration_s: 1, metrics: [min_separation_m]}
cases:
  good: {}
  singular: {formation.leader_gains.uav1: 0}
  lost: {scenario: near.yaml, limits.collision_m: 47.43}
  raises: {controller.law: "torn:Torn"}
"""
NEAR = "extends: ideal-figure-eight"


def test_sweep_failed_runs_are_rows_and_exit_1(workers, tmp_path):
    small_study.write(tmp_path, FAILURES, "bad")
    (tmp_path / "near.yaml").write_text(NEAR)
    (tmp_path / "torn.py").write_text(small_study.TORN_LAW)
    done = call_command(
        "sweep", "bad.yaml", "--out", "b.parquet", "--json", "b.json",
        cwd=tmp_path, code=LOST, columns=100,
    )  # fmt: skip
    check_snapshot("sweep_failures", done.stdout.replace(str(tmp_path), "FOLDER"))
    quiet = ("sweep", "bad.yaml", "--out", "q.parquet", "--quiet")
    told = call_command(*quiet, cwd=tmp_path, code=LOST, columns=100)
    lines = [line for line in told.stderr.splitlines() if line.startswith("warning: run ")]
    kinds = [line.split(": ")[2] for line in lines]
    assert kinds[-3:] == ["invalid", "lost", "failed"] and told.stdout == ""
    rows = {row["case"]: row for row in read_rows(tmp_path / "b.parquet")}
    assert {case: row["outcome"] for case, row in rows.items()} == {
        "good": "completed",
        "singular": "invalid",
        "lost": "lost",
        "raises": "failed",
    }
    assert rows["lost"]["metrics.simulated_s"] < 1 and rows["good"]["error"] == ""
    assert rows["raises"]["metrics.simulated_s"] is None
    document = json.loads((tmp_path / "b.json").read_text())
    assert document["outcomes"] == {
        "completed": 1,
        "lost": 1,
        "envelope_exceeded": 0,
        "formation_lost": 0,
        "separation_lost": 0,
        "bound_violated": 0,
        "failed": 1,
        "invalid": 1,
    }
    assert document["complete"] and len(document["failures"]) == 3


def test_sweep_summary_and_default_place(workers, tmp_path):
    """Without --out the file is in logs/studies, where --resume finds it."""
    small_study.write(tmp_path)
    done = call_command("sweep", "small.yaml", "--json", "-", cwd=tmp_path, code=0, columns=80)
    document = json.loads(done.stdout)
    assert document["runs"] == document["new_runs"] == small_study.RUNS
    (path,) = tmp_path.glob("logs/studies/small/*/study.parquet")
    assert str(path.relative_to(tmp_path)) == document["file"]
    table = done.stderr[done.stderr.index(" small · ") : done.stderr.index(" file  ")]
    check_snapshot("sweep_summary", table)
    first = document["groups"][0]
    assert (first["case"], first["set"], first["runs"]) == ("near", {"network.loss": 0.0}, 2)
    assert set(first["metrics"][ERROR]) == {"median", "min", "max"}
    call_command("sweep", "small.yaml", "--resume", cwd=tmp_path, code=0, columns=80)
    assert len(list(tmp_path.rglob("*.parquet"))) == 1


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("keys", [0, 1, 4])
@pytest.mark.parametrize("metrics", [1, 4])
def test_sweep_table_fits_the_terminal(width, keys, metrics):
    """No line is wider than the terminal, and no part of a key or a metric is broken."""
    values = {
        "network.loss": 0.25,
        "air.wind.speed_mps": 12,
        "air.turbulence": {"kind": "dryden", "intensity": "severe"},
        "controller.estimators.leader_angular_acceleration": True,
    }
    names = (
        "windows.rectangles.mean_rms_m",
        "windows.circles.mean_rms_m",
        "followers.uav1.relative_position_error_m",
        "min_separation_m",
    )[:metrics]
    point = dict(list(values.items())[:keys])
    numbers = dict.fromkeys(names, (12.345, 3.21, 123.4))
    groups = (
        RunGroup("simulation-1-autopilot-100", point, 20, 19, numbers),
        RunGroup("far", point, 20, 20, dict.fromkeys(names)),
    )
    console = Console(width=width, file=io.StringIO())
    for table in summary_tables(Summary(names, {}, groups, (), 0), width):
        console.print(table)
    text = console.file.getvalue()
    assert max(map(len, text.splitlines())) <= width and "…" not in text
    for name in (*point, *names):
        for part in re.findall("[^._]+[._]?", name):
            assert re.search(rf"(?<![a-z]){re.escape(part)}", text), part
    assert text.count("3.21 to 123") == metrics and "19 of 20" in text


@pytest.mark.parametrize(
    ("numbers", "shown"),
    [
        ((12.345, 0.25, 999.0), "12.3 (0.25 to 999)"),
        ((765.4, 0.75, 1500.0), "765 (1 to 1500)"),
        ((-765.4, -1500.0, -0.75), "-765 (-1500 to -1)"),
    ],
)
def test_range_of_large_numbers_has_no_exponents(numbers, shown):
    groups = (RunGroup("", {}, 2, 2, {"min_separation_m": numbers}),)
    (table,) = summary_tables(Summary(("min_separation_m",), {}, groups, (), 0), 100)
    console = Console(width=100, file=io.StringIO())
    console.print(table)
    assert shown in console.file.getvalue()


def test_progress_shows_flights_per_second(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    for rate in ("flights", ""):
        with progress_counter("runs", rate=rate) as update:
            for done in range(5):
                time.sleep(0.01)
                update(done, 9)
        shown = re.sub(r"\x1b\[[\d;?]*\w", "", capsys.readouterr().err)
        assert "4 of 9" in shown
        assert bool(re.search(r" \d+(\.\d+)? flights/s", shown)) == bool(rate), shown


def test_sweep_bad_input_exits_2_and_writes_nothing(tmp_path):
    small_study.write(tmp_path)
    refuse_all("sweep", tmp_path)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98] if ALL else [0.02, 0.98])
def test_sweep_on_a_full_disk_is_one_error_line(folder, workers, tmp_path, share):
    """The disk is full when the journal is created, while it grows, or at the last write."""
    small_study.write(tmp_path)
    free = int(share * (folder / "whole.parquet").stat().st_size)
    arguments = ("sweep", "small.yaml", "--out", "full")
    with full_disk(free):
        done = call_command(*arguments, "--quiet", cwd=tmp_path, code=BAD_INPUT, columns=200)
    assert done.stderr.startswith("error: full/study.") and done.stderr.count("\n") == 1
    assert "cannot be written: File too large" in done.stderr
    left = {each.name for each in (tmp_path / "full").iterdir()}
    assert left <= {"study.parquet", "study.journal"}
    call_command(*arguments, "--resume", cwd=tmp_path, code=0, columns=200)
    assert same(folder, tmp_path / "full" / "study.parquet")


@pytest.mark.skipif(not WHOLE, reason="TESTBED_STUDIES=1: many processes, killed and restarted")
def test_sweep_killed_command_is_resumed_to_the_bit(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    out = tmp_path / "study.parquet"
    command = (sys.executable, "-m", "testbed", "sweep", "small.yaml", "--out", out, "--resume")
    journal = tmp_path / "study.journal"

    def rows():
        return journal.read_bytes().count(b'{"run":') if journal.exists() else 0

    for number in (signal.SIGKILL, signal.SIGINT, signal.SIGTERM):
        before = rows()
        parent = subprocess.Popen((*command, "--jobs", "2"), env=environment(80), cwd=folder)
        try:
            until(lambda before=before: rows() > before)
            parent.send_signal(number)
            parent.wait(timeout=TIMEOUT_S)
        finally:
            parent.kill()
        assert parent.returncode in (-signal.SIGKILL, INTERRUPTED)
    assert 0 < len(read_table(out).columns["run"]) < small_study.RUNS
    subprocess.run(command, env=environment(80), cwd=folder, check=True, timeout=TIMEOUT_S)
    assert same(folder, out)
