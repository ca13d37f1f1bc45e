"""Every key of the schema: defaults, full fixture, round trip, and the editor's schema."""

import copy
import os
import random
import re
from collections.abc import Mapping
from functools import cache, reduce
from operator import getitem
from typing import get_args

import jsonschema
import numpy as np
import pytest
import yaml
from cases import some
from places import TESTS
from run_flight import small_grids
from snapshot import check_snapshot

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
from testbed.tuning.tune_schema import TuneConfig

FOLDER = TESTS / "data" / "scenarios"
FIXTURES = sorted(FOLDER.glob("*.yaml"))
EVERY_SCENARIO = [*list_scenarios(), *map(str, FIXTURES)]


@cache
def schema_validator():
    return jsonschema.Draft202012Validator(json_schema())


# what the fixtures have are all keys
@pytest.mark.parametrize("name", [*some(list_scenarios(), 12), *map(str, FIXTURES)])
def test_dump_loads_to_equal_scenario(name, monkeypatch, tmp_path):
    """What it resolves to also obeys the editor's schema."""
    scenario = load_scenario(name)
    assert not [*schema_validator().iter_errors(scenario.model_dump(mode="json", by_alias=True))]
    monkeypatch.chdir(tmp_path)  # a dump does not depend on the working directory
    assert loads(dump(scenario)) == scenario


def test_defaults_and_full_fixture_are_as_reviewed():
    """Each key's default, also those of a scenario with few keys, and the one with every key."""
    lines = sorted(
        f"{section.__name__}.{key}: {field.get_default()!r}"
        for section in sections_of(Scenario)
        for key, field in section.model_fields.items()
        if not isinstance(field.get_default(), Section)
    )
    for name in ("minimal", "everything"):
        values = load_scenario(FOLDER / f"{name}.yaml").model_dump(mode="json", by_alias=True)
        text = yaml.safe_dump(values, sort_keys=False, width=100, allow_unicode=True)
        lines += ["", f"{name}.yaml:", *text.replace(str(FOLDER.parents[2]), ".").splitlines()]
    check_snapshot("scenario_defaults", "\n".join(lines))


@pytest.mark.parametrize("name", list_scenarios())
def test_scenario_has_name_question_and_expectation(name):
    header = load_scenario(name).scenario
    assert header.name == name
    assert header.question.endswith("?") and header.expectation


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
    VIRTUAL.format("kind: circle, bank_deg: 35, direction: anticlockwise, climb_mps: -0.5"),
    VIRTUAL.format("kind: figure-eight, radius_m: 180, direction: anticlockwise"),
    VIRTUAL.format("kind: weave, amplitude_m: 30, period_s: 25"),
    VIRTUAL.format("kind: speed-change, amplitude_mps: 2, period_s: 30"),
    "leader.path={kind: replay, file: arduplane-auto-leader-rascal.csv}",
    "air.wind={file: gusty-wind.csv, max_gap_s: 2, profile: {kind: uniform}}",
    "air.wind={speed_mps: 5, profile: {kind: power, height_m: 20, exponent: 0.2}}",
    "network={trace: {file: gusty-wind.csv, random_start: true, begin_s: 2}, message_bytes: 120, "
    "tdma: {frame_s: 0.1, order: [uav2, lead, uav1], packets: 2, queue_packets: 3}}",
    "controller.companion={link: mavlink, acceleration: imu}",
    "formation.control_function={example: own, function: 'gentle_functions:mu'}",
    "formation.barrier={example: own, function: 'gentle_functions:h'}",
    "formation.speed_model={f: 'drag_and_propeller:f', g: 'drag_and_propeller:g'}",
    "formation.agents.uav2={speed_model: {f: 'drag_and_propeller:f', g: 'drag_and_propeller:g'}}",
    f"leader={{name: lead, aircraft: rascal110, autopilot: {ARDUPLANE}, path: {MISSION}}}",
    f"leader={{name: lead, aircraft: rascal110, commanded_by: {EXTERNAL}, path: {MISSION}}}",
    f"leader={{name: lead, aircraft: rascal110, fuel_burn: true, path: {MISSION}}}",
    f"leader={{name: lead, aircraft: rascal110, autopilot: {SITL}, path: {MISSION}}}",
    f"fleet.1={{name: uav2, aircraft: rascal110, autopilot: {ARDUPLANE}, start_m: [-40, -10, 0]}}",
]
# Keys with a single value.
BY_KIND = ("ByFormation", "VirtualAutopilot", "External", "ArduPlane")
SINGLE_VALUE = {(kind, "kind") for kind in ("Bernoulli", *BY_KIND)}
# A key of every fault that a check refuses for this kind.
REFUSED = {("BatteryLow", "duration_s")}
# Keys of flights that begin as another one: not beside commands from outside.
REFUSED |= {("Header", "begin"), ("Begin", "scenario"), ("Begin", "at_s")}
# Of a law that is an FMU; that of the fixture is a class.
REFUSED |= {("Controller", "map")}


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


