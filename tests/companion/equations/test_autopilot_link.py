"""What a companion takes from its autopilot and asks it for, and its clock."""

import math

import pytest

from testbed.companion.autopilot_requests import (
    AGAIN_S,
    PARAMETER_S,
    PARAMETER_TRIES,
    AutopilotRequests,
)
from testbed.companion.autopilot_state import AutopilotState
from testbed.companion.boot_clock import BootClock, monotonic_of
from testbed.companion.loop_statistics import LoopStatistics, peak_memory_mb
from testbed.mavlink.codec import Codec, constant, decode

STREAMS = ("GLOBAL_POSITION_INT", "ATTITUDE")
ANGLES = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.1)


def message(name, system=2, component=1, **fields):
    return decode(Codec(system, component).pack(name, **fields))


def attitude(system=2, component=1, time_boot_ms=40):
    return message("ATTITUDE", system, component, time_boot_ms=time_boot_ms, **ANGLES)


def heartbeat(system=2, component=1, mode=15, base=129):
    fields = {"type": 1, "autopilot": 3, "system_status": 4, "mavlink_version": 3}
    return message("HEARTBEAT", system, component, custom_mode=mode, base_mode=base, **fields)


def system_time(unix_us, boot_ms):
    return message("SYSTEM_TIME", time_unix_usec=unix_us, time_boot_ms=boot_ms)


@pytest.mark.parametrize(("system", "component"), [(2, 191), (3, 1), (255, 190)])
def test_others_at_the_link_change_nothing(system, component):
    state = AutopilotState(2)
    assert not state.add(attitude(system, component), 1.0)
    state.add(heartbeat(system, component), 1.0)
    assert state.boot_ms is None and state.mode is None
    assert state.other_system == (system if component == 1 else 0)
    assert state.add(attitude(), 1.0)
    assert state.boot_ms == 40


def test_armed_is_a_bit_of_the_heartbeat():
    state = AutopilotState(2)
    for base, armed in ((129, True), (1, False)):
        state.add(heartbeat(base=base), 0.0)
        assert state.armed is armed


def test_gps_time_at_boot_holds_against_rounding():
    state = AutopilotState(2)
    for unix_us, boot_ms, base_ms in (
        (1_800_000_000_000_400, 1_000, 1_799_999_999_000),
        (1_800_000_000_041_600, 1_040, 1_799_999_999_000),  # 2 ms more, by rounding
        (1_800_000_000_580_000, 1_080, 1_799_999_999_500),  # a jump
        (0, 1_120, None),  # no GPS time any more
    ):
        state.add(system_time(unix_us, boot_ms), 0.0)
        assert state.base_ms == base_ms


@pytest.mark.parametrize(
    ("name", "value", "present", "expected"),
    [
        ("ROLL_LIMIT_DEG", 50.0, "ROLL_LIMIT_DEG", 50.0),
        ("LIM_ROLL_CD", 5000.0, "ROLL_LIMIT_DEG", 50.0),
        ("ARSPD_FBW_MIN", 12.0, "AIRSPEED_MIN", 12.0),
    ],
)
def test_earlier_names_of_parameters_are_known(name, value, present, expected):
    state = AutopilotState(2)
    numbers = {"param_type": 9, "param_count": 900, "param_index": 1}
    state.add(message("PARAM_VALUE", param_id=name, param_value=value, **numbers), 0.0)
    assert state.parameters == {present: pytest.approx(expected)}


@pytest.mark.parametrize("pulses", [(0, 1500, 1500), (1500, 65535, 1500)])
def test_sticks_of_no_receiver_are_unknown(pulses):
    state = AutopilotState(2)
    rest = {f"chan{k}_raw": 1500 for k in range(1, 19)}
    own = dict(zip(("chan1_raw", "chan2_raw", "chan4_raw"), pulses, strict=True))
    for fields, known in ((rest, True), ({**rest, **own}, False)):
        state.add(message("RC_CHANNELS", time_boot_ms=1, chancount=16, rssi=9, **fields), 0.0)
        assert (state.sticks_us is not None) is known


def requests(parameters=()):
    return AutopilotRequests(Codec(2, 191), 2, STREAMS, 25.0, parameters)


