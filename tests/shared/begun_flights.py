"""Pairs of a flight and of one that begins as it is at some time, drawn by number.

A pair is a scenario with faults, sensors, network, law, air and windows of its own, and the same
with `scenario.begin` of itself. Both must be equal to the bit from there on.
"""

import json
import random
from collections import Counter

import numpy as np

import testbed
from testbed.core.errors import InputError
from testbed.scenario import dump, load_scenario

END_S = 8.0
SEED = 20261129
BASES = (
    *("simulation-1", "simulation-2", "simulation-3", "simulation-3-30deg", "experiment-1"),
    *("mixed-fleet", "ideal-figure-eight", "simulation-3-recorded-leader", "own-functions"),
    *("own-law-repulsion", "own-law-leader-follower", "own-law-integral", "telemetry-radio"),
    *("ideal-own-speed-model", "close-formation-wake"),
)
# Laws whose memories and attributes have every form that Python has.
LAWS = '''
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import testbed
from testbed.law import FbwaCommand


class Turning:
    """Rolls by an angle that depends on all that it has counted."""

    def __init__(self, config, *, roll=0.02):
        self.config, self.roll = config, roll

    def start(self, own):
        return self.first(len(own.airspeed))

    def first(self, n):
        return np.zeros(n)

    def count(self, memory, own):
        memory = memory + 0.001 * own.euler[:, 0] + 0.001
        return memory, memory

    def step(self, now, own, inbox, memory):
        memory, angle = self.count(memory, own)
        roll = np.clip(self.roll + np.asarray(angle, float), -0.5, 0.5)
        n = len(own.airspeed)
        pitch, throttle = np.full((2, n), [[0.03], [0.5]])
        return FbwaCommand(pitch, np.broadcast_to(roll, n).copy(), throttle), memory


class Tuples(Turning):
    def first(self, n):
        return (0, np.zeros(n), {"deep": [np.zeros(n)]})

    def count(self, memory, own):
        k, sums, deep = memory
        deep = {"deep": [*deep["deep"], own.euler[:, 0]]}
        more = 1e-3 * sums + 1e-4 * k + 1e-4 * sum(deep["deep"])
        return (k + 1, sums + own.euler[:, 0], deep), more


@dataclass
class Held:
    values: list = field(default_factory=list)
    seen: set = field(default_factory=set)


class Objects(Turning):
    def first(self, n):
        return Held()

    def count(self, memory, own):
        seen = memory.seen | {f"step {len(memory.values) // 3}"}
        memory = Held([*memory.values, own.euler[:, 1]], seen)
        return memory, 1e-4 * sum(memory.values) + 1e-3 * len(memory.seen)


class Queues(Turning):
    def first(self, n):
        return [deque(maxlen=20), np.zeros((0, n)), (0.0, 0), {}]

    def count(self, memory, own):
        queue, array, pair, names = memory
        queue = deque([*queue, own.euler[:, 2]], maxlen=20)
        array = np.append(array, own.euler[None, :, 1], axis=0)
        pair = (pair[0] + 0.001, pair[1] + 1)
        names = names | {f"at {pair[1] // 4}": frozenset([pair[1]])}
        more = 1e-4 * sum(queue) + 1e-4 * array.sum(axis=0) + 1e-3 * pair[0] + 1e-3 * len(names)
        return [queue, array, pair, names], more


class Generators(Turning):
    """Cannot be taken over: nobody can copy a generator."""

    def first(self, n):
        return (0.001 * k for k in range(10**6))

    def count(self, memory, own):
        return memory, next(memory)


@testbed.kernel(memory=[("sum", float), ("turns", float, 3)])
def counting(now, own, inbox, memory, config, gain=0.3):
    memory.sum += own.euler[0]
    memory.turns[0] += own.rates_body[0]
    roll = 0.02 + 0.002 * gain * memory.sum + 0.01 * memory.turns[0]
    return FbwaCommand(0.03, min(max(roll, -0.5), 0.5), 0.5)
'''
OWN_LAWS = ("Turning", "Tuples", "Objects", "Queues", "counting")


