"""The station: sockets, several aircraft on a link, signatures, words, and what is left of it."""

import socket
import time
from collections import Counter

import numpy as np
import pytest
from commands import call_command
from links_cockpit import TO, Notebook, frame, info

import testbed.links.station
from testbed.errors import InputError
from testbed.links.addresses import Address, parse_address
from testbed.links.endpoint import DATAGRAMS, LONGEST, PEERS, Endpoint
from testbed.links.station import MOST_CLIENTS, Station
from testbed.mavlink.door import Codec, number
from testbed.mavlink.signing import Signing, signing_time
from testbed.mavlink.tlog import Tlog
from testbed.metrics.outside import describe_mavlink
from testbed.state import Event, Failing

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


class Ground:
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

    def say(self, name, /, **fields):
        self.socket.sendto(self.codec.pack(name, **fields), self.peer)

    def datagrams(self):
        """All that have come; loopback delivers before send returns."""
        found = []
        self.socket.settimeout(2.0)
        while True:
            try:
                data, self.peer = self.socket.recvfrom(65536)
            except (TimeoutError, BlockingIOError):
                return found
            found.append(data)
            self.socket.settimeout(0.0)

    def hear(self):
        """The messages in them."""
        datagrams = self.datagrams()
        assert all(len(data) <= 1400 for data in datagrams)
        return [m for data in datagrams for m in self.codec.feed(data, whole=True)]


@pytest.fixture
def ground():
    station = Ground()
    yield station
    station.socket.close()


@pytest.fixture
def opened(monkeypatch):
    """Stations that are closed whatever happens."""
    stations = []

    def make(*addresses, count=1, notebooks=None, **options):
        if "clock" not in options:
            # how far a look gets must not depend on what else this machine does
            monkeypatch.setattr("testbed.links.station.SPARED_S", 2.0)
        notebooks = notebooks or [Notebook(name) for name in info(count).names]
        station = Station(addresses, notebooks, epoch_us=EPOCH_US, **options)
        stations.append(station)
        station.begin(info(len(notebooks)))
        return station

    yield make
    for station in stations:
        station.close()


def out(ground):
    return Address("udpout", "127.0.0.1", ground.port)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_aircraft_share_a_link_each_with_its_own_number_and_sequence(opened, ground):
    station = opened(out(ground), count=3)
    for tick in range(10):
        station.observe(frame(tick, 3))
    heard = ground.hear()
    assert {m.system for m in heard} == {1, 2, 3}
    assert {m.component for m in heard} == {1}
    for system in (1, 2, 3):
        sequence = [m.sequence for m in heard if m.system == system]
        assert sequence == list(range(len(sequence)))
    assert station.summary()["frames_sent"] == len(heard)


def test_what_is_said_is_heard_and_answered(opened, ground):
    notebook = Notebook()
    station = opened(out(ground), notebooks=[notebook])
    station.observe(frame())
    ground.hear()
    ground.say("HEARTBEAT", **HEARTBEAT)
    ground.say("COMMAND_LONG", **ARM, param1=1.0)
    station.poll(0.02)
    assert notebook.calls == [("arm", True, False)]
    (ack,) = ground.hear()
    assert (ack.name, ack.fields["result"]) == ("COMMAND_ACK", 0)
    assert station.clients == ((255, 190, 0.02),)
    assert station.summary()["frames_heard"] == 2
    assert station.summary()["clients"] == ["255.190"]


def test_who_only_commands_has_spoken_too(opened, ground):
    station = opened(out(ground))
    station.observe(frame())
    ground.hear()
    ground.say("COMMAND_LONG", **ARM, param1=1.0)
    station.poll(0.02)
    station.poll(0.06)
    assert station.clients == ((255, 190, 0.02),)
    ground.socket.sendto(Codec(7, 25).pack("COMMAND_LONG", **ARM, param1=1.0), ground.peer)
    station.poll(0.1)
    assert station.summary()["clients"] == ["7.25", "255.190"]


