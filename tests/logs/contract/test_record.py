"""The recorder and the reader of logs: same bits for any reader, however the run ends."""

import io
import json
import os
import shutil
import struct
import time
import zlib

import mcap.data_stream
import mcap.reader
import numpy as np
import pytest
import zstandard
from cases import ALL
from full_disk import full_disk
from mcap import records
from mcap.stream_reader import StreamReader
from record_flight import RECORDS, assert_same_sample, decoded, event, record, run_info, run_samples
from waiting import TIMEOUT_S, until

import testbed
from testbed.core import samples as core_samples
from testbed.core.errors import InputError
from testbed.core.frames import rotation_ned_body
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import Event, logged_fields
from testbed.core.samples import block_samples
from testbed.core.start_time import start_unix_ns
from testbed.logs import header, recorder
from testbed.logs.mcap_file import LogError, tail_path
from testbed.logs.messages import RECORDS as RECORDS_OF_SAMPLE
from testbed.logs.messages import TOPICS
from testbed.logs.read import read_log, samples
from testbed.logs.recorder import McapRecorder
from testbed.metrics.observer import MetricsObserver
from testbed.scenario import load_scenario

CHUNK = block_samples(4)
SMALL = 40  # samples of `small_chunks`


@pytest.fixture
def small_chunks(monkeypatch):
    """Write only full chunks, also on a slow machine, and of few samples."""
    monkeypatch.setattr(recorder, "FLUSH_S", 3600.0)
    monkeypatch.setattr(core_samples, "_BLOCK_AIRCRAFT_SAMPLES", 4 * SMALL)