def _faults(rng, surfaces):
    """Faults of an aircraft: before, at and after the beginning, by time and by condition."""
    roll, pitch, yaw = surfaces
    kinds = (
        {"kind": "engine-out"},
        {"kind": "thrust-loss", "remaining": round(rng.uniform(0.2, 0.9), 2)},
        {"kind": "surface-stuck", "surface": roll, "position": 0.05},
        {"kind": "surface-stuck", "surface": pitch},
        {"kind": "surface-floating", "surface": yaw},
        {"kind": "airspeed-blocked", "drain": rng.choice(["blocked", "open"])},
        {"kind": "gps-lost"},
        {"kind": "gps-jump", "offset_m": [3, -2, 1]},
        {"kind": "autopilot-frozen"},
        {"kind": "transmitter-off"},
    )
    found = []
    for _ in range(rng.choice([1, 1, 2])):
        fault = dict(rng.choice(kinds))
        if rng.random() < 0.2:
            fault["when"] = {"quantity": "bank_deg", "above": rng.choice([3, 8])}
        else:
            fault["at_s"] = round(rng.uniform(0.0, 7.0) / 0.02) * 0.02
        if rng.random() < 0.4:
            fault["duration_s"] = round(rng.uniform(0.1, 4.0), 2)
        if rng.random() < 0.2 and fault["kind"] != "transmitter-off":
            fault["declared"] = rng.choice([True, False])
        found.append(fault)
    return found


