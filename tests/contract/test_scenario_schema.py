"""Every key of the schema: defaults, full fixture, round trip, and the editor's schema."""

import copy
import os
import random
import re
from collections.abc import Mapping
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import get_args

import jsonschema
import numpy as np
import pytest
import yaml

from testbed.core.numbers import SMALLEST
from testbed.plan.world import build
from testbed.scenario import (
    Scenario,
    ScenarioError,
    dump,
    json_schema,
    list_scenarios,
    load_middle_loop,
    load_scenario,
    loads,
    open_scenario,
    set_duration,
)
from testbed.scenario.fields import Section
from testbed.scenario.middle_loop import Guidance, MiddleLoopFile, MiddleLoopGains
from testbed.scenario.problems import FilePosition
from testbed.scenario.unusual import unusual_numbers
from testbed.scenario.validate import _at, validate
from testbed.scenario.yaml_io import plant, to_inline
from testbed.studies.study_schema import StudyConfig
from testbed.studies.tune_schema import TuneConfig

FOLDER = Path(__file__).parents[1] / "data" / "scenarios"
FIXTURES = sorted(FOLDER.glob("*.yaml"))
EVERY_SCENARIO = [*list_scenarios(), *map(str, FIXTURES)]


@pytest.mark.parametrize("name", EVERY_SCENARIO)
def test_dump_loads_to_equal_scenario(name, monkeypatch, tmp_path):
    scenario = load_scenario(name)
    monkeypatch.chdir(tmp_path)  # a dump does not depend on the working directory
    assert loads(dump(scenario)) == scenario


@pytest.mark.parametrize("name", list_scenarios())
def test_scenario_has_name_question_and_expectation(name):
    header = load_scenario(name).scenario
    assert header.name == name
    assert header.question.endswith("?") and header.expectation


def test_simulation_3_has_the_papers_parameters():
    formation = load_scenario("simulation-3").formation
    assert (formation.k, formation.a, formation.b) == (3.0, 1.0, 0.1)
    assert (formation.c.constant, formation.c.per_speed_squared) == (0.1, 0.0)
    assert formation.altitudes_m == formation.agents == {}
    assert (formation.kappa_mps, formation.speed_mps) == (3.6, (16.0, 30.0))
    assert formation.offsets_m == {
        "uav1": (-5.0, 5.0, 0.0),
        "uav2": (-5.0, -5.0, -4.0),
        "uav3": (-5.0, -5.0, 4.0),
    }
    one = (1.0, 1.0, 1.0)
    assert formation.leader_gains == {"uav1": one, "uav2": one, "uav3": one}
    assert formation.neighbour_gains == {"uav2": {"uav1": one}, "uav3": {"uav2": one}}


def test_defaults_are_as_documented():
    scenario = load_scenario(FOLDER / "minimal.yaml")
    rates = scenario.rates
    assert (rates.physics_hz, rates.autopilot_hz, rates.control_hz) == (100, 50, 25)
    assert (rates.broadcast_hz, rates.log_hz) == (25, 25)
    assert scenario.leader.sensors.exact and scenario.fleet[0].sensors.exact
    assert scenario.leader.path.bank_limit_deg == 30.0
    assert scenario.leader.start.altitude_m == 100.0
    assert scenario.formation.leader_gains == {}
    assert scenario.scenario.origin.latitude_deg == 38.0
    assert scenario.log.mcap is True
    assert rates.synchronous is True
    assert scenario.leader.vehicle == scenario.fleet[0].vehicle == "jsbsim"
    controller = scenario.controller
    assert (controller.law, controller.options) == ("hbh23", {})
    assert set(controller.estimators.model_dump().values()) == {None}
    assert (controller.pitch_feedforward, controller.bounded_speed) == ("none", "ground_speed")
    assert (controller.leader_timeout_s, controller.on_leader_timeout) == (5.0, "straight")
    assert scenario.network.transmitter_off_s == {}
    assert scenario.air.wind.speed_mps == 0.0
    assert scenario.leader.faults == scenario.fleet[0].faults == ()
    on_failure = scenario.formation.on_failure
    assert (on_failure.response, on_failure.declared_after_s) == ("ignore", 2.0)
    assert scenario.expect.model_dump() == {}
    assert scenario.limits.model_dump() == {
        "collision_m": None,
        "separation_m": None,
        "min_separation_m": None,
        "overspeed_mps": None,
        "stall_deg": None,
        "formation_lost_m": 100.0,
        "on_loss": "stop",
        "on_limit_exceeded": "continue",
    }


