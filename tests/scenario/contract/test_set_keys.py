"""A key that is set and that nothing in the flight reads is an error; one that acts is none."""

import os
import re
import shutil

import numpy as np
import pytest
from cases import ALL
from key_draws import (
    REFUSED,
    alternatives,
    candidates,
    draws,
    flies,
    flown,
    made_by,
    said,
    scenario_of,
)
from places import ROOT, SHARED

import testbed
from testbed.core.errors import InputError
from testbed.formation.compiled_law import allocate_inputs
from testbed.law import VehicleState, ground_speed_bounds
from testbed.plan.world import build
from testbed.scenario import ScenarioError, load_scenario, set_duration
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan

SEED = 20261129
COUNT = int(os.environ.get("TESTBED_KEYS", "2"))
# What keys wait for that are read and change nothing in a short flight, by what reads them.
WAITS = {
    "limits.": "a limit that is exceeded",
    "testbed.network.outages.": "a time in the flight",
    "faults.": "a fault that begins",
    "control._write_timeouts": "messages that stop",
    "control.leader_timeout": "messages that stop",
    "control.neighbour_timeout": "messages that stop",
    "control._write_extrapolation": "a late message",
    "control.make_barrier": "a speed near its bounds",
    "control.speeds": "a speed at its bounds",
    "control._speed_set": "a desired speed at its bounds",
    "control.make_loops": "a command at its limit",
    "leader.": "a later part of the path",
    "commands.": "a program that commands",
    "world._build": "a program that commands, or a lost aircraft",
    "air.": "a height, a gust or a vortex",
    "estimators.": "a measurement that is rejected",
}


def describe_wait(consumers):
    return {text for name, text in WAITS.items() for one in consumers if one.startswith(name)}


