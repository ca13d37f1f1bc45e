"""Sensors, faults and limits on the page: what they mean, and how a wrong one is refused."""

from pathlib import Path
from typing import get_args

import pytest

from testbed.scenario import ScenarioError, dump, load, loads, shorten
from testbed.scenario.faults import Fault
from testbed.scenario.sensors import MEASURE, TRUTH, Estimator, Sensors

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
MINIMAL = (PAGES / "minimal.yaml").read_text()
KINDS = {
    "engine-out": "",
    "thrust-loss": ", left: 0.5",
    "surface-stuck": ", surface: elevator",
    "surface-floating": ", surface: rudder",
    "airspeed-blocked": "",
    "gps-lost": "",
    "gps-jump": ", offset_m: [1, 2, 3]",
    "autopilot-frozen": "",
    "radio-mute": "",
    "battery-low": ", state_of_charge: 0.3",
}
EVERY_KIND = ", ".join(f"{{kind: {kind}, at_s: 1{own}}}" for kind, own in KINDS.items())
OF_FLIGHT = ("engine-out", "thrust-loss", "surface-stuck", "surface-floating")
OF_FLIGHT += ("autopilot-frozen", "battery-low")
VIRTUAL = "leader.path={kind: virtual, speed_mps: 20, curve: {kind: straight}}"
REPLAY = "leader.path={kind: replay, file: arduplane-auto-leader-rascal.csv}"


def page(text, *overrides):
    """The minimal page with keys for its follower, as YAML."""
    assert MINIMAL.count("name: uav1,") == 1
    return loads(MINIMAL.replace("name: uav1,", f"name: uav1, {text},"), overrides, source="p.yaml")


def complaint(text, *overrides):
    with pytest.raises(ScenarioError) as caught:
        page(text, *overrides)
    return str(caught.value)


def sensors(text, *overrides):
    return page(f"sensors: {text}", *overrides).fleet[0].sensors


def fault(text):
    (one,) = page(f"faults: [{{{text}}}]").fleet[0].faults
    return one


def test_only_what_says_no_sensor_and_no_error_is_exact():
    assert TRUTH.exact and not TRUTH.measured
    assert Sensors(estimator=Estimator(gate_sigma=3.0)).exact
    for name in MEASURE:
        one = sensors(f"{{{name}: {{}}}}")
        assert one.measured and not one.exact
        assert [each for each in MEASURE if getattr(one, each) is not None] == [name]
    noisy = sensors("gps-ins")
    assert not noisy.exact and not noisy.measured


def test_a_sensor_that_says_nothing_has_rates_and_no_errors():
    empty = sensors("{gps: {}, barometer: {}, airspeed: {}, gyro: {}, accelerometer: {}}")
    assert (empty.gps.rate_hz, empty.gps.latency_s) == (5, 0.12)
    assert (empty.barometer.rate_hz, empty.airspeed.rate_hz) == (10, 10)
    assert empty.airspeed.smoothing_s == 0.28
    assert sensors("{magnetometer: {}}").magnetometer.rate_hz == 10
    for name in MEASURE:
        for key, value in sensors(f"{{{name}: {{}}}}").model_dump()[name].items():
            if not key.endswith(("_hz", "_s")):
                assert value in (0.0, (0.0, 0.0)), (name, key)


def test_the_estimator_has_the_settings_of_ekf3_for_planes():
    settings = sensors("truth").estimator
    assert settings.gps_position_noise_m == 0.5
    assert settings.gps_velocity_noise_mps == (0.5, 0.7)
    assert (settings.barometer_noise_m, settings.airspeed_noise_mps) == (3.0, 1.4)
    # 0.5 rad, to the digits of the page
    assert settings.heading_noise_deg == pytest.approx(0.5 * 180.0 / 3.14159265, abs=0.06)
    assert (settings.gyro_noise_radps, settings.accelerometer_noise_mps2) == (0.015, 0.35)
    assert (settings.gate_sigma, settings.airspeed_gate_sigma) == (5.0, 4.0)


