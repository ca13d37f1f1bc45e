"""Packets through sockets: those of the channel alone, in order, damaged, scripted, by distance."""

import math
import os
import socket
import time

import numpy as np
import pytest
from link_loop import LONGEST_S, LinkLoop, attitude, make_settings

from testbed.link.emulator import RADIO_SYSTEM
from testbed.mavlink.codec import Codec, decode
from testbed.network.single_link import SingleLink, send_packets
from testbed.scenario.network import Network

PACKETS = int(os.environ.get("TESTBED_LINK_PACKETS", "600"))
LINK = (
    "network.loss={kind: gilbert-elliott, p: 0.1, r: 0.4}",
    "network.delay_s=0.02",
    "network.jitter={spread_s: 0.01, correlation: 0.3}",
    "network.duplicate=0.03",
)
PLAIN = {
    "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.4},
    "delay_s": 0.02,
    "jitter": {"spread_s": 0.01, "correlation": 0.3},
    "duplicate": 0.03,
}


def numbers(frames):
    return [int(decode(each).fields["time_boot_ms"]) for each in frames]


def copies_of(count, seed, sender, receiver):
    """How often each packet arrives, by the kernels without sockets."""
    link, copies = SingleLink(Network.model_validate(PLAIN), sender, receiver, seed), []
    for k in range(count):
        link.send(0.001 * k)
        copies.append(int(np.isfinite(link.arrivals_s).sum()))
    return copies


@pytest.mark.parametrize("end", [0, 1])
def test_packets_lost_are_those_of_the_channel(end):
    """The same packets lost and duplicated, each way; another seed, or direction, loses others."""
    with LinkLoop(make_settings(*LINK, seed=7)) as loop:
        if end:
            loop.carry([attitude(0)])  # so that b knows where to send
        arrived = numbers(loop.carry(map(attitude, range(PACKETS)), end))
        ends = ("a", "b") if end == 0 else ("b", "a")
        assert loop.summary(*ends)["delivered"] == len(set(arrived))
    found = np.bincount(arrived, minlength=PACKETS).tolist()
    assert found == copies_of(PACKETS, 7, *ends)
    assert 0 in found and 2 in found
    assert found != copies_of(PACKETS, 8, *ends) and found != copies_of(PACKETS, 7, *ends[::-1])


def test_single_link_is_the_one_of_send_packets():
    """The names and the seed make the packets: by default those of `send_packets`."""
    link = SingleLink(Network.model_validate(PLAIN), "sender", "receiver", 3)
    sent = send_packets(np.arange(300) * 0.02, seed=3, **PLAIN)
    outcomes = [link.send(0.02 * k) for k in range(300)]
    assert outcomes == sent.outcome.tolist() and set(outcomes) == {0, 1}


def test_frames_stay_in_order_and_datagrams_overtake():
    settings = ("network.delay_s=0.02", "network.jitter={spread_s: 0.02}")
    for unit, in_order in (("frames", True), ("datagrams", False)):
        with LinkLoop(make_settings(*settings, unit=unit)) as loop:
            arrived = numbers(loop.carry(map(attitude, range(200))))
            assert sorted(arrived) == list(range(200))
            assert (arrived == sorted(arrived)) == in_order
            assert (loop.summary()["overtaken"] == 0) == in_order


def test_a_datagram_of_frames_loses_frames_or_all():
    """A run packs many frames into a datagram: a radio loses some of them, IP all or none."""
    datagrams = [b"".join(attitude(10 * k + j) for j in range(10)) for k in range(40)]
    with LinkLoop(make_settings("network.loss=0.3", unit="datagrams")) as loop:
        whole = loop.carry(datagrams)
        assert set(whole) < set(datagrams) and 10 < len(whole) < 40
        assert loop.summary()["messages"][0]["offered"] == 400
    with LinkLoop(make_settings("network.loss=0.3", unit="frames")) as loop:
        found = set(numbers(loop.carry(datagrams, wait_s=0.3)))
        partly = [sum(10 * k + j in found for j in range(10)) for k in range(40)]
        assert any(0 < each < 10 for each in partly) and 200 < len(found) < 350
        assert loop.summary()["messages"][0]["lost"] == {"lost": 400 - len(found)}


