"""Fleets that are a pattern: slots, neighbours, settings and inheritance."""

from itertools import combinations
from math import dist

import numpy as np
import pytest
import yaml
from places import TESTS
from run_flight import Collector

import testbed
from testbed.plan.world import build
from testbed.scenario import ScenarioError, dump, json_schema, load_scenario, loads
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.pattern import Pattern

FOLDER = TESTS / "data" / "scenarios"
PATTERN = FOLDER / "pattern.yaml"
HEAD = """\
scenario: {schema: 2, name: pattern, duration_s: 10}
leader:
  aircraft: rascal110
  path: {kind: virtual, speed_mps: 22, curve: {kind: straight}}
"""
ONE = (1.0, 1.0, 1.0)


def read(fleet, *changes, more=""):
    return loads(f"{HEAD}fleet: {fleet}\n{more}", changes, source="case.yaml")


def of(pattern, count, *changes, **keys):
    more = "".join(f", {key}: {value}" for key, value in keys.items())
    return read(f"{{pattern: {pattern}, count: {count}, aircraft: rascal110{more}}}", *changes)


def slots(scenario):
    return [scenario.formation.offsets_m[follower.name] for follower in scenario.fleet]


def neighbours(scenario):
    return {name: [*gains] for name, gains in scenario.formation.neighbour_gains.items()}


def error_of(call, *arguments, **keys):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **keys)
    return str(caught.value)


def test_pattern_fixture_sets_every_key():
    fixture = Pattern.model_validate(yaml.safe_load(PATTERN.read_text())["fleet"])
    own = Pattern.model_fields.keys() - AircraftSection.model_fields.keys() | {"name"}
    assert own <= fixture.model_fields_set
    for key in own:
        field = Pattern.model_fields[key]
        assert field.is_required() or getattr(fixture, key) != field.get_default(), key


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("vee", [(-9, 5, 1), (-9, -5, 1), (-18, 10, 2), (-18, -10, 2), (-27, 15, 3)]),
        ("echelon-right", [(-9, 5, 1), (-18, 10, 2), (-27, 15, 3), (-36, 20, 4), (-45, 25, 5)]),
        ("echelon-left", [(-9, -5, 1), (-18, -10, 2), (-27, -15, 3), (-36, -20, 4), (-45, -25, 5)]),
        # as square as it goes: three and, in their middle, two
        ("grid", [(-9, -5, 1), (-9, 0, 1), (-9, 5, 1), (-18, -2.5, 2), (-18, 2.5, 2)]),
    ],
)
def test_slots_are_steps_of_the_spacing(pattern, expected):
    assert slots(of(pattern, 5, spacing_m="[9, 5, 1]")) == expected


def test_column_and_line_have_one_direction():
    assert slots(of("column", 3, spacing_m="[9, 0, 1]")) == [(-9, 0, 1), (-18, 0, 2), (-27, 0, 3)]
    line = slots(of("line-abreast", 3, spacing_m="[0, 5, 1]"))
    assert line == [(0, 5, 1), (0, -5, 1), (0, 10, 2)]


@pytest.mark.parametrize(
    ("pattern", "first"),
    [("vee", (-10, 10, 0)), ("column", (-10, 0, 0)), ("line-abreast", (0, 10, 0))],
)
def test_default_spacing_is_ten_metres(pattern, first):
    assert slots(of(pattern, 1)) == [first]


@pytest.mark.parametrize(
    "pattern", ["vee", "line-abreast", "column", "echelon-left", "echelon-right", "grid"]
)
@pytest.mark.parametrize("count", [1, 2, 7, 30, 100])
def test_slots_and_starts_are_apart(pattern, count):
    scenario = of(pattern, count)
    places = [(0.0, 0.0, 0.0), *slots(scenario)]
    assert len(places) == count + 1
    assert min(dist(one, other) for one, other in combinations(places, 2)) >= 10.0
    starts = np.array([follower.start_m for follower in scenario.fleet])
    assert np.array_equal(starts, np.array(places[1:]) - [20.0, 0.0, 0.0])


