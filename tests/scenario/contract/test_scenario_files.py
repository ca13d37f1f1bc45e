"""Scenario files that extend others, settings, and names of files."""

import pytest
from places import TESTS

from testbed.scenario import (
    ScenarioError,
    dump,
    find_aircraft,
    find_data,
    find_scenario,
    find_tune,
    list_aircraft,
    list_data,
    load_middle_loop,
    load_scenario,
    loads,
)

FOLDER = TESTS / "data" / "scenarios"
MINIMAL = FOLDER / "minimal.yaml"
FULL = FOLDER / "everything.yaml"


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def error_of(call, *arguments, **options):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **options)
    return str(caught.value)


def test_extends_merges_maps_and_replaces_the_rest(tmp_path):
    base = load_scenario(FULL)
    changed = load_scenario(
        write(
            tmp_path,
            "top.yaml",
            f"extends: {FULL}\n"
            "scenario: {name: top, windows: {turn: [15, 20]}}\n"
            "leader: {path: {legs: [{kind: waypoints, points_m: [[1, 2, 3]]}]}}\n"
            "formation: {leader_gains: {uav2: 3}, k: 1}\n",
        )
    )
    assert changed.name == "top"
    assert changed.scenario.windows == {"straight": (5.0, 10.0), "turn": (15.0, 20.0)}
    assert len(changed.leader.path.legs) == 1
    assert changed.leader.path.airspeed_mps == base.leader.path.airspeed_mps
    gains = {"uav1": (1.0, 1.0, 0.5), "uav2": (3.0, 3.0, 3.0)}
    assert changed.formation.leader_gains == gains
    assert (changed.formation.k, changed.formation.c) == (1.0, base.formation.c)
    assert changed.fleet == base.fleet


def test_renamed_scenario_does_not_inherit_question(tmp_path):
    keys = ("question", "expectation", "published")
    base = load_scenario("simulation-3").scenario
    same = load_scenario(
        write(tmp_path, "same.yaml", "extends: simulation-3\nrates: {log_hz: 50}\n")
    )
    again = "extends: simulation-3\nscenario: {name: simulation-3}\n"
    for kept in (same, load_scenario(write(tmp_path, "again.yaml", again))):
        assert [getattr(kept.scenario, key) for key in keys] == [getattr(base, key) for key in keys]
    other = "extends: simulation-3\nscenario: {name: other, published: null}\n"
    header = load_scenario(write(tmp_path, "other.yaml", other)).scenario
    assert [getattr(header, key) for key in keys] == ["", "", None]
    assert header.windows == base.windows
    below = "extends: other.yaml\nscenario: {name: below, question: Why?, published: {source: x}}\n"
    header = load_scenario(write(tmp_path, "below.yaml", below)).scenario
    assert (header.question, header.expectation) == ("Why?", "")
    assert header.published.source == "x" and not header.published.rms_m  # no part of another's


def test_inherited_window_beyond_the_end_is_an_error(tmp_path):
    short = "extends: simulation-3\nscenario:\n  name: short\n  duration_s: 600\n"
    keys = error_of(load_scenario, write(tmp_path, "short.yaml", short))
    assert "short.yaml:4:15: scenario.windows.circles: ends at 1080 s, after the run" in keys
    assert "inherited from" in keys and "write circles: null under windows" in keys
    named = short.replace("short", "simulation-3") + "  windows: {circles: null}\n"
    keys = error_of(load_scenario, write(tmp_path, "named.yaml", named))
    assert "published.rms_m.circles: no window has this name" in keys
    assert "write published: null under scenario" in keys
    keys = error_of(load_scenario, "simulation-3", ["scenario.duration_s=600"])
    assert "write --set scenario.windows.circles=null" in keys


def test_null_removes_a_key(tmp_path):
    top = write(
        tmp_path,
        "top.yaml",
        f"extends: {FULL}\n"
        "formation: {altitudes_m: null, agents: {uav1: {k: null}}, leader_gains: {uav1: null}}\n"
        "controller: {estimators: null}\n",
    )
    for changed in (
        load_scenario(top),
        load_scenario(
            FULL,
            [
                "formation.altitudes_m=null",
                "formation.agents.uav1.k=null",
                "formation.leader_gains.uav1=null",
                "controller.estimators=null",
            ],
        ),
    ):
        formation = changed.formation
        assert formation.altitudes_m == formation.leader_gains == {}
        assert (formation.agents["uav1"].k, formation.agents["uav1"].a) == (None, 0.8)
        assert set(changed.controller.estimators.model_dump().values()) == {None}
    assert "scenario.duration_s: is missing" in error_of(
        load_scenario, FULL, ["scenario.duration_s=null"]
    )
    assert load_scenario(FULL, ["formation.leader_gains.*=null"]).formation.leader_gains == {}


