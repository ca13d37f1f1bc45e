"""Wrong scenarios: each error names the place, the wrong value and what to write.

tests/data/wrong_scenarios has texts that are wrong on top of minimal.yaml, one per paragraph;
files.txt whole texts, settings.txt settings of everything.yaml.
"""

from pathlib import Path

import pytest
from snapshot import check_snapshot

from testbed.scenario import ScenarioError, load, loads

ROOT = Path(__file__).parents[2]
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
            text = error_of(load, "everything.yaml", [case])
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
    scenario = load(FOLDER / "minimal.yaml", ["scenario.duration_s=1e1", "scenario.seed=010"])
    assert (scenario.scenario.duration_s, scenario.scenario.seed) == (10.0, 10)


def test_file_is_named_relative_to_working_directory(tmp_path, monkeypatch):
    (tmp_path / "below").mkdir()
    file = tmp_path / "below" / "mine.yaml"
    file.write_text("extends: simulation-3\nscenario: {duration_s: 0}\n")
    monkeypatch.chdir(tmp_path)
    assert error_of(load, file).startswith("below/mine.yaml:2:24: scenario.duration_s: is 0")
    monkeypatch.chdir(tmp_path / "below")
    file.write_bytes(b"scenario:\n  name: \xff\n")
    assert error_of(load, "mine.yaml").startswith("mine.yaml:2:1: is not UTF-8 text")


def test_unknown_scenario_lists_the_known_ones():
    text = error_of(load, "simulation-33")
    assert "did you mean 'simulation-3'" in text and "vee-100" in text


def test_problems_have_place_and_path():
    text = "extends: simulation-3\nscenario: {duration_s: x, seed: y}\n"
    with pytest.raises(ScenarioError) as caught:
        loads(text, source="case.yaml")
    first, second = caught.value.problems
    assert (first.place.line, first.place.column) == (2, 24)
    assert first.path == ("scenario", "duration_s")
    assert second.path == ("scenario", "seed")


def test_error_text_lists_the_first_fifty_problems():
    text = f"scenario: {{schema: 2, name: many, windows: {dict.fromkeys(range(1000), 0)}}}"
    with pytest.raises(ScenarioError) as caught:
        loads(text)
    lines = str(caught.value).splitlines()
    assert len(caught.value.problems) >= 1000
    assert len(lines) == 51
    assert lines[-1] == f"and {len(caught.value.problems) - 50:,} more"
