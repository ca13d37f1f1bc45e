"""`testbed check`: output, files and exit codes."""

import json
import re
from xml.etree import ElementTree

import golden_scenarios as samples
import pytest
import yaml
from cases import ALL, in_full
from commands import call_command, refuse_all
from places import ROOT
from small_study import Backwards, in_this_process, use
from snapshot import check_snapshot

from testbed.core.compile import notice
from testbed.core.errors import InputError
from testbed.golden.golden import fly_all
from testbed.golden.golden_annotations import MAX_ANNOTATIONS, input_annotations
from testbed.golden.golden_compare import GoldenFlight
from testbed.golden.golden_table import read_table
from testbed.pool.flight_code import describe_code
from testbed.pool.scenario_snapshot import read_inputs
from testbed.scenario import dump, load_scenario

PYPROJECT = (ROOT / "pyproject.toml").read_text()
BAD_INPUT, REGRESSION, INTERRUPTED = 2, 3, 130


def check(*arguments, cwd, code=0):
    return call_command("check", *arguments, cwd=cwd, code=code, columns=100)


def check_here(*arguments, cwd, code=0):
    with in_this_process():
        return check(*arguments, cwd=cwd, code=code)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A deterministic scenario, a noisy one, and their tables."""
    folder = tmp_path_factory.mktemp("golden")
    samples.write(folder, "exact")
    samples.write(folder, "noisy", noisy=True)
    options = ("--update", "--seeds", "3", "--reason", "first flights")
    done = check_here("exact.yaml", "noisy.yaml", *options, cwd=folder)
    check_snapshot("check_update", done.stdout)
    return folder


def without_notice(text):
    """Return it without the notice of kernels that another process compiles meanwhile."""
    return text.removeprefix(f"{notice()}\n")


def test_check_same_code_passes_for_any_jobs(folder, monkeypatch):
    """Output and files do not depend on the number of processes, and nothing is written.

    In `make test` flights that end in another order stand for those of two processes.
    """
    before = samples.files(folder)
    assert sorted(before) == ["exact.yaml", "golden/exact.json", "golden/noisy.json", "noisy.yaml"]
    words = ("exact.yaml", "noisy.yaml", "--seeds", "2", "--json", "-", "--jobs")
    one = check_here(*words, 1, cwd=folder)
    if not ALL:
        workers = use(monkeypatch, Backwards())
    two = check(*words, 2, cwd=folder)
    assert ALL or workers.finished != sorted(workers.finished)
    assert one.stdout == two.stdout
    assert without_notice(one.stderr) == without_notice(two.stderr)
    document = json.loads(one.stdout)
    assert document["passed"]
    assert [each["seeds"] for each in document["scenarios"]] == [[1, 2]] * 2
    assert "\x1b" not in one.stderr
    assert samples.files(folder) == before


@pytest.fixture(scope="module")
def failed(folder, tmp_path_factory):
    """A lower gain and a lost aircraft, between two scenarios that pass with the same table."""
    other = tmp_path_factory.mktemp("failed")
    (other / "golden").mkdir()
    changes = {"before": "", "gain": samples.LOWER_GAIN, "dive": samples.INTO_THE_GROUND}
    changes["after"] = ""
    for name, change in changes.items():
        samples.write(other, name, change)
        table = (folder / "golden/exact.json").read_bytes()
        (other / "golden" / f"{name}.json").write_bytes(table)
    before = samples.files(other)
    names = [f"{name}.yaml" for name in changes]
    outputs = ("--seeds", "1", "--junit", "junit.xml", "--json", "found.json")
    done = check_here(*names, *outputs, cwd=other, code=REGRESSION)
    assert samples.files(other).items() > before.items()
    assert samples.files(other).keys() == {*before, "junit.xml", "found.json"}
    return other, done.stdout


def test_check_failures_print_causes_and_commands(failed):
    """The text names changes, lost aircraft, violations, and which update would be written."""
    check_snapshot("check_failed", failed[1])


def test_check_lower_gain_lists_violations(failed):
    folder, _ = failed
    found = json.loads((folder / "found.json").read_text())["scenarios"][1]
    assert found["changes"] == ["controller.gain_scale is now 0.9"]
    deviations = [each["deviation"] for each in found["violations"]]
    assert deviations == sorted(deviations, reverse=True)
    assert deviations[-1] > 1.0
    rows = {each["row"] for each in found["violations"]}
    assert {f"rms_m/circles/{name}" for name in samples.FOLLOWERS} <= rows
    assert rows == {key for key, row in found["rows"].items() if not row["passed"]}


def test_check_junit_agrees_with_json(failed):
    folder, _ = failed
    found = json.loads((folder / "found.json").read_text())["scenarios"]
    suites = ElementTree.parse(folder / "junit.xml").getroot().findall("testsuite")
    rows = len(found[0]["rows"])
    differing = sum(not row["passed"] for row in found[1]["rows"].values())
    counts = [[int(suite.get(n)) for n in ("tests", "failures", "skipped")] for suite in suites]
    cases = 1 + rows
    assert counts == [[cases, 0, 0], [cases, differing, 0], [cases, 1, rows], [cases, 0, 0]]
    message = suites[1].find("testcase/failure").get("message")
    assert "seed 1" in message and "golden" in message


def without_a_number(path):
    table = json.loads(path.read_text())
    table["rows"]["min_separation_m"]["by_seed"].pop()
    return json.dumps(table)


# Unreadable tables, made from a readable one.
UNREADABLE = {
    "broken": lambda path: '{"schema": 3}',
    "cut": lambda path: path.read_text()[:1000],
    "old": lambda path: path.read_text().replace('"schema": 3', '"schema": 1'),
    "short": without_a_number,
}


@pytest.mark.parametrize("kind", UNREADABLE)
def test_update_unreadable_table_is_replaced(folder, tmp_path, monkeypatch, fly_two, kind):
    samples.write(tmp_path, "exact")
    path = tmp_path / "golden" / "exact.json"
    path.parent.mkdir()
    path.write_text(UNREADABLE[kind](folder / "golden/exact.json"))
    monkeypatch.setattr("testbed.golden.golden.fly_all", fly_two)
    done = check_here("exact.yaml", "--update", "--reason", "again", cwd=tmp_path)
    printed = done.stdout.splitlines()
    (line,) = [line for line in printed if "the old table is ignored" in line]
    assert "the old table is ignored: golden/exact.json: " in line and "--update" not in line
    assert sum(" · written · " in line for line in printed) == 1
    assert read_table(path).reason == "again"
    assert read_table(path).rows == read_table(folder / "golden/exact.json").rows


def write_schema_2(folder, path, **rows):
    """Write a table as schema 2 had it: with copies in place of digests, and other rules."""
    inputs = read_inputs(load_scenario(folder / "exact.yaml"), folder)
    table = json.loads((folder / "golden/exact.json").read_text()) | {"schema": 2}
    for key in ("code", "value_digests", "scenario_digests"):
        del table[key]
    table["rules"], table["band"] = {"rms_m": {"label": "RMS error"}}, {"false_alarm": 1e-6}
    table["values"], table["resolved_scenario"] = dict(inputs.values), dict(inputs.scenario)
    table["metrics"] = ["a_metric_that_is_gone", *table["metrics"]]
    for key, value in rows.items():
        table["rows"][key]["by_seed"] = [value] * len(table["seeds"])
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(table))


def test_table_of_schema_2_is_compared(folder, tmp_path, monkeypatch, fly_two):
    """Its rows decide, its copies name what changed; an update shows old beside new."""
    monkeypatch.setattr("testbed.golden.golden.fly_all", fly_two)
    samples.write(tmp_path, "exact")
    path = tmp_path / "golden" / "exact.json"
    write_schema_2(folder, path)
    done = check_here("exact.yaml", cwd=tmp_path)
    assert " exact.yaml · passed · " in done.stdout and "scenario changed" not in done.stdout
    assert (
        "   the table is of schema 2\n   metric a_metric_that_is_gone is missing\n" in done.stdout
    )

    samples.write(tmp_path, "exact", "controller: {gain_scale: 1.01}")
    write_schema_2(folder, path, min_separation_m=4.0)
    done = check_here("exact.yaml", cwd=tmp_path, code=REGRESSION)
    assert "the scenario changed: controller.gain_scale is now 1.01" in done.stdout
    assert re.search(r"minimum separation, m +4\.000 +\d\.\d+ +\+\d+\.\d % better", done.stdout)
    assert "code: the table is of a testbed whose code it does not state; this is" in done.stdout
    done = check_here("exact.yaml", "--update", "--reason", "new", cwd=tmp_path)
    assert "exact.yaml · differs · " in done.stdout and "minimum separation, m  " in done.stdout
    assert "ignored" not in done.stdout
    assert json.loads(path.read_text())["schema"] == 3
    check_here("exact.yaml", cwd=tmp_path)


def test_check_that_differs_names_the_code(folder, tmp_path, monkeypatch, fly_two):
    """The table of a test has the code of the product; one of other code passes without a word."""
    monkeypatch.setattr("testbed.golden.golden.fly_all", fly_two)
    samples.write(tmp_path, "exact")
    path = tmp_path / "golden" / "exact.json"
    path.parent.mkdir()
    own = (folder / "golden/exact.json").read_text()
    assert f'"code": "{describe_code()}"' in own and re.search(r"code [0-9a-f]{12}", own)
    other = own.replace(describe_code(), "testbed 0.0.9, code 0123456789ab")
    path.write_text(other)
    assert "code" not in check_here("exact.yaml", cwd=tmp_path).stdout
    table = json.loads(other)
    table["rows"]["min_separation_m"]["by_seed"] = [4.0, 4.0]
    path.write_text(json.dumps(table))
    done = check_here("exact.yaml", cwd=tmp_path, code=REGRESSION)
    line = f"code: the table is of testbed 0.0.9, code 0123456789ab; this is {describe_code()}"
    assert line in done.stdout
    path.write_text(json.dumps(table | {"code": describe_code()}))
    assert "code" not in check_here("exact.yaml", cwd=tmp_path, code=REGRESSION).stdout


def test_update_outside_the_bounds_writes_no_table(tmp_path, monkeypatch):
    """Else the next check would fail. Both remedies that are named write the table."""

    flown = {}

    def fly_once(wanted, **options):  # the same for every seed, and each time
        for scenario, _ in wanted[:1]:
            text = dump(scenario)
            flown[text] = flown.get(text) or fly_all(wanted[:1], **options)[0]
        return [GoldenFlight(seed, flown[text].metrics) for _, seed in wanted]

    monkeypatch.setattr("testbed.golden.golden.fly_all", fly_once)
    place = "exact.yaml:13:34: expect.min_separation_m.min: "
    samples.write(tmp_path, "exact", "expect: {min_separation_m: {min: 50}}")
    update = ("exact.yaml", "--update", "--reason", "first")
    done = check_here(*update, cwd=tmp_path, code=REGRESSION)
    assert "exact.yaml · NOT WRITTEN" in done.stdout
    assert f"{place}seeds 1, 2, " in done.stdout and "below 50 m" in done.stdout
    assert "correct the bound in expect, or the scenario; --ignore-bounds writes" in done.stdout
    assert not (tmp_path / "golden").exists()

    done = check_here(*update, "--ignore-bounds", cwd=tmp_path)
    assert " · written · " in done.stdout and f"{place}seeds 1, 2, " in done.stdout
    written = (tmp_path / "golden/exact.json").read_text()
    done = check_here("exact.yaml", cwd=tmp_path, code=REGRESSION)
    assert "--update" not in done.stdout  # which would write no table
    done = check_here(*update, cwd=tmp_path, code=REGRESSION)  # beside the table that there is
    assert "NOT WRITTEN" in done.stdout and f"{place}seeds 1, 2, " in done.stdout
    assert (tmp_path / "golden/exact.json").read_text() == written

    samples.write(tmp_path, "exact", "expect: {min_separation_m: {min: 2}}")
    assert " · written · " in check_here(*update, cwd=tmp_path).stdout
    check_here("exact.yaml", cwd=tmp_path)
    done = check_here("exact.yaml", "--ignore-bounds", cwd=tmp_path, code=BAD_INPUT)
    assert done.stderr == "error: --ignore-bounds: is of --update; write --update too\n"


@in_full  # of the page alone: bounds of a run are tested in other packages
def test_first_example_of_the_docs_is_in_its_bounds(tmp_path):
    """And the number beside a narrower bound is that of its command."""
    page = (ROOT / "docs/ci.md").read_text()
    (tmp_path / "my").mkdir()
    text = page.partition('```yaml title="my/wide.yaml"\n')[2].partition("```")[0]
    (tmp_path / "my/wide.yaml").write_text(text)
    shown = re.search(r"^\$ testbed (run my/wide\.yaml .*)\n(.*)\n", page, re.MULTILINE)
    done = call_command(*shown[1].split(), cwd=tmp_path, code=REGRESSION, columns=100)
    assert done.stderr.splitlines()[-1] == shown[2]
    assert len(re.findall(r"^--set", done.stderr, re.MULTILINE)) == 1  # bounds of the file hold


@pytest.mark.parametrize("content", ["of mine\n", '{"schema": 2, "scenario": "exact", "seed": 1}'])
def test_update_replaces_no_other_file(tmp_path, monkeypatch, content):
    """A golden table, readable or not, is replaced; metrics.json and notes are not."""
    samples.write(tmp_path, "exact")
    (tmp_path / "exact.json").write_text(content)
    monkeypatch.setattr("testbed.golden.golden.fly_all", pytest.fail)
    words = ("exact.yaml", "--update", "--reason", "again", "--golden", ".")
    done = check_here(*words, cwd=tmp_path, code=BAD_INPUT)
    assert done.stderr.startswith("error: exact.json: is no golden table, so --update does not")
    assert (tmp_path / "exact.json").read_text() == content


@pytest.fixture(scope="module")
def fly_two():
    """In place of `fly_all`: one flight of the deterministic scenario for every seed."""
    flight = samples.fly(1)

    def fly(wanted, **_):
        return [GoldenFlight(seed, flight.metrics) for _, seed in wanted]

    return fly


def test_check_bad_input_exits_2(folder, tmp_path, monkeypatch):
    """Nothing is flown or written."""
    for name in ("exact", "noisy", "broken", "cut", "old", "short"):
        samples.write(tmp_path, name)
    bare = ROOT / "tests" / "data" / "scenarios" / "minimal.yaml"
    (tmp_path / "bare.yaml").write_bytes(bare.read_bytes())
    (tmp_path / "golden").mkdir()
    (tmp_path / "golden" / "exact.json").write_bytes((folder / "golden/exact.json").read_bytes())
    for name, content in UNREADABLE.items():
        path = tmp_path / "golden" / f"{name}.json"
        path.write_text(content(folder / "golden/exact.json"))
    monkeypatch.setattr("testbed.golden.golden.fly_all", pytest.fail)
    refuse_all("check", tmp_path)


def test_check_missing_table_is_an_error_in_junit(tmp_path):
    samples.write(tmp_path, "exact")
    options = ("--junit", "j.xml", "--annotations", "github")
    done = check_here("exact.yaml", *options, cwd=tmp_path, code=BAD_INPUT)
    assert "exact.yaml:1:1: there is no golden table golden/exact.json" in done.stderr
    (annotation,) = [line for line in done.stdout.splitlines() if line.startswith("::error ")]
    assert "exact.yaml,title=" in annotation and "line=1,col=1::" in annotation
    root = ElementTree.parse(tmp_path / "j.xml").getroot()
    assert (root.get("tests"), root.get("errors"), root.get("failures")) == ("1", "1", "0")


@pytest.mark.parametrize("count", [10, 11, 25])
def test_annotations_of_many_errors_are_counted(count):
    """GitHub shows ten of a step: the last has the number of those that are left out."""
    text = "\n".join(f"a.yaml:{line}:1: wrong" for line in range(1, count + 1))
    found = input_annotations(InputError(text))
    assert len(found) == MAX_ANNOTATIONS == 10
    shown = [each for each in found if each.place]
    assert [each.place.line for each in shown] == list(range(1, len(shown) + 1))
    left = [int(each.text.split(" more errors")[0]) for each in found if not each.place]
    assert len(shown) + sum(left) == count and len(left) == (count > 10)


def test_fly_all_exception_becomes_a_problem(tmp_path):
    """A scenario that cannot be built does not stop the others."""
    changes = ("formation.leader_gains.uav1=0", "formation.neighbour_gains.uav2.uav1=0")
    with in_this_process():
        flights = fly_all([(samples.scenario(*changes), 1), (samples.scenario(), 1)], jobs=1)
    assert flights[0].metrics is None
    assert "A + B is singular" in flights[0].problem
    assert flights[1].metrics["outcome"] == "completed"


def test_workflow_uploads_the_junit_of_the_check():
    workflow = yaml.safe_load((ROOT / ".github/workflows/check.yml").read_text())
    (job,) = workflow["jobs"].values()
    supported = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
    assert job["strategy"]["matrix"]["python"] == supported
    runs = [step["run"] for step in job["steps"] if "run" in step]
    (check_step,) = [each for each in runs if "testbed check" in each]
    (upload,) = [step for step in job["steps"] if "upload-artifact" in step.get("uses", "")]
    assert check_step.endswith(f"--junit {upload['with']['path']}")
