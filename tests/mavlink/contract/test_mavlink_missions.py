"""The mission protocol: a mission is applied when complete, despite losses and repetitions."""

import math

import pytest
from mavlink_control import TO, WAYPOINT, VehicleClient, fields_of, item, texts

from testbed.mavlink.missions import MAX_ITEMS, REPEAT_S, REPEATS
from testbed.mavlink.vehicle_control import FlightMode, Rejection

ACCEPTED, ERROR, BAD_FRAME, UNSUPPORTED, NO_SPACE, INVALID = range(6)
BAD_SEQUENCE, DENIED, CANCELLED = 13, 14, 15
OTHER = {"system": 254, "component": 1}


def begin(client, count, kind=0, **sender):
    return client.send("MISSION_COUNT", **TO, count=count, mission_type=kind, **sender)


def send(client, sequence, *, sender=None, name="MISSION_ITEM_INT", **changes):
    fields = {f"param{n}": 0.0 for n in range(1, 5)}
    fields |= {"frame": 3, "command": WAYPOINT, "current": 0, "autocontinue": 1, "mission_type": 0}
    fields |= {"x": 380010000 + sequence, "y": -35010000, "z": 100.0, "seq": sequence}
    return client.send(name, **TO, **(fields | changes), **(sender or {}))


def requested(messages):
    return [each["seq"] for each in fields_of(messages, "MISSION_REQUEST_INT")]


def acks(messages):
    return [each["type"] for each in fields_of(messages, "MISSION_ACK")]


def upload(client, count):
    replies = begin(client, count)
    for sequence in range(count):
        assert requested(replies) == [sequence]
        replies = send(client, sequence)
    return replies


def test_upload_requests_items_and_applies_all():
    client = VehicleClient()
    replies = upload(client, 3)
    assert acks(replies) == [ACCEPTED]
    assert [each.name for each in replies] == ["MISSION_ACK", "MISSION_CURRENT"]
    expected = tuple(item(x=38.001 + 1e-7 * n, y=-3.501) for n in range(3))
    ((call, items),) = client.control.calls
    assert call == "set_mission"
    assert [each._replace(x=0.0) for each in items] == [each._replace(x=0.0) for each in expected]
    assert [each.x for each in items] == pytest.approx([each.x for each in expected], abs=1e-12)


def test_download_returns_upload_in_both_forms():
    client = VehicleClient()
    upload(client, 4)
    (count,) = fields_of(client.send("MISSION_REQUEST_LIST", **TO, mission_type=0), "MISSION_COUNT")
    assert count["count"] == 4
    for sequence in range(4):
        (whole,) = client.send("MISSION_REQUEST_INT", **TO, seq=sequence, mission_type=0)
        (split,) = client.send("MISSION_REQUEST", **TO, seq=sequence, mission_type=0)
        assert (whole.name, split.name) == ("MISSION_ITEM_INT", "MISSION_ITEM")
        assert whole.fields["x"] == 380010000 + sequence
        # single precision has steps of 3.8e-6 degrees there
        assert split.number("x") == pytest.approx(whole.number("x") * 1e-7, abs=4e-6)
        assert whole.fields["current"] == split.fields["current"] == (sequence == 1)
    beyond = client.send("MISSION_REQUEST_INT", **TO, seq=4, mission_type=0)
    assert acks(beyond) == [BAD_SEQUENCE]


def test_upload_repeats_request_then_cancels():
    client = VehicleClient()
    begin(client, 2)
    send(client, 0)
    assert requested(client.poll(0.9 * REPEAT_S)) == []
    repeats = [requested(client.poll(REPEAT_S)) for _ in range(REPEATS)]
    assert repeats == [[1]] * REPEATS
    replies = client.poll(REPEAT_S)
    assert acks(replies) == [CANCELLED]
    assert texts(replies) == ["mission: item 1 did not arrive: upload again"]
    assert fields_of(client.poll(REPEAT_S), "MISSION_ACK") == []
    assert acks(send(client, 1)) == [ERROR]
    assert client.control.calls == []


def test_upload_repeat_count_restarts_per_item():
    client = VehicleClient()
    replies = begin(client, 8)
    for sequence in range(8):
        assert requested(replies) == [sequence]
        for _ in range(REPEATS):
            assert requested(client.poll(REPEAT_S)) == [sequence]
        replies = send(client, sequence)
    assert acks(replies) == [ACCEPTED]