@pytest.mark.parametrize(
    ("count", "followers", "noisy_from", "lost_from"),
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
def test_log_read_back_has_every_sample(tmp_path, count, followers, noisy_from, lost_from):
    # CHUNK samples fill a chunk, so that the event after them has a chunk of its own
    some = [event(0), event(0, "é ∞"), event(3, level="error")]
    seen = list(
        run_samples(count, followers, noisy_from=noisy_from, lost_from=lost_from, events=some)
    )
    last = Event(seen[-1].time_s, "info", "run", "the end")
    info = run_info(followers)
    log = read_log(record(tmp_path / "run.mcap", seen, info, events=(last,)))
    back = list(samples(log))
    assert len(back) == count
    assert back[-1].events[-1] == last
    for one, other in zip(seen[:-1], back[:-1], strict=True):
        assert_same_sample(one, other)
    assert log.finished
    assert log.lost_bytes == 0


def test_every_logged_field_is_in_one_topic():
    declared = [
        f"{record}.{field}"
        for record, kind in RECORDS_OF_SAMPLE.items()
        if hasattr(kind, "_fields")
        for field in logged_fields(kind)
    ]
    columns = [column.source for topic in TOPICS for column in topic.columns]
    assert sorted(columns) == sorted([*declared, "lost"])
    assert len(declared) > 30


def test_metrics_from_log_equal_live_metrics(tmp_path):
    # estimates differ, and an aircraft is lost, inside the second block of the metrics
    seen, info = list(run_samples(300, noisy_from=261, lost_from=270)), run_info()
    log = read_log(record(tmp_path / "run.mcap", seen, info))
    live, again = MetricsObserver(), MetricsObserver()
    live.begin(info)
    again.begin(log.info)
    for one, other in zip(seen, samples(log), strict=True):
        live.observe(one)
        again.observe(other)
    assert again.summary() == live.summary()


def test_log_read_back_has_run_info(tmp_path):
    info = run_info(directory=tmp_path)
    log = read_log(record(tmp_path / "run.mcap", run_samples(3), info))
    for field in type(info).__annotations__:
        if field not in ("directory", "leader_path_ned", "make_yaml"):
            assert getattr(log.info, field) == getattr(info, field), field
    assert log.info.scenario_yaml == info.scenario_yaml
    np.testing.assert_array_equal(log.info.leader_path_ned, info.leader_path_ned)
    assert log.metadata["seed"] == "7"
    assert log.metadata["version.jsbsim"] == "1.3.3"
    assert log.metadata["base_rate_hz"] == str(info.base_rate_hz)
    assert log.metadata["integrator.rate_rotational"] == "Euler"
    assert log.metrics == {"outcome": "completed", "wall_s": None}


def test_log_decodes_with_its_own_schemas(tmp_path):
    some = [event(50, "a gust")]
    seen = list(run_samples(60, noisy_from=0, lossy_from=0, lost_from=31, events=some))
    info = run_info()
    messages = {}
    for topic, stamp, message in decoded(record(tmp_path / "run.mcap", seen, info)):
        messages.setdefault(topic, []).append((stamp, message))
    each = ("state", "estimate", "command", "formation", "estimated_error", "network", "fix")
    expected = {f"/{name}/{part}" for name in info.names for part in each}
    expected -= {"/leader/formation", "/leader/estimated_error", "/leader/network"}
    assert set(messages) == expected | {"/tf", "/tf_static", "/events"}
    assert len(messages["/uav2/state"]) == 60
    assert len(messages["/uav2/fix"]) == 12  # 5 Hz of 25

    k = 31
    stamp, state = messages["/uav2/state"][k]
    sample = seen[k]
    assert stamp == round(sample.time_s * 1e9)
    assert state.position_down_m == sample.truth.position_ned[2, 2]
    assert state.yaw_rate_radps == sample.truth.rates_body[2, 2]
    assert state.equivalent_airspeed_mps == sample.truth.equivalent_airspeed[2]
    assert state.wind_east_mps == sample.air.wind_ned[2, 1]
    assert state.throttle == sample.surfaces.throttle[2]
    assert messages["/uav2/estimate"][k][1].roll_rad == sample.estimate.euler[2, 0]
    assert messages["/leader/command"][k][1].pitch_rad == sample.command.pitch[0]
    assert [messages["/uav3/state"][row][1].lost for row in (30, 31)] == [False, True]
    assert not state.lost
    estimated = messages["/uav2/estimated_error"][k][1]
    assert estimated.estimated_error_down_m == sample.formation.estimated_error_ned[1, 2]
    formation = messages["/uav2/formation"][k][1]
    assert formation.error_east_m == sample.formation.error_ned[1, 1]
    assert formation.flight_path_angle_desired_rad == sample.formation.flight_path_angle_desired[1]
    assert formation.limiter_bits == sample.formation.limiter_flags[1]
    assert formation.saturation_bits == sample.formation.saturations[1]
    ages = [getattr(formation.age_s, name) for name in info.names]
    np.testing.assert_array_equal(ages, sample.formation.age_s[1])

    network = messages["/uav3/network"][k][1]
    sent, delivered = (
        [getattr(field, name) for name in info.names]
        for field in (network.sent_count, network.delivered_count)
    )
    assert sent == sample.links.sent[2].tolist()
    assert delivered == sample.links.delivered[2].tolist()
    assert delivered != sent

    stamp, fix = messages["/uav1/fix"][2]
    sample = seen[10]
    assert (fix.timestamp.seconds, fix.timestamp.nanos) == (0, 400_000_000)
    expected = geodetic_from_ned(sample.estimate.position_ned[1], info.origin)
    np.testing.assert_array_equal([fix.latitude, fix.longitude, fix.altitude], expected)
    assert fix.frame_id == "uav1"
    errors = [each.estimate.position_ned[1] - each.truth.position_ned[1] for each in seen[:11]]
    enu = np.array(errors) @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]).T
    covariance = np.array(fix.position_covariance).reshape(3, 3)
    np.testing.assert_allclose(covariance, enu.T @ enu / 11, rtol=1e-12)
    assert fix.position_covariance_type == 1  # approximated
    [(stamp, line)] = messages["/events"]
    assert (stamp, line.timestamp.seconds) == (2_000_000_000, 2)
    assert (line.level, line.message, line.name) == (3, "a gust", "uav1")


