"""The command assess: its rows, page, exit code, and how it goes on after an interruption."""

import contextlib
import json
import shlex
import shutil
from functools import partial

import pytest
from cases import ALL
from commands import call_command

import testbed.assessment.assess as module
from testbed.assessment import conditions, measures
from testbed.assessment.assess import ROWS
from testbed.assessment.conditions import CONDITIONS
from testbed.atmosphere.turbulence_field import make_field
from testbed.pool.flight_task import run_task
from testbed.reports.assessment_page import TITLES

FLIGHT = ("assess", "ideal-figure-eight", "--duration", "20", "--flights", "2")
FEW = ("nominal", "loss", "leader-silent")  # rows that take least
SLOW = "rates={physics_hz: 50, autopilot_hz: 50, control_hz: 25, broadcast_hz: 25, log_hz: 25}"
RATES = () if ALL else ("--set", SLOW)
BOUNDS = ("--set", "expect.rms_m.max=47", *RATES)


class Here:
    """A pool that flies in this process, up to a number of rows."""

    def __init__(self):
        self.flown, self.most = [], 1000

    def run(self, tasks):
        for task in tasks:
            if len(self.flown) == self.most:
                raise KeyboardInterrupt
            self.flown.append(task)
            yield run_task(task)


def fly_here(patch):
    here = Here()
    patch.setattr(module, "open_flight_pool", lambda **_: contextlib.nullcontext(here))
    # few levels: how the value is found is tested with the search
    patch.setattr(conditions, "geometric_levels", lambda *ends: list(ends))
    if not ALL:  # the leader and one follower fail, in coarse fields for short flights
        patch.setattr(measures, "MAX_VICTIMS", 2)
        coarse = partial(make_field, path_m=600.0, finest_m=16.0, widest_m=2400.0)
        patch.setattr("testbed.plan.air.make_field", coarse)
    return here


@pytest.fixture
def pool(monkeypatch):
    return fly_here(monkeypatch)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of an assessment with all rows, and what was printed."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        fly_here(patch)
        return folder, assess(folder, *BOUNDS).stdout


@pytest.fixture
def kept(whole, tmp_path):
    """A function that returns the folder of a copy of it with some of its rows, to resume."""

    def keep(*rows):
        folder = shutil.copytree(whole[0], tmp_path / "copy")
        for path in (folder / "found" / "rows").iterdir():
            if path.stem not in rows:
                path.unlink()
        return folder

    return keep


def assess(folder, *words, code=0, flight=FLIGHT):
    words = (*flight, *words, "--out", folder / "found")
    return call_command(*words, cwd=folder, code=code, columns=120)


def written(folder):
    return json.loads((folder / "found" / "assessment.json").read_text())


def without_times(document):
    text = json.dumps(document)
    found = json.loads(text, object_hook=lambda each: {k: each[k] for k in each if k != "cpu_s"})
    return {key: value for key, value in found.items() if key != "command"}


def test_a_page_has_all_rows(whole):
    folder, printed = whole
    found = written(folder)
    page = (folder / "found" / "assessment.html").read_text()
    assert list(found["rows"]) == list(ROWS)
    assert (found["verdict"], found["short"]) == ("go", [])
    assert "go" in printed
    for name in ROWS:
        assert TITLES[name] in page or name == "nominal"
    for name in CONDITIONS:
        row = found["rows"][name]
        assert row["value"] is not None
        assert "testbed assess ideal-figure-eight --set expect.rms_m.max=47" in row["command"]
        assert row["seeds"] in (1, 2)
    assert found["rows"]["delay"]["seeds"] == 1
    assert found["rows"]["wind"]["seeds"] == 2
    assert "no roll command" in found["rows"]["margins"]["cases"][0]["not_predicted"]
    for flight in found["rows"]["gps-lost"]["flights"]:
        assert list(flight["does"]) == ["leader", "uav1", "uav2", "uav3"]
    assert "no flight model" in found["rows"]["engine-out"]["flights"][0]["problem"]


def test_a_flight_that_breaks_has_its_command(tmp_path, pool, kept):
    folder = kept("delay")
    assess(folder, *BOUNDS, "--only", "delay", "--resume")
    assert pool.flown == []
    row = written(folder)["rows"]["delay"]
    words = [*shlex.split(row["weakest"]["command"])[1:], "--quiet"]
    at = words.index(f"network.delay_s={row['weakest']['value']:g}")
    done = call_command(*words, "--out", tmp_path / "broken", cwd=tmp_path, code=3, columns=200)
    assert row["weakest"]["why"].split("; ")[0] in done.stderr + done.stdout
    words[at] = f"network.delay_s={row['value']:g}"
    call_command(*words, "--out", tmp_path / "kept", cwd=tmp_path, code=0, columns=200)
    assert written(folder)["verdict"] == "incomplete"


