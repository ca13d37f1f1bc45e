"""A study in one file, the same to the bit whoever flies it and however often it is interrupted."""

import json
import os
import shlex
import signal
import subprocess
import sys

import pytest
import study_pages as pages
from commands import call_command, environment
from patience import PATIENCE_S, until

from testbed.errors import InputError
from testbed.study.journal import Journal
from testbed.study.places import find_file
from testbed.study.rows import flatten
from testbed.study.sweep import sweep
from testbed.study.table import read_rows, read_table

WHOLE = os.environ.get("TESTBED_STUDIES")
LOST, BAD_INPUT, INTERRUPTED = 1, 2, 130
ERROR = "portions.approach.mean_rms_m"


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with the small study, and what it is when it is flown at one go."""
    folder = tmp_path_factory.mktemp("desk")
    pages.write(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("testbed.study.crew._pool", lambda *_: pages.Here())
        patch.chdir(folder)
        sweep(folder / "small.yaml", folder / "whole.parquet", refresh_s=0.0)
    return folder


@pytest.fixture
def here(monkeypatch, desk):
    """Who flies in this process."""
    pool = pages.Here()
    monkeypatch.setattr("testbed.study.crew._pool", lambda *_: pool)
    monkeypatch.chdir(desk)
    return pool


def same(desk, path):
    return pages.content(read_table(path)) == pages.content(read_table(desk / "whole.parquet"))


def test_a_row_for_each_run_in_order(desk):
    table = read_table(desk / "whole.parquet")
    assert table.complete
    assert table.columns["run"].tolist() == list(range(pages.RUNS))
    assert list(table.columns)[:7] == [
        *("run", "case", "seed", "set.network.loss", "outcome", "error", "command")
    ]
    rows = read_rows(desk / "whole.parquet")
    assert [(r["case"], r["set.network.loss"], r["seed"]) for r in rows[:5]] == [
        *(("near", 0, 3), ("near", 0, 1), ("near", 0.4, 3), ("near", 0.4, 1), ("far", 0, 3))
    ]
    assert {row["outcome"] for row in rows} == {"flown"}
    assert rows[0][f"metrics.{ERROR}"] < rows[4][f"metrics.{ERROR}"]
    assert rows[2][f"metrics.{ERROR}"] != rows[3][f"metrics.{ERROR}"]  # other dice
    assert rows[0]["metrics.engaged_at_s.uav1"] is None
    assert not any("wall" in name or "version" in name for name in table.columns)
    assert table.facts["study.yaml"] == pages.PAGE
    assert "duration_s: 1.0" in table.facts["scenario.far.yaml"]
    assert json.loads(table.facts["versions.json"])["jsbsim"]
    assert {path.name for path in desk.iterdir()} == {"small.yaml", "whole.parquet"}


def test_the_command_of_a_row_gives_its_numbers_to_the_bit(desk, tmp_path):
    row = read_rows(desk / "whole.parquet")[7]
    words = shlex.split(row["command"])
    assert words[:3] == ["testbed", "run", "ideal-figure-eight"]
    call_command(*words[1:], "--out", "run", "--quiet", cwd=tmp_path, code=0, columns=80)
    again = flatten(json.loads((tmp_path / "run/metrics.json").read_text()))
    row = {name.removeprefix("metrics."): value for name, value in row.items()}
    assert {name: row[name] for name in again} == again


def test_processes_give_the_same_file(desk, tmp_path, monkeypatch):
    monkeypatch.chdir(desk)
    seen = []
    swept = sweep(
        "small.yaml", tmp_path / "new", jobs=2, progress=lambda *numbers: seen.append(numbers)
    )
    assert same(desk, swept.path)
    assert swept.flown == pages.RUNS and swept.good
    assert seen == [(k, pages.RUNS) for k in range(pages.RUNS + 1)]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["study.parquet"]


@pytest.mark.filterwarnings("ignore")  # of a library's own that we do not depend on
def test_a_dask_cluster_gives_the_same_file(desk, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="the extra dask of pyproject.toml")
    monkeypatch.chdir(desk)
    kind = {"n_workers": 2, "threads_per_worker": 1, "processes": bool(WHOLE)}
    with distributed.LocalCluster(**kind, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        out = tmp_path / "dask.parquet"
        sweep("small.yaml", out, backend="dask", scheduler=address)
    assert same(desk, out)


def interrupted(desk, out, after, **more):
    """The study, stopped after so many runs."""

    def progress(done, of):
        if done == after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep("small.yaml", out, progress=progress, **more)


def test_an_interrupted_study_is_readable_and_resumed_to_the_bit(desk, here, tmp_path):
    out = tmp_path / "study.parquet"
    interrupted(desk, out, 3)
    part = read_table(out)
    assert not part.complete and part.columns["run"].tolist() == [0, 1, 2]
    with (tmp_path / "study.journal").open("ab") as journal:
        journal.write(b'{"run":3,"outcome":"flo')  # the machine went down here
    with pytest.raises(InputError, match="go on with it with --resume"):
        sweep("small.yaml", out)
    here.flown.clear()
    swept = sweep("small.yaml", out, resume=True)
    assert swept.flown == pages.RUNS - 3
    assert here.flown == list(range(3, pages.RUNS))
    assert same(desk, out)
    assert [path.name for path in tmp_path.iterdir()] == ["study.parquet"]
    assert sweep("small.yaml", out, resume=True).flown == 0


def test_a_study_may_be_interrupted_before_its_first_run(desk, here, tmp_path):
    out = tmp_path / "study.parquet"
    interrupted(desk, out, 0)
    assert len(read_table(out).columns["run"]) == 0
    interrupted(desk, out, 1, resume=True)
    assert read_table(out).columns["run"].tolist() == [0]


def test_the_file_can_be_read_while_the_study_is_flown(desk, here, tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.study.sweep.SHARE", 1e9)  # writing may take all of the time
    out = tmp_path / "study.parquet"
    seen = []

    def progress(done, of):
        seen.append((done, len(read_table(out).columns["run"])))

    sweep("small.yaml", out, refresh_s=0.0, progress=progress)
    assert seen == [(0, 0), *((done, done - 1) for done in range(1, pages.RUNS + 1))]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("0.4]", "0.4, 0.5]"), r"the study's page .*vary.network.loss"),
        (lambda text: text.replace("[3, 1]", "[3, 1, 2]"), r"study.seeds from \[3, 1\]"),
        (
            lambda text: text.replace("ideal-figure-eight", "mine.yaml"),
            "study.scenario from ideal-figure-eight to mine.yaml",
        ),
    ],
    ids=["levels", "seeds", "scenario"],
)
def test_another_study_is_not_gone_on_with(desk, here, tmp_path, change, says):
    out = tmp_path / "study.parquet"
    interrupted(desk, out, 1)
    before = (tmp_path / "study.journal").read_bytes()
    (tmp_path / "mine.yaml").write_text("extends: ideal-figure-eight\n")
    other = pages.write(tmp_path, change(pages.PAGE))
    with pytest.raises(InputError, match=says):
        sweep(other, out, resume=True)
    assert (tmp_path / "study.journal").read_bytes() == before


def test_other_versions_do_not_go_on(desk, here, tmp_path, monkeypatch):
    out = tmp_path / "study.parquet"
    interrupted(desk, out, 1)
    monkeypatch.setattr("testbed.study.sweep.versions", lambda: {"jsbsim": "0.9"})
    with pytest.raises(InputError, match=r"versions other than now: .*jsbsim from .* to 0.9"):
        sweep("small.yaml", out, resume=True)
    with pytest.raises(InputError, match="by a worker of other versions: .*jsbsim"):
        sweep("small.yaml", tmp_path / "new")


def test_two_sweeps_do_not_write_one_file(desk, here, tmp_path):
    out = tmp_path / "study.parquet"

    def progress(done, of):
        with pytest.raises(InputError, match="another sweep is at work on it"):
            sweep("small.yaml", out, resume=True)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep("small.yaml", out, progress=progress)


def test_two_sweeps_that_begin_at_once_do_not_write_one_file(desk, here, tmp_path, monkeypatch):
    """Neither has seen the other's file when it looks; and nobody goes on with a complete one."""
    out = tmp_path / "study.parquet"
    looked = find_file("small", out, resume=False)

    def progress(done, of):
        with pytest.raises(InputError, match=r"study\.journal: another sweep is at work on it"):
            sweep("small.yaml", out)
        with pytest.raises(InputError, match=r"study\.journal: another sweep has just begun it"):
            Journal(looked.journal, {})

    close = Journal.close

    def held(journal):
        assert not journal.path.exists()
        close(journal)

    with monkeypatch.context() as patch:
        patch.setattr("testbed.study.sweep.find_file", lambda *_, **__: looked)
        patch.setattr(Journal, "close", held)
        sweep("small.yaml", out, progress=progress)
    assert same(desk, out)


