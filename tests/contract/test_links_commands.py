"""Commands over MAVLink: each is answered once, and does what it says or says why not."""

import math
import random

import pytest
from links_cockpit import TO, Notebook, Talk, item, named, texts

from testbed.links.cockpit import Mode, Refusal

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, INT_ONLY, NO_FRAME = 0, 1, 2, 3, 4, 8, 9
ARM, SET_MODE, REPOSITION, SPEED, START, SET_ITEM = 400, 176, 192, 178, 300, 224
GET_INTERVAL, SET_INTERVAL, REQUEST, CAPABILITIES, HOME = 510, 511, 512, 520, 410
ATTITUDE = 30


def answer(messages):
    (ack,) = named(messages, "COMMAND_ACK")
    return ack["result"]


def place(talk, *numbers, frame=6, x=380010000, y=-35010000, z=120.0):
    values = {f"param{n}": 0.0 for n in range(1, 5)}
    values |= {f"param{n}": value for n, value in enumerate(numbers, 1)}
    head = {"frame": frame, "command": REPOSITION, "current": 0, "autocontinue": 0}
    return talk.ask("COMMAND_INT", **TO, **head, **values, x=x, y=y, z=z)


def test_every_command_number_is_answered_once_to_who_asked():
    talk = Talk()
    numbers = random.Random(5).sample(range(65536), 400)
    for command in [*numbers, *range(1, 260), *range(300, 600)]:
        for name in ("COMMAND_LONG", "COMMAND_INT"):
            fields = {f"param{n}": 0.0 for n in range(1, 5)}
            tail = ("param5", "param6", "param7") if name == "COMMAND_LONG" else "xyz"
            fields |= dict.fromkeys(tail, 0)
            fields |= {"frame": 0, "current": 0, "autocontinue": 0} if tail == "xyz" else {}
            fields |= {"confirmation": 0} if name == "COMMAND_LONG" else {}
            said = talk.ask(name, system=77, component=3, **TO, command=command, **fields)
            (ack,) = named(said, "COMMAND_ACK")
            assert (ack["command"], ack["target_system"], ack["target_component"]) == (
                command,
                77,
                3,
            )
            if command in (20, 21, 22, 241, 245, 259, 519):
                assert ack["result"] == UNSUPPORTED


def test_commands_for_others_are_nobodys_here():
    talk = Talk()
    for to in ((2, 1), (1, 154), (2, 0)):
        said = talk.order(ARM, 1.0, target_system=to[0], target_component=to[1])
        assert said == []
    assert answer(talk.order(ARM, 1.0, target_system=0, target_component=0)) == ACCEPTED
    assert talk.cockpit.calls == [("arm", True, False)]


def test_arming_may_be_forced_and_a_refusal_says_why():
    talk = Talk()
    said = talk.order(ARM, 0.0)
    assert answer(said) == FAILED
    assert texts(said) == ["in flight"]
    assert answer(talk.order(ARM, 0.0, 21196.0)) == ACCEPTED
    assert not talk.cockpit.armed
    for strange in (2.0, math.nan, -1.0):
        assert answer(talk.order(ARM, strange)) == DENIED
    assert [call[0] for call in talk.cockpit.calls] == ["arm", "arm"]


@pytest.mark.parametrize("mode", Mode)
def test_a_mode_is_changed_by_command_and_by_message(mode):
    talk = Talk()
    assert answer(talk.order(SET_MODE, 1.0, float(mode))) == ACCEPTED
    talk.ask("SET_MODE", target_system=1, base_mode=1, custom_mode=mode)
    assert talk.cockpit.calls == [("change_mode", mode)] * 2
    (beat,) = named(talk.look(25), "HEARTBEAT")
    assert beat["custom_mode"] == mode


@pytest.mark.parametrize(
    ("base", "custom"), [(0.0, 10.0), (1.0, 3.0), (1.0, math.nan), (math.nan, 5.0), (1.0, 5.5)]
)
def test_a_mode_that_is_not_there_is_denied_and_those_that_are_are_named(base, custom):
    talk = Talk()
    said = talk.order(SET_MODE, base, custom)
    assert answer(said) == DENIED
    (text,) = texts(said)
    assert all(mode.name in text for mode in Mode)
    assert talk.cockpit.calls == []


@pytest.mark.parametrize(("command", "name"), [(20, "RTL"), (21, "LAND"), (22, "TAKEOFF")])
def test_what_needs_a_runway_is_not_done_and_what_is_instead_is_said_once(command, name):
    talk = Talk()
    said = talk.order(command)
    assert answer(said) == UNSUPPORTED
    assert texts(said) == [f"no {name} here: LOITER, GUIDED or AUTO"]
    again = talk.order(command)
    assert answer(again) == UNSUPPORTED
    assert texts(again) == talk.cockpit.calls == []


def test_a_return_home_by_mode_is_denied_in_the_same_words():
    said = Talk().order(SET_MODE, 1.0, 11.0)
    assert answer(said) == DENIED
    assert texts(said) == ["no RTL here: LOITER, GUIDED or AUTO"]


@pytest.mark.parametrize(("supported", "result"), [(True, FAILED), (False, UNSUPPORTED)])
def test_a_cockpits_refusal_is_told_in_words(supported, result):
    talk = Talk()
    talk.cockpit.refuses["change_mode"] = Refusal("no autopilot of ours", supported)
    said = talk.order(SET_MODE, 1.0, 12.0)
    assert answer(said) == result
    assert texts(said) == ["no autopilot of ours"]