def test_corrupt_frames_arrive_with_wrong_bits():
    settings = ("network.corrupt={probability: 0.3, bits: 3}",)
    with LinkLoop(make_settings(*settings, unit="frames")) as loop:
        arrived = loop.carry(map(attitude, range(100)))
        summary = loop.summary()
    sent = {k: attitude(k) for k in range(100)}
    wrong = [each for each in arrived if decode(each) is None]
    assert len(arrived) == 100 and len(wrong) == summary["lost"]["corrupted"] > 15
    for each in wrong:
        flipped = [
            sum((x ^ y).bit_count() for x, y in zip(each, frame, strict=True))
            for frame in sent.values()
        ]
        assert min(flipped) == 3
    with LinkLoop(make_settings("network.corrupt=0.3")) as loop:
        arrived = loop.carry(map(attitude, range(100)))
        assert 50 < len(arrived) < 90 and all(map(decode, arrived))


def test_blackout_and_transmitter_act_in_time():
    windows = "network.links.a.b.blackout_s=[[0, 1]]", "network.transmitter_off_s={b: [[0, 60]]}"
    with LinkLoop(make_settings(*windows)) as loop:
        assert loop.carry(map(attitude, range(20))) == []
        assert loop.summary()["lost"] == {"blackout": 20}
        time.sleep(1.0)
        assert numbers(loop.carry(map(attitude, range(20)))) == list(range(20))
        assert loop.carry([attitude(1)], end=1) == []
        assert loop.summary("b", "a")["muted"] == 1


def position(north_deg, codec):
    values = {"lat": round(1e7 * (38.0 + north_deg)), "lon": 0, "alt": 100_000}
    rest = dict.fromkeys(("time_boot_ms", "relative_alt", "vx", "vy", "vz", "hdg"), 0)
    return codec.pack("GLOBAL_POSITION_INT", **values, **rest)


def test_loss_follows_the_distance_of_the_positions():
    """Both ways, by what both ends send; before both are known nothing is lost."""
    curve = "network.range_loss=[[1000, 0], [1001, 1]]"
    one, other = Codec(1, 1), Codec(2, 1)
    with LinkLoop(make_settings(curve, unit="frames")) as loop:
        assert len(loop.carry([position(0.0, one)])) == 1
        assert len(loop.carry([attitude(1), attitude(2)])) == 2
        assert len(loop.carry([position(0.005, other)], end=1)) == 1  # 555 m
        assert loop.emulator.summary()["positions"]["distance_m"] == pytest.approx(555.0, abs=1.0)
        assert len(loop.carry([attitude(3)])) == 1
        assert loop.carry([position(0.02, other)], end=1) == []
        assert loop.carry([attitude(4)]) == [] and loop.summary()["lost"] == {"faded": 1}
        # out of range, and with a wrong checksum: no position
        for nowhere in (position(80.0, other), position(0.0, other)[:-1] + b"\0"):
            assert loop.carry([nowhere], end=1) == []
        assert loop.carry([attitude(5)]) == []
        assert len(loop.carry([position(0.02, one)])) == 1
        assert len(loop.carry([attitude(6)])) == 1


def test_an_end_may_stay_where_the_file_says():
    place = "positions={b: {latitude_deg: 38.0, longitude_deg: 0.0, height_m: 100}}"
    curve = "network.range_loss=[[1000, 0], [1001, 1]]"
    with LinkLoop(make_settings(place, curve, unit="frames")) as loop:
        assert len(loop.carry([position(0.001, Codec(1, 1))])) == 1
        assert loop.carry([position(0.1, Codec(1, 1)), attitude(1)]) == []