# Kinds that exclude those of everything.yaml: paths, winds, and of the network traces and TDMA.
VIRTUAL = "leader.path={{kind: virtual, speed_mps: 21, curve: {{{}}}}}"
ARDUPLANE = "{kind: ardupilot, start: false, instance: 7, timeout_s: 20.0}"
SITL = "{kind: virtual, gyro_filter: sitl}"
EXTERNAL = "{kind: external, failsafe_s: 3.0, lockstep: true, timeout_s: 5.0}"
MISSION = (
    "{kind: mission, airspeed_mps: 21.0, bank_limit_deg: 25.0, climb_limit_mps: 1.0, "
    "waypoint_radius_m: 80.0, legs: [{kind: waypoints, laps: 1, points_m: [[600.0, 0.0, 90.0], "
    "[0.0, 0.0, 90.0]]}]}"
)
OTHER_KINDS = [
    VIRTUAL.format("kind: straight, climb_mps: 1"),
    VIRTUAL.format("kind: circle, radius_m: 200, direction: anticlockwise, climb_mps: -0.5"),
    VIRTUAL.format("kind: figure-eight, radius_m: 180, direction: anticlockwise"),
    VIRTUAL.format("kind: weave, amplitude_m: 30, period_s: 25"),
    VIRTUAL.format("kind: speed-change, amplitude_mps: 2, period_s: 30"),
    "leader.path={kind: replay, file: arduplane-auto-leader-rascal.csv}",
    "air.wind={file: gusty-wind.csv, max_gap_s: 2, profile: {kind: uniform}}",
    "air.wind={speed_mps: 5, profile: {kind: power, height_m: 20, exponent: 0.2}}",
    "network={trace: {file: gusty-wind.csv, random_start: true, begin_s: 2}, message_bytes: 120, "
    "tdma: {frame_s: 0.1, order: [uav2, lead, uav1], packets: 2, queue_packets: 3}}",
    "formation.control_function={example: own, function: 'gentle_functions:mu'}",
    "formation.barrier={example: own, function: 'gentle_functions:h'}",
    "formation.speed_model={f: 'drag_and_propeller:f', g: 'drag_and_propeller:g'}",
    "formation.agents.uav2={speed_model: {f: 'drag_and_propeller:f', g: 'drag_and_propeller:g'}}",
    f"leader={{name: lead, aircraft: rascal110, autopilot: {ARDUPLANE}, path: {MISSION}}}",
    f"leader={{name: lead, aircraft: rascal110, commanded_by: {EXTERNAL}, path: {MISSION}}}",
    f"leader={{name: lead, aircraft: rascal110, autopilot: {SITL}, path: {MISSION}}}",
    f"fleet.1={{name: uav2, aircraft: rascal110, autopilot: {ARDUPLANE}, start_m: [-40, -10, 0]}}",
]
# Keys with a single value.
BY_KIND = ("ByFormation", "VirtualAutopilot", "External", "ArduPlane")
SINGLE_VALUE = {(kind, "kind") for kind in ("Bernoulli", *BY_KIND)}
# A key of every fault that a check refuses for this kind.
REFUSED = {("BatteryLow", "duration_s")}


def _sections(value):
    """Yield every section of a scenario, at any depth."""
    if isinstance(value, Section):
        yield value
        value = dict(value)
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple):
        for item in value:
            yield from _sections(item)


