"""The command protocol: one answer per command, and the reason of every rejection."""

import math
import random

import pytest
from mavlink_control import TO, RecordingControl, VehicleClient, fields_of, item, texts

from testbed.mavlink.vehicle_control import FlightMode, Rejection

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, INT_ONLY, NO_FRAME = 0, 1, 2, 3, 4, 8, 9
ARM, SET_MODE, REPOSITION, SPEED, START, SET_ITEM = 400, 176, 192, 178, 300, 224
GET_INTERVAL, SET_INTERVAL, REQUEST, CAPABILITIES, HOME = 510, 511, 512, 520, 410
ATTITUDE = 30


def answer(messages):
    (ack,) = fields_of(messages, "COMMAND_ACK")
    return ack["result"]


def place(client, *numbers, frame=6, x=380010000, y=-35010000, z=120.0):
    values = {f"param{n}": 0.0 for n in range(1, 5)}
    values |= {f"param{n}": value for n, value in enumerate(numbers, 1)}
    head = {"frame": frame, "command": REPOSITION, "current": 0, "autocontinue": 0}
    return client.send("COMMAND_INT", **TO, **head, **values, x=x, y=y, z=z)


def test_every_command_gets_one_ack_to_its_sender():
    client = VehicleClient()
    numbers = random.Random(5).sample(range(65536), 400)
    for command in [*numbers, *range(1, 260), *range(300, 600)]:
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            fields = {f"param{n}": 0.0 for n in range(1, 5)}
            tail = ("param5", "param6", "param7") if name == "COMMAND_LONG" else "xyz"
            fields |= dict.fromkeys(tail, 0)
            fields |= {"frame": 0, "current": 0, "autocontinue": 0} if tail == "xyz" else {}
            fields |= {"confirmation": 0} if name == "COMMAND_LONG" else {}
            replies = client.send(name, system=77, component=3, **TO, command=command, **fields)
            (ack,) = fields_of(replies, "COMMAND_ACK")
            assert (ack["command"], ack["target_system"], ack["target_component"]) == (
                command,
                77,
                3,
            )
            if command in (20, 21, 22, 241, 245, 259, 519):
                assert ack["result"] == UNSUPPORTED


def test_commands_for_other_systems_are_ignored():
    client = VehicleClient()
    for to in ((2, 1), (1, 154), (2, 0)):
        replies = client.command(ARM, 1.0, target_system=to[0], target_component=to[1])
        assert replies == []
    assert answer(client.command(ARM, 1.0, target_system=0, target_component=0)) == ACCEPTED
    assert client.control.calls == [("set_armed", True, False)]


def test_disarming_in_flight_must_be_forced():
    client = VehicleClient()
    replies = client.command(ARM, 0.0)
    assert answer(replies) == FAILED
    assert texts(replies) == ["in flight"]
    assert answer(client.command(ARM, 0.0, 21196.0)) == ACCEPTED
    assert not client.control.armed
    for strange in (2.0, math.nan, -1.0):
        assert answer(client.command(ARM, strange)) == DENIED
    assert [call[0] for call in client.control.calls] == ["set_armed", "set_armed"]


@pytest.mark.parametrize("mode", FlightMode)
def test_mode_changes_by_command_and_by_message(mode):
    client = VehicleClient()
    assert answer(client.command(SET_MODE, 1.0, float(mode))) == ACCEPTED
    client.send("SET_MODE", target_system=1, base_mode=1, custom_mode=mode)
    assert client.control.calls == [("set_mode", mode)] * 2
    (beat,) = fields_of(client.update(25), "HEARTBEAT")
    assert beat["custom_mode"] == mode


@pytest.mark.parametrize(
    ("base", "custom"), [(0.0, 10.0), (1.0, 3.0), (1.0, math.nan), (math.nan, 5.0), (1.0, 5.5)]
)
def test_unknown_mode_is_denied_naming_valid_ones(base, custom):
    client = VehicleClient()
    replies = client.command(SET_MODE, base, custom)
    assert answer(replies) == DENIED
    (text,) = texts(replies)
    assert all(mode.name in text for mode in FlightMode)
    assert client.control.calls == []