def test_map_of_other_kind_replaces_the_old(tmp_path):
    record = write(tmp_path, "flight.csv", "t_s\n")
    top = write(
        tmp_path,
        "top.yaml",
        f"extends: {FULL}\n"
        "leader: {path: {kind: replay, file: flight.csv}}\n"
        "formation: {barrier: {example: 7}}\n",
    )
    changed = load_scenario(top)
    assert changed.leader.path.file == str(record)
    assert changed.formation.barrier.example == 7


def test_error_names_the_file_of_the_value(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base = MINIMAL.read_text().replace("duration_s: 10", "duration_s: x")
    write(tmp_path, "below/base.yaml", base)
    write(tmp_path, "top.yaml", "extends: below/base.yaml\nscenario:\n  seed: y\n")
    lines = error_of(load_scenario, "top.yaml").splitlines()
    assert lines[0].startswith("below/base.yaml:2:50: scenario.duration_s: is 'x'")
    assert lines[1].startswith("top.yaml:3:9: scenario.seed: is 'y'")


def test_circular_extends_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, "a.yaml", "extends: b.yaml")
    write(tmp_path, "b.yaml", "extends: a.yaml")
    assert (
        error_of(load_scenario, "a.yaml")
        == "b.yaml:1:10: extends: 'a.yaml' extends this file in turn (write another scenario)"
    )


def test_circular_begin_is_refused(tmp_path, monkeypatch):
    """By `testbed validate` as before a flight; the remedy makes it valid."""
    monkeypatch.chdir(tmp_path)

    def begin(name, other):
        begins = f"begin: {{scenario: {other}, at_s: 1}}" if other else ""
        text = f"extends: simulation-3\nscenario:\n  name: {name}\n  {begins}\n"
        write(tmp_path, f"{name}.yaml", text)

    place, remedy = "yaml:4:21: scenario.begin.scenario: never begins:", "(remove scenario.begin"
    begin("r", "r.yaml")
    assert error_of(load_scenario, "r.yaml") == (
        f"r.{place} r.yaml begins with r.yaml {remedy} of one of them)"
    )
    begin("p", "q.yaml")
    begin("q", "p.yaml")
    assert error_of(load_scenario, "p.yaml") == (
        f"p.{place} q.yaml begins with p.yaml begins with q.yaml {remedy} of one of them)"
    )
    begin("q", None)
    assert load_scenario("p.yaml").scenario.begin.scenario == str(tmp_path / "q.yaml")
    setting = ["scenario.begin.scenario=q.yaml", "scenario.begin.at_s=2"]
    assert load_scenario("q.yaml", setting).scenario.begin.at_s == 2  # not a circle


def test_begins_are_a_chain_of_ten_at_most(tmp_path):
    for number in range(12):
        begin = f"begin: {{scenario: s{number - 1}.yaml, at_s: {number}}}" if number else ""
        text = f"extends: simulation-3\nscenario:\n  name: s{number}\n  {begin}\n"
        write(tmp_path, f"s{number}.yaml", text)
    assert load_scenario(tmp_path / "s10.yaml").scenario.begin
    assert "is a chain of more than 10 scenarios" in error_of(load_scenario, tmp_path / "s11.yaml")
    (tmp_path / "s3.yaml").unlink()
    text = error_of(load_scenario, tmp_path / "s5.yaml")
    assert text.startswith(f"{tmp_path}/s5.yaml:4:21: scenario.begin.scenario: ")
    assert f"s4.yaml cannot begin: s3.yaml: there is no file {tmp_path}/s3.yaml" in text


def test_unknown_base_is_refused_at_its_place():
    text = error_of(loads, "extends: simulation-33", source="case.yaml")
    assert text.startswith("case.yaml:1:10: extends: there is no scenario 'simulation-33': did you")
    text = error_of(loads, "extends: [a]", source="case.yaml")
    assert text == "case.yaml:1:10: extends: must be the name or the path of a scenario"


def test_relative_paths_start_at_their_file(tmp_path, monkeypatch):
    tune = write(tmp_path, "below/mine.param", "TRIM_THROTTLE,45\n")
    text = MINIMAL.read_text().replace("rascal110, start_m", "rascal110, tune: mine.param, start_m")
    write(tmp_path, "below/base.yaml", text)
    top = write(tmp_path, "top.yaml", "extends: below/base.yaml\n")
    monkeypatch.chdir("/")
    loaded = load_scenario(top)
    assert loaded.fleet[0].tune == str(tune)
    assert loads(dump(loaded)) == loaded