def _set_keys(data):
    """Return (section, key) of all keys that are set, and of those that differ from the default."""
    present, changed = set(), set()
    for section in _sections(Scenario.model_validate(data)):
        kind = type(section)
        for key in section.model_fields_set & kind.model_fields.keys():  # not names of bounds
            field = kind.model_fields[key]
            present.add((kind.__name__, key))
            if field.is_required() or getattr(section, key) != field.get_default():
                changed.add((kind.__name__, key))
    return present, changed


def _every_key():
    """Return (section, key) of every key of the schema."""
    waiting, found = [Scenario], set()
    while waiting:
        kind = waiting.pop()
        if kind not in found:
            found.add(kind)
            waiting += [
                each for field in kind.model_fields.values() for each in _kinds(field.annotation)
            ]
    return {(kind.__name__, key) for kind in found for key in kind.model_fields}


def _kinds(annotation):
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for part in get_args(annotation):
        yield from _kinds(part)


def _other(text):
    """Return keys and value of one of OTHER_KINDS."""
    where, _, value = text.partition("=")
    keys = [int(key) if key.isdigit() else key for key in where.split(".")]
    return keys, yaml.safe_load(value)


def test_full_fixture_sets_every_key():
    text = (FOLDER / "everything.yaml").read_text()
    present, changed = _set_keys(yaml.safe_load(text))
    for other in OTHER_KINDS:
        data = yaml.safe_load(text)
        (*parts, key), value = _other(other)
        reduce(getitem, parts, data)[key] = value
        more, otherwise = _set_keys(data)
        present, changed = present | more, changed | otherwise
    assert len(present) > 370
    assert _every_key() - present == REFUSED
    assert present - changed == SINGLE_VALUE


@pytest.mark.parametrize("other", OTHER_KINDS)
def test_other_kinds_are_read_in_full(other):
    full = load_scenario(FOLDER / "everything.yaml", [other])
    assert loads(dump(full)) == full
    keys, expected = _other(other)
    found = reduce(getitem, keys, full.model_dump(mode="json"))
    for name, value in expected.items():
        assert found[name] == value


def test_full_fixture_is_read_as_written():
    full = load_scenario(FOLDER / "everything.yaml")
    assert full.fleet[0].sensors.position.sigma_m == 0.3
    assert full.fleet[1].sensors.velocity.sigma_mps == 0.0
    assert full.formation.leader_gains["uav1"] == (1.0, 1.0, 0.5)
    assert full.formation.neighbour_gains["uav2"]["uav1"] == (2.0, 3.0, 4.0)
    assert full.formation.altitudes_m == {"uav2": 115.0}
    assert full.formation.c.per_speed_squared == 0.0004
    own = full.formation.agents["uav1"]
    assert (own.c.constant, own.c.per_speed_squared) == (0.2, 0.0)
    assert (own.control_function.example, own.barrier.example) == (2, 7)
    assert own.speed_desired_mps == (19.0, 27.0)
    controller = full.controller
    assert controller.extrapolate_from == "timestamp"
    assert controller.law == f"{FOLDER / 'slower.py'}:Slower"
    options = {"by_mps": 0.5, "axes": (1.0, 2.5), "loud": False, "mark": "x"}
    assert controller.options == options
    assert controller.estimators.leader_acceleration_blend == (0.5, 0.6, 0.1)
    assert full.network.transmitter_off_s == {"lead": ((5.0, 6.0), (8.0, 12.5))}
    assert full.leader.path.legs[1].levels[0].turns == 1.5
    assert full.leader.sensors.gps.own_drift_m == (0.5, 1.0)
    assert full.leader.faults[2].offset_m == (20.0, -10.0, 5.0)
    assert full.fleet[0].faults[5].when.below == 0.5