@pytest.mark.parametrize(("command", "name"), [(20, "RTL"), (21, "LAND"), (22, "TAKEOFF")])
def test_ground_commands_are_unsupported_warned_once(command, name):
    client = VehicleClient()
    replies = client.command(command)
    assert answer(replies) == UNSUPPORTED
    assert texts(replies) == [f"no {name} here: LOITER, GUIDED or AUTO"]
    again = client.command(command)
    assert answer(again) == UNSUPPORTED
    assert texts(again) == client.control.calls == []


def test_rtl_mode_is_denied_with_the_same_text():
    replies = VehicleClient().command(SET_MODE, 1.0, 11.0)
    assert answer(replies) == DENIED
    assert texts(replies) == ["no RTL here: LOITER, GUIDED or AUTO"]


@pytest.mark.parametrize(("supported", "result"), [(True, FAILED), (False, UNSUPPORTED)])
def test_rejection_sets_result_and_text(supported, result):
    client = VehicleClient()
    client.control.rejections["set_mode"] = Rejection("flown by ArduPlane", supported)
    replies = client.command(SET_MODE, 1.0, 12.0)
    assert answer(replies) == result
    assert texts(replies) == ["flown by ArduPlane"]


def test_reposition_altitude_above_home_or_sea():
    client = VehicleClient()
    client.control.mode = FlightMode.GUIDED
    assert answer(place(client)) == ACCEPTED
    assert answer(place(client, -1.0, 0.0, 80.0, 1.0, frame=0, z=420.0)) == ACCEPTED
    assert answer(place(client, z=math.nan)) == ACCEPTED
    assert client.control.calls == [
        ("set_loiter_point", 38.001, -3.501, 120.0, None),
        ("set_loiter_point", 38.001, -3.501, 120.0, -80.0),  # the origin is 300 m above sea level
        ("set_loiter_point", 38.001, -3.501, None, None),
    ]


def test_reposition_changes_mode_only_with_flag():
    client = VehicleClient()
    assert answer(place(client)) == DENIED
    assert client.control.calls == []
    assert answer(place(client, -1.0, 1.0)) == ACCEPTED
    assert [call[0] for call in client.control.calls] == ["set_mode", "set_loiter_point"]


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"x": 2**31 - 1}, DENIED),
        ({"y": -(2**31)}, DENIED),
        ({"z": math.inf}, DENIED),
        ({"frame": 1}, NO_FRAME),
        ({"frame": 7}, NO_FRAME),
    ],
)
def test_reposition_invalid_position_changes_nothing(changes, result):
    client = VehicleClient()
    assert answer(place(client, -1.0, 1.0, **changes)) == result
    assert client.control.calls == []
    assert answer(client.command(REPOSITION, -1.0, 1.0, 0.0, 0.0, 38.0, -3.5, 400.0)) == INT_ONLY


def test_change_speed_takes_airspeed_only():
    client = VehicleClient()
    assert answer(client.command(SPEED, 0.0, 21.5)) == ACCEPTED
    for numbers in ((1.0, 20.0), (0.0, -2.0), (0.0, math.nan), (0.0, math.inf)):
        assert answer(client.command(SPEED, *numbers)) == DENIED
    assert client.control.calls == [("set_airspeed", 21.5)]


def test_mission_starts_at_an_existing_item():
    client = VehicleClient()
    client.control.mission = (item(),) * 4
    assert answer(client.command(START)) == ACCEPTED
    assert answer(client.command(START, 2.0, 3.0)) == ACCEPTED
    assert client.control.calls == [
        ("set_mode", FlightMode.AUTO),
        ("set_mode", FlightMode.AUTO),
        ("set_current_item", 2),
    ]
    for numbers in ((4.0,), (0.0, 2.0), (math.nan,), (-1.0,)):
        assert answer(client.command(START, *numbers)) == DENIED
    replies = client.command(SET_ITEM, 3.0)
    assert answer(replies) == ACCEPTED
    assert fields_of(replies, "MISSION_CURRENT")[0]["seq"] == 3
    assert answer(client.command(SET_ITEM, 9.0)) == FAILED
    assert answer(client.command(SET_ITEM, math.nan)) == DENIED


