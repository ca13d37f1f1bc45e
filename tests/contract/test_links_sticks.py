"""Sticks, joysticks and attitude targets: what comes of them in the cockpit."""

import math

import numpy as np
import pytest
from links_cockpit import TO, Talk, named, texts

from testbed.frames import quaternion_xyzw
from testbed.links.cockpit import Refusal

ROLL, UP, DOWN, CRUISE = math.radians(50), math.radians(20), math.radians(15), 0.22
NO_RATES, NO_THROTTLE, NO_ATTITUDE, VECTOR = 7, 64, 128, 32
NO_AXIS = 32767


def override(talk, *pulses, **fields):
    channels = {f"chan{n}_raw": 65535 for n in range(1, 9)}
    channels |= {f"chan{n}_raw": each for n, each in enumerate(pulses, 1)}
    return talk.ask("RC_CHANNELS_OVERRIDE", **(TO | channels | fields))


def joystick(talk, x, y, z, target=1):
    return talk.ask("MANUAL_CONTROL", target=target, x=x, y=y, z=z, r=0, buttons=0)


def attitude(talk, roll=0.2, pitch=0.1, *, thrust=0.6, mask=NO_RATES, stamp=0, q=None):
    x, y, z, w = quaternion_xyzw(np.array([roll, pitch, 2.0])).tolist()
    return talk.ask(
        "SET_ATTITUDE_TARGET",
        **TO,
        time_boot_ms=stamp,
        type_mask=mask,
        q=(w, x, y, z) if q is None else q,
        body_roll_rate=0.0,
        body_pitch_rate=0.0,
        body_yaw_rate=0.0,
        thrust=thrust,
    )


def told(talk):
    """Roll, pitch, throttle of the last command."""
    name, *command = talk.cockpit.calls[-1]
    assert name == "sticks"
    return pytest.approx(tuple(command[:3]), abs=1e-12)


def test_pulses_are_shares_of_the_limits():
    talk = Talk()
    override(talk, 1750, 1200, 1300)
    assert (ROLL / 2, -0.6 * DOWN, 0.3) == told(talk)
    override(talk, 1000, 2000, 2000)
    assert (-ROLL, UP, 1.0) == told(talk)


def test_a_channel_that_is_ignored_stays_and_one_let_go_is_centred():
    talk = Talk()
    override(talk, 1750, 1750, 1600)
    override(talk, 1600)
    assert (0.2 * ROLL, UP / 2, 0.6) == told(talk)
    override(talk, 65535, 0)
    assert (0.2 * ROLL, 0.0, 0.6) == told(talk)
    override(talk, 65535, 65535, 0)
    assert (0.2 * ROLL, 0.0, CRUISE) == told(talk)


def test_with_all_let_go_nothing_is_commanded():
    talk = Talk()
    override(talk, 1750, 1750, 1600)
    override(talk, 0, 0, 0)
    override(talk)
    assert len(talk.cockpit.calls) == 1


def test_what_was_held_long_ago_is_forgotten():
    talk = Talk()
    override(talk, 1750, 1750, 1600)
    talk.look(4 * 25)
    override(talk, 1600)
    assert (0.2 * ROLL, 0.0, CRUISE) == told(talk)