def test_a_crowd_of_speakers_is_counted_only_so_far(opened, ground):
    station = opened(out(ground))
    station.observe(frame())
    ground.hear()
    for system in range(10, 60):
        ground.socket.sendto(Codec(system, 1).pack("HEARTBEAT", **HEARTBEAT), ground.peer)
    while station.summary()["frames_heard"] < 50:
        station.poll(0.02)
    assert len(station.clients) == MOST_CLIENTS == 32


def test_a_wait_ends_when_something_is_heard_and_otherwise_in_time(opened, ground, monkeypatch):
    now = [0.0]

    def turn(endpoints, seconds, really=testbed.links.station.wait):
        really(endpoints, seconds)
        now[0] += seconds  # the clock goes on as long as was asked for, and no further

    monkeypatch.setattr("testbed.links.station.wait", turn)
    station = opened(out(ground), clock=lambda: now[0])
    station.observe(frame())
    ground.hear()
    station.wait(0.05, 0.0)
    assert now[0] == pytest.approx(0.05)
    ground.say("HEARTBEAT", **HEARTBEAT)
    station.wait(20.0, 0.0)
    assert now[0] < 10.0
    assert len(station.clients) == 1


def test_one_who_listens_tells_those_who_have_spoken(opened):
    port = free_port()
    station = opened(Address("udpin", "127.0.0.1", port))
    first, second = Ground(), Ground()
    try:
        for each in (first, second):
            each.peer = ("127.0.0.1", port)
        first.say("HEARTBEAT", **HEARTBEAT)
        second.socket.sendto(b"noise", second.peer)
        station.poll(0.0)
        station.observe(frame())
        assert "ATTITUDE" in {m.name for m in first.hear()}
        second.say("HEARTBEAT", **HEARTBEAT)
        station.poll(0.1)
        station.observe(frame(10))
        assert "ATTITUDE" in {m.name for m in second.hear()}
        # what it was told before it had spoken sense would have come before this
        assert second.codec.skipped == 0
        assert station.summary()["skipped_bytes"] == len(b"noise")
    finally:
        first.socket.close()
        second.socket.close()


def test_each_aircraft_may_have_a_port(opened):
    grounds = [Ground(), None]
    while grounds[1] is None:
        try:
            grounds[1] = Ground(grounds[0].port + 1)
        except OSError:
            grounds[0].socket.close()
            grounds[0] = Ground()
    try:
        station = opened(parse_address(f"{grounds[0].port}+1"), count=2)
        station.observe(frame(0, 2))
        assert [{m.system for m in each.hear()} for each in grounds] == [{1}, {2}]
    finally:
        for each in grounds:
            each.socket.close()


def test_nobody_listening_is_no_trouble_and_who_comes_later_is_told(opened):
    port = free_port()
    station = opened(Address("udpout", "127.0.0.1", port))
    for tick in range(20):
        station.observe(frame(tick))
        station.poll(tick / 25)
    late = Ground(port)
    try:
        station.observe(frame(25))
        assert "HEARTBEAT" in {m.name for m in late.hear()}
    finally:
        late.socket.close()


def test_only_the_peer_of_a_link_is_heard(opened, ground):
    notebook = Notebook()
    station = opened(out(ground), notebooks=[notebook])
    station.observe(frame())
    ground.hear()
    stranger = Ground()
    try:
        stranger.peer = ground.peer
        stranger.say("COMMAND_LONG", **ARM, param1=1.0)
        station.poll(0.0)
    finally:
        stranger.socket.close()
    assert notebook.calls == []


def test_a_flood_takes_bounded_work_and_the_rest_waits():
    port = free_port()
    endpoint = Endpoint(Address("udpin", "127.0.0.1", port), time.monotonic)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
        for _ in range(DATAGRAMS + 50):
            flood.sendto(b"x", ("127.0.0.1", port))
        assert [len(list(endpoint.receive())) for _ in range(3)] == [DATAGRAMS, 50, 0]
        for _ in range(40):
            flood.sendto(bytes(60_000), ("127.0.0.1", port))
        taken = [len(data) for _, data in endpoint.receive()]
    endpoint.close()
    assert set(taken) == {LONGEST}