def test_a_place_to_fly_to_is_above_home_or_above_the_sea():
    talk = Talk()
    talk.cockpit.mode = Mode.GUIDED
    assert answer(place(talk)) == ACCEPTED
    assert answer(place(talk, -1.0, 0.0, 80.0, 1.0, frame=0, z=420.0)) == ACCEPTED
    assert answer(place(talk, z=math.nan)) == ACCEPTED
    assert talk.cockpit.calls == [
        ("fly_to", 38.001, -3.501, 120.0, None),
        ("fly_to", 38.001, -3.501, 120.0, -80.0),  # the origin is 300 m above the sea
        ("fly_to", 38.001, -3.501, None, None),
    ]


def test_a_place_changes_the_mode_only_if_it_says_so():
    talk = Talk()
    assert answer(place(talk)) == DENIED
    assert talk.cockpit.calls == []
    assert answer(place(talk, -1.0, 1.0)) == ACCEPTED
    assert [call[0] for call in talk.cockpit.calls] == ["change_mode", "fly_to"]


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"x": 2**31 - 1}, DENIED),
        ({"y": -(2**31)}, DENIED),
        ({"z": math.inf}, DENIED),
        ({"frame": 1}, NO_FRAME),
        ({"frame": 11}, NO_FRAME),
    ],
)
def test_a_place_that_is_none_changes_nothing(changes, result):
    talk = Talk()
    assert answer(place(talk, -1.0, 1.0, **changes)) == result
    assert talk.cockpit.calls == []
    assert answer(talk.order(REPOSITION, -1.0, 1.0, 0.0, 0.0, 38.0, -3.5, 400.0)) == INT_ONLY


def test_an_airspeed_is_changed_and_nothing_else_called_speed():
    talk = Talk()
    assert answer(talk.order(SPEED, 0.0, 21.5)) == ACCEPTED
    for numbers in ((1.0, 20.0), (0.0, -2.0), (0.0, math.nan), (0.0, math.inf)):
        assert answer(talk.order(SPEED, *numbers)) == DENIED
    assert talk.cockpit.calls == [("change_airspeed", 21.5)]


def test_a_mission_is_started_at_an_item_it_has():
    talk = Talk()
    talk.cockpit.mission = (item(),) * 4
    assert answer(talk.order(START)) == ACCEPTED
    assert answer(talk.order(START, 2.0, 3.0)) == ACCEPTED
    assert talk.cockpit.calls == [
        ("change_mode", Mode.AUTO),
        ("change_mode", Mode.AUTO),
        ("go_on_at", 2),
    ]
    for numbers in ((4.0,), (0.0, 2.0), (math.nan,), (-1.0,)):
        assert answer(talk.order(START, *numbers)) == DENIED
    said = talk.order(SET_ITEM, 3.0)
    assert answer(said) == ACCEPTED
    assert named(said, "MISSION_CURRENT")[0]["seq"] == 3
    assert answer(talk.order(SET_ITEM, 9.0)) == FAILED
    assert answer(talk.order(SET_ITEM, math.nan)) == DENIED


def test_a_message_is_sent_on_request():
    talk = Talk()
    for number, name in ((242, "HOME_POSITION"), (148, "AUTOPILOT_VERSION"), (49, None), (0, None)):
        said = talk.order(REQUEST, float(number))
        assert answer(said) == ACCEPTED
        assert len(said) == 2
        assert name in (None, said[1].name)
    for number in (259.0, 65535.0, math.nan, -5.0, 1e30):
        assert answer(talk.order(REQUEST, number)) == UNSUPPORTED
    assert [m.name for m in talk.order(CAPABILITIES, 1.0)] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert [m.name for m in talk.order(HOME)] == ["COMMAND_ACK", "HOME_POSITION"]


def test_before_the_first_frame_only_the_heartbeat_can_be_had():
    talk = Talk(look=False)
    assert answer(talk.order(REQUEST, float(ATTITUDE))) == REJECTED
    assert [m.name for m in talk.order(REQUEST, 0.0)] == ["COMMAND_ACK", "HEARTBEAT"]


def test_an_interval_is_set_told_and_no_shorter_than_frames():
    talk = Talk()

    def told():
        said = talk.order(GET_INTERVAL, float(ATTITUDE))
        return named(said, "MESSAGE_INTERVAL")[0]["interval_us"]

    assert told() == 100_000
    for asked, got in ((2e5, 200_000), (1.0, 40_000), (-1.0, -1), (0.0, 100_000)):
        assert answer(talk.order(SET_INTERVAL, float(ATTITUDE), asked)) == ACCEPTED
        assert told() == got
    assert answer(talk.order(SET_INTERVAL, 26.0, 1e5)) == DENIED
    assert answer(talk.order(SET_INTERVAL, float(ATTITUDE), math.nan)) == DENIED
    assert named(talk.order(GET_INTERVAL, 26.0), "MESSAGE_INTERVAL")[0]["interval_us"] == 0
    assert named(talk.order(REQUEST, 244.0, 30.0), "MESSAGE_INTERVAL")[0]["interval_us"] == 100_000


def test_in_flight_nothing_reboots():
    assert answer(Talk().order(246, 1.0)) == DENIED


def test_the_same_reason_is_not_said_over_and_over():
    talk = Talk()
    first = talk.order(SET_MODE, 1.0, 3.0)
    again = talk.order(SET_MODE, 1.0, 3.0)
    talk.at_s += 5.0
    later = talk.order(SET_MODE, 1.0, 3.0)
    assert [bool(texts(said)) for said in (first, again, later)] == [True, False, True]


def test_an_aircraft_with_nothing_to_command_still_answers():
    talk = Talk(Notebook(external=False))
    talk.cockpit.parameters = {}
    assert answer(talk.order(REQUEST, 65.0)) == ACCEPTED
