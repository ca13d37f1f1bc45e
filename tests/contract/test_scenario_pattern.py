"""A fleet that is a pattern: the list it stands for, and what may be changed and is wrong in it."""

from itertools import combinations
from math import dist
from pathlib import Path

import numpy as np
import pytest
import yaml

import testbed
from testbed.scenario import ScenarioError, dump, json_schema, load, loads
from testbed.scenario.aircraft import Craft
from testbed.scenario.pattern import Pattern
from testbed.sim.world import build

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
PATTERN = PAGES / "pattern.yaml"
HEAD = """\
scenario: {schema: 1, name: page, duration_s: 10}
leader:
  aircraft: rascal110
  path: {kind: virtual, speed_mps: 22, curve: {kind: straight}}
"""
ONE = (1.0, 1.0, 1.0)


def page(fleet, *changes, more=""):
    return loads(f"{HEAD}fleet: {fleet}\n{more}", changes, source="page.yaml")


def of(pattern, count, *changes, **keys):
    said = "".join(f", {key}: {value}" for key, value in keys.items())
    return page(f"{{pattern: {pattern}, count: {count}, aircraft: rascal110{said}}}", *changes)


def slots(scenario):
    return [scenario.formation.offsets_m[follower.name] for follower in scenario.fleet]


def heeded(scenario):
    return {name: [*whom] for name, whom in scenario.formation.neighbour_gains.items()}


def refusal(call, *arguments, **keys):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments, **keys)
    return str(caught.value)


def test_the_page_of_every_key_says_each_of_the_patterns_own_and_none_at_its_default():
    said = Pattern.model_validate(yaml.safe_load(PATTERN.read_text())["fleet"])
    own = Pattern.model_fields.keys() - Craft.model_fields.keys() | {"name"}
    assert own <= said.model_fields_set
    for key in own:
        field = Pattern.model_fields[key]
        assert field.is_required() or getattr(said, key) != field.get_default(), key


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


def test_a_column_and_a_line_have_one_direction():
    assert slots(of("column", 3, spacing_m="[9, 0, 1]")) == [(-9, 0, 1), (-18, 0, 2), (-27, 0, 3)]
    line = slots(of("line-abreast", 3, spacing_m="[0, 5, 1]"))
    assert line == [(0, 5, 1), (0, -5, 1), (0, 10, 2)]


@pytest.mark.parametrize(
    ("pattern", "first"),
    [("vee", (-10, 10, 0)), ("column", (-10, 0, 0)), ("line-abreast", (0, 10, 0))],
)
def test_the_spacing_is_ten_metres_where_the_pattern_has_any(pattern, first):
    assert slots(of(pattern, 1)) == [first]


@pytest.mark.parametrize(
    "pattern", ["vee", "line-abreast", "column", "echelon-left", "echelon-right", "grid"]
)
@pytest.mark.parametrize("count", [1, 2, 7, 30, 100])
def test_everyone_has_a_place_and_starts_with_room(pattern, count):
    scenario = of(pattern, count)
    places = [(0.0, 0.0, 0.0), *slots(scenario)]
    assert len(places) == count + 1
    assert min(dist(one, other) for one, other in combinations(places, 2)) >= 10.0
    starts = np.array([follower.start_m for follower in scenario.fleet])
    assert np.array_equal(starts, np.array(places[1:]) - [20.0, 0.0, 0.0])


def test_each_heeds_the_leader_and_whose_slots_are_nearest():
    # 14.1 m along an arm, 20 m across the first rank, 28.3 m to the next but one
    scenario = of("vee", 6)
    assert scenario.formation.leader_gains == dict.fromkeys(scenario.aircraft_names[1:], ONE)
    assert heeded(scenario) == {
        "uav1": ["uav3", "uav2"],
        "uav2": ["uav4", "uav1"],
        "uav3": ["uav1", "uav5"],
        "uav4": ["uav2", "uav6"],
        "uav5": ["uav3", "uav1"],
        "uav6": ["uav4", "uav2"],
    }
    for neighbours, found in (("0", set()), ("3", {3}), ("99", {5})):
        gains = of("vee", 6, neighbours=neighbours).formation.neighbour_gains
        assert {len(whom) for whom in gains.values()} == found


