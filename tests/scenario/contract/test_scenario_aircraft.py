"""Sensors, faults and limits: defaults, presets and settings."""

from typing import get_args

import numpy as np
import pytest
from places import TESTS

from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains
from testbed.plan.world import build
from testbed.scenario import ScenarioError, dump, load_scenario, loads, set_duration
from testbed.scenario.faults import AnyFault
from testbed.scenario.sensors import SENSOR_NAMES, TRUTH, Estimator, Sensors

FOLDER = TESTS / "data" / "scenarios"
MINIMAL = (FOLDER / "minimal.yaml").read_text()
KINDS = {
    "engine-out": "",
    "thrust-loss": ", remaining: 0.5",
    "surface-stuck": ", surface: elevator",
    "surface-floating": ", surface: rudder",
    "airspeed-blocked": "",
    "gps-lost": "",
    "gps-jump": ", offset_m: [1, 2, 3]",
    "autopilot-frozen": "",
    "transmitter-off": "",
    "battery-low": ", state_of_charge: 0.3",
}
FLIGHT_MODEL = ("engine-out", "thrust-loss", "surface-stuck", "surface-floating")
FLIGHT_MODEL += ("autopilot-frozen", "battery-low")


def read(text, *overrides):
    """Read minimal.yaml with more keys of its follower, as YAML."""
    assert MINIMAL.count("name: uav1,") == 1
    return loads(MINIMAL.replace("name: uav1,", f"name: uav1, {text},"), overrides)


def sensors(text, *overrides):
    return read(f"sensors: {text}", *overrides).fleet[0].sensors


def fault(text):
    (one,) = read(f"faults: [{{{text}}}]").fleet[0].faults
    return one


def test_sensors_without_errors_are_exact():
    assert TRUTH.exact and not TRUTH.measured
    assert Sensors(estimator=Estimator(gate_sigma=3.0)).exact
    for name in SENSOR_NAMES:
        one = sensors(f"{{{name}: {{}}}}")
        assert one.measured and not one.exact
        assert [each for each in SENSOR_NAMES if getattr(one, each) is not None] == [name]
    noisy = sensors("gps-ins")
    assert not noisy.exact and not noisy.measured


@pytest.mark.parametrize("name", ["gps-ins", "pixhawk", "degraded"])
def test_preset_is_dumped_in_full(name):
    whole = read(f"sensors: {name}")
    text = dump(whole)
    assert name not in text and "preset" not in text
    assert loads(text) == whole
    assert sensors(f"{{preset: {name}}}") == whole.fleet[0].sensors
    assert "sensors: truth" in text  # the leader's


def test_map_changes_preset_key_by_key():
    changed, preset = (
        sensors("{preset: pixhawk, gps: {rate_hz: 1}, gyro: null}"),
        sensors("pixhawk"),
    )
    assert changed.gps == preset.gps.model_copy(update={"rate_hz": 1})
    assert changed.gyro is None
    assert changed.barometer == preset.barometer != sensors("degraded").barometer
    late = sensors("{preset: degraded, estimator: {gps_delay_s: 0.22}}")
    assert late.estimator == Estimator(gps_delay_s=0.22)
    assert late.gps.latency_s == 0.22 != sensors("degraded").estimator.gps_delay_s
    assert sensors("{gps: {rate_hz: 1}}").gps.noise_m == (0.0, 0.0)


@pytest.mark.parametrize("written", ["pixhawk", "{preset: pixhawk, gps: {rate_hz: 2}}"])
def test_setting_changes_one_number_of_a_preset(written):
    at = "fleet.*.sensors"
    preset = sensors("pixhawk")
    one = sensors(written, f"{at}.gps.rate_hz=1")
    assert one == preset.model_copy(update={"gps": preset.gps.model_copy(update={"rate_hz": 1})})
    assert sensors(written, f"{at}.gps=null") == preset.model_copy(update={"gps": None})
    assert sensors(written, f"{at}.preset=degraded").barometer == sensors("degraded").barometer


def test_null_setting_restores_number_of_preset():
    text = "{preset: pixhawk, gps: {rate_hz: 2}}"
    assert sensors(text, "fleet.0.sensors.gps.rate_hz=null") == sensors("pixhawk")


def test_extending_file_changes_preset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base = MINIMAL.replace(
        "leader:\n", "leader:\n  sensors: {preset: pixhawk, gps: {rate_hz: 1}}\n"
    )
    assert base != MINIMAL
    (tmp_path / "base.yaml").write_text(base)
    top = loads("extends: base.yaml\nleader: {sensors: {gps: null}}")
    assert top.leader.sensors == sensors("{preset: pixhawk, gps: null}")
    top = loads("extends: base.yaml\nleader: {sensors: {gps: {latency_s: 0.3}}}")
    assert (top.leader.sensors.gps.rate_hz, top.leader.sensors.gps.latency_s) == (1, 0.3)
    top = loads("extends: base.yaml\nleader: {sensors: {preset: null, gps: null}}")
    assert top.leader.sensors == TRUTH


def test_sensor_rate_is_at_most_the_autopilots():
    assert sensors("{gps: {rate_hz: 50}}").gps.rate_hz == 50
    with pytest.raises(ScenarioError) as caught:
        read("sensors: pixhawk", "rates.autopilot_hz=8")
    text = "fleet.0.sensors: the barometer measures at 10 Hz, above rates.autopilot_hz, 8"
    assert text in str(caught.value)
    assert "gps" not in str(caught.value)


