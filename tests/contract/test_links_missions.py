"""The mission protocol: taken whole or not at all, whatever is lost, repeated or wrong."""

import math

import pytest
from links_cockpit import TO, WAYPOINT, Talk, item, named, texts

from testbed.links.cockpit import Mode, Refusal
from testbed.links.missions import MOST_ITEMS, REPEAT_S, REPEATS

ACCEPTED, ERROR, BAD_FRAME, UNSUPPORTED, NO_SPACE, INVALID = range(6)
BAD_SEQUENCE, DENIED, CANCELLED = 13, 14, 15
OTHER = {"system": 254, "component": 1}


def begin(talk, count, kind=0, **who):
    return talk.ask("MISSION_COUNT", **TO, count=count, mission_type=kind, **who)


def send(talk, sequence, *, who=None, name="MISSION_ITEM_INT", **changes):
    fields = {f"param{n}": 0.0 for n in range(1, 5)}
    fields |= {"frame": 3, "command": WAYPOINT, "current": 0, "autocontinue": 1, "mission_type": 0}
    fields |= {"x": 380010000 + sequence, "y": -35010000, "z": 100.0, "seq": sequence}
    return talk.ask(name, **TO, **(fields | changes), **(who or {}))


def asked(messages):
    return [each["seq"] for each in named(messages, "MISSION_REQUEST_INT")]


def acks(messages):
    return [each["type"] for each in named(messages, "MISSION_ACK")]


def upload(talk, count):
    said = begin(talk, count)
    for sequence in range(count):
        assert asked(said) == [sequence]
        said = send(talk, sequence)
    return said


def test_a_mission_is_asked_for_item_by_item_and_taken_whole():
    talk = Talk()
    said = upload(talk, 3)
    assert acks(said) == [ACCEPTED]
    assert [each.name for each in said] == ["MISSION_ACK", "MISSION_CURRENT"]
    places = tuple(item(x=38.001 + 1e-7 * n, y=-3.501) for n in range(3))
    ((call, items),) = talk.cockpit.calls
    assert call == "change_mission"
    assert [each._replace(x=0.0) for each in items] == [each._replace(x=0.0) for each in places]
    assert [each.x for each in items] == pytest.approx([each.x for each in places], abs=1e-12)


def test_what_was_uploaded_is_downloaded_in_both_forms():
    talk = Talk()
    upload(talk, 4)
    (count,) = named(talk.ask("MISSION_REQUEST_LIST", **TO, mission_type=0), "MISSION_COUNT")
    assert count["count"] == 4
    for sequence in range(4):
        (whole,) = talk.ask("MISSION_REQUEST_INT", **TO, seq=sequence, mission_type=0)
        (split,) = talk.ask("MISSION_REQUEST", **TO, seq=sequence, mission_type=0)
        assert (whole.name, split.name) == ("MISSION_ITEM_INT", "MISSION_ITEM")
        assert whole.fields["x"] == 380010000 + sequence
        # single precision has steps of 3.8e-6 degrees there
        assert split.number("x") == pytest.approx(whole.number("x") * 1e-7, abs=4e-6)
        assert whole.fields["current"] == split.fields["current"] == (sequence == 1)
    beyond = talk.ask("MISSION_REQUEST_INT", **TO, seq=4, mission_type=0)
    assert acks(beyond) == [BAD_SEQUENCE]


def test_an_item_that_does_not_come_is_asked_for_again_and_then_given_up():
    talk = Talk()
    begin(talk, 2)
    send(talk, 0)
    assert asked(talk.due(0.9 * REPEAT_S)) == []
    repeats = [asked(talk.due(REPEAT_S)) for _ in range(REPEATS)]
    assert repeats == [[1]] * REPEATS
    assert acks(talk.due(REPEAT_S)) == [CANCELLED]
    assert named(talk.due(REPEAT_S), "MISSION_ACK") == []
    assert acks(send(talk, 1)) == [ERROR]
    assert talk.cockpit.calls == []