def test_neighbours_are_those_of_nearest_slots():
    # 14.1 m along an arm, 20 m across the first rank, 28.3 m to the next but one
    scenario = of("vee", 6)
    assert scenario.formation.leader_gains == dict.fromkeys(scenario.aircraft_names[1:], ONE)
    assert neighbours(scenario) == {
        "uav1": ["uav3", "uav2"],
        "uav2": ["uav4", "uav1"],
        "uav3": ["uav1", "uav5"],
        "uav4": ["uav2", "uav6"],
        "uav5": ["uav3", "uav1"],
        "uav6": ["uav4", "uav2"],
    }
    for number, found in (("0", set()), ("3", {3}), ("99", {5})):
        gains = of("vee", 6, neighbours=number).formation.neighbour_gains
        assert {len(each) for each in gains.values()} == found


def test_neighbours_from_ahead_have_lower_numbers():
    assert neighbours(of("vee", 6, neighbours_from="ahead")) == {
        "uav2": ["uav1"],
        "uav3": ["uav1", "uav2"],
        "uav4": ["uav2", "uav1"],
        "uav5": ["uav3", "uav1"],
        "uav6": ["uav4", "uav2"],
    }
    chain = neighbours(of("column", 4, neighbours_from="ahead", neighbours=1))
    assert chain == {"uav2": ["uav1"], "uav3": ["uav2"], "uav4": ["uav3"]}


def test_neighbour_ties_ignore_rounding():
    near = neighbours(of("column", 30, spacing_m="[0.7, 0, 0]"))
    for before, name, after in zip(range(1, 29), range(2, 30), range(3, 31), strict=True):
        assert near[f"uav{name}"] == [f"uav{before}", f"uav{after}"]


def test_zero_gains_are_left_out():
    scenario = of("vee", 4, leader_gain=0, neighbour_gain="[1, 1, 0.5]")
    assert scenario.formation.leader_gains == {}
    assert scenario.formation.neighbour_gains["uav1"]["uav2"] == (1.0, 1.0, 0.5)
    assert of("vee", 4, neighbour_gain=0).formation.neighbour_gains == {}
    assert "no position reference for uav1, uav2, uav3, uav4" in error_of(build, scenario)
    led = "{pattern: vee, count: 4, aircraft: rascal110, leader_gain: 0}"
    scenario = read(led, more="formation: {leader_gains: {uav1: 2}}")
    assert scenario.formation.leader_gains == {"uav1": (2.0, 2.0, 2.0)}
    assert build(scenario).names[1:] == ("uav1", "uav2", "uav3", "uav4")


def test_agents_override_common_keys():
    scenario = load_scenario(PATTERN)
    x1, x2, x3, x4, _ = scenario.fleet
    assert [each.name for each in scenario.fleet] == ["x1", "x2", "x3", "x4", "x5"]
    assert (x1.vehicle, x1.tune, x1.sensors.position.sigma_m) == ("unicycle", "recorded", 0.3)
    assert (x2.vehicle, x2.sensors.position.sigma_m) == ("jsbsim", 2.0)
    assert (x3.faults, x4.faults) == (x1.faults, ()) and len(x1.faults) == 1
    assert (x4.tune, x4.start_m) == ("autopilot", (-90.0, -20.0, 0.0))
    assert x1.start_m == (-27.0, -6.0, -1.5)


def test_formation_keys_precede_the_pattern():
    formation = load_scenario(PATTERN).formation
    assert formation.offsets_m["x5"] == (-70.0, -30.0, 5.0)
    assert set(formation.leader_gains) == {"x1", "x2", "x4", "x5"}
    assert formation.neighbour_gains["x5"] == {"x4": (0.5,) * 3, "x1": (2.0,) * 3}


def test_dump_has_the_list_of_followers(tmp_path):
    scenario = load_scenario(PATTERN)
    text = dump(scenario)
    assert "pattern:" not in text
    assert loads(text) == loads(text, check_files=False) == scenario
    assert loads(PATTERN.read_text(), check_files=False).fleet == scenario.fleet


