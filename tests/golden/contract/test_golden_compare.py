"""Golden tables: what a comparison finds, and what a table stores."""

import copy
import io
import json
import shutil
import statistics
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import golden_scenarios as samples
import pytest
from rich.console import Console

from testbed.core.errors import InputError
from testbed.golden import golden
from testbed.golden.golden_ci import to_junit
from testbed.golden.golden_compare import GoldenFlight, compare
from testbed.golden.golden_report import print_check, print_updates, violation_line
from testbed.golden.golden_table import (
    FALSE_ALARM,
    RULES,
    make_table,
    read_table,
    table_numbers,
    write_table,
)
from testbed.plan.scenario_files import file_digests, referents
from testbed.pool.scenario_snapshot import (
    differences,
    key_digests,
    read_inputs,
    scenario_differences,
)
from testbed.scenario import find_aircraft, load_scenario

NOISY_SEEDS = (1, 2, 3, 4, 5, 6)


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """A deterministic flight, its table, and the description of its scenario."""
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


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Flights with sensor noise by seed, their table, and the description of their scenario."""
    flights = {seed: samples.fly(seed, noisy=True) for seed in NOISY_SEEDS}
    inputs = samples.inputs(noisy=True, folder=tmp_path_factory.mktemp("noisy"))
    table = make_table(
        {seed: flight.metrics for seed, flight in flights.items()},
        scenario="short",
        reason="first flights",
        random=True,
        inputs=inputs,
    )
    return flights, table, inputs


def compare_edited(fixture, edit, *, seed=1):
    flight, table, inputs = fixture
    return compare("short", table, [samples.edited(flight, edit, seed=seed)], inputs=inputs)


def texts(verdict):
    return [str(problem) for problem in verdict.problems]


def unchanged(metrics):
    pass


def printed(show, *arguments):
    console = Console(file=io.StringIO(), width=80)
    show(*arguments, console)
    return console.file.getvalue()


def test_compare_same_flight_passes(exact):
    verdict = compare_edited(exact, unchanged)
    assert verdict.passed
    assert verdict.changes == verdict.versions == verdict.notes == ()
    assert all(row.golden == pytest.approx(row.measured, abs=1e-8) for row in verdict.rows)


def test_compare_more_than_a_millimetre_fails(exact):
    def by(step):
        def edit(metrics):
            metrics["windows"]["circles"]["rms_m"]["uav2"] += step

        return edit

    assert exact[0].metrics["windows"]["circles"]["rms_m"]["uav2"] > 0.1
    assert compare_edited(exact, by(0.999e-3)).passed
    assert compare_edited(exact, by(-0.999e-3)).passed
    worse, better = compare_edited(exact, by(1.1e-3)), compare_edited(exact, by(-1.1e-3))
    for verdict, word in ((worse, "worse"), (better, "better")):
        assert not verdict.passed
        (violation,) = verdict.violations
        assert violation.key == "rms_m/circles/uav2"
        assert violation.deviation == pytest.approx(1.1, abs=0.01)
        assert violation_line(violation, verdict).endswith(f"{word} (1.1 x)")


def test_rule_small_numbers_have_relative_tolerance():
    rule = RULES["rms_m"]
    assert rule.allowed(2e-3) == pytest.approx(2e-5)
    assert rule.allowed(1e-9) == 1e-6
    assert rule.allowed(5.0) == 1e-3
    assert RULES["joined_at_s"].allowed(0.0) == 0.2


def drop(*path):
    def edit(metrics):
        part = metrics
        for name in path[:-1]:
            part = part[name]
        del part[path[-1]]

    return edit


def without_follower(metrics):
    for window in metrics["windows"].values():
        del window["rms_m"]["uav2"]
    for part in ("joined_at_s", "saturations"):
        del metrics[part]["uav2"]


def with_window(metrics):
    metrics["windows"]["squares"] = metrics["windows"]["circles"]


def with_follower(metrics):
    for window in metrics["windows"].values():
        window["rms_m"]["uav4"] = 0.1


def never_joined(metrics):
    metrics["joined_at_s"]["uav3"] = None


def lost(metrics):
    event = {"time_s": 3.0, "level": "error", "source": "uav2", "text": "lost: on the ground"}
    metrics.update(outcome="lost", simulated_s=3.0, events=[event])


def incomplete(metrics):
    metrics["windows"]["circles"].update(complete=False, covered_s=4.0)


@pytest.mark.parametrize(
    ("edit", "problems"),
    [
        (drop("windows", "circles"), ["window circles is missing"]),
        (with_window, ["window squares is new"]),
        (without_follower, ["follower uav2 is missing"]),
        (with_follower, ["follower uav4 is new"]),
        (drop("saturations", "uav1"), ["number saturated_s/uav1 is missing"]),
        (drop("leader_bank_deg"), ["metric leader_bank_deg is missing"]),
        (never_joined, ["seed 1: never reached its slot: uav3"]),
        (lost, ["seed 1: lost at 3 s; uav2: lost: on the ground"]),
        (incomplete, ["seed 1: window circles covers 4 s of 6 s"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_compare_structure_fails_before_numbers(exact, edit, problems):
    verdict = compare_edited(exact, edit)
    assert not verdict.passed
    assert texts(verdict) == problems
    assert verdict.violations == []
    assert problems[0] in printed(print_check, [verdict])


def test_compare_new_metric_is_a_note(exact):
    verdict = compare_edited(exact, lambda metrics: metrics.update(fuel_kg=1.0))
    assert verdict.passed
    assert verdict.notes == ("metric fuel_kg is new",)


def test_compare_failed_flight_is_a_problem(exact):
    _, table, inputs = exact
    verdict = compare(
        "short", table, [GoldenFlight(7, None, "failed: ValueError: no")], inputs=inputs
    )
    assert texts(verdict) == ["seed 7: failed: ValueError: no"]
    assert not verdict.passed


def test_compare_random_numbers_are_a_problem(exact):
    """The table is of a scenario whose numbers do not depend on the seed."""
    flight, table, inputs = exact

    def edit(metrics):
        metrics["min_separation_m"] += 1e-9

    flights = [flight, samples.edited(flight, edit, seed=2)]
    verdict = compare("short", table, flights, inputs=inputs)
    assert texts(verdict) == [
        "the seed changes the numbers, which it did not when the table was made"
    ]


def test_compare_changed_scenario_lists_keys(exact, tmp_path):
    flight, table, _ = exact
    changes = ("formation.k=2.5", "leader.path.airspeed_mps=23", "scenario.seed=9")
    verdict = compare("short", table, [flight], inputs=samples.inputs(*changes, folder=tmp_path))
    assert verdict.passed  # only numbers decide
    assert set(verdict.changes) == {
        "formation.k is now 2.5",
        "leader.path.airspeed_mps is now 23",
    }
    assert differences({"a": {"b": 1}, "c": 2}, {"a": {"b": [1, 2]}, "d": 0.5}) == (
        "a.b from 1 to [1, 2]",
        "c 2 is removed",
        "d 0.5 is new",
    )
    assert differences({"question": "why"}, {"question": ""}) == ('question from why to ""',)


def test_compare_changed_file_is_listed(exact):
    """Of a file with values every changed key; of a table without values only the file."""
    flight, table, inputs = exact
    gains, model = "rascal110/middle_loop.yaml", "rascal110/rascal110.xml"
    changed = {**inputs.files, gains: "0123456789ab", model: "0123456789ab"}
    assert inputs.values[gains]["tuned"]["course"]["p"] == 3.48
    assert inputs.values["rascal110/autopilot.param"]["TRIM_THROTTLE"] > 0

    def changes(table, edit):
        values = copy.deepcopy(inputs.values)
        edit(values[gains])
        edited = replace(inputs, files=changed, values=values)
        return set(compare("short", table, [flight], inputs=edited).changes)

    def edit_gains(profiles):
        profiles["tuned"]["course"]["p"] = 2.5
        del profiles["rms"]["course"]
        profiles["new"] = {"eta_speed": 0.1}

    whole = f"file {model} changed"
    assert changes(table, edit_gains) == {
        whole,
        f"{gains}: tuned.course.p is now 2.5",
        f"{gains}: new.eta_speed 0.1 is new",
        f"{gains}: 3 keys removed",
    }
    assert changes(table, dict) == {whole, f"file {gains} changed, but no value in it"}
    older = table.model_copy(update={"value_digests": {}})
    assert changes(older, edit_gains) == {whole, f"file {gains} changed"}


def test_file_digests_airframe_without_caches(tmp_path):
    """Every file of an airframe's folder counts, except caches and hidden files."""
    x8 = tmp_path / "x8"
    shutil.copytree(find_aircraft("skywalker_x8"), x8)
    (x8 / "skywalker_x8.xml").rename(x8 / "x8.xml")
    chosen = samples.scenario(f"fleet.uav2.aircraft={x8}", "controller.profile=tuned")
    before = file_digests(referents(chosen))
    assert {"x8/x8.xml", "x8/Engines/x8_motor.xml", "x8/Systems/battery.xml"} <= set(before)
    assert "rascal110/Engines/rascal110_motor.xml" in before

    for cache in ("__pycache__", ".cache"):
        (x8 / "Systems" / cache).mkdir()
        (x8 / "Systems" / cache / "battery.xml").write_text("<other/>")
    assert file_digests(referents(chosen)) == before
    battery = x8 / "Systems" / "battery.xml"
    battery.write_bytes(battery.read_bytes() + b"\n")
    after = file_digests(referents(chosen))
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"x8/Systems/battery.xml"}


