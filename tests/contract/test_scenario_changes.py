"""Pages that change other pages, changes from the command line, and what a name finds."""

from pathlib import Path

import pytest

from testbed.scenario import (
    ScenarioError,
    dump,
    find_aircraft,
    find_data,
    find_scenario,
    find_tune,
    list_aircraft,
    list_data,
    list_scenarios,
    load,
    load_middle_loop,
    loads,
)

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
MINIMAL = PAGES / "minimal.yaml"
FULL = PAGES / "everything.yaml"


def page(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def refusal(call, *arguments, **options):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **options)
    return str(caught.value)


def test_maps_merge_deeply_and_lists_and_scalars_replace(tmp_path):
    base = load(FULL)
    changed = load(
        page(
            tmp_path,
            "top.yaml",
            f"extends: {FULL}\n"
            "scenario: {name: top, portions: {turn: [15, 20]}}\n"
            "leader: {path: {legs: [{kind: waypoints, points_m: [[1, 2, 3]]}]}}\n"
            "formation: {leader_gains: {uav2: 3}, k: 1}\n",
        )
    )
    assert changed.name == "top"
    assert changed.scenario.portions == {"straight": (5.0, 10.0), "turn": (15.0, 20.0)}
    assert len(changed.leader.path.legs) == 1
    assert changed.leader.path.airspeed_mps == base.leader.path.airspeed_mps
    gains = {"uav1": (1.0, 1.0, 0.5), "uav2": (3.0, 3.0, 3.0)}
    assert changed.formation.leader_gains == gains
    assert (changed.formation.k, changed.formation.c) == (1.0, base.formation.c)
    assert changed.fleet == base.fleet


def test_what_is_true_of_a_name_is_not_of_another(tmp_path):
    said = ("question", "expectation", "published")
    base = load("simulation-3").scenario
    same = load(page(tmp_path, "same.yaml", "extends: simulation-3\nrates: {log_hz: 50}\n"))
    again = "extends: simulation-3\nscenario: {name: simulation-3}\n"
    for kept in (same, load(page(tmp_path, "again.yaml", again))):
        assert [getattr(kept.scenario, key) for key in said] == [getattr(base, key) for key in said]
    other = "extends: simulation-3\nscenario: {name: other, published: null}\n"
    header = load(page(tmp_path, "other.yaml", other)).scenario
    assert [getattr(header, key) for key in said] == ["", "", None]
    assert header.portions == base.portions
    below = "extends: other.yaml\nscenario: {name: below, question: Why?, published: {source: x}}\n"
    header = load(page(tmp_path, "below.yaml", below)).scenario
    assert (header.question, header.expectation) == ("Why?", "")
    assert header.published.source == "x" and not header.published.rms_m  # no part of another's


def test_a_portion_of_another_page_is_wrong_where_this_one_is_shorter(tmp_path):
    short = "extends: simulation-3\nscenario:\n  name: short\n  duration_s: 600\n"
    said = refusal(load, page(tmp_path, "short.yaml", short))
    assert "short.yaml:4:15: scenario.portions.circles: ends at 1080 s, after the run" in said
    assert "inherited from" in said and "write circles: null under portions" in said
    named = short.replace("short", "simulation-3") + "  portions: {circles: null}\n"
    said = refusal(load, page(tmp_path, "named.yaml", named))
    assert "published.rms_m.circles: no portion has this name" in said
    assert "write published: null under scenario" in said
    said = refusal(load, "simulation-3", ["scenario.duration_s=600"])
    assert "write --set scenario.portions.circles=null" in said


@pytest.mark.parametrize("name", list_scenarios())
def test_every_scenario_says_what_it_asks_and_expects(name):
    header = load(name).scenario
    assert header.question.endswith("?") and header.expectation


