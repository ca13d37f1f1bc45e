"""Relative and one-sided tolerances of golden tables: better passes and is said."""

import io
import json
import math
from xml.etree import ElementTree as xml

import golden_scenarios as samples
import pytest
from commands import call_command
from rich.console import Console

from testbed.core.errors import InputError
from testbed.golden.golden_ci import to_junit, to_markdown
from testbed.golden.golden_compare import GoldenFlight, compare
from testbed.golden.golden_report import print_check, to_document, violation_line
from testbed.golden.golden_table import RULES, make_table
from testbed.golden.golden_tolerance import Tolerances, parse_tolerances
from testbed.metrics.document import finalise
from testbed.scenario import loads
from testbed.scenario.expect import TABLE_QUANTITIES

KEY = "rms_m/circles/uav2"
BAD_INPUT, DIFFERENT = 2, 3


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """A flight, its table and what decides its numbers."""
    flight = samples.fly(1)
    inputs = samples.inputs(folder=tmp_path_factory.mktemp("exact"))
    table = make_table(
        {1: flight.metrics, 2: flight.metrics},
        scenario="short",
        reason="first flights",
        random=False,
        inputs=inputs,
    )
    return flight, table, inputs


def judged(exact, factor, *, options=(), expect="{}"):
    """Compare a flight whose number `KEY` is changed by a factor."""
    flight, table, inputs = exact
    golden = table.rows[KEY].by_seed[0]
    parts = loads(f"extends: simulation-3\nexpect: {expect}\nscenario: {{published: null}}\n")

    def edit(metrics):
        metrics["windows"]["circles"]["rms_m"]["uav2"] = golden * factor

    changed = samples.edited(flight, edit)
    tolerances = Tolerances(parse_tolerances(options), parts.expect.model_dump())
    flights = [changed, GoldenFlight(2, changed.metrics)]
    return compare("short", table, flights, inputs=inputs, tolerances=tolerances)


@pytest.mark.parametrize(
    "tolerances",
    [
        {"options": ["5%"]},
        {"options": ["rms_m=5%", "1%"]},
        {"expect": "{rms_m: {not_above: 5%}}"},
        {"expect": "{rms_m: {not_above: 0%, circles: {not_above: 5%}}}"},
        {"expect": "{rms_m: {circles: {not_above: 9%, uav2: {not_above: 5 %}}}}"},
        {"expect": "{rms_m: {uav2: {not_above: 5%}, circles: {not_above: 9%}}}"},
    ],
    ids=["all", "quantity", "file", "window", "both", "smaller"],
)
def test_number_may_be_worse_by_a_share(exact, tolerances):
    """And better by any: without the tolerance both fail."""
    assert judged(exact, 1.049, **tolerances).passed
    worse = judged(exact, 1.051, **tolerances)
    (violation,) = worse.violations
    assert violation.key == KEY and violation.deviation == pytest.approx(1.02, abs=1e-3)
    line = violation_line(violation, worse)
    assert "at most" in line and line.endswith("worse (1.0 x)")
    better = judged(exact, 0.5, **tolerances)
    assert better.passed and [row.key for row in better.improved] == [KEY]
    for factor in (1.049, 0.5):
        assert not judged(exact, factor).passed


def test_worse_side_keeps_its_tolerance(exact):
    """`not_below` of an error limits what is better, and the rule what is worse."""
    expect = "{rms_m: {not_below: 5%}}"
    assert judged(exact, 0.96, expect=expect).passed
    assert not judged(exact, 0.94, expect=expect).passed
    assert not judged(exact, 1.02, expect=expect).passed
    both = "{rms_m: {not_below: 5%, not_above: 10%}}"
    assert judged(exact, 1.09, expect=both).passed
    assert not judged(exact, 1.11, expect=both).passed
    assert not judged(exact, 0.94, expect=both).passed