@pytest.mark.parametrize("edit", [lost, never_joined, incomplete])
def test_update_invalid_flight_writes_no_table(exact, tmp_path, monkeypatch, edit):
    samples.write(tmp_path, "exact")
    monkeypatch.chdir(tmp_path)
    results = [samples.edited(exact[0], unchanged), samples.edited(exact[0], edit, seed=2)]
    monkeypatch.setattr(golden, "fly_all", lambda wanted, **_: results if wanted else [])
    cases = golden.find_cases(["exact.yaml"], folder=None, new=True)
    options = {"seeds": None, "jobs": 1, "progress": lambda done, total: None}
    (update,) = golden.update_tables(cases, reason="because", **options)
    assert update.table is None
    assert [problem.seed for problem in update.problems] == [2]
    assert samples.files(tmp_path).keys() == {"exact.yaml"}
    assert "NOT WRITTEN" in printed(print_updates, [update])


# seeds


def test_compare_each_seed_has_its_own_number(noisy):
    flights, table, inputs = noisy
    assert compare("short", table, list(flights.values()), inputs=inputs).passed
    swapped = [GoldenFlight(1, flights[2].metrics), GoldenFlight(2, flights[1].metrics)]
    verdict = compare("short", table, swapped, inputs=inputs)
    assert not verdict.passed
    assert {each.seeds for each in verdict.violations} == {(1,), (2,)}
    # the means are the same, and inside the band
    rows = [row for row in verdict.rows if row.band]
    assert all(
        row.measured == pytest.approx(row.golden, abs=1e-8) and row.inside_band for row in rows
    )


