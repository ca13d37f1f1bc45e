"""Pages that are wrong: the message names the place, what is wrong, and what to write."""

from pathlib import Path

import pytest

from testbed.scenario import ScenarioError, list_aircraft, load, loads

MINIMAL = (Path(__file__).parents[1] / "data" / "scenarios" / "minimal.yaml").read_text()


def complaint(text, **changes):
    with pytest.raises(ScenarioError) as caught:
        loads(text, source="page.yaml", **changes)
    return str(caught.value)


def changed(old, new):
    assert MINIMAL.count(old) == 1
    return MINIMAL.replace(old, new)


WRONG = [
    (
        "duration_s: 10",
        "duraton_s: 10",
        "page.yaml:2:1: scenario.duration_s: is missing (write duration_s: ...; Length of the run, "
        "s)\n"
        "page.yaml:2:38: scenario.duraton_s: is not a key of this part: did you mean 'duration_s'? "
        "(write one of schema, name, question, expectation, duration_s, seed, origin, portions, "
        "published)",
    ),
    (
        "duration_s: 10",
        "duration_s: long",
        "page.yaml:2:50: scenario.duration_s: is 'long' (write a number; Length of the run, s)",
    ),
    (
        "duration_s: 10",
        'duration_s: "10"',
        "page.yaml:2:50: scenario.duration_s: is '10' (write 10, without quotes, blanks or "
        "underscores)",
    ),
    (
        "duration_s: 10",
        "duration_s: 1_000",
        "page.yaml:2:50: scenario.duration_s: is '1_000' (write 1000, without quotes, blanks or "
        "underscores)",
    ),
    (
        "duration_s: 10",
        "duration_s: -10",
        "page.yaml:2:50: scenario.duration_s: is -10 (write a number above 0)",
    ),
    (
        "duration_s: 10",
        "duration_s: .nan",
        "page.yaml:2:50: scenario.duration_s: is nan (write a finite number)",
    ),
    (
        "schema: 1",
        "schema: 2",
        "page.yaml:2:20: scenario.schema: is 2 (write 1)",
    ),
    (
        "name: minimal",
        "name: mini mal",
        "page.yaml:2:29: scenario.name: is 'mini mal' (write letters, digits, '-', '_' and '.', no "
        "blanks)",
    ),
    (
        "start_m: [-10, 5, 0]",
        "start_m: [-10, 5]",
        "page.yaml:7:48: fleet.0.start_m: has 2 elements (write 3; Start [forward, right, down] of "
        "the leader's start along its course, m)",
    ),
    (
        "kind: waypoints",
        "kind: waypoint",
        "page.yaml:5:57: leader.path.legs.0.kind: is 'waypoint': did you mean 'waypoints'? (write "
        "one of waypoints, loiter)",
    ),
    (
        "points_m: [[1000",
        "points_m: [[far",
        "page.yaml:5:80: leader.path.legs.0.points_m.0.0: is 'far' (write a number; Waypoints "
        "[north, east, altitude], m from the origin)",
    ),
    (
        "name: uav1,",
        "name: uav1, sensors: gps,",
        "page.yaml:7:27: fleet.0.sensors: 'gps' is not a known sensor set: did you mean 'gps-ins'? "
        "(write one of truth, gps-ins, pixhawk, degraded, or a map of what errs)",
    ),
    (
        "aircraft: rascal110, start_m",
        "aircraft: rascal100, start_m",
        "page.yaml:7:28: fleet.0.aircraft: there is no aircraft 'rascal100': did you mean "
        f"'rascal110'? (write one of: {', '.join(list_aircraft())}; or the path of a folder with a "
        "JSBSim model)",
    ),
    (
        "offsets_m: {uav1:",
        "offsets_m: {uav2:",
        "page.yaml:9:14: formation.offsets_m: the offset of 'uav1' is missing (write uav1: "
        "[forward, right, down] in m)\n"
        "page.yaml:9:21: formation.offsets_m.uav2: no follower has this name: did you mean 'uav1'? "
        "(the fleet has uav1)",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG, ids=[new for _, new, _ in WRONG])
def test_a_wrong_value_is_named_with_its_place_and_its_cure(old, new, message):
    assert complaint(changed(old, new)) == message


MORE = [
    (
        "rates: {control_hz: 30}",
        "rates.control_hz: 30 Hz does not divide physics_hz, 200 Hz (write 25",
    ),
    ("rates: {log_hz: 400}", "rates.log_hz: 400 Hz does not divide physics_hz, 200 Hz (write 200"),
    ("log: {mcap: no}", "log.mcap: is 'no' (write false)"),
    ("log: {mcap: 1}", "log.mcap: is 1 (write true or false"),
    ("network: {delay_s: [1]}", "network.delay_s: is a list (write a number; Latency"),
    ("network: 5", "network: is 5 (write a map of keys and values; The radio"),
    ("controller: {profile: papr}", "there is no profile 'papr': did you mean 'paper'?"),
    ("controller: {throttle_error: air}", "is 'air' (write ground_speed or airspeed)"),
    ("networks: {delay_s: 0}", "networks: is not a key of this part: did you mean 'network'?"),
    ("rates: {synchronous: no}", "rates.synchronous: is 'no' (write false)"),
    (
        "network: {mute_s: {lead: [[1, 2]]}}",
        "network.mute_s.lead: no aircraft has this name: did you mean 'leader'? (the run has "
        "leader, uav1)",
    ),
    (
        "network: {mute_s: {uav1: [[1, 2], [5, 5]]}}",
        "network.mute_s.uav1.1: [5, 5] is not a window (write [from, to] in s)",
    ),
    (
        "network: {mute_s: {uav1: [[2, 1]]}}",
        "network.mute_s.uav1.0: [2, 1] is not a window (write [from, to] in s)",
    ),
    ("network: {mute_s: {uav1: [[-1, 2]]}}", "mute_s.uav1.0.0: is -1 (write a number at least 0)"),
    ("network: {mute_s: {uav1: [[1]]}}", "network.mute_s.uav1.0: has 1 elements (write 2; By"),
    ("network: {mute_s: {uav1: [1, 2]}}", "network.mute_s.uav1.0: is 1 (write a list; By aircraft"),
    ("air: {wind: {speed_mps: -1}}", "air.wind.speed_mps: is -1 (write a number at least 0)"),
    (
        "controller: {options: {gain: 1}}",
        "controller.options: the paper's law takes no options (write its gains under formation, or "
        "leave this out)",
    ),
    ("controller: {options: {gain: {a: 1}}}", "controller.options.gain: is a map (write "),
    (
        "controller: {law: papre}",
        "controller.law: must be paper, or module:Class for a law of your",
    ),
    ("controller: {law: 'mine.py:Law'}", "mine.py (write module:Class, with module.py beside the"),
    ("controller: {silence: {after_s: 0}}", "silence.after_s: is 0 (write a number above 0)"),
    ("controller: {silence: {then: land}}", "silence.then: is 'land' (write straight or loiter)"),
    ("controller: {silence: {bank_deg: 70}}", "silence.bank_deg: is 70 (write a number at most 60"),
    ("controller: {pitch_feedforward: all}", "is 'all' (write none or incidence)"),
    ("controller: {bounds_of: air}", "bounds_of: is 'air' (write ground_speed or airspeed)"),
    (
        "controller: {estimators: {leader_acceleration: bank}}",
        "estimators.leader_acceleration: is 'bank' (write broadcast, turn or none)",
    ),
    (
        "controller: {estimators: {leader_acceleration_blend: [0, 1, 1]}}",
        "estimators.leader_acceleration_blend.0: is 0 (write a number above 0)",
    ),
]


@pytest.mark.parametrize(("line", "message"), MORE, ids=[line for line, _ in MORE])
def test_a_wrong_section_is_named_in_its_line(line, message):
    text = complaint(MINIMAL + line + "\n")
    assert text.startswith("page.yaml:10:")
    assert message in text


ALSO = [
    ("name: minimal,", "name: minimal, portions: {a: [5, 4]},", "[5, 4] is not a window (write"),
    ("name: minimal,", "name: minimal, portions: {a: [5, 11]},", "ends at 11 s, after the run"),
    (
        "name: minimal,",
        "name: minimal, portions: {a: [0, 5]}, published: {source: x, rms_m: {a: [1, 2]}},",
        "scenario.published.rms_m.a: has 2 numbers for 1 followers",
    ),
    (
        "name: minimal,",
        "name: minimal, portions: {rect: [0, 5]}, published: {source: x, mean_rms_m: {rekt: 1}},",
        "scenario.published.mean_rms_m.rekt: no portion has this name: did you mean 'rect'?",
    ),
    ("name: uav1,", "name: leader,", "fleet.0.name: 'leader' is already the name of the leader"),
    ("formation:", "formation:\n  speed_mps: [30, 16]", "[30, 16] is not a range of speeds"),
    ("formation:", "formation:\n  leader_gains: {uav9: 1}", "leader_gains.uav9: no follower"),
    ("formation:", "formation:\n  leader_gains: {uav1: [1, 2]}", "must be a number, three numbers"),
    ("formation:", "formation:\n  leader_gains: {uav1: -1}", "is -1 (write a number at least 0)"),
    (
        "formation:",
        "formation:\n  neighbour_gains: {uav1: {uav1: 1}}",
        "neighbour_gains.uav1.uav1: an aircraft is not its own neighbour",
    ),
    ("formation:", "formation:\n  barrier: {example: 3}", "is 3 (write one of 4, 5, 6, 7)"),
    (
        "formation:",
        "formation:\n  agents: {uav2: {k: 1}}",
        "formation.agents.uav2: no follower has this name: did you mean 'uav1'? (the fleet",
    ),
    (
        "formation:",
        "formation:\n  agents: {uav1: {kappa: 1}}",
        "agents.uav1.kappa: is not a key of this part: did you mean 'kappa_mps'? (write one of",
    ),
    (
        "formation:",
        "formation:\n  agents: {uav1: {k: 0}}",
        "formation.agents.uav1.k: is 0 (write a number above 0)",
    ),
    (
        "formation:",
        "formation:\n  agents: {uav1: {barrier: {example: 1}}}",
        "formation.agents.uav1.barrier.example: is 1 (write one of 4, 5, 6, 7)",
    ),
    (
        "formation:",
        "formation:\n  agents: {uav1: {speed_mps: [20, 20]}}",
        "formation.agents.uav1.speed_mps: [20, 20] is not a range of speeds (write [lowest,",
    ),
    (
        "formation:",
        "formation:\n  agents: {uav1: {speed_desired_mps: [0, 20]}}",
        "formation.agents.uav1.speed_desired_mps: [0, 20] is not a range of speeds",
    ),
    (
        "formation:",
        "formation:\n  speed_desired_mps: [25, 20]",
        "formation.speed_desired_mps: [25, 20] is not a range of speeds",
    ),
    (
        "formation:",
        "formation:\n  altitudes_m: {uv1: 90}",
        "formation.altitudes_m.uv1: no follower has this name: did you mean 'uav1'? (the fleet has",
    ),
    (
        "formation:",
        "formation:\n  altitudes_m: {uav1: high}",
        "formation.altitudes_m.uav1: is 'high' (write a number; ",
    ),
    (
        "formation:",
        "formation:\n  c: {per_sped_squared: 1}",
        "c.per_sped_squared: is not a key of this part: did you mean 'per_speed_squared'?",
    ),
    (
        "formation:",
        "formation:\n  c: {per_speed_squared: -1}",
        "formation.c.per_speed_squared: is -1 (write a number at least 0)",
    ),
    ("formation:", "formation:\n  c: 0", "formation.c: must be above 0"),
    ("formation:", "formation:\n  c: -1", "formation.c: is -1 (write a number"),
    (
        "formation:",
        "formation:\n  leader_gains: {uav1: [[1, 0, 0], [0, 2, 1], [0, 0, 3]]}",
        "formation.leader_gains.uav1: a matrix must be diagonal (write [north, east, down])",
    ),
    (
        "formation:",
        "formation:\n  leader_gains: {uav1: [[1, 0], [0, 2], [0, 0]]}",
        "formation.leader_gains.uav1: must be a number, three numbers [north, east, down], or a",
    ),
    (
        "formation:",
        "formation:\n  leader_gains: {uav1: [[1, 0, 0], 2, 3]}",
        "formation.leader_gains.uav1: must be a number, three numbers [north, east, down], or a",
    ),
    (
        "formation:",
        "formation:\n  leader_gains: {uav1: [[1, 0, 0], [0, -2, 0], [0, 0, 3]]}",
        "formation.leader_gains.uav1.1: is a list (write a number at least 0)",
    ),
    (
        "formation:",
        "formation:\n  leader_gains: {uav1: yes}",
        "formation.leader_gains.uav1: must be a number, three numbers",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), ALSO, ids=[new for _, new, _ in ALSO])
def test_parts_that_contradict_each_other_are_refused(old, new, message):
    assert message in complaint(changed(old, new))


NOT_PAGES = [
    ("", "page.yaml:1:1: is empty (write a map of keys and values)"),
    ("- 1", "page.yaml:1:1: is a list (write a map of keys and values)"),
    ("a: b: c", "page.yaml:1:5: is not YAML: mapping values are not allowed in this context"),
    (
        "a: 1\nb: 2\na: 3",
        "page.yaml:3:1: the key 'a' is here twice, first in line 1 (write it once)",
    ),
    (
        "a: !!python/object/apply:os.getcwd []",
        "page.yaml:1:4: the tag !!python/object/apply:os.getcwd is not read (leave it out)",
    ),
    ("a: &a [*a]", "page.yaml:1:4: the page is too large or too deep"),
    ("[" * 200_000, "page.yaml:1:41: is too deep"),
    ("<<: {a: 1}", "page.yaml:1:1: merge keys are not read (write extends instead)"),
]


@pytest.mark.parametrize(("text", "message"), NOT_PAGES, ids=[text[:20] for text, _ in NOT_PAGES])
def test_what_is_no_page_is_refused(text, message):
    assert complaint(text) == message


def test_aliases_that_stand_for_millions_are_refused():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join(['*a%d' % (n - 1)] * 10)}]" for n in range(1, 9)]
    assert "too large" in complaint("\n".join(lines))