def test_a_flood_of_questions_takes_little_of_a_flights_time(opened, ground):
    now = [0.0]
    notebook = Notebook()
    station = opened(out(ground), notebooks=[notebook], clock=lambda: now[0])
    station.observe(frame())
    ground.hear()
    notebook._note = lambda *_: now.__setitem__(0, now[0] + 0.002)  # each takes 2 ms
    for _ in range(50):
        ground.say("COMMAND_LONG", **ARM, param1=1.0)
    looks = []
    while station.summary()["frames_heard"] < 50:
        before = now[0]
        station.poll(0.0)
        looks.append(now[0] - before)
    assert max(looks) == pytest.approx(0.006)  # it ends with the first beyond 5 ms
    assert len(looks) == 17


def test_a_datagram_of_many_questions_is_answered_in_parts_and_in_order(opened, ground):
    now = [0.0]
    notebook = Notebook()
    station = opened(out(ground), notebooks=[notebook], clock=lambda: now[0])
    station.observe(frame())
    ground.hear()
    notebook._note = lambda *given: (
        notebook.calls.append((station.now, *given)),
        now.__setitem__(0, now[0] + 0.002),  # each takes 2 ms
    )[1]
    items = [ground.codec.pack("MISSION_SET_CURRENT", **TO, seq=seq) for seq in range(1, 31)]
    ground.socket.sendto(b"".join(items[:25]), ground.peer)
    ground.socket.sendto(b"".join(items[25:]), ground.peer)
    looks = []
    for look in range(12):
        before, station.now = now[0], look
        station.poll(0.0)
        looks.append(now[0] - before)
    # each look ends with the first beyond 5 ms
    assert looks == pytest.approx([0.006] * 10 + [0.0] * 2)
    assert notebook.calls == [(k // 3, "go_on_at", k + 1) for k in range(30)]
    assert station.summary()["frames_heard"] == 30


def test_a_crowd_is_told_only_so_far_and_those_gone_silent_make_room():
    now = [0.0]
    port = free_port()
    endpoint = Endpoint(Address("udpin", "127.0.0.1", port), lambda: now[0])
    peers = [("127.0.0.1", 20_000 + n) for n in range(PEERS + 1)]
    sent = []
    endpoint._send = lambda attempt: sent.append(attempt)
    for peer in peers:
        endpoint.welcome(peer)
    endpoint.send(b"x")
    assert len(sent) == PEERS
    now[0] = 121.0
    endpoint.welcome(peers[-1])
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
def test_a_link_that_cannot_be_had_is_an_error_that_says_what_to_give(address, words, ground):
    with pytest.raises(InputError, match=words):
        Station([address(ground.port)], [Notebook(), Notebook()], epoch_us=EPOCH_US)


def test_more_aircraft_than_numbers_are_refused():
    with pytest.raises(InputError, match="251 aircraft"):
        Station([], [Notebook()] * 251, epoch_us=EPOCH_US)


def test_signed_words_are_believed_and_others_counted_and_reported_once(opened):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    for signing, believed in (
        (key, True),
        (None, False),
        (Signing(bytes(32), time=key.time), False),
    ):
        notebook = Notebook()
        ground = Ground(signing=signing)
        station = opened(out(ground), notebooks=[notebook], signing=key)
        station.observe(frame())
        deaf = Codec(255, 190, key)
        data, ground.peer = ground.socket.recvfrom(65536)
        assert deaf.feed(data, whole=True)
        for _ in range(2):
            ground.say("COMMAND_LONG", **ARM, param1=1.0)
        station.poll(0.5)
        assert bool(notebook.calls) is believed
        refused = station.summary()["refused"]
        assert sum(refused.values()) == (0 if believed else 2)
        first, later = station.news(), station.news()
        assert [event.level for event in first] == ([] if believed else ["warning"])
        assert later == []
        ground.socket.close()


def test_what_was_signed_before_or_long_ago_is_not_believed(opened):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    notebook, ground = Notebook(), Ground(signing=key)
    station = opened(out(ground), notebooks=[notebook], signing=key)
    station.observe(frame())
    _, ground.peer = ground.socket.recvfrom(65536)
    said = ground.codec.pack("COMMAND_LONG", **ARM, param1=1.0)
    for _ in range(3):
        ground.socket.sendto(said, ground.peer)
    station.poll(0.0)
    assert len(notebook.calls) == 1
    assert station.summary()["refused"] == {"replayed": 2}
    # by another who has the key, in a minute that is over
    old = Codec(254, 190, Signing(KEY, time=key.time - 61 * 100_000))
    ground.socket.sendto(old.pack("COMMAND_LONG", **ARM, param1=1.0), ground.peer)
    station.poll(0.1)
    assert len(notebook.calls) == 1
    assert station.summary()["refused"] == {"replayed": 3}
    assert [event.level for event in station.news()] == ["warning"]
    ground.say("COMMAND_LONG", **ARM, param1=1.0)
    station.poll(0.2)
    assert len(notebook.calls) == 2
    ground.socket.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot read this key"),
        ("  \n", "empty; write a passphrase or 64 hexadecimal digits"),
        ("ab" * 20, "40 hexadecimal digits; write 64, or a passphrase"),
    ],
)
def test_a_key_that_is_missing_or_cut_is_refused_before_anything_is_opened(tmp_path, text, words):
    path = tmp_path / "key"
    if text is not None:
        path.write_text(text)
    arguments = ("run", "simulation-3", "--mavlink", "14659", "--mavlink-key", path)
    said = call_command(*arguments, cwd=tmp_path, code=2, columns=200).stderr
    assert f"{path}: " in said and words in said
    assert "MAVLink:" not in said and not (tmp_path / "logs").exists()


