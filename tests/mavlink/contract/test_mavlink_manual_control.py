"""RC overrides, joystick axes and attitude targets become fly-by-wire-A commands."""

import math

import numpy as np
import pytest
from mavlink_control import TO, VehicleClient, fields_of, texts

from testbed.core.frames import quaternion_xyzw
from testbed.mavlink.vehicle_control import Rejection

ROLL, UP, DOWN, CRUISE = math.radians(50), math.radians(20), math.radians(15), 0.22
NO_RATES, NO_THROTTLE, NO_ATTITUDE, VECTOR = 7, 64, 128, 32
NO_AXIS = 32767


def override(client, *pulses, **fields):
    channels = {f"chan{n}_raw": 65535 for n in range(1, 9)}
    channels |= {f"chan{n}_raw": each for n, each in enumerate(pulses, 1)}
    return client.send("RC_CHANNELS_OVERRIDE", **(TO | channels | fields))


def joystick(client, x, y, z, target=1):
    return client.send("MANUAL_CONTROL", target=target, x=x, y=y, z=z, r=0, buttons=0)


def attitude(client, roll=0.2, pitch=0.1, *, thrust=0.6, mask=NO_RATES, stamp=0, q=None):
    x, y, z, w = quaternion_xyzw(np.array([roll, pitch, 2.0])).tolist()
    return client.send(
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


def last_command(client):
    """Return roll, pitch and throttle of the last command."""
    return pytest.approx(sticks(client), abs=1e-12)


def sticks(client):
    name, command, *_ = client.control.calls[-1]
    assert name == "set_manual_command"
    return command.roll, command.pitch, command.throttle


def test_override_pulses_are_shares_of_limits():
    client = VehicleClient()
    override(client, 1750, 1200, 1300)
    assert (ROLL / 2, -0.6 * DOWN, 0.3) == last_command(client)
    override(client, 1000, 2000, 2000)
    assert (-ROLL, UP, 1.0) == last_command(client)


def test_override_ignored_holds_released_centres():
    client = VehicleClient()
    override(client, 1750, 1750, 1600)
    override(client, 1600)
    assert (0.2 * ROLL, UP / 2, 0.6) == last_command(client)
    override(client, 65535, 0)
    assert (0.2 * ROLL, 0.0, 0.6) == last_command(client)
    override(client, 65535, 65535, 0)
    assert (0.2 * ROLL, 0.0, CRUISE) == last_command(client)


def test_override_all_released_commands_nothing():
    client = VehicleClient()
    override(client, 1750, 1750, 1600)
    override(client, 0, 0, 0)
    override(client)
    assert len(client.control.calls) == 1


def test_override_is_released_after_hold_time():
    client = VehicleClient()
    override(client, 1750, 1750, 1600)
    client.update(4 * 25)
    override(client, 1600)
    assert (0.2 * ROLL, 0.0, CRUISE) == last_command(client)


def test_override_uses_channel_parameters():
    client = VehicleClient()
    for name, value in (("RC1_MIN", 1100.0), ("RC1_TRIM", 1400.0)):
        client.send("PARAM_SET", **TO, param_id=name, param_value=value, param_type=9)
    override(client, 1250, 1500, 1000)
    assert (-ROLL / 2, 0.0, 0.0) == last_command(client)


def test_joystick_forward_is_nose_down():
    client = VehicleClient()
    joystick(client, 400, 500, 300)
    assert (ROLL / 2, -0.4 * DOWN, 0.3) == last_command(client)
    joystick(client, -1000, -1000, 1000)
    assert (-ROLL, UP, 1.0) == last_command(client)


def test_joystick_missing_axis_holds():
    client = VehicleClient()
    joystick(client, 400, 500, 300)
    joystick(client, NO_AXIS, NO_AXIS, 800)
    assert (ROLL / 2, -0.4 * DOWN, 0.8) == last_command(client)
    absent = VehicleClient()
    joystick(absent, NO_AXIS, NO_AXIS, NO_AXIS)
    assert absent.control.calls == []


def test_joystick_axes_are_clamped():
    client = VehicleClient()
    joystick(client, -32768, 32766, -32768)
    assert (ROLL, UP, 0.0) == last_command(client)


def test_attitude_target_is_clamped_for_any_heading():
    client = VehicleClient()
    attitude(client, 0.3, -0.1)
    # the quaternion has single precision
    assert sticks(client) == pytest.approx((0.3, -0.1, 0.6), abs=1e-6)
    attitude(client, 2.0, -1.0, thrust=3.0)
    assert (ROLL, -DOWN, 1.0) == last_command(client)
    attitude(client, thrust=-1.0)
    assert sticks(client)[2] == 0.0


def test_attitude_target_mask_selects_fields():
    client = VehicleClient()
    attitude(client, 0.3, -0.1, thrust=0.6)
    attitude(client, 0.0, 0.0, thrust=0.8, mask=NO_RATES | NO_ATTITUDE)
    assert sticks(client) == pytest.approx((0.3, -0.1, 0.8), abs=1e-6)
    attitude(client, 0.1, 0.1, thrust=math.nan, mask=NO_RATES | NO_THROTTLE)
    assert sticks(client) == pytest.approx((0.1, 0.1, 0.8), abs=1e-6)
    attitude(client, mask=0)  # rates beside an attitude are ignored
    assert len(client.control.calls) == 4


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
def test_attitude_target_invalid_is_warned_about(changes, word):
    client = VehicleClient()
    replies = attitude(client, **changes)
    again = attitude(client, **changes)
    client.wall_s += 5.0
    later = attitude(client, **changes)
    assert [word in "".join(texts(each)) for each in (replies, again, later)] == [True, False, True]
    assert client.control.calls == []


def test_attitude_target_stamp_names_answered_sample():
    client = VehicleClient()
    client.update(50)  # 2 s
    stamps = {1960: 1.96, 2000: 2.0, 0: None, 2001: None, 4_000_000: None}
    for stamp, answers_s in stamps.items():
        attitude(client, stamp=stamp)
        assert client.control.calls[-1][2:] == (True, answers_s)
    override(client, 1500)
    assert client.control.calls[-1][2:] == (False, None)


def test_manual_control_of_others_is_ignored():
    client = VehicleClient()
    override(client, 1700, target_system=2)
    joystick(client, 100, 100, 100, target=2)
    assert client.control.calls == []


def test_manual_rejection_warnings_are_limited():
    client = VehicleClient()
    client.control.rejections["set_manual_command"] = Rejection("is flown by the formation")
    replies = [override(client, 1600) for _ in range(20)]
    assert [texts(each) for each in replies if each] == [["is flown by the formation"]]
    client.wall_s += 5.0
    assert texts(override(client, 1600))


def test_reported_channels_reproduce_the_command():
    client = VehicleClient()
    channels = fields_of(client.update(1000), "RC_CHANNELS")[0]
    pulses = [channels[f"chan{n}_raw"] for n in (1, 2, 3)]
    override(client, *pulses)
    # rounded to whole µs: half of one is a thousandth of a limit
    roll, pitch, throttle = sticks(client)
    assert roll == pytest.approx(-0.5, abs=ROLL / 1000)
    assert pitch == pytest.approx(0.1, abs=UP / 1000)
    assert throttle == pytest.approx(0.25, abs=1 / 2000)
