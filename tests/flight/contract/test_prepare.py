"""No entry is compiled or loaded during a flight: all that it calls is prepared before it."""

import json
import os

import pytest
from fresh import run_fresh
from places import ROOT

from testbed.guidance.mission_follower import guide
from testbed.plan.world import build
from testbed.scenario import library, load_scenario

ALL = os.environ.get("TESTBED_PREPARED") == "1"
GOLDEN = sorted(path.stem for path in (library() / "scenarios" / "golden").glob("*.json"))
# A fault is flown to the end; whole flights of the others, without events, take long.
SAMPLE = (
    *("simulation-3-pixhawk:30", "own-law-repulsion:20"),
    *("ideal-figure-eight:30", "engine-out-uav2"),
)
# Compares the machine code of a process at the end of `prepare` and at the end of the run: for each
# scenario in a process of its own, forked before any code is loaded.
FLY = """
import gc
import json
import os
import sys

from testbed.core.call_list import CalledByAddress
from testbed.core.compile import CompiledFunction
from testbed.scenario import load_scenario, set_duration
from testbed.runs import run as runs


def signatures():
    modules = [each for name, each in sys.modules.items() if name.startswith("testbed.")]
    functions = {each for module in modules for each in vars(module).values()
                 if isinstance(each, CompiledFunction) and "dispatcher" in vars(each)}
    compiled = [(each, each.signatures) for each in functions]
    compiled += [(each, list(each._addresses)) for each in gc.get_objects()
                 if type(each) is CalledByAddress]
    return {f"{each.__module__}.{each.__qualname__}{of}" for each, all in compiled for of in all}


class Prepared(runs.Flight):
    def prepare(self, *args):
        super().prepare(*args)
        prepared.update(signatures())


prepared = set()
runs.Flight = Prepared
duration, *names = WORDS
for name in names:
    name, _, own = name.partition(":")
    if child := os.fork():
        if os.waitpid(child, 0)[1]:
            sys.exit(name)
        continue
    scenario = load_scenario(name)
    if duration := own or duration:
        begin = scenario.scenario.begin
        scenario = set_duration(scenario, float(duration) + (begin.at_s if begin else 0.0))
    runs.run(scenario, out=name)
    later = sorted(each[:80] for each in signatures() - prepared)
    print(json.dumps([name, len(prepared), later]), flush=True)
    sys.exit()
"""


def entries_after_prepare(names, duration, folder, **environment):
    """Fly scenarios, perhaps with a duration of their own; return what each loaded in flight."""
    program = FLY.replace("WORDS", repr([duration, *names]))
    env = os.environ | environment
    code, output, errors = run_fresh(program, folder=folder, paths=[ROOT], env=env)
    assert code == 0, errors
    found = list(map(json.loads, output.splitlines()))
    assert all(prepared > 10 for _, prepared, _ in found)
    return {name: later for name, _, later in found}


@pytest.mark.parametrize("names", [[each] for each in GOLDEN] if ALL else [SAMPLE])
def test_no_entry_is_loaded_in_flight(names, tmp_path):
    """Flown to the end: faults and losses call others than the first tick."""
    expected = {name.partition(":")[0]: [] for name in names}
    assert entries_after_prepare(names, "", tmp_path) == expected


@pytest.mark.skipif(not ALL, reason="TESTBED_PREPARED=1: compiles all from nothing")
@pytest.mark.parametrize("name", GOLDEN if ALL else GOLDEN[:1])
def test_no_entry_is_compiled_in_flight(name, tmp_path):
    """With nothing cached, and without optimisation, which takes a third of the time."""
    cache = str(tmp_path / "cache")
    later = entries_after_prepare([name], "2", tmp_path, NUMBA_CACHE_DIR=cache, NUMBA_OPT="0")
    assert later == {name: []}


def test_guidance_of_later_circles_is_prepared():
    """No mission flies before an external program commands a circle; the leader is a recording."""
    world = build(load_scenario("simulation-3-recorded-leader"), commanded=True)
    assert guide in [getattr(each, "function", each) for each, _ in world.entries]