def test_null_takes_a_key_away(tmp_path):
    top = page(
        tmp_path,
        "top.yaml",
        f"extends: {FULL}\n"
        "formation: {altitudes_m: null, agents: {uav1: {k: null}}, leader_gains: {uav1: null}}\n"
        "controller: {estimators: null}\n",
    )
    for changed in (
        load(top),
        load(
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
    assert "scenario.duration_s: is missing" in refusal(load, FULL, ["scenario.duration_s=null"])
    assert load(FULL, ["formation.leader_gains.*=null"]).formation.leader_gains == {}


def test_a_map_of_another_kind_replaces_the_old_one(tmp_path):
    record = page(tmp_path, "flight.csv", "t_s\n")
    top = page(
        tmp_path,
        "top.yaml",
        f"extends: {FULL}\n"
        "leader: {path: {kind: replay, file: flight.csv}}\n"
        "formation: {barrier: {example: 7}}\n",
    )
    changed = load(top)
    assert changed.leader.path.file == str(record)
    assert changed.formation.barrier.example == 7


def test_an_error_names_the_page_it_stands_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base = MINIMAL.read_text().replace("duration_s: 10", "duration_s: x")
    page(tmp_path, "below/base.yaml", base)
    page(tmp_path, "top.yaml", "extends: below/base.yaml\nscenario:\n  seed: y\n")
    lines = refusal(load, "top.yaml").splitlines()
    assert lines[0].startswith("below/base.yaml:2:50: scenario.duration_s: is 'x'")
    assert lines[1].startswith("top.yaml:3:9: scenario.seed: is 'y'")


def test_a_page_that_extends_itself_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page(tmp_path, "a.yaml", "extends: b.yaml")
    page(tmp_path, "b.yaml", "extends: a.yaml")
    assert refusal(load, "a.yaml") == "b.yaml:1:10: extends: 'a.yaml' extends this page in turn"


def test_an_unknown_base_is_refused_at_its_place():
    text = refusal(loads, "extends: simulation-33", source="page.yaml")
    assert text.startswith("page.yaml:1:10: extends: there is no scenario 'simulation-33': did you")
    text = refusal(loads, "extends: [a]", source="page.yaml")
    assert text == "page.yaml:1:10: extends: must be the name or the path of a scenario"


def test_relative_paths_count_from_the_page_that_writes_them(tmp_path, monkeypatch):
    tune = page(tmp_path, "below/mine.param", "TRIM_THROTTLE,45\n")
    text = MINIMAL.read_text().replace("rascal110, start_m", "rascal110, tune: mine.param, start_m")
    page(tmp_path, "below/base.yaml", text)
    top = page(tmp_path, "top.yaml", "extends: below/base.yaml\n")
    monkeypatch.chdir("/")
    loaded = load(top)
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
def test_a_setting_changes_the_page(text, holds):
    assert not holds(load(FULL))
    assert holds(load(FULL, [text]))


def test_settings_are_applied_in_order_and_may_name_what_the_page_leaves_out():
    changed = load(MINIMAL, ["rates.log_hz=50", "rates.log_hz=10", "controller.gain_scale=0.67"])
    assert changed.rates.log_hz == 10
    assert changed.controller.gain_scale == 0.67


BAD_SETTINGS = [
    ("rates.log_hz", "is not key.path=value (write for example rates.log_hz=50)"),
    ("=3", "is not key.path=value (write for example rates.log_hz=50)"),
    (
        "rates.loq_hz=50",
        "rates.loq_hz: is not a key of this part: did you mean 'log_hz'? (write one of physics_hz, "
        "autopilot_hz, control_hz, broadcast_hz, log_hz, synchronous)",
    ),
    (
        "fleet.uav3.tune=recorded",
        "fleet: has no element 'uav3': did you mean 'uav2'? (it has 0 to 1, uav1, uav2; * is all "
        "of them)",
    ),
    (
        "fleet.2.tune=recorded",
        "fleet: has no element '2' (it has 0 to 1, uav1, uav2; * is all of them)",
    ),
    ("scenario.seed.x=1", "scenario.seed: is 7, which has no 'x' inside"),
    (
        "scenario.seed=many",
        "scenario.seed: is 'many' (write a whole number; Seed of every random stream, a number)",
    ),
    (
        "fleet.*.start_m=[1, 2",
        "fleet.*.start_m: is not YAML: did not find expected ',' or ']'",
    ),
]


@pytest.mark.parametrize(("text", "message"), BAD_SETTINGS, ids=[text for text, _ in BAD_SETTINGS])
def test_a_wrong_setting_is_named(text, message):
    assert refusal(load, FULL, [text]) == f"--set {text}: {message}"


def test_a_wildcard_over_nothing_is_refused():
    message = "--set formation.leader_gains.*=1: formation.leader_gains: is empty: * has nothing"
    assert refusal(load, MINIMAL, ["formation.leader_gains.*=1"]).startswith(message)


def test_names_are_found_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_scenario("simulation-3").is_file()
    assert "rascal110" in list_aircraft()
    home = find_aircraft("rascal110")
    assert (home / "rascal110.xml").is_file()
    assert find_tune("rascal110", "recorded") == home / "recorded.param"
    for name in list_data():
        assert find_data(name).name == name


def test_a_path_to_an_aircraft_of_ones_own_is_kept(tmp_path):
    home = page(tmp_path, "glider/glider.xml", "<fdm_config/>").parent
    page(home, "calm.param", "TRIM_THROTTLE,45\n")
    page(home, "middle_loop.yaml", (find_aircraft("rascal110") / "middle_loop.yaml").read_text())
    settings = [f"fleet.0.aircraft={home}", "fleet.0.tune=calm"]
    loaded = load(MINIMAL, settings)
    assert (loaded.fleet[0].aircraft, loaded.fleet[0].tune) == (str(home), "calm")
    assert loads(dump(loaded)) == loaded
    text = refusal(load, MINIMAL, [settings[0], "fleet.0.tune=clam"])
    assert "there is no tune of glider 'clam': did you mean 'calm'?" in text


def test_a_folder_without_a_model_is_no_aircraft(tmp_path):
    text = refusal(load, MINIMAL, [f"fleet.0.aircraft={tmp_path}"])
    assert f"{tmp_path} has no {tmp_path.name}.xml" in text


def test_a_missing_recording_is_answered_with_the_known_ones():
    text = refusal(load, MINIMAL, ["leader.path={kind: replay, file: lost.csv}"])
    assert "leader.path.file: there is no data file 'lost.csv' (write one of: " in text


def test_a_middle_loop_is_read_and_checked(tmp_path):
    authors = load_middle_loop("rascal110", "authors")
    assert (authors.course.p, authors.course.i, authors.course.d) == (1.0, 0.1, 0.2)
    assert (authors.limits.pitch_deg, authors.limits.roll_deg) == (20.0, 50.0)
    home = page(tmp_path, "glider/glider.xml", "<fdm_config/>").parent
    page(home, "middle_loop.yaml", "paper:\n  course: {p: 1, q: 2}\n")
    text = refusal(load_middle_loop, home, "paper")
    assert "middle_loop.yaml:2:18: paper.course.q: is not a key of this part" in text
    assert "middle_loop.yaml:1:1: paper.speed: is missing" in text
