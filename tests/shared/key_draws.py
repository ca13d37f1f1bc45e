"""Draws of a scenario, one of its keys, and values of this key; and what a flight with them is."""

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from testbed import run
from testbed.core.errors import InputError
from testbed.plan.world import build
from testbed.runs.run import EXIT_CODES
from testbed.scenario import Scenario, list_scenarios, load_scenario
from testbed.scenario.set_keys import SetKeys

FLOWN_S = 3.0
LARGEST = 20  # aircraft; the others have the same keys
SHARES = (1.0, 0.5, 0.1, 0.01, 1e-3)  # of the way to a bound, the first that can be flown
# sections that the files, names and exit code of every run have, or aircraft alone
LEFT_OUT = (("log",), ("expect",), ("scenario",), ("controller", "companion", "flight"))
# maps that name aircraft; an empty one gets the first follower
BY_NAME = ("agents", "clocks", "broadcast", "links")


@dataclass(frozen=True)
class Draw:
    """A key of a scenario with a value, and its bounds or what else it can be."""

    scenario: str
    key: str
    value: object
    others: tuple

    def __str__(self):
        return f"{self.scenario}: {self.key}={json.dumps(self.value)}"


def schema_of(model=Scenario):
    return model.model_json_schema(by_alias=True)


SCHEMA = schema_of()


def resolved(node):
    while "$ref" in node:
        extra = {key: each for key, each in node.items() if key != "$ref"}
        node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]] | extra
    return node


def branches(node):
    node = resolved(node)
    found = []
    for key in ("anyOf", "oneOf", "allOf"):
        for each in node.get(key, ()):
            found += branches(each)
    return found or [node]


def leaves(node, data, path, names):
    """Yield path, schema and present value of each number, flag and choice."""
    options = [each for each in branches(node) if each.get("type") != "null"]
    objects = [each for each in options if "properties" in each]
    maps = [each for each in options if isinstance(each.get("additionalProperties"), dict)]
    if objects:
        chosen = objects[0]
        if isinstance(data, dict):
            tags = {key: data[key] for key in ("kind", "example") if key in data}
            for each in objects:
                consts = {
                    key: [each["properties"].get(key, {}).get("const")]
                    + each["properties"].get(key, {}).get("enum", [])
                    for key in tags
                }
                if all(tags[key] in consts[key] for key in tags):
                    chosen = each
        for key, child in chosen["properties"].items():
            if key in ("name", "kind", "preset", "example") or (*path, key) in LEFT_OUT:
                continue
            value = data.get(key) if isinstance(data, dict) else None
            yield from leaves(child, value, (*path, key), names)
    elif maps:
        known = data or {}
        if not known and path[-1] in BY_NAME:
            known = {names[0 if path[-1] == "links" else 1]: None}
        if not known and path[-2:-1] == ("links",):
            known = {names[1]: None}
        for key in list(known)[:2]:
            child = maps[0]["additionalProperties"]
            yield from leaves(child, known[key], (*path, key), names)
    elif any(each.get("type") == "array" for each in options):
        array = next(each for each in options if each.get("type") == "array")
        items = array.get("prefixItems")
        if items is None and isinstance(data, list) and data and isinstance(data[0], dict):
            for index, each in enumerate(data[:2]):
                yield from leaves(array["items"], each, (*path, str(index)), names)
        elif items is not None and all(resolved(each).get("type") == "number" for each in items):
            yield path, array, data
    else:
        for each in options:
            if each.get("type") in ("number", "integer", "boolean") or "enum" in each:
                yield path, each, data
                return


def bounds_of(node):
    low = node.get("minimum", node.get("exclusiveMinimum"))
    high = node.get("maximum", node.get("exclusiveMaximum"))
    return (-1e6 if low is None else low), (1e6 if high is None else high)


def drawn_number(node, now, rng):
    low, high = bounds_of(node)
    if not isinstance(now, int | float) or isinstance(now, bool) or now == 0:
        value = min(high, max(low, rng.uniform(0.05, 1.0) * min(abs(high), 2.0)))
    else:
        value = min(max(now * rng.uniform(0.6, 1.4), low), high)
    if node["type"] == "integer":
        value = max(1, round(value))
        divisors = [50, 25, 20, 10, 5] if 1 <= value <= 10_000 and high == 10_000 else [value]
        return int(rng.choice([each for each in divisors if each != now]))
    return float(f"{value:.4g}")


def values_of(node, now, rng):
    """Return a value, and the alternatives at which the flight is compared."""
    if "enum" in node:
        others = [each for each in node["enum"] if each != now]
        return (others[int(rng.integers(len(others)))] if others else now), tuple(others)
    if node["type"] == "boolean":
        return not now, (not now,)
    if node["type"] == "array":
        items = [resolved(each) for each in node["prefixItems"]]
        at = now if isinstance(now, list) else [None] * len(items)
        value = [drawn_number(item, each, rng) for item, each in zip(items, at, strict=True)]
        ends = zip(*map(bounds_of, items), strict=True)
        return value, tuple(list(each) for each in ends)
    return drawn_number(node, now, rng), bounds_of(node)


def keys_of(name):
    """Return the keys of a scenario: path, schema, present value."""
    scenario = load_scenario(name)
    data = json.loads(scenario.model_dump_json(by_alias=True))
    return scenario, list(leaves(SCHEMA, data, (), scenario.aircraft_names))


