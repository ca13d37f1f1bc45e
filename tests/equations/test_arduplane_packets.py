"""ArduPlane's packets and pulses against arithmetic by hand."""

import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest

from testbed.ardupilot.channels import (
    FUNCTIONS,
    LIMITS,
    MAPS,
    ChannelError,
    make_outputs,
    make_sticks,
    ranges_needed,
)
from testbed.ardupilot.defaults import defaults_text
from testbed.ardupilot.packets import (
    PacketError,
    motion_columns,
    motion_line,
    read_servos,
    specific_force,
)
from testbed.frames import GRAVITY
from testbed.state import VehicleState
from testbed.streams import stream
from testbed.vehicle.params import read_params

RASCAL = Path(__file__).parents[2] / "aircraft" / "rascal110" / "autopilot.param"


def known(**changes):
    """ArduPlane's defaults, and what is changed."""
    values = dict(zip(MAPS, (1, 2, 3, 4), strict=True))
    values |= dict(zip(LIMITS, (45.0, 20.0, -25.0, 0.5), strict=True))
    values |= dict.fromkeys(FUNCTIONS, 0)
    values |= {f"SERVO{n}_FUNCTION": f for n, f in ((1, 4), (2, 19), (3, 70), (4, 21))}
    for n in range(1, 17):
        for kind in ("RC", "SERVO"):
            values |= {f"{kind}{n}_MIN": 1100, f"{kind}{n}_TRIM": 1500}
            values |= {f"{kind}{n}_MAX": 1900, f"{kind}{n}_REVERSED": 0}
    assert changes.keys() <= values.keys()
    return values | changes


def state(euler=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0)):
    return VehicleState(
        position_ned=np.array([[1.0, 2.0, -3.0]]),
        velocity_ned=np.array([[20.0, 0.5, -0.25]]),
        acceleration_ned=np.array([acceleration]),
        euler=np.array([euler]),
        rates_body=np.array([[0.1, 0.2, 0.3]]),
        airspeed=np.array([22.0]),
        equivalent_airspeed=np.array([21.5]),
    )


# servo packets


def test_a_servo_packet_is_taken_apart_byte_by_byte():
    # 18458 = 0x481a, 200 = 0x00c8, 258 = 0x102, 1500 = 0x5dc, 1100 = 0x44c; low byte first
    data = bytes.fromhex("1a48 c800 02010000") + bytes.fromhex("dc05") + bytes.fromhex("4c04") * 15
    packet = read_servos(data)
    assert packet == (200, 258, (1500, *(1100,) * 15))


def test_thirty_two_outputs_have_another_magic():
    pulses = tuple(range(1000, 1032))
    assert read_servos(struct.pack("<HHI32H", 29569, 400, 7, *pulses)).pulses == pulses


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "0 bytes"),
        (b"garbage", "7 bytes"),
        (struct.pack("<HHI16H", 12345, 200, 1, *[0] * 16), "magic 12345"),
        (struct.pack("<HHI15H", 18458, 200, 1, *[0] * 15), "38 bytes with magic 18458"),
        (struct.pack("<HHI16H", 29569, 200, 1, *[0] * 16), "40 bytes with magic 29569"),
    ],
)
def test_what_is_no_servo_packet_is_refused_with_what_it_is(data, said):
    with pytest.raises(PacketError, match=said):
        read_servos(data)


# motion


def test_accelerometers_of_level_flight_feel_the_wings_lift():
    np.testing.assert_allclose(specific_force(state()), [[0.0, 0.0, -GRAVITY]], atol=1e-15)


def test_accelerometers_in_a_level_turn_feel_the_load_factor_along_z_only():
    # heading north in a turn to the right at a bank of 60°: a = g tan φ to the east, n = 2
    turn = state((math.radians(60), 0.0, 0.0), (0.0, GRAVITY * math.sqrt(3.0), 0.0))
    np.testing.assert_allclose(specific_force(turn), [[0.0, 0.0, -2.0 * GRAVITY]], atol=1e-12)


def test_accelerometers_with_the_nose_up_and_east_feel_gravity_ahead():
    climb = state((0.0, math.radians(30), math.radians(90)), (0.0, 2.0, 0.0))
    # 2 m/s² to the east is 2 cos 30° along the nose; gravity presses g sin 30° into the seat
    expected = 2.0 * math.cos(math.radians(30)) + 0.5 * GRAVITY
    assert specific_force(climb)[0, 0] == pytest.approx(expected, abs=1e-12)


def line(voltage=math.nan, pulses=(1500, 1600, 1000, 1500), wind=(1.0, -2.0, 0.5)):
    columns = motion_columns(state(), np.array([wind]), np.array([21.25]))
    return motion_line(12.005, columns[0].tolist(), voltage, pulses)


