"""The log holds what was seen, to the bit, for any reader, however the run ends."""

import io
import json
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import mcap.reader
import numpy as np
import pytest
import zstandard
from commands import environment
from given_time import last_s
from mcap import records
from mcap.stream_reader import StreamReader
from patience import until
from record_flight import RECORDS, assert_same_frame, decoded, event, record, run_frames, run_info

from testbed.frames import geodetic_from_ned, rotation_ned_body
from testbed.metrics import MetricsObserver
from testbed.record import recorder
from testbed.record.door import LogError
from testbed.record.read import frames, read_log
from testbed.record.recorder import McapRecorder
from testbed.state import Event

CHUNK = recorder.chunk_frames(4)
# Runs that are killed: how slow they are, and a seed of the moment; all where TESTBED_KILLS is set.
KILLED = [(0.0, 1), (0.1, 4)]
if os.environ.get("TESTBED_KILLS"):
    KILLED += [(0.0, 2), (0.02, 3)]


@pytest.fixture
def quick(monkeypatch):
    """No chunk is cut because a busy machine is slow."""
    monkeypatch.setattr(recorder, "FLUSH_S", 3600.0)


@pytest.mark.parametrize(
    ("count", "followers", "noisy_from", "gone_from"),
    [
        (120, 3, None, None),
        (120, 3, 60, 70),
        (7, 1, 0, 0),
        (25, 20, None, 12),
        (5, 0, None, None),
        (5, 0, 3, 4),
        (CHUNK, 3, None, None),
    ],
)
def test_a_log_gives_back_every_frame(tmp_path, count, followers, noisy_from, gone_from):
    # CHUNK frames end with a chunk, so that the event after them has a chunk of its own
    some = [event(0), event(0, "é ∞"), event(3, level="error")]
    seen = list(
        run_frames(count, followers, noisy_from=noisy_from, gone_from=gone_from, events=some)
    )
    last = Event(seen[-1].time_s, "info", "run", "the end")
    info = run_info(followers)
    log = read_log(record(tmp_path / "run.mcap", seen, info, events=(last,)))
    back = list(frames(log))
    assert len(back) == count
    assert back[-1].events[-1] == last
    for one, other in zip(seen[:-1], back[:-1], strict=True):
        assert_same_frame(one, other)
    assert log.finished
    assert log.lost_bytes == 0


def test_metrics_from_the_log_are_those_of_the_flight(tmp_path):
    # from inside the second block, and later, there are estimates and a lost aircraft
    seen, info = list(run_frames(300, noisy_from=261, gone_from=270)), run_info()
    log = read_log(record(tmp_path / "run.mcap", seen, info))
    live, again = MetricsObserver(), MetricsObserver()
    live.begin(info)
    again.begin(log.info)
    for one, other in zip(seen, frames(log), strict=True):
        live.observe(one)
        again.observe(other)
    assert again.summary() == live.summary()


def test_a_log_gives_back_what_was_known_before_the_first_frame(tmp_path):
    info = run_info(directory=tmp_path)
    log = read_log(record(tmp_path / "run.mcap", run_frames(3), info))
    for field in type(info).__annotations__:
        if field not in ("directory", "leader_path_ned"):
            assert getattr(log.info, field) == getattr(info, field), field
    np.testing.assert_array_equal(log.info.leader_path_ned, info.leader_path_ned)
    assert log.metadata["seed"] == "7"
    assert log.metadata["version.jsbsim"] == "1.3.3"
    assert log.metrics == {"outcome": "flown", "wall_s": None}