def test_covariance_of_exact_estimates_is_unknown(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(60, noisy_from=40))
    fixes = [each for topic, _, each in decoded(path) if topic == "/uav1/fix"]
    kinds = [fix.position_covariance_type for fix in fixes]
    assert kinds == [0] * 8 + [1] * 4
    assert [len(fix.position_covariance) for fix in fixes] == [0] * 8 + [9] * 4


def test_start_time_moves_all_times_and_no_number(tmp_path):
    seen = list(run_samples(60, noisy_from=0, lossy_from=0, events=[event(50, "a gust")]))
    start_ns = start_unix_ns("2026-05-01T11:30:00.25+02:00")
    assert start_ns == 1_777_627_800_250_000_000
    path = record(tmp_path / "run.mcap", seen, run_info(start_unix_ns=start_ns))
    late, messages = {}, list(decoded(path))
    assert messages == sorted(messages, key=lambda each: each[1])
    for topic, stamp, message in messages:
        late.setdefault(topic, []).append(stamp)
        stamps = [message] if hasattr(message, "timestamp") else getattr(message, "transforms", ())
        for each in stamps:
            assert each.timestamp.seconds * 10**9 + each.timestamp.nanos == stamp
    assert late["/tf"] == [start_ns + k * 40_000_000 for k in range(60)]
    assert late["/events"] == [start_ns + 2 * 10**9]
    log = testbed.load_run(path).log
    assert (log.time_s[-1], log.events[0].time_s) == (59 / 25, 2.0)
    for one, other in zip(seen, samples(log), strict=True):
        assert_same_sample(one, other)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("yesterday", "ISO 8601"),
        ("2026-05-01T09:30:00", "time zone"),
        ("1969-12-31T23:59:59Z", "1970 to 2037"),
        ("2038-01-01T00:00:00Z", "1970 to 2037"),
    ],
)
def test_other_start_times_are_refused(text, reason):
    with pytest.raises(ValueError, match=reason):
        start_unix_ns(text)
    with pytest.raises(InputError, match=f"log.start_time.*{reason}"):
        load_scenario("simulation-3", [f"log.start_time={text}"])


def test_fields_have_names_of_aircraft(tmp_path):
    """A name that is a field's name keeps it, also after another one that would become it."""
    names = ("lead-1", "a.b", "a_b", "7_x")
    seen = list(run_samples(3))
    path = record(tmp_path / "run.mcap", seen, run_info(names=names))
    formation = [each for topic, _, each in decoded(path) if topic == "/a_b/formation"][2].age_s
    ages = [getattr(formation, name) for name in ("lead_1", "a_b_2", "a_b", "aircraft_7_x")]
    np.testing.assert_array_equal(ages, seen[2].formation.age_s[1])


def test_transforms_rotate_body_to_ned_and_ned_to_enu(tmp_path):
    seen = list(run_samples(30))
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
    # computed by a quaternion and by a matrix: equal up to rounding
    np.testing.assert_allclose(nose, rotation_ned_body(truth.euler[3])[:, 0], atol=1e-14)
    assert transform.translation.z == truth.position_ned[3, 2]

    [static] = messages["/tf_static"]
    north_east_down = [rotate(static.transforms[0].rotation, axis) for axis in np.eye(3)]
    east_north_up = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
    np.testing.assert_allclose(north_east_down, east_north_up, atol=1e-15)


@pytest.mark.usefixtures("small_chunks")
def test_estimate_written_only_in_chunks_that_differ(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(3 * SMALL, noisy_from=2 * SMALL + 20))
    topics = [topic for topic, _, _ in decoded(path)]
    assert topics.count("/uav1/state") == 3 * SMALL
    # the chunk in which the estimates begin to differ
    assert topics.count("/uav1/estimate") == topics.count("/uav1/estimated_error") == SMALL


def test_estimated_error_written_only_if_different(tmp_path):
    # an airspeed error changes no position
    seen = []
    for sample in run_samples(SMALL):
        estimate = sample.truth._replace(airspeed=sample.truth.airspeed + 1.0)
        seen.append(sample._replace(estimate=estimate))
    path = record(tmp_path / "run.mcap", seen)
    topics = {topic for topic, _, _ in decoded(path)}
    assert "/uav1/estimate" in topics
    assert "/uav1/estimated_error" not in topics
    log = read_log(path)
    assert log.formation.estimated_error_ned is log.formation.error_ned
    for one, other in zip(seen, samples(log), strict=True):
        assert_same_sample(one, other)


