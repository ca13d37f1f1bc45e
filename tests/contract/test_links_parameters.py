"""The parameter protocol: read, listed, set, and never without an answer."""

import math

import pytest
from links_cockpit import TO, Notebook, Talk, named, texts

from testbed.links.cockpit import Refusal
from testbed.links.parameters import BATCH

MISSING, OUT_OF_RANGE, READ_ONLY = 1, 2, 5


def read(talk, name="", index=-1):
    return talk.ask("PARAM_REQUEST_READ", **TO, param_id=name, param_index=index)


def change(talk, name, value):
    return talk.ask("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)


def listed(talk):
    said = talk.ask("PARAM_REQUEST_LIST", **TO)
    while batch := talk.due():
        batch = named(batch, "PARAM_VALUE")
        if not batch:
            break
        assert len(batch) <= BATCH
        said += batch
    return said


def test_a_list_has_every_value_once_in_order():
    talk = Talk()
    values = listed(talk)
    count = len(talk.cockpit.parameters) + 1 + 12 + 14  # its number, four sticks and four outputs
    assert [each["param_index"] for each in values] == list(range(count))
    assert {each["param_count"] for each in values} == {count}
    told = {each["param_id"]: each["param_value"] for each in values}
    assert len(told) == count
    assert told | talk.cockpit.parameters == told
    assert (told["SYSID_THISMAV"], told["RC2_TRIM"], told["RC3_TRIM"]) == (1, 1500, 1000)


def test_a_list_asked_for_again_begins_again():
    talk = Talk()
    talk.ask("PARAM_REQUEST_LIST", **TO)
    talk.due()
    values = listed(talk)
    assert [each["param_index"] for each in values] == list(range(len(values)))


def test_a_value_is_read_by_name_and_by_place():
    talk = Talk()
    for index, each in enumerate(listed(talk)):
        for said in (read(talk, each["param_id"]), read(talk, index=index)):
            assert named(said, "PARAM_VALUE") == [each]


@pytest.mark.parametrize("asked", [{"name": "NO_SUCH"}, {"index": 32767}, {"name": ""}])
def test_a_value_that_is_not_there_is_said_so(asked):
    said = read(Talk(), **asked)
    assert [each["error"] for each in named(said, "PARAM_ERROR")] == [MISSING]


def test_a_value_that_is_set_holds_and_is_told():
    talk = Talk()
    (told,) = named(change(talk, "ROLL_LIMIT_DEG", 40.0), "PARAM_VALUE")
    assert (told["param_id"], told["param_value"]) == ("ROLL_LIMIT_DEG", 40.0)
    assert talk.cockpit.parameters["ROLL_LIMIT_DEG"] == 40.0


def test_a_value_that_is_refused_stays_and_the_reason_is_told():
    talk = Talk()
    talk.cockpit.refuses["change_parameter"] = Refusal("write 1 to 90")
    said = change(talk, "ROLL_LIMIT_DEG", 400.0)
    assert named(said, "PARAM_VALUE")[0]["param_value"] == 50.0
    assert named(said, "PARAM_ERROR")[0]["error"] == OUT_OF_RANGE
    assert texts(said) == ["write 1 to 90"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_reaches_the_cockpit(value):
    talk = Talk()
    for name in ("ROLL_LIMIT_DEG", "RC1_MIN", "SYSID_THISMAV"):
        before = named(read(talk, name), "PARAM_VALUE")
        assert named(change(talk, name, value), "PARAM_VALUE") == before
    assert talk.cockpit.calls == []


def test_a_name_that_is_not_there_is_not_set():
    talk = Talk()
    said = change(talk, "NO_SUCH", 1.0)
    assert named(said, "PARAM_ERROR")[0]["error"] == MISSING
    assert named(said, "PARAM_VALUE") == talk.cockpit.calls == []


def test_sticks_keep_an_order_and_a_sense():
    talk = Talk()
    for name, value, holds in [
        ("RC1_MIN", 1100.0, 1100.0),
        ("RC1_MIN", 1600.0, 1100.0),  # above the trim
        ("RC1_MAX", 1400.0, 2000.0),  # below it
        ("RC1_TRIM", 1480.0, 1480.0),
        ("RC1_MAX", 9000.0, 2000.0),
        ("RC3_TRIM", 990.0, 1000.0),
    ]:
        assert named(change(talk, name, value), "PARAM_VALUE")[0]["param_value"] == holds
    assert talk.cockpit.calls == []


def test_the_number_of_a_vehicle_is_read_only():
    talk = Talk(count=2, row=1)
    to = {"target_system": 2, "target_component": 1}
    said = talk.ask("PARAM_SET", **to, param_id="SYSID_THISMAV", param_value=7.0, param_type=9)
    assert named(said, "PARAM_ERROR")[0]["error"] == READ_ONLY
    assert named(said, "PARAM_VALUE")[0]["param_value"] == 2.0


def test_an_aircraft_without_parameters_has_those_of_its_sticks():
    notebook = Notebook()
    notebook.parameters = {}
    talk = Talk(notebook)
    assert len(listed(talk)) == 27
    assert texts(change(talk, "ROLL_LIMIT_DEG", 40.0)) == [
        "ROLL_LIMIT_DEG: it has no parameters here"
    ]
    assert texts(change(talk, "RC1_MIN", 1100.0)) == []


def test_outputs_are_told_as_they_are_and_stay_so():
    talk = Talk()
    told = {each["param_id"]: each["param_value"] for each in listed(talk)}
    assert [told[f"SERVO{n}_FUNCTION"] for n in range(1, 5)] == [4, 19, 70, 21]
    assert [told[f"SERVO{n}_REVERSED"] for n in range(1, 5)] == [0, 1, 0, 1]
    assert [told[f"SERVO{n}_TRIM"] for n in range(1, 5)] == [1500, 1500, 1000, 1500]
    said = change(talk, "SERVO2_REVERSED", 0.0)
    assert named(said, "PARAM_ERROR")[0]["error"] == READ_ONLY
    assert named(said, "PARAM_VALUE")[0]["param_value"] == 1.0
    assert named(change(talk, "SERVO2_REVERSED", 1.0), "PARAM_ERROR") == []
    assert talk.cockpit.calls == []


def test_a_value_too_large_for_the_wire_is_told_as_the_largest():
    notebook = Notebook()
    notebook.parameters = {"HUGE": 1e300}
    assert listed(Talk(notebook))[0]["param_value"] == pytest.approx(3.4028235e38)