def test_any_protobuf_reader_understands_the_log(tmp_path):
    some = [event(50, "a gust")]
    seen = list(run_frames(60, noisy_from=0, lossy_from=0, gone_from=31, events=some))
    info = run_info()
    messages = {}
    for topic, stamp, message in decoded(record(tmp_path / "run.mcap", seen, info)):
        messages.setdefault(topic, []).append((stamp, message))
    each = ("state", "estimate", "command", "formation", "believed", "network", "fix")
    expected = {f"/{name}/{part}" for name in info.names for part in each}
    expected -= {"/leader/formation", "/leader/believed", "/leader/network"}
    assert set(messages) == expected | {"/tf", "/tf_static", "/events"}
    assert len(messages["/uav2/state"]) == 60
    assert len(messages["/uav2/fix"]) == 12  # 5 Hz of 25

    k = 31
    stamp, state = messages["/uav2/state"][k]
    frame = seen[k]
    assert stamp == round(frame.time_s * 1e9)
    assert state.position_down_m == frame.truth.position_ned[2, 2]
    assert state.yaw_rate_radps == frame.truth.rates_body[2, 2]
    assert state.equivalent_airspeed_mps == frame.truth.equivalent_airspeed[2]
    assert state.wind_east_mps == frame.air.wind_ned[2, 1]
    assert state.throttle == frame.surfaces.throttle[2]
    assert messages["/uav2/estimate"][k][1].roll_rad == frame.estimate.euler[2, 0]
    assert messages["/leader/command"][k][1].pitch_rad == frame.command.pitch[0]
    said = [messages["/uav3/state"][row][1].lost for row in (30, 31)]
    assert said == [False, True]
    assert not state.lost
    believed = messages["/uav2/believed"][k][1]
    assert believed.believed_error_down_m == frame.formation.believed_ned[1, 2]
    formation = messages["/uav2/formation"][k][1]
    assert formation.error_east_m == frame.formation.error_ned[1, 1]
    assert formation.flight_path_angle_desired_rad == frame.formation.flight_path_angle_desired[1]
    assert formation.guard_bits == frame.formation.guards[1]
    assert formation.saturation_bits == frame.formation.saturations[1]
    np.testing.assert_array_equal(list(formation.age_s), frame.formation.age_s[1])

    network = messages["/uav3/network"][k][1]
    assert list(network.sent_count) == frame.links.sent[2].tolist()
    assert list(network.delivered_count) == frame.links.delivered[2].tolist()
    assert list(network.delivered_count) != list(network.sent_count)

    stamp, fix = messages["/uav1/fix"][2]
    frame = seen[10]
    assert (fix.timestamp.seconds, fix.timestamp.nanos) == (0, 400_000_000)
    place = geodetic_from_ned(frame.truth.position_ned[1], info.origin)
    np.testing.assert_array_equal([fix.latitude, fix.longitude, fix.altitude], place)
    assert fix.frame_id == "uav1"
    [(stamp, line)] = messages["/events"]
    assert (stamp, line.timestamp.seconds) == (2_000_000_000, 2)
    assert (line.level, line.message, line.name) == (3, "a gust", "uav1")


def test_transforms_turn_bodies_into_ned_and_ned_into_a_world_with_z_up(tmp_path):
    seen = list(run_frames(30))
    messages = {"/tf": [], "/tf_static": []}
    for topic, _, message in decoded(record(tmp_path / "run.mcap", seen)):
        messages.get(topic, []).append(message)

    def rotate(q, vector):
        u, w = np.array([q.x, q.y, q.z]), q.w
        return vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)

    transform = messages["/tf"][29].transforms[3]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("ned", "uav3")
    assert (transform.timestamp.seconds, transform.timestamp.nanos) == (1, 160_000_000)
    nose = rotate(transform.rotation, np.array([1.0, 0.0, 0.0]))
    truth = seen[29].truth
    # the quaternion takes another way than the matrix, a few roundings apart
    np.testing.assert_allclose(nose, rotation_ned_body(truth.euler[3])[:, 0], atol=1e-14)
    assert transform.translation.z == truth.position_ned[3, 2]

    [static] = messages["/tf_static"]
    north_east_down = [rotate(static.transforms[0].rotation, axis) for axis in np.eye(3)]
    east_north_up = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    np.testing.assert_allclose(north_east_down, east_north_up, atol=1e-15)


@pytest.mark.usefixtures("quick")
def test_an_estimate_is_written_only_where_it_differs(tmp_path):
    path = record(tmp_path / "run.mcap", run_frames(3 * CHUNK, noisy_from=2 * CHUNK + 20))
    topics = [topic for topic, _, _ in decoded(path)]
    assert topics.count("/uav1/state") == 3 * CHUNK
    # the chunk in which they began to differ
    assert topics.count("/uav1/estimate") == topics.count("/uav1/believed") == CHUNK