def test_exact_estimates_read_back_as_truth(tmp_path):
    log = read_log(record(tmp_path / "run.mcap", run_samples(CHUNK + 5)))
    assert log.estimate is log.truth
    assert all(sample.estimate is sample.truth for sample in samples(log))


def test_nan_estimates_read_back(tmp_path):
    seen = []
    for sample in run_samples(20, noisy_from=0):
        airspeed = np.where([False, True, False, False], np.nan, sample.estimate.airspeed)
        error = sample.formation.estimated_error_ned * np.nan
        seen.append(
            sample._replace(
                estimate=sample.estimate._replace(airspeed=airspeed),
                formation=sample.formation._replace(estimated_error_ned=error),
            )
        )
    log = read_log(record(tmp_path / "run.mcap", seen))
    for one, other in zip(seen, samples(log), strict=True):
        assert_same_sample(one, other)


@pytest.mark.usefixtures("small_chunks")
def test_network_written_from_first_loss_on(tmp_path):
    seen = list(run_samples(3 * SMALL, lossy_from=SMALL + 20))
    path = record(tmp_path / "run.mcap", seen)
    topics = [topic for topic, _, _ in decoded(path)]
    assert topics.count("/uav1/network") == topics.count("/uav3/network") == 2 * SMALL
    assert "/leader/network" not in topics
    for k, (ours, theirs) in enumerate(zip(seen, samples(read_log(path)), strict=True)):
        for before, after in zip(ours.links, theirs.links, strict=True):
            assert after.dtype == np.uint32
            assert np.array_equal(after, before if k >= SMALL else np.zeros((3, 4)))


def test_network_without_loss_not_written(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(CHUNK + 5))
    assert not [topic for topic, _, _ in decoded(path) if topic.endswith("/network")]
    assert not np.any(read_log(path).links)


@pytest.mark.usefixtures("small_chunks")
def test_same_run_gives_same_bytes(tmp_path):
    (tmp_path / "other").mkdir()
    some = [event(9)]
    one = record(tmp_path / "a.mcap", run_samples(130, events=some), run_info(directory=tmp_path))
    again = {"outcome": "completed", "wall_s": 99.0}
    two = record(tmp_path / "other" / "b.mcap", run_samples(130, events=some), summary=again)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.usefixtures("small_chunks")
def test_overwritten_samples_do_not_change_log(tmp_path):
    info = run_info()
    log, live = McapRecorder(tmp_path / "lent.mcap"), MetricsObserver()
    for observer in (log, live):
        assert observer.zero_copy
        observer.begin(info)
    for sample in run_samples(100, noisy_from=70):
        for observer in (log, live):
            observer.observe(sample)
        for name in RECORDS:
            for array in getattr(sample, name):
                array[...] = 0
    log.end({"outcome": "completed", "wall_s": 1.5}, ())
    kept = record(tmp_path / "kept.mcap", run_samples(100, noisy_from=70))
    assert (tmp_path / "lent.mcap").read_bytes() == kept.read_bytes()
    again = MetricsObserver()
    again.begin(info)
    for sample in run_samples(100, noisy_from=70):
        again.observe(sample)
    assert live.summary() == again.summary()


