"""The loop of a companion, with an autopilot and others that the test plays."""

from pathlib import Path

import pytest
from companion_bench import FBWA, GUIDED, CompanionBench, angles, make_control

import testbed
from testbed.companion.engagement import Engagement, EngagementState
from testbed.companion.start import UNSIGNED
from testbed.logs.mcap_file import LogError
from testbed.mavlink.codec import Codec
from testbed.mavlink.signing import Signing, signing_time

KEY, OTHER_KEY = b"k" * 32, b"o" * 32
FOLDER = Path("scenarios")


@pytest.fixture(scope="module")
def scenario():
    return testbed.load_scenario("simulation-3")


@pytest.fixture(scope="module")
def control(scenario):
    return make_control(scenario)


@pytest.fixture
def bench(scenario, control):
    made = CompanionBench(scenario, FOLDER, control)
    yield made
    made.close()


def test_pilot_engages_and_ends_by_the_switch(bench):
    bench.give_parameters()
    for _ in range(5):
        bench.sample()
    assert not bench.commands()
    assert bench.listening.texts[-1] == "formation ready: GUIDED engages it"
    bench.mode = GUIDED
    bench.sample()
    bench.sample()
    assert len(bench.commands()) == 2
    bench.mode = FBWA
    bench.sample()
    bench.sample()
    assert not bench.commands()
    assert "formation left: mode 5 by the pilot" in bench.listening.texts


def test_command_follows_each_new_sample_once(bench):
    bench.engage()
    first = bench.commands()
    bench.sample()
    second = bench.commands()
    assert len(first) == len(second) == 1
    assert second[0].fields["time_boot_ms"] == bench.boot_ms
    assert second[0].fields["type_mask"] == 7
    bench.sample(step_ms=0)  # the same sample again
    assert not bench.commands()


@pytest.mark.parametrize("east", [8.0, -8.0])
def test_command_flies_towards_the_slot(bench, monkeypatch, east):
    """An aircraft right of its slot banks left, and one left of it right."""
    place, row = bench.position_ned, bench.control.row

    def beside(other):
        north, own, down = place(other)
        return north, own + (east if other == row else 0.0), down

    monkeypatch.setattr(bench, "position_ned", beside)
    bench.engage()
    for _ in range(5):
        bench.sample()
    roll = angles(bench.commands()[-1])[0]
    assert roll < -0.1 if east > 0.0 else roll > 0.1


def test_message_during_the_decision_is_used(bench, monkeypatch):
    """Where autopilots send at the same moment: that of the same sample, not of the one before."""
    bench.engage()
    decide, step, used = Engagement.step, type(bench.control).step, []

    def decide_late(gate, seen):
        bench.send_formation(bench.peer_frame(0))
        return decide(gate, seen)

    def watch(control, now):
        used.append(float(control.inbox[0]["stamp_s"]))
        step(control, now)

    monkeypatch.setattr(Engagement, "step", decide_late)
    monkeypatch.setattr(type(bench.control), "step", watch)
    bench.sample(with_peers=False)
    assert used == [bench.boot_ms / 1e3]


def test_position_is_not_that_of_the_local_frame(bench):
    """LOCAL_POSITION_NED counts from the origin of each autopilot's filter."""
    bench.sample(LOCAL_POSITION_NED={"x": 5e3, "y": -7e3, "z": 400.0})
    own = bench.control.own["estimate"]["position_ned"]
    assert own == pytest.approx(bench.position_ned(bench.control.row), abs=0.02)


def test_leader_that_is_silent_is_left(bench):
    bench.engage()
    assert bench.loop.decision.state is EngagementState.ENGAGED
    for _ in range(3):
        bench.sample()
    assert bench.commands()
    while bench.loop.decision.command:
        bench.sample(with_peers=False)
        bench.turn(longest_s=0.1)
        assert bench.boot_ms < 10_000
    bench.received = []
    bench.turn(longest_s=0.2)
    assert not bench.commands()
    assert any("leader silent" in each for each in bench.listening.texts)