def test_compare_small_change_is_found_under_noise(noisy):
    """Seed by seed, although the numbers spread over seeds by several times the change."""
    _, table, inputs = noisy
    changed = samples.fly(1, "controller.gain_scale=0.97", noisy=True)
    verdict = compare("short", table, [changed], inputs=inputs)
    row = next(row for row in verdict.rows if row.key == "mean_rms_m/circles")
    assert 0.002 < abs(row.measured / row.golden - 1.0) < 0.05
    assert row.violations
    values = table.rows["mean_rms_m/circles"].by_seed
    assert statistics.stdev(values) > 3.0 * abs(row.measured - row.golden)


def test_compare_new_seeds_are_held_to_the_band(noisy):
    """One by one, and in the mean."""
    flights, table, inputs = noisy
    key = "rms_m/circles/uav1"
    values = table.rows[key].by_seed
    low, high = table.rows[key].band
    assert low <= min(values) and max(values) < high

    def verdict(numbers):
        def edit_to(value):
            def edit(metrics):
                metrics["windows"]["circles"]["rms_m"]["uav1"] = value

            return edit

        results = [
            samples.edited(flights[1], edit_to(number), seed=100 + k)
            for k, number in enumerate(numbers)
        ]
        return compare("short", table, results, inputs=inputs)

    assert verdict([statistics.fmean(values)]).passed
    (violation,) = verdict([1.01 * high]).violations
    assert (violation.key, violation.seeds) == (key, (100,))
    # each is inside, their mean is not
    violations = verdict([0.98 * high] * 8).violations
    assert [each.seeds for each in violations] == [tuple(range(100, 108))]


# files


