"""Packets, pulses and start parameters of ArduPlane, against hand arithmetic."""

import json
import math
import struct

import numpy as np
import pytest
from places import ROOT
from reference.frames import rotation_ned_body

from testbed.ardupilot.json_physics import (
    LIMITS,
    MOTION_NUMBERS,
    RC_MAPS,
    SERVO_FUNCTIONS,
    ChannelError,
    PacketError,
    inputs_text,
    make_rc_channels,
    make_servo_outputs,
    motion_text,
    pack_motion,
    range_names,
    read_servos,
)
from testbed.ardupilot.sitl_parameters import TuneUse, defaults_text, tune_report
from testbed.autopilot import param_file
from testbed.autopilot.parameters import read_params
from testbed.core.frames import GRAVITY
from testbed.core.random import named_stream
from testbed.core.records import AIRCRAFT, FbwaCommand, allocate

RASCAL = ROOT / "aircraft" / "rascal110" / "autopilot.param"


def known(**changes):
    """Return ArduPlane's defaults with changes."""
    values = dict(zip(RC_MAPS, (1, 2, 3, 4), strict=True))
    values |= dict(zip(LIMITS, (45.0, 20.0, -25.0, 0.5), strict=True))
    values |= dict.fromkeys(SERVO_FUNCTIONS, 0)
    values |= {f"SERVO{n}_FUNCTION": f for n, f in ((1, 4), (2, 19), (3, 70), (4, 21))}
    for n in range(1, 17):
        for kind in ("RC", "SERVO"):
            values |= {f"{kind}{n}_MIN": 1100, f"{kind}{n}_TRIM": 1500}
            values |= {f"{kind}{n}_MAX": 1900, f"{kind}{n}_REVERSED": 0}
    assert changes.keys() <= values.keys()
    return values | changes


def motion(euler=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0)):
    aircraft, numbers = allocate(AIRCRAFT, 3), np.full((2, MOTION_NUMBERS), np.nan)
    truth = aircraft["truth"][2]
    truth["position_ned"], truth["velocity_ned"] = (1.0, 2.0, -3.0), (20.0, 0.5, -0.25)
    truth["acceleration_ned"], truth["euler"] = acceleration, euler
    truth["rates_body"] = 0.1, 0.2, 0.3
    pack_motion(np.array([0, 2]), aircraft, numbers, np.array([1]))
    assert np.isnan(numbers[0]).all()
    return numbers[1]


def specific_force(*args):
    return motion(*args)[3:6]


# servo packets


def test_servo_packet_is_parsed():
    # 18458 = 0x481a, 200 = 0x00c8, 258 = 0x102, 1500 = 0x5dc, 1100 = 0x44c; low byte first
    data = bytes.fromhex("1a48 c800 02010000") + bytes.fromhex("dc05") + bytes.fromhex("4c04") * 15
    packet = read_servos(data)
    assert packet == (200, 258, (1500, *(1100,) * 15))


def test_servo_packet_of_32_outputs():
    pulses = tuple(range(1000, 1032))
    assert read_servos(struct.pack("<HHI32H", 29569, 400, 7, *pulses)).pulses == pulses


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "0 bytes"),
        (b"garbage", "7 bytes"),
        (struct.pack("<HHI16H", 12345, 200, 1, *[0] * 16), "magic 12345"),
        (struct.pack("<HHI15H", 18458, 200, 1, *[0] * 15), "38 bytes with magic 18458"),
        (struct.pack("<HHI16H", 29569, 200, 1, *[0] * 16), "40 bytes with magic 29569"),
    ],
)
def test_invalid_servo_packet_is_an_error(data, text):
    with pytest.raises(PacketError, match=text):
        read_servos(data)


# states


def test_specific_force_in_level_flight():
    np.testing.assert_allclose(specific_force(), [0.0, 0.0, -GRAVITY], atol=1e-15)


def test_specific_force_in_level_turn():
    # heading north in a turn to the right at a bank of 60°: a = g tan φ to the east, n = 2
    turn = (math.radians(60), 0.0, 0.0), (0.0, GRAVITY * math.sqrt(3.0), 0.0)
    np.testing.assert_allclose(specific_force(*turn), [0.0, 0.0, -2.0 * GRAVITY], atol=1e-12)


def test_specific_force_nose_up():
    climb = (0.0, math.radians(30), math.radians(90)), (0.0, 2.0, 0.0)
    # 2 m/s² to the east is 2 cos 30° along the nose; gravity adds g sin 30°
    expected = 2.0 * math.cos(math.radians(30)) + 0.5 * GRAVITY
    assert specific_force(*climb)[0] == pytest.approx(expected, abs=1e-12)


