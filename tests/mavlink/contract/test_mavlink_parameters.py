"""The parameter protocol: every read, list and set request is answered."""

import math

import pytest
from mavlink_control import TO, RecordingControl, VehicleClient, fields_of, texts

from testbed.mavlink.parameter_protocol import BATCH
from testbed.mavlink.vehicle_control import Rejection

MISSING, OUT_OF_RANGE, READ_ONLY = 1, 2, 5


def read(client, name="", index=-1):
    return client.send("PARAM_REQUEST_READ", **TO, param_id=name, param_index=index)


def change(client, name, value):
    return client.send("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)


def list_parameters(client):
    replies = client.send("PARAM_REQUEST_LIST", **TO)
    while batch := client.poll():
        batch = fields_of(batch, "PARAM_VALUE")
        if not batch:
            break
        assert len(batch) <= BATCH
        replies += batch
    return replies


def test_list_has_every_value_once_in_order():
    client = VehicleClient()
    values = list_parameters(client)
    count = len(client.control.parameters) + 1 + 12 + 14  # system id, channels and servo outputs
    assert [each["param_index"] for each in values] == list(range(count))
    assert {each["param_count"] for each in values} == {count}
    reported = {each["param_id"]: each["param_value"] for each in values}
    assert len(reported) == count
    assert reported | client.control.parameters == reported
    assert (reported["SYSID_THISMAV"], reported["RC2_TRIM"], reported["RC3_TRIM"]) == (
        1,
        1500,
        1000,
    )


def test_list_restarts_on_a_new_request():
    client = VehicleClient()
    client.send("PARAM_REQUEST_LIST", **TO)
    client.poll()
    values = list_parameters(client)
    assert [each["param_index"] for each in values] == list(range(len(values)))


def test_value_is_read_by_name_and_by_index():
    client = VehicleClient()
    for index, each in enumerate(list_parameters(client)):
        for replies in (read(client, each["param_id"]), read(client, index=index)):
            assert fields_of(replies, "PARAM_VALUE") == [each]


@pytest.mark.parametrize("requested", [{"name": "NO_SUCH"}, {"index": 32767}, {"name": ""}])
def test_reading_unknown_value_is_an_error(requested):
    replies = read(VehicleClient(), **requested)
    assert [each["error"] for each in fields_of(replies, "PARAM_ERROR")] == [MISSING]


def test_set_value_is_stored_and_reported():
    client = VehicleClient()
    (reported,) = fields_of(change(client, "ROLL_LIMIT_DEG", 40.0), "PARAM_VALUE")
    assert (reported["param_id"], reported["param_value"]) == ("ROLL_LIMIT_DEG", 40.0)
    assert client.control.parameters["ROLL_LIMIT_DEG"] == 40.0


def test_rejected_value_is_unchanged_with_reason():
    client = VehicleClient()
    client.control.rejections["set_parameter"] = Rejection("write 1 to 90")
    replies = change(client, "ROLL_LIMIT_DEG", 400.0)
    assert fields_of(replies, "PARAM_VALUE")[0]["param_value"] == 50.0
    assert fields_of(replies, "PARAM_ERROR")[0]["error"] == OUT_OF_RANGE
    assert texts(replies) == ["write 1 to 90"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_value_that_is_not_finite_is_rejected(value):
    client = VehicleClient()
    for name in ("ROLL_LIMIT_DEG", "RC1_MIN", "SYSID_THISMAV"):
        before = fields_of(read(client, name), "PARAM_VALUE")
        assert fields_of(change(client, name, value), "PARAM_VALUE") == before
    assert client.control.calls == []


def test_setting_unknown_value_is_an_error():
    client = VehicleClient()
    replies = change(client, "NO_SUCH", 1.0)
    assert fields_of(replies, "PARAM_ERROR")[0]["error"] == MISSING
    assert fields_of(replies, "PARAM_VALUE") == client.control.calls == []


def test_channel_range_stays_ordered():
    client = VehicleClient()
    for name, value, holds in [
        ("RC1_MIN", 1100.0, 1100.0),
        ("RC1_MIN", 1600.0, 1100.0),  # above the trim
        ("RC1_MAX", 1400.0, 2000.0),  # below it
        ("RC1_TRIM", 1480.0, 1480.0),
        ("RC1_MAX", 9000.0, 2000.0),
        ("RC3_TRIM", 990.0, 1000.0),
    ]:
        assert fields_of(change(client, name, value), "PARAM_VALUE")[0]["param_value"] == holds
    assert client.control.calls == []


def test_system_id_is_read_only():
    client = VehicleClient(count=2, row=1)
    to = {"target_system": 2, "target_component": 1}
    replies = client.send(
        "PARAM_SET", **to, param_id="SYSID_THISMAV", param_value=7.0, param_type=9
    )
    assert fields_of(replies, "PARAM_ERROR")[0]["error"] == READ_ONLY
    assert fields_of(replies, "PARAM_VALUE")[0]["param_value"] == 2.0


def test_aircraft_without_parameters_has_channels():
    control = RecordingControl()
    control.parameters = {}
    client = VehicleClient(control)
    assert len(list_parameters(client)) == 27
    assert texts(change(client, "ROLL_LIMIT_DEG", 40.0)) == [
        "ROLL_LIMIT_DEG: this aircraft has no parameters"
    ]
    assert texts(change(client, "RC1_MIN", 1100.0)) == []


def test_servo_parameters_are_read_only():
    client = VehicleClient()
    reported = {each["param_id"]: each["param_value"] for each in list_parameters(client)}
    assert [reported[f"SERVO{n}_FUNCTION"] for n in range(1, 5)] == [4, 19, 70, 21]
    assert [reported[f"SERVO{n}_REVERSED"] for n in range(1, 5)] == [0, 1, 0, 1]
    assert [reported[f"SERVO{n}_TRIM"] for n in range(1, 5)] == [1500, 1500, 1000, 1500]
    replies = change(client, "SERVO2_REVERSED", 0.0)
    assert fields_of(replies, "PARAM_ERROR")[0]["error"] == READ_ONLY
    assert fields_of(replies, "PARAM_VALUE")[0]["param_value"] == 1.0
    assert fields_of(change(client, "SERVO2_REVERSED", 1.0), "PARAM_ERROR") == []
    assert client.control.calls == []


def test_value_beyond_float32_is_clamped():
    control = RecordingControl()
    control.parameters = {"HUGE": 1e300}
    assert list_parameters(VehicleClient(control))[0]["param_value"] == pytest.approx(3.4028235e38)