def candidates():
    """Return all keys of the shipped scenarios, those of the largest ones left out."""
    found = []
    for name in list_scenarios():
        scenario, keys = keys_of(name)
        plain = all(each.autopilot.kind == "virtual" for each in scenario.aircraft)
        if plain and len(scenario.aircraft) <= LARGEST:
            found += [(name, *each) for each in keys]
    return found


def draws(seed, count, known=None):
    """Draw keys whose values can be read: scenario, key, value."""
    rng, by_key = np.random.default_rng(seed), {}
    for each in known or candidates():
        by_key.setdefault(tuple(part for part in each[1] if not part.isdigit()), []).append(each)
    patterns = sorted(by_key)
    found = 0
    while found < count:
        choices = by_key[patterns[int(rng.integers(len(patterns)))]]
        name, path, node, now = choices[int(rng.integers(len(choices)))]
        value, others = values_of(node, now, rng)
        draw = Draw(name, ".".join(path), value, (now, others, node))
        if scenario_of(draw, value) is not None:
            found += 1
            yield draw


def scenario_of(draw, value):
    try:
        return load_scenario(draw.scenario, [f"{draw.key}={json.dumps(value)}"])
    except InputError:
        return None


def made_by(draw):
    """Return settings that make the section which only the key of a draw makes, without the key.

    A sensor, for example, that the scenario does not have; none where the section needs the key.
    """
    data = json.loads(load_scenario(draw.scenario).model_dump_json(by_alias=True))
    section = draw.key.rpartition(".")[0]
    for part in section.split("."):
        data = data[int(part)] if isinstance(data, list) else data.get(part)
        if not isinstance(data, dict | list):
            setting = f"{section}={{}}"
            with suppress(InputError):
                load_scenario(draw.scenario, [setting])
                return (setting,)
            break
    return ()


REFUSED = "refused"


def alternatives(draw):
    """Yield the scenarios that are compared: with the drawn value, and those at the bounds.

    Of a bound that cannot be flown the first value on the way to it that can; `REFUSED` if none
    can.
    """
    yield scenario_of(draw, draw.value)
    now, others, node = draw.others
    if "enum" in node or node.get("type") == "boolean":
        for each in others:
            yield scenario_of(draw, each) or REFUSED
        return
    for end in others:
        yield next(on_the_way(draw, end, node), REFUSED)


def on_the_way(draw, end, node):
    """Yield scenarios with values between the drawn one and a bound, the farthest first."""
    for share in SHARES:
        if isinstance(end, list):
            at = [a + share * (b - a) for a, b in zip(draw.value, end, strict=True)]
        else:
            at = draw.value + share * (end - draw.value)
            at = round(at) if node["type"] == "integer" else at
        scenario = scenario_of(draw, at)
        if scenario is not None and flies(scenario):
            yield scenario


def flies(scenario):
    try:
        build(scenario, unused="list")
    except InputError:
        return False
    return True


def said(scenario):
    """Return whether a key is said to have no effect, and what reads it."""
    world = build(scenario, unused="list")
    (group,) = {each.group for each in scenario.set_keys.keys if each.by_setting}
    paths = [each.path for each in scenario.set_keys.keys]
    consumers = {
        consumer.removeprefix("testbed.plan.")
        for read, consumer in world.consumers.items()
        for path in paths
        if path[: len(read)] == read or read[: len(path)] == path
    }
    return group in {each.key.group for each in world.unused}, consumers


class Fingerprint:
    """An observer that digests everything that a log has."""

    def __init__(self):
        self.digest = hashlib.sha256()

    def begin(self, info):
        for name in info.__dataclass_fields__:
            if name not in ("make_yaml", "versions"):
                self.add(getattr(info, name))

    def observe(self, sample):
        events = [each for each in sample.events if each.time_s > 0.0]
        self.add(sample._replace(events=events, records=None))

    def end(self, metrics, events):
        self.add([each.text for each in events])

    def add(self, value):
        if isinstance(value, np.ndarray):
            self.digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, tuple | list):
            for each in value:
                self.add(each)
        elif hasattr(value, "__dataclass_fields__"):
            for name in value.__dataclass_fields__:
                self.add(getattr(value, name))
        else:
            self.digest.update(repr(value).encode())


def flown(scenario, duration_s=FLOWN_S):
    """Return a digest of all that a flight gives; of one that is refused its error."""
    own = scenario.with_set_keys(SetKeys())
    print_ = Fingerprint()
    try:
        duration = min(duration_s, own.scenario.duration_s)
        if own.scenario.begin is not None:
            duration = own.scenario.begin.at_s + 1.0
        result = run(own, duration_s=duration, write=False, progress=False, observers=[print_])
    except InputError as error:
        return str(error)
    metrics = {key: each for key, each in result.metrics.items() if "wall" not in key}
    for key in ("versions", "published", "real_time_factor"):  # the second names what is set
        metrics.pop(key, None)
    # what is printed before the flight is no effect of it
    metrics["events"] = [each for each in metrics["events"] if each["time_s"] > 0.0]
    assert result.outcome in EXIT_CODES
    return (
        print_.digest.hexdigest()
        + hashlib.sha256(json.dumps(metrics, sort_keys=True, default=str).encode()).hexdigest()
    )