def test_what_is_believed_is_written_only_where_it_differs(tmp_path):
    # an airspeed that errs moves nobody
    seen = []
    for frame in run_frames(CHUNK):
        estimate = frame.truth._replace(airspeed=frame.truth.airspeed + 1.0)
        seen.append(frame._replace(estimate=estimate))
    path = record(tmp_path / "run.mcap", seen)
    topics = {topic for topic, _, _ in decoded(path)}
    assert "/uav1/estimate" in topics
    assert "/uav1/believed" not in topics
    log = read_log(path)
    assert log.formation.believed_ned is log.formation.error_ned
    for one, other in zip(seen, frames(log), strict=True):
        assert_same_frame(one, other)


def test_of_exact_estimates_the_log_says_that_they_are_the_truth(tmp_path):
    log = read_log(record(tmp_path / "run.mcap", run_frames(CHUNK + 5)))
    assert log.estimate is log.truth
    assert all(frame.estimate is frame.truth for frame in frames(log))


def test_an_estimate_that_is_not_a_number_is_kept(tmp_path):
    seen = []
    for frame in run_frames(20, noisy_from=0):
        airspeed = np.where([False, True, False, False], np.nan, frame.estimate.airspeed)
        believed = frame.formation.believed_ned * np.nan
        seen.append(
            frame._replace(
                estimate=frame.estimate._replace(airspeed=airspeed),
                formation=frame.formation._replace(believed_ned=believed),
            )
        )
    log = read_log(record(tmp_path / "run.mcap", seen))
    for one, other in zip(seen, frames(log), strict=True):
        assert_same_frame(one, other)


@pytest.mark.usefixtures("quick")
def test_the_radio_is_written_from_the_first_loss_on(tmp_path):
    seen = list(run_frames(3 * CHUNK, lossy_from=CHUNK + 20))
    path = record(tmp_path / "run.mcap", seen)
    topics = [topic for topic, _, _ in decoded(path)]
    assert topics.count("/uav1/network") == topics.count("/uav3/network") == 2 * CHUNK
    assert "/leader/network" not in topics
    for k, (ours, theirs) in enumerate(zip(seen, frames(read_log(path)), strict=True)):
        for before, after in zip(ours.links, theirs.links, strict=True):
            assert after.dtype == np.uint32
            assert np.array_equal(after, before if k >= CHUNK else np.zeros((3, 4)))


def test_a_radio_that_loses_nothing_is_not_written(tmp_path):
    path = record(tmp_path / "run.mcap", run_frames(CHUNK + 5))
    assert not [topic for topic, _, _ in decoded(path) if topic.endswith("/network")]
    assert not np.any(read_log(path).links)


@pytest.mark.usefixtures("quick")
def test_the_same_run_gives_the_same_bytes(tmp_path):
    (tmp_path / "other").mkdir()
    some = [event(9)]
    one = record(tmp_path / "a.mcap", run_frames(130, events=some), run_info(directory=tmp_path))
    again = {"outcome": "flown", "wall_s": 99.0}
    two = record(tmp_path / "other" / "b.mcap", run_frames(130, events=some), summary=again)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.usefixtures("quick")
def test_what_was_seen_may_be_overwritten(tmp_path):
    info = run_info()
    log, live = McapRecorder(tmp_path / "lent.mcap"), MetricsObserver()
    for observer in (log, live):
        assert observer.borrows
        observer.begin(info)
    for frame in run_frames(300, noisy_from=200):
        for observer in (log, live):
            observer.observe(frame)
        for name in RECORDS:
            for array in getattr(frame, name):
                array[...] = 0
    log.end({"outcome": "flown", "wall_s": 1.5}, ())
    kept = record(tmp_path / "kept.mcap", run_frames(300, noisy_from=200))
    assert (tmp_path / "lent.mcap").read_bytes() == kept.read_bytes()
    again = MetricsObserver()
    again.begin(info)
    for frame in run_frames(300, noisy_from=200):
        again.observe(frame)
    assert live.summary() == again.summary()