BAD = """
study: {schema: 1, name: bad, scenario: ideal-figure-eight, duration_s: 1, metrics: [max_err]}
cases:
  good: {}
  singular: {formation.leader_gains.uav1: 0}
  lost: {scenario: near.yaml, limits.collision_m: 47.43}
  raises: {controller.law: "torn:Torn"}
"""
NEAR = "extends: ideal-figure-eight"
TORN = """
class Torn:
    def __init__(self, team):
        self.paper = team.paper

    def start(self, own):
        return self.paper.start(own)

    def step(self, now, own, inbox, memory):
        if now > 0.5:
            raise RuntimeError("torn")
        return self.paper.step(now, own, inbox, memory)
"""


def test_a_bad_run_is_a_row_and_exit_code_1(here, tmp_path):
    pages.write(tmp_path, BAD, "bad")
    (tmp_path / "near.yaml").write_text(NEAR)
    (tmp_path / "torn.py").write_text(TORN)
    done = call_command(
        "sweep", "bad.yaml", "--out", "b.parquet", "--json", "b.json",
        cwd=tmp_path, code=LOST, columns=100,
    )  # fmt: skip
    rows = {row["case"]: row for row in read_rows(tmp_path / "b.parquet")}
    assert {case: row["outcome"] for case, row in rows.items()} == {
        "good": "flown",
        "singular": "cannot be flown",
        "lost": "lost",
        "raises": "cannot be flown",
    }
    assert "A + B is singular" in rows["singular"]["error"]
    assert rows["lost"]["error"].startswith("lost: ") and rows["lost"]["metrics.simulated_s"] < 1
    assert "torn.py:11: the law raised RuntimeError: torn" in rows["raises"]["error"]
    assert rows["good"]["error"] == "" and rows["raises"]["metrics.simulated_s"] is None
    for row in rows.values():
        assert row["outcome"] == "flown" or row["command"] in done.stdout
    assert "2 cannot be flown" in done.stdout
    assert "no run has a number 'max_err'" in done.stdout
    document = json.loads((tmp_path / "b.json").read_text())
    assert document["outcomes"] == {
        "flown": 1,
        "lost": 1,
        "upset": 0,
        "failed": 0,
        "cannot be flown": 2,
    }
    assert document["complete"] and len(document["troubles"]) == 3