@pytest.mark.usefixtures("small_chunks")
def test_message_index_finds_every_message(tmp_path):
    some = [event(k) for k in (0, 3, 3, SMALL, SMALL + 1)]
    seen = run_samples(SMALL + 30, noisy_from=SMALL, lossy_from=7, events=some)
    data = record(tmp_path / "run.mcap", seen).read_bytes()
    head = struct.Struct("<BQHIQQ")  # of a message: opcode, length, channel, sequence, times
    found = {}
    for one in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(one, records.Chunk):
            chunk = zstandard.ZstdDecompressor().decompressobj().decompress(one.data)
            assert zlib.crc32(chunk) == one.uncompressed_crc
        elif isinstance(one, records.MessageIndex):
            for time_ns, offset in one.records:
                opcode, _, channel, number, *times = head.unpack_from(chunk, offset)
                assert (opcode, channel, times) == (5, one.channel_id, [time_ns, time_ns])
                found.setdefault(channel, []).append(number)
        elif isinstance(one, records.ChunkIndex):
            for channel, offset in one.message_index_offsets.items():
                assert struct.unpack_from("<BQH", data, offset)[::2] == (7, channel)
            assert data[one.chunk_start_offset] == 6
        elif isinstance(one, records.Statistics):
            statistics = one
    counts = {channel: len(numbers) for channel, numbers in found.items()}
    assert counts == statistics.channel_message_counts
    assert all(numbers == [*range(1, len(numbers) + 1)] for numbers in found.values())
    assert (statistics.message_count, statistics.chunk_count) == (sum(counts.values()), 2)


@pytest.mark.parametrize("late_s", [-1.0, 0.003])
def test_slow_clock_gives_the_same_bytes(tmp_path, monkeypatch, late_s):
    """Also where a topic begins within a chunk; the tail has what the log lacks, to the bit."""
    monkeypatch.setattr(core_samples, "_BLOCK_AIRCRAFT_SAMPLES", 4 * 20)
    changes = {"noisy_from": 27, "lossy_from": 45, "events": [event(1), event(48)]}
    fast = record(tmp_path / "fast.mcap", run_samples(52, **changes))
    monkeypatch.setattr(recorder, "FLUSH_S", late_s)  # every sample is late, or most are
    slow = McapRecorder(tmp_path / "slow.mcap")
    slow.begin(run_info())
    for number, sample in enumerate(run_samples(52, **changes), 1):
        slow.observe(sample)
        if late_s > 0.0:
            time.sleep(0.001)
        elif number % 17 == 0:
            assert_same_samples(slow.path, fast, number)
    slow.end({"outcome": "completed", "wall_s": 1.5}, ())
    assert slow.path.read_bytes() == fast.read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["fast.mcap", "slow.mcap"]


def assert_same_samples(cut, whole, count):
    """Compare a log of a run in flight with the beginning of a finished one."""
    pairs = [*zip(samples(read_log(cut)), samples(read_log(whole)), strict=False)]
    assert len(pairs) == count and not read_log(cut).finished
    for pair in pairs:
        assert_same_sample(*pair)


@pytest.fixture(scope="module")
def two_tails(tmp_path_factory):
    """Two logs that are written, of 25 samples in chunks of 20, each with its tail: bytes."""
    folder, found = tmp_path_factory.mktemp("tails"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_samples, "_BLOCK_AIRCRAFT_SAMPLES", 4 * 20)
        for name in "ab":
            patch.setattr(recorder, "FLUSH_S", 3600.0)
            log = McapRecorder(folder / f"{name}.mcap")
            log.begin(run_info(make_yaml=lambda: f"scenario: {{name: {name}}}\n"))  # noqa: B023
            for number, sample in enumerate(run_samples(25), 1):
                if number == 25:  # which writes the tail, with all samples since the chunk
                    patch.setattr(recorder, "FLUSH_S", -1.0)
                log.observe(sample)
            found.append((log.path.read_bytes(), tail_path(log.path).read_bytes()))
            log.close()
    return found


