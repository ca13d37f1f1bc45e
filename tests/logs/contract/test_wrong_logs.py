"""Logs that are well-formed but wrong: one error that names the file and the field."""

import io
import json

import mcap.data_stream
import mcap.records
import numpy as np
import pytest
from commands import call_command
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from mutations import ATTACHMENT, MAGIC, content_of, joined, split_records
from record_flight import event, record, run_info, run_samples

from testbed.core.errors import InputError
from testbed.golden.compare_runs import compare_runs
from testbed.logs import mcap_file
from testbed.logs.mcap_file import LogError
from testbed.logs.read import read_log
from testbed.metrics.observer import MetricsObserver
from testbed.reports import figures, read_run, run_page
from testbed.runs.recover import recover

DEEP = "[" * 200_000


def write_log(path, info=None, metrics=None):
    """Write a good log, then change fields of its run.json and metrics.json."""
    samples = list(run_samples(12))
    meter = MetricsObserver()
    meter.begin(run_info())
    for sample in samples:
        meter.observe(sample)
    record(path, samples, summary=meter.summary([event(0.1)[1]]) | {"outcome": "completed"})
    data = path.read_bytes()
    found = split_records(data[: -len(MAGIC)], len(MAGIC))
    for each in found:
        if each[0] == ATTACHMENT:
            each[1] = changed(each[1], {"run.json": info, "metrics.json": metrics})
    path.write_bytes(MAGIC + joined(found) + MAGIC)
    return path


def changed(content, changes):
    made = mcap.records.Attachment.read(mcap.data_stream.ReadDataStream(io.BytesIO(content)))
    change = changes.get(made.name)
    if isinstance(change, str):
        made.data = change.encode()
    elif change is not None:
        values = json.loads(made.data)
        change(values)
        made.data = json.dumps(values).encode()
    return content_of(made)


def test_good_log_is_reported_and_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "MAKERS", ())  # all of them take seconds
    path = write_log(tmp_path / "run.mcap")
    assert "completed" in run_page(read_run(path)).head
    assert compare_runs(read_log(path), read_log(path)).same
    assert not recover(path).was_cut


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (DEEP, "is nested deeper than 40 levels"),
        ("[]", "is not a map"),
        ("{", "Expecting"),
        ({"names": []}, "names: is empty or has repeated names"),
        ({"names": ["a", "a", "b", "c"]}, "names: is empty or has repeated names"),
        ({"names": "lead"}, "names: is text, not a list"),
        ({"names": [1, 2, 3, 4]}, r"names\[0\]: is a number, not text"),
        ({"aircraft": ["rascal"]}, "aircraft: has 1 elements, not 4"),
        ({"scenario_name": None}, "scenario_name: is null, not text"),
        ({"base_rate_hz": "x"}, "base_rate_hz: is text, not a whole number"),
        ({"base_rate_hz": 0}, "base_rate_hz: is below 1"),
        ({"sample_rate_hz": True}, "sample_rate_hz: is true or false, not a whole number"),
        ({"duration_s": float("nan")}, "duration_s: is nan, not a finite number"),
        ({"seed": 10**40}, "seed: is above 9223372036854775808"),
        ({"origin": [1, 2, 3]}, "origin: is a list, not a map"),
        ({"windows": {"laps": [1]}}, "windows.laps: has 1 elements, not 2"),
        ({"versions": {"numpy": 2}}, "versions.numpy: is a number, not text"),
        ({"leader_path_ned": [[1, 2]]}, r"leader_path_ned\[0\]: has 2 elements, not 3"),
        ({"barriers": [[1]]}, r"barriers\[0\]: has 1 elements, not 2"),
        ({"unheard": 1}, "unheard: is an unknown field"),
    ],
)
def test_wrong_header_of_a_log_is_named(tmp_path, change, message):
    made = change if isinstance(change, str) else lambda values: values.update(change)
    path = write_log(tmp_path / "run.mcap", info=made)
    with pytest.raises(LogError, match=rf"run\.mcap: run\.json: {message}"):
        read_log(path)


@pytest.mark.parametrize("field", ["barrier_samples", "integrators"])
def test_header_without_a_field_is_refused(tmp_path, field):
    path = write_log(tmp_path / "run.mcap", info=lambda values: values.pop(field))
    with pytest.raises(LogError, match=rf"run\.json: {field}: is missing"):
        read_log(path)


