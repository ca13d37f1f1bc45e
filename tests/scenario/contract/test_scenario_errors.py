"""Wrong scenarios: each error names the place, the wrong value and what to write.

tests/data/wrong_scenarios has texts that are wrong on top of minimal.yaml, one per paragraph;
files.txt whole texts, settings.txt settings of everything.yaml.
"""

import time

import pytest
from commands import call_command
from places import ROOT
from snapshot import check_snapshot

from testbed.core.errors import InputError
from testbed.guidance.flight_plan import GuidanceMission, WaypointLeg, expand_laps
from testbed.scenario import ScenarioError, library, load_scenario, loads
from testbed.scenario.problems import MAX_LINE

FOLDER = ROOT / "tests" / "data" / "scenarios"
CASES = ROOT / "tests" / "data" / "wrong_scenarios"


def error_of(call, *arguments, **options):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **options)
    return str(caught.value)


@pytest.mark.parametrize("section", sorted(path.stem for path in CASES.glob("*.txt")))
def test_wrong_scenario_matches_snapshot(section, monkeypatch):
    monkeypatch.chdir(FOLDER)
    blocks = []
    for case in (CASES / f"{section}.txt").read_text().rstrip().split("\n\n"):
        if section == "settings":
            text = error_of(load_scenario, "everything.yaml", [case])
        else:
            base = "" if section == "files" else "extends: minimal.yaml\n"
            text = error_of(loads, base + case, source="case.yaml")
        blocks.append(f"{case}\n{text.replace(str(FOLDER), '.').replace(str(ROOT), '.')}\n")
    check_snapshot(f"scenario_errors_{section}", "\n".join(blocks))


def test_empty_file_is_refused():
    text = error_of(loads, "", source="x.yaml")
    assert text == "x.yaml:1:1: is empty (write a map of keys and values)"


def test_deep_nesting_is_refused():
    assert error_of(loads, "[" * 200_000, source="x.yaml") == (
        "x.yaml:1:41: is nested deeper than 40 levels (write a flatter file)"
    )


def test_aliases_for_millions_of_nodes_are_refused():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join(['*a%d' % (n - 1)] * 10)}]" for n in range(1, 9)]
    assert "too large" in error_of(loads, "\n".join(lines))


def test_numbers_are_read_by_yaml_1_2():
    scenario = load_scenario(
        FOLDER / "minimal.yaml", ["scenario.duration_s=1e1", "scenario.seed=010"]
    )
    assert (scenario.scenario.duration_s, scenario.scenario.seed) == (10.0, 10)


def test_file_is_named_relative_to_working_directory(tmp_path, monkeypatch):
    (tmp_path / "below").mkdir()
    file = tmp_path / "below" / "mine.yaml"
    file.write_text("extends: simulation-3\nscenario: {duration_s: 0}\n")
    monkeypatch.chdir(tmp_path)
    assert error_of(load_scenario, file).startswith(
        "below/mine.yaml:2:24: scenario.duration_s: is 0"
    )
    monkeypatch.chdir(tmp_path / "below")
    file.write_bytes(b"scenario:\n  name: \xff\n")
    assert error_of(load_scenario, "mine.yaml").startswith("mine.yaml:2:1: is not UTF-8 text")


def test_unknown_scenario_lists_the_known_ones():
    text = error_of(load_scenario, "simulation-33")
    assert "did you mean 'simulation-3'" in text and "vee-100" in text


def test_problems_have_place_and_path():
    text = "extends: simulation-3\nscenario: {duration_s: x, seed: y}\n"
    with pytest.raises(ScenarioError) as caught:
        loads(text, source="case.yaml")
    first, second = caught.value.problems
    assert (first.place.line, first.place.column) == (2, 24)
    assert first.path == ("scenario", "duration_s")
    assert second.path == ("scenario", "seed")


def test_error_text_lists_the_first_problems():
    text = f"scenario: {{schema: 2, name: many, windows: {dict.fromkeys(range(1000), 0)}}}"
    with pytest.raises(ScenarioError) as caught:
        loads(text)
    lines = str(caught.value).splitlines()
    assert len(caught.value.problems) >= 1000
    assert len(lines) == 21
    assert lines[-1] == f"… and {len(caught.value.problems) - 20:,} more"


@pytest.mark.parametrize("row", ["window_s: [0], groups: x", "window_s: [9, 8], groups: [[x]]"])
def test_thousands_of_errors_take_seconds(row):
    """The time per error does not grow with the file."""
    rows = f"    - {{{row}}}\n" * 2000
    text = f"extends: simulation-3\nnetwork:\n  partitions:\n{rows}"
    began = time.process_time()
    with pytest.raises(ScenarioError) as caught:
        loads(text)
    assert time.process_time() - began < 2.0
    assert len(caught.value.problems) == 4000
    assert len(str(caught.value)) < 21 * MAX_LINE


def test_long_keys_and_words_are_shortened():
    text = error_of(loads, f"extends: simulation-3\n{'k' * 500_000}: 1\nair: {'w' * 500_000}\n")
    assert len(text) < 2 * MAX_LINE