def test_what_has_no_effect_is_said():
    """Of drawn keys: a flight with the value and with both bounds, compared with one without.

    That one has the section that the key is in: a key of a sensor makes the sensor, too.
    """
    plain, waiting, wrong, count = {}, [], [], 0
    for draw in draws(SEED, 10 * COUNT, candidates()):
        scenario = scenario_of(draw, draw.value)
        if count == COUNT:
            break
        if not flies(scenario):
            continue
        count += 1
        is_said, consumers = said(scenario)
        without = draw.scenario, made_by(draw)
        if without not in plain:
            plain[without] = flown(load_scenario(*without))
        differs = any(
            each is REFUSED or flown(each) != plain[without] for each in alternatives(draw)
        )
        if is_said == differs and not (differs is False and describe_wait(consumers)):
            wrong.append((str(draw), is_said, sorted(consumers)))
        elif not is_said and not differs:
            waiting.append((str(draw), sorted(describe_wait(consumers))))
        print(count, draw, "said" if is_said else "", "acts" if differs else "", flush=True)
    for each in waiting:
        print("waits", *each)
    assert not wrong
    assert count == COUNT and len(waiting) <= max(2, COUNT // 5)


LAWS = ("Sticks", "Speeds", "Velocity", "Paper")
ROW = re.compile(r"^\| (`.+?`) \| (.+?) \| (.+?) \|$", re.M)
WORDS = {
    "every law": set(LAWS),
    "`UnicycleCommand`": {"Speeds", "Velocity", "Paper"},
    "`command_from_velocity`, `config.hbh23`": {"Velocity", "Paper"},
    "`config.hbh23.step`": {"Paper"},
}
VALUES = {  # of keys whose number is no value between its bounds
    "formation.offsets_m": "{uav1: [-10, 10.5, 0], uav2: [-10, -10, 0], uav3: [-20, 20, 0]}",
    "formation.leader_gains": "{uav1: 2, uav2: 2, uav3: 2}",
    "formation.neighbour_gains": "{uav1: {uav2: 1}}",
    "formation.speed_mps": "[16, 31]",
    "formation.speed_desired_mps": "[18, 28]",
    "formation.control_function": "{example: 2}",
    "formation.barrier": "{example: 4}",
    "controller.extrapolate_from": "timestamp",
    "controller.estimators.extrapolation": "acceleration",
    "controller.estimators.leader_acceleration": "none",
    "controller.estimators.leader_angular_acceleration": "roll_rate",
    "controller.on_leader_timeout": "loiter",
    "controller.on_neighbour_timeout": "hold-relative-position",
    "controller.throttle_error": "airspeed",
    "controller.pitch_feedforward": "incidence",
    "controller.gains.limits.roll_deg": "40",
    "controller.gains.limits.pitch_deg": "18",
    "controller.gains.trim_throttle": "0.3",
    "controller.gains.trim_airspeed_mps": "21",
}


def documented():
    """The keys of the table in own-law.md: what uses each."""
    page = (ROOT / "docs/own-law.md").read_text(encoding="utf-8")
    table = page.partition("### Keys that are yours")[2].partition("\n## ")[0]
    return {
        key: used
        for keys, _, used in ROW.findall(table)
        for key in re.findall(r"`([a-z_.]+)`", keys)
    }


@pytest.fixture(scope="module")
def own_laws(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laws")
    shutil.copy(SHARED / "key_laws.py", folder)
    for name in (*LAWS, "sticks"):
        text = f"extends: simulation-3\nscenario: {{name: {name}}}\n"
        file = folder / f"{name}_law.yaml"
        file.write_text(f"{text}controller: {{law: key_laws:{name}}}\n", encoding="utf-8")
    return folder


def settings_of(keys):
    return [f"{key}={VALUES.get(key, 0.7)}" for key in keys]


def test_documented_keys_of_a_law(own_laws):
    """Each key of the table, with laws that use nothing, the second half, and the paper's law."""
    keys = documented()
    assert len(keys) > 20
    unused = {}
    for law in LAWS:
        scenario = load_scenario(own_laws / f"{law}_law.yaml", settings_of(keys))
        world = build(scenario, unused="list")
        unused[law] = {".".join(each.key.path) for each in world.unused}
    for key, used in keys.items():
        laws = {law for law in LAWS if not any(each.startswith(key) for each in unused[law])}
        if used.startswith("a law that reads"):
            assert laws < set(LAWS), key
        else:
            assert laws == WORDS[used], key


def test_keys_of_extended_files_are_silent(own_laws):
    """The first inherits all gains of the paper's law; the second sets one of them."""
    assert not build(load_scenario(own_laws / "Sticks_law.yaml")).unused
    own = own_laws / "own.yaml"
    own.write_text(
        "extends: Sticks_law.yaml\nscenario: {name: own}\nformation:\n  k: 2\n", encoding="utf-8"
    )
    with pytest.raises(ScenarioError) as caught:
        build(load_scenario(own))
    (problem,) = caught.value.problems
    assert (problem.place.line, problem.path) == (4, ("formation", "k"))
    assert "key_laws.py:Sticks, and neither it" in problem.text
    # its remedy
    build(load_scenario(own, ["controller.law=hbh23"]))
    # and what puts a key of the file out of action is a warning
    (event,) = [
        each
        for each in build(load_scenario(own, ["controller.leader_timeout_s=4"])).initial_events
        if "has no effect" in each.text
    ]
    assert event.level == "warning" and "formation.k" in event.text


def test_resolved_scenarios_are_flown(own_laws, tmp_path):
    """It has every key, those without effect too."""
    file = tmp_path / "scenario.resolved.yaml"
    shutil.copy(own_laws / "key_laws.py", tmp_path)
    scenario = load_scenario(own_laws / "Sticks_law.yaml")
    file.write_text(build(scenario).info.scenario_yaml, encoding="utf-8")
    assert not build(load_scenario(file)).unused


WITHOUT = (
    ("simulation-3", "air.wind.from_deg=90", "no wind blows"),
    ("simulation-3", "air.wind={profile: {kind: log}}", "no wind blows"),
    ("ideal-figure-eight", "leader.tune=autopilot", "a leader with a path of kind virtual"),
    ("ideal-figure-eight", "fleet.*.tune=autopilot", "is an ideal vehicle"),
    ("simulation-3", "fleet.*.sensors.estimator.gate_sigma=3", "no sensor of uav1 uses it"),
    ("simulation-3", "air.turbulence.intensity=light", "air.turbulence.model is none"),
    ("simulation-3", "network.loss={probability: 0, correlation: 0.5}", "no part of this flight"),
    ("simulation-3", "controller.gains.altitude.p=0.1", "no part of this flight"),
    ("simulation-3", "formation.on_failure.declared_after_s=3", "no part of this flight"),
    ("own-law-leader-follower", "controller.gains.course.p=2", "neither it nor what flies its"),
)


@pytest.mark.parametrize(("name", "setting", "reason"), WITHOUT)
def test_settings_without_effect_are_refused(name, setting, reason):
    with pytest.raises(ScenarioError) as caught:
        build(load_scenario(name, [setting]))
    assert reason in str(caught.value) and f"--set {setting}: " in str(caught.value)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("simulation-3", ["air.wind.speed_mps=5", "air.wind.from_deg=90"]),
        ("simulation-3", ["fleet.*.sensors=pixhawk", "fleet.*.sensors.estimator.gate_sigma=3"]),
        ("experiment-3", ["controller.gains.altitude.p=0.1"]),
        ("own-law-integral", ["formation.k=2"]),
    ],
)
def test_settings_that_act_are_silent(name, settings):
    assert not build(load_scenario(name, settings)).unused