def banked(roll, codec):
    rest = dict.fromkeys(("time_boot_ms", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0)
    return codec.pack("ATTITUDE", roll=roll, **rest)


def test_an_airframe_is_in_the_way_by_its_attitude():
    """The antenna is below: what flies above is heard upside down alone."""
    above = "positions={b: {latitude_deg: 38.001, longitude_deg: 0.0, height_m: 600}}"
    curve = "network.shadowing={loss: [[0, 0], [1, 1]]}"
    codec = Codec(1, 1)
    with LinkLoop(make_settings(above, curve, unit="frames")) as loop:
        assert loop.carry([position(0.0, codec)]) == []
        assert loop.carry([banked(0.5, codec)]) == [] != loop.carry([banked(math.pi, codec)])
        assert len(loop.carry([b"upside down"])) == 1
        assert loop.carry([banked(0.0, codec), b"level"]) == []
        assert loop.carry([banked(math.nan, codec)]) == []  # no attitude
    below = above.replace("600", "-400")  # whose antenna is below, too: it does not hear a
    with LinkLoop(make_settings(below, curve, unit="frames")) as loop:
        assert loop.carry([position(0.0, codec), banked(0.0, codec)]) == []


RATE = ("radio=sik", "network.rate={bit_per_s: 8000, queue_packets: 40}")


def test_sik_radios_report_how_full_their_buffer_is():
    with LinkLoop(make_settings(*RATE, unit="frames")) as loop:
        arrived = loop.carry(map(attitude, range(100)), wait_s=0.8)
        own = [decode(each) for each in loop.received(0)]
        assert loop.summary()["lost"]["queue"] > 40
    assert {(each.name, each.system, each.component) for each in own} == {
        ("RADIO_STATUS", RADIO_SYSTEM, 68)
    }
    free = [int(each.fields["txbuf"]) for each in own]
    assert 0 <= min(free) < 75 and all(0 <= each <= 100 for each in free)
    assert {decode(each).name for each in arrived} == {"ATTITUDE"}  # b has sent nothing yet


def test_no_radio_reports_without_mavlink():
    with LinkLoop(make_settings(*RATE, unit="frames")) as loop:
        assert loop.carry([b"hello", b"\xfd\xfd"], wait_s=0.7) == [b"hello", b"\xfd\xfd"]
        assert loop.received(0) == []


def test_rates_and_delays_of_the_summary():
    with LinkLoop(make_settings("network.delay_s=0.05", "network.drop=[3]")) as loop:
        loop.carry(map(attitude, range(30)))
        whole = loop.emulator.summary()
    link, seconds = whole["links"]["a"]["b"], whole["duration_s"]
    (kind,) = link["messages"]
    assert 0.05 < seconds < LONGEST_S
    assert link["rate_hz"] * seconds == kind["rate_hz"] * seconds == pytest.approx(30.0)
    assert (kind["system"], kind["message"], kind["bytes"]) == (
        1,
        "ATTITUDE",
        sum(len(attitude(k)) for k in range(30)),
    )
    assert (kind["offered"], kind["delivered"], kind["lost"]) == (30, 29, {"listed": 1})
    for delay in (kind["delay_s"], link["delay_s"]):
        assert delay["max"] == delay["p50"] == pytest.approx(0.05)
    late = whole["emulator"]["late_s"]
    assert 0.0 < late["p50"] <= late["p99"] <= late["max"] < LONGEST_S
    assert 0.0 < whole["emulator"]["processor_share"] <= 1.0


def test_packets_lost_unasked_are_counted():
    """By the system, before they are read, and at a port that no program has sent to."""
    with LinkLoop(make_settings()) as loop:
        listening = loop.ends[0]._endpoint._socket
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
        for number in range(500):
            loop.a.send(attitude(number))
        found = loop.emulator.summary
        offered = lambda: loop.emulator.progress()[0].offered  # noqa: E731
        loop.emulator.run(lambda: loop.received(1) == [] and offered(), duration_s=LONGEST_S)
        loop.carry([attitude(0)])
        assert found()["emulator"]["unread"] == 501 - offered() > 0
        assert found()["emulator"]["not_sent"] == 0
    settings = make_settings()
    with LinkLoop(settings) as loop, LinkLoop(settings) as other:
        loop.emulator._ends = other.ends[0], loop.ends[0]  # both listen
        loop.b.connect(("127.0.0.1", other._here))
        loop.b.send(attitude(1))
        loop.emulator.run(lambda: loop.emulator.progress()[0].offered, duration_s=LONGEST_S)
        assert loop.emulator.summary()["emulator"]["not_sent"] == 1


def test_a_program_that_is_gone_stops_nothing():
    """A port without a program, before and after: packets are dropped, and the link goes on."""
    with LinkLoop(make_settings()) as loop:
        port = loop.b.getsockname()[1]
        assert loop.carry([attitude(0)]) == [attitude(0)]
        loop.b.close()
        loop.received = lambda end: []
        loop.carry([attitude(1), attitude(2)])
        del loop.received
        loop.b = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        loop.b.bind(("127.0.0.1", port))
        loop.b.setblocking(False)
        loop.carry([attitude(3)])
        assert loop.carry([attitude(4)]) == [attitude(4)]