def test_upload_repeated_item_is_taken_once():
    client = VehicleClient()
    begin(client, 2)
    send(client, 0)
    assert send(client, 0) == []
    assert acks(send(client, 1)) == [ACCEPTED]
    assert acks(send(client, 1)) == [ACCEPTED]
    assert len(client.control.calls) == 1


def test_upload_item_out_of_order_ends_it():
    client = VehicleClient()
    begin(client, 3)
    assert acks(send(client, 2)) == [BAD_SEQUENCE]
    assert acks(send(client, 0)) == [ERROR]
    assert client.control.calls == []


def test_upload_of_another_client_is_denied():
    client = VehicleClient()
    begin(client, 2)
    assert acks(begin(client, 5, **OTHER)) == [DENIED]
    assert acks(send(client, 0, sender=OTHER)) == [DENIED]
    assert acks(client.send("MISSION_CLEAR_ALL", **TO, mission_type=0, **OTHER)) == [DENIED]
    send(client, 0)
    assert acks(send(client, 1)) == [ACCEPTED]
    assert len(client.control.calls[0][1]) == 2
    assert acks(begin(client, 0, **OTHER)) == [ACCEPTED]


def test_upload_restarts_by_the_same_client():
    client = VehicleClient()
    begin(client, 5)
    send(client, 0)
    assert acks(upload(client, 2)) == [ACCEPTED]
    assert len(client.control.calls[0][1]) == 2


def test_upload_is_cancelled_by_its_client():
    client = VehicleClient()
    begin(client, 3)
    quit_ = {**TO, "type": CANCELLED, "mission_type": 0}
    assert client.send("MISSION_ACK", **quit_, **OTHER) == []
    assert requested(client.poll(REPEAT_S)) == [0]
    assert client.send("MISSION_ACK", **quit_) == []
    assert requested(client.poll(REPEAT_S)) == []


def test_download_ack_does_not_end_upload():
    client = VehicleClient()
    begin(client, 1)
    client.send("MISSION_ACK", **TO, type=ACCEPTED, mission_type=0)
    assert acks(send(client, 0)) == [ACCEPTED]


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"frame": 1}, BAD_FRAME),
        ({"frame": 7}, BAD_FRAME),
        ({"x": 910000000}, 10),
        ({"y": -1810000000}, 11),
        ({"z": math.nan}, 12),
        ({"z": math.inf}, 12),
        ({"param1": math.inf}, 6),
        ({"param4": -math.inf}, 9),
        ({"mission_type": 1}, UNSUPPORTED),
    ],
)
def test_upload_invalid_item_is_rejected(changes, result):
    client = VehicleClient()
    begin(client, 1)
    replies = send(client, 0, **changes)
    assert acks(replies) == [result]
    assert texts(replies)  # a refusal says why
    assert client.control.calls == []


@pytest.mark.parametrize("frame", [0, 2, 3, 5, 6, 10, 11])
def test_upload_keeps_the_frame_of_an_item(frame):
    client = VehicleClient()
    begin(client, 1)
    assert acks(send(client, 0, frame=frame)) == [ACCEPTED]
    (item,) = client.send("MISSION_REQUEST_INT", **TO, seq=0, mission_type=0)
    assert item.fields["frame"] == frame


def test_every_refusal_has_a_text():
    part = {"start_index": 0, "end_index": 1, "mission_type": 0}
    for refused, setup in (
        (lambda c: begin(c, MAX_ITEMS + 1), None),
        (lambda c: begin(c, 1, 1), None),
        (lambda c: begin(c, 1, **OTHER), lambda c: begin(c, 2)),
        (lambda c: send(c, 0, sender=OTHER), lambda c: begin(c, 2)),
        (lambda c: send(c, 1), lambda c: begin(c, 2)),
        (lambda c: send(c, 0), None),
        (lambda c: send(c, 0, name="MISSION_ITEM", current=3), None),
        (lambda c: c.send("MISSION_CLEAR_ALL", **TO, mission_type=7), None),
        (lambda c: c.send("MISSION_REQUEST_INT", **TO, seq=5, mission_type=0), None),
        (lambda c: c.send("MISSION_WRITE_PARTIAL_LIST", **TO, **part), None),
    ):
        client = VehicleClient()
        if setup:
            setup(client)
        replies = refused(client)
        assert acks(replies) != [ACCEPTED]
        assert texts(replies), replies