def test_patience_begins_anew_with_every_item():
    talk = Talk()
    said = begin(talk, 8)
    for sequence in range(8):
        assert asked(said) == [sequence]
        for _ in range(REPEATS):
            assert asked(talk.due(REPEAT_S)) == [sequence]
        said = send(talk, sequence)
    assert acks(said) == [ACCEPTED]


def test_an_item_said_twice_is_taken_once_and_the_last_is_answered_again():
    talk = Talk()
    begin(talk, 2)
    send(talk, 0)
    assert send(talk, 0) == []
    assert acks(send(talk, 1)) == [ACCEPTED]
    assert acks(send(talk, 1)) == [ACCEPTED]
    assert len(talk.cockpit.calls) == 1


def test_an_item_out_of_order_ends_the_upload():
    talk = Talk()
    begin(talk, 3)
    assert acks(send(talk, 2)) == [BAD_SEQUENCE]
    assert acks(send(talk, 0)) == [ERROR]
    assert talk.cockpit.calls == []


def test_while_one_uploads_another_is_refused_and_changes_nothing():
    talk = Talk()
    begin(talk, 2)
    assert acks(begin(talk, 5, **OTHER)) == [DENIED]
    assert acks(send(talk, 0, who=OTHER)) == [DENIED]
    assert acks(talk.ask("MISSION_CLEAR_ALL", **TO, mission_type=0, **OTHER)) == [DENIED]
    send(talk, 0)
    assert acks(send(talk, 1)) == [ACCEPTED]
    assert len(talk.cockpit.calls[0][1]) == 2
    assert acks(begin(talk, 0, **OTHER)) == [ACCEPTED]


def test_the_same_sender_may_begin_again():
    talk = Talk()
    begin(talk, 5)
    send(talk, 0)
    assert acks(upload(talk, 2)) == [ACCEPTED]
    assert len(talk.cockpit.calls[0][1]) == 2


def test_a_sender_that_gives_up_is_let_go():
    talk = Talk()
    begin(talk, 3)
    quit_ = {**TO, "type": CANCELLED, "mission_type": 0}
    assert talk.ask("MISSION_ACK", **quit_, **OTHER) == []
    assert asked(talk.due(REPEAT_S)) == [0]
    assert talk.ask("MISSION_ACK", **quit_) == []
    assert asked(talk.due(REPEAT_S)) == []


def test_the_end_of_a_download_is_not_the_end_of_an_upload():
    talk = Talk()
    begin(talk, 1)
    talk.ask("MISSION_ACK", **TO, type=ACCEPTED, mission_type=0)
    assert acks(send(talk, 0)) == [ACCEPTED]


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"frame": 1}, BAD_FRAME),
        ({"frame": 10}, BAD_FRAME),
        ({"x": 910000000}, 10),
        ({"y": -1810000000}, 11),
        ({"z": math.nan}, 12),
        ({"z": math.inf}, 12),
        ({"param1": math.inf}, 6),
        ({"param4": -math.inf}, 9),
        ({"mission_type": 1}, UNSUPPORTED),
    ],
)
def test_an_item_that_cannot_be_is_refused_with_its_reason(changes, result):
    talk = Talk()
    begin(talk, 1)
    assert acks(send(talk, 0, **changes)) == [result]
    assert talk.cockpit.calls == []


def test_a_parameter_that_is_no_number_means_its_default():
    talk = Talk()
    begin(talk, 1)
    send(talk, 0, param4=math.nan)
    assert talk.cockpit.calls[0][1][0].parameters == (0.0,) * 4


def test_items_in_degrees_are_taken_too():
    talk = Talk()
    begin(talk, 1)
    assert acks(send(talk, 0, name="MISSION_ITEM", x=38.5, y=-3.25)) == [ACCEPTED]
    taken = talk.cockpit.calls[0][1][0]
    assert (taken.x, taken.y) == (38.5, -3.25)