def test_short_flights_need_no_answer_to_later_faults():
    """The fault at 125 s is dropped, and its response with it; nothing else is."""
    whole = load_scenario("engine-out-uav2")
    assert not build(set_duration(whole, 10.0)).unused
    assert not build(set_duration(whole, 126.0)).unused
    for setting in ("air.wind.from_deg=90", "air.turbulence.intensity=light"):
        with pytest.raises(ScenarioError, match="has no effect"):
            build(set_duration(load_scenario("engine-out-uav2", [setting]), 10.0))
    none = load_scenario("simulation-3", ["formation.on_failure.response=drop"])
    with pytest.raises(ScenarioError, match=r"on_failure\.response: has no effect"):
        build(set_duration(none, 10.0))


def test_keys_of_faults_after_a_shorter_flight():
    """A flight that ends before its fault leaves it out, and not what answers it."""
    answer = load_scenario("engine-out-uav2", ["formation.on_failure.response=drop"])
    assert build(answer).faults and build(set_duration(answer, 10.0)).faults is None
    assert not build(set_duration(set_duration(answer, 20.0), 10.0)).unused
    wind = load_scenario("engine-out-uav2", ["air.wind.from_deg=90"])
    with pytest.raises(ScenarioError, match="no wind blows"):
        build(set_duration(wind, 10.0))