@pytest.mark.parametrize(
    ("change", "count"),
    [
        ("none", 25),
        ("record begun", 25),
        ("log cut", 20),
        ("other log", 20),
        ("cut", 20),
        ("end cut", 20),
        ("damaged", 20),
        ("missing", 20),
    ],
)
def test_tail_of_another_log_is_not_read(tmp_path, two_tails, change, count):
    """Nor one that is missing, cut or damaged: the log has its complete chunks.

    The other log has the same size and the same samples, but another scenario.
    """
    (log, data), (other_log, other) = two_tails
    path = tmp_path / "a.mcap"
    path.write_bytes(log)
    tail = tail_path(path)
    tail.write_bytes(data)
    if change == "record begun":
        path.write_bytes(log + struct.pack("<BQ", 7, 100))  # the head of an index
    elif change == "log cut":
        path.write_bytes(log[:-1])
    elif change == "other log":
        assert len(other_log) == len(log)
        tail.write_bytes(other)
    elif change in ("cut", "end cut"):
        tail.write_bytes(data[: len(data) // 2] if change == "cut" else data[:-1])
    elif change == "damaged":
        tail.write_bytes(data[:400] + bytes([data[400] ^ 255]) + data[401:])
    elif change == "missing":
        tail.unlink()
    assert read_log(path).tick.size == count


def test_cut_log_gives_complete_chunks(tmp_path):
    seen = list(run_samples(160))
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


@pytest.mark.usefixtures("small_chunks")
def test_full_disk_raises_and_leaves_readable_log(tmp_path):
    path = tmp_path / "run.mcap"
    log = McapRecorder(path)
    log.begin(run_info())
    with full_disk(200_000):
        with pytest.raises(LogError, match=r"run\.mcap: cannot write the log"):
            for sample in run_samples(2000):
                log.observe(sample)
        log.end({}, ())  # the run ends every observer, also one that has failed
    back = read_log(path)
    assert not back.finished
    assert back.lost_bytes == 0
    assert back.tick.size % SMALL == 0
    assert back.tick.size > 0


def test_log_cut_before_first_sample_raises(tmp_path):
    """Cut in the file's head, in an attachment, or in the first chunk."""
    whole = record(tmp_path / "run.mcap", run_samples(3)).read_bytes()
    path = tmp_path / "cut.mcap"
    ends = [*range(60), *range(60, 20_000, 97 if ALL else 389)]
    refused = 0
    for end in ends:
        path.write_bytes(whole[:end])
        try:
            log = read_log(path)
        except LogError as error:
            refused += 1
            assert str(error) == f"{path}: was cut before its first sample: nothing was recorded"
        else:
            assert refused > 60 and log.info.names == run_info().names
    assert refused > 60


def samples_in(path):
    """Count the samples written so far."""
    try:
        return read_log(path).tick.size
    except LogError:  # none yet
        return 0


def test_samples_written_while_run_waits(tmp_path):
    """The run may wait for an external program, and be killed meanwhile."""
    path = tmp_path / "run.mcap"
    log = McapRecorder(path)
    log.begin(run_info())
    for sample in run_samples(10):
        log.observe(sample)
    until(lambda: samples_in(path) == 10)
    log.end({}, ())
    assert samples_in(path) == 10


class FakeClock:
    """Stand in for `time` and for the event the flushing thread waits for, until a moment."""

    def __init__(self, end):
        self.now, self.end = 0.0, end

    def monotonic(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds
        return self.now > self.end

    def set(self):
        """Do nothing: the log is closed."""


@pytest.mark.parametrize("last_s", [0.0, 0.1, recorder.FLUSH_S - 0.01])
def test_samples_written_within_half_a_second(tmp_path, monkeypatch, last_s):
    """The flushing thread, run here, writes in time after the last sample at `last_s`."""
    clock = FakeClock(last_s + 0.5)
    monkeypatch.setattr(recorder, "time", clock)
    log = McapRecorder(tmp_path / "run.mcap")
    with monkeypatch.context() as patch:
        patch.setattr(recorder.threading.Thread, "start", lambda thread: None)
        log.begin(run_info())
    log._closed, clock.now = clock, last_s
    for sample in run_samples(10):
        log.observe(sample)
    clock.now = 0.0  # the thread has waited since the beginning
    log._flush_loop()
    until(lambda: samples_in(tmp_path / "run.mcap") == 10)  # as soon as it is compressed
    log.end({}, ())


@pytest.mark.parametrize("change", ["removed", "moved", "replaced"])
def test_removed_log_raises(tmp_path, change):
    folder = tmp_path / "run"
    folder.mkdir()
    log = McapRecorder(folder / "run.mcap")
    log.begin(run_info())
    if change == "removed":
        shutil.rmtree(folder)
    else:
        folder.rename(tmp_path / "elsewhere")
    if change == "replaced":
        folder.mkdir()
        (folder / "run.mcap").write_bytes(b"another")
    with pytest.raises(LogError, match=r"run\.mcap: the log is not there any more: .* moved"):
        for sample in run_samples(CHUNK - 1):  # too few for a chunk: noticed after FLUSH_S
            log.observe(sample)
            time.sleep(0.01)
    log.end({}, ())  # the error was raised once


def test_damaged_log_raises(tmp_path):
    whole = record(tmp_path / "run.mcap", run_samples(160)).read_bytes()
    path = tmp_path / "bad.mcap"
    rng = np.random.default_rng(5)
    refused = 0
    count = 60 if ALL else 30
    for at in rng.integers(0, len(whole), count):
        damaged = bytearray(whole)
        damaged[at] ^= 0xFF
        path.write_bytes(damaged)
        try:
            read_log(path)
        except LogError as error:
            refused += 1
            assert str(path) in str(error)
    # most of a file is chunks, which have checksums; damage in an index is harmless
    assert refused > count / 3


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a text", "not an MCAP file"),
        (b"\x89MCAP0\r\n" + b"\x0f" * 40, "not a log of a testbed run"),
    ],
)
def test_foreign_file_raises(tmp_path, data, message):
    path = tmp_path / "other.mcap"
    path.write_bytes(data)
    with pytest.raises(LogError, match=message):
        read_log(path)


def test_log_of_another_schema_raises(tmp_path, monkeypatch):
    monkeypatch.setattr(header, "LOG_SCHEMA", 99)
    path = record(tmp_path / "run.mcap", run_samples(3))
    with pytest.raises(LogError, match=r"log schema 99 of testbed 0\.0; .* schema 6 only"):
        read_log(path)


def test_existing_log_is_not_overwritten(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(3))
    before = path.read_bytes()
    with pytest.raises(LogError, match="there is a log already"):
        McapRecorder(path).begin(run_info())
    assert path.read_bytes() == before


def test_log_in_missing_folder_raises(tmp_path):
    with pytest.raises(LogError, match="cannot create the log"):
        McapRecorder(tmp_path / "missing" / "run.mcap").begin(run_info())


def test_metrics_and_scenario_are_attached(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(3), summary={"events": [], "a": None})
    with open(path, "rb") as file:
        attached = {a.name: a for a in mcap.reader.make_reader(file).iter_attachments()}
    assert json.loads(attached["metrics.json"].data) == {"events": [], "a": None}
    assert attached["scenario.resolved.yaml"].data == run_info().scenario_yaml.encode()


@pytest.mark.parametrize(
    ("record", "field", "array", "found"),
    [
        ("command", "roll", np.arange(4), r"int64 \(4,\), not float64 \(4,\)"),
        ("truth", "airspeed", np.ones((4, 1)), r"float64 \(4, 1\), not float64 \(4,\)"),
        ("formation", "slot_ned", np.ones(3), r"float64 \(3,\), not float64 \(3, 3\)"),
        ("formation", "age_s", np.ones(4), r"float64 \(4,\), not float64 \(3, 4\)"),
        ("formation", "slot_index", np.ones(3), r"float64 \(3,\), not uint32 \(3,\)"),
        ("links", "sent", np.ones((3, 4)), r"float64 \(3, 4\), not uint32 \(3, 4\)"),
    ],
)
def test_sample_of_wrong_type_or_shape_raises(tmp_path, record, field, array, found):
    log = McapRecorder(tmp_path / "run.mcap")
    log.begin(run_info())
    [sample] = run_samples(1)
    wrong = getattr(sample, record)._replace(**{field: array})
    with pytest.raises(ValueError, match=rf"{record}\.{field} of the sample is {found}"):
        log.observe(sample._replace(**{record: wrong}))
    log.close()


def test_sample_of_other_size_raises(tmp_path):
    log = McapRecorder(tmp_path / "run.mcap")
    log.begin(run_info())
    log.observe(*run_samples(1))
    with pytest.raises(ValueError, match="the sample has 5 aircraft, the run has 4"):
        log.observe(*run_samples(1, followers=4))
    log.close()


@pytest.mark.parametrize("where", ["the chunk", "its data"])
def test_chunk_too_large_for_memory_raises(tmp_path, where):
    """A kilobyte of zstd may decompress to gigabytes."""
    path = record(tmp_path / "run.mcap", run_samples(160))
    data = bytearray(path.read_bytes())
    head = struct.Struct("<BQ")
    at = len(b"\x89MCAP0\r\n")
    while data[at] != 6:  # a chunk
        at += head.size + head.unpack_from(data, at)[1]
    if where == "the chunk":
        struct.pack_into("<Q", data, at + head.size + 16, 1 << 40)
    else:
        packed = at + head.size + 8 + 8 + 8 + 4 + 4 + 4 + 8
        # zstd: magic, a descriptor of 8 bytes of content size and no window follow
        data[packed + 4] = 0b11100000
        struct.pack_into("<Q", data, packed + 5, 1 << 40)
    path.write_bytes(data)
    with pytest.raises(LogError, match=rf"chunk at byte {at} would be {1 << 40:,} bytes"):
        read_log(path)


def mcap_of_chunks(path, content, count):
    """Write a file of equal chunks, each with this content uncompressed."""
    packed = zstandard.ZstdCompressor().compress(content)
    head = struct.pack(
        "<QQQII4sQ", 0, 0, len(content), zlib.crc32(content), 4, b"zstd", len(packed)
    )
    channel = records.Channel(1, "/uav1/state", "protobuf", {}, 0)
    builder = mcap.data_stream.RecordBuilder()
    channel.write(builder)
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n" + bytes(builder.end()))
        for _ in range(count):
            file.write(struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed)


@pytest.mark.parametrize("more", [0, 1])
def test_size_uncompressed_has_a_limit(tmp_path, more):
    """All records: 268 MB and 20 times the file; the limit itself is allowed."""
    path = tmp_path / "bomb.mcap"
    mcap_of_chunks(path, b"", 9)
    data, head, at = bytearray(path.read_bytes()), struct.Struct("<BQ"), len(b"\x89MCAP0\r\n")
    rest = (1 << 28) + 20 * len(data) + more
    while at < len(data):
        opcode, length = head.unpack_from(data, at)
        size = length
        if opcode == 6:  # a chunk
            size = min(rest, 1 << 25)
            struct.pack_into("<Q", data, at + head.size + 16, size)
        rest, at = rest - size, at + head.size + length
    assert rest == 0
    path.write_bytes(data)
    message = "at most 268,.* are allowed in a file of" if more else "damaged after byte"
    with pytest.raises(LogError, match=message):
        read_log(path)


def test_many_chunks_too_large_together_raise(tmp_path):
    """Each of 10 kB and allowed; together they are 512 MB, of no 80 kB log."""
    path = tmp_path / "bomb.mcap"
    mcap_of_chunks(path, bytes(1 << 26), 8)
    assert path.stat().st_size < 100_000
    with pytest.raises(LogError, match=r"bomb.mcap: the chunks up to byte .* bytes uncompressed"):
        read_log(path)


def test_millions_of_empty_messages_raise(tmp_path):
    """In less than 1 MB: more than any log of that size has."""
    message = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)
    path = tmp_path / "bomb.mcap"
    mcap_of_chunks(path, message * 300_000, 8)
    began = time.monotonic()
    with pytest.raises(LogError, match=r"bomb.mcap: more messages than any log of [\d,]+ bytes"):
        read_log(path)
    assert time.monotonic() - began < TIMEOUT_S


def test_sparse_log_is_damaged_not_endless(tmp_path):
    path = record(tmp_path / "run.mcap", run_samples(160))
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)
        file.truncate(1 << 30)
    with pytest.raises(LogError, match=r"run.mcap: damaged after byte \d+"):
        read_log(path)