def test_a_line_says_everything_to_the_last_bit():
    data = line(voltage=14.5)
    assert data.startswith(b"\n") and data.endswith(b"\n") and data.count(b"\n") == 2
    told = json.loads(data)
    rc = told.pop("rc")
    assert told == {
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


def test_an_aircraft_without_battery_says_nothing_of_one():
    assert "battery" not in json.loads(line())


def test_a_line_is_read_by_who_only_looks_for_the_first_place_of_a_key():
    text = line(voltage=12.0, pulses=range(1000, 1012)).decode()
    for key, value in (("velocity", "[20.0"), ("rc_1", "1000.25"), ("rc_2", "1001.25")):
        at = text.index(key)
        assert text[at:].startswith(f'{key}":{value}')
    assert text.index('"rc"') == text.index("rc") - 1
    assert " " not in text


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_pulses_survive_single_precision_and_a_cut(scale):
    """1501 µs may become (1501 − 1000)/1000 in float32, times 1000, cut: 1500 without the rest."""
    for pulse in range(900, 2101):
        sent = json.loads(line(pulses=(pulse,) * 4))["rc"]["rc_1"]
        part = np.float32(np.float32(sent - 1000.0) * np.float32(scale))
        assert int(np.float32(part / np.float32(scale)) + np.float32(1000.0)) == pulse


# sticks


def read_back(pulse, least, trim, most, turned):
    """What ArduPlane makes of a pulse: part of the side of the trim it is on."""
    side = trim - least if pulse < trim else most - trim
    return (-1 if turned else 1) * (pulse - trim) / side


def test_sticks_by_hand():
    sticks = make_sticks(known())
    # 22.5° of 45° is half of 400 µs; 10° of 20° up is half; a quarter of 800 µs of throttle
    assert sticks.pulses(math.radians(22.5), math.radians(10), 0.25) == (1700, 1700, 1300, 1500)
    # 12.5° of 25° down
    assert sticks.pulses(-math.radians(45), -math.radians(12.5), 1.0) == (1100, 1300, 1900, 1500)


def test_sticks_beyond_their_limits_stay_at_the_ends():
    sticks = make_sticks(known())
    assert sticks.pulses(2.0, -2.0, 1.5) == (1900, 1100, 1900, 1500)
    assert sticks.pulses(-2.0, 2.0, -0.5) == (1100, 1900, 1100, 1500)


def test_sticks_are_read_back_within_half_a_microsecond():
    draw = stream(1, "test/sticks")
    for _ in range(500):
        least, trim, most = (
            int(draw.integers(*ends)) for ends in ((900, 1200), (1400, 1600), (1800, 2100))
        )
        turned = int(draw.integers(0, 2))
        roll, pitch = draw.uniform(-math.radians(45), math.radians(45)), draw.uniform(-0.4, 0.3)
        throttle = float(draw.uniform(0, 1))
        ends = {
            f"RC{n}_{name}": value
            for n in (1, 2, 3)
            for name, value in (("MIN", least), ("TRIM", trim), ("MAX", most), ("REVERSED", turned))
        }
        one, two, three, four = make_sticks(known(**ends)).pulses(roll, pitch, throttle)
        half = 0.5001 / min(trim - least, most - trim)
        got = read_back(one, least, trim, most, turned) * math.radians(45)
        assert got == pytest.approx(roll, abs=half * math.radians(45))
        got = read_back(two, least, trim, most, turned)
        got *= math.radians(20) if got > 0 else math.radians(25)
        assert got == pytest.approx(pitch, abs=half * math.radians(25))
        pulse = most - (three - least) if turned else three
        assert (pulse - least) / (most - least) == pytest.approx(
            throttle, abs=0.5001 / (most - least)
        )
        assert four == 1500


def test_dead_zones_change_nothing_in_fly_by_wire():
    assert not [name for name in ranges_needed(known()) if name.endswith("_DZ")]


def test_sticks_go_to_the_channels_they_are_mapped_to():
    sticks = make_sticks(known(RCMAP_ROLL=5, RCMAP_PITCH=1, RCMAP_THROTTLE=2, RCMAP_YAW=3))
    assert sticks.pulses(math.radians(45), 0.0, 0.0) == (1500, 1100, 1500, 1500, 1900)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"RCMAP_PITCH": 1}, "four different channels"),
        ({"RCMAP_YAW": 13}, "of 1 to 12"),
        ({"RC1_MIN": 1900}, "RC1_MIN is 1900 and RC1_MAX 1900"),
        ({"ROLL_LIMIT_DEG": 0}, "ROLL_LIMIT_DEG is 0"),
    ],
)
def test_sticks_that_tell_nothing_are_refused(changes, said):
    with pytest.raises(ChannelError, match=said):
        make_sticks(known(**changes))


# outputs


def surfaces(pulses, mixing=math.nan, **changes):
    full = (*pulses, *(0,) * (16 - len(pulses)))
    return pytest.approx(make_outputs(known(**changes), mixing).surfaces(full), abs=1e-12)


def test_surfaces_by_hand():
    assert surfaces((1600, 1250, 1300, 1500)) == (0.2, -0.5, 0.0, 0.25)
    assert surfaces((1500, 1500, 1900, 1525)) == (0.0, 0.0, 0.05, 1.0)