def test_pulses_follow_the_sticks_parameters():
    talk = Talk()
    for name, value in (("RC1_MIN", 1100.0), ("RC1_TRIM", 1400.0)):
        talk.ask("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)
    override(talk, 1250, 1500, 1000)
    assert (-ROLL / 2, 0.0, 0.0) == told(talk)


def test_a_joystick_forward_is_nose_down_and_its_throttle_begins_at_zero():
    talk = Talk()
    joystick(talk, 400, 500, 300)
    assert (ROLL / 2, -0.4 * DOWN, 0.3) == told(talk)
    joystick(talk, -1000, -1000, 1000)
    assert (-ROLL, UP, 1.0) == told(talk)


def test_an_axis_that_is_not_there_stays():
    talk = Talk()
    joystick(talk, 400, 500, 300)
    joystick(talk, NO_AXIS, NO_AXIS, 800)
    assert (ROLL / 2, -0.4 * DOWN, 0.8) == told(talk)
    absent = Talk()
    joystick(absent, NO_AXIS, NO_AXIS, NO_AXIS)
    assert absent.cockpit.calls == []


def test_axes_beyond_their_ends_are_at_the_end():
    talk = Talk()
    joystick(talk, -32768, 32766, -32768)
    assert (ROLL, UP, 0.0) == told(talk)


def test_an_attitude_is_flown_within_the_limits_whatever_its_heading():
    talk = Talk()
    attitude(talk, 0.3, -0.1)
    # the quaternion is of single precision
    assert talk.cockpit.calls[-1][1:4] == pytest.approx((0.3, -0.1, 0.6), abs=1e-6)
    attitude(talk, 2.0, -1.0, thrust=3.0)
    assert (ROLL, -DOWN, 1.0) == told(talk)
    attitude(talk, thrust=-1.0)
    assert talk.cockpit.calls[-1][3] == 0.0


def test_the_mask_says_what_is_meant():
    talk = Talk()
    attitude(talk, 0.3, -0.1, thrust=0.6)
    attitude(talk, 0.0, 0.0, thrust=0.8, mask=NO_RATES | NO_ATTITUDE)
    assert talk.cockpit.calls[-1][1:4] == pytest.approx((0.3, -0.1, 0.8), abs=1e-6)
    attitude(talk, 0.1, 0.1, thrust=math.nan, mask=NO_RATES | NO_THROTTLE)
    assert talk.cockpit.calls[-1][1:4] == pytest.approx((0.1, 0.1, 0.8), abs=1e-6)
    attitude(talk, mask=0)  # rates beside an attitude do no harm
    assert len(talk.cockpit.calls) == 4


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"q": (0.0, 0.0, 0.0, 0.0)}, "quaternion"),
        ({"q": (2.0, 0.0, 0.0, 0.0)}, "quaternion"),
        ({"q": (math.nan, 0.0, 0.0, 0.0)}, "quaternion"),
        ({"q": (math.inf, 0.0, 0.0, 0.0)}, "quaternion"),
        ({"q": (3e38, 3e38, 3e38, 3e38)}, "quaternion"),
        ({"thrust": math.nan}, "thrust"),
        ({"mask": NO_ATTITUDE}, "rates"),
        ({"mask": NO_RATES | VECTOR}, "vector"),
    ],
)
def test_an_attitude_that_is_none_moves_nothing_and_is_said_once_in_a_while(changes, word):
    talk = Talk()
    said = attitude(talk, **changes)
    again = attitude(talk, **changes)
    talk.at_s += 5.0
    later = attitude(talk, **changes)
    assert [word in "".join(texts(each)) for each in (said, again, later)] == [True, False, True]
    assert talk.cockpit.calls == []


def test_an_answer_names_the_state_it_answers_unless_its_clock_is_its_own():
    talk = Talk()
    talk.look(50)  # 2 s
    stamps = {1960: 1.96, 2000: 2.0, 0: None, 2001: None, 4_000_000: None}
    for stamp, answers_s in stamps.items():
        attitude(talk, stamp=stamp)
        assert talk.cockpit.calls[-1][4:] == (True, answers_s)
    override(talk, 1500)
    assert talk.cockpit.calls[-1][4:] == (False, None)


def test_sticks_for_others_move_nothing():
    talk = Talk()
    override(talk, 1700, target_system=2)
    joystick(talk, 100, 100, 100, target=2)
    assert talk.cockpit.calls == []


def test_a_refusal_is_told_once_in_a_while():
    talk = Talk()
    talk.cockpit.refuses["sticks"] = Refusal("is flown by the formation")
    said = [override(talk, 1600) for _ in range(20)]
    assert [texts(each) for each in said if each] == [["is flown by the formation"]]
    talk.at_s += 5.0
    assert texts(override(talk, 1600))


def test_what_the_sticks_are_shown_to_do_is_what_was_asked_for():
    talk = Talk()
    channels = named(talk.look(1000), "RC_CHANNELS")[0]
    pulses = [channels[f"chan{n}_raw"] for n in (1, 2, 3)]
    override(talk, *pulses)
    # of whole microseconds, half of one is a thousandth of a limit
    roll, pitch, throttle = talk.cockpit.calls[-1][1:4]
    assert roll == pytest.approx(-0.5, abs=ROLL / 1000)
    assert pitch == pytest.approx(0.1, abs=UP / 1000)
    assert throttle == pytest.approx(0.25, abs=1 / 2000)