SETTINGS = [
    ("formation.k=2", lambda s: s.formation.k == 2.0),
    ("formation.leader_gains.uav1=[1, 1, 2]", lambda s: s.formation.leader_gains["uav1"][2] == 2.0),
    ("formation.leader_gains={uav2: 1}", lambda s: (*s.formation.leader_gains,) == ("uav2",)),
    ("formation.leader_gains.*=5", lambda s: s.formation.leader_gains == {"uav1": (5.0,) * 3}),
    ("fleet.1.start_m=[1, 2, 3]", lambda s: s.fleet[1].start_m == (1.0, 2.0, 3.0)),
    ("fleet.uav2.tune=autopilot", lambda s: [f.tune for f in s.fleet] == ["recorded", "autopilot"]),
    ("fleet.*.sensors=truth", lambda s: all(f.sensors.exact for f in s.fleet)),
    ("leader.path.legs.0.points_m.1.2=90", lambda s: s.leader.path.legs[0].points_m[1][2] == 90.0),
    ("scenario.question=a = b", lambda s: s.scenario.question == "a = b"),
    ("scenario.published=null", lambda s: s.scenario.published is None),
]


@pytest.mark.parametrize(("text", "holds"), SETTINGS)
def test_setting_changes_the_scenario(text, holds):
    assert not holds(load_scenario(FULL))
    assert holds(load_scenario(FULL, [text]))


def test_settings_are_applied_in_order():
    changed = load_scenario(
        MINIMAL, ["rates.log_hz=50", "rates.log_hz=10", "controller.gain_scale=0.67"]
    )
    assert changed.rates.log_hz == 10
    assert changed.controller.gain_scale == 0.67


def test_wildcard_over_nothing_is_refused():
    message = "--set formation.leader_gains.*=1: formation.leader_gains: is empty: * stands"
    assert error_of(load_scenario, MINIMAL, ["formation.leader_gains.*=1"]).startswith(message)


def test_names_are_found_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_scenario("simulation-3").is_file()
    assert "rascal110" in list_aircraft()
    home = find_aircraft("rascal110")
    assert (home / "rascal110.xml").is_file()
    assert find_tune("rascal110", "recorded") == home / "recorded.param"
    for name in list_data():
        assert find_data(name).name == name


def test_path_to_own_aircraft_is_resolved(tmp_path):
    home = write(tmp_path, "glider/glider.xml", "<fdm_config/>").parent
    write(home, "calm.param", "TRIM_THROTTLE,45\n")
    write(home, "middle_loop.yaml", (find_aircraft("rascal110") / "middle_loop.yaml").read_text())
    settings = [f"fleet.0.aircraft={home}", "fleet.0.tune=calm"]
    loaded = load_scenario(MINIMAL, settings)
    assert (loaded.fleet[0].aircraft, loaded.fleet[0].tune) == (str(home), "calm")
    assert loads(dump(loaded)) == loaded
    text = error_of(load_scenario, MINIMAL, [settings[0], "fleet.0.tune=clam"])
    assert "there is no tune of glider 'clam': did you mean 'calm'?" in text


def test_folder_without_model_is_no_aircraft(tmp_path):
    text = error_of(load_scenario, MINIMAL, [f"fleet.0.aircraft={tmp_path}"])
    assert f"{tmp_path} has no {tmp_path.name}.xml" in text


def test_missing_recording_lists_the_known_ones():
    text = error_of(load_scenario, MINIMAL, ["leader.path={kind: replay, file: lost.csv}"])
    assert "leader.path.file: there is no data file 'lost.csv' (write one of: " in text


def test_middle_loop_is_read_and_checked(tmp_path):
    authors = load_middle_loop("rascal110", "authors")
    assert (authors.course.p, authors.course.i, authors.course.d) == (1.0, 0.1, 0.2)
    assert (authors.limits.pitch_deg, authors.limits.roll_deg) == (20.0, 50.0)
    home = write(tmp_path, "glider/glider.xml", "<fdm_config/>").parent
    write(home, "middle_loop.yaml", "tuned:\n  course: {p: 1, q: 2}\n")
    text = error_of(load_middle_loop, home, "tuned")
    assert "middle_loop.yaml:2:18: tuned.course.q: is not a key of this section" in text
    assert "middle_loop.yaml:1:1: tuned.speed: is missing" in text
