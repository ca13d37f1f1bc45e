"""A run in other forms: every number of the log is there, under its name, for readers of theirs."""

import csv
import io
import json
import math
import re
import subprocess
import sys

import numpy as np
import pandas
import pytest
from commands import call_command
from pyarrow import parquet
from record_flight import RECORDS, decoded, event, record, run_frames, run_info

import testbed
from testbed.record import arrow_door
from testbed.record.door import LogError
from testbed.record.export import write_npz
from testbed.record.flight import QUANTITIES, UNITS
from testbed.record.messages import TOPICS
from testbed.state import VehicleState, listed

FRAMES = 60
# what is no length, speed, angle, …: shares, coefficients, counts, bits, and yes or no
PLAIN = {"aileron", "elevator", "rudder", "throttle", "lost", "place"}
PLAIN_ENDS = ("_coefficient", "_of_charge", "_bits", "_count")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A log in which estimates err and messages are lost from frame 20 on, and one is lost."""
    seen = run_frames(
        FRAMES, noisy_from=20, lossy_from=20, gone_from=40, events=[event(30, "a gust")]
    )
    folder = tmp_path_factory.mktemp("run")
    return record(folder / "run.mcap", seen, summary={"outcome": "flown"})


@pytest.fixture(scope="module")
def flight(path):
    return testbed.load(path)


@pytest.fixture(scope="module")
def table(flight):
    file = io.BytesIO()
    arrow_door.write_parquet(flight, file)
    return parquet.read_table(file)


def said(path):
    """What any protobuf reader finds: a number by time in ns, aircraft and column."""
    names = run_info().names
    found = {}
    for topic, stamp, message in decoded(path):
        parts = topic.strip("/").split("/")
        if len(parts) == 2 and parts[1] != "fix":
            for field, value in (
                (d.name, getattr(message, d.name)) for d in message.DESCRIPTOR.fields
            ):
                column = field if field.startswith(parts[1]) else f"{parts[1]}_{field}"
                if isinstance(value, bool | int | float):
                    found[stamp, parts[0], column] = value
                else:
                    stem, _, unit = column.rpartition("_")
                    for name, one in zip(names, value, strict=True):
                        found[stamp, parts[0], f"{stem}_{name}_{unit}"] = one
    return found


def test_a_table_has_what_the_messages_say_and_nothing_where_they_say_nothing(path, table):
    messages = said(path)
    rows = table.to_pylist()
    assert [row["aircraft"] for row in rows[:5]] == ["leader", "uav1", "uav2", "uav3", "leader"]
    assert len(rows) == FRAMES * 4
    told = 0
    for row in rows:
        stamp = round(row["time_s"] * 1e9)
        for column, value in row.items():
            if column in ("time_s", "aircraft"):
                continue
            message = messages.get((stamp, row["aircraft"], column))
            if message is None or math.isnan(message):
                # of what is not written, exact estimates are the truth
                assert value is None or column.startswith(("estimate_", "believed_")), column
            else:
                assert value == message, (stamp, column)
                told += 1
    assert told == sum(not math.isnan(value) for value in messages.values())
    assert told > 10_000


def test_where_nothing_errs_estimates_are_the_truth(table):
    row = table.to_pylist()[1]
    assert row["estimate_roll_rad"] == row["state_roll_rad"]
    assert row["believed_error_down_m"] == row["formation_error_down_m"]


def test_csv_is_the_table_to_the_last_bit(flight, table):
    file = io.BytesIO()
    arrow_door.write_csv(flight, file)
    header, *rows = csv.reader(io.StringIO(file.getvalue().decode()))
    assert header == table.column_names
    expected = table.to_pylist()
    assert len(rows) == len(expected)
    for row, values in zip(rows, expected, strict=True):
        for cell, value in zip(row, values.values(), strict=True):
            if isinstance(value, bool):
                assert cell == str(value).lower()
            elif isinstance(value, str) or value is None:
                assert cell == (value or "")
            else:
                assert float(cell) == value


def test_npz_is_the_arrays_by_name(flight):
    file = io.BytesIO()
    write_npz(flight, file)
    file.seek(0)
    kept = np.load(file, allow_pickle=False)
    np.testing.assert_array_equal(kept["time_s"], flight.time_s)
    assert kept["aircraft"].tolist() == list(flight.names)
    for name in flight.keys():
        np.testing.assert_array_equal(kept[name], flight[name])
    assert str(kept["scenario.resolved.yaml"]) == flight.info.scenario_yaml
    assert json.loads(str(kept["run.json"]))["seed"] == "7"


def test_parquet_says_what_the_run_was_and_the_units_of_its_columns(flight, table):
    facts = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    assert facts["scenario.resolved.yaml"] == run_info().scenario_yaml
    run = json.loads(facts["run.json"])
    assert (run["seed"], run["version.jsbsim"], run["finished"]) == ("7", "1.3.3", True)
    assert json.loads(facts["metrics.json"]) == {"outcome": "flown"}
    assert [each["text"] for each in json.loads(facts["events.json"])] == ["a gust"]
    units = {
        field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in table.schema
    }
    assert units["state_acceleration_down_mps2"] == "m/s²"
    assert units["formation_age_leader_s"] == "s"
    assert units["command_throttle"] == ""


def test_every_number_of_the_log_says_its_unit_or_is_a_plain_number():
    fields = [field for topic in TOPICS for field, _ in topic.fields]
    assert len(fields) > 60
    for field in fields:
        known = field.rpartition("_")[2] in UNITS
        assert known != (field in PLAIN or field.endswith(PLAIN_ENDS)), field
    assert len(QUANTITIES) == len(fields)


def test_arrays_have_a_row_for_every_aircraft(flight):
    log = flight.log
    np.testing.assert_array_equal(flight["state_pitch_rad"], log.truth.euler[..., 1])
    slots = flight["formation_slot_east_m"]
    assert np.isnan(slots[:, 0]).all()
    np.testing.assert_array_equal(slots[:, 1:], log.formation.slot_ned[..., 1])
    places = flight["formation_place"]
    assert places.dtype == np.uint32 and not places[:, 0].any()
    assert flight["formation_age_s"].shape == (FRAMES, 4, 4)
    np.testing.assert_array_equal(flight["formation_age_s"][:, 2, 0], log.formation.age_s[:, 1, 0])
    assert set(dict(flight)) == set(flight.keys())


def test_before_the_log_tells_of_messages_there_is_no_count(tmp_path):
    # a chunk is 200 frames of four aircraft; the first loss is in the second
    path = record(tmp_path / "run.mcap", run_frames(450, lossy_from=250))
    sent = testbed.load(path)["network_sent_count"]
    told = ~np.isnan(sent[:, 1, 0])
    assert 0 < told.argmax() <= 250
    assert told[told.argmax() :].all()


def test_a_flight_and_its_parts_are_printed_in_few_words(flight, path, tmp_path):
    text = repr(flight)
    assert text == (
        "<Flight of synthetic: 60 frames, 2.36 s, of leader, uav1, uav2, uav3 (rascal110); flown>"
    )
    assert repr(flight.info).startswith("<RunInfo of synthetic: leader, uav1") and "60 s" in repr(
        flight.info
    )
    assert "1 event>" in repr(flight.log) and "truth" in repr(flight.log)
    assert "position_ned 60×4×3" in repr(flight.log.truth)
    now = VehicleState(*(each[0, :1] for each in flight.log.truth))
    assert "airspeed=array([" in repr(now)  # few numbers are shown
    for part in (flight, flight.log, flight.info, *frame_parts(flight.log)):
        assert len(repr(part)) < 500
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert repr(testbed.load(tmp_path / "cut.mcap")).endswith("; cut short>")
    many = ", ".join(f"uav{i}" for i in range(1, 5))
    assert listed(run_info(30).names) == f"leader, {many}, … 31 in all"


def frame_parts(log):
    return [getattr(log, name) for name in RECORDS]


def test_a_name_that_is_none_is_answered_with_those_like_it(flight):
    with pytest.raises(KeyError, match="did you mean .*state_position_north_m"):
        flight["north"]
    with pytest.raises(KeyError, match="did you mean .*state_roll_rad"):
        flight["state_rol_rad"]
    with pytest.raises(KeyError, match=r"keys\(\)"):
        flight["§"]


def test_pandas_and_xarray_have_the_same_numbers(flight):
    frame = flight.to_pandas()
    at = (flight.time_s[33], "uav2")
    assert frame.loc[at, "state_yaw_rad"] == flight["state_yaw_rad"][33, 2]
    assert frame.index.names == ["time_s", "aircraft"]
    assert pandas.isna(frame.loc[(0.0, "leader"), "formation_speed_mps"])
    data = flight.to_xarray()
    age = data["formation_age_s"].sel(aircraft="uav3", other="leader")
    np.testing.assert_array_equal(age, flight["formation_age_s"][:, 3, 0])
    assert age.units == "s"
    assert data.attrs["scenario.resolved.yaml"] == flight.info.scenario_yaml


@pytest.mark.parametrize("rows", [28, FRAMES * 4])
def test_parts_make_the_same_table(flight, table, monkeypatch, rows):
    monkeypatch.setattr(arrow_door, "_ROWS", rows)
    file = io.BytesIO()
    arrow_door.write_parquet(flight, file)
    assert parquet.ParquetFile(file).num_row_groups == math.ceil(FRAMES / (rows // 4))
    assert parquet.read_table(file).to_pylist() == table.to_pylist()


def test_of_a_run_that_was_cut_short_what_is_whole_is_written(tmp_path, path):
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    done = call_command("export", cut, "--format", "parquet", cwd=tmp_path, code=0, columns=120)
    assert "the run was cut short" in done.stderr
    kept = parquet.read_table(tmp_path / "cut.parquet")
    assert json.loads(kept.schema.metadata[b"run.json"])["finished"] is False
    assert json.loads(kept.schema.metadata[b"metrics.json"]) is None


def test_a_run_without_frames_is_a_table_without_rows(tmp_path):
    nothing = testbed.load(record(tmp_path / "run.mcap", ()))
    file = io.BytesIO()
    arrow_door.write_csv(nothing, file)
    assert file.getvalue().decode().count("\n") == 1
    assert nothing.to_pandas().empty


def test_the_command_writes_beside_the_log_or_where_it_is_told(tmp_path, path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.mcap").write_bytes(path.read_bytes())

    def export(*more, code=0):
        return call_command("export", folder, *more, cwd=tmp_path, code=code, columns=120)

    suffixes = ("csv", "parquet", "npz", "foxglove", "plotjuggler")
    for form in suffixes:
        done = export("--format", form)
        assert done.stdout == ""
        assert f"run.{form}" in done.stderr
    made = {file.name for file in folder.iterdir()} - {"run.mcap"}
    assert made == {
        *(f"run.{form}" for form in suffixes[:3]),
        "run.foxglove.json",
        "run.plotjuggler.xml",
    }
    printed = export("--format", "csv", "--out", "-").stdout
    assert printed == (folder / "run.csv").read_text()
    refused = {
        ("--format", "xlsx"): "xlsx",
        ("--format", "csv", "--out", "no/where.csv"): "no folder",
        ("--format", "csv", "--out", folder / "run.mcap"): "the log itself",
    }
    for arguments, message in refused.items():
        assert message in export(*arguments, code=2).stderr
    assert (folder / "run.mcap").read_bytes() == path.read_bytes()


def test_a_run_that_is_none_is_refused():
    with pytest.raises(LogError, match="no-such-run"):
        testbed.load("no-such-run")


def test_loading_a_run_needs_neither_the_simulation_nor_pandas():
    code = (
        "import sys, testbed\n"
        "try: testbed.load('no-such-run')\n"
        "except ValueError: print(*sorted(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "testbed.record.flight" in loaded
    assert not loaded & {"jsbsim", "numba", "pandas", "pyarrow", "rerun"}


def test_the_names_of_the_columns_need_no_quotes():
    word = re.compile(r"[a-z][a-z0-9_]*")
    assert all(word.fullmatch(name) for name in QUANTITIES)
