"""The MAVLink server: sockets, aircraft that share a link, signatures, events and its log."""

import socket
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from commands import call_command
from mavlink_control import TO, RecordingControl, info, sample

import testbed.mavlink.server
from testbed.core.errors import InputError
from testbed.core.records import Event, FaultState
from testbed.mavlink.codec import Codec, constant
from testbed.mavlink.server import MAX_CLIENTS, MavlinkServer
from testbed.mavlink.signing import Signing, signing_time
from testbed.mavlink.tlog import Tlog
from testbed.mavlink.udp_endpoint import (
    MAX_DATAGRAM_BYTES,
    MAX_DATAGRAMS,
    MAX_PEERS,
    Address,
    Endpoint,
    parse_address,
)
from testbed.metrics.facts import describe_mavlink
from testbed.runs.external_options import ExternalOptions, make_server

EPOCH_US = 1_795_000_000_000_000
KEY = bytes(range(32))
HEARTBEAT = {
    "type": 6,
    "autopilot": 8,
    "base_mode": 0,
    "custom_mode": 0,
    "system_status": 4,
    "mavlink_version": 3,
}
ARM = {**TO, "command": 400, "confirmation": 0} | {f"param{n}": 0.0 for n in range(2, 8)}


class GroundStation:
    """A ground station with a socket."""

    def __init__(self, port=0, signing=None):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.socket.settimeout(2.0)
        self.codec = Codec(255, 190, signing)
        self.peer = None

    @property
    def port(self):
        return self.socket.getsockname()[1]

    def send(self, name, /, **fields):
        self.socket.sendto(self.codec.pack(name, **fields), self.peer)

    def datagrams(self):
        """Return all received datagrams; loopback delivers before send returns."""
        found = []
        self.socket.settimeout(2.0)
        while True:
            try:
                data, self.peer = self.socket.recvfrom(65536)
            except (TimeoutError, BlockingIOError):
                return found
            found.append(data)
            self.socket.settimeout(0.0)

    def receive(self):
        """Return all received messages."""
        datagrams = self.datagrams()
        assert all(len(data) <= 1400 for data in datagrams)
        return [m for data in datagrams for m in self.codec.feed(data, datagram=True)]


@pytest.fixture
def ground():
    station = GroundStation()
    yield station
    station.socket.close()


@pytest.fixture
def open_server(monkeypatch):
    """Open servers that are closed after the test."""
    servers = []

    def make(*addresses, count=1, controls=None, **options):
        if "clock" not in options:
            # the number of messages per poll must not depend on the load of the machine
            monkeypatch.setattr("testbed.mavlink.server.RECEIVE_BUDGET_S", 2.0)
        controls = controls or [RecordingControl(name) for name in info(count).names]
        server = MavlinkServer(addresses, controls, epoch_us=EPOCH_US, **options)
        servers.append(server)
        server.begin(info(len(controls)))
        return server

    yield make
    for server in servers:
        server.close()


def out(ground):
    return Address("udpout", "127.0.0.1", ground.port)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_aircraft_on_one_link_have_own_sequences(open_server, ground):
    server = open_server(out(ground), count=3)
    for tick in range(10):
        server.observe(sample(tick, 3))
    received = ground.receive()
    assert {m.system for m in received} == {1, 2, 3}
    assert {m.component for m in received} == {1}
    for system in (1, 2, 3):
        sequence = [m.sequence for m in received if m.system == system]
        assert sequence == list(range(len(sequence)))
    assert server.summary()["frames_sent"] == len(received)


def test_command_is_executed_and_answered(open_server, ground):
    control = RecordingControl()
    server = open_server(out(ground), controls=[control])
    server.observe(sample())
    ground.receive()
    ground.send("HEARTBEAT", **HEARTBEAT)
    ground.send("COMMAND_LONG", **ARM, param1=1.0)
    server.poll(0.02)
    assert control.calls == [("set_armed", True, False)]
    (ack,) = ground.receive()
    assert (ack.name, ack.fields["result"]) == ("COMMAND_ACK", 0)
    assert server.clients == ((255, 190, 0.02),)
    assert server.summary()["frames_received"] == 2
    assert server.summary()["clients"] == ["255.190"]