def test_a_reversed_servo_and_a_trimmed_one():
    assert surfaces((1600, 1500, 1100, 1500), SERVO1_REVERSED=1) == (-0.2, 0.0, 0.0, 0.0)
    assert surfaces((1500, 1550, 1100, 1500), SERVO2_TRIM=1550) == (0.0, 0.0, 0.0, 0.0)
    assert surfaces((1500, 1500, 1100, 1500), SERVO3_REVERSED=1) == (0.0, 0.0, 0.0, 1.0)


def test_without_pulses_nothing_moves():
    assert surfaces((0, 0, 0, 0)) == (0.0, 0.0, 0.0, 0.0)


ELEVONS = {"SERVO1_FUNCTION": 77, "SERVO2_FUNCTION": 78, "SERVO4_FUNCTION": 0}


@pytest.mark.parametrize("mixing", [1.0, 0.5])
def test_elevons_give_the_aileron_and_elevator_that_put_them_there(mixing):
    """left = m (elevator − aileron), right = m (elevator + aileron), as the airframe mixes them."""
    aileron, elevator = 0.3, -0.4
    left, right = mixing * (elevator - aileron), mixing * (elevator + aileron)
    pulses = (round(1500 + 500 * left), round(1500 + 500 * right), 1500)
    assert surfaces(pulses, mixing, **ELEVONS) == (aileron, elevator, 0.0, 0.5)


def test_elevons_on_an_airframe_without_are_unmixed_as_arduplane_mixed_them():
    # MIXING_GAIN 0.5: full elevator is half the travel of both
    assert surfaces((1750, 1750, 1100), **ELEVONS) == (0.0, 1.0, 0.0, 0.0)


def test_a_v_tail_is_unmixed():
    tail = {"SERVO2_FUNCTION": 79, "SERVO4_FUNCTION": 80}
    # left = 0.5 (elevator + rudder), right = 0.5 (elevator − rudder)
    assert surfaces((1500, 1650, 1100, 1550), **tail) == (0.0, 0.4, 0.2, 0.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"SERVO1_FUNCTION": 0}, "moves the aileron; write SERVOn_FUNCTION 4"),
        ({"SERVO3_FUNCTION": 0}, "moves the throttle"),
        ({"SERVO1_FUNCTION": 77}, "none is its pair"),
        ({"SERVO2_MIN": 1950}, "SERVO2_MIN is 1950"),
        ({**ELEVONS, "MIXING_GAIN": 0}, "MIXING_GAIN is 0"),
    ],
)
def test_outputs_that_cannot_fly_are_refused(changes, said):
    with pytest.raises(ChannelError, match=said):
        make_outputs(known(**changes), math.nan)


# parameters at the start


def test_arduplane_starts_with_the_tune_and_what_the_link_needs_each_once(tmp_path):
    tune = tmp_path / "mine.param"
    tune.write_text(RASCAL.read_text() + "AHRS_EKF_TYPE,3 # as it flew\nSCHED_LOOP_RATE 300\n")
    text = defaults_text(tune, physics_hz=200, autopilot_hz=50)
    pairs = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in pairs}
    assert len(values) == len(pairs)
    assert (values["AHRS_EKF_TYPE"], values["SCHED_LOOP_RATE"], values["SIM_RATE_HZ"]) == (
        10,
        50,
        200,
    )
    flown = read_params(RASCAL)
    for name in ("rll_rate_p", "ptch_rate_ff", "trim_throttle", "servo4_max"):
        assert values[name.upper()] == getattr(flown, name)


def test_no_sensor_of_arduplanes_adds_errors_to_those_of_the_page(tmp_path):
    tune = tmp_path / "noisy.param"
    tune.write_text("SIM_ARSPD_RND 2\nARSPD_RATIO 1.6\nSIM_DRIFT_SPEED 0.05\n")
    text = defaults_text(tune, physics_hz=200, autopilot_hz=50)
    pairs = [line.split() for line in text.splitlines() if not line.startswith("#")]
    values = {name: float(value) for name, value in pairs}
    assert (values["SIM_ARSPD_RND"], values["SIM_DRIFT_SPEED"]) == (0.0, 0.0)
    assert values["ARSPD_RATIO"] == values["SIM_ARSPD_RATIO"]


def test_arduplane_reads_every_line_whole(tmp_path):
    text = defaults_text(RASCAL, physics_hz=200, autopilot_hz=50)
    assert max(len(line.encode()) for line in text.splitlines()) < 99


def test_the_docs_name_every_parameter_that_is_set(tmp_path):
    empty = tmp_path / "empty.param"
    empty.write_text("")
    page = (RASCAL.parents[2] / "docs" / "arduplane.md").read_text(encoding="utf-8")
    part = page.split("## Parameters that are set")[1].split("## ")[0]
    lines = defaults_text(empty, physics_hz=200, autopilot_hz=50).splitlines()
    for name, value in (line.split() for line in lines if not line.startswith("#")):
        assert f"`{name}`" in part
        if name not in ("SIM_RATE_HZ", "SCHED_LOOP_RATE"):
            assert f"`{name}` {value.replace('-', '−')}" in part