@pytest.mark.usefixtures("quick")
def test_the_index_finds_every_message(tmp_path):
    some = [event(k) for k in (0, 3, 3, CHUNK, CHUNK + 1)]
    seen = run_frames(CHUNK + 60, noisy_from=CHUNK, lossy_from=7, events=some)
    data = record(tmp_path / "run.mcap", seen).read_bytes()
    head = struct.Struct("<BQHIQQ")  # of a message: its kind, its length, channel, number and times
    found = {}
    for one in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(one, records.Chunk):
            chunk = zstandard.ZstdDecompressor().decompressobj().decompress(one.data)
            assert zlib.crc32(chunk) == one.uncompressed_crc
        elif isinstance(one, records.MessageIndex):
            for time_ns, place in one.records:
                kind, _, channel, number, *times = head.unpack_from(chunk, place)
                assert (kind, channel, times) == (5, one.channel_id, [time_ns, time_ns])
                found.setdefault(channel, []).append(number)
        elif isinstance(one, records.ChunkIndex):
            for channel, place in one.message_index_offsets.items():
                assert struct.unpack_from("<BQH", data, place)[::2] == (7, channel)
            assert data[one.chunk_start_offset] == 6
        elif isinstance(one, records.Statistics):
            statistics = one
    counts = {channel: len(numbers) for channel, numbers in found.items()}
    assert counts == statistics.channel_message_counts
    assert all(numbers == [*range(1, len(numbers) + 1)] for numbers in found.values())
    assert (statistics.message_count, statistics.chunk_count) == (sum(counts.values()), 2)


def test_a_slow_run_writes_the_same_messages_sooner(tmp_path, monkeypatch):
    fast = record(tmp_path / "fast.mcap", run_frames(70))
    monkeypatch.setattr(recorder, "FLUSH_S", -1.0)  # as if every frame came late
    slow = record(tmp_path / "slow.mcap", run_frames(70))
    assert slow.stat().st_size > fast.stat().st_size
    assert list(map(str, decoded(slow))) == list(map(str, decoded(fast)))


WRITER = """
import sys, time
from pathlib import Path
from given_time import GivenTime
from record_flight import run_frames, run_info
from testbed.record.recorder import McapRecorder

given = GivenTime(sys.argv[3]).__enter__()
log = McapRecorder(Path(sys.argv[1]))
log.begin(run_info())
pause = float(sys.argv[2])
seen = list(run_frames(50))
k = 0
while True:
    frame = seen[k % 50]._replace(tick=8 * k, time_s=k / 25)
    log.observe(frame)
    sys.stdout.write(f"{k} {given.now_s}\\n")
    sys.stdout.flush()
    k += 1
    if pause:
        time.sleep(pause)
"""


def at_s(line):
    return float(line.split()[1])


@pytest.mark.parametrize(("pause_s", "seed"), KILLED)
def test_a_killed_run_loses_less_than_half_a_second(tmp_path, pause_s, seed):
    """Of the time that the machine gives it; see `GivenTime`."""
    path, clock = tmp_path / "run.mcap", tmp_path / "clock"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path), str(pause_s), str(clock)],
        stdout=subprocess.PIPE,
        text=True,
        env=environment(80, Path(__file__).parent),
    ) as writer:
        lines = [writer.stdout.readline()]
        end = at_s(lines[0]) + 0.7 + 0.5 * np.random.default_rng(seed).random()
        while at_s(lines[-1]) < end:
            lines.append(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
        lines += writer.stdout.readlines()
    told = [line for line in lines if line.endswith("\n")]
    killed = last_s(clock)
    assert killed >= at_s(told[-1])
    due = max(int(line.split()[0]) for line in told if at_s(line) < killed - 0.5)
    log = read_log(path)
    assert not log.finished
    assert log.metrics is None
    assert log.tick[-1] // 8 >= due
    np.testing.assert_array_equal(log.tick, 8 * np.arange(log.tick.size))
    seen = list(run_frames(50))
    for k, frame in enumerate(frames(log)):
        np.testing.assert_array_equal(frame.truth.euler, seen[k % 50].truth.euler)
        if k == 120:
            break


def test_a_log_cut_anywhere_gives_what_is_whole(tmp_path):
    seen = list(run_frames(160))
    whole = record(tmp_path / "run.mcap", seen).read_bytes()
    counts = []
    for end in np.linspace(5000, len(whole), 40).astype(int):
        path = tmp_path / "cut.mcap"
        path.write_bytes(whole[:end])
        log = read_log(path)
        counts.append(log.tick.size)
        assert log.finished == (end == len(whole))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 160)