def test_client_without_heartbeat_is_listed(open_server, ground):
    server = open_server(out(ground))
    server.observe(sample())
    ground.receive()
    ground.send("COMMAND_LONG", **ARM, param1=1.0)
    server.poll(0.02)
    server.poll(0.06)
    assert server.clients == ((255, 190, 0.02),)
    ground.socket.sendto(Codec(7, 25).pack("COMMAND_LONG", **ARM, param1=1.0), ground.peer)
    server.poll(0.1)
    assert server.summary()["clients"] == ["7.25", "255.190"]


def test_number_of_listed_clients_is_limited(open_server, ground):
    server = open_server(out(ground))
    server.observe(sample())
    ground.receive()
    for system in range(10, 60):
        ground.socket.sendto(Codec(system, 1).pack("HEARTBEAT", **HEARTBEAT), ground.peer)
    while server.summary()["frames_received"] < 50:
        server.poll(0.02)
    assert len(server.clients) == MAX_CLIENTS == 32


def test_wait_ends_by_message_or_by_time(open_server, ground, monkeypatch):
    now = [0.0]

    def timed_wait(endpoints, seconds, really=testbed.mavlink.server.wait):
        really(endpoints, seconds)
        now[0] += seconds  # the clock advances by the requested time only

    monkeypatch.setattr("testbed.mavlink.server.wait", timed_wait)
    server = open_server(out(ground), clock=lambda: now[0])
    server.observe(sample())
    ground.receive()
    server.wait(0.05, 0.0)
    assert now[0] == pytest.approx(0.05)
    ground.send("HEARTBEAT", **HEARTBEAT)
    server.wait(20.0, 0.0)
    assert now[0] < 10.0
    assert len(server.clients) == 1


def test_listening_link_sends_to_known_peers(open_server):
    port = free_port()
    server = open_server(Address("udpin", "127.0.0.1", port))
    first, second = GroundStation(), GroundStation()
    try:
        for each in (first, second):
            each.peer = ("127.0.0.1", port)
        first.send("HEARTBEAT", **HEARTBEAT)
        second.socket.sendto(b"noise", second.peer)
        server.poll(0.0)
        server.observe(sample())
        assert "ATTITUDE" in {m.name for m in first.receive()}
        second.send("HEARTBEAT", **HEARTBEAT)
        server.poll(0.1)
        server.observe(sample(10))
        assert "ATTITUDE" in {m.name for m in second.receive()}
        # anything sent to it before its first valid message would have arrived before
        assert second.codec.skipped == 0
        assert server.summary()["skipped_bytes"] == len(b"noise")
    finally:
        first.socket.close()
        second.socket.close()


def test_each_aircraft_can_have_a_port(open_server):
    grounds = [GroundStation(), None]
    while grounds[1] is None:
        try:
            grounds[1] = GroundStation(grounds[0].port + 1)
        except OSError:
            grounds[0].socket.close()
            grounds[0] = GroundStation()
    try:
        server = open_server(parse_address(f"{grounds[0].port}+1"), count=2)
        server.observe(sample(0, 2))
        assert [{m.system for m in each.receive()} for each in grounds] == [{1}, {2}]
    finally:
        for each in grounds:
            each.socket.close()


def test_late_client_receives_telemetry(open_server):
    port = free_port()
    server = open_server(Address("udpout", "127.0.0.1", port))
    for tick in range(20):
        server.observe(sample(tick))
        server.poll(tick / 25)
    late = GroundStation(port)
    try:
        server.observe(sample(25))
        assert "HEARTBEAT" in {m.name for m in late.receive()}
    finally:
        late.socket.close()


def test_link_ignores_other_peers(open_server, ground):
    control = RecordingControl()
    server = open_server(out(ground), controls=[control])
    server.observe(sample())
    ground.receive()
    stranger = GroundStation()
    try:
        stranger.peer = ground.peer
        stranger.send("COMMAND_LONG", **ARM, param1=1.0)
        server.poll(0.0)
    finally:
        stranger.socket.close()
    assert control.calls == []


