"""Broken datagrams and absurd messages neither raise nor move an aircraft.

TESTBED_FRAMES sets the number of frames.
"""

import math
import os
import random
import socket

import pytest
from frame_damage import broken
from mavlink_control import RecordingControl, info, sample

from testbed.mavlink import codec as codec_module
from testbed.mavlink.codec import Codec, Message
from testbed.mavlink.server import MavlinkServer
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.udp_endpoint import MAX_DATAGRAMS, Address
from testbed.mavlink.vehicle import MavlinkVehicle
from testbed.mavlink.vehicle_control import FlightMode, MissionItem

FRAMES = int(os.environ.get("TESTBED_FRAMES", "5000"))
SEED = 20261122
# A 16-bit checksum passes one broken frame in 65536: this many may be accepted.
COINCIDENCES = 2 + FRAMES // 10000


def commands(codec):
    """Return frames that each command the aircraft if they arrive intact."""
    to = {"target_system": 1, "target_component": 1}
    numbers = {f"param{n}": 0.0 for n in range(3, 8)}
    channels = {f"chan{n}_raw": 1700 for n in range(1, 9)}
    order = {**to, **numbers, "confirmation": 0}
    axes = {"x": 300, "y": -300, "z": 800, "r": 0, "buttons": 0}
    target = {"time_boot_ms": 1, "type_mask": 7, "q": (1.0, 0.0, 0.0, 0.0), "thrust": 0.7}
    target |= {f"body_{axis}_rate": 0.0 for axis in ("roll", "pitch", "yaw")}
    return [
        codec.pack("COMMAND_LONG", **order, command=400, param1=0.0, param2=21196.0),
        codec.pack("COMMAND_LONG", **order, command=176, param1=1.0, param2=12.0),
        codec.pack("COMMAND_LONG", **order, command=178, param1=0.0, param2=18.0),
        codec.pack("SET_MODE", target_system=1, base_mode=1, custom_mode=15),
        codec.pack("RC_CHANNELS_OVERRIDE", **to, **channels),
        codec.pack("MANUAL_CONTROL", target=1, **axes),
        codec.pack("SET_ATTITUDE_TARGET", **to, **target),
        codec.pack("PARAM_SET", **to, param_id="ROLL_LIMIT_DEG", param_value=9.0, param_type=9),
        codec.pack("MISSION_CLEAR_ALL", **to, mission_type=0),
        codec.pack("MISSION_SET_CURRENT", **to, seq=0),
    ]


POLLS = 50  # a poll has a few ms, in which a busy machine may handle only one message