def test_the_table_says_why_somebody_was_not_believed():
    links = {"frames_sent": 9, "frames_heard": 0, "clients": []}
    for refused, words in (
        ({"forged": 33}, "33 signed with another key"),
        ({"forged": 1, "replayed": 1, "unsigned": 3}, "1 heard before, 3 not signed"),
    ):
        assert str(describe_mavlink(links | {"refused": refused})).endswith(words)
    assert "refused" not in str(describe_mavlink(links | {"refused": {}}))


def test_signatures_are_stamped_by_the_wall_clock(opened, ground):
    key = Signing(KEY, time=signing_time(EPOCH_US * 1e-6))
    now = [500.0]
    station = opened(out(ground), signing=key, clock=lambda: now[0])
    for after_s in (0.0, 30.0):
        now[0] = 500.0 + after_s
        station.observe(frame(round(25 * 100 * after_s)))
        data = ground.datagrams()[-1]
        # of the last signature, 10 µs; each is one later than the last
        stamp = int.from_bytes(data[-12:-6], "little")
        assert 0 <= stamp - signing_time(EPOCH_US * 1e-6 + after_s) < 100


def test_what_happens_is_said_by_whom_it_is_about(opened, ground):
    station = opened(out(ground), count=2)
    events = (
        Event(0.0, "info", "run", "a gust of 3 m/s²"),
        Event(0.0, "error", "uav1", "lost: " + "very " * 20 + "far"),
        Event(0.0, "warning", "nobody", "x" * 50),
        Event(0.0, "warning", "uav1", "y" * 100),
    )
    station.observe(frame(0, 2, events=events))
    heard = [m for m in ground.hear() if m.name == "STATUSTEXT"]
    whole = {}
    for m in heard:
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
    # a text that fills its last message is ended by an empty one
    assert {len(text) for text in whole.values()} == {1, 3}


