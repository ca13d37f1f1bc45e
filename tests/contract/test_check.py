"""`testbed check`: what it prints, what it leaves, and its exit codes."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import check_pages as pages
import pytest
import yaml
from commands import call_command, children, environment, run_command
from patience import PATIENCE_S, until

from testbed.check_console import check_and_show
from testbed.study.flights import Flight, fly_all
from testbed.study.golden_table import read_table

ROOT = Path(__file__).parents[2]
PYPROJECT = (ROOT / "pyproject.toml").read_text()
ENV = environment(100)
BAD_INPUT, REGRESSION, INTERRUPTED = 2, 3, 130


def check(*arguments, cwd, code=0):
    return run_command("check", *arguments, cwd=cwd, code=code, columns=100)


def check_here(*arguments, cwd, code=0):
    return call_command("check", *arguments, cwd=cwd, code=code, columns=100)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with an exact page, a noisy one, and their tables."""
    folder = tmp_path_factory.mktemp("desk")
    pages.write(folder, "exact")
    pages.write(folder, "noisy", noisy=True)
    options = ("--update", "--seeds", "3", "--jobs", "1", "--reason", "first flights")
    done = check_here("exact.yaml", "noisy.yaml", *options, cwd=folder)
    assert "exact.yaml · written · seeds 1, 2, the same for every seed" in done.stdout
    assert "noisy.yaml · written · seeds 1 to 3, with dice" in done.stdout
    return folder


def test_a_good_run_passes_and_writes_nothing_however_many_fly_at_once(desk):
    before = pages.files(desk)
    assert sorted(before) == ["exact.yaml", "golden/exact.json", "golden/noisy.json", "noisy.yaml"]
    words = ("exact.yaml", "noisy.yaml", "--seeds", "2", "--json", "-", "--jobs")
    one, two = check(*words, 1, cwd=desk), check_here(*words, 2, cwd=desk)
    assert (one.stdout, one.stderr) == (two.stdout, two.stderr)
    document = json.loads(one.stdout)
    assert document["passed"]
    assert [each["seeds"] for each in document["scenarios"]] == [[1, 2]] * 2
    assert "2 good" in one.stderr
    assert "\x1b" not in one.stderr
    assert pages.files(desk) == before


@pytest.fixture(scope="module")
def failed(desk, tmp_path_factory):
    """A page whose gains changed and one that loses an aircraft, between two of the same table."""
    folder = tmp_path_factory.mktemp("failed")
    (folder / "golden").mkdir()
    changes = {"before": "", "gain": pages.LESS_GAIN, "dive": pages.INTO_THE_GROUND, "after": ""}
    for name, change in changes.items():
        pages.write(folder, name, change)
        table = (desk / "golden/exact.json").read_bytes()
        (folder / "golden" / f"{name}.json").write_bytes(table)
    before = pages.files(folder)
    names = [f"{name}.yaml" for name in changes]
    outputs = ("--seeds", "1", "--jobs", "1", "--junit", "junit.xml", "--json", "found.json")
    done = check_here(*names, *outputs, cwd=folder, code=REGRESSION)
    assert pages.files(folder).items() > before.items()
    assert pages.files(folder).keys() == {*before, "junit.xml", "found.json"}
    return folder, done.stdout


def test_a_changed_gain_fails_and_names_the_page_and_the_offenders(failed):
    folder, printed = failed
    lines = printed[printed.index(" gain.yaml") :].splitlines()
    assert lines[0].startswith(" gain.yaml · FAILED · seed 1 ·")
    assert lines[1].strip() == "golden: first flights"
    assert lines[2].strip() == "the page changed: controller.gain_scale from 1 to 0.9"
    assert "testbed run gain.yaml --seed 1" in printed
    found = json.loads((folder / "found.json").read_text())["scenarios"][1]
    offenders = found["offenders"]
    outside = [each["outside"] for each in offenders]
    assert outside == sorted(outside, reverse=True)
    assert outside[-1] > 1.0
    rows = {each["row"] for each in offenders}
    assert {f"rms_m/circles/{name}" for name in pages.FOLLOWERS} <= rows
    assert rows == {key for key, row in found["rows"].items() if not row["passed"]}


