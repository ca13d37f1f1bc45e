"""What is broken or absurd on a link neither breaks a vehicle nor moves an aircraft.

TESTBED_FRAMES sets how many are tried.
"""

import math
import os
import random
import socket

import pytest
from links_cockpit import Notebook, frame, info

from testbed.links.addresses import Address
from testbed.links.cockpit import Item, Mode
from testbed.links.endpoint import DATAGRAMS
from testbed.links.scene import Scene
from testbed.links.station import Station
from testbed.links.vehicle import Vehicle
from testbed.mavlink import door
from testbed.mavlink.door import Codec, Message

FRAMES = int(os.environ.get("TESTBED_FRAMES", "10000"))
SEED = 20261122
# A checksum of 16 bits lets one broken frame of 65536 pass: so many of those tried may be believed.
COINCIDENCES = 2 + FRAMES // 10000


def commands(codec):
    """Frames that each move an aircraft or change it, if they are heard whole."""
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


def broken(frame_, dice):
    """A frame as bad links and bad people make it; never the frame itself."""
    way = dice.randrange(6)
    if way == 0:
        return dice.randbytes(dice.randrange(1, 400))
    if way == 1:
        return frame_[: dice.randrange(1, len(frame_))]
    if way == 2:
        return bytes(dice.choice(b"\xfd\xfe\x00\x01\xff") for _ in range(dice.randrange(1, 80)))
    if way == 3:
        at = dice.randrange(1, len(frame_))
        return frame_[:at] + frame_[at + 1 :]
    changed = bytearray(frame_)
    # a bit in any byte; what changes only the sender's number is caught by the checksum too
    for _ in range(1 if way == 4 else dice.randrange(2, 12)):
        at = dice.randrange(len(changed))
        changed[at] ^= 1 << dice.randrange(8)
    return b"\xfd" if bytes(changed) == frame_ else bytes(changed)


LOOKS = 50  # a look has a few ms, in which a busy machine may get to one message


def test_no_broken_datagram_moves_an_aircraft_or_ends_the_link():
    dice = random.Random(SEED)
    notebook, codec = Notebook(), Codec(255, 190)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        port = ground.getsockname()[1]
        station = Station([Address("udpout", "127.0.0.1", port)], [notebook], epoch_us=0)
        station.begin(info())
        station.observe(frame())
        _, vehicle = ground.recvfrom(2048)
        whole = commands(codec)
        for number in range(FRAMES):
            ground.sendto(broken(dice.choice(whole), dice), vehicle)
            if number % (DATAGRAMS // 4) == 0:
                station.poll(0.0)
        for _ in range(LOOKS):
            station.poll(0.0)
        assert len(notebook.calls) <= COINCIDENCES
        assert station.summary()["skipped_bytes"] > FRAMES
        # the same frames, whole, each do something
        notebook.calls.clear()
        for each in whole:
            ground.sendto(each, vehicle)
        for _ in range(LOOKS):
            station.poll(0.0)
        station.close()
    assert len(notebook.calls) == len(whole)


SPECIAL = {
    "f": (math.nan, math.inf, -math.inf, 3e38, -3e38, 0.0, 1.0, 176.0, 21196.0, 1e-38),
    "d": (math.nan, math.inf, 1e308),
}


def absurd(name, dice):
    """A message of this name with any bytes, extremes, or what is often meant, in its fields."""
    layout = door._layout(door._numbers()[name])
    fields = dict(layout.unpack(dice.randbytes(layout.struct.size)))
    for each in layout.fields:
        if each.text or each.count or dice.random() < 0.3:
            continue
        if each.code in SPECIAL:
            fields[each.name] = dice.choice(SPECIAL[each.code])
        else:
            bits = int(each.kind.strip("uint_"))
            low = 0 if each.kind.startswith("u") else -(1 << (bits - 1))
            high = (1 << bits) - 1 + low
            fields[each.name] = min(max(dice.choice((low, high, 0, 1, 2, 3, 6)), low), high)
    for target in ("target_system", "target_component", "target"):
        if target in fields:
            fields[target] = dice.choice((0, 1))
    if "command" in fields and dice.random() < 0.8:
        fields["command"] = dice.choice((16, 17, 176, 178, 192, 224, 300, 400, 410, 510, 511, 512))
    if "mission_type" in fields and dice.random() < 0.8:
        fields["mission_type"] = 0
    if "frame" in fields:
        fields["frame"] = dice.choice((0, 3, 5, 6))
    if name == "PARAM_SET" and dice.random() < 0.8:
        fields["param_id"] = dice.choice(("RC1_MIN", "ROLL_LIMIT_DEG", "SYSID_THISMAV"))
    return Message(name, dice.choice((0, 1, 255)), dice.choice((0, 1, 190)), 0, fields)


def numbers_in(given):
    """Every number in what a cockpit was given."""
    if isinstance(given, Item | tuple):
        for each in given:
            yield from numbers_in(each)
    elif isinstance(given, float):
        yield given


@pytest.mark.parametrize("asleep", [False, True], ids=["flying", "before the first frame"])
def test_no_absurd_message_raises_or_gives_a_cockpit_what_is_no_number(asleep):
    dice = random.Random(SEED + asleep)
    notebook, codec = Notebook(), Codec(1, 1)
    notebook.mission = (Item(16, 3, (0.0,) * 4, 38.0, -3.5, 100.0),) * 3
    vehicle = Vehicle(notebook, 1, 0, info(), 0)
    at_s = 0.0
    known = list(vehicle._handlers)
    every = sorted(door._numbers())
    for number in range(FRAMES // 2):
        name = dice.choice(known if number % 4 else every)
        at_s += 0.3 * dice.random()
        replies = vehicle.hear(absurd(name, dice), at_s) + vehicle.due(at_s)
        if not asleep and number % 10 == 0:
            replies += vehicle.look(Scene(frame(number), info().origin), at_s)
        for reply in replies:
            codec.pack(reply.name, **reply.fields)
    assert {call[0] for call in notebook.calls} >= {"sticks", "change_mode", "arm", "fly_to"}
    assert all(map(math.isfinite, numbers_in(tuple(notebook.calls))))
    for name, *given in notebook.calls:
        if name == "change_mode":
            assert given[0] in Mode
        if name == "sticks":
            roll, pitch, throttle = given[:3]
            assert abs(roll) < math.tau
            assert abs(pitch) < math.tau
            assert 0.0 <= throttle <= 1.0


def test_what_no_handler_knows_is_never_answered():
    dice = random.Random(SEED + 2)
    notebook = Notebook()
    vehicle = Vehicle(notebook, 1, 0, info(), 0)
    for name in sorted(door._numbers().keys() - vehicle._handlers.keys()):
        assert vehicle.hear(absurd(name, dice), 0.0) == []
    assert notebook.calls == []