def test_full_fixture_can_be_built():
    # a Rascal has no battery
    fuel = ["leader.battery=null", "fleet.uav1.battery=null"]
    fuel += ["fleet.uav1.faults.5={kind: engine-out, at_s: 16}"]
    world = build(load_scenario(FOLDER / "everything.yaml", fuel))
    assert world.names == ("lead", "uav1", "uav2")
    written = [(each.source, each.begin_s, each.end_s) for each in world.formation.outages.windows]
    assert written[:3] == [("lead", 5.0, 6.0), ("lead", 8.0, 12.5), ("run", 16.0, 18.0)]
    assert sorted(written[3:]) == [("run", 3.0, 3.5), ("run", 9.0, 10.0), ("run", 15.0, 15.5)]
    assert np.array_equal(world.formation.altitudes, [np.nan, 115.0], equal_nan=True)
    assert sum(len(group.rows) for group in world.formation.control.groups) == 2


@pytest.mark.parametrize("name", EVERY_SCENARIO)
def test_json_schema_accepts_resolved_scenario(name):
    data = load_scenario(name).model_dump(mode="json", by_alias=True)
    assert not [*jsonschema.Draft202012Validator(json_schema()).iter_errors(data)]


@pytest.mark.parametrize(
    "wrong",
    [
        {"rates": {"physic_hz": 200}},
        {"rates": {"physics_hz": "fast"}},
        {"fleet": [{"sensors": "gps-inz"}]},
        {"fleet": [{"sensors": {"preset": "gps-inz"}}]},
        {"fleet": [{"sensors": {"gps": {"rate_hz": 0}}}]},
        {"leader": {"faults": [{"kind": "engine-off"}]}},
        {"leader": {"faults": [{"kind": "surface-stuck", "surface": "flap"}]}},
        {"leader": {"path": {"kind": "mission", "legs": [{"kind": "waypoint"}]}}},
        {"formation": {"leader_gains": {"uav1": [1, 2]}}},
    ],
)
def test_json_schema_refuses_wrong_values(wrong):
    validator = jsonschema.Draft202012Validator(json_schema())
    assert not validator.is_valid(wrong)
    assert validator.is_valid({"extends": "simulation-3"})


def test_every_key_has_description_and_unit():
    schema = json_schema()
    units = {"_m": "m", "_s": "s", "_hz": "Hz", "_deg": "degrees", "_mps": "m/s", "_per_s": "1/s"}
    units |= {"bit_per_s": "bit/s", "_pa": "Pa", "_dps": "degrees/s", "_rthz": "per root hertz"}
    units |= {"_c": "°C", "_radps": "rad/s", "_radps2": "rad/s²", "_mps2": "m/s²", "_mps3": "m/s³"}
    sections = [schema, *schema["$defs"].values()]
    # A section with alternatives keeps its fields one level further down.
    sections += [choice for section in sections for choice in section.get("anyOf", ())]
    fields = [item for section in sections for item in section.get("properties", {}).items()]
    assert len(fields) > 60
    for key, field in fields:
        section = schema["$defs"][field["$ref"].rsplit("/", 1)[1]] if "$ref" in field else {}
        assert field.get("description") or section.get("description"), key
        suffix = max((s for s in units if key.endswith(s)), key=len, default=None)
        if suffix and "$ref" not in field:
            assert units[suffix] in field["description"], (key, field["description"])


@pytest.mark.parametrize(
    "sensors",
    ["degraded", {"preset": "pixhawk", "gps": {"rate_hz": 1}, "gyro": None}, {"airspeed": {}}],
)
def test_json_schema_accepts_presets(sensors):
    assert jsonschema.Draft202012Validator(json_schema()).is_valid({"leader": {"sensors": sensors}})


def test_scenario_is_frozen():
    scenario = load_scenario(FOLDER / "minimal.yaml")
    with pytest.raises(ValueError, match="frozen"):
        scenario.formation.k = 4.0