def test_mode_of_leaving_is_asked_for_once(bench):
    bench.engage()
    bench.sample(ATTITUDE={"roll": 0.0}, GPS_RAW_INT={"fix_type": 1})
    for _ in range(3):
        bench.sample(GPS_RAW_INT={"fix_type": 1})
    asked = [
        each.fields["param2"]
        for each in bench.received
        if each.name == "COMMAND_LONG" and each.fields["command"] == 176
    ]
    assert asked == [12.0]
    assert not any(
        each.name == "COMMAND_LONG" and each.fields["command"] == 400 for each in bench.received
    )  # never arms


def test_texts_go_to_the_ground_station(bench):
    bench.engage()
    texts = [each.fields["text"] for each in bench.received if each.name == "STATUSTEXT"]
    assert "formation engaged" in texts


@pytest.mark.parametrize(
    "change",
    [{"vel": (float("nan"), 0.0, 0.0)}, {"vel": (400.0, 0.0, 0.0)}, {"lat": 900_000_000}],
    ids=["nan", "fast", "far"],
)
def test_absurd_message_is_not_taken(bench, change):
    bench.sample()
    before = bench.control.inbox.copy()
    bench.boot_ms += 40
    bench.send_formation(bench.peer_frame(0, **change))
    bench.turn()
    assert bench.control.inbox.tobytes() == before.tobytes()
    bench.send_formation(bench.peer_frame(0))
    bench.turn()
    assert bench.control.inbox.tobytes() != before.tobytes()


def test_older_message_is_not_taken(bench):
    bench.sample()
    frame = bench.peer_frame(0, timestamp=1_800_000_000_000 + bench.boot_ms - 20)
    before = bench.control.inbox[0]["stamp_s"]
    bench.send_formation(frame)
    bench.turn()
    assert bench.control.inbox[0]["stamp_s"] == before


def test_garbage_changes_nothing(bench):
    bench.engage()
    for data in (b"", b"\xfd" * 300, bench.peer_frame(0)[:-1], b"\xfe" + bytes(40)):
        bench.send_formation(data)
        bench.autopilot.sendto(data, ("127.0.0.1", bench._autopilot_port))
    bench.turn()
    bench.sample()
    assert bench.loop.decision.command


def test_another_scenario_is_refused(bench):
    bench.give_parameters()
    for _ in range(5):
        bench.sample()
    for _ in range(30):
        bench.boot_ms += 40
        bench.send_formation(bench.peer_frame(0, custom_state=1))
        bench.sample(with_peers=False)
        if bench.loop.decision.state is not EngagementState.READY:
            break
    bench.mode = GUIDED
    bench.sample(with_peers=False)
    assert not bench.commands()
    assert any("leader has other scenario" in each for each in bench.listening.texts)


def test_forged_and_replayed_messages_are_refused(scenario, control):
    bench = CompanionBench(scenario, FOLDER, control, key=KEY)
    try:
        now = signing_time(1.9e9)
        bench.codec = Codec(3, 1, Signing(KEY, time=now))
        signed = Codec(1, 191, Signing(KEY, link=1, time=now))
        bench.peers = {}
        bench.sample()
        number = bench.control.inbox[0]["number"]
        frames = {}
        for name, codec in (
            ("unsigned", Codec(1, 191)),
            ("forged", Codec(1, 191, Signing(OTHER_KEY, link=1, time=now))),
            ("good", signed),
        ):
            bench.boot_ms += 40
            bench.peers[0] = codec
            frames[name] = bench.peer_frame(0)
            bench.send_formation(frames[name])
            bench.turn()
            taken = bench.control.inbox[0]["number"] != number
            assert taken == (name == "good"), name
        rejected = dict(bench.loop.rejected)
        bench.send_formation(frames["good"])
        bench.turn()
        assert bench.loop.rejected["replayed"] == rejected.get("replayed", 0) + 1
    finally:
        bench.close()


def test_law_that_fails_leaves_the_formation(bench, monkeypatch):
    bench.engage()
    bench.received = []

    def fail(now):
        raise testbed.InputError("law.py:3: no number")

    monkeypatch.setattr(bench.control, "step", fail)
    for _ in range(4):
        bench.sample()
    assert not bench.commands()
    assert any("law failed" in each for each in bench.listening.texts)
    assert bench.loop.decision.state is EngagementState.LEFT