@pytest.mark.parametrize("name", ["gps-ins", "pixhawk", "degraded"])
def test_a_preset_is_written_out_and_reads_again_as_itself(name):
    whole = page(f"sensors: {name}")
    text = dump(whole)
    assert name not in text and "like" not in text
    assert loads(text) == whole
    assert sensors(f"{{like: {name}}}") == whole.fleet[0].sensors
    assert "sensors: truth" in text  # the leader's


def test_like_changes_key_by_key_what_a_preset_says():
    like, preset = sensors("{like: pixhawk, gps: {rate_hz: 1}, gyro: null}"), sensors("pixhawk")
    assert like.gps == preset.gps.model_copy(update={"rate_hz": 1})
    assert like.gyro is None
    assert like.barometer == preset.barometer != sensors("degraded").barometer
    late = sensors("{like: degraded, estimator: {gps_delay_s: 0.22}}")
    assert late.estimator == Estimator(gps_delay_s=0.22)
    assert late.gps.latency_s == 0.22 != sensors("degraded").estimator.gps_delay_s
    assert sensors("{gps: {rate_hz: 1}}").gps.noise_m == (0.0, 0.0)


@pytest.mark.parametrize("written", ["pixhawk", "{like: pixhawk, gps: {rate_hz: 2}}"])
def test_a_setting_changes_one_number_of_a_preset(written):
    at = "fleet.*.sensors"
    preset = sensors("pixhawk")
    one = sensors(written, f"{at}.gps.rate_hz=1")
    assert one == preset.model_copy(update={"gps": preset.gps.model_copy(update={"rate_hz": 1})})
    assert sensors(written, f"{at}.gps=null") == preset.model_copy(update={"gps": None})
    assert sensors(written, f"{at}.like=degraded").barometer == sensors("degraded").barometer


def test_a_number_taken_out_of_a_changed_preset_is_the_presets_again():
    text = "{like: pixhawk, gps: {rate_hz: 2}}"
    assert sensors(text, "fleet.0.sensors.gps.rate_hz=null") == sensors("pixhawk")