def test_whoever_is_ahead_may_be_all_that_one_heeds():
    assert heeded(of("vee", 6, among="ahead")) == {
        "uav2": ["uav1"],
        "uav3": ["uav1", "uav2"],
        "uav4": ["uav2", "uav1"],
        "uav5": ["uav3", "uav1"],
        "uav6": ["uav4", "uav2"],
    }
    chain = heeded(of("column", 4, among="ahead", neighbours=1))
    assert chain == {"uav2": ["uav1"], "uav3": ["uav2"], "uav4": ["uav3"]}


def test_distances_that_differ_by_rounding_alone_are_the_same():
    near = heeded(of("column", 30, spacing_m="[0.7, 0, 0]"))
    for before, name, after in zip(range(1, 29), range(2, 30), range(3, 31), strict=True):
        assert near[f"uav{name}"] == [f"uav{before}", f"uav{after}"]


def test_gains_of_nothing_are_left_out_and_the_leaders_may_be_some_followers_alone():
    scenario = of("vee", 4, leader_gain=0, neighbour_gain="[1, 1, 0.5]")
    assert scenario.formation.leader_gains == {}
    assert scenario.formation.neighbour_gains["uav1"]["uav2"] == (1.0, 1.0, 0.5)
    assert of("vee", 4, neighbour_gain=0).formation.neighbour_gains == {}
    assert "uav1, uav2, uav3, uav4 cannot tell where to be" in refusal(build, scenario)
    led = "{pattern: vee, count: 4, aircraft: rascal110, leader_gain: 0}"
    scenario = page(led, more="formation: {leader_gains: {uav1: 2}}")
    assert scenario.formation.leader_gains == {"uav1": (2.0, 2.0, 2.0)}
    assert build(scenario).names[1:] == ("uav1", "uav2", "uav3", "uav4")


def test_what_all_have_and_what_one_has_different():
    scenario = load(PATTERN)
    x1, x2, x3, x4, _ = scenario.fleet
    assert [each.name for each in scenario.fleet] == ["x1", "x2", "x3", "x4", "x5"]
    assert (x1.vehicle, x1.tune, x1.sensors.position.sigma_m) == ("ideal", "recorded", 0.3)
    assert (x2.vehicle, x2.sensors.position.sigma_m) == ("jsbsim", 2.0)
    assert (x3.faults, x4.faults) == (x1.faults, ()) and len(x1.faults) == 1
    assert (x4.tune, x4.start_m) == ("autopilot", (-90.0, -20.0, 0.0))
    assert x1.start_m == (-27.0, -6.0, -1.5)


def test_what_the_formation_says_stands_before_the_pattern():
    formation = load(PATTERN).formation
    assert formation.offsets_m["x5"] == (-70.0, -30.0, 5.0)
    assert set(formation.leader_gains) == {"x1", "x2", "x4", "x5"}
    assert formation.neighbour_gains["x5"] == {"x4": (0.5,) * 3, "x1": (2.0,) * 3}


def test_the_resolved_page_is_the_list(tmp_path):
    scenario = load(PATTERN)
    text = dump(scenario)
    assert "pattern:" not in text
    assert loads(text) == loads(text, look=False) == scenario
    assert loads(PATTERN.read_text(), look=False).fleet == scenario.fleet


def test_the_whole_is_changed_before_one_of_it():
    changes = ["fleet.uav9.vehicle=ideal", "fleet.*.sensors=gps-ins", "fleet.count=9"]
    changes += ["fleet.8.sensors=truth", "fleet.spacing_m=[20, 20, 0]", "formation.k=2"]
    changes += ["formation.leader_gains.uav9=null", "fleet.tune=recorded"]
    scenario = of("vee", 3, *changes)
    assert len(scenario.fleet) == 9
    assert [each.vehicle for each in scenario.fleet] == ["jsbsim"] * 8 + ["ideal"]
    assert {each.tune for each in scenario.fleet} == {"recorded"}
    assert scenario.fleet[0].sensors.position.sigma_m == 0.3
    assert scenario.fleet[8].sensors.exact
    assert scenario.formation.offsets_m["uav9"] == (-100.0, 100.0, 0.0)
    assert len(scenario.formation.leader_gains) == 8