def test_message_is_sent_on_request():
    client = VehicleClient()
    for number, name in ((242, "HOME_POSITION"), (148, "AUTOPILOT_VERSION"), (49, None), (0, None)):
        replies = client.command(REQUEST, float(number))
        assert answer(replies) == ACCEPTED
        assert len(replies) == 2
        assert name in (None, replies[1].name)
    for number in (259.0, 65535.0, math.nan, -5.0, 1e30):
        assert answer(client.command(REQUEST, number)) == UNSUPPORTED
    assert [m.name for m in client.command(CAPABILITIES, 1.0)] == [
        "COMMAND_ACK",
        "AUTOPILOT_VERSION",
    ]
    assert [m.name for m in client.command(HOME)] == ["COMMAND_ACK", "HOME_POSITION"]


def test_before_first_sample_only_heartbeat_is_sent():
    client = VehicleClient(update=False)
    assert answer(client.command(REQUEST, float(ATTITUDE))) == REJECTED
    assert [m.name for m in client.command(REQUEST, 0.0)] == ["COMMAND_ACK", "HEARTBEAT"]


def test_message_interval_is_at_least_sample_period():
    client = VehicleClient()

    def interval():
        replies = client.command(GET_INTERVAL, float(ATTITUDE))
        return fields_of(replies, "MESSAGE_INTERVAL")[0]["interval_us"]

    assert interval() == 100_000
    for requested, got in ((2e5, 200_000), (1.0, 40_000), (-1.0, -1), (0.0, 100_000)):
        assert answer(client.command(SET_INTERVAL, float(ATTITUDE), requested)) == ACCEPTED
        assert interval() == got
    assert answer(client.command(SET_INTERVAL, 27.0, 1e5)) == DENIED
    assert answer(client.command(SET_INTERVAL, float(ATTITUDE), math.nan)) == DENIED
    assert fields_of(client.command(GET_INTERVAL, 27.0), "MESSAGE_INTERVAL")[0]["interval_us"] == 0
    assert (
        fields_of(client.command(REQUEST, 244.0, 30.0), "MESSAGE_INTERVAL")[0]["interval_us"]
        == 100_000
    )


def test_reboot_is_denied():
    assert answer(VehicleClient().command(246, 1.0)) == DENIED


def test_equal_warnings_are_limited_in_rate():
    client = VehicleClient()
    first = client.command(SET_MODE, 1.0, 3.0)
    again = client.command(SET_MODE, 1.0, 3.0)
    client.wall_s += 5.0
    later = client.command(SET_MODE, 1.0, 3.0)
    assert [bool(texts(replies)) for replies in (first, again, later)] == [True, False, True]


def test_aircraft_without_parameters_still_answers():
    client = VehicleClient(RecordingControl(external=False))
    client.control.parameters = {}
    assert answer(client.command(REQUEST, 65.0)) == ACCEPTED


POSITION = {
    **TO,
    **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz"), 0.0),
    **{"time_boot_ms": 0, "coordinate_frame": 1, "type_mask": 0, "yaw": 0.0, "yaw_rate": 0.0},
}


def test_unhandled_messages_are_answered_once():
    client = VehicleClient()
    name = "SET_POSITION_TARGET_LOCAL_NED"
    text = "".join(texts(client.send(name, **POSITION)))
    assert text == (
        "SET_POSITION_TARGET_LOCAL_NED is ignored: not supported here (send SET_ATTITUDE_TARGET, "
        "or DO_REPOSITION in GUIDED)"
    )
    assert client.send(name, **POSITION) == []
    assert "".join(texts(client.send(name, system=254, **POSITION))) == text
    home = {"target_system": 1, "latitude": 0, "longitude": 0, "altitude": 0}
    text = "".join(texts(client.send("SET_GPS_GLOBAL_ORIGIN", **home)))
    assert text == "SET_GPS_GLOBAL_ORIGIN is ignored: not supported here"
    # another vehicle, an answer, and what names no vehicle
    assert client.send(name, system=253, **POSITION | {"target_system": 2}) == []
    assert client.send("MISSION_ACK", **TO, type=0) == []
    assert client.send("SYSTEM_TIME", time_unix_usec=0, time_boot_ms=0) == []