def asked(frames, command):
    number = constant(command)
    found = [decode(each) for each in frames]
    return [
        each.fields
        for each in found
        if each.name == "COMMAND_LONG" and each.fields["command"] == number
    ]


def test_streams_are_asked_for_at_the_control_rate():
    fields = asked(requests().due(AutopilotState(2), 0.0), "MAV_CMD_SET_MESSAGE_INTERVAL")
    every = {each["param1"]: each["param2"] for each in fields}
    for name in STREAMS:
        assert every[constant(f"MAVLINK_MSG_ID_{name}")] == 40_000.0


def test_a_stream_that_is_slow_is_asked_for_again():
    wanted = constant("MAVLINK_MSG_ID_ATTITUDE")
    for count, again in ((25, False), (10, True)):  # of those of a second
        state, made = AutopilotState(2), requests()
        list(made.due(state, 0.0))
        for k in range(int(count * AGAIN_S)):
            state.add(attitude(time_boot_ms=k), 0.0)
        assert not asked(made.due(state, AGAIN_S - 0.1), "MAV_CMD_SET_MESSAGE_INTERVAL")
        fields = asked(made.due(state, AGAIN_S), "MAV_CMD_SET_MESSAGE_INTERVAL")
        assert (wanted in [each["param1"] for each in fields]) is again


def test_parameters_are_asked_for_until_they_come():
    state, made = AutopilotState(2), requests(("ROLL_LIMIT_DEG", "NO_SUCH"))
    names = []
    for k in range(40):
        for each in map(decode, made.due(state, k * PARAMETER_S)):
            if each.name == "PARAM_REQUEST_READ":
                names.append(each.fields["param_id"])
        if k == 2:
            state.parameters["ROLL_LIMIT_DEG"] = 50.0
    assert names.count("NO_SUCH") == PARAMETER_TRIES
    assert 1 <= names.count("ROLL_LIMIT_DEG") <= 2
    assert names.count("LIM_ROLL_CD") == names.count("ROLL_LIMIT_DEG")


def test_nothing_that_is_sent_arms_or_changes_a_mode():
    state, made = AutopilotState(2), requests(("ROLL_LIMIT_DEG",))
    frames = [each for k in range(100) for each in made.due(state, 0.5 * k)]
    assert {decode(each).name for each in frames} == {
        "HEARTBEAT",
        "COMMAND_LONG",
        "PARAM_REQUEST_READ",
    }
    for command in ("COMPONENT_ARM_DISARM", "DO_SET_MODE"):
        assert not asked(frames, f"MAV_CMD_{command}")
    (fields,) = asked([made.change_mode(12)], "MAV_CMD_DO_SET_MODE")
    assert (fields["param1"], fields["param2"]) == (1.0, 12.0)


def test_boot_time_is_that_of_the_fastest_sample():
    clock = BootClock()
    assert math.isnan(clock.at(1.0))
    for k, delay_s in enumerate((0.02, 0.003, 0.4, 0.01)):
        clock.add(0.04 * k, 100.0 + 0.04 * k + delay_s)
    assert clock.at(100.5) == pytest.approx(0.5 - 0.003)
    clock.restart()
    assert math.isnan(clock.at(1.0))


def test_a_clock_that_is_set_makes_no_message_old(monkeypatch):
    monkeypatch.setattr("time.time_ns", lambda: 10_000_000_000)
    assert monotonic_of(9_950_000_000, 5.0) == pytest.approx(4.95)
    assert monotonic_of(1, 5.0) == 4.0
    assert monotonic_of(99_000_000_000, 5.0) == 5.0


def test_statistics_count_what_is_added():
    found = LoopStatistics(["leader"])
    assert found.summary()["first_command_cpu_s"] is None
    for latency_s in (0.001, 0.002, 0.1):
        found.add_command(latency_s)
    found.add_age("leader", 0.03)
    found.add_age("leader", math.nan)
    summary = found.summary()
    assert summary["commands"] == 3
    assert summary["state_to_command_s"]["max"] == 0.1
    assert summary["state_to_command_s"]["p50"] == pytest.approx(0.002, rel=0.1)
    assert summary["steps_without_message"] == {"leader": 1}
    assert summary["age_s"]["leader"]["max"] == 0.03
    assert 10.0 < peak_memory_mb() < 10_000.0