def test_in_lockstep_the_state_that_is_answered_comes_last_and_is_repeated(opened, ground):
    notebooks = [Notebook(), Notebook("uav1", lockstep=True), Notebook("uav2")]
    station = opened(out(ground), notebooks=notebooks)
    for tick in range(3):
        station.observe(frame(tick, 3))
        last = ground.hear()[-1]
        assert (last.name, last.system) == ("ATTITUDE", 2)
        assert last.fields["time_boot_ms"] == 40 * tick
    station.repeat(0.08)
    again = ground.hear()
    assert [(m.name, m.system) for m in again] == [("LOCAL_POSITION_NED", 2), ("ATTITUDE", 2)]
    assert again[-1].fields == last.fields


def test_a_log_keeps_what_was_said_and_what_was_believed(opened, ground, tmp_path):
    station = opened(out(ground))
    station.keep(tmp_path / "run.tlog")
    station.observe(frame(5))
    said = ground.hear()
    ping = {"time_usec": 2**63 + 1, "seq": 7, "target_system": 0, "target_component": 0}
    one = ground.codec.pack("PING", **ping)
    two = ground.codec.pack("COMMAND_LONG", **ARM, param1=float("nan"))
    ground.socket.sendto(b"\xfd\x01" + one + b"??" + two, ground.peer)
    station.poll(0.3)
    said += ground.hear()
    station.end({}, ())
    kept = list(Tlog(tmp_path / "run.tlog"))
    names = Counter(m.name for _, m in kept)
    assert names == Counter(m.name for m in said) + Counter(["PING", "COMMAND_LONG"])
    assert {time_us - EPOCH_US for time_us, _ in kept} == {200_000, 300_000}
    pings = [m.fields["time_usec"] for _, m in kept if m.name == "PING"]
    assert pings == [2**63 + 1] * 2  # asked and answered, to the last digit


def test_a_log_begins_with_all_parameters_and_a_link_does_not(ground, tmp_path):
    station = Station([out(ground)], [Notebook("leader"), Notebook("uav1")], epoch_us=EPOCH_US)
    station.keep(tmp_path / "run.tlog")
    station.begin(info(2))
    station.observe(frame(0, 2))
    assert "PARAM_VALUE" not in {m.name for m in ground.hear()}
    sent = station.summary()["frames_sent"]
    station.end({}, ())
    kept = list(Tlog(tmp_path / "run.tlog"))
    values = [m for _, m in kept if m.name == "PARAM_VALUE"]
    assert [m.name for _, m in kept[: len(values)]] == ["PARAM_VALUE"] * len(values)
    assert len(kept) == len(values) + sent
    for system in (1, 2):
        told = {m.fields["param_id"]: m.fields["param_value"] for m in values if m.system == system}
        assert told | Notebook().parameters == told
        assert (told["SYSID_THISMAV"], told["SERVO2_REVERSED"]) == (system, 1.0)
        sequence = [m.sequence for _, m in kept if m.system == system]
        assert sequence == list(range(len(sequence)))


def test_a_log_alone_needs_no_link(opened, tmp_path):
    station = opened()
    station.keep(tmp_path / "run.tlog")
    station.observe(frame())
    station.wait(0.01, 0.0)
    station.end({}, [Event(0.0, "info", "run", "the end")])
    names = [m.name for _, m in Tlog(tmp_path / "run.tlog")]
    assert names[-1] == "STATUSTEXT"
    assert "ATTITUDE" in names


def test_a_station_nobody_commands_calls_nothing_in_a_cockpit(opened, ground):
    notebooks = [Notebook(), Notebook("uav1")]
    station = opened(out(ground), notebooks=notebooks)
    for tick in range(100):
        station.poll(tick / 25)
        station.observe(frame(tick, 2))
    assert [notebook.calls for notebook in notebooks] == [[], []]