def test_endpoint_reads_limited_datagrams():
    port = free_port()
    endpoint = Endpoint(Address("udpin", "127.0.0.1", port), time.monotonic)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
        for _ in range(MAX_DATAGRAMS + 50):
            flood.sendto(b"x", ("127.0.0.1", port))
        assert [len(list(endpoint.receive())) for _ in range(3)] == [MAX_DATAGRAMS, 50, 0]
        for _ in range(40):
            flood.sendto(bytes(60_000), ("127.0.0.1", port))
        taken = [len(data) for _, data in endpoint.receive()]
    endpoint.close()
    assert set(taken) == {MAX_DATAGRAM_BYTES}


def test_flood_of_commands_is_served_within_budget(open_server, ground):
    now = [0.0]
    control = RecordingControl()
    server = open_server(out(ground), controls=[control], clock=lambda: now[0])
    server.observe(sample())
    ground.receive()
    control._record = lambda *_: now.__setitem__(0, now[0] + 0.002)  # each takes 2 ms
    for _ in range(50):
        ground.send("COMMAND_LONG", **ARM, param1=1.0)
    polls = []
    while server.summary()["frames_received"] < 50:
        before = now[0]
        server.poll(0.0)
        polls.append(now[0] - before)
    assert max(polls) == pytest.approx(0.006)  # it ends with the first message beyond 5 ms
    assert len(polls) == 17


def test_flood_of_all_ports_has_one_budget(open_server):
    now, grounds = [0.0], [GroundStation() for _ in range(5)]
    control = RecordingControl()
    server = open_server(*map(out, grounds), controls=[control], clock=lambda: now[0])
    server.observe(sample())
    control._record = lambda *_: now.__setitem__(0, now[0] + 0.001)  # each takes 1 ms
    for k, ground in enumerate(grounds):
        ground.receive()
        ground.codec = Codec(250 + k, 190)
        for _ in range(20):
            ground.send("COMMAND_LONG", **ARM, param1=1.0)
    polls = []
    for _ in range(10):
        before = now[0]
        server.poll(0.0)
        polls.append(now[0] - before)
        assert len(server.clients) == 5  # each port has its share
    for ground in grounds:
        ground.socket.close()
    assert max(polls) < 0.008  # 5 ms and the rest of a message