def test_set_duration_drops_what_begins_later():
    short = set_duration(load_scenario(FOLDER / "everything.yaml"), 14.0)
    assert short.scenario.duration_s == 14.0
    assert short.scenario.windows == {"straight": (5.0, 10.0), "turn": (12.5, 14.0)}
    assert set(short.scenario.published.rms_m) == {"straight"}
    assert [fault.at_s for fault in short.leader.faults] == [2.0, 3.0, 8.0, 12.0]
    assert [fault.at_s for fault in short.fleet[0].faults] == [4.0, 9.0, 10.0, 11.0]
    shorter = set_duration(short, 5.0)
    assert shorter.scenario.windows == {}
    assert shorter.scenario.published.mean_rms_m == {}
    assert loads(dump(shorter)) == shorter


@pytest.mark.parametrize(
    "text", ["no", "1e-2", "08", "1_000", "12:30", "null", "~", "", "- x", "é: #"]
)
def test_odd_text_survives_the_round_trip(text):
    scenario = load_scenario(FOLDER / "minimal.yaml")
    data = scenario.model_dump(by_alias=True)
    data["scenario"]["question"] = text
    scenario = Scenario.model_validate(data)
    assert loads(dump(scenario)).scenario.question == text


# Numbers without bounds, and why.
UNBOUNDED = {
    "expect": "any number bounds a metric",
    "scenario.schema": "the version is 2",
    "scenario.published.percent_error": "of a publication, and of no effect on a flight",
    "control_function.example": "a choice",
    "barrier.example": "a choice",
    "controller.options": "of the user's own law",
    "controller.gains": "has the bounds of middle_loop.yaml",
    "trace.begin_s": "in the time of the trace, which may be that of a clock",
}
BOUNDS = [{"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}]


def numbers(schema, node, path=(), seen=()):
    """Yield every number of a JSON schema with its path."""
    if "$ref" in node:
        name = node["$ref"].rsplit("/", 1)[1]
        if name not in seen:
            yield from numbers(schema, schema["$defs"][name], path, (*seen, name))
        return
    if node.get("type") in ("number", "integer"):
        yield ".".join(path), node
    for key in ("anyOf", "oneOf", "prefixItems"):
        for each in node.get(key, ()):
            yield from numbers(schema, each, path, seen)
    for key, each in node.get("properties", {}).items():
        yield from numbers(schema, each, (*path, key), seen)
    for key in ("items", "additionalProperties"):
        if isinstance(node.get(key), dict):
            yield from numbers(schema, node[key], path, seen)
    for each in node.get("patternProperties", {}).values():
        yield from numbers(schema, each, path, seen)


@pytest.mark.parametrize("model", [Scenario, MiddleLoopFile, Guidance])
def test_every_number_has_bounds(model):
    schema = model.model_json_schema(by_alias=True)
    found = list(numbers(schema, schema))
    without = {path for path, node in found if not all(each & node.keys() for each in BOUNDS)}
    assert len(found) > 5
    assert {path for path in without if not any(each in path for each in UNBOUNDED)} == set()


@pytest.mark.parametrize("model", [Scenario, MiddleLoopFile, Guidance, StudyConfig, TuneConfig])
def test_no_number_is_positive_in_name_only(model):
    """A bound `> 0` lets 5e-324 pass, by which quotients overflow: SMALLEST is the bound."""
    schema = model.model_json_schema(by_alias=True)
    found = [(path, node) for path, node in numbers(schema, schema) if node["type"] == "number"]
    assert [path for path, node in found if node.get("exclusiveMinimum") == 0] == []


# Numbers of which 0 switches an effect off, and which divide otherwise.
ZERO_IS_OFF = ("bit_per_s", "resolution_s", "smoothing_s")


def test_tiny_numbers_are_refused_with_their_key():
    """Each number that must be positive, also in lists and maps, of a scenario with every key."""
    found = [
        (data, key)
        for data, key, bounds in every_number()
        if named(key) in ZERO_IS_OFF or bounds.get("minimum") == SMALLEST
    ]
    assert len(found) > 60
    for data, key in found if os.environ.get("TESTBED_NUMBERS") else found[::3]:
        for tiny in (5e-324, 9e-7):
            with pytest.raises(ScenarioError) as caught:
                with_number(data, key, tiny)
            problem = caught.value.problems[0]
            assert key.startswith(".".join(problem.path)), key
            assert re.search("a number at least 1e-06|must be above 0", problem.text), problem


def leaves(value, path=()):
    """Yield the paths of all numbers in plain data."""
    if isinstance(value, dict | list):
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        for key, each in pairs:
            yield from leaves(each, (*path, str(key)))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


# Numbers without a usual limit: warned of by another rule, see the tests below, or with bounds of
# their nature.
WARNED_ELSEWHERE = {"a", "c", "constant", "speed_pole_per_s", "gain_scale"}
NATURAL = {
    "seed": "any whole number",
    "latitude_deg": "the earth",
    "longitude_deg": "the earth",
    "elevation_m": "the earth",
    "temperature_c": "the weather",
    "from_deg": "a circle",
    "towards_deg": "a circle",
    "course_deg": "a circle",
    "instance": "numbers processes",
}


def named(key):
    """Return the last part of a key that is no index; "": there is none."""
    return next((part for part in reversed(key.split(".")) if not part.isdigit()), "")


def every_number():
    """Yield plain data of a scenario, path and bounds of each number of the schema."""
    file = open_scenario(FOLDER / "everything.yaml")
    schema = Scenario.model_json_schema(by_alias=True)
    seen = set()
    for other in ["log.mcap=false", *OTHER_KINDS]:
        data = file.resolve([other]).model_dump(mode="json", by_alias=True)
        tree = plant(data, FilePosition(""))
        validate(tree, Scenario)  # what is refused below is refused for its number
        for path in leaves(data):
            key = ".".join(path)
            if key not in seen and not any(each in key for each in UNBOUNDED):
                seen.add(key)
                yield data, key, bounds_at(schema, tree, path)


def bounds_at(schema, tree, path):
    """Return the JSON schema of the number at a path, also where it stands for a list or a map."""
    while True:
        found = [node for _, node in numbers(schema, _at(schema, tree, path, follow=False))]
        if found:
            return found[0]
        path = path[:-1]


def with_number(data, key, number):
    """Return the scenario of plain data with another number.

    Raises:
        ScenarioError: it is refused.
    """
    data = copy.deepcopy(data)
    *parts, last = (int(part) if part.isdigit() else part for part in key.split("."))
    reduce(getitem, parts, data)[last] = number
    return validate(plant(data, FilePosition("")), Scenario)


def limits(bounds):
    """Return the smallest and the largest allowed number."""
    low, high = (next(bounds[key] for key in keys if key in bounds) for keys in BOUNDS_OF_NUMBER)
    step = 1 if bounds["type"] == "integer" else 0
    least = low if "minimum" in bounds else low + step if step else np.nextafter(low, high)
    most = high if "maximum" in bounds else high - step if step else np.nextafter(high, low)
    return least, most


BOUNDS_OF_NUMBER = [("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")]


def test_absurd_numbers_are_refused_or_warned_of():
    """Each number of the schema at its bounds and beyond; TESTBED_NUMBERS=1 takes all of them."""
    every = list(every_number())
    assert len(every) > 350
    if not os.environ.get("TESTBED_NUMBERS"):
        every = random.Random("bounds").sample(every, 60)
    for data, key, bounds in every:
        least, most = limits(bounds)
        for beyond in (2 * most + 1, least - abs(least) / 2 - (least <= 0)):
            beyond = int(beyond) if bounds["type"] == "integer" else beyond
            with pytest.raises(ScenarioError) as caught:
                with_number(data, key, beyond)
            problem = caught.value.problems[0]
            assert key.startswith(".".join(problem.path)), (key, beyond, problem)
            assert re.search("write a number (at |above|below)|above 0", problem.text), problem
        name = named(key)
        flown = not key.startswith("scenario.published.")
        if name in NATURAL or name in WARNED_ELSEWHERE or most <= 1 or not flown:
            continue
        for number in (most, least) if least <= -most else (most,):
            try:
                texts = list(unusual_numbers(with_number(data, key, number)))
            except ScenarioError:
                continue
            assert any(named(text.partition(" is ")[0]) == name for text in texts), (
                key,
                number,
                texts,
            )


def test_absurd_gains_are_refused_or_warned_of():
    """As above, of the middle loop."""
    schema = MiddleLoopGains.model_json_schema()
    data = load_middle_loop("rascal110", "tuned").model_dump(mode="json")
    tree, usual = plant(data, FilePosition("")), load_scenario("simulation-3")
    found = [(path, _at(schema, tree, path)) for path in leaves(data)]
    assert len(found) > 25
    for path, bounds in found:
        key = ".".join(path)
        if path[0] == "estimators":  # shares, which controller.estimators changes
            continue
        least, most = limits(bounds)
        change = to_inline(float(most))
        for part in reversed(path):
            change = f"{{{part}: {change}}}"
        changed = load_scenario("simulation-3", [f"controller.gains={change}"])
        if most > 1:
            (text,) = unusual_numbers(changed)
            assert text.startswith(f"controller.gains.{key} is "), key
        assert [*unusual_numbers(usual)] == []


@pytest.mark.parametrize("change", ["a=1000", "c=1000", "c.constant=1000", "speed_pole_per_s=1000"])
def test_absurd_rates_of_the_law_are_warned_of(change):
    """What is usual of them depends on the control period."""
    change = change.replace("c.constant=1000", "c={constant: 1000, per_speed_squared: 0.001}")
    world = build(load_scenario("simulation-3", [f"formation.{change}"]))
    key = f"formation.{change.partition('=')[0]} has a gain of "
    assert any(key in each.text for each in world.initial_events)


def test_absurd_scale_of_gains_is_warned_of():
    world = build(load_scenario("simulation-3", ["controller.gain_scale=100"]))
    assert any("controller.gain_scale: 100" in each.text for each in world.initial_events)


def test_shipped_scenarios_have_usual_numbers():
    for name in list_scenarios():
        assert list(unusual_numbers(load_scenario(name))) == [], name


def test_unusual_numbers_are_warned_of():
    """One warning for like keys, before the flight; also for gains of the middle loop."""
    changes = ["fleet.*.sensors={position: {sigma_m: 1000, time_constant_s: 1}}"]
    changes += ["controller.gains={course: {p: 50}}", "leader.start.north_m=-20000"]
    world = build(load_scenario("simulation-3", changes))
    texts = [each.text for each in world.initial_events if "usual are" in each.text]
    assert texts == [
        "leader.start.north_m is -20000; usual are up to -10000",
        "fleet.0.sensors.position.sigma_m is 1000, and 2 more such numbers; usual are up to 200",
        "controller.gains.course.p is 50; usual are up to 20",
    ]
    assert "" not in [each.text for each in world.initial_events]


def test_absurd_numbers_are_refused_with_their_key():
    """Each number of a scenario with every key, replaced by one that no flight has."""
    file = open_scenario(FOLDER / "everything.yaml")
    data = file.resolve().model_dump(mode="json", by_alias=True)
    paths = [".".join(path) for path in leaves(data)]
    paths = [path for path in paths if not any(each in path for each in UNBOUNDED)]
    rng = random.Random("absurd")
    chosen = paths if os.environ.get("TESTBED_MUTATIONS") else rng.sample(paths, 30)
    assert len(paths) > 100
    for path in chosen:
        for value in rng.sample(["1e300", "-1e12", "1e12", ".nan", ".inf", "-.inf"], 2):
            with pytest.raises(ScenarioError) as caught:
                file.resolve([f"{path}={value}"])
            assert any(path.startswith(".".join(p.path)) for p in caught.value.problems), path