def test_upload_nan_parameter_means_default():
    client = VehicleClient()
    begin(client, 1)
    send(client, 0, param4=math.nan)
    assert client.control.calls[0][1][0].parameters == (0.0,) * 4


def test_upload_takes_items_in_degrees():
    client = VehicleClient()
    begin(client, 1)
    assert acks(send(client, 0, name="MISSION_ITEM", x=38.5, y=-3.25)) == [ACCEPTED]
    taken = client.control.calls[0][1][0]
    assert (taken.x, taken.y) == (38.5, -3.25)


@pytest.mark.parametrize(("supported", "result"), [(True, INVALID), (False, UNSUPPORTED)])
def test_upload_rejected_mission_is_not_applied(supported, result):
    client = VehicleClient()
    client.control.rejections["set_mission"] = Rejection("item 1: below the ground", supported, 1)
    replies = upload(client, 2)
    assert acks(replies) == [result]
    assert texts(replies) == ["item 1: below the ground"]
    assert client.control.mission == ()


def test_upload_length_is_limited():
    client = VehicleClient()
    assert acks(begin(client, MAX_ITEMS + 1)) == [NO_SPACE]
    assert acks(begin(client, 65535)) == [NO_SPACE]
    assert acks(upload(client, MAX_ITEMS)) == [ACCEPTED]


@pytest.mark.parametrize("clear", ["MISSION_CLEAR_ALL", "MISSION_COUNT"])
def test_mission_is_cleared(clear):
    client = VehicleClient()
    upload(client, 2)
    fields = {"mission_type": 0} | ({"count": 0} if clear == "MISSION_COUNT" else {})
    assert acks(client.send(clear, **TO, **fields)) == [ACCEPTED]
    assert client.control.mission == ()


@pytest.mark.parametrize("kind", [1, 2])
def test_fence_and_rally_lists_are_empty(kind):
    client = VehicleClient()
    (count,) = fields_of(
        client.send("MISSION_REQUEST_LIST", **TO, mission_type=kind), "MISSION_COUNT"
    )
    assert (count["count"], count["mission_type"]) == (0, kind)
    assert acks(begin(client, 0, kind)) == acks(
        client.send("MISSION_CLEAR_ALL", **TO, mission_type=kind)
    )
    assert acks(begin(client, 4, kind)) == [UNSUPPORTED]
    assert client.control.calls == []


def test_partial_lists_are_rejected():
    client = VehicleClient()
    part = {"start_index": 0, "end_index": 1, "mission_type": 0}
    for name in ("MISSION_WRITE_PARTIAL_LIST", "MISSION_REQUEST_PARTIAL_LIST"):
        assert acks(client.send(name, **TO, **part)) == [UNSUPPORTED]


def test_set_current_is_reported():
    client = VehicleClient()
    upload(client, 4)
    replies = client.send("MISSION_SET_CURRENT", **TO, seq=3)
    assert fields_of(replies, "MISSION_CURRENT")[0]["seq"] == 3
    replies = client.send("MISSION_SET_CURRENT", **TO, seq=9)
    assert fields_of(replies, "MISSION_CURRENT")[0]["seq"] == 3
    assert texts(replies) == ["no such item"]


def test_item_reached_only_in_flight_order():
    client = VehicleClient()
    upload(client, 4)
    client.control.mode = FlightMode.AUTO
    assert fields_of(client.update(1), "MISSION_ITEM_REACHED") == []
    client.control.current_item = 2
    assert fields_of(client.update(2), "MISSION_ITEM_REACHED") == [{"seq": 1}]
    client.send("MISSION_SET_CURRENT", **TO, seq=3)
    assert fields_of(client.update(3), "MISSION_ITEM_REACHED") == []


def test_guided_item_sets_loiter_point():
    client = VehicleClient()
    replies = send(client, 0, name="MISSION_ITEM", current=2, x=38.5, y=-3.25, z=80.0)
    assert acks(replies) == [ACCEPTED]
    assert client.control.calls == [("set_loiter_point", 38.5, -3.25, 80.0, None)]
    assert acks(send(client, 0, name="MISSION_ITEM", current=3, x=38.5, y=-3.25)) == [UNSUPPORTED]
    assert len(client.control.calls) == 1