def test_a_page_changes_the_pattern_of_another(tmp_path):
    (tmp_path / "base.yaml").write_text(
        HEAD + "fleet: {pattern: vee, count: 3, aircraft: rascal110}\nformation: {k: 2}\n"
    )
    (tmp_path / "top.yaml").write_text("extends: base.yaml\nfleet: {count: 5, neighbours: 1}\n")
    scenario = load(tmp_path / "top.yaml", ["fleet.count=6"])
    assert len(scenario.fleet) == 6 and scenario.formation.k == 2.0
    assert heeded(scenario)["uav5"] == ["uav3"]


def test_a_pattern_in_the_place_of_a_list_is_told_nothing_of_the_lists_aircraft(tmp_path):
    fleet = "{pattern: vee, count: 5, aircraft: rascal110}"
    (tmp_path / "top.yaml").write_text(
        f"extends: simulation-3\nscenario: {{name: top}}\nfleet: {fleet}\n"
        "formation: {leader_gains: {uav2: 2}}\n"
    )
    base, top = load("simulation-3"), load(tmp_path / "top.yaml")
    again = load("simulation-3", ["scenario.published=null", f"fleet={fleet}"])
    assert again.fleet == top.fleet
    for scenario in (top, again):
        assert slots(scenario)[:2] == [(-10.0, 10.0, 0.0), (-10.0, -10.0, 0.0)]
        assert heeded(scenario)["uav2"] == ["uav4", "uav1"]
        assert scenario.formation.kappa_mps == base.formation.kappa_mps
    assert top.formation.leader_gains["uav2"] == (2.0, 2.0, 2.0)
    assert again.formation.leader_gains["uav2"] == ONE


WRONG = [
    (
        "{pattern: wedge, count: 3, aircraft: rascal110}",
        "page.yaml:5:18: fleet.pattern: is 'wedge'",
    ),
    ("{pattern: vee, count: 0, aircraft: rascal110}", "fleet.count: is 0 (write a number at least"),
    (
        "{pattern: vee, cuont: 3, aircraft: rascal110}",
        "fleet.cuont: is not a key of this part: did",
    ),
    ("{pattern: vee, aircraft: rascal110}", "page.yaml:5:1: fleet.count: is missing (write count"),
    ("{name: wing, aircraft: rascal110, start_m: [0, 0, 0]}", "fleet.pattern: is missing (write p"),
    (
        "{pattern: vee, count: 3, aircraft: rascal11}",
        "page.yaml:5:43: fleet.*.aircraft: there is no aircraft 'rascal11'",
    ),
    (
        "{pattern: vee, count: 3, aircraft: rascal110, vehicle: idel}",
        "page.yaml:5:63: fleet.vehicle: is 'idel': did you mean 'ideal'?",
    ),
    (
        "{pattern: vee, count: 3, aircraft: rascal110, sensors: {gps: {rate_hz: 80}}}",
        "page.yaml:5:79: fleet.*.sensors.gps.rate_hz: the gps measures at 80 Hz",
    ),
    (
        "{pattern: column, count: 3, aircraft: rascal110, spacing_m: [5, 4, 0]}",
        "page.yaml:5:72: fleet.spacing_m.1: has 4 m beside, where a column has nobody (write 0, or "
        "pattern: echelon-right)",
    ),
    (
        "{pattern: line-abreast, count: 3, aircraft: rascal110, spacing_m: [5, 5, 0]}",
        "fleet.spacing_m.0: has 5 m behind, where a line-abreast has nobody (write 0, or pattern: "
        "vee)",
    ),
    (
        "{pattern: vee, count: 3, aircraft: rascal110, spacing_m: [5, 0, 0]}",
        "fleet.spacing_m: puts uav2 where uav1 is",
    ),
    (
        "{pattern: grid, count: 3, aircraft: rascal110, spacing_m: [0, 5, 0]}",
        "fleet.spacing_m: puts uav3 where the leader is",
    ),
    (
        "{pattern: vee, count: 3, aircraft: rascal110, agents: {uav7: {tune: recorded}}}",
        "page.yaml:5:69: fleet.agents.uav7: no follower has this name: did you mean 'uav3'? (the "
        "fleet has uav1 to uav3)",
    ),
    (
        "{pattern: vee, count: 3, aircraft: rascal110, agents: {uav2: {tun: recorded}}}",
        "page.yaml:5:70: fleet.1.tun: is not a key of this part: did you mean 'tune'?",
    ),
]