def test_long_datagram_is_served_in_order(open_server, ground):
    now = [0.0]
    control = RecordingControl()
    server = open_server(out(ground), controls=[control], clock=lambda: now[0])
    server.observe(sample())
    ground.receive()
    control._record = lambda *given: (
        control.calls.append((server.now, *given)),
        now.__setitem__(0, now[0] + 0.002),  # each takes 2 ms
    )[1]
    items = [ground.codec.pack("MISSION_SET_CURRENT", **TO, seq=seq) for seq in range(1, 31)]
    ground.socket.sendto(b"".join(items[:25]), ground.peer)
    ground.socket.sendto(b"".join(items[25:]), ground.peer)
    polls = []
    for poll in range(12):
        before, server.now = now[0], poll
        server.poll(0.0)
        polls.append(now[0] - before)
    # each poll ends with the first message beyond 5 ms
    assert polls == pytest.approx([0.006] * 10 + [0.0] * 2)
    assert control.calls == [(k // 3, "set_current_item", k + 1) for k in range(30)]
    assert server.summary()["frames_received"] == 30


def test_endpoint_replaces_silent_peers():
    now = [0.0]
    port = free_port()
    endpoint = Endpoint(Address("udpin", "127.0.0.1", port), lambda: now[0])
    peers = [("127.0.0.1", 20_000 + n) for n in range(MAX_PEERS + 1)]
    sent = []
    endpoint._send = lambda attempt: sent.append(attempt)
    for peer in peers:
        endpoint.add_peer(peer)
    endpoint.send(b"x")
    assert len(sent) == MAX_PEERS
    now[0] = 121.0
    endpoint.add_peer(peers[-1])
    sent.clear()
    endpoint.send(b"x")
    assert len(sent) == 1
    endpoint.close()


@pytest.mark.parametrize(
    ("address", "words"),
    [
        (lambda taken: Address("udpin", "127.0.0.1", taken), "another program has this port"),
        (lambda taken: Address("udpin", "192.0.2.1", 14550), "no such address"),
        (lambda taken: Address("udpout", "no..such.host", 14550), "cannot be used"),
        (lambda taken: Address("udpin", "127.0.0.1", 65535, 10), "port 65545"),
    ],
)
def test_unusable_link_is_an_error_with_a_remedy(address, words, ground):
    with pytest.raises(InputError, match=words):
        MavlinkServer(
            [address(ground.port)], [RecordingControl(), RecordingControl()], epoch_us=EPOCH_US
        )


def test_too_many_aircraft_are_an_error():
    with pytest.raises(InputError, match="251 aircraft"):
        MavlinkServer([], [RecordingControl()] * 251, epoch_us=EPOCH_US)


def test_signed_link_rejects_other_messages(open_server):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    for signing, accepted in (
        (key, True),
        (None, False),
        (Signing(bytes(32), time=key.time), False),
    ):
        control = RecordingControl()
        ground = GroundStation(signing=signing)
        server = open_server(out(ground), controls=[control], signing=key)
        server.observe(sample())
        listener = Codec(255, 190, key)
        data, ground.peer = ground.socket.recvfrom(65536)
        assert listener.feed(data, datagram=True)
        for _ in range(2):
            ground.send("COMMAND_LONG", **ARM, param1=1.0)
        server.poll(0.5)
        assert bool(control.calls) is accepted
        rejected = server.summary()["rejected"]
        assert sum(rejected.values()) == (0 if accepted else 2)
        first, later = server.pop_events(), server.pop_events()
        assert [event.level for event in first] == ([] if accepted else ["warning"])
        assert later == []
        ground.socket.close()


def test_signed_link_rejects_replays_and_old_times(open_server):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    control, ground = RecordingControl(), GroundStation(signing=key)
    server = open_server(out(ground), controls=[control], signing=key)
    server.observe(sample())
    _, ground.peer = ground.socket.recvfrom(65536)
    said = ground.codec.pack("COMMAND_LONG", **ARM, param1=1.0)
    for _ in range(3):
        ground.socket.sendto(said, ground.peer)
    server.poll(0.0)
    assert len(control.calls) == 1
    assert server.summary()["rejected"] == {"replayed": 2}
    # from another client with the key, more than a minute old
    old = Codec(254, 190, Signing(KEY, time=key.time - 61 * 100_000))
    ground.socket.sendto(old.pack("COMMAND_LONG", **ARM, param1=1.0), ground.peer)
    server.poll(0.1)
    assert len(control.calls) == 1
    assert server.summary()["rejected"] == {"outdated": 1, "replayed": 2}
    assert [event.level for event in server.pop_events()] == ["warning"]
    ground.send("COMMAND_LONG", **ARM, param1=1.0)
    server.poll(0.2)
    assert len(control.calls) == 2
    ground.socket.close()


def test_signed_frame_is_rejected_on_another_port(open_server, ground):
    key, second = Signing(KEY, time=signing_time(EPOCH_US * 1e-6)), GroundStation()
    control = RecordingControl()
    server = open_server(out(ground), out(second), controls=[control], signing=key)
    server.observe(sample())
    frame = Codec(255, 190, key).pack("COMMAND_LONG", **ARM, param1=1.0)
    for each in (ground, second):
        _, peer = each.socket.recvfrom(65536)
        each.socket.sendto(frame, peer)
    server.poll(0.0)
    second.socket.close()
    assert len(control.calls) == 1 and server.summary()["rejected"] == {"replayed": 1}


def test_frame_from_before_the_run_is_rejected(monkeypatch, ground):
    """The run answers it with its time, from which the client learns to sign later ones."""
    port, world = free_port(), SimpleNamespace(external_control=SimpleNamespace())
    control = RecordingControl()
    world.external_control.vehicles = [control]
    options = ExternalOptions(mavlink=(Address("udpin", "127.0.0.1", port),), signing_key=KEY)
    monkeypatch.setattr(time, "time", lambda: EPOCH_US * 1e-6)
    server = make_server(options, world)
    server.begin(info(1))
    start = signing_time(EPOCH_US * 1e-6)
    ground.codec = Codec(255, 190, Signing(KEY, time=start - 1))  # of a run just before
    ground.peer = ("127.0.0.1", port)
    ground.send("COMMAND_LONG", **ARM, param1=1.0)
    server.poll(0.0)
    assert control.calls == [] and server.summary()["rejected"] == {"outdated": 1}
    assert [message.name for message in ground.receive()] == ["SYSTEM_TIME"]
    ground.send("COMMAND_LONG", **ARM, param1=1.0)
    server.poll(0.0)
    server.close()
    assert len(control.calls) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "key: cannot be read: No such file"),
        ("  \n", "empty; write a passphrase or 64 hexadecimal digits"),
        ("ab" * 20, "40 hexadecimal digits; write 64, or a passphrase"),
    ],
)
def test_invalid_key_is_an_error_before_the_run(tmp_path, text, words):
    path = tmp_path / "key"
    if text is not None:
        path.write_text(text)
    arguments = ("run", "simulation-3", "--mavlink", "14659", "--mavlink-key", path)
    said = call_command(*arguments, cwd=tmp_path, code=2, columns=200).stderr
    assert f"{path}: " in said and words in said
    assert "MAVLink:" not in said and not (tmp_path / "logs").exists()