def test_after_the_end_ports_are_free(ground):
    port = free_port()
    for _ in range(2):
        station = Station([Address("udpin", "127.0.0.1", port)], [Notebook()], epoch_us=EPOCH_US)
        station.begin(info())
        station.end({}, ())
        station.close()


def test_files_logs_and_clocks_are_answered(opened, ground):
    station = opened(out(ground))
    station.observe(frame(50))
    ground.hear()
    payload = bytes([7, 0, 3, 4, 0, 0, 0, 0, 0, 0, 0, 0]) + b"@PARAM/param.pck"
    ground.say("FILE_TRANSFER_PROTOCOL", **TO, target_network=0, payload=payload)
    ground.say("LOG_REQUEST_LIST", **TO, start=0, end=65535)
    ground.say("TIMESYNC", tc1=0, ts1=2**62 + 1)
    ground.say("TIMESYNC", tc1=5, ts1=6)
    station.poll(2.0)
    nak, logs, clock = ground.hear()
    # sequence, session, NAK, one byte, the operation, no burst; the byte says that it failed
    assert nak.fields["payload"][:8] == (8, 0, 3, 129, 1, 4, 0, 0)
    assert nak.fields["payload"][12] == 1
    assert logs.fields["num_logs"] == 0
    assert (clock.fields["tc1"], clock.fields["ts1"]) == (2_000_000_000, 2**62 + 1)


def broken(count, **what):
    fields = {name: np.zeros(count, dtype=bool) for name in Failing._fields}
    return Failing(**{**fields, **what})


def test_a_receiver_without_a_fix_says_so(opened, ground):
    station = opened(out(ground), count=2)
    failing = broken(2, gps_lost=np.array([False, True]))
    station.observe(frame(0, count=2)._replace(failing=failing))
    heard = ground.hear()
    fixes = {m.system: m.fields["fix_type"] for m in heard if m.name == "GPS_RAW_INT"}
    assert fixes == {1: 3, 2: 1}
    gps = number("MAV_SYS_STATUS_SENSOR_GPS")
    well = {
        m.system: bool(int(m.fields["onboard_control_sensors_health"]) & gps)
        for m in heard
        if m.name == "SYS_STATUS"
    }
    assert well == {1: True, 2: False}


def test_an_autopilot_that_hangs_neither_speaks_nor_hears(opened, ground):
    books = [Notebook("one"), Notebook("two")]
    station = opened(out(ground), notebooks=books)
    failing = broken(2, frozen=np.array([False, True]))
    station.observe(frame(0, count=2)._replace(failing=failing))
    assert {m.system for m in ground.hear()} == {1}
    for system in (1, 2):
        asked = {**ARM, "target_system": system, "param1": 0.0, "param2": 21196.0}
        ground.socket.sendto(ground.codec.pack("COMMAND_LONG", **asked), ground.peer)
    station.poll(0.1)
    assert [m.system for m in ground.hear() if m.name == "COMMAND_ACK"] == [1]
    station.observe(frame(50, count=2))
    assert {m.system for m in ground.hear()} == {1, 2}


def test_an_autopilot_that_hangs_does_not_say_so_but_that_it_flies_again(opened, ground):
    books = [Notebook("one"), Notebook("two", lockstep=True)]
    station = opened(out(ground), notebooks=books)
    failing = broken(2, frozen=np.array([False, True]))
    news = [Event(0.0, "warning", name, f"of {name}") for name in ("run", "leader", "uav1")]
    station.observe(frame(0, count=2, events=news)._replace(failing=failing))
    station.repeat(0.0)
    heard = ground.hear()
    assert {m.system for m in heard} == {1}
    assert [m.fields["text"] for m in heard if m.name == "STATUSTEXT"] == ["of run", "of leader"]
    station.observe(frame(1, count=2, events=news))
    texts = [m.fields["text"] for m in ground.hear() if m.name == "STATUSTEXT"]
    assert texts == ["of run", "of leader", "of uav1"]