@pytest.mark.parametrize(("fleet", "says"), WRONG)
def test_what_is_wrong_is_said_once_where_it_stands(fleet, says):
    said = refusal(page, fleet)
    assert says in said
    assert len(said.splitlines()) == len(set(said.splitlines())) <= 3


def test_everything_that_is_wrong_with_a_pattern_is_said_at_once():
    said = refusal(page, "{pattern: wedge, count: x, aircraft: 5, neighbours: -1}")
    assert len(said.splitlines()) == 4


def test_an_offset_of_nobody_is_named():
    fleet = "{pattern: vee, count: 3, aircraft: rascal110}"
    said = refusal(page, fleet, more="formation: {offsets_m: {uav4: [1, 2, 3]}}")
    assert "page.yaml:6:31: formation.offsets_m.uav4: no follower has this name" in said


def test_editors_know_the_pattern_and_the_list():
    fleet = json_schema()["properties"]["fleet"]
    assert [next(iter(way)) for way in fleet["anyOf"]] == ["items", "$ref"]
    assert fleet["description"]


@pytest.mark.parametrize("synchronous", ["true", "false"])
def test_of_many_slots_that_are_too_fast_the_worst_is_told(synchronous):
    changes = ["fleet.*.vehicle=ideal", "leader.path.bank_limit_deg=20"]
    changes.append(f"rates.synchronous={synchronous}")
    assert not build(load("vee-30", changes[:1])).notes
    (note,) = build(load("vee-30", changes)).notes
    assert note.text.startswith("uav29, uav30: the slot may move at 19.68 to 41.95 m/s")
    assert note.text.endswith("; and so do the slots of 20 more, less so")
    # a pair of slots each: as many as the table has lines for
    assert len(build(load("vee-30", [*changes, "fleet.count=20"])).notes) == 6


def test_a_follower_that_hears_only_whom_it_heeds_flies_the_same():
    """The paper's law asks for nobody else's messages: to the bit."""
    changes = ["fleet.count=6", "scenario.duration_s=4", "scenario.portions=null", "log.mcap=false"]
    flown = {}
    for hears in ("all", "heeded"):
        watcher = Keeper()
        run = testbed.run(
            load("vee-30", [*changes, f"network.hears={hears}"]), write=False, observers=[watcher]
        )
        flown[hears] = watcher.seen, run.metrics["network"]["links"]
    for of_all, of_some in zip(flown["all"][0], flown["heeded"][0], strict=True):
        assert np.array_equal(of_all, of_some)
    assert {name: len(by) for name, by in flown["all"][1].items()} == {
        "leader": 6,
        **{f"uav{k}": 5 for k in range(1, 7)},
    }
    assert sum(len(by) for by in flown["heeded"][1].values()) == 6 + 6 * 2


class Keeper:
    """Keeps where everybody is."""

    def begin(self, info):
        """Nothing was seen."""
        self.seen = []

    def observe(self, frame):
        """Keep it."""
        self.seen.append(frame.truth.position_ned)

    def end(self, summary, events):
        """Nothing."""