def test_table_lists_reasons_of_rejections():
    links = {"frames_sent": 9, "frames_received": 0, "clients": []}
    for rejected, words in (
        ({"forged": 33}, "33 signed with another key"),
        ({"forged": 1, "replayed": 1, "unsigned": 3}, "1 received before, 3 not signed"),
    ):
        assert str(describe_mavlink(links | {"rejected": rejected})).endswith(words)
    assert "rejected" not in str(describe_mavlink(links | {"rejected": {}}))


def test_signatures_use_wall_clock_time(open_server, ground):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    now = [500.0]
    server = open_server(out(ground), signing=key, clock=lambda: now[0])
    for after_s in (0.0, 30.0):
        now[0] = 500.0 + after_s
        server.observe(sample(round(25 * 100 * after_s)))
        data = ground.datagrams()[-1]
        # time of the last signature, 10 µs; each is one later than the one before
        stamp = int.from_bytes(data[-12:-6], "little")
        assert 0 <= stamp - signing_time(EPOCH_US * 1e-6 + after_s) < 100


def test_events_are_sent_by_their_aircraft(open_server, ground):
    server = open_server(out(ground), count=2)
    events = (
        Event(0.0, "info", "run", "a gust of 3 m/s²"),
        Event(0.0, "error", "uav1", "lost: " + "very " * 20 + "far"),
        Event(0.0, "warning", "nobody", "x" * 50),
        Event(0.0, "warning", "uav1", "y" * 100),
    )
    server.observe(sample(0, 2, events=events))
    received = [m for m in ground.receive() if m.name == "STATUSTEXT"]
    whole = {}
    for m in received:
        text = whole.setdefault((m.system, m.fields["severity"], m.fields["id"]), {})
        text[m.fields["chunk_seq"]] = m.fields["text"]
        assert len(m.fields["text"]) <= 50
    said = {(key[0], key[1], "".join(text[n] for n in sorted(text))) for key, text in whole.items()}
    assert said == {
        (1, 6, "a gust of 3 m/s2"),
        (2, 3, events[1].text),
        (1, 4, "x" * 50),
        (2, 4, "y" * 100),
    }
    # a text that fills its last chunk is followed by an empty one
    assert {len(text) for text in whole.values()} == {1, 3}