def test_the_end_is_told_and_kept_under_logs(desk, here, tmp_path):
    pages.write(tmp_path)
    done = call_command("sweep", "small.yaml", "--json", "-", cwd=tmp_path, code=0, columns=80)
    document = json.loads(done.stdout)
    assert document["runs"] == document["flown_now"] == pages.RUNS
    (path,) = tmp_path.glob("logs/studies/small/*/study.parquet")
    assert str(path.relative_to(tmp_path)) == document["file"]
    assert document["file"] in done.stderr and "median" in done.stderr
    first = document["groups"][0]
    assert (first["case"], first["set"], first["runs"]) == ("near", {"network.loss": 0.0}, 2)
    assert set(first["metrics"][ERROR]) == {"median", "smallest", "largest"}
    again = call_command("sweep", "small.yaml", "--resume", cwd=tmp_path, code=0, columns=80)
    assert "0 of them now" in again.stdout
    assert len(list(tmp_path.rglob("*.parquet"))) == 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("no-such-study",), "there is no study 'no-such-study'"),
        (("small.yaml", "--jobs", "0"), "--jobs 0"),
        (("small.yaml", "--json", "missing/f.json"), "there is no folder"),
        (("small.yaml", "--scheduler", "tcp://127.0.0.1:1"), "goes with --backend dask"),
        (("small.yaml", "--backend", "ray"), "'ray' is not one of"),
        (("small.yaml", "--out", "small.yaml"), "--out small.yaml: cannot be made"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_is_2_and_leaves_nothing(tmp_path, arguments, says):
    pages.write(tmp_path)
    done = call_command("sweep", *arguments, cwd=tmp_path, code=BAD_INPUT, columns=200)
    assert says in done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["small.yaml"]


@pytest.mark.skipif(not WHOLE, reason="TESTBED_STUDIES=1: many processes, killed and started anew")
def test_a_study_whose_processes_are_killed_is_resumed_to_the_bit(desk, tmp_path, monkeypatch):
    monkeypatch.chdir(desk)
    out = tmp_path / "study.parquet"
    asked = (sys.executable, "-m", "testbed", "sweep", "small.yaml", "--out", out, "--resume")
    journal = tmp_path / "study.journal"

    def rows():
        return journal.read_bytes().count(b'{"run":') if journal.exists() else 0

    for number in (signal.SIGKILL, signal.SIGINT, signal.SIGTERM):
        before = rows()
        parent = subprocess.Popen((*asked, "--jobs", "2"), env=environment(80), cwd=desk)
        try:
            until(lambda before=before: rows() > before)
            parent.send_signal(number)
            parent.wait(timeout=PATIENCE_S)
        finally:
            parent.kill()
        assert parent.returncode in (-signal.SIGKILL, INTERRUPTED)
    assert 0 < len(read_table(out).columns["run"]) < pages.RUNS
    subprocess.run(asked, env=environment(80), cwd=desk, check=True, timeout=PATIENCE_S)
    assert same(desk, out)
