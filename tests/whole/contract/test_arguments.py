"""Arguments of Python end in success or in an error that names them, and leave no trace.

TESTBED_ARGUMENTS sets the number of calls. Two flights get the same calls; one of them also gets
those that are refused, and must stay equal to the other to the bit.
"""

import os
import random
import re
from dataclasses import fields
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from places import ROOT

import testbed
import testbed.rl
from testbed.core.errors import InputError
from testbed.mavlink.udp_endpoint import Address, parse_address
from testbed.rl.episodes import Task
from testbed.rl.formation import FormationEnv
from testbed.rl.hold_slot import HoldSlotEnv
from testbed.runs.external_options import ExternalOptions
from testbed.runs.single_aircraft import _ARGUMENTS
from testbed.scenario import load_scenario, set_duration, set_seed
from testbed.scenario.arguments import with_changes
from testbed.studies.sweep import sweep

CALLS = int(os.environ.get("TESTBED_ARGUMENTS", "100"))
SHORT = set_duration(load_scenario("simulation-3", ["fleet.uav1.commanded_by=external"]), 20)
STILL = np.zeros(3, np.float32)
LOOP: list = []
LOOP.append(LOOP)

# Values of every kind that Python has, of every size, and some that are right.
VALUES = [
    *(None, True, "", "x", "22", "a=b", b"x", "\0", "\ud800", Path("x"), 1j, object(), len),
    *(float("nan"), float("inf"), -float("inf"), 0, -1, 1, 3, 17, 60, 1.5, 0.1, -0.2, 0.0),
    *(1e-300, 1e300, -1e300, 10**400, 10**5000, 2**63, np.float32(0.2), np.int64(2)),
    *([], (), {}, {1: 2}, {"x": 1}, [1, 2], (0.1, 0.2, 0.3), (3, 17, 60), ("a", 0, 0), LOOP),
    *(np.zeros(2), np.zeros(3), np.full(3, np.nan), np.zeros((1, 3)), np.array(["x"] * 3)),
    *((8.0, 0.0), [0.1, 0.2, 0.3], range(3), {"uav1": (0.1, 0.1, 0.5)}, {"uav1": STILL}),
    *(["rates.log_hz=50"], ["rates.log_hz"], {"wind": {"speed_mps": -5}}, {"a.b": (0, 1)}),
    *({"air.wind.speed_mps": (0.0, 8.0)}, {"scenario.seed": [1]}, {"air.wind.speed_mps": (8, 0)}),
]


def new_targets():
    """Return flights that are stepped, at their start."""
    hold = HoldSlotEnv(duration_s=4.0)
    formation = FormationEnv(duration_s=4.0)
    hold.reset(seed=1)
    formation.reset(seed=1)
    return {
        "simulation": testbed.Simulation(SHORT),
        "aircraft": testbed.Aircraft("rascal110", airspeed_mps=22, duration_s=20),
        "hold": hold,
        "formation": formation,
    }


STEPS = {
    "simulation": {
        "commands": lambda o, v: o.step(v),
        "command": lambda o, v: o.step({"uav1": v}),
        "pitch": lambda o, v: o.step({"uav1": (v, 0.1, 0.5)}),
        "second": lambda o, v: o.step(
            {"uav1": (0.1, 0.1, 0.5), v if v.__hash__ else "x": (0, 0, 0)}
        ),
        "until": lambda o, v: o.step({"uav1": (0.1, -0.1, 0.5)}, until=v),
        "reset": lambda o, v: o.reset(v),
    },
    "aircraft": {
        "pitch": lambda o, v: o.step(v, 0.1, 0.5),
        "roll": lambda o, v: o.step(0.1, v, 0.5),
        "throttle": lambda o, v: o.step(0.1, 0.1, v),
        "until": lambda o, v: o.step(0.1, 0.0, 0.5, until=v),
        "seed": lambda o, v: o.reset(v),
    },
    "hold": {
        "action": lambda o, v: o.step(v),
        "part": lambda o, v: o.step([0.1, v, 0.0]),
        "seed": lambda o, v: o.reset(seed=v),
        "options": lambda o, v: o.reset(options=v),
    },
    "formation": {
        "actions": lambda o, v: o.step(v),
        "action": lambda o, v: o.step({"uav1": v, "uav2": STILL, "uav3": STILL}),
        "seed": lambda o, v: o.reset(seed=v),
        "options": lambda o, v: o.reset(options=v),
    },
}