@pytest.mark.usefixtures("quick")
def test_a_full_disk_leaves_a_readable_log_and_says_so(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapRecorder(path)
    log.begin(run_info())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, limits[1]))
        with pytest.raises(LogError, match=r"run\.mcap: cannot write the log"):
            for frame in run_frames(2000):
                log.observe(frame)
        log.end({}, ())  # the runner ends every observer; this one is done
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    back = read_log(path)
    assert not back.finished
    assert back.lost_bytes == 0
    assert back.tick.size % CHUNK == 0
    assert back.tick.size > 0


def test_a_log_cut_before_its_first_frame_says_that_nothing_was_recorded(tmp_path):
    """Wherever that is: in its first bytes, in what is attached, in the first frames' chunk."""
    whole = record(tmp_path / "run.mcap", run_frames(3)).read_bytes()
    path = tmp_path / "cut.mcap"
    ends = [*range(60), *range(60, 20_000, 97)]
    told = 0
    for end in ends:
        path.write_bytes(whole[:end])
        try:
            log = read_log(path)
        except LogError as error:
            told += 1
            assert str(error) == f"{path}: was cut before its first frame: nothing was recorded"
        else:
            assert told > 60 and log.info.names == run_info().names
    assert told > 60


def frames_in(path):
    """How many have been written."""
    try:
        return read_log(path).tick.size
    except LogError:  # none yet
        return 0


def test_what_was_flown_is_written_though_no_frame_follows(tmp_path):
    """A run may wait for a program outside, for long, and be killed then."""
    path = tmp_path / "run.mcap"
    log = McapRecorder(path)
    log.begin(run_info())
    for frame in run_frames(10):
        log.observe(frame)
    until(lambda: frames_in(path) == 10)
    log.end({}, ())
    assert frames_in(path) == 10


class Waiting:
    """What the recorder's thread waits for, by a clock that goes on only then, to a moment."""

    def __init__(self, end):
        self.now, self.end = 0.0, end

    def monotonic(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds
        return self.now > self.end

    def set(self):
        """The log is closed."""


@pytest.mark.parametrize("flown_s", [0.0, 0.1, recorder.FLUSH_S - 0.01])
def test_what_was_flown_is_written_within_half_a_second(tmp_path, monkeypatch, flown_s):
    """Its thread looks in time; this one is in its place."""
    clock = Waiting(flown_s + 0.5)
    monkeypatch.setattr(recorder, "time", clock)
    log = McapRecorder(tmp_path / "run.mcap")
    with monkeypatch.context() as alone:
        alone.setattr(recorder.threading.Thread, "start", lambda thread: None)
        log.begin(run_info())
    log._over, clock.now = clock, flown_s
    for frame in run_frames(10):
        log.observe(frame)
    clock.now = 0.0  # the thread has waited since the beginning
    log._keep_up()
    until(lambda: frames_in(tmp_path / "run.mcap") == 10)  # as soon as it is compressed
    log.end({}, ())


@pytest.mark.parametrize("gone", ["removed", "moved", "replaced"])
def test_a_log_that_nobody_can_find_any_more_is_not_written_on(tmp_path, gone):
    folder = tmp_path / "run"
    folder.mkdir()
    log = McapRecorder(folder / "run.mcap")
    log.begin(run_info())
    if gone == "removed":
        shutil.rmtree(folder)
    else:
        folder.rename(tmp_path / "elsewhere")
    if gone == "replaced":
        folder.mkdir()
        (folder / "run.mcap").write_bytes(b"another")
    with pytest.raises(LogError, match=r"run\.mcap: the log is not there any more: .* moved"):
        for frame in run_frames(CHUNK - 1):  # too few for a chunk: it is the time that has it seen
            log.observe(frame)
            time.sleep(0.01)
    log.end({}, ())  # which has been said


def test_damage_is_told_from_a_cut(tmp_path):
    whole = record(tmp_path / "run.mcap", run_frames(160)).read_bytes()
    path = tmp_path / "bad.mcap"
    rng = np.random.default_rng(5)
    told = 0
    for at in rng.integers(0, len(whole), 60):
        damaged = bytearray(whole)
        damaged[at] ^= 0xFF
        path.write_bytes(damaged)
        try:
            read_log(path)
        except LogError as error:
            told += 1
            assert str(path) in str(error)
    # most of a file is chunks, which carry checksums; in indexes and padding damage is harmless
    assert told > 20


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a text", "not an MCAP file"),
        (b"\x89MCAP0\r\n" + b"\x0f" * 40, "not a log of a testbed run"),
    ],
)
def test_another_file_is_refused(tmp_path, data, message):
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    with pytest.raises(LogError, match=message):
        read_log(path)