def test_a_lost_aircraft_fails_and_is_named(failed):
    _, printed = failed
    assert " dive.yaml · FAILED" in printed
    assert "seed 1: lost at" in printed
    assert "uav1: lost" in printed
    assert "testbed run dive.yaml --seed 1" in printed


def test_the_others_are_judged_all_the_same_and_the_last_lines_sum_up(failed):
    _, printed = failed
    assert " before.yaml · good" in printed
    assert " after.yaml · good" in printed
    *_, count, hint = printed.splitlines()
    assert count == " 2 failed, 2 good"
    # a table of a lost flight would not be written: dive.yaml is not offered
    assert hint.endswith("testbed check gain.yaml --update --reason TEXT")


def test_the_junit_says_the_same(failed):
    folder, _ = failed
    found = json.loads((folder / "found.json").read_text())["scenarios"]
    suites = ElementTree.parse(folder / "junit.xml").getroot().findall("testsuite")
    rows = len(found[0]["rows"])
    moved = sum(not row["passed"] for row in found[1]["rows"].values())
    counts = [[int(suite.get(n)) for n in ("tests", "failures", "skipped")] for suite in suites]
    whole = 1 + rows
    assert counts == [[whole, 0, 0], [whole, moved, 0], [whole, 1, rows], [whole, 0, 0]]
    message = suites[1].find("testcase/failure").get("message")
    assert "seed 1" in message and "golden" in message


def without_a_number(path):
    table = json.loads(path.read_text())
    table["rows"]["min_separation_m"]["by_seed"].pop()
    return json.dumps(table)