def test_specific_force_is_body_axes_of_any_attitude():
    euler, acceleration = np.array([0.4, -0.3, 2.1]), np.array([1.0, -2.0, 3.0])
    expected = rotation_ned_body(euler).T @ (acceleration - [0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(specific_force(euler, acceleration), expected, atol=1e-12)


def line(voltage=math.nan, pulses=(1500, 1600, 1000, 1500), wind=(1.0, -2.0, 0.5)):
    text = motion_text(12.005, motion().tolist()) + inputs_text(wind, 21.25, voltage, pulses)
    return text.encode()


def test_state_line_has_every_value():
    data = line(voltage=14.5)
    assert data.startswith(b"\n") and data.endswith(b"\n") and data.count(b"\n") == 2
    state_ = json.loads(data)
    rc = state_.pop("rc")
    assert state_ == {
        "timestamp": 12.005,
        "imu": {"gyro": [0.1, 0.2, 0.3], "accel_body": [0.0, 0.0, -GRAVITY]},
        "position": [1.0, 2.0, -3.0],
        "attitude": [0.0, 0.0, 0.0],
        "velocity": [20.0, 0.5, -0.25],
        "velocity_wind": [1.0, -2.0, 0.5],
        "airspeed": 21.25,
        "battery": {"voltage": 14.5, "current": 0.0},
    }
    assert [int(pulse) for pulse in rc.values()] == [1500, 1600, 1000, 1500]
    assert list(rc) == ["rc_1", "rc_2", "rc_3", "rc_4"]


def test_state_line_without_battery():
    assert "battery" not in json.loads(line())


def test_state_line_suits_arduplane_parser():
    text = line(voltage=12.0, pulses=range(1000, 1012)).decode()
    for key, value in (("velocity", "[20.0"), ("rc_1", "1000.25"), ("rc_2", "1001.25")):
        at = text.index(key)
        assert text[at:].startswith(f'{key}":{value}')
    assert text.index('"rc"') == text.index("rc") - 1
    assert " " not in text


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_rc_pulses_survive_truncation(scale):
    """1501 µs may become (1501 − 1000)/1000 in float32, times 1000, truncated: 1500."""
    for pulse in range(900, 2101):
        sent = json.loads(line(pulses=(pulse,) * 4))["rc"]["rc_1"]
        part = np.float32(np.float32(sent - 1000.0) * np.float32(scale))
        assert int(np.float32(part / np.float32(scale)) + np.float32(1000.0)) == pulse


# channels


def read_back(pulse, low, trim, high, reversed_):
    """Convert a pulse to the share of the side of trim it is on, as ArduPlane does."""
    side = trim - low if pulse < trim else high - trim
    return (-1 if reversed_ else 1) * (pulse - trim) / side


def test_rc_pulses_by_hand():
    channels = make_rc_channels(known())
    # 22.5° of 45° is half of 400 µs; 10° of 20° up is half; a quarter of 800 µs of throttle
    assert rc_pulses(channels, math.radians(22.5), math.radians(10), 0.25) == (
        1700,
        1700,
        1300,
        1500,
    )
    # 12.5° of 25° down
    assert rc_pulses(channels, -math.radians(45), -math.radians(12.5), 1.0) == (
        1100,
        1300,
        1900,
        1500,
    )


def rc_pulses(channels, roll, pitch, throttle):
    return channels.pulses(FbwaCommand(roll=roll, pitch=pitch, throttle=throttle))


def test_rc_pulses_are_clamped():
    channels = make_rc_channels(known())
    assert rc_pulses(channels, 2.0, -2.0, 1.5) == (1900, 1100, 1900, 1500)
    assert rc_pulses(channels, -2.0, 2.0, -0.5) == (1100, 1900, 1100, 1500)


def test_rc_pulses_round_to_half_a_microsecond():
    rng = named_stream(1, "test/sticks")
    for _ in range(500):
        low, trim, high = (
            int(rng.integers(*ends)) for ends in ((900, 1200), (1400, 1600), (1800, 2100))
        )
        reversed_ = int(rng.integers(0, 2))
        roll, pitch = rng.uniform(-math.radians(45), math.radians(45)), rng.uniform(-0.4, 0.3)
        throttle = float(rng.uniform(0, 1))
        ends = {
            f"RC{n}_{name}": value
            for n in (1, 2, 3)
            for name, value in (
                ("MIN", low),
                ("TRIM", trim),
                ("MAX", high),
                ("REVERSED", reversed_),
            )
        }
        one, two, three, four = rc_pulses(make_rc_channels(known(**ends)), roll, pitch, throttle)
        half = 0.5001 / min(trim - low, high - trim)
        got = read_back(one, low, trim, high, reversed_) * math.radians(45)
        assert got == pytest.approx(roll, abs=half * math.radians(45))
        got = read_back(two, low, trim, high, reversed_)
        got *= math.radians(20) if got > 0 else math.radians(25)
        assert got == pytest.approx(pitch, abs=half * math.radians(25))
        pulse = high - (three - low) if reversed_ else three
        assert (pulse - low) / (high - low) == pytest.approx(throttle, abs=0.5001 / (high - low))
        assert four == 1500


def test_rc_dead_zones_have_no_effect():
    assert not [name for name in range_names(known()) if name.endswith("_DZ")]


def test_rc_channels_are_mapped():
    channels = make_rc_channels(known(RCMAP_ROLL=5, RCMAP_PITCH=1, RCMAP_THROTTLE=2, RCMAP_YAW=3))
    assert rc_pulses(channels, math.radians(45), 0.0, 0.0) == (1500, 1100, 1500, 1500, 1900)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"RCMAP_PITCH": 1}, "four different channels"),
        ({"RCMAP_YAW": 13}, "of 1 to 12"),
        ({"RC1_MIN": 1900}, "RC1_MIN is 1900 and RC1_MAX 1900"),
        ({"ROLL_LIMIT_DEG": 0}, "ROLL_LIMIT_DEG is 0"),
    ],
)
def test_unusable_rc_channels_are_an_error(changes, text):
    with pytest.raises(ChannelError, match=text):
        make_rc_channels(known(**changes))