def test_limits_of_each_direction():
    low, high = Tolerances({"": "10%"}).limits("min_separation_m", 5.0)
    assert (low, high) == (pytest.approx(4.5), math.inf)
    low, high = Tolerances({"joined_at_s": 2.0}).limits("joined_at_s/uav1", 10.0)
    assert (low, high) == (-math.inf, 12.0)
    low, high = Tolerances({"": "0%"}).limits("rms_m/laps/uav1", 1.0)
    assert high == pytest.approx(1.001)  # rounding stays inside
    band = Tolerances({"": "5%"}).limits("rms_m/laps/uav1", 1.0, 0.7, 1.3)
    assert band == (-math.inf, 1.3)
    below = Tolerances(expect={"rms_m": {"not_below": "5%"}})
    assert below.limits("rms_m/laps/uav1", 1.0, 0.7, 1.3) == (0.7, 1.3)  # the band is wider
    low, high = Tolerances({"": "10%"}).limits("min_separation_m", -5.0)
    assert (low, high) == (pytest.approx(-5.5), math.inf)  # a share of a negative number


def test_improvement_is_said_in_every_output(exact):
    verdict = judged(exact, 0.5, options=["5%"])
    console = Console(file=io.StringIO(), width=80)
    print_check([verdict], console)
    text = console.file.getvalue()
    assert "better: circles uav2 RMS error: " in text and "(-50.0 %)" in text
    assert "To keep what is better: testbed check short --update --reason TEXT" in text
    assert "1 passed: all flights are within their tolerances" in text
    (found,) = to_document([verdict])["scenarios"]
    assert found["improved"] == [KEY] and found["passed"]
    case = xml.fromstring(to_junit([verdict])).find(".//testcase[@name='circles uav2 RMS error']")
    assert case.find("failure") is None and case.findtext("system-out").startswith("better: ")
    markdown = to_markdown([verdict])
    assert "### Better than the golden table" in markdown
    assert "testbed check short --update --reason TEXT" in markdown
    for unchanged in (judged(exact, 1.0, options=["5%"]), judged(exact, 1.0)):
        assert not unchanged.improved and "Better than" not in to_markdown([unchanged])


def test_check_takes_a_tolerance(exact, tmp_path, monkeypatch):
    """From the command line to the annotation."""

    def fly_all(wanted, **_):
        return [GoldenFlight(seed, exact[0].metrics) for _, seed in wanted]

    monkeypatch.setattr("testbed.golden.golden.fly_all", fly_all)
    samples.write(tmp_path, "short")
    update = ("check", "short.yaml", "--update", "--reason", "first")
    call_command(*update, cwd=tmp_path, code=0, columns=80)
    path = tmp_path / "golden" / "short.json"
    table = json.loads(path.read_text())
    row = table["rows"][KEY]
    row["by_seed"] = [1.5 * each for each in row["by_seed"]]
    path.write_text(json.dumps(table))
    arguments = ("check", "short.yaml", "--annotations", "github", "--json", "c.json")
    call_command(*arguments, cwd=tmp_path, code=DIFFERENT, columns=80)
    done = call_command(*arguments, "--tolerance", "5%", cwd=tmp_path, code=0, columns=80)
    assert "::notice file=golden/short.json,title=short.yaml%3A golden table" in done.stdout
    assert json.loads((tmp_path / "c.json").read_text())["scenarios"][0]["improved"] == [KEY]
    row["by_seed"] = [each / 3.0 for each in row["by_seed"]]
    path.write_text(json.dumps(table))
    call_command(*arguments, "--tolerance", "5%", cwd=tmp_path, code=DIFFERENT, columns=80)
    call_command(*arguments, "--tolerance", "110%", cwd=tmp_path, code=0, columns=80)


@pytest.mark.parametrize(
    ("texts", "error"),
    [
        (["5"], "--tolerance 5: write 5% for all numbers, or QUANTITY=5%"),
        (["-5%"], "--tolerance -5%: write"),
        (["rms=5%"], "golden tables have no 'rms': did you mean 'rms_m'"),
        (["rms_m=x"], "--tolerance rms_m=x: write"),
        (["nan%"], "--tolerance nan%: write"),
        (["5%", "6%"], "--tolerance 6%: is the second one of its kind"),
    ],
)
def test_wrong_tolerance_names_the_remedy(texts, error):
    with pytest.raises(InputError) as found:
        parse_tolerances(texts)
    assert error in str(found.value)