def test_a_log_of_another_schema_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "LOG_SCHEMA", 99)
    path = record(tmp_path / "run.mcap", run_frames(3))
    with pytest.raises(LogError, match="log schema 99, but this version reads 3"):
        read_log(path)


def test_a_log_is_never_overwritten(tmp_path):
    path = record(tmp_path / "run.mcap", run_frames(3))
    before = path.read_bytes()
    with pytest.raises(LogError, match="there is a log already"):
        McapRecorder(path).begin(run_info())
    assert path.read_bytes() == before


def test_no_log_without_a_folder(tmp_path):
    with pytest.raises(LogError, match="cannot create the log"):
        McapRecorder(tmp_path / "missing" / "run.mcap").begin(run_info())


def test_the_attached_metrics_are_json(tmp_path):
    path = record(tmp_path / "run.mcap", run_frames(3), summary={"events": [], "a": None})
    with open(path, "rb") as file:
        attached = {a.name: a for a in mcap.reader.make_reader(file).iter_attachments()}
    assert json.loads(attached["metrics.json"].data) == {"events": [], "a": None}
    assert attached["scenario.resolved.yaml"].data == run_info().scenario_yaml.encode()


def test_a_frame_whose_arrays_are_not_as_agreed_is_refused(tmp_path):
    # rows are copied byte by byte, so that whole numbers would be read as others
    log = McapRecorder(tmp_path / "run.mcap")
    log.begin(run_info())
    [frame] = run_frames(1)
    command = frame.command._replace(roll=np.arange(4))
    with pytest.raises(TypeError, match=r"command\.roll: int64"):
        log.observe(frame._replace(command=command))
    log.close()


def test_a_frame_of_other_sizes_than_those_before_is_refused(tmp_path):
    log = McapRecorder(tmp_path / "run.mcap")
    log.begin(run_info())
    log.observe(*run_frames(1))
    with pytest.raises(ValueError, match="not as large as those of the first frame"):
        log.observe(*run_frames(1, followers=4))
    log.close()


@pytest.mark.parametrize("where", ["the chunk", "its data"])
def test_a_chunk_that_would_fill_the_memory_is_refused_unread(tmp_path, where):
    """A kilobyte of zstd may stand for gigabytes."""
    path = record(tmp_path / "run.mcap", run_frames(160))
    data = bytearray(path.read_bytes())
    head = struct.Struct("<BQ")
    at = len(b"\x89MCAP0\r\n")
    while data[at] != 6:  # a chunk
        at += head.size + head.unpack_from(data, at)[1]
    if where == "the chunk":
        struct.pack_into("<Q", data, at + head.size + 16, 1 << 40)
    else:
        packed = at + head.size + 8 + 8 + 8 + 4 + 4 + 4 + 8
        # zstd: magic, a descriptor that says 8 bytes of content size and no window follow
        data[packed + 4] = 0b11100000
        struct.pack_into("<Q", data, packed + 5, 1 << 40)
    path.write_bytes(data)
    with pytest.raises(LogError, match=rf"a chunk of {1 << 40:,} bytes at byte {at}: no run"):
        read_log(path)