# servo outputs


def surfaces(pulses, mixing=math.nan, **changes):
    full = (*pulses, *(0,) * (16 - len(pulses)))
    return pytest.approx(make_servo_outputs(known(**changes), mixing).surfaces(full), abs=1e-12)


def test_open_ports_by_hand():
    assert surfaces((1600, 1250, 1300, 1500)) == (0.2, -0.5, 0.0, 0.25)
    assert surfaces((1500, 1500, 1900, 1525)) == (0.0, 0.0, 0.05, 1.0)


def test_servo_reversed_and_trimmed():
    assert surfaces((1600, 1500, 1100, 1500), SERVO1_REVERSED=1) == (-0.2, 0.0, 0.0, 0.0)
    assert surfaces((1500, 1550, 1100, 1500), SERVO2_TRIM=1550) == (0.0, 0.0, 0.0, 0.0)
    assert surfaces((1500, 1500, 1100, 1500), SERVO3_REVERSED=1) == (0.0, 0.0, 0.0, 1.0)


def test_servo_trim_does_not_change_the_travel():
    """ArduPlane scales each side of the trim by itself, and full output is the whole travel."""
    trimmed = {"SERVO2_TRIM": 1600, "SERVO2_MIN": 1200, "SERVO2_MAX": 1900}
    for pulse, output in ((1900, 1.0), (1750, 0.5), (1400, -0.5), (1200, -1.0)):
        assert surfaces((1500, pulse, 1100, 1500), **trimmed) == (0.0, 0.7 * output, 0.0, 0.0)


def test_servos_without_pulses_are_neutral():
    assert surfaces((0, 0, 0, 0)) == (0.0, 0.0, 0.0, 0.0)


ELEVONS = {"SERVO1_FUNCTION": 77, "SERVO2_FUNCTION": 78, "SERVO4_FUNCTION": 0}


@pytest.mark.parametrize("mixing", [1.0, 0.5])
def test_elevons_are_unmixed(mixing):
    """left = m (elevator − aileron), right = m (elevator + aileron), as the airframe mixes them."""
    aileron, elevator = 0.3, -0.4
    left, right = mixing * (elevator - aileron), mixing * (elevator + aileron)
    pulses = (round(1500 + 500 * left), round(1500 + 500 * right), 1500)
    assert surfaces(pulses, mixing, **ELEVONS) == (aileron, elevator, 0.0, 0.5)


def test_elevons_without_airframe_mixing():
    # MIXING_GAIN 0.5: full elevator is half the travel of both
    assert surfaces((1750, 1750, 1100), **ELEVONS) == (0.0, 1.0, 0.0, 0.0)