def test_table_is_read_back_with_a_line_per_row(noisy, tmp_path):
    _, table, _ = noisy
    path = tmp_path / "golden" / "short.json"
    write_table(path, table)
    assert read_table(path) == table
    assert [each.name for each in path.parent.iterdir()] == ["short.json"]
    lines = [line.strip() for line in path.read_text().splitlines()]
    assert sum(line.startswith('"rms_m/circles/') for line in lines) == 3
    assert json.loads(path.read_text())["reason"] == "first flights"
    with pytest.raises(InputError, match="cannot be written"):
        write_table(path / "below" / "short.json", table)


def test_table_has_all_numbers_and_versions(exact):
    flight, table, _ = exact
    assert set(table.rows) == set(table_numbers(flight.metrics))
    assert table.rows["rms_m/circles/uav1"].band is None
    assert table.versions == flight.metrics["versions"]
    assert FALSE_ALARM * 200 * 5000 == pytest.approx(1.0)


def test_junit_counts_agree_for_any_text(exact):
    _, table, inputs = exact
    control_characters = GoldenFlight(1, None, "failed: \x1b[31mred\x07 & <none>")
    verdicts = [
        compare_edited(exact, never_joined),
        compare("a b", table, [control_characters], inputs=inputs),
    ]
    root = ElementTree.fromstring(to_junit(verdicts).encode())
    suites = root.findall("testsuite")
    assert [suite.get("name") for suite in suites] == ["short", "a b"]
    for suite in suites:
        cases = suite.findall("testcase")
        assert len(cases) == int(suite.get("tests")) == 1 + len(table.rows)
        assert len({case.get("name") for case in cases}) == len(cases)
        assert all(case.get("classname") and case.get("time") for case in cases)
        for count, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.get(count)) == len(suite.findall(f"testcase/{tag}"))
    for count in ("tests", "failures", "errors", "skipped"):
        assert int(root.get(count)) == sum(int(suite.get(count)) for suite in suites)
    assert "& <none>" in suites[1].find("testcase/failure").get("message")


@pytest.fixture(scope="module")
def stored():
    """Digests of Simulation 3, and a function that describes the changes by settings."""

    def inputs(*settings):
        return read_inputs(load_scenario("simulation-3", settings), Path())

    def changes(*settings, without=()):
        sections = {**inputs().scenario}
        for section, key in without:
            sections[section] = {k: v for k, v in sections[section].items() if k != key}
        digests = {name: key_digests(section) for name, section in sections.items()}
        return scenario_differences(digests, inputs(*settings))

    return changes


def test_new_keys_at_defaults_are_no_change(stored):
    """A scenario gains keys with later versions; digests of a table do not have them."""
    gained = [("network", "encoding"), ("leader", "autopilot"), ("limits", "on_loss")]
    assert stored(without=gained) == ()
    changed = stored("network.delay_s=0.5", without=gained)
    assert changed == ("network.delay_s is now 0.5",)
    found = stored("network.encoding=follow-target", without=gained)
    assert found == ("network.encoding follow-target is new",)


@pytest.mark.parametrize(
    ("settings", "lines"),
    [
        (["formation.k=3.0000001"], ["formation.k is now 3.0000001"]),
        (["leader.path.legs.0.laps=2"], ["leader.path.legs.0.laps is now 2"]),
        (["formation.neighbour_gains.uav3=null"], ["formation: 1 key removed"]),
        (
            ["network.loss={probability: 0.1}"],  # in place of null
            [
                "network.loss.probability 0.1 is new",
                "network.loss.correlation 0 is new",
                "network.loss.kind bernoulli is new",
                "network: 1 key removed",
            ],
        ),
    ],
)
def test_changed_keys_are_named_from_digests(stored, settings, lines):
    assert stored(*settings) == tuple(lines)


def test_value_back_at_its_default_is_named():
    """The digests are of other values than defaults; null stands for a removed map."""
    changes = ["network.delay_s=0.1", "network.loss={probability: 0.1}"]
    old = read_inputs(load_scenario("simulation-3", changes), Path()).scenario
    digests = {name: key_digests(section) for name, section in old.items()} | {"old": ""}
    found = scenario_differences(digests, read_inputs(load_scenario("simulation-3"), Path()))
    assert found == (
        "section old is removed",
        "network.delay_s is now 0",
        "network.loss null is new",
        "network: 3 keys removed",
    )