@pytest.mark.parametrize(
    ("laps", "message"),
    [
        ("laps: 10000000", "laps: is 10000000 (write a number at most 10000)"),
        ("laps: 9000", "laps: the mission has 18,002 legs with all laps (write 10,000 or fewer)"),
    ],
)
def test_laps_without_end_are_refused(laps, message):
    """Each lap of each point is a segment in memory."""
    text = (
        "extends: simulation-3\nleader:\n  path:\n    legs:\n"
        f"      - {{kind: waypoints, points_m: [[900, 0, 100], [900, 900, 100]], {laps}}}\n"
        "      - {kind: waypoints, points_m: [[0, 0, 100], [900, 900, 100]]}\n"
    )
    found = error_of(loads, text, source="x.yaml")
    assert found.startswith("x.yaml:5:") and f"legs.0.{message}" in found


def test_mission_of_a_program_has_bounded_laps():
    leg = WaypointLeg(points=((900.0, 0.0, 100.0), (0.0, 900.0, 100.0)), laps=10**9)
    mission = GuidanceMission(legs=(leg,), airspeed=20.0)
    with pytest.raises(InputError, match=r"legs: 2,000,000,000 with all laps; write 10,000 or"):
        expand_laps(mission, (0.0, 0.0, 100.0))


def test_file_that_is_no_scenario_is_not_quoted(tmp_path):
    """`study.scenario` may name any file; what it holds may be a secret."""
    (tmp_path / "passphrase").write_text("correct:horse:battery\n")
    text = error_of(load_scenario, tmp_path / "passphrase")
    assert text == f"{tmp_path}/passphrase:1:1: is text (write a map of keys and values)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("air:\n  wind: {speed_mps: 40, from_deg: 0}", "2:9: air.wind: wind of 40 m/s"),
        ("leader:\n  tune: nope\n  path: *replay", "2:9: leader.tune: there is no tune"),
        ("leader:\n  path: *replay", "2:30: leader.path.file: {}/short.csv: 1 rows of numbers"),
        ("leader:\n  path: {airspeed_mps: 60}", ":44:19: leader.path.legs[3].radius_m: 120 m is"),
        (
            "leader:\n  path:\n    airspeed_mps: 45\n    legs: [{kind: waypoints, points_m: "
            "[[9000, 0, 100], [9000, 9000, 100]]}]\n    bank_limit_deg: 60",
            "3:19: leader.path.airspeed_mps: rascal110: trim at 45 m/s",
        ),
    ],
    ids=["wind", "tune", "recording", "leg", "trim"],
)
def test_errors_of_a_build_have_their_place(tmp_path, text, message):
    """What is found while a scenario is built is at the key to change, also in a base file."""
    recording = library() / "scenarios" / "data" / "arduplane-auto-leader-rascal.csv"
    (tmp_path / "short.csv").write_text("\n".join(recording.read_text().splitlines()[:2]))
    text = text.replace("*replay", "{kind: replay, file: short.csv}")
    path = tmp_path / "mine.yaml"
    path.write_text(f"{text}\nextends: simulation-3\nscenario: {{name: x}}\n")
    done = call_command("validate", path, cwd=tmp_path, code=2, columns=80)
    (line,) = done.stderr.splitlines()
    place = message if message.startswith(":") else f"error: {path.name}:{message}"
    assert place.format(tmp_path) in line


def test_control_character_has_its_place():
    error = error_of(loads, "extends: simulation-3\nlog: ü\0\n")
    assert error.startswith("<scenario>:2:7: is not YAML: unacceptable character #x0000")


def test_file_that_is_no_scenario_is_not_extended(tmp_path):
    """Neither its keys nor its values are in the error, also where a study names it."""
    (tmp_path / "secret").write_text("password: hunter2\n")
    (tmp_path / "mine.yaml").write_text("extends: secret\n")
    (tmp_path / "study.yaml").write_text("study: {schema: 1, name: s, scenario: secret}\n")
    for name, place in (("mine.yaml", "1:10: extends"), ("study.yaml", "1:39: study.scenario")):
        command = "validate" if name == "mine.yaml" else "sweep"
        error = call_command(command, name, cwd=tmp_path, code=2, columns=80).stderr
        expected = f"error: {name}:{place}: {tmp_path}/secret has no key of a scenario (write the "
        assert error.startswith(expected) and "password" not in error and "hunter" not in error


def test_wrong_lengths_have_a_number():
    """Neither bound of a length is written where there is none."""
    for case in ("fleet: []", "network: {partitions: [{window_s: [1, 2], groups: []}]}"):
        assert "None" not in error_of(loads, f"extends: simulation-3\n{case}\n")


def test_null_windows_without_inherited_ones_are_none():
    minimal = (FOLDER / "minimal.yaml").read_text()
    text = minimal.replace("duration_s: 10", "duration_s: 10, windows: null", 1)
    assert "windows: null" in text and loads(text).scenario.windows == {}


@pytest.mark.parametrize("overrides", [(), ("scenario.seed=1e3",)])
def test_exponent_of_a_whole_number_is_shown(overrides):
    text = (FOLDER / "minimal.yaml").read_text()
    if not overrides:
        text = text.replace("duration_s: 10", "duration_s: 10, seed: 1e3")
    assert "scenario.seed: is 1e3 (write 1000, a whole number; " in error_of(loads, text, overrides)


def test_whole_number_with_a_point_is_shown_as_written():
    text = error_of(load_scenario, FOLDER / "minimal.yaml", ["scenario.seed=7.0"])
    assert "scenario.seed: is 7.0 (write 7, a whole number" in text
