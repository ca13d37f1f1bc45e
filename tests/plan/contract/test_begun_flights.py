"""Flights that begin as others go on as these, to the bit, or are refused with the reason.

TESTBED_BEGUN sets the number of pairs that are drawn; see `begun_flights`.
"""

import json
import os
import sys
import threading
from collections import deque

import begun_flights
import numpy as np
import pytest
from user_laws import FILTERED

import testbed
from testbed.core import saved_state
from testbed.core.errors import InputError
from testbed.core.samples import SampleBuffer
from testbed.core.saved_state import SavedState, copy_state, take_changes
from testbed.formation.compiled_law import CompiledLaw
from testbed.metrics.accumulator import Accumulator
from testbed.plan.world import build
from testbed.runs.recover import recover
from testbed.scenario import dump, load_scenario, set_duration

PAIRS = int(os.environ.get("TESTBED_BEGUN", "2"))
CHUNK = min(PAIRS, 50)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return tmp_path


@pytest.mark.parametrize("chunk", range(PAIRS // CHUNK))
def test_pairs_are_equal_to_the_bit(chunk, folder):
    """Pairs that cannot be flown at all are replaced by the next ones."""
    found, number = {}, 1000 * chunk
    while len(found) < CHUNK:
        result = begun_flights.compare(number, folder)
        if not result.startswith("not flown"):
            found[number] = result
        number += 1
    different = {key: each for key, each in found.items() if each != "equal"}
    refused = {key: each for key, each in different.items() if each.startswith("refused")}
    print(refused)
    assert different == refused, {k: v for k, v in different.items() if k not in refused}
    assert len(refused) <= CHUNK // 20
    assert number < 1000 * chunk + 3 * CHUNK + 10


@pytest.mark.parametrize(
    ("target", "name", "value"),
    [
        (SampleBuffer, "copy_last", lambda self: None),
        (Accumulator, "precede", lambda self, block: None),
        (saved_state, "_take_numbers", lambda *each: True),
    ],
    ids=["sample", "neighbour", "numbers"],
)
def test_pair_with_a_planted_fault_differs(target, name, value, folder, monkeypatch):
    path = folder / "first.yaml"
    header = {"duration_s": 4.0, "windows": WINDOWS, "published": None}
    path.write_text(json.dumps({"extends": "simulation-3", "scenario": header}))
    own = begin_as("first.yaml", 2.02, folder)
    assert windows(own, folder) == windows(path, folder)
    monkeypatch.setattr(target, name, value)
    monkeypatch.setattr("testbed.plan.begin._last", [])
    assert windows(own, folder) != windows(path, folder)


WINDOWS = {"rectangles": None, "circles": None, "at-once": [2.02, 3.0], "later": [2.5, 4.0]}


def begin_as(name, at_s, folder, settings=()):
    """A file of the scenario that begins as another one, with settings of its own."""
    path = folder / f"as-{name}"
    scenario = {"extends": name, "scenario": {"begin": {"scenario": name, "at_s": at_s}}}
    path.write_text(json.dumps(scenario))
    return path


def windows(path, folder, settings=()):
    simulation = testbed.Simulation(load_scenario(path, settings))
    simulation.step(until=4.0)
    return simulation.metrics["windows"]


def test_windows_are_equal_over_several_spans(folder):
    """Over several spans of sums, and from the first sample on: the last bit."""
    path = folder / "long.yaml"
    some = {"rectangles": None, "circles": None, "a": [37.0, 105.0], "b": [60.0, 115.0]}
    header = {"duration_s": 115.0, "windows": some, "published": None}
    path.write_text(json.dumps({"extends": "simulation-3", "scenario": header}))
    one, other = (
        testbed.Simulation(load_scenario(each))
        for each in (path, begin_as("long.yaml", 37.0, folder))
    )
    for each in (one, other):
        each.step(until=115.0)
    assert one.metrics["windows"] == other.metrics["windows"]
    assert one.metrics["windows"]["a"]["kappa_mps"]["uav1"] is not None


def engine_out(at_s, **more):
    return [f"fleet.uav2.faults={json.dumps([{'kind': 'engine-out', 'at_s': at_s, **more}])}"]


def variant(settings, prior_settings, folder, at_s=3.0):
    """The flights of a scenario with settings, and of one that begins as it with others."""
    path = folder / "prior.yaml"
    header = {"duration_s": 6.0, "windows": {"rectangles": None, "circles": None}}
    path.write_text(
        json.dumps({"extends": "simulation-3", "scenario": {**header, "published": None}})
    )
    prior = folder / "with-faults.yaml"
    first = load_scenario(path, prior_settings)
    prior.write_text(dump(first))
    begin = [f"scenario.begin={{scenario: {prior}, at_s: {at_s}}}"]
    return testbed.Simulation(first), testbed.Simulation(load_scenario(path, [*settings, *begin]))


def test_fault_in_both_scenarios_is_that_of_ones_own(folder):
    """The fault of the other flight would begin a second later."""
    first, own = variant(engine_out(4.0), engine_out(5.0), folder)
    first.step(until=3.0)
    own.step(until=4.9)
    events = [str(each.text) for each in own.events]
    assert "engine out" in events
    assert own._world.aircraft["faults"]["power"].tolist() == [1.0, 1.0, 0.0, 1.0]


def test_fault_taken_over_goes_on_others_end(folder):
    _, same = variant(engine_out(2.0), engine_out(2.0), folder)
    same.step(until=3.1)
    assert same._world.aircraft["faults"]["power"].tolist() == [1.0, 1.0, 0.0, 1.0]
    assert not any(each.text == "engine out" for each in same.events)
    for settings in ([], engine_out(4.5)):
        _, none = variant(settings, engine_out(2.0), folder)
        none.step(until=3.1)
        assert none._world.aircraft["faults"]["power"].tolist() == [1.0] * 4
        assert any(each.text.endswith("faults begin anew") for each in none.events)


def test_fault_before_the_beginning_is_refused(folder):
    with pytest.raises(InputError, match=r"uav2: fault engine-out: at_s: 2 s is before") as caught:
        variant(engine_out(2.0), [], folder)
    assert "(write a later time, or give simulation-3 the same fault)" in str(caught.value)
    variant(engine_out(3.0), [], folder)  # a later time
    variant(engine_out(2.0), engine_out(2.0), folder)  # the same fault


def test_formation_of_one_follower_has_its_fault(folder):
    """No follower is left whose reference could be missing."""
    fault = json.dumps([{"kind": "engine-out", "at_s": 1.0}])
    settings = [f"fleet.uav1.faults={fault}", "formation.on_failure.response=drop"]
    simulation = testbed.Simulation(set_duration(load_scenario("simulation-1", settings), 2.0))
    simulation.step(until=2.0)
    assert any(each.text == "engine out" for each in simulation.events)


def test_recovered_windows_equal_those_of_the_run(folder):
    """But for the speed of slots at the first sample, which needs the sample before."""
    path = folder / "first.yaml"
    some = {name: each for name, each in WINDOWS.items() if name != "at-once"}
    header = {"duration_s": 4.0, "windows": some, "published": None}
    path.write_text(json.dumps({"extends": "simulation-3", "scenario": header}))
    scenario = load_scenario(begin_as("first.yaml", 2.02, folder))
    run = testbed.run(scenario, out=folder / "run")
    log = folder / "run" / "run.mcap"
    whole = log.read_bytes()
    (folder / "run" / "metrics.json").unlink()
    log.write_bytes(whole[:-200])
    assert recover(folder / "run").metrics["windows"] == run.metrics["windows"]


class Held:
    """An object of a user."""

    def __init__(self, **values):
        vars(self).update(values)


def taken(before, after, target):
    """What `take_changes` makes of a target, and what is left."""
    parts = {"part": before}, {"part": after}, {"part": target}
    left = take_changes(*parts)
    return vars(target), left


def test_changes_are_taken_over_by_kind():
    old = {"names": {1, 2}, "pair": (1, 0.5), "queue": deque([1]), "gone": 1, "gain": 3.0}
    new = {"names": {2, 3}, "pair": (2, 0.5), "queue": deque([1, 2]), "late": [0.5], "gain": 3.0}
    own = {"names": {1, 2, 9}, "pair": (1, 7.5), "queue": deque([1]), "gone": 1, "gain": 4.0}
    found, left = taken(Held(**old), Held(**new), Held(**own))
    assert left == []
    expected = {"names": {2, 3, 9}, "pair": (2, 7.5), "queue": deque([1, 2]), "gain": 4.0}
    assert found == {**expected, "late": [0.5]}
    later = Held(late=Held(sum=np.ones(2)), rng=np.random.default_rng(1))
    found, _ = taken(Held(), later, Held())
    assert found["late"] is not later.late and found["late"].sum.tolist() == [1.0, 1.0]
    assert found["rng"].random() == np.random.default_rng(1).random()


def test_shared_object_is_taken_over_at_each_place():
    old, new, own = (Held(one=np.zeros(2), other=np.zeros(2)) for _ in range(3))
    new.one = new.other
    new.other[1] = 3.0
    found, left = taken(old, new, own)
    assert left == []
    assert found["one"].tolist() == found["other"].tolist() == [0.0, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (None, (each for each in "ab"), "part.x: has become a builtins.generator"),
        (1, threading.Lock(), "part.x: has become a _thread.lock, which cannot be copied"),
        ([], [threading.Lock()], "part.x: has become a builtins.list"),
    ],
)
def test_change_that_cannot_be_copied_is_refused(old, new, text):
    with pytest.raises(InputError, match=text):
        taken(Held(x=old), Held(x=new), Held(x=old))
    with pytest.raises(InputError, match="is a _thread.lock, whose state is not in Python"):
        taken(*(Held(x=threading.Lock()) for _ in range(3)))


def test_sets_are_saved_restored_and_copied():
    part = Held(names={1, 2}, fixed=frozenset([3]))
    state = SavedState(part=part)
    names = part.names
    part.names.add(5)
    part.fixed = frozenset()
    state.restore()
    assert part.names is names and names == {1, 2} and part.fixed == {3}
    target = Held(names={7}, fixed=frozenset())
    copy_state(part, target)
    assert target.names == {1, 2} and target.names is not names and target.fixed == {3}


def test_compiled_laws_ignore_what_is_between_fields(folder, monkeypatch):
    """Of records of the law; one is refused that writes its configuration, byte by byte."""
    made = CompiledLaw.__init__

    def filled(self, law, config, hbh23, *rest):
        laws.append(self)
        data = np.full(hbh23.nbytes, 17 * len(laws), dtype=np.uint8)
        other = data.view(hbh23.dtype).view(type(hbh23))
        for name in hbh23.dtype.names:
            other[name] = hbh23[name]
        made(self, law, config, other, *rest)

    def compiles(call):
        raise KeyboardInterrupt

    laws = []
    monkeypatch.setattr(CompiledLaw, "__init__", filled)
    monkeypatch.setattr("testbed.formation.compiled_law.Call.prepare", compiles)
    (folder / "law_filtered.py").write_text(FILTERED, "utf-8")
    path = folder / "first.yaml"
    path.write_text(
        json.dumps({"extends": "simulation-3", "controller": {"law": "law_filtered:filtered"}})
    )
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            build(load_scenario(path))
    one, other = (each._given.tobytes() for each in laws)
    assert one == other


def test_changes_of_records_are_those_of_fields():
    old, new, own = (
        np.zeros(1, np.dtype([("a", "u1"), ("b", float)], align=True)) for _ in range(3)
    )
    new.view(np.uint8)[1] = 17  # between the fields
    own["b"] = 2.0
    found, left = taken(Held(x=old), Held(x=new), Held(x=own))
    assert left == [] and found["x"]["b"] == 2.0