WHOLE = set_duration(load_scenario("simulation-3", ["log.mcap=false"]), 0.1)


def begin_episode(**arguments):
    """Make an environment and begin an episode, which is closed: its log is then complete."""
    env = HoldSlotEnv(**arguments)
    try:
        env.reset(seed=1)
    finally:
        env.close()


MAKES = {
    **{
        f"Aircraft {name}": lambda v, name=name: testbed.Aircraft(
            **{"aircraft": "rascal110", "airspeed_mps": 22} | {name: v}
        )
        for name in (*_ARGUMENTS, "progress")
    },
    **{
        f"HoldSlotEnv {name}": lambda v, name=name: begin_episode(**{name: v})
        for name in (*Task.model_fields, "follower", "randomize", "render_mode")
    },
    **{
        f"Simulation {name}": lambda v, name=name: testbed.Simulation(WHOLE, **{name: v}).close()
        for name in ("overrides", "seed", "duration_s", "out", "observers", "progress", "stages")
    },
    **{
        f"run {name}": lambda v, name=name: testbed.run(WHOLE, **{"write": False, name: v})
        for name in (
            *("overrides", "duration_s", "seed", "out", "progress", "observers", "external"),
            *("processes", "stages"),
        )
    },
    **{
        f"ExternalOptions {each.name}": lambda v, name=each.name: ExternalOptions(**{name: v})
        for each in fields(ExternalOptions)
    },
    **{
        f"Batch {name}": lambda v, name=name: testbed.Batch(
            **{"scenario": "simulation-3", "duration_s": 0.1} | {name: v}
        )
        for name in ("scenario", "overrides", "seeds", "rows", "duration_s", "progress")
    },
    "Batch of a scenario": lambda v: testbed.Batch(WHOLE, seeds=v),
    **{
        f"Batch.{name} {key or ''}": lambda v, name=name, key=key: getattr(
            testbed.Batch(WHOLE, seeds=[1, 2, 3]), name
        )(**{key: v})
        for name, key in (
            *(("step", "until"), ("reset", "rows"), ("reset", "seeds"), ("metrics", "row")),
            *(("events", "row"), ("scenario", "row")),
        )
    },
    "scenario": lambda v: testbed.Simulation(v),
    "FormationEnv": lambda v: FormationEnv(v),
    "load_scenario": lambda v: load_scenario(v),
    "overrides": lambda v: load_scenario("hold-slot", v),
    "load_run": lambda v: testbed.load_run(v),
    "set_seed": lambda v: set_seed(WHOLE, v),
    "set_duration": lambda v: set_duration(WHOLE, v),
    "sweep": lambda v: sweep(v),
    "sweep jobs": lambda v: sweep("no such study", jobs=v),
    "sweep refresh_s": lambda v: sweep("no such study", refresh_s=v),
}


def call(function, *arguments):
    """Return whether a call succeeded.

    Raises:
        AssertionError: it ended in an error that is not documented.
    """
    try:
        function(*arguments)
    except InputError as error:
        text = str(error)
        assert text and "\n" not in text.replace("\n… and", ""), text
        assert not re.search(r"numpy|pydantic|broadcast|setting an array|NoneType|float\(\)", text)
        return False
    return True


def over(target):
    flight = target.simulation if hasattr(target, "simulation") else target
    return flight.outcome is not None or getattr(target, "agents", True) == []


def bits(target):
    """Return everything that a step changes, as bytes."""
    flight = target.simulation if hasattr(target, "simulation") else target
    parts = [flight.time_s, flight.outcome, flight.scenario.scenario.seed, flight.commands]
    parts += [each.tobytes() for each in (*flight.state.truth, *flight.state.command)]
    if hasattr(target, "_episodes"):
        episodes = target._episodes
        generator = target._generator if hasattr(target, "_generator") else target.np_random
        parts += [episodes._steps, episodes._changes, generator.bit_generator.state]
        parts += [each.tobytes() for each in episodes._actions.values()]
    return parts


def drawn(number, names):
    rng = random.Random(f"arguments/{number}")
    return rng.choice(names), rng.choice(VALUES)