def test_a_page_on_top_of_another_takes_an_error_of_a_preset_away(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base = MINIMAL.replace("leader:\n", "leader:\n  sensors: {like: pixhawk, gps: {rate_hz: 1}}\n")
    assert base != MINIMAL
    (tmp_path / "base.yaml").write_text(base)
    top = loads("extends: base.yaml\nleader: {sensors: {gps: null}}")
    assert top.leader.sensors == sensors("{like: pixhawk, gps: null}")
    top = loads("extends: base.yaml\nleader: {sensors: {gps: {latency_s: 0.3}}}")
    assert (top.leader.sensors.gps.rate_hz, top.leader.sensors.gps.latency_s) == (1, 0.3)
    top = loads("extends: base.yaml\nleader: {sensors: {like: null, gps: null}}")
    assert top.leader.sensors == TRUTH


WRONG_SENSORS = [
    (
        "pixhawks",
        "sensors: 'pixhawks' is not a known sensor set: did you mean 'pixhawk'? (write one of "
        "truth, gps-ins, pixhawk, degraded, or a map of what errs)",
    ),
    (
        "{like: pixhawks}",
        "p.yaml:7:34: fleet.0.sensors.like: 'pixhawks' is not a known sensor set: did you mean "
        "'pixhawk'? (write one of truth, gps-ins, pixhawk, degraded)",
    ),
    ("{like: 3}", "fleet.0.sensors.like: 3 is not a known sensor set (write one of truth, "),
    (
        "{like: pixhawk, gpz: null}",
        "p.yaml:7:43: fleet.0.sensors.gpz: is not a key of this part: did you mean 'gps'? (write "
        "one of like, position, ",
    ),
    (
        "{like: pixhawk, gps: {rate: 5}}",
        "p.yaml:7:49: fleet.0.sensors.gps.rate: is not a key of this part: did you mean 'rate_hz'?",
    ),
    ("{like: pixhawk, gps: 5}", "sensors.gps: is 5 (write a map of keys and values; The GPS"),
    ("{gps: {noise_m: 3}}", "gps.noise_m: is 3 (write a list; White, 1 sigma of a fix"),
    ("{gps: {noise_m: [0, -1]}}", "gps.noise_m.1: is -1 (write a number at least 0)"),
    ("{gps: {rate_hz: 2.5}}", "gps.rate_hz: is 2.5 (write a whole number; How often"),
    ("{gps: {own_time_constant_s: 0}}", "own_time_constant_s: is 0 (write a number above 0)"),
    ("{airspeed: {scale: -1}}", "airspeed.scale: is -1 (write a number above -1)"),
    ("{estimator: {gate_sigma: 0}}", "estimator.gate_sigma: is 0 (write a number above 0)"),
    ("{estimator: null}", "sensors.estimator: is empty (write a map of keys and values; What"),
    (
        "{gps: {rate_hz: 100}}",
        "p.yaml:7:43: fleet.0.sensors.gps.rate_hz: the gps measures at 100 Hz, above "
        "rates.autopilot_hz, 50 Hz, at which sensors are read (write a rate_hz of at most 50)",
    ),
]


@pytest.mark.parametrize(
    ("text", "message"), WRONG_SENSORS, ids=[text for text, _ in WRONG_SENSORS]
)
def test_a_wrong_sensor_is_named_with_its_cure(text, message):
    assert message in complaint(f"sensors: {text}")


def test_a_rate_at_the_autopilots_is_allowed_and_a_presets_above_it_is_named():
    assert sensors("{gps: {rate_hz: 50}}").gps.rate_hz == 50
    text = complaint("sensors: pixhawk", "rates.autopilot_hz=8")
    assert "fleet.0.sensors: the barometer measures at 10 Hz, above rates.autopilot_hz, 8" in text
    assert "gps" not in text


def test_every_kind_is_here():
    union = get_args(Fault)[0]
    known = {get_args(kind.model_fields["kind"].annotation)[0] for kind in get_args(union)}
    assert known == set(KINDS)


@pytest.mark.parametrize(("kind", "own"), KINDS.items())
def test_a_fault_says_little_and_means_this(kind, own):
    one = fault(f"kind: {kind}, at_s: 3{own}")
    assert (one.kind, one.at_s, one.when, one.lasts_s, one.declared) == (kind, 3.0, *[None] * 3)
    silent = kind in ("airspeed-blocked", "gps-jump", "autopilot-frozen", "radio-mute")
    assert one.is_declared is not silent
    assert fault(f"kind: {kind}, at_s: 3, declared: false{own}").is_declared is False
    assert one.OF_FLIGHT is (kind in OF_FLIGHT)
    assert next(iter(one.model_dump())) == "kind"


def test_what_is_left_out_of_a_fault_has_a_default():
    assert fault("kind: surface-stuck, at_s: 0, surface: left-elevon").position is None
    assert fault("kind: surface-floating, at_s: 0, surface: aileron").ratio == 0.5
    assert fault("kind: airspeed-blocked, at_s: 0").drain == "blocked"
    assert fault("kind: gps-jump, at_s: 0, declared: true, offset_m: [1, 2, 3]").is_declared


def test_a_state_may_begin_a_fault_with_or_without_a_time():
    low = fault("kind: gps-lost, when: {quantity: airspeed_mps, below: 15}")
    assert (low.at_s, low.when.quantity, low.when.below, low.when.above) == (
        None,
        "airspeed_mps",
        15.0,
        None,
    )
    both = fault("kind: gps-lost, at_s: 10, when: {quantity: bank_deg, above: 0}")
    assert (both.at_s, both.when.above) == (10.0, 0.0)  # at the end of the run, and above nothing


WRONG_FAULTS = [
    (
        "kind: engine-out",
        "p.yaml:7:27: fleet.0.faults.0: never begins (write at_s: 20, say, in s, or when: "
        "{quantity: airspeed_mps, below: 15})",
    ),
    (
        "kind: engine-out, at_s: 11",
        "p.yaml:7:52: fleet.0.faults.0.at_s: 11 s is after the run, which lasts 10 s (write less, "
        "or a longer duration_s)",
    ),
    ("kind: engine-out, at_s: -1", "faults.0.at_s: is -1 (write a number at least 0)"),
    ("kind: engine-out, at_s: 1, lasts_s: 0", "lasts_s: is 0 (write a number above 0)"),
    (
        "kind: engine-out, when: {quantity: bank_deg}",
        "p.yaml:7:52: fleet.0.faults.0.when: says neither above nor below (write one of the two",
    ),
    (
        "kind: engine-out, when: {quantity: bank_deg, above: 0, below: 9}",
        "fleet.0.faults.0.when: says above and below (write one of the two, as in below: 15)",
    ),
    (
        "kind: engine-out, when: {quantity: bank, above: 1}",
        "when.quantity: is 'bank': did you mean 'bank_deg'? (write altitude_m, airspeed_mps, ",
    ),
    (
        "kind: battery-low, at_s: 1, state_of_charge: 0.2, lasts_s: 3",
        "faults.0.lasts_s: a battery in flight does not recharge (leave this out)",
    ),
    (
        "kind: battery-low, at_s: 1, state_of_charge: 0",
        "faults.0.state_of_charge: is 0 (write a number above 0)",
    ),
    (
        "kind: autopilot-frozen, at_s: 1, declared: true",
        "faults.0.declared: an autopilot that hangs tells nobody (leave this out)",
    ),
    (
        "kind: radio-mute, at_s: 1, declared: true",
        "faults.0.declared: an aircraft that is mute tells nobody (leave this out)",
    ),
    (
        "kind: engine-off, at_s: 1",
        "p.yaml:7:34: fleet.0.faults.0.kind: is 'engine-off': did you mean 'engine-out'? (write "
        "one of engine-out, thrust-loss, ",
    ),
    ("at_s: 1", "fleet.0.faults.0.kind: is missing (write one of airspeed-blocked, "),
    ("kind: thrust-loss, at_s: 1", "faults.0.left: is missing (write left: ...; Share of the"),
    ("kind: thrust-loss, at_s: 1, left: 1.2", "left: is 1.2 (write a number at most 1)"),
    (
        "kind: surface-stuck, at_s: 1, surface: elevon",
        "surface: is 'elevon': did you mean 'elevator'? (write aileron, elevator, rudder, ",
    ),
    (
        "kind: surface-stuck, at_s: 1, surface: rudder, position: 2",
        "position: is 2 (write a number at most 1)",
    ),
    ("kind: gps-jump, at_s: 1", "faults.0.offset_m: is missing (write offset_m: ...; By how"),
    ("kind: gps-jump, at_s: 1, offset_m: [1, 2]", "offset_m: has 2 elements (write 3; By how"),
    (
        "kind: gps-lost, at_s: 1, drain: open",
        "faults.0.drain: is not a key of this part (write one of kind, at_s, when, lasts_s, "
        "declared)",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG_FAULTS, ids=[text for text, _ in WRONG_FAULTS])
def test_a_wrong_fault_is_named_with_its_cure(text, message):
    assert message in complaint(f"faults: [{{{text}}}]")


def test_an_ideal_aircraft_has_no_parts_that_break():
    lines = complaint(f"faults: [{EVERY_KIND}]", "fleet.0.vehicle=ideal").splitlines()
    assert len(lines) == len(OF_FLIGHT)
    for kind, line in zip([kind for kind in KINDS if kind in OF_FLIGHT], lines, strict=True):
        number = list(KINDS).index(kind)
        assert line.endswith(
            f"fleet.0.faults.{number}.kind: is {kind}, and an ideal vehicle has no parts that "
            "break (leave the fault out, or write vehicle: jsbsim)"
        )


@pytest.mark.parametrize(("path", "kind"), [(VIRTUAL, "virtual"), (REPLAY, "replay")])
def test_a_leader_on_a_path_that_is_not_flown_has_no_parts_that_break(path, kind):
    setting = f"leader.faults=[{EVERY_KIND}]"
    lines = complaint("tune: autopilot", path, setting).splitlines()
    assert len(lines) == len(OF_FLIGHT)
    for line in lines:
        assert f"the leader flies its {kind} path whatever breaks" in line
        assert line.endswith("(leave the fault out, or write a path of kind: mission)")
    assert len(page("tune: autopilot", setting).leader.faults) == len(KINDS)


def test_a_condition_on_a_battery_wants_an_aircraft_that_can_have_one():
    text = "faults: [{kind: gps-lost, when: {quantity: state_of_charge, below: 0.5}}]"
    assert page(text).fleet[0].faults[0].when.below == 0.5
    assert "faults.0.when.quantity: is state_of_charge, and no battery is simulated here" in (
        complaint(text, "fleet.0.vehicle=ideal")
    )


def test_a_shortened_flight_has_the_faults_that_begin_in_it():
    text = "faults: [{kind: gps-lost, at_s: 4}, {kind: gps-lost, at_s: 4.5}, {kind: engine-out, "
    text += "when: {quantity: bank_deg, above: 50}}]"
    (short,) = shorten(page(text), 4.0).fleet
    assert [one.at_s for one in short.faults] == [4.0, None]


def test_limits_and_answers_are_read():
    settings = ["limits={collision_m: 2, separation_m: 2}", "formation.on_failure.answer=re-slot"]
    one = page("tune: autopilot", *settings)
    assert (one.limits.collision_m, one.limits.separation_m) == (2.0, 2.0)
    assert one.formation.on_failure.answer == "re-slot"
    assert load(PAGES / "everything.yaml").limits.when_lost == "fly-on"


WRONG_SETTINGS = [
    (
        ["limits={collision_m: 3, separation_m: 2}"],
        "limits.collision_m: 3 m is above separation_m, 2 m: the warning would come after the "
        "collision (write at most 2, or a larger separation_m)",
    ),
    (["limits={collision_m: 0}"], "limits.collision_m: is 0 (write a number above 0)"),
    (["limits={when_lost: go}"], "limits.when_lost: is 'go' (write stop or fly-on)"),
    (["limits={when_upset: go}"], "limits.when_upset: is 'go' (write stop or fly-on)"),
    (["limits={formation_m: 0}"], "limits.formation_m: is 0 (write a number above 0)"),
    (["limits={stall_deg: 200}"], "limits.stall_deg: is 200 (write a number at most 180)"),
    (["limits={overspeed_mps: -1}"], "limits.overspeed_mps: is -1 (write a number above 0)"),
    (
        ["formation.on_failure={answer: re-slot}", "formation.altitudes_m={uav1: 90}"],
        "formation.on_failure.answer: is re-slot, and altitudes_m names followers whose altitude "
        "would stay with them in another's slot (write drop, or leave altitudes_m out)",
    ),
    (
        ["formation.on_failure={answer: reslot}"],
        "on_failure.answer: is 'reslot': did you mean 're-slot'? (write fly-on, drop or re-slot)",
    ),
    (["formation.on_failure={after_s: -1}"], "after_s: is -1 (write a number at least 0)"),
]


@pytest.mark.parametrize(("settings", "message"), WRONG_SETTINGS, ids=str)
def test_a_wrong_answer_or_limit_is_named_with_its_cure(settings, message):
    assert message in complaint("tune: autopilot", *settings)