def test_settings_of_pattern_precede_those_of_one():
    changes = ["fleet.uav9.vehicle=unicycle", "fleet.*.sensors=gps-ins", "fleet.count=9"]
    changes += ["fleet.8.sensors=truth", "fleet.spacing_m=[20, 20, 0]", "formation.k=2"]
    changes += ["formation.leader_gains.uav9=null", "fleet.tune=recorded"]
    scenario = of("vee", 3, *changes)
    assert len(scenario.fleet) == 9
    assert [each.vehicle for each in scenario.fleet] == ["jsbsim"] * 8 + ["unicycle"]
    assert {each.tune for each in scenario.fleet} == {"recorded"}
    assert scenario.fleet[0].sensors.position.sigma_m == 0.3
    assert scenario.fleet[8].sensors.exact
    assert scenario.formation.offsets_m["uav9"] == (-100.0, 100.0, 0.0)
    assert len(scenario.formation.leader_gains) == 8


def test_extending_file_changes_pattern(tmp_path):
    (tmp_path / "base.yaml").write_text(
        HEAD + "fleet: {pattern: vee, count: 3, aircraft: rascal110}\nformation: {k: 2}\n"
    )
    (tmp_path / "top.yaml").write_text("extends: base.yaml\nfleet: {count: 5, neighbours: 1}\n")
    scenario = load_scenario(tmp_path / "top.yaml", ["fleet.count=6"])
    assert len(scenario.fleet) == 6 and scenario.formation.k == 2.0
    assert neighbours(scenario)["uav5"] == ["uav3"]


def test_pattern_replaces_list_and_its_gains(tmp_path):
    fleet = "{pattern: vee, count: 5, aircraft: rascal110}"
    (tmp_path / "top.yaml").write_text(
        f"extends: simulation-3\nscenario: {{name: top}}\nfleet: {fleet}\n"
        "formation: {leader_gains: {uav2: 2}}\n"
    )
    base, top = load_scenario("simulation-3"), load_scenario(tmp_path / "top.yaml")
    again = load_scenario("simulation-3", ["scenario.published=null", f"fleet={fleet}"])
    assert again.fleet == top.fleet
    for scenario in (top, again):
        assert slots(scenario)[:2] == [(-10.0, 10.0, 0.0), (-10.0, -10.0, 0.0)]
        assert neighbours(scenario)["uav2"] == ["uav4", "uav1"]
        assert scenario.formation.kappa_mps == base.formation.kappa_mps
    assert top.formation.leader_gains["uav2"] == (2.0, 2.0, 2.0)
    assert again.formation.leader_gains["uav2"] == ONE


def test_json_schema_allows_pattern_and_list():
    fleet = json_schema()["properties"]["fleet"]
    assert [next(iter(way)) for way in fleet["anyOf"]] == ["items", "$ref"]
    assert fleet["description"]


@pytest.mark.parametrize("synchronous", ["true", "false"])
def test_slot_warning_names_the_worst(synchronous):
    changes = ["fleet.*.vehicle=unicycle", "leader.path.bank_limit_deg=20"]
    changes.append(f"rates.synchronous={synchronous}")
    assert not build(load_scenario("vee-30", changes[:1])).initial_events
    (note,) = build(load_scenario("vee-30", changes)).initial_events
    assert note.text.startswith("uav29, uav30: the slot may move at 19.68 to 41.95 m/s")
    assert note.text.endswith("; 20 other slots have the same problem to a lesser degree")
    # a pair of slots each: as many as the table has lines for
    assert len(build(load_scenario("vee-30", [*changes, "fleet.count=20"])).initial_events) == 6


def test_receive_neighbours_changes_no_flight():
    """The law hbh23 uses no other messages; equal to the bit."""
    changes = ["fleet.count=6", "scenario.duration_s=4", "scenario.windows=null", "log.mcap=false"]
    results = {}
    for receive in ("all", "neighbours"):
        collector = Collector()
        run = testbed.run(
            load_scenario("vee-30", [*changes, f"network.receive={receive}"]),
            write=False,
            observers=[collector],
        )
        results[receive] = collector.frames, run.metrics["network"]["links"]
    for of_all, of_some in zip(results["all"][0], results["neighbours"][0], strict=True):
        assert np.array_equal(of_all.truth.position_ned, of_some.truth.position_ned)
    assert {name: len(by) for name, by in results["all"][1].items()} == {
        "leader": 6,
        **{f"uav{k}": 5 for k in range(1, 7)},
    }
    assert sum(len(by) for by in results["neighbours"][1].values()) == 6 + 6 * 2