def test_refused_steps_leave_no_trace():
    """Calls with any value; a twin gets only those that succeed."""
    ours, twins, seen = new_targets(), new_targets(), set()
    names = [(target, step) for target, steps in STEPS.items() for step in steps]
    for number in range(CALLS):
        (target, step), value = drawn(number, names)
        one, twin = ours[target], twins[target]
        if over(one):
            for each in (one, twin):
                each.reset(seed=1)
        done = call(STEPS[target][step], one, value)
        if done:
            STEPS[target][step](twin, value)
        seen.add(done)
        assert bits(one) == bits(twin), (number, target, step, value)
    assert seen == {True, False}


def test_constructors_end_in_documented_errors(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = set()
    for number in range(CALLS // 2):
        name, value = drawn(number, [*MAKES])
        try:
            seen.add(call(MAKES[name], value))
        except Exception as error:
            raise AssertionError(f"{number}: {name} with {type(value).__name__}") from error
    assert seen == {True, False}


@pytest.mark.parametrize("action", [[np.nan, 0, 0], [0, 0], "abc", None, np.zeros((1, 3))])
def test_refused_action_keeps_the_episode(action):
    """The next step flies one period, and its reward is that without the refused one."""
    results = []
    for refused in (False, True):
        env = HoldSlotEnv(duration_s=2.0)
        env.reset(seed=1)
        if refused:
            with pytest.raises(InputError, match="action of uav1: .*three numbers from -1 to 1"):
                env.step(action)
        _, reward, _, _, info = env.step(STILL)
        results.append((reward, info["time_s"]))
    assert results[0] == results[1] and np.isfinite(results[0][0])


@pytest.mark.parametrize("make", [HoldSlotEnv, FormationEnv])
@pytest.mark.parametrize("action", [STILL, {}])
def test_step_before_reset_says_so(make, action):
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset\(\)") as caught:
        make().step(action)
    assert isinstance(caught.value, InputError)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"smoothness": float("nan")}, r"smoothness: is nan \(write a finite number"),
        ({"smoothness": -1}, "smoothness: is -1"),
        ({"control_ticks": 1.5}, r"control_ticks: is 1\.5 \(write a whole number"),
        ({"collision_m": -1}, r"collision_m: is -1 \(write a number above 0"),
        ({"duration_s": "3"}, r"duration_s: is '3' \(write 3, without quotes"),
        ({"limit": 3}, "limit: is not a key .*did you mean 'limit_m'"),
        ({"overrides": "rates.log_hz=50"}, r"overrides: is 'rates.log_hz=50' \(write a list"),
        ({"overrides": ["scenario.seed=3"]}, "overrides: scenario.seed=3: has no effect here"),
        ({"randomize": {"scenario.seed": [3]}}, "randomize: scenario.seed: has no effect here"),
        ({"randomize": {"scenario.duration_s": (3.0, 5.0)}}, "write the argument duration_s"),
        ({"randomize": {"air.wind.speed_mps": (8.0, 0.0)}}, r"is not a range \(write \(0\.0, 8\.0"),
        (
            {"randomize": {"air.wind.speed_mps": (0.0, 99.0)}},
            "randomize: air.wind.speed_mps: is 99",
        ),
        ({"randomize": {"air.wnd": (0.0, 1.0)}}, "randomize: air.wnd: is not a key"),
        ({"render_mode": "human"}, "render_mode: is 'human'"),
    ],
)
def test_argument_of_environment_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        HoldSlotEnv(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mavlink": "udpout:127.0.0.1:14550"}, r"^mavlink: is 'udpout:.* \(write "),
        ({"mavlink": ["14550"]}, r"^mavlink\[0\]: is '14550' \(write parse_address"),
        ({"mavlink": (Address("udpout", "host", 0),)}, r"^mavlink\[0\]: 'udpout:host:0': port 0;"),
        (
            {"mavlink": (Address("udpout", "host", 1.0),)},
            r"^mavlink\[0\]: .* not a MAVLink address",
        ),
        ({"mavlink": (Address("tcp", "host", 1),)}, r"^mavlink\[0\]: .* not a MAVLink address"),
        ({"mavlink": (Address("udpin", "", 1),)}, r"^mavlink\[0\]: .* reads as udpin:127"),
        (
            {"mavlink": (Address("udpin", "host", 10**5000),)},
            r"^mavlink\[0\]: .*write a port of 1 ",
        ),
        ({"pace": float("nan")}, "^pace nan: write a number from 0.001"),
        ({"pace": 1e-300}, "^pace 1e-300: write a number from 0.001"),
        ({"pace": "1"}, "^pace '1': write a number from 0.001"),
        ({"pace": True}, "^pace True: write a number from 0.001"),
        ({"tlog": "no"}, r"^tlog: is 'no' \(write false"),
        ({"quiet": 1}, r"^quiet: is 1 \(write true or false"),
        ({"signing_key": b"secret"}, "^signing_key: 6 bytes; give 32"),
        ({"signing_key": "s" * 32}, "^signing_key: is a str; give 32 bytes"),
        ({"arduplane": 3}, r"^arduplane: is 3 \(write a text or a path"),
        ({"arduplane": "\0"}, "^arduplane: is .*, not a path"),
        ({"announce": "x"}, r"^announce: is 'x' \(write a function"),
    ],
)
def test_external_option_is_checked(arguments, message):
    with pytest.raises(InputError, match=message) as caught:
        ExternalOptions(**arguments)
    assert "secret" not in str(caught.value) and "sss" not in str(caught.value)