@pytest.mark.parametrize("text", ["[1, 2]", "null", "5", DEEP, "{"])
def test_metrics_that_are_no_map_are_refused(tmp_path, text):
    path = write_log(tmp_path / "run.mcap", metrics=text)
    with pytest.raises(LogError, match=r"run\.mcap: metrics\.json: "):
        read_log(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(schema=1), "schema: is 1; this version reads 2"),
        (lambda m: m.pop("schema"), "schema: is missing"),
        (lambda m: m.update(schema="2"), "schema: is text, not a whole number"),
        (lambda m: m.update(seed=-1), "seed: is below 0"),
        (lambda m: m["versions"].update(numpy=2), "versions.numpy: is a number, not text"),
        (lambda m: m["windows"].clear(), "windows.*: is missing"),
        (lambda m: m["wind"]["uav1"].update(mean_ned_mps=[1]), "has 1 elements, not 3"),
        (lambda m: m["saturations"]["uav1"]["by_kind"].clear(), "by_kind.pitch: is missing"),
        (lambda m: m.pop("windows"), "windows: is missing"),
        (lambda m: m.update(windows=[]), "windows: is a list, not a map"),
        (lambda m: m.update(outcome="flown"), "outcome: is none of completed"),
        (lambda m: m.update(events=[5]), r"events\[0\]: is a number, not a map"),
        (lambda m: m["joined_at_s"].update(x=1), "joined_at_s: its keys are not those of the run"),
        (lambda m: m.update(joined_at_s={}), "joined_at_s.*: is missing"),
        (lambda m: m.update(simulated_s="1"), "simulated_s: is text, not a number"),
        (lambda m: m.update(network={}), "network.links: is missing"),
        (lambda m: m.update(min_separation_between=["x", "y"]), "are not two aircraft of the run"),
        (lambda m: m.update(min_separation_between=["x"]), "are not two aircraft of the run"),
        (lambda m: m.update(min_separation_at_s=None), "its values contradict each other"),
        (lambda m: m.update(pace={"achieved": "x"}), "pace.requested: is missing"),
        (lambda m: m.update(commanded=[1]), "commanded: is a list, not a map"),
    ],
)
def test_wrong_metrics_of_a_log_are_named(tmp_path, change, message):
    path = write_log(tmp_path / "run.mcap", metrics=change)
    for use in (read_run, recover, lambda path: compare_runs(read_log(path), read_log(path))):
        with pytest.raises(InputError, match=rf"metrics\.json: .*{message}"):
            use(path)


def test_report_of_a_wrong_log_exits_with_2(tmp_path):
    write_log(tmp_path / "run.mcap", metrics=lambda m: m.update(windows=5))
    done = call_command("report", "run.mcap", cwd=tmp_path, code=2, columns=200)
    assert done.stderr.count("\n") == 1
    assert "run.mcap: metrics.json: windows: is a number, not a map" in done.stderr


def test_messages_after_the_last_state_are_left_out(tmp_path, monkeypatch):
    """As of a file from which another program took messages of one topic."""
    path = write_log(tmp_path / "run.mcap")
    whole, read = read_log(path), mcap_file.read

    def without_last_states(path):
        contents = read(path)
        states = contents.messages["/leader/state"]
        del states.time_ns[-2:], states.data[-2:]
        return contents

    monkeypatch.setattr(mcap_file, "read", without_last_states)
    log = read_log(path)
    assert log.tick.tolist() == whole.tick[:-2].tolist()
    for own, other in zip(log.formation, whole.formation, strict=True):
        np.testing.assert_array_equal(own, other[:-2])


@pytest.mark.parametrize("bytes_more", (0, 1))
def test_record_longer_than_its_chunk_is_refused(tmp_path, bytes_more):
    """In a chunk without compression and checksum; one of its length is read."""
    path = write_log(tmp_path / "run.mcap")
    found = split_records(path.read_bytes()[: -len(MAGIC)], len(MAGIC))
    each = next(each for each in found if each[0] == Opcode.CHUNK)
    made = mcap.records.Chunk.read(mcap.data_stream.ReadDataStream(io.BytesIO(each[1])))
    stream, size = get_chunk_data_stream(made)
    unknown = bytes([0xFF]) + (8 + bytes_more).to_bytes(8, "little") + bytes(8)
    made.data, made.compression, made.uncompressed_crc = stream.read(size) + unknown, "", 0
    made.uncompressed_size = len(made.data)
    each[1] = content_of(made)
    path.write_bytes(MAGIC + joined(found) + MAGIC)
    if bytes_more:
        with pytest.raises(LogError, match="damaged after byte"):
            mcap_file.read(path)
    else:
        assert mcap_file.read(path).messages


def test_many_aircraft_of_few_messages_are_refused(tmp_path):
    """Names in the header alone would be arrays of 20,004² numbers."""

    def grow(values):
        n = 20_000
        names = [f"u{k}" for k in range(n)]
        values |= {"names": [*values["names"], *names]}
        for key in ("aircraft", "wingspan_m", "speed_bounds_mps", "kappa_mps", "roll_limit_rad"):
            values[key] = [*values[key], *[values[key][-1]] * n]
        if values["barriers"]:
            values["barriers"] += [values["barriers"][-1]] * n

    path = write_log(tmp_path / "run.mcap", info=grow)
    with pytest.raises(LogError, match="samples of 20,004 aircraft have .* too many"):
        read_log(path)