# Tables that cannot be read, made from one that can.
SPOILT = {
    "broken": lambda path: '{"schema": 1}',
    "torn": lambda path: path.read_text()[:1000],
    "old": lambda path: path.read_text().replace('"schema": 1', '"schema": 0'),
    "short": without_a_number,
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_an_update_takes_a_table_that_cannot_be_read_as_missing(
    desk, tmp_path, monkeypatch, capsys, flown, spoil
):
    page = pages.write(tmp_path, "exact")
    path = tmp_path / "golden" / "exact.json"
    path.parent.mkdir()
    path.write_text(SPOILT[spoil](desk / "golden/exact.json"))
    monkeypatch.setattr("testbed.study.golden.fly_all", flown)
    quiet = {"seeds": None, "jobs": 1, "junit": None, "json": None, "golden": None}
    code = check_and_show([str(page)], update=True, reason="again", **quiet)
    printed = capsys.readouterr().out.splitlines()
    assert code == 0
    (said,) = [line for line in printed if "taken as without a table" in line]
    assert "exact.json: not a golden table: " in said and "--update" not in said
    assert sum(" · written · " in line for line in printed) == 1
    assert read_table(path).reason == "again"
    assert read_table(path).rows == read_table(desk / "golden/exact.json").rows


@pytest.fixture(scope="module")
def flown():
    """In place of `fly_all`: the flight of the exact page, flown once."""
    flight = pages.fly(1)

    def fly(wanted, **_):
        return [Flight(seed, flight.metrics) for _, seed in wanted]

    return fly


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("exact.yaml", "noisy.yaml"), "testbed check noisy.yaml --update --reason TEXT"),
        (("exact.yaml", "--update"), "--reason TEXT"),
        (("exact.yaml", "--update", "--reason", "  "), "--reason TEXT"),
        (("exact.yaml", "--reason", "why"), "--update"),
        (("exact.yaml", "--update", "--reason", "why", "--junit", "j.xml"), "--junit"),
        (("exact.yaml", "--update", "--reason", "why", "--seeds", "2"), "3 at least"),
        (("exact.yaml", "--seeds", "0"), "--seeds 0"),
        (("exact.yaml", "--jobs", "-1"), "--jobs -1"),
        (("exact.yaml", "--golden", "nowhere"), "no such folder"),
        (("--golden", "."), "no golden tables"),
        (("exact.yaml", "--json", "missing/f.json"), "there is no folder"),
        (("no-such-page",), "no-such-page"),
        (("bare.yaml",), "scenario.portions"),
        (("broken.yaml",), "scenario: Field required"),
        (("torn.yaml",), "torn.json: not a golden table: the file: Invalid JSON"),
        (("old.yaml",), "schema: Input should be 1"),
        (("short.yaml",), "1 numbers, not one for each seed (write it anew with --update"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_bad_input_is_refused_before_anything_flies(
    desk, tmp_path, monkeypatch, capsys, arguments, says
):
    from testbed import cli

    for name in ("exact", "noisy", "broken", "torn", "old", "short"):
        pages.write(tmp_path, name)
    bare = ROOT / "tests" / "data" / "scenarios" / "minimal.yaml"
    (tmp_path / "bare.yaml").write_bytes(bare.read_bytes())
    (tmp_path / "golden").mkdir()
    (tmp_path / "golden" / "exact.json").write_bytes((desk / "golden/exact.json").read_bytes())
    for name, spoil in SPOILT.items():
        (tmp_path / "golden" / f"{name}.json").write_text(spoil(desk / "golden/exact.json"))
    before = pages.files(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["testbed", "check", *arguments])
    monkeypatch.setattr("testbed.study.golden.fly_all", pytest.fail)
    with pytest.raises(SystemExit) as ending:
        cli.main()
    assert ending.value.code == BAD_INPUT
    assert says in capsys.readouterr().err
    assert pages.files(tmp_path) == before


def test_bad_input_is_in_the_junit_too(tmp_path):
    pages.write(tmp_path, "exact")
    done = check_here("exact.yaml", "--junit", "j.xml", cwd=tmp_path, code=BAD_INPUT)
    assert "there is no golden table golden/exact.json" in done.stderr
    root = ElementTree.parse(tmp_path / "j.xml").getroot()
    assert (root.get("tests"), root.get("errors"), root.get("failures")) == ("1", "1", "0")


def test_ctrl_c_is_130_and_leaves_nothing(tmp_path):
    pages.write(tmp_path, "long", "leader: {sensors: truth}")
    text = (tmp_path / "long.yaml").read_text().replace("duration_s: 14", "duration_s: 20000")
    (tmp_path / "long.yaml").write_text(text)
    process = subprocess.Popen(
        [sys.executable, "-m", "testbed", "check", "long.yaml", "--update", "--reason", "why"],
        cwd=tmp_path,
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        until(lambda: process.poll() is not None or children(process.pid))
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == INTERRUPTED, errors
    assert (printed, errors) == ("", "")
    assert pages.files(tmp_path).keys() == {"long.yaml"}
    # Python's own tracker of shared resources ends a little later
    until(lambda: not anybody_of(process.pid))


def anybody_of(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_flight_that_raises_is_a_row_and_not_the_end(tmp_path):
    """A world that cannot be built, beside one that can."""
    bad = pages.page("formation.leader_gains.uav1=0", "formation.neighbour_gains.uav2.uav1=0")
    good = pages.page()
    flights = fly_all([(bad, 1), (good, 1)], jobs=1)
    assert flights[0].metrics is None
    assert "A + B is singular" in flights[0].problem
    assert flights[1].metrics["outcome"] == "flown"


def test_the_workflow_uploads_what_the_check_writes():
    workflow = yaml.safe_load((ROOT / ".github/workflows/check.yml").read_text())
    (job,) = workflow["jobs"].values()
    supported = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
    assert job["strategy"]["matrix"]["python"] == supported
    runs = [step["run"] for step in job["steps"] if "run" in step]
    (check_step,) = [each for each in runs if "testbed check" in each]
    (upload,) = [step for step in job["steps"] if "upload-artifact" in step.get("uses", "")]
    assert check_step.endswith(f"--junit {upload['with']['path']}")
