"""What steps the flight models: compiled functions where they are proved equal to JSBSim."""

import os
import shutil

import numpy as np
import pytest
from commands import call_command
from run_flight import Collector

import testbed
from testbed.core.errors import InputError
from testbed.flight.loop import fly
from testbed.logs.read import read_log
from testbed.plan.world import build
from testbed.scenario import library, load_scenario, loads, set_duration

ALL = os.environ.get("TESTBED_ENGINES") == "1"
SAMPLE = ("mixed-fleet", "simulation-3-pixhawk", "gust-front", "engine-out-uav2")
SCENARIOS = sorted(
    path.stem
    for path in (library() / "scenarios").glob("*.yaml")
    # a program of its own; begins as a flight whose models are compiled
    if path.stem not in ("simulation-3-ardupilot", "late-radio-loss")
)
SEEN = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")


def scenario_of(name, engine, duration_s):
    scenario = load_scenario(name, [f"scenario.engine={engine}"])
    longer = scenario.scenario.duration_s > duration_s
    return set_duration(scenario, duration_s) if longer else scenario


def assert_equal(own, others):
    assert len(own) == len(others) > 50
    for ours, theirs in zip(own, others, strict=True):
        assert ours.events == theirs.events
        for part in SEEN:
            pairs = zip(getattr(ours, part), getattr(theirs, part), strict=True)
            assert all(np.array_equal(a, b, equal_nan=True) for a, b in pairs), (part, ours.time_s)


@pytest.mark.parametrize("name", SCENARIOS if ALL else SAMPLE)
def test_engines_fly_the_same_numbers(name):
    """Every number of every sample, and every event, to the bit."""
    flown = {}
    for engine in ("compiled", "jsbsim"):
        collector, scenario = Collector(), scenario_of(name, engine, 60.0 if ALL else 4.0)
        run = testbed.run(scenario, write=False, observers=[collector])
        leads = scenario.leader.path.kind == "mission" and scenario.leader.vehicle == "jsbsim"
        models = leads or any(each.vehicle == "jsbsim" for each in scenario.fleet)
        assert run.metrics["engine"] == (engine if models else None)
        flown[engine] = collector.frames
    assert_equal(flown["compiled"], flown["jsbsim"])


def test_engines_agree_above_the_tropopause():
    changes = (
        "scenario.origin.elevation_m=9000",
        "leader.start.altitude_m=2100",
        "leader.path.airspeed_mps=30",
        "leader.path.legs=[{kind: waypoints, points_m: [[3000, 0, 2100], [6000, 0, 2100]]}]",
    )
    flown = []
    for engine in ("compiled", "jsbsim"):
        collector = Collector()
        scenario = load_scenario("simulation-1", [f"scenario.engine={engine}", *changes])
        run = testbed.run(set_duration(scenario, 4.0), write=False, observers=[collector])
        assert (run.metrics["engine"], run.outcome) == (engine, "completed")
        flown.append(collector.frames)
    assert_equal(*flown)


def test_last_bit_of_a_mass_is_seen():
    """A negative control of the test above."""
    flown = []
    for change in (False, True):
        world, collector = build(scenario_of("simulation-1", "compiled", 4.0)), Collector()
        (kind,) = world.fleet._kinds
        column = kind.aircraft.columns["inertia/mass-slugs"]
        if change:
            kind.state[1, column] = np.nextafter(kind.state[1, column], 1.0)
        collector.begin(world.info)
        fly(world, [collector], lambda now, due: False)
        flown.append(collector.frames)
    with pytest.raises(AssertionError, match="truth"):
        assert_equal(*flown)


SLOW = """
  <system name="slow">
    <channel name="slow" execrate="2">
      <summer name="slow/speed"> <input> velocities/vt-fps </input> </summer>
    </channel>
  </system>
</fdm_config>"""


@pytest.fixture(scope="module")
def kite(tmp_path_factory):
    """A Rascal with a channel of another rate, which is not translated."""
    folder = tmp_path_factory.mktemp("aircraft") / "kite"
    shutil.copytree(library() / "aircraft" / "rascal110", folder)
    file = (folder / "rascal110.xml").rename(folder / "kite.xml")
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("</fdm_config>", SLOW), encoding="utf-8")
    return folder


def reason_of(kite):
    line = (
        (kite / "kite.xml")
        .read_text(encoding="utf-8")
        .splitlines()
        .index('    <channel name="slow" execrate="2">')
    )
    return f"{kite}/kite.xml:{line + 1}: <channel> with the attribute execrate is not translated"


def test_untranslated_aircraft_flies_by_jsbsim(kite, tmp_path):
    """The log and the metrics name the engine; an event has file, line and element."""
    text = f"extends: simulation-1\nleader: {{aircraft: {kite}}}\n"
    scenario = set_duration(loads(text), 0.2)
    run = testbed.run(scenario, out=tmp_path / "run")
    assert run.metrics["engine"] == "jsbsim"
    log = read_log(tmp_path / "run" / "run.mcap")
    assert log.info.engine == "jsbsim"
    assert any(reason_of(kite) in event.text for event in log.events)


def test_compiled_engine_is_refused_for_it(kite):
    text = f"extends: simulation-1\nscenario: {{engine: compiled}}\nleader: {{aircraft: {kite}}}\n"
    with pytest.raises(InputError) as caught:
        build(loads(text))
    assert "engine: compiled: " in str(caught.value) and reason_of(kite) in str(caught.value)


def test_validate_names_engine_and_reason(kite, tmp_path):
    for of, engine in (("rascal110", "compiled (rascal110 equals JSBSim"), (kite, "jsbsim (")):
        done = call_command(
            "validate",
            "simulation-1",
            "--set",
            f"leader.aircraft={of}",
            cwd=tmp_path,
            code=0,
            columns=200,
        )
        assert f"engine: {engine}" in done.stderr