@pytest.mark.parametrize(("supported", "result"), [(True, INVALID), (False, UNSUPPORTED)])
def test_a_mission_the_cockpit_refuses_is_not_there_and_the_item_is_named(supported, result):
    talk = Talk()
    talk.cockpit.refuses["change_mission"] = Refusal("item 1: below the ground", supported, 1)
    said = upload(talk, 2)
    assert acks(said) == [result]
    assert texts(said) == ["item 1: below the ground"]
    assert talk.cockpit.mission == ()


def test_a_mission_has_an_end():
    talk = Talk()
    assert acks(begin(talk, MOST_ITEMS + 1)) == [NO_SPACE]
    assert acks(begin(talk, 65535)) == [NO_SPACE]
    assert acks(upload(talk, MOST_ITEMS)) == [ACCEPTED]


@pytest.mark.parametrize("clear", ["MISSION_CLEAR_ALL", "MISSION_COUNT"])
def test_a_mission_is_cleared(clear):
    talk = Talk()
    upload(talk, 2)
    fields = {"mission_type": 0} | ({"count": 0} if clear == "MISSION_COUNT" else {})
    assert acks(talk.ask(clear, **TO, **fields)) == [ACCEPTED]
    assert talk.cockpit.mission == ()


@pytest.mark.parametrize("kind", [1, 2])
def test_of_fence_and_rally_points_there_are_none_and_may_be_none(kind):
    talk = Talk()
    (count,) = named(talk.ask("MISSION_REQUEST_LIST", **TO, mission_type=kind), "MISSION_COUNT")
    assert (count["count"], count["mission_type"]) == (0, kind)
    assert acks(begin(talk, 0, kind)) == acks(
        talk.ask("MISSION_CLEAR_ALL", **TO, mission_type=kind)
    )
    assert acks(begin(talk, 4, kind)) == [UNSUPPORTED]
    assert talk.cockpit.calls == []


def test_parts_of_missions_are_refused():
    talk = Talk()
    part = {"start_index": 0, "end_index": 1, "mission_type": 0}
    for name in ("MISSION_WRITE_PARTIAL_LIST", "MISSION_REQUEST_PARTIAL_LIST"):
        assert acks(talk.ask(name, **TO, **part)) == [UNSUPPORTED]


def test_an_item_is_chosen_and_told():
    talk = Talk()
    upload(talk, 4)
    said = talk.ask("MISSION_SET_CURRENT", **TO, seq=3)
    assert named(said, "MISSION_CURRENT")[0]["seq"] == 3
    said = talk.ask("MISSION_SET_CURRENT", **TO, seq=9)
    assert named(said, "MISSION_CURRENT")[0]["seq"] == 3
    assert texts(said) == ["no such item"]


def test_an_item_is_reached_when_the_next_is_flown_but_not_when_it_is_chosen():
    talk = Talk()
    upload(talk, 4)
    talk.cockpit.mode = Mode.AUTO
    assert named(talk.look(1), "MISSION_ITEM_REACHED") == []
    talk.cockpit.item = 2
    assert named(talk.look(2), "MISSION_ITEM_REACHED") == [{"seq": 1}]
    talk.ask("MISSION_SET_CURRENT", **TO, seq=3)
    assert named(talk.look(3), "MISSION_ITEM_REACHED") == []


def test_fly_here_is_heard_from_an_item_as_arduplane_does():
    talk = Talk()
    said = send(talk, 0, name="MISSION_ITEM", current=2, x=38.5, y=-3.25, z=80.0)
    assert acks(said) == [ACCEPTED]
    assert talk.cockpit.calls == [("fly_to", 38.5, -3.25, 80.0, None)]
    assert acks(send(talk, 0, name="MISSION_ITEM", current=3, x=38.5, y=-3.25)) == [UNSUPPORTED]
    assert len(talk.cockpit.calls) == 1