@pytest.mark.parametrize(
    ("expect", "error"),
    [
        ("{rms_m: {not_above: 5}}", None),
        ("{rms_m: {not_above: five}}", "expect.rms_m.not_above: must be a number of 0 or more, or"),
        ("{rms_m: {not_above: -5%}}", "must be a number of 0 or more"),
        ("{max_error_m: {not_above: 5%}}", "expect.max_error_m: is in no golden table"),
        ("{rms_m: {circle: {not_above: 5%}}}", "did you mean 'circles'?"),
    ],
)
def test_tolerance_in_expect_is_checked(expect, error):
    text = f"extends: simulation-3\nexpect: {expect}\n"
    if error is None:
        loads(text)
        return
    with pytest.raises(InputError) as found:
        loads(text)
    assert error in str(found.value)


def test_flight_alone_is_not_compared_with_a_table(exact):
    """A run has no golden table; only min and max are in its metrics."""
    document = exact[0].metrics
    more = {"network": None, "external": {}, "outcome": "completed", "wall_s": 1.0}
    assert "expect" not in finalise(document, **more, expect={"rms_m": {"not_above": "5%"}})
    both = {"rms_m": {"not_above": "5%", "max": 9.0}}
    assert finalise(document, **more, expect=both)["expect"]["checked"] == 6


def test_quantities_of_expect_are_in_tables():
    assert set(TABLE_QUANTITIES) <= set(RULES)


def result(folder, name, measured, golden=1.0):
    rows = {
        KEY: {"passed": True, "measured": measured, "golden": golden},
        "min_separation_m": {"passed": True, "measured": 6.0, "golden": 6.0},
    }
    document = {"schema": 2, "scenarios": [{"scenario": "short", "rows": rows}]}
    (folder / f"{name}.json").write_text(json.dumps(document))


def test_trend_of_kept_results(tmp_path):
    """In order of their names; the change from the first to the last."""
    (folder := tmp_path / "kept").mkdir()
    for name, value in (("3-ccc", 1.2), ("1-aaa", 1.0), ("2-bbb", None), ("4-ddd", 0.9)):
        result(folder, name, value)
    arguments = ("check", "--trend", "kept")
    done = call_command(*arguments, "--figures", "drawn", cwd=tmp_path, code=0, columns=100)
    assert "circles uav2 RMS error, m" in done.stdout and "-10.0 %  better" in done.stdout
    assert "minimum separation, m" in done.stdout and "+0.0 %" in done.stdout
    drawn = sorted(each.name for each in (tmp_path / "drawn").glob("*.png"))
    assert drawn == ["short-RMS-error-m.png", "short-minimum-separation-m.png"]
    done = call_command(*arguments, "--json", cwd=tmp_path, code=0, columns=100)
    found = json.loads(done.stdout)
    assert found["files"] == ["1-aaa", "2-bbb", "3-ccc", "4-ddd"]
    assert found["scenarios"]["short"][KEY]["measured"] == [1.0, None, 1.2, 0.9]
    assert found["scenarios"]["short"][KEY]["change_percent"] == pytest.approx(-10.0)


def test_trend_refuses_what_it_cannot_read(tmp_path):
    (folder := tmp_path / "kept").mkdir()

    def refused(*more):
        done = call_command("check", *more, cwd=tmp_path, code=BAD_INPUT, columns=200)
        return done.stderr

    assert "has 0 files *.json" in refused("--trend", "kept")
    assert "there is no such folder" in refused("--trend", "gone")
    assert "--figures: are of --trend" in refused("--figures", "drawn")
    result(folder, "1-aaa", 1.0)
    assert "--seeds: --trend flies nothing" in refused("--trend", "kept", "--seeds", "2")
    assert "long: is in no file of kept" in refused("--trend", "kept", "long")
    for wrong in ("{}", "[", '{"schema": 2}', '{"schema": 2, "scenarios": [{"rows": 3}]}'):
        (folder / "2-bbb.json").write_text(wrong)
        assert "2-bbb.json: is not a result of testbed check" in refused("--trend", "kept")
    result(folder, "2-bbb", "1.0")
    assert "measured is not a number" in refused("--trend", "kept")