def test_numbers_are_read_as_yaml_1_2_writes_them():
    page = loads(changed("duration_s: 10", "duration_s: 1e1, seed: 010"))
    assert page.scenario.duration_s == 10.0
    assert page.scenario.seed == 10


def test_a_file_is_named_relative_to_here(tmp_path, monkeypatch):
    (tmp_path / "pages").mkdir()
    page = tmp_path / "pages" / "mine.yaml"
    page.write_text(changed("duration_s: 10", "duration_s: 0"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError) as caught:
        load(page)
    assert str(caught.value).startswith("pages/mine.yaml:2:50: scenario.duration_s: is 0")
    monkeypatch.chdir(tmp_path / "pages")
    page.write_bytes(b"scenario:\n  name: \xff\n")
    with pytest.raises(ScenarioError, match=r"^mine\.yaml:2:1: is not UTF-8 text"):
        load("mine.yaml")


def test_an_unknown_scenario_is_answered_with_the_known_ones():
    with pytest.raises(ScenarioError, match="did you mean 'simulation-3'") as caught:
        load("simulation-33")
    assert "simulation-3" in str(caught.value)


def test_problems_carry_what_a_program_needs():
    with pytest.raises(ScenarioError) as caught:
        loads(changed("duration_s: 10", "duration_s: x, seed: y"), source="page.yaml")
    first, second = caught.value.problems
    assert (first.place.line, first.place.column) == (2, 50)
    assert first.path == ("scenario", "duration_s")
    assert second.path == ("scenario", "seed")


def test_an_error_of_a_thousand_places_tells_the_first_fifty():
    text = f"scenario: {{schema: 1, name: many, portions: {dict.fromkeys(range(1000), 0)}}}"
    with pytest.raises(ScenarioError) as refused:
        loads(text)
    lines = str(refused.value).splitlines()
    assert len(refused.value.problems) >= 1000
    assert len(lines) == 51
    assert lines[-1] == f"and {len(refused.value.problems) - 50:,} more"