def test_batches_and_studies_refuse_too(tmp_path):
    winds = [["air.wind.speed_mps=0"], ["air.wind.speed_mps=3"]]
    direction = ["air.wind.from_deg=90"]
    testbed.Batch("ideal-figure-eight", direction, rows=winds)
    with pytest.raises(ScenarioError, match="no wind blows"):
        testbed.Batch("ideal-figure-eight", direction, rows=winds[:1] * 2)
    study = tmp_path / "study.yaml"
    text = (
        "study: {schema: 1, name: study, scenario: ideal-figure-eight, seeds: [1],\n"
        "  set: {air.wind.from_deg: 90}}\n"
        "vary: {air.wind.speed_mps: [0, SPEED]}\n"
    )
    study.write_text(text.replace("SPEED", "3"), encoding="utf-8")
    checked = check_plan(Plan(load_study(study)))
    assert "no wind blows" in checked.without_effect[0]
    study.write_text(text.replace("[0, SPEED]", "[0]"), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        check_plan(Plan(load_study(study)))
    assert str(caught.value).startswith(f"{study}:2:")


# one law, as a kernel and as a class
KERNEL, CLASS = ROOT / "examples/leader-follower-kernel.yaml", "own-law-leader-follower"


def test_extrapolation_reaches_own_laws():
    """As a class and compiled alike; a law that extrapolates itself does it once."""
    flown = {}
    for law in (KERNEL, CLASS):
        for origin in ("receipt", "timestamp", "null") if law == KERNEL or ALL else ("timestamp",):
            own = "controller.options.closing=0.05"  # with which no speed is at its bounds
            settings = "network.delay_s=0.2", f"controller.extrapolate_from={origin}", own
            simulation = testbed.Simulation(law, settings, duration_s=2.0)
            flown[law, origin] = simulation.step(until=2.0).truth.position_ned
    for (law, origin), one in flown.items():
        np.testing.assert_allclose(one, flown[KERNEL, origin], atol=1e-9, err_msg=str(law))
    np.testing.assert_array_equal(flown[KERNEL, "receipt"], flown[KERNEL, "null"])
    apart = np.linalg.norm(flown[KERNEL, "timestamp"] - flown[KERNEL, "null"], axis=1)
    assert apart[1:].min() > 0.01


def test_the_extrapolated_inbox():
    """Positions along the velocity from the stamp; times are now, but of timed-out messages."""
    world = build(
        load_scenario("own-law-leader-follower", ["controller.extrapolate_from=timestamp"])
    )
    control, links = world.parts.control, world.links
    rng = np.random.default_rng(3)
    links["received_s"], links["stamp_s"] = 9.9, 9.7
    links["received_s"][:, 2] = 1.0  # above the timeout of 5 s
    vectors = ("position_ned", "velocity_ned", "acceleration_ned")
    for name, values in zip(vectors, rng.normal(size=(3, *links.shape, 3)), strict=True):
        links[name] = values
    inputs = allocate_inputs(*links.shape, 0)
    control._inputs_call(control.groups[0], *inputs)(10.0)
    inbox = inputs[1]
    moved = links["position_ned"] + 0.3 * links["velocity_ned"]
    for column in (0, 1, 3):
        np.testing.assert_allclose(inbox.position_ned[:, column], moved[:, column], atol=1e-12)
        assert (inbox.received_s[:, column] == 10.0).all()
        assert (inbox.stamp_s[:, column] == 10.0).all()
    np.testing.assert_array_equal(inbox.position_ned[:, 2], links["position_ned"][:, 2])
    assert (inbox.received_s[:, 2] == 1.0).all()


def test_the_example_flies_in_wind():
    """Its bounds are those of the airspeed; with those of calm air it is 31 to 37 m off."""
    wind = ["air.wind.speed_mps=8", "air.wind.from_deg=90"]
    windows = ["scenario.windows={joined: [20, 30]}", "scenario.published=null"]
    result = testbed.run(
        "own-law-leader-follower", wind + windows, duration_s=30.0, write=False, progress=False
    )
    assert max(result.metrics["windows"]["joined"]["rms_m"].values()) < 3.0


def test_bounds_of_speeds_in_wind(own_laws):
    calm = build(load_scenario(own_laws / "Sticks_law.yaml")).parts.built_control.config
    np.testing.assert_array_equal(calm.speed_min, calm.airspeed_min)
    np.testing.assert_array_equal(calm.ground_speed_max, calm.airspeed_max)
    windy = build(load_scenario(own_laws / "Sticks_law.yaml", ["air.wind.speed_mps=8"]))
    config = windy.parts.built_control.config
    np.testing.assert_array_equal(config.airspeed_min, calm.airspeed_min)
    assert not config.ground_speed_min.any() and np.isinf(config.ground_speed_max).all()
    with pytest.raises(InputError, match=r"write config\.airspeed_min and airspeed_max"):
        _ = config.speed_max
    own = VehicleState(*np.zeros((5, 3, 3)), *np.full((2, 3), 20.0))
    own.velocity_ned[:, 0] = 28.0  # of a tail wind of 8 m/s
    low, high = ground_speed_bounds(config, own)
    np.testing.assert_allclose(low, config.airspeed_min + 8.0)
    np.testing.assert_allclose(high, config.airspeed_max + 8.0)
    np.testing.assert_array_equal(ground_speed_bounds(calm, own)[1], calm.airspeed_max)
    file = own_laws / "old.py"
    file.write_text(
        "import testbed\nfrom testbed.law import FbwaCommand\n@testbed.kernel\n"
        "def old(now, own, inbox, memory, config):\n"
        "    return FbwaCommand(0.03, 0.0, 0.3 + 0.0 * config.speed_min)\n",
        encoding="utf-8",
    )
    setting = f"controller.law={file}:old"
    with pytest.raises(InputError, match=r"config\.speed_min is no bound of the ground speed"):
        build(load_scenario("simulation-3", [setting, "air.wind.speed_mps=8"]))
