"""Golden tables: what a comparison sees and says, and what a table keeps."""

import io
import json
import shutil
import statistics
from pathlib import Path
from xml.etree import ElementTree

import check_pages as pages
import pytest
from rich.console import Console

from testbed.errors import InputError
from testbed.scenario import find_aircraft, load
from testbed.study import golden
from testbed.study.flights import Flight
from testbed.study.golden_compare import compare
from testbed.study.golden_page import differences, digests, page_kept, spelt_out
from testbed.study.golden_table import (
    BAND,
    RULES,
    make_table,
    measure,
    read_table,
    write_table,
)
from testbed.study.golden_text import show_check, show_renewals
from testbed.study.golden_words import offence_line
from testbed.study.junit import to_junit

NOISY_SEEDS = (1, 2, 3, 4, 5, 6)


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """An exact flight and its table."""
    folder = tmp_path_factory.mktemp("exact")
    flight = pages.fly(1)
    around = pages.context(folder=folder)
    table = make_table(
        {1: flight.metrics, 2: flight.metrics},
        scenario="short",
        reason="first flights",
        random=False,
        **around,
    )
    return flight, table, around


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Flights with noise by seed, and their table."""
    folder = tmp_path_factory.mktemp("noisy")
    flights = {seed: pages.fly(seed, noisy=True) for seed in NOISY_SEEDS}
    around = pages.context(noisy=True, folder=folder)
    table = make_table(
        {seed: flight.metrics for seed, flight in flights.items()},
        scenario="short",
        reason="first flights",
        random=True,
        **around,
    )
    return flights, table, around


def judged(fixture, edit, *, seed=1):
    flight, table, around = fixture
    return compare("short", table, [pages.edited(flight, edit, seed=seed)], **around)


def texts(verdict):
    return [str(fault) for fault in verdict.faults]


def nothing(metrics):
    pass


def test_the_same_flight_passes(exact):
    verdict = judged(exact, nothing)
    assert verdict.passed
    assert verdict.changes == verdict.versions == verdict.notes == ()
    assert all(row.golden == pytest.approx(row.now, abs=1e-8) for row in verdict.rows)


def test_a_millimetre_passes_and_more_does_not(exact):
    def by(step):
        def edit(metrics):
            metrics["portions"]["circles"]["rms_m"]["uav2"] += step

        return edit

    assert exact[0].metrics["portions"]["circles"]["rms_m"]["uav2"] > 0.1
    assert judged(exact, by(0.999e-3)).passed
    assert judged(exact, by(-0.999e-3)).passed
    worse, better = judged(exact, by(1.1e-3)), judged(exact, by(-1.1e-3))
    for verdict, word in ((worse, "worse"), (better, "better")):
        assert not verdict.passed
        (offence,) = verdict.offences
        assert offence.key == "rms_m/circles/uav2"
        assert offence.outside == pytest.approx(1.1, abs=0.01)
        assert offence_line(offence, verdict).endswith(f"{word} (1.1 x)")


def test_a_small_error_is_held_to_a_hundredth_of_itself():
    rule = RULES["rms_m"]
    assert rule.allowed(2e-3) == pytest.approx(2e-5)
    assert rule.allowed(1e-9) == 1e-6
    assert rule.allowed(5.0) == 1e-3
    assert RULES["engaged_at_s"].allowed(0.0) == 0.2


def drop(*path):
    def edit(metrics):
        part = metrics
        for name in path[:-1]:
            part = part[name]
        del part[path[-1]]

    return edit


def without_follower(metrics):
    for portion in metrics["portions"].values():
        del portion["rms_m"]["uav2"]
    for part in ("engaged_at_s", "saturations"):
        del metrics[part]["uav2"]


def with_portion(metrics):
    metrics["portions"]["squares"] = metrics["portions"]["circles"]


def with_follower(metrics):
    for portion in metrics["portions"].values():
        portion["rms_m"]["uav4"] = 0.1


def never_engaged(metrics):
    metrics["engaged_at_s"]["uav3"] = None


def lost(metrics):
    event = {"time_s": 3.0, "level": "error", "source": "uav2", "text": "lost: on the ground"}
    metrics.update(outcome="lost", simulated_s=3.0, events=[event])


def add_a_metre(metrics):
    metrics["portions"]["circles"]["rms_m"]["uav2"] += 1.0


def uncovered(metrics):
    metrics["portions"]["circles"].update(complete=False, covered_s=4.0)


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (drop("portions", "circles"), ["portion circles is missing"]),
        (with_portion, ["portion squares is new"]),
        (without_follower, ["follower uav2 is missing"]),
        (with_follower, ["follower uav4 is new"]),
        (drop("saturations", "uav1"), ["number saturated_s/uav1 is missing"]),
        (drop("leader_bank_deg"), ["metric leader_bank_deg is missing"]),
        (never_engaged, ["seed 1: the formation never engaged: uav3"]),
        (lost, ["seed 1: lost at 3 s; uav2: lost: on the ground"]),
        (uncovered, ["seed 1: portion circles covers 4 s of 6 s"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_structure_fails_before_values(exact, edit, says):
    verdict = judged(exact, edit)
    assert not verdict.passed
    assert texts(verdict) == says
    assert verdict.offences == []
    console = Console(file=io.StringIO(), width=80)
    show_check([verdict], console)
    assert says[0] in console.file.getvalue()


def test_a_new_metric_is_noted_and_passes(exact):
    verdict = judged(exact, lambda metrics: metrics.update(fuel_kg=1.0))
    assert verdict.passed
    assert verdict.notes == ("metric fuel_kg is new",)


def test_a_flight_that_failed_is_named(exact):
    _, table, around = exact
    verdict = compare("short", table, [Flight(7, None, "failed: ValueError: no")], **around)
    assert texts(verdict) == ["seed 7: failed: ValueError: no"]
    assert not verdict.passed


def test_dice_in_a_table_without_are_a_fault(exact):
    flight, table, around = exact

    def edit(metrics):
        metrics["min_separation_m"] += 1e-9

    flights = [flight, pages.edited(flight, edit, seed=2)]
    verdict = compare("short", table, flights, **around)
    assert texts(verdict) == ["the seed moves the numbers, which it did not for the table"]


def test_what_changed_on_the_page_is_named(exact, tmp_path):
    flight, table, _ = exact
    changes = ("formation.k=2.5", "leader.path.airspeed_mps=23", "scenario.seed=9")
    verdict = compare("short", table, [flight], **pages.context(*changes, folder=tmp_path))
    assert verdict.passed  # the page is no gate
    assert set(verdict.changes) == {
        "formation.k from 3 to 2.5",
        "leader.path.airspeed_mps from 22 to 23",
    }
    assert differences({"a": {"b": 1}, "c": 2}, {"a": {"b": [1, 2]}, "d": 0.5}) == (
        "a.b from 1 to [1, 2]",
        "c 2 is gone",
        "d 0.5 is new",
    )


def test_a_file_that_changed_is_named(exact):
    flight, table, around = exact
    files = {**around["files"], "rascal110/middle_loop.yaml": "0123456789ab"}
    verdict = compare("short", table, [flight], page=around["page"], files=files)
    assert verdict.changes == ("file rascal110/middle_loop.yaml has another content",)


def test_a_file_anywhere_in_an_aircraft_counts_and_what_tools_leave_does_not(tmp_path):
    x8 = tmp_path / "x8"
    shutil.copytree(find_aircraft("skywalker_x8"), x8)
    (x8 / "skywalker_x8.xml").rename(x8 / "x8.xml")
    chosen = pages.page(f"fleet.uav2.aircraft={x8}", "controller.profile=paper")
    before = digests(chosen)
    assert {"x8/x8.xml", "x8/Engines/x8_motor.xml", "x8/Systems/battery.xml"} <= set(before)
    assert "rascal110/Engines/rascal110_motor.xml" in before

    for left in ("__pycache__", ".cache"):
        (x8 / "Systems" / left).mkdir()
        (x8 / "Systems" / left / "battery.xml").write_text("<other/>")
    assert digests(chosen) == before
    battery = x8 / "Systems" / "battery.xml"
    battery.write_bytes(battery.read_bytes() + b"\n")
    after = digests(chosen)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {"x8/Systems/battery.xml"}


def test_an_update_is_offered_for_flights_that_it_would_take(exact):
    def hints(*verdicts):
        console = Console(file=io.StringIO(), width=80)
        show_check(verdicts, console)
        return [line for line in console.file.getvalue().splitlines() if "--update" in line]

    moved, new = judged(exact, add_a_metre), judged(exact, with_portion)
    (hint,) = hints(moved)
    assert hint == " If this is meant: testbed check short --update --reason TEXT"
    assert hints(new) == [hint]
    for edit in (lost, never_engaged, uncovered):
        assert hints(judged(exact, edit)) == []
        assert hints(judged(exact, edit), moved) == [hint]


@pytest.mark.parametrize("edit", [lost, never_engaged, uncovered])
def test_a_flight_that_is_not_sound_is_never_made_golden(exact, tmp_path, monkeypatch, edit):
    pages.write(tmp_path, "exact")
    monkeypatch.chdir(tmp_path)
    flown = [pages.edited(exact[0], nothing), pages.edited(exact[0], edit, seed=2)]
    monkeypatch.setattr(golden, "fly_all", lambda wanted, **_: flown if wanted else [])
    cases = golden.find_cases(["exact.yaml"], folder=None, new=True)
    quiet = {"seeds": None, "jobs": 1, "progress": lambda flown, of: None}
    (renewal,) = golden.renew(cases, reason="because", **quiet)
    assert renewal.table is None
    assert [fault.seed for fault in renewal.faults] == [2]
    assert pages.files(tmp_path).keys() == {"exact.yaml"}
    console = Console(file=io.StringIO(), width=80)
    show_renewals([renewal], console)
    assert "NOT WRITTEN" in console.file.getvalue()


# seeds


def test_each_seed_is_held_to_its_own_number(noisy):
    flights, table, around = noisy
    assert compare("short", table, list(flights.values()), **around).passed
    swapped = [Flight(1, flights[2].metrics), Flight(2, flights[1].metrics)]
    verdict = compare("short", table, swapped, **around)
    assert not verdict.passed
    assert {each.seeds for each in verdict.offences} == {(1,), (2,)}
    # the two means are what they were, and the band would have let it pass
    rows = [row for row in verdict.rows if row.band]
    assert all(row.now == pytest.approx(row.golden, abs=1e-8) and row.inside_band for row in rows)


def test_a_creep_of_a_few_percent_is_seen_through_the_noise(noisy):
    """Seed by seed, although the spread over seeds is many times the creep."""
    _, table, around = noisy
    crept = pages.fly(1, "controller.gain_scale=0.97", noisy=True)
    verdict = compare("short", table, [crept], **around)
    row = next(row for row in verdict.rows if row.key == "mean_rms_m/circles")
    assert 0.002 < abs(row.now / row.golden - 1.0) < 0.05
    assert row.offences
    values = table.rows["mean_rms_m/circles"].by_seed
    assert statistics.stdev(values) > 3.0 * abs(row.now - row.golden)


def test_other_seeds_are_held_to_the_band_one_by_one_and_in_the_mean(noisy):
    flights, table, around = noisy
    key = "rms_m/circles/uav1"
    values = table.rows[key].by_seed
    low, high = table.rows[key].band
    assert low <= min(values) and max(values) < high

    def verdict(numbers):
        def edit_to(value):
            def edit(metrics):
                metrics["portions"]["circles"]["rms_m"]["uav1"] = value

            return edit

        made = [
            pages.edited(flights[1], edit_to(number), seed=100 + k)
            for k, number in enumerate(numbers)
        ]
        return compare("short", table, made, **around)

    assert verdict([statistics.fmean(values)]).passed
    (offence,) = verdict([1.01 * high]).offences
    assert (offence.key, offence.seeds) == (key, (100,))
    # each inside, all of them together not
    nearly = verdict([0.98 * high] * 8).offences
    assert [each.seeds for each in nearly] == [tuple(range(100, 108))]


# the files


def test_a_table_reads_back_and_a_row_is_a_line(noisy, tmp_path):
    _, table, _ = noisy
    path = tmp_path / "golden" / "short.json"
    write_table(path, table)
    assert read_table(path) == table
    assert [each.name for each in path.parent.iterdir()] == ["short.json"]
    lines = [line.strip() for line in path.read_text().splitlines()]
    assert sum(line.startswith('"rms_m/circles/') for line in lines) == 3
    assert json.loads(path.read_text())["reason"] == "first flights"
    assert all(rule["reason"] for rule in json.loads(path.read_text())["rules"].values())
    with pytest.raises(InputError, match="cannot be written"):
        write_table(path / "below" / "short.json", table)


def test_the_table_keeps_what_decides(exact):
    flight, table, _ = exact
    assert set(table.rows) == set(measure(flight.metrics))
    assert table.rows["rms_m/circles/uav1"].band is None
    assert table.versions == flight.metrics["versions"]
    assert BAND.false_alarm * 200 * 5000 == pytest.approx(1.0)


def test_junit_counts_and_survives_any_text(exact):
    _, table, around = exact
    bell = Flight(1, None, "failed: \x1b[31mred\x07 & <none>")
    verdicts = [judged(exact, never_engaged), compare("a b", table, [bell], **around)]
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


def test_keys_that_pages_have_had_since_are_no_change_at_their_defaults():
    kept = page_kept(load("simulation-3"), Path())
    older = json.loads(json.dumps(kept))
    del older["network"]["encoding"], older["leader"]["autopilot"], older["limits"]
    assert differences(older, kept)
    assert differences(spelt_out(older), kept) == ()
    changed = load("simulation-3", ["network.delay_s=0.5"])
    told = differences(spelt_out(older), page_kept(changed, Path()))
    assert told == ("network.delay_s from 0 to 0.5",)
    stranger = {**older, "extinct": 1}
    assert spelt_out(stranger) == stranger