def test_lockstep_attitude_is_last_and_repeated(open_server, ground):
    controls = [
        RecordingControl(),
        RecordingControl("uav1", lockstep=True),
        RecordingControl("uav2"),
    ]
    server = open_server(out(ground), controls=controls)
    for tick in range(3):
        server.observe(sample(tick, 3))
        last = ground.receive()[-1]
        assert (last.name, last.system) == ("ATTITUDE", 2)
        assert last.fields["time_boot_ms"] == 40 * tick
    server.repeat(0.08)
    again = ground.receive()
    assert [(m.name, m.system) for m in again] == [("LOCAL_POSITION_NED", 2), ("ATTITUDE", 2)]
    assert again[-1].fields == last.fields


def test_lockstep_repeats_the_whole_sample(open_server, ground):
    """A program that has missed the first one needs its slow messages, too, to answer it."""
    server = open_server(out(ground), controls=[RecordingControl(lockstep=True)])
    server.observe(sample(0, 1))
    said = [m.name for m in ground.receive()]
    server.repeat(0.0)
    again = [m.name for m in ground.receive()]
    assert {"VFR_HUD", "SYSTEM_TIME", "HEARTBEAT"} <= set(again)
    assert [name for name in said if name != "STATUSTEXT"] == again


def test_log_contains_sent_and_accepted_frames(open_server, ground, tmp_path):
    server = open_server(out(ground))
    server.log_to(tmp_path / "run.tlog")
    server.observe(sample(5))
    said = ground.receive()
    ping = {"time_usec": 2**63 + 1, "seq": 7, "target_system": 0, "target_component": 0}
    one = ground.codec.pack("PING", **ping)
    two = ground.codec.pack("COMMAND_LONG", **ARM, param1=float("nan"))
    ground.socket.sendto(b"\xfd\x01" + one + b"??" + two, ground.peer)
    server.poll(0.3)
    said += ground.receive()
    server.end({}, ())
    kept = list(Tlog(tmp_path / "run.tlog"))
    names = Counter(m.name for _, m in kept)
    assert names == Counter(m.name for m in said) + Counter(["PING", "COMMAND_LONG"])
    assert {time_us - EPOCH_US for time_us, _ in kept} == {200_000, 300_000}
    pings = [m.fields["time_usec"] for _, m in kept if m.name == "PING"]
    assert pings == [2**63 + 1] * 2  # request and answer, to the last digit


def test_log_starts_with_all_parameters(ground, tmp_path):
    server = MavlinkServer(
        [out(ground)], [RecordingControl("leader"), RecordingControl("uav1")], epoch_us=EPOCH_US
    )
    server.log_to(tmp_path / "run.tlog")
    server.begin(info(2))
    server.observe(sample(0, 2))
    assert "PARAM_VALUE" not in {m.name for m in ground.receive()}
    sent = server.summary()["frames_sent"]
    server.end({}, ())
    kept = list(Tlog(tmp_path / "run.tlog"))
    values = [m for _, m in kept if m.name == "PARAM_VALUE"]
    assert [m.name for _, m in kept[: len(values)]] == ["PARAM_VALUE"] * len(values)
    assert len(kept) == len(values) + sent
    for system in (1, 2):
        reported = {
            m.fields["param_id"]: m.fields["param_value"] for m in values if m.system == system
        }
        assert reported | RecordingControl().parameters == reported
        assert (reported["SYSID_THISMAV"], reported["SERVO2_REVERSED"]) == (system, 1.0)
        sequence = [m.sequence for _, m in kept if m.system == system]
        assert sequence == list(range(len(sequence)))


def test_log_works_without_links(open_server, tmp_path):
    server = open_server()
    server.log_to(tmp_path / "run.tlog")
    server.observe(sample())
    server.wait(0.01, 0.0)
    server.end({}, [Event(0.0, "info", "run", "the end")])
    names = [m.name for _, m in Tlog(tmp_path / "run.tlog")]
    assert names[-1] == "STATUSTEXT"
    assert "ATTITUDE" in names


def test_server_without_commands_calls_no_control(open_server, ground):
    controls = [RecordingControl(), RecordingControl("uav1")]
    server = open_server(out(ground), controls=controls)
    for tick in range(100):
        server.poll(tick / 25)
        server.observe(sample(tick, 2))
    assert [control.calls for control in controls] == [[], []]