def test_v_tail_is_unmixed():
    tail = {"SERVO2_FUNCTION": 79, "SERVO4_FUNCTION": 80}
    # left = 0.5 (elevator + rudder), right = 0.5 (elevator − rudder)
    assert surfaces((1500, 1650, 1100, 1550), **tail) == (0.0, 0.4, 0.2, 0.0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"SERVO1_FUNCTION": 0}, "moves the aileron; write SERVOn_FUNCTION 4"),
        ({"SERVO3_FUNCTION": 0}, "moves the throttle"),
        ({"SERVO1_FUNCTION": 77}, "none is its pair"),
        ({"SERVO2_MIN": 1950}, "SERVO2_MIN is 1950"),
        ({**ELEVONS, "MIXING_GAIN": 0}, "MIXING_GAIN is 0"),
    ],
)
def test_unusable_servo_outputs_are_an_error(changes, text):
    with pytest.raises(ChannelError, match=text):
        make_servo_outputs(known(**changes), math.nan)


# start parameters


def test_defaults_have_each_parameter_once(tmp_path):
    tune = tmp_path / "mine.param"
    tune.write_text(RASCAL.read_text() + "AHRS_EKF_TYPE,3 # another value\nSCHED_LOOP_RATE 300\n")
    text = defaults_text(tune, physics_hz=200, autopilot_hz=50)
    pairs = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in pairs}
    assert len(values) == len(pairs)
    assert (values["AHRS_EKF_TYPE"], values["SCHED_LOOP_RATE"], values["SIM_RATE_HZ"]) == (
        10,
        50,
        200,
    )
    params = read_params(RASCAL)
    for name in ("rll_rate_p", "ptch_rate_ff", "trim_throttle", "servo4_max"):
        assert values[name.upper()] == getattr(params, name)


def test_defaults_remove_simulated_sensor_errors(tmp_path):
    tune = tmp_path / "noisy.param"
    tune.write_text("SIM_ARSPD_RND 2\nARSPD_RATIO 1.6\nSIM_DRIFT_SPEED 0.05\n")
    text = defaults_text(tune, physics_hz=200, autopilot_hz=50)
    pairs = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in pairs}
    assert (values["SIM_ARSPD_RND"], values["SIM_DRIFT_SPEED"]) == (0.0, 0.0)
    assert values["ARSPD_RATIO"] == values["SIM_ARSPD_RATIO"]


REAL_AIRCRAFT = """#NOTE: 12.05.2024 plane
LIM_ROLL_CD,5500
ARSPD_FBW_MIN,13
INS_GYROFFS_X,0.012
INS_GYRO_FILTER,20
COMPASS_OFS_X,31
FS_LONG_ACTN,1
RLL_RATE_P,0.21
TECS_CLMB_MAX,4
"""


def test_defaults_of_a_real_aircraft(tmp_path):
    """Older names are converted; calibrations would be errors of the simulated sensors."""
    tune = tmp_path / "plane.param"
    tune.write_text(REAL_AIRCRAFT)
    text = defaults_text(tune, physics_hz=200, autopilot_hz=50)
    own = text.split("# the tune\n")[1].splitlines()
    assert own == [
        *("ROLL_LIMIT_DEG 55", "AIRSPEED_MIN 13", "INS_GYRO_FILTER 20", "RLL_RATE_P 0.21"),
        "TECS_CLMB_MAX 4",
    ]
    assert tune_report(tune).use == TuneUse(
        renamed={"LIM_ROLL_CD": "ROLL_LIMIT_DEG 55", "ARSPD_FBW_MIN": "AIRSPEED_MIN 13"},
        both=("LIM_ROLL_CD", "ARSPD_FBW_MIN", "INS_GYRO_FILTER", "RLL_RATE_P"),
        arduplane=("TECS_CLMB_MAX",),
        link=("FS_LONG_ACTN",),
        hardware=("INS_GYROFFS_X", "COMPASS_OFS_X"),
    )