_SURFACES = "aileron", "elevator", "rudder"
_ELEVONS = "left-elevon", "right-elevon", "right-elevon"
NETWORKS = (
    {"loss": 0.3},
    {"loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.3}, "delay_s": 0.15},
    {"loss": {"kind": "four-state", "p13": 0.1, "p31": 0.4}},
    {"delay_s": 0.1, "jitter": {"distribution": "uniform", "spread_s": 0.08}},
    {"delay_s": 0.3, "jitter": {"distribution": "normal", "spread_s": 0.05, "correlation": 0.5}},
    {"delay_s": 0.2, "jitter": {"distribution": "pareto", "spread_s": 0.1, "in_order": True}},
    {"duplicate": 0.3, "delay_s": 0.2, "jitter": {"spread_s": 0.1}, "reorder": 0.2},
    {"corrupt": {"probability": 0.1, "bits": 2}, "encoding": "follow-target"},
    {"rate": {"bit_per_s": 57600, "overhead_bytes": 16, "queue_packets": 3}},
    {"slots": {"every_s": [0.02, 0.09], "queue_packets": 3}},
    {"tdma": {"frame_s": 0.1}},
    {"range_loss": [[0, 0.0], [40, 0.5]]},
    {"shadowing": {"loss": [[0, 0.0], [20, 0.9]]}},
    {"blackout_s": [[2.1, 3.3], [4.5, 6.2]]},
    {"drop": [3, 4, 5, 60, 61, 130]},
    {"arithmetic": "netem", "loss": {"probability": 0.2, "correlation": 0.3}, "delay_s": 0.1},
)
AIRS = (
    {"wind": {"speed_mps": 5, "from_deg": 70}},
    {"wind": {"speed_mps": 3, "from_deg": 200}, "turbulence": {"model": "dryden"}},
    {"turbulence": {"model": "von-karman", "intensity": "light"}},
    {
        "gusts": [
            {"kind": "time", "name": "g", "velocity_mps": [2, 1, -1], "at_s": 4, "ramp_s": 1},
            {
                **{"kind": "front", "name": "f", "velocity_mps": [0, 2, 0], "at_m": [20, 0]},
                **{"towards_deg": 0, "length_m": 10, "speed_mps": 3},
            },
        ]
    },
)
CONTROLLERS = (
    {"companion": {"state_latency_s": 0.02, "command_latency_s": 0.04}},
    {"extrapolate_from": "timestamp"},
    {"gain_scale": 0.7},
    {"leader_timeout_s": 0.3, "on_leader_timeout": "loiter"},
    {"neighbour_timeout_s": 0.2, "on_neighbour_timeout": "hold-relative-position"},
    {"estimators": {"extrapolation": "acceleration"}},
    {"pitch_feedforward": "incidence", "bounded_speed": "airspeed"},
)


def draw(number, folder, seed=SEED):
    """Write the two files of a pair; return their paths and what was drawn."""
    rng = random.Random(f"begin/{seed}/{number}")
    base = rng.choice(BASES)
    at_s = round(rng.uniform(0.1, END_S - 1.0) / 0.02) * 0.02
    loaded = load_scenario(base)
    names, mission = loaded.aircraft_names, loaded.leader.path.kind == "mission"
    followers = [each.name for each in loaded.fleet if each.vehicle == "jsbsim"]
    modelled = [names[0], *followers] if mission else followers
    first = at_s if rng.random() < 0.3 else rng.uniform(at_s, END_S - 0.5)
    windows = {each: None for each in loaded.scenario.windows}
    windows |= {"one": [first, rng.uniform(first + 0.1, END_S)], "two": [first, END_S]}
    data = {"extends": base}
    if loaded.expect.model_dump(exclude_unset=True):
        data["expect"] = {"rms_m": None}
    header = {"seed": rng.randrange(1000), "duration_s": END_S, "windows": windows}
    data["scenario"] = {"name": "first", **header, "published": None}
    drawn = {"base": base, "at_s": at_s}
    if rng.random() < 0.6:
        data["network"] = drawn["network"] = rng.choice(NETWORKS)
    if rng.random() < 0.35:
        data["air"] = drawn["air"] = rng.choice(AIRS)
    controller = {}
    if rng.random() < 0.4:
        controller |= rng.choice(CONTROLLERS)
    if rng.random() < 0.3 and "own-law" not in base and followers == [*names[1:]]:
        controller["law"] = f"laws_of_pairs:{rng.choice(OWN_LAWS)}"
    if rng.random() < 0.01:
        controller["law"], controller["options"] = "laws_of_pairs:Generators", {}
    if controller:
        data["controller"] = drawn["controller"] = controller
    if rng.random() < 0.2:
        data["limits"] = {"on_loss": "continue", "on_limit_exceeded": "continue"}
    settings = []
    begin_s = rng.uniform(0.02, at_s)
    drawn["nested"] = round(begin_s / 0.02) * 0.02 if rng.random() < 0.15 else None
    sensors = rng.choice(["truth", "truth", "noise", "gps-ins", "pixhawk"])
    if sensors != "truth" and modelled:
        settings.append(f"fleet.*.sensors={_sensors(sensors)}")
        drawn["sensors"] = sensors
    for name in rng.sample(modelled, min(len(modelled), rng.choice([0, 0, 1, 1, 2]))):
        key = "leader" if name == names[0] else f"fleet.{name}"
        row = names.index(name)
        elevons = loaded.aircraft[row].aircraft.endswith("skywalker_x8")
        faults = _faults(rng, _ELEVONS if elevons else _SURFACES)
        settings.append(f"{key}.faults={json.dumps(faults)}")
        drawn[f"faults of {name}"] = faults
    if any("faults" in each for each in settings) and rng.random() < 0.5:
        reassign = "law" not in controller and "own-law" not in base
        response = rng.choice(["drop", "reassign-slots"]) if reassign else "drop"
        settings.append(f"formation.on_failure.response={response}")
    if rng.random() < 0.1:
        settings.append("rates.synchronous=false")
    if rng.random() < 0.1:
        settings.append("rates.broadcast_hz=10")
    drawn["settings"] = settings
    return data, settings, at_s, drawn


def _sensors(kind):
    return "{position: {sigma_m: 1, time_constant_s: 5}}" if kind == "noise" else kind


def load_pair(number, folder, seed=SEED):
    """Return the two scenarios of a pair, and what was drawn.

    Raises:
        InputError: the first scenario cannot be flown, whether another begins as it or not.
    """
    (folder / "laws_of_pairs.py").write_text(LAWS)
    data, settings, at_s, drawn = draw(number, folder, seed)
    path = folder / f"first-{number}.yaml"
    path.write_text(json.dumps(data))
    first = load_scenario(path, settings)
    resolved = folder / f"resolved-{number}.yaml"
    resolved.write_text(dump(first))
    if drawn["nested"] and drawn["nested"] < at_s:
        nested = folder / f"nested-{number}.yaml"
        begin = {"scenario": resolved.name, "at_s": drawn["nested"]}
        nested.write_text(json.dumps({"extends": resolved.name, "scenario": {"begin": begin}}))
        first, resolved = load_scenario(nested), nested
    begin = {"scenario": resolved.name, "at_s": at_s}
    second = folder / f"second-{number}.yaml"
    second.write_text(json.dumps({"extends": resolved.name, "scenario": {"begin": begin}}))
    return first, second, at_s, drawn


TIMES_S = (0.0, 0.02, 0.4, END_S)  # after the beginning


def numbers(simulation, at_s):
    """All records at some times, later events, and the metrics of windows."""
    seen = []
    for after in TIMES_S:
        if at_s + after > simulation.time_s + 1e-9 and simulation.outcome is None:
            simulation.step(until=min(at_s + after, END_S))
        records = simulation.state.records
        seen += [simulation.time_s, simulation.outcome]
        seen += [_bytes(each) for each in records]
    events = [each for each in simulation.events if each.time_s > at_s + 1e-9]
    return seen, [str(each) for each in events], simulation.metrics["windows"]


def _bytes(records):
    """The fields of records, without what is between them."""
    if records.dtype.names is None:
        return records.tobytes()
    return [(name, _bytes(np.ascontiguousarray(records[name]))) for name in records.dtype.names]


def compare(number, folder, seed=SEED):
    """Fly a pair; return "equal", "refused: …", "not flown: …" or "differs: …", with what it is."""
    try:
        first, second, at_s, drawn = load_pair(number, folder, seed)
        one = testbed.Simulation(first)
        one.step(until=at_s)
    except InputError as error:
        return f"not flown: {str(error).splitlines()[0][-200:]}"
    if one.outcome is not None:
        return "not flown: ends before the other begins"
    try:
        other = testbed.Simulation(load_scenario(second))
    except InputError as error:
        return f"refused: {str(error).splitlines()[0][-170:]}"
    if abs(other.time_s - one.time_s) > 1e-9:
        return f"differs: begins at {other.time_s}, not at {one.time_s}: {drawn}"
    flown = numbers(one, at_s), numbers(other, at_s)
    for name, a, b in zip(("records", "events", "windows"), *flown, strict=True):
        if str(a) != str(b):
            return f"differs: {name}: {_first(a, b)}: {drawn}"
    return "equal"


def _first(a, b):
    """The first of two lists or mappings that differs."""
    if isinstance(a, dict):
        return {key: (a[key], b[key]) for key in a if str(a[key]) != str(b[key])}
    for k, (one, other) in enumerate(zip(a, b, strict=False)):
        if str(one) != str(other):
            if isinstance(one, list):
                fields = [x[0] for x, y in zip(one, other, strict=True) if x != y]
                return k, fields
            return k, one if not isinstance(one, bytes) else "", other
    return len(a), len(b)


def count(numbers_, folder, seed=SEED):
    """Fly pairs; return how many of each result there are, without what differs in the text."""
    found = Counter()
    for number in numbers_:
        found[compare(number, folder, seed)] += 1
    return found