def test_broken_datagrams_move_no_aircraft():
    rng = random.Random(SEED)
    control, codec = RecordingControl(), Codec(255, 190)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        port = ground.getsockname()[1]
        server = MavlinkServer([Address("udpout", "127.0.0.1", port)], [control], epoch_us=0)
        server.begin(info())
        server.observe(sample())
        _, vehicle = ground.recvfrom(2048)
        whole = commands(codec)
        for number in range(FRAMES):
            ground.sendto(broken(rng.choice(whole), rng), vehicle)
            if number % (MAX_DATAGRAMS // 4) == 0:
                server.poll(0.0)
        for _ in range(POLLS):
            server.poll(0.0)
        assert len(control.calls) <= COINCIDENCES
        assert server.summary()["skipped_bytes"] > FRAMES
        # intact, each of these frames has an effect
        control.calls.clear()
        for each in whole:
            ground.sendto(each, vehicle)
        for _ in range(POLLS):
            server.poll(0.0)
        server.close()
    assert len(control.calls) == len(whole)


SPECIAL = {
    "f": (math.nan, math.inf, -math.inf, 3e38, -3e38, 0.0, 1.0, 176.0, 21196.0, 1e-38),
    "d": (math.nan, math.inf, 1e308),
}


def absurd(name, rng):
    """Make a message with random bytes, extreme or common values in its fields."""
    layout = codec_module._layout(codec_module._numbers_by_name()[name])
    fields = dict(layout.unpack(rng.randbytes(layout.struct.size)))
    for each in layout.fields:
        if each.is_text or each.count or rng.random() < 0.3:
            continue
        if each.code in SPECIAL:
            fields[each.name] = rng.choice(SPECIAL[each.code])
        else:
            bits = int(each.type_name.strip("uint_"))
            low = 0 if each.type_name.startswith("u") else -(1 << (bits - 1))
            high = (1 << bits) - 1 + low
            fields[each.name] = min(max(rng.choice((low, high, 0, 1, 2, 3, 6)), low), high)
    for target in ("target_system", "target_component", "target"):
        if target in fields:
            fields[target] = rng.choice((0, 1))
    if "command" in fields and rng.random() < 0.8:
        fields["command"] = rng.choice((16, 17, 176, 178, 192, 224, 300, 400, 410, 510, 511, 512))
    if "mission_type" in fields and rng.random() < 0.8:
        fields["mission_type"] = 0
    if "frame" in fields:
        fields["frame"] = rng.choice((0, 3, 5, 6))
    if name == "PARAM_SET" and rng.random() < 0.8:
        fields["param_id"] = rng.choice(("RC1_MIN", "ROLL_LIMIT_DEG", "SYSID_THISMAV"))
    return Message(name, rng.choice((0, 1, 255)), rng.choice((0, 1, 190)), 0, fields)


def numbers_in(given):
    """Yield every number in the arguments of a command."""
    if isinstance(given, MissionItem | tuple):
        for each in given:
            yield from numbers_in(each)
    elif isinstance(given, float):
        yield given


@pytest.mark.parametrize("without_sample", [False, True], ids=["flying", "before the first sample"])
def test_absurd_messages_give_finite_commands(without_sample):
    rng = random.Random(SEED + without_sample)
    control, codec = RecordingControl(), Codec(1, 1)
    control.mission = (MissionItem(16, 3, (0.0,) * 4, 38.0, -3.5, 100.0),) * 3
    vehicle = MavlinkVehicle(control, 1, 0, info(), 0)
    wall_s = 0.0
    # most commands are many in one message
    known = [*vehicle._handlers, *4 * ("COMMAND_INT", "COMMAND_LONG")]
    every = sorted(codec_module._numbers_by_name())
    for number in range(FRAMES // 2):
        name = rng.choice(known if number % 4 else every)
        wall_s += 0.3 * rng.random()
        replies = vehicle.handle(absurd(name, rng), wall_s) + vehicle.poll(wall_s)
        if not without_sample and number % 10 == 0:
            replies += vehicle.update(TelemetrySnapshot(sample(number), info().origin), wall_s)
        for reply in replies:
            codec.pack(reply.name, **reply.fields)
    assert {call[0] for call in control.calls} >= {
        "set_manual_command",
        "set_mode",
        "set_armed",
        "set_loiter_point",
    }
    assert all(map(math.isfinite, numbers_in(tuple(control.calls))))
    for name, *given in control.calls:
        if name == "set_mode":
            assert given[0] in FlightMode
        if name == "set_manual_command":
            command = given[0]
            assert abs(command.roll) < math.tau
            assert abs(command.pitch) < math.tau
            assert 0.0 <= command.throttle <= 1.0


# Messages to a vehicle that command or ask for something and that it does not handle.
COMMANDS = set(
    """
    AUTOPILOT_VERSION_REQUEST CAN_FILTER_MODIFY CHANGE_OPERATOR_CONTROL
    CUBEPILOT_FIRMWARE_UPDATE_START DEVICE_OP_READ DEVICE_OP_WRITE DIGICAM_CONFIGURE
    DIGICAM_CONTROL FENCE_FETCH_POINT FENCE_POINT GIMBAL_CONTROL GIMBAL_DEVICE_SET_ATTITUDE
    GIMBAL_MANAGER_SET_ATTITUDE GIMBAL_MANAGER_SET_MANUAL_CONTROL GIMBAL_MANAGER_SET_PITCHYAW
    GOPRO_GET_REQUEST GOPRO_SET_REQUEST GPS_INJECT_DATA LED_CONTROL LOG_ERASE LOG_REQUEST_DATA
    LOG_REQUEST_END MOUNT_CONFIGURE MOUNT_CONTROL OSD_PARAM_CONFIG OSD_PARAM_SHOW_CONFIG
    PARAM_EXT_REQUEST_LIST PARAM_EXT_REQUEST_READ PARAM_EXT_SET PARAM_MAP_RC PLAY_TUNE
    RALLY_FETCH_POINT RALLY_POINT SAFETY_SET_ALLOWED_AREA SECURE_COMMAND SETUP_SIGNING
    SET_ACTUATOR_CONTROL_TARGET SET_GPS_GLOBAL_ORIGIN SET_HOME_POSITION SET_MAG_OFFSETS
    SET_POSITION_TARGET_GLOBAL_INT SET_POSITION_TARGET_LOCAL_NED
    """.split()
)


def test_only_commands_are_answered_and_once():
    """With any content; of a client that sends each unhandled message without an end."""
    rng = random.Random(SEED + 2)
    control = RecordingControl()
    vehicle = MavlinkVehicle(control, 1, 0, info(), 0)
    answered = set()
    for name in sorted(codec_module._numbers_by_name().keys() - vehicle._handlers.keys()):
        for repeated in range(4):
            fields = absurd(name, rng).fields
            replies = vehicle.handle(Message(name, 255, 190, 0, fields), 0.0)
            if replies:
                assert {each.name for each in replies} == {"STATUSTEXT"} and repeated == 0
                answered.add(name)
    assert answered == COMMANDS
    assert control.calls == []
