"""Numbers of a law's own in messages: which a follower has, their time on the air, their frame."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega

from testbed.core.records import Broadcast, NedOrigin
from testbed.mavlink.codec import decode
from testbed.mavlink.follow_target import FollowTarget
from testbed.mavlink.law_payload import LawPayload
from testbed.network.channel import make_channel
from testbed.network.links import resolve_links
from testbed.network.payload import KEPT
from testbed.network.radio import Radio
from testbed.scenario.network import Network

NAMES = ("leader", "uav1", "uav2", "uav3")
N = len(NAMES)
PERIOD = 0.04


def make_radio(coder=None, payload=2, **keys):
    network = Network.model_validate(keys)
    added = (coder or FollowTarget(NedOrigin(), payload)).payload_bytes
    channel = make_channel(resolve_links(NAMES, network), 1, payload_bytes=added)
    return Radio(channel, None, coder, payload=payload)


def fly(radio, steps, factor=1.0):
    """Yield time, links and payloads received; each sender's message k carries k and its row."""
    keep, receive = radio.keep_payloads_call(), radio.payloads.receive_call(radio.links)
    message = Broadcast(np.zeros(N), *(np.ones((N, 3)) for _ in range(5)))
    for k in range(steps):
        now = k * PERIOD
        radio.payloads.sent[1:, 0], radio.payloads.sent[1:, 1] = k * factor, np.arange(1, N)
        radio.send(np.full(N, now), message._replace(stamp_s=np.full(N, now)), None)
        keep(now)
        radio.deliver(now)
        receive(now)
        yield now, radio.links, radio.payloads.received.copy()


@pytest.mark.parametrize("encoded", [False, True])
def test_payload_is_that_of_the_newest_message(encoded):
    """Under loss, delay, packets that overtake others, and copies: that of the message's number."""
    keys = {
        "delay_s": 0.3,
        "jitter": {"spread_s": 0.25},
        "loss": 0.3,
        "duplicate": 0.2,
        "corrupt": 0.2,
    }
    keys |= {"encoding": "follow-target"} if encoded else {}
    radio = make_radio(FollowTarget(NedOrigin(), 2) if encoded else None, **keys)
    overtaken = 0
    for _, links, received in fly(radio, 400):
        number = links["number"]
        known = number >= 0
        known[:, 0] = False  # the leader sends none
        assert np.array_equal(received[..., 0][known], number[known])
        assert (received[..., 1] == np.arange(N))[known].all()
        assert np.isnan(received[~known]).all()
    overtaken = int(radio.statistics["overtaken"].sum())
    assert overtaken > 20


def test_payload_of_a_message_too_old_is_not_a_number():
    """Of a number that is kept no more, or not yet: those in its place are of another message."""
    radio = make_radio()
    for k, (_, _, received) in enumerate(fly(radio, KEPT + 3)):
        if k == 1:
            radio.links["number"][1, 1] = 5000  # which has not been sent
        if k == 2:
            assert np.isnan(received[1, 1]).all()
        if k == 0:
            assert not np.isnan(received[1, 1]).any()


def test_second_frame_takes_time_on_the_air():
    """A frame of TUNNEL with K numbers has 18 + 4 K bytes; the leader, without law, sends none."""
    service = {}
    for count in (0, 3):
        network = Network.model_validate({"rate": {"bit_per_s": 8000, "overhead_bytes": 0}})
        added = LawPayload(count).length if count else 0
        channel = make_channel(resolve_links(NAMES, network), 1, payload_bytes=added)
        service[count] = channel.links["service"]
    assert LawPayload(3).length == 18 + 4 * 3
    more = (service[3] - service[0]) * 1000.0  # bytes, at 1000 bytes a second
    assert more[:, 0] == pytest.approx(0.0)
    others = more[:, 1:][~np.eye(3, dtype=bool)]
    assert others == pytest.approx(30.0)


def test_second_frame_is_a_tunnel_of_pymavlink():
    """Byte for byte, also with a zero at the end, which MAVLink would cut off."""
    values = np.array([[1.5, -2.25, 0.0], [np.nan, 1e-3, 3.0]])
    frames = LawPayload(3).pack(values, np.array([1, 2]), np.array([255, 256]))
    for row, frame in enumerate(frames):
        raw = bytes(frame)
        found = decode(raw)
        assert found is not None and (found.name, found.system) == ("TUNNEL", row + 2)
        length = int(found.number("payload_length"))
        sent = np.frombuffer(bytes(found.fields["payload"])[: length - 1], "<f4")
        assert sent.tobytes() == values[row].astype("<f4").tobytes()
        packer = ardupilotmega.MAVLink(None, srcSystem=row + 2, srcComponent=1)
        packer.seq = (255 + row) % 256
        message = ardupilotmega.MAVLink_tunnel_message(
            0, 0, 0, length, list(bytes(found.fields["payload"]))
        )
        assert message.pack(packer) == raw
    assert np.array_equal(LawPayload(3).unpack(frames)[0], values[0])


def test_frames_round_to_single_precision():
    radio = make_radio(FollowTarget(NedOrigin(), 2), encoding="follow-target")
    for k, (_, _, received) in enumerate(fly(radio, 3, factor=1.0 / 3.0)):
        assert received[0, 2, 0] == np.float64(np.float32(k / 3.0))


def test_damaged_second_frame_drops_its_packet():
    """As many packets are refused as with one frame: a wrong bit in either is found."""
    refused = []
    for payload in (0, 30):
        coder = FollowTarget(NedOrigin(), payload)
        keys = {"corrupt": {"probability": 0.5, "bits": 1}, "encoding": "follow-target"}
        radio = make_radio(coder, payload=payload, **keys)
        message = Broadcast(np.zeros(N), *(np.ones((N, 3)) for _ in range(5)))
        for k in range(200):
            radio.send(np.full(N, k * PERIOD), message, None)
        refused.append(radio.summary()["damaged"])
    assert refused[0] == refused[1] and refused[0]["refused"] > 500
    assert refused[0]["undetected"] == 0