def test_fault_kinds_are_complete():
    union = get_args(AnyFault)[0]
    known = {get_args(kind.model_fields["kind"].annotation)[0] for kind in get_args(union)}
    assert known == set(KINDS)


@pytest.mark.parametrize(("kind", "own"), KINDS.items())
def test_fault_is_declared_by_its_kind(kind, own):
    one = fault(f"kind: {kind}, at_s: 3{own}")
    undeclared = kind in ("airspeed-blocked", "gps-jump", "autopilot-frozen", "transmitter-off")
    assert one.is_declared is not undeclared
    # what sends nothing cannot declare anything
    for declared in (False,) if kind in ("autopilot-frozen", "transmitter-off") else (True, False):
        asked = f"kind: {kind}, at_s: 3, declared: {str(declared).lower()}{own}"
        assert fault(asked).is_declared is declared
    assert one.NEEDS_FLIGHT_MODEL is (kind in FLIGHT_MODEL)
    assert next(iter(one.model_dump())) == "kind"


def test_condition_begins_fault_with_or_without_time():
    low = fault("kind: gps-lost, when: {quantity: airspeed_mps, below: 15}")
    assert (low.at_s, low.when.quantity, low.when.below, low.when.above) == (
        None,
        "airspeed_mps",
        15.0,
        None,
    )
    both = fault("kind: gps-lost, at_s: 10, when: {quantity: bank_deg, above: 0}")
    assert (both.at_s, both.when.above) == (10.0, 0.0)  # at the end of the run


def test_set_duration_drops_later_faults():
    text = "faults: [{kind: gps-lost, at_s: 4}, {kind: gps-lost, at_s: 4.5}, {kind: engine-out, "
    text += "when: {quantity: bank_deg, above: 50}}]"
    (short,) = set_duration(read(text), 4.0).fleet
    assert [one.at_s for one in short.faults] == [4.0, None]


def test_limits_and_response_are_read():
    settings = [
        "limits={collision_m: 2, separation_m: 2}",
        "formation.on_failure.response=reassign-slots",
    ]
    one = read("tune: autopilot", *settings)
    assert (one.limits.collision_m, one.limits.separation_m) == (2.0, 2.0)
    assert one.formation.on_failure.response == "reassign-slots"
    assert load_scenario(FOLDER / "everything.yaml").limits.on_loss == "continue"


def test_pressure_of_a_sensor_is_filtered_once():
    """The filter of a described airspeed sensor is ArduPlane's; a retuned autopilot keeps that."""
    loaded = load_scenario("simulation-3", ["fleet.uav1.sensors={airspeed: {noise_pa: 1}}"])
    world = build(loaded)
    (jsbsim,) = world.vehicles
    weights = jsbsim.autopilots.gains["pressure_weight"]
    assert weights.tolist() == [0.3, 1.0, 0.3, 0.3]
    jsbsim.retune(1, FbwaParams(rll_rate_smax=100.0))
    assert weights.tolist() == [0.3, 1.0, 0.3, 0.3]
    assert jsbsim.autopilots.gains["slew_max"][1].tolist() == [100.0, 150.0]


def test_gyro_filter_of_sitl_reaches_its_aircraft():
    """Its cut-off follows rates.physics_hz; a retuned autopilot keeps its kind of filter."""
    own = ["fleet.uav2.autopilot={kind: virtual, gyro_filter: sitl}", "rates.physics_hz=400"]
    (jsbsim,) = build(load_scenario("simulation-3", own)).vehicles
    gains = jsbsim.autopilots.gains
    assert gains["sitl_physics_hz"].tolist() == [0.0, 0.0, 400.0, 0.0]
    sitl = make_gains([FbwaParams()], 0.02, AutopilotTiming(sitl_physics_hz=400.0))
    assert gains["gyro_b"][2].tolist() == sitl["gyro_b"][0].tolist()
    jsbsim.retune(2, FbwaParams(ins_gyro_filter=10.0))
    assert gains["gyro_b"][2].tolist() != sitl["gyro_b"][0].tolist()
    jsbsim.retune(2, FbwaParams())
    assert gains["gyro_b"][2].tolist() == sitl["gyro_b"][0].tolist()


@pytest.mark.parametrize(
    ("size", "problem"),
    [("", "neither radius_m nor bank_deg"), (", radius_m: 90, bank_deg: 20", "both sizes")],
)
def test_circle_has_a_radius_or_a_bank(size, problem):
    path = "leader.path={{kind: virtual, speed_mps: 22, curve: {{kind: circle{}}}}}"
    with pytest.raises(ScenarioError, match=f"leader.path.curve: has {problem} .*bank_deg: 20; nu"):
        loads(MINIMAL, [path.format(size)])
    gain = "formation.leader_gains={uav1: 1}"
    # R = V² / (g tan φ) = 22² / (9.80665 · tan 20°) = 135.60 m
    for bank, same in ((20, True), (21, False)):
        paths = [
            build(loads(MINIMAL, [path.format(f", {each}"), gain])).info.leader_path_ned
            for each in (f"bank_deg: {bank}", "radius_m: 135.6")
        ]
        assert np.allclose(*paths, atol=0.05) == same