def test_differences_from_the_virtual_autopilot(tmp_path):
    tune = tmp_path / "wing.param"
    tune.write_text(
        "SERVO1_FUNCTION 77\nSERVO2_FUNCTION 78\nYAW2SRV_DAMP 0\nINS_GYRO_FILTER 40\n"
        "FLIGHT_OPTIONS 1029\nMIXING_OFFSET 100\n"
    )
    assert [each.partition(":")[0] for each in tune_report(tune).differences] == [
        *("MIXING_OFFSET 100", "FLIGHT_OPTIONS bit 0", "FLIGHT_OPTIONS bit 10"),
        "INS_GYRO_FILTER 40",
    ]
    tune.write_text("SERVO1_FUNCTION 77\nSERVO2_FUNCTION 78\nMIXING_GAIN 0.5\nRLL_RATE_SMAX 100\n")
    assert list(tune_report(tune).differences) == [
        "INS_GYRO_FILTER 20: 20 Hz in the virtual autopilot, as on an aircraft; in SITL times "
        "rates.physics_hz / 1000, 4 Hz at 200, which the virtual autopilot has with gyro_filter: "
        "sitl"
    ]
    tune.write_text("INS_GYRO_FILTER 0\n")
    assert tune_report(tune).differences == ()
    tune.write_text("RLL_RATE_SMAX 100\n")
    assert "RLL_RATE_SMAX" in tune_report(tune).use.both


def test_what_is_not_known_is_named(tmp_path):
    """A name or an option's bit is known to be flown, known to have no effect, or listed."""
    tune = tmp_path / "plane.param"
    tune.write_text(
        "INS_GYRO_FILTER 0\nTECS_CLMB_MAX 4\nCOMPASS_OFS_X 3\nYAW2SRV_DAMP 0.2\nRLL_RATE_P 0.2\n"
        "THR_SLEWRATE 20\nNEW_NAME 1\nFLIGHT_OPTIONS 1081346\n"
    )
    assert tune_report(tune).unknown == ("THR_SLEWRATE", "NEW_NAME")
    assert list(tune_report(tune).differences) == [
        "YAW2SRV_DAMP 0.2: yaw damper",
        *(f"FLIGHT_OPTIONS bit {bit}: not known: may change the flight" for bit in (15, 20)),
    ]


def test_names_without_effect_are_known_exactly(tmp_path):
    """A name that only begins like one without effect is not known; nor is what FBWA reads."""
    known = ("TECS_CLMB_MAX", "TKOFF_THR_MAX", "WP_RADIUS", "INS_HNTCH_FREQ", "LAND_TYPE")
    unknown = ("TECS_NEW", "TKOFF_TDRAG_SPD1", "WP_RADIUS2", "INS_HNTCH_NEW", "STICK_MIXING_X")
    tune = tmp_path / "plane.param"
    tune.write_text("".join(f"{name} 1\n" for name in (*known, *unknown)))
    assert tune_report(tune).unknown == unknown


def test_tune_report_reads_the_file_once(tmp_path, monkeypatch):
    tune = tmp_path / "plane.param"
    tune.write_text(REAL_AIRCRAFT)
    read, paths = param_file.read_bounded_text, []
    monkeypatch.setattr(
        param_file, "read_bounded_text", lambda path, **how: paths.append(path) or read(path, **how)
    )
    tune_report(tune)
    assert paths == [tune]


def test_unused_rate_parameters_are_differences(tmp_path):
    tune = tmp_path / "plane.param"
    names = [
        "KFF_THR2PTCH",
        *(f"{axis}_RATE_{end}" for end in ("PDMX", "D_FF") for axis in ("RLL", "PTCH")),
        *(f"{axis}_RATE_{end}" for axis in ("RLL", "PTCH") for end in ("NTF", "NEF")),
    ]
    tune.write_text("INS_GYRO_FILTER 0\n" + "".join(f"{name} 1\n" for name in names))
    assert [each.split()[0] for each in tune_report(tune).differences] == names
    assert tune_report(tune).use.arduplane == tuple(names)


def test_defaults_lines_fit_arduplane_buffer(tmp_path):
    text = defaults_text(RASCAL, physics_hz=200, autopilot_hz=50)
    assert max(len(line.encode()) for line in text.splitlines()) < 99


def test_docs_list_every_parameter_that_is_set(tmp_path):
    empty = tmp_path / "empty.param"
    empty.write_text("")
    page = (RASCAL.parents[2] / "docs" / "arduplane.md").read_text(encoding="utf-8")
    part = page.split("## Parameters that are set")[1].split("## ")[0]
    lines = defaults_text(empty, physics_hz=200, autopilot_hz=50).splitlines()
    for name, value in (line.split() for line in lines if not line.startswith("#")):
        assert f"`{name}`" in part
        if name not in ("SIM_RATE_HZ", "SCHED_LOOP_RATE"):
            assert f"`{name}` {value.replace('-', '−')}" in part