def test_log_that_fails_does_not_stop_the_control(scenario, control, tmp_path, monkeypatch):
    from testbed.companion.flight_record import FlightRecord
    from testbed.logs.recorder import McapRecorder

    warned = []
    record = FlightRecord(scenario, control, tmp_path / "out", warned.append)
    made = CompanionBench(scenario, FOLDER, control, listeners=[record])
    try:
        made.engage()

        def full(self, sample):
            raise LogError("run.mcap: cannot write the log: No space left on device")

        monkeypatch.setattr(McapRecorder, "observe", full)
        made.commands()
        for _ in range(3):
            made.sample()
        assert len(made.commands()) == 3
        assert len(warned) == 1 and "No space left" in warned[0]
        record.close(made.loop.statistics.summary())
        assert len(warned) == 1
    finally:
        made.close()


def test_own_acceleration_is_of_two_samples(bench):
    bench.sample()
    bench.sample(LOCAL_POSITION_NED={"vx": 20.2})
    own = bench.control.own["estimate"]["acceleration_ned"]
    assert own == pytest.approx((5.0, 0.0, 0.0), abs=1e-4)


def test_position_moves_to_the_time_of_attitude(bench):
    bench.sample(GLOBAL_POSITION_INT={"time_boot_ms": 0})  # 40 ms older than the attitude
    expected = bench.position_ned(bench.control.row)[0] + 20.0 * 0.04
    assert bench.control.own["estimate"]["position_ned"][0] == pytest.approx(expected, abs=0.02)


def test_of_waiting_samples_the_newest_is_answered(bench):
    bench.engage()
    bench.commands()
    with bench.waiting():
        for _ in range(5):
            bench.sample()
    bench.turn()
    (command,) = bench.commands()
    assert command.fields["time_boot_ms"] == bench.boot_ms


def test_another_aircraft_at_the_link_is_reported(bench):
    bench.codec = Codec(7, 1)
    with bench.waiting():  # it counts none of these samples
        for _ in range(3):
            bench.sample()
    bench.turn()
    told = [each for each in bench.listening.texts if "system id" in each]
    assert told == ["autopilot has system id 7, 3 is expected"]
    assert not bench.listening.samples


def test_clock_that_jumps_forgets_the_messages(bench):
    bench.sample()
    bench.sample()
    assert bench.control.inbox[0]["number"] >= 0
    later_us = 1000 * (1_800_000_000_000 + bench.boot_ms + 40) + 3_000_000
    bench.sample(with_peers=False, SYSTEM_TIME={"time_unix_usec": later_us})
    assert bench.control.inbox[0]["number"] == -1


def test_without_gps_time_nothing_is_broadcast(bench):
    bench.sample(SYSTEM_TIME={"time_unix_usec": 0})
    assert not bench.heard()
    bench.sample()
    assert bench.heard()


def test_law_begins_again_with_each_engagement(bench, monkeypatch):
    """Its memory is that of the first step: to the bit the same for the same state."""
    control = bench.control
    bench.sample()
    inbox, commands = control.inbox.copy(), []
    control.own["estimate"]["position_ned"] += (0.0, 5.0, 2.0)

    def command(now):
        control.inbox["received_s"] = now
        control.step(now)
        return tuple(control.own["control"].tolist())

    for restarts in (True, True, False):
        if restarts:
            control.restart()
        commands.append([command(0.04 * k) for k in range(20)])
    assert control.inbox["number"].tolist() == inbox["number"].tolist()  # messages stay
    assert commands[0] == commands[1] != commands[2]
    restarted = []
    monkeypatch.setattr(control, "restart", lambda: restarted.append(bench.boot_ms))
    for _ in range(2):
        bench.mode = FBWA
        bench.engage()
    assert len(restarted) == 2


def test_unsigned_links_that_leave_are_reported(scenario, control):
    """Also to the ground station, in one STATUSTEXT."""
    for unsigned, place, told in ((True, "0.0.0.0", 1), (False, "127.0.0.1", 0)):
        bench = CompanionBench(scenario, FOLDER, control, unsigned=unsigned, place=place)
        try:
            bench.sample()
            bench.sample()
            assert bench.listening.texts.count(UNSIGNED.text) == told
            texts = [each.fields["text"] for each in bench.received if each.name == "STATUSTEXT"]
            assert texts.count(UNSIGNED.text) == told
        finally:
            bench.close()
