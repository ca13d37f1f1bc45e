"""Files of tests that are left out because nothing changed: what counts as a change."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import shards
import stamps
from cases import SEED, in_full
from places import ROOT, TESTS
from selection import Selection

GUSTS = TESTS / "atmosphere" / "equations" / "test_atmosphere_gusts.py"
COMMANDS = TESTS / "linear" / "contract" / "test_delay.py"  # runs commands


@pytest.fixture
def changed(monkeypatch):
    """Have the digest of one file be another."""
    before = stamps.digest_of

    def change(path):
        other = lambda each: "another" if each == path else before(each)  # noqa: E731
        monkeypatch.setattr(stamps, "digest_of", other)
        stamps.digest_below.cache_clear()

    yield change
    stamps.digest_below.cache_clear()


def test_imports_of_imports_are_followed():
    found = {str(path.relative_to(ROOT)) for path in stamps.closure(GUSTS)}
    assert {"testbed/atmosphere/gusts.py", "testbed/core/compile.py"} <= found
    assert not any(name.startswith(("testbed/flight/", "testbed/views/")) for name in found)


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("tests/atmosphere/equations/test_atmosphere_gusts.py", True),
        ("testbed/atmosphere/gusts.py", True),
        ("testbed/core/errors.py", True),
        ("scenarios/simulation-3.yaml", True),
        ("aircraft/rascal110/rascal110.xml", True),
        ("requirements.lock", True),
        ("testbed/views/view.py", False),
        ("docs/air.md", False),
    ],
)
def test_change_of_a_file_that_decides_counts(file, counts, changed):
    assert (ROOT / file).is_file()
    before = stamps.stamp(GUSTS)
    assert stamps.stamp(GUSTS) == before
    changed(ROOT / file)
    assert (stamps.stamp(GUSTS) != before) is counts


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("testbed/cli/main.py", True),
        ("testbed/cli/delay.py", True),  # the command
        ("testbed/linear/delay_margin.py", True),
        ("testbed/flight/loop.py", True),
        ("testbed/benchmark/score.py", False),
    ],
)
def test_commands_decide_by_their_names(file, counts, changed):
    assert (ROOT / file).is_file()
    before = stamps.stamp(COMMANDS)
    changed(ROOT / file)
    assert (stamps.stamp(COMMANDS) != before) is counts


UNKNOWN = (
    *("print(testbed)", "getattr(testbed, 'run')", "vars(testbed._MODULES)"),
    *("import testbed as t", "from testbed import *", "run('from testbed import (run)')"),
    *("from places import ROOT as HERE", "places.ROOT / 'docs'"),
    *("call(cwd=ROOT)", "HERE = ROOT", "ROOT.rglob('*')", "ROOT / name", "open(__file__)"),
)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("import testbed\ntestbed.run(1)", "testbed/runs/run.py"),
        ("from testbed import Batch", "testbed/runs/batch.py"),
        ("patch('testbed.reports.page.run_page')", "testbed/reports/page.py"),
        ("run('from testbed import Batch, load_run')", "testbed/logs/flight_data.py"),
        ("run('-m testbed.cli.main', 'new', 'law')", "testbed/cli/new.py"),
        ("ROOT / 'docs' / 'air.md'", "docs/air.md"),
        ("run(ROOT / 'examples/arc_follower.py')", "testbed/law.py"),
        ("SHARED / 'airframe_fuzz.py'", "testbed/airframes/airframe_validation.py"),
        *((text, None) for text in UNKNOWN),
    ],
)
def test_what_a_text_reaches_decides(text, name, tmp_path, monkeypatch):
    """None: it cannot be followed, so that every file of the repository decides."""
    path = tmp_path / "test_file.py"
    path.write_text(text + "\n")
    monkeypatch.setattr(stamps, "TESTS", tmp_path)
    found = stamps.decisive(path)
    if name is None:
        assert found is None
    else:
        assert name in {each.relative_to(ROOT).as_posix() for each in found[0] - {path}} | found[1]
        assert "testbed/studies/sweep.py" not in found[0]


@in_full
def test_files_execute_only_what_decides_them(tmp_path):
    """Functions that tests call, and files that are found by reading."""
    followed = [
        path
        for path in sorted(TESTS.rglob("test_*.py"))
        if path != Path(__file__) and stamps.decisive(path) is not None
    ]
    executed = tmp_path / "executed.json"
    for path in (COMMANDS, *random.Random(SEED).sample(followed, 12)):
        subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "executed_files", path],
            env=os.environ | {"EXECUTED": str(executed), "CI": "1"},
            check=True,
        )
        found = {*map(Path, json.loads(executed.read_text()))}
        assert found and not found - stamps.decisive(path)[0], path


def test_size_of_a_sample_counts(monkeypatch):
    before = stamps.stamp(GUSTS)
    monkeypatch.setenv("TESTBED_AIR_SAMPLES", "61")
    assert stamps.stamp(GUSTS) != before


@pytest.mark.parametrize("name", ["CI", "ALL", "TESTBED_SHARD"])
def test_nothing_is_left_out_in_ci(name, monkeypatch):
    for each in ("CI", "ALL", "TESTBED_SHARD"):
        monkeypatch.delenv(each, raising=False)
    assert stamps.wanted()
    monkeypatch.setenv(name, "1")
    assert not stamps.wanted()


def selection(*args, keyword=""):
    option = SimpleNamespace(keyword=keyword, markexpr="")
    return Selection(SimpleNamespace(rootpath=ROOT, option=option, args=args))


def run(chosen, *results):
    """Have a selection see results of tests: a node, and how it ended."""
    for node, outcome in results:
        chosen.pytest_runtest_logreport(SimpleNamespace(nodeid=node, outcome=outcome, duration=0.1))
    chosen.pytest_sessionfinish(SimpleNamespace(), pytest.ExitCode.OK)


def test_only_whole_files_that_pass_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(stamps, "FILE", tmp_path / "stamps.json")
    for each in ("CI", "ALL", "TESTBED_SHARD"):
        monkeypatch.delenv(each, raising=False)
    gusts, others = str(GUSTS.relative_to(ROOT)), str(COMMANDS.relative_to(ROOT))
    chosen = selection()
    chosen.expect([f"{gusts}::a", f"{gusts}::b", f"{others}::a"])
    run(chosen, (f"{gusts}::a", "passed"), (f"{others}::a", "failed"))
    assert stamps.unchanged() == {}  # one was not run, the other failed
    run(chosen, (f"{gusts}::b", "skipped"))
    assert stamps.unchanged() == {str(GUSTS): 2}
    run(chosen, (f"{gusts}::b", "failed"))  # at its teardown
    assert stamps.unchanged() == {}
    (tmp_path / "stamps.json").write_text(json.dumps([1]))
    assert stamps.unchanged() == {}
    assert not selection(keyword="a").stamps and not selection(f"{gusts}::a").stamps


def test_shards_are_all_tests_once(monkeypatch):
    files = sorted(TESTS.rglob("test_*.py"))
    items = [SimpleNamespace(path=path, nodeid=f"{path.relative_to(ROOT)}::a") for path in files]
    seen = []
    for part in (1, 2, 3):
        monkeypatch.setenv("TESTBED_SHARD", f"{part}/3")
        chosen = list(items)
        selection().pytest_collection_modifyitems(chosen)
        assert chosen
        seen += chosen
    assert sorted(each.nodeid for each in seen) == sorted(each.nodeid for each in items)


def test_shards_are_even_by_the_seconds_of_files(tmp_path, monkeypatch):
    monkeypatch.setattr(shards, "SECONDS", tmp_path / "seconds.json")
    shards.write_seconds({"long": 9.2, "b": 5.4, "c": 4.4, "short": 1.2})
    assert json.loads(shards.SECONDS.read_text()) == {"b": 5, "c": 4, "long": 9}
    files = ["b", "c", "long", "new", "short"]
    assert [shards.files_of(part, 2, files) for part in (1, 2)] == [
        {"b", "c", "short"},  # and lint and types: without them it would have the longest
        {"long", "new"},
    ]


def test_table_of_seconds_names_files_that_exist():
    assert [
        name for name in json.loads(shards.SECONDS.read_text()) if not (ROOT / name).exists()
    ] == []