def test_ports_are_free_after_the_end(ground):
    port = free_port()
    for _ in range(2):
        server = MavlinkServer(
            [Address("udpin", "127.0.0.1", port)], [RecordingControl()], epoch_us=EPOCH_US
        )
        server.begin(info())
        server.end({}, ())
        server.close()


def test_ftp_logs_and_timesync_are_answered(open_server, ground):
    server = open_server(out(ground))
    server.observe(sample(50))
    ground.receive()
    payload = bytes([7, 0, 3, 4, 0, 0, 0, 0, 0, 0, 0, 0]) + b"@PARAM/param.pck"
    ground.send("FILE_TRANSFER_PROTOCOL", **TO, target_network=0, payload=payload)
    ground.send("LOG_REQUEST_LIST", **TO, start=0, end=65535)
    ground.send("TIMESYNC", tc1=0, ts1=2**62 + 1)
    ground.send("TIMESYNC", tc1=5, ts1=6)
    server.poll(2.0)
    nak, logs, clock = ground.receive()
    # sequence, session, NAK, one byte, the opcode, no burst; the byte is the error code FAIL
    assert nak.fields["payload"][:8] == (8, 0, 3, 129, 1, 4, 0, 0)
    assert nak.fields["payload"][12] == 1
    assert nak.fields["target_network"] == 0  # all networks
    assert logs.fields["num_logs"] == 0
    assert (clock.fields["tc1"], clock.fields["ts1"]) == (2_000_000_000, 2**62 + 1)


def broken(count, **what):
    fields = {name: np.zeros(count, dtype=bool) for name in FaultState._fields}
    return FaultState(**{**fields, **what})


def test_lost_gps_fix_is_reported(open_server, ground):
    server = open_server(out(ground), count=2)
    faults = broken(2, gps_lost=np.array([False, True]))
    server.observe(sample(0, count=2)._replace(faults=faults))
    received = ground.receive()
    fixes = {m.system: m.fields["fix_type"] for m in received if m.name == "GPS_RAW_INT"}
    assert fixes == {1: 3, 2: 1}
    gps = constant("MAV_SYS_STATUS_SENSOR_GPS")
    well = {
        m.system: bool(int(m.fields["onboard_control_sensors_health"]) & gps)
        for m in received
        if m.name == "SYS_STATUS"
    }
    assert well == {1: True, 2: False}


def test_frozen_autopilot_sends_and_receives_nothing(open_server, ground):
    controls = [RecordingControl("one"), RecordingControl("two")]
    server = open_server(out(ground), controls=controls)
    faults = broken(2, frozen=np.array([False, True]))
    server.observe(sample(0, count=2)._replace(faults=faults))
    assert {m.system for m in ground.receive()} == {1}
    for system in (1, 2):
        asked = {**ARM, "target_system": system, "param1": 0.0, "param2": 21196.0}
        ground.socket.sendto(ground.codec.pack("COMMAND_LONG", **asked), ground.peer)
    server.poll(0.1)
    assert [m.system for m in ground.receive() if m.name == "COMMAND_ACK"] == [1]
    server.observe(sample(50, count=2))
    assert {m.system for m in ground.receive()} == {1, 2}


def test_frozen_autopilot_sends_events_when_it_resumes(open_server, ground):
    controls = [RecordingControl("one"), RecordingControl("two", lockstep=True)]
    server = open_server(out(ground), controls=controls)
    faults = broken(2, frozen=np.array([False, True]))
    events = [Event(0.0, "warning", name, f"of {name}") for name in ("run", "leader", "uav1")]
    server.observe(sample(0, count=2, events=events)._replace(faults=faults))
    server.repeat(0.0)
    received = ground.receive()
    assert {m.system for m in received} == {1}
    assert [m.fields["text"] for m in received if m.name == "STATUSTEXT"] == ["of run", "of leader"]
    server.observe(sample(1, count=2, events=events))
    texts = [m.fields["text"] for m in ground.receive() if m.name == "STATUSTEXT"]
    assert texts == ["of run", "of leader", "of uav1"]