def test_external_options_are_read_as_on_a_shell():
    address = parse_address("udpin:127.0.0.1:14550+10")
    options = ExternalOptions((address,), np.float32(2.0), arduplane="x")
    assert (options.mavlink, options.pace, options.arduplane) == ((address,), 2.0, Path("x"))
    assert ExternalOptions(pace=0).pace is None


def test_changed_section_is_validated():
    limits = WHOLE.limits
    with pytest.raises(InputError, match=r"^collision_m: is -1 \(write a number above 0\)"):
        with_changes(limits, collision_m=-1)
    with pytest.raises(InputError, match="^limits.collision_m: 9 m is above separation_m, 5 m"):
        with_changes(WHOLE, limits=with_changes(limits, collision_m=9, separation_m=5))
    changed = with_changes(limits, collision_m=3)
    assert changed == limits.model_copy(update={"collision_m": 3.0})


def test_sections_are_copied_with_validation_only():
    root = ROOT
    files = [
        *root.glob("testbed/**/*.py"),
        *root.glob("examples/*.py"),
        *root.glob("benchmarks/*.py"),
        *root.glob("paper/*.py"),
    ]
    pattern = re.compile(r"model_copy\(update|model_construct\(")
    found = [each.name for each in files if pattern.search(each.read_text(encoding="utf-8"))]
    assert found == ["network.py"]  # a link, merged from values that are validated, for each pair


def test_seed_of_the_scenario_is_a_whole_number():
    with pytest.raises(InputError, match=r"^seed: is 7\.0 \(write 7, a whole number"):
        set_seed(WHOLE, 7.0)


@pytest.fixture(scope="module")
def batch():
    return testbed.Batch(SHORT, seeds=[1, 2, 3])


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda b: testbed.Batch("simulation-1", seeds={1, 2}), r"^seeds: is \{1, 2\} \(write a"),
        (lambda b: testbed.Batch("simulation-1", rows={"a"}), r"^rows: is .* \(write a list"),
        (lambda b: testbed.Batch("simulation-1", seeds=b"12"), r"^seeds: is .* \(write a list"),
        (lambda b: testbed.Batch(b"simulation-1"), "simulation-1"),
        (lambda b: testbed.Batch({"simulation-1"}), "simulation-1"),
        (lambda b: b.reset(rows=5), r"^rows: is 5 \(write a list: numbers of rows\)"),
        (lambda b: b.reset(seeds=5), r"^seeds: is 5 \(write a list: whole numbers\)"),
        (lambda b: b.reset(rows="12"), r"^rows: is '12' \(write a list"),
        (lambda b: b.reset(rows=[True]), "^row: is "),
        (lambda b: b.step(1j), r"^until: is 1j \(write a time from 0"),
        (lambda b: b.step(True), r"^until: is True \(write a time from 0"),
        (lambda b: b.step([True, 1.0, 1.0]), r"^until: is .* \(write a time from 0"),
        (lambda b: b.step({1.0}), r"^until: is .* \(write a time from 0"),
        (lambda b: b.step([1, [2], 3]), r"^until: is .* \(write a time from 0"),
        (lambda b: b.step(10**400), r"^until: is .* \(write a time from 0"),
    ],
)
def test_argument_of_batch_is_named(function, message, batch):
    before = batch.times_s.tolist(), batch.aircraft.tobytes(), list(batch.seeds)
    with pytest.raises(InputError, match=message):
        function(batch)
    assert before == (batch.times_s.tolist(), batch.aircraft.tobytes(), batch.seeds)