def sections_of(section):
    """Return a kind of section, and every kind below it."""
    waiting, found = [section], set()
    while waiting:
        kind = waiting.pop()
        if kind not in found:
            found.add(kind)
            waiting += [
                each for field in kind.model_fields.values() for each in _kinds(field.annotation)
            ]
    return found


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
    full = yaml.safe_load((FOLDER / "everything.yaml").read_text())
    present, changed = _set_keys(full)
    for other in OTHER_KINDS:
        data = copy.deepcopy(full)
        (*parts, key), value = _other(other)
        reduce(getitem, parts, data)[key] = value
        more, otherwise = _set_keys(data)
        present, changed = present | more, changed | otherwise
    assert len(present) > 370
    every = {(kind.__name__, key) for kind in sections_of(Scenario) for key in kind.model_fields}
    assert every - present == REFUSED
    assert present - changed == SINGLE_VALUE


@pytest.mark.parametrize("other", OTHER_KINDS)
def test_other_kinds_are_read_in_full(other):
    full = load_scenario(FOLDER / "everything.yaml", [other])
    assert loads(dump(full)) == full
    keys, expected = _other(other)
    found = reduce(getitem, keys, full.model_dump(mode="json"))
    for name, value in expected.items():
        assert found[name] == value


def test_full_fixture_can_be_built(monkeypatch):
    small_grids(monkeypatch)  # of its turbulence, in which nothing flies here
    # a Rascal has no battery and burns no fuel
    fuel = ["leader.battery=null", "fleet.uav1.battery=null"]
    fuel += ["fleet.uav1.fuel_burn=false"]
    fuel += ["fleet.uav1.faults.5={kind: engine-out, at_s: 16}"]
    world = build(load_scenario(FOLDER / "everything.yaml", fuel))
    assert world.names == ("lead", "uav1", "uav2")
    written = [(each.source, each.begin_s, each.end_s) for each in world.formation.outages.windows]
    assert written[:3] == [("lead", 5.0, 6.0), ("lead", 8.0, 12.5), ("run", 16.0, 18.0)]
    assert sorted(written[3:]) == [("run", 3.0, 3.5), ("run", 9.0, 10.0), ("run", 15.0, 15.5)]
    assert np.array_equal(world.formation.altitudes, [np.nan, 115.0], equal_nan=True)
    assert sum(len(group.rows) for group in world.formation.control.groups) == 2


def test_json_schema_accepts_and_refuses():
    cases = yaml.safe_load((FOLDER.parent / "json_schema.yaml").read_text("utf-8"))
    validator = schema_validator()
    assert [each for each in cases["valid"] if not validator.is_valid(each)] == []
    assert [each for each in cases["invalid"] if validator.is_valid(each)] == []


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


def test_scenario_is_frozen():
    scenario = load_scenario(FOLDER / "minimal.yaml")
    with pytest.raises(ValueError, match="frozen"):
        scenario.formation.k = 4.0


def test_set_duration_drops_what_begins_later():
    short = set_duration(load_scenario(FOLDER / "everything.yaml"), 14.0)
    assert short.scenario.duration_s == 14.0
    assert short.scenario.windows == {"straight": (5.0, 10.0), "turn": (12.5, 14.0)}
    assert short.scenario.question and not short.scenario.expectation
    assert set(short.scenario.published.rms_m) == {"straight"}
    assert [fault.at_s for fault in short.leader.faults] == [2.0, 3.0, 8.0, 12.0]
    assert [fault.at_s for fault in short.fleet[0].faults] == [4.0, 9.0, 10.0, 11.0]
    shorter = set_duration(short, 5.0)
    assert shorter.scenario.windows == {"second_half": (2.5, 5.0)}
    assert shorter.scenario.published.mean_rms_m == {}
    assert loads(dump(shorter)) == shorter


def test_expectation_is_of_the_whole_flight():
    whole = load_scenario("simulation-3")
    assert whole.scenario.expectation
    for duration_s in (1080.0, 1200.0):
        assert set_duration(whole, duration_s).scenario.expectation == whole.scenario.expectation
    assert not set_duration(whole, 1079.0).scenario.expectation


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
    for data, key in found if os.environ.get("TESTBED_NUMBERS") else found[::12]:
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


@cache
def every_number():
    """Return plain data of a scenario, path and bounds of each number of the schema."""
    file = open_scenario(FOLDER / "everything.yaml")
    schema = Scenario.model_json_schema(by_alias=True)
    seen, found = set(), []
    for other in ["log.mcap=false", *OTHER_KINDS]:
        data = file.resolve([other]).model_dump(mode="json", by_alias=True)
        tree = plant(data, FilePosition(""))
        validate(tree, Scenario)  # what is refused below is refused for its number
        for path in leaves(data):
            key = ".".join(path)
            if key not in seen and not any(each in key for each in UNBOUNDED):
                seen.add(key)
                found.append((data, key, bounds_at(schema, tree, path)))
    return found


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
    every = every_number()
    assert len(every) > 350
    if not os.environ.get("TESTBED_NUMBERS"):
        every = random.Random("bounds").sample(every, 30)
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
        flown = not key.startswith(("scenario.published.", "controller.companion.flight."))
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