def test_a_bound_too_tight_is_a_nominal_row(tmp_path, pool):
    only = [word for name in ("nominal", *CONDITIONS) for word in ("--only", name)]
    assess(tmp_path, "--set", "expect.rms_m.max=1", *RATES, *only, code=3)
    found = written(tmp_path)
    assert found["verdict"] == "no-go"
    assert found["short"][0]["row"] == "nominal"
    assert "expect.rms_m.max: uav1" in found["short"][0]["text"]
    assert {found["rows"][name]["flights"] for name in CONDITIONS} == {0}
    assert {found["rows"][name]["value"] for name in CONDITIONS} == {None}
    page = (tmp_path / "found" / "assessment.html").read_text()
    assert page.count("no value") == len(CONDITIONS)


def test_an_interrupted_assessment_goes_on(tmp_path, pool, kept):
    rows = ("nominal", "loss", "delay", "leader-silent", "radio-cut") if ALL else FEW
    cut = (len(rows) + 1) // 2
    only = [word for name in rows for word in ("--only", name)]
    (tmp_path / "cut").mkdir()
    folder = kept(*rows)
    assess(folder, *BOUNDS, *only, "--resume")
    assert pool.flown == []
    pool.most = cut
    done = assess(tmp_path / "cut", *BOUNDS, *only, code=130)
    assert "write --resume" in done.stderr
    assert len([*(tmp_path / "cut" / "found" / "rows").iterdir()]) == cut
    pool.flown, pool.most = [], 1000
    assess(tmp_path / "cut", *BOUNDS, *only, "--resume")
    assert len(pool.flown) == len(rows) - cut
    both = written(folder), written(tmp_path / "cut")
    assert without_times(both[0]) == without_times(both[1])
    pool.flown = []
    done = assess(tmp_path / "cut", *BOUNDS, *only, "--resume")
    assert (pool.flown, done.stderr.count(": kept")) == ([], len(rows))


def test_rows_of_a_changed_scenario_are_found_anew(pool, kept):
    folder = kept("nominal", "delay")
    before = written(folder)
    only = ("--only", "nominal", "--only", "delay")
    assess(folder, "--set", "expect.rms_m.max=46", *RATES, *only, "--resume")
    assert len(pool.flown) == 2
    assert written(folder)["rows"]["delay"] != before["rows"]["delay"]


def test_parameters_of_the_aircraft_are_compared(tmp_path, pool):
    """One that differs is a no-go; flights with the tune of the file have none."""
    flight = ("assess", "simulation-3", "--duration", "1", "--flights", "1", "--only", "nominal")
    assess(tmp_path, flight=flight, code=3)  # the second is too short for the criteria
    own = tmp_path / "found" / "parameters" / "rascal110.param"
    (tmp_path / "same.param").write_text(own.read_text())
    other = tmp_path / "other.param"
    changed = own.read_text().replace("ROLL_LIMIT_DEG 50", "ROLL_LIMIT_DEG 45")
    other.write_text("".join(line for line in changed.splitlines(True) if "NAVL1" not in line))
    assert changed != own.read_text() and other.read_text() != changed

    for file, count in (("same.param", 0), ("uav1=other.param", 3)):
        assess(tmp_path, "--resume", "--param", file, flight=flight, code=3)
        found = written(tmp_path)
        [compared] = found["compared"]
        assert len(compared["differences"]) == count, compared
        short = [each["text"] for each in found["short"] if each["row"] == "parameters"]
        assert len(short) == bool(count)
        assert f"--param {file}" in found["command"]
    assert compared["aircraft"] == ["uav1"]
    assert "ROLL_LIMIT_DEG 50: 45 in other.param" in compared["differences"]
    assert "its path as tune of uav1" in short[0]
    page = (tmp_path / "found" / "assessment.html").read_text()
    assert "3 of these flights differ:" in page

    with_file = ("--set", f"fleet.uav1.tune={other}", "--param", "uav1=other.param")
    assess(tmp_path, "--resume", *with_file, flight=flight, code=3)
    differences = written(tmp_path)["compared"][0]["differences"]
    assert all("not in other.param" in each for each in differences)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--param", "none.param"), "no aircraft here has a flight model"),
        (("--only", "los"), "--only los: write one of nominal, margins, loss"),
        (("--flights", "0"), "--flights 0: write a whole number above 0"),
        (("--resume",), "there is no such folder to resume"),
        (("--set", "leader.autopilot=ardupilot"), "leader.autopilot"),
    ],
)
def test_wrong_words_are_refused(tmp_path, pool, words, text):
    done = assess(tmp_path, *words, code=2)
    assert text in done.stderr
    assert pool.flown == []
