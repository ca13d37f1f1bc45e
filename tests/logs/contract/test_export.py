"""Exports of a run: every number of the log, by name, for arrays, tables and other programs."""

import csv
import io
import json
import math
import re

import numpy as np
import pandas
import pytest
from commands import call_command, environment
from fresh import run_fresh
from places import ROOT
from pyarrow import parquet
from record_flight import RECORDS, decoded, event, record, run_info, run_samples
from scipy.io import loadmat

import testbed
from testbed.core.records import VehicleState, join_names
from testbed.law import LimiterFlag, Saturation
from testbed.logs import arrow_io, flight_data
from testbed.logs.file_record import RECORD_NAME
from testbed.logs.flight_data import write_npz
from testbed.logs.matlab_file import write_mat
from testbed.logs.mcap_file import LogError
from testbed.logs.messages import QUANTITIES, TOPICS, UNITS

SAMPLES = 60
# dimensionless fields: ratios, coefficients, counts, indices, bits and booleans
DIMENSIONLESS = {"aileron", "elevator", "rudder", "throttle", "lost", "slot_index"}
DIMENSIONLESS_ENDS = ("_delta_cl", "_of_charge", "_bits", "_count")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A log with estimate errors and lost messages from sample 20, a lost aircraft from 40."""
    seen = run_samples(
        SAMPLES, noisy_from=20, lossy_from=20, lost_from=40, events=[event(30, "a gust")]
    )
    folder = tmp_path_factory.mktemp("run")
    return record(folder / "run.mcap", seen, summary={"outcome": "completed"})


@pytest.fixture(scope="module")
def flight(path):
    return testbed.load_run(path)


@pytest.fixture(scope="module")
def table(flight):
    file = io.BytesIO()
    arrow_io.write_parquet(flight, file)
    return parquet.read_table(file)


def decoded_numbers(path):
    """Decode with the file's own schemas: numbers by time in ns, aircraft and column."""
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
                    for name in names:
                        found[stamp, parts[0], f"{stem}_{name}_{unit}"] = getattr(value, name)
    return found


def test_parquet_equals_decoded_messages(path, table):
    messages = decoded_numbers(path)
    rows = table.to_pylist()
    assert [row["aircraft"] for row in rows[:5]] == ["leader", "uav1", "uav2", "uav3", "leader"]
    assert len(rows) == SAMPLES * 4
    compared = 0
    for row in rows:
        stamp = round(row["time_s"] * 1e9)
        for column, value in row.items():
            if column in ("time_s", "aircraft"):
                continue
            message = messages.get((stamp, row["aircraft"], column))
            if message is None or math.isnan(message):
                # unwritten estimates have the true values
                assert value is None or column.startswith(("estimate_", "estimated_error_")), column
            else:
                assert value == message, (stamp, column)
                compared += 1
    assert compared == sum(not math.isnan(value) for value in messages.values())
    assert compared > 10_000


def test_exact_estimates_equal_truth_in_table(table):
    row = table.to_pylist()[1]
    assert row["estimate_roll_rad"] == row["state_roll_rad"]
    assert row["estimated_error_down_m"] == row["formation_error_down_m"]


def test_csv_equals_parquet_to_the_bit(flight, table):
    file = io.BytesIO()
    flight_data.write_csv(flight, file)
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


def test_npz_has_arrays_and_documents(flight):
    file = io.BytesIO()
    write_npz(flight, file)
    file.seek(0)
    arrays = np.load(file, allow_pickle=False)
    np.testing.assert_array_equal(arrays["time_s"], flight.time_s)
    assert arrays["aircraft"].tolist() == list(flight.names)
    for name in flight.keys():
        np.testing.assert_array_equal(arrays[name], flight[name])
    assert str(arrays["scenario.resolved.yaml"]) == flight.info.scenario_yaml
    assert json.loads(str(arrays["run.json"]))["seed"] == "7"


def test_mat_has_arrays_under_names_of_matlab(flight):
    """No dots, a letter first, at most 63 letters; the same bytes each time."""
    files = [io.BytesIO(), io.BytesIO()]
    for file in files:
        write_mat(flight, file)
    assert files[0].getvalue() == files[1].getvalue()
    variables = loadmat(files[0], squeeze_me=False)
    names = {name for name in variables if not name.startswith("__")}
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", name) for name in names)
    assert len(names) == len(flight.keys()) + 6
    for name in flight.keys():
        np.testing.assert_array_equal(variables[name], flight[name])
    assert variables["time_s"].shape == (flight.time_s.size, 1)
    np.testing.assert_array_equal(variables["time_s"][:, 0], flight.time_s)
    assert [str(each[0]) for each in variables["aircraft"][:, 0]] == list(flight.names)
    assert str(variables["scenario_resolved_yaml"][0]) == flight.info.scenario_yaml
    assert json.loads(str(variables["run_json"][0]))["seed"] == "7"


def test_parquet_has_documents_and_units(flight, table):
    documents = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    assert documents["scenario.resolved.yaml"] == run_info().scenario_yaml
    run = json.loads(documents["run.json"])
    assert (run["seed"], run["version.jsbsim"], run["finished"]) == ("7", "1.3.3", True)
    assert json.loads(documents["metrics.json"]) == {"outcome": "completed"}
    assert [each["text"] for each in json.loads(documents["events.json"])] == ["a gust"]
    units = {
        field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in table.schema
    }
    assert units["state_acceleration_down_mps2"] == "m/s²"
    assert units["formation_age_leader_s"] == "s"
    assert units["command_throttle"] == ""


def test_every_field_has_unit_or_is_dimensionless():
    fields = [field for topic in TOPICS for field, _ in topic.fields]
    assert len(fields) > 60
    for field in fields:
        known = field.rpartition("_")[2] in UNITS
        assert known != (field in DIMENSIONLESS or field.endswith(DIMENSIONLESS_ENDS)), field
    assert len(QUANTITIES) == len(fields)


def test_arrays_have_row_for_every_aircraft(flight):
    log = flight.log
    np.testing.assert_array_equal(flight["state_pitch_rad"], log.truth.euler[..., 1])
    slots = flight["formation_slot_east_m"]
    assert np.isnan(slots[:, 0]).all()
    np.testing.assert_array_equal(slots[:, 1:], log.formation.slot_ned[..., 1])
    slots = flight["formation_slot_index"]
    assert slots.dtype == np.uint32 and not slots[:, 0].any()
    assert flight["formation_age_s"].shape == (SAMPLES, 4, 4)
    np.testing.assert_array_equal(flight["formation_age_s"][:, 2, 0], log.formation.age_s[:, 1, 0])
    assert set(dict(flight)) == set(flight.keys())


def test_message_counts_before_first_loss_are_nan(tmp_path):
    # a chunk has 200 samples of four aircraft; the first loss is in the second chunk
    path = record(tmp_path / "run.mcap", run_samples(450, lossy_from=250))
    sent = testbed.load_run(path)["network_sent_count"]
    counted = ~np.isnan(sent[:, 1, 0])
    assert 0 < counted.argmax() <= 250
    assert counted[counted.argmax() :].all()


def test_repr_is_short(flight, path, tmp_path):
    text = repr(flight)
    assert text == (
        "<FlightData of synthetic: 60 samples, 2.36 s, of leader, uav1, uav2, uav3 (rascal110);"
        " completed>"
    )
    assert repr(flight.info).startswith("<RunInfo of synthetic: leader, uav1") and "60 s" in repr(
        flight.info
    )
    assert "1 event>" in repr(flight.log) and "truth" in repr(flight.log)
    assert "position_ned 60×4×3" in repr(flight.log.truth)
    now = VehicleState(*(each[0, :1] for each in flight.log.truth))
    assert "airspeed=array([" in repr(now)  # short arrays are printed
    for part in (flight, flight.log, flight.info, *records_of(flight.log)):
        assert len(repr(part)) < 500
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert repr(testbed.load_run(tmp_path / "cut.mcap")).endswith("; cut short>")
    many = ", ".join(f"uav{i}" for i in range(1, 5))
    assert join_names(run_info(30).names) == f"leader, {many}, … 31 in all"


def records_of(log):
    return [getattr(log, name) for name in RECORDS]


def test_bits_have_names(flight, table):
    """In arrays of flags, in xarray and in Parquet: those of the two sets of bits, no others."""
    found = flight.flags("formation_saturation_bits")
    bits = flight["formation_saturation_bits"]
    assert list(found) == ["pitch", "roll", "throttle"]
    assert np.array_equal(4 * found["throttle"], bits & 4)
    assert found["throttle"].any() and not found["throttle"].all()
    with pytest.raises(KeyError, match="state_roll_rad is a number, without bits; formation_limi"):
        flight.flags("state_roll_rad")
    attributes = flight.to_xarray()["formation_limiter_bits"].attrs
    masks = "1 2 4 8 16 32 64"
    assert attributes["flag_masks"] == masks
    assert attributes["flag_meanings"].split()[3] == "leader_timeout"
    assert (
        table.schema.field("formation_limiter_bits").metadata[b"flag_masks"] == b"1 2 4 8 16 32 64"
    )
    assert "flag_masks" not in flight.to_xarray()["state_roll_rad"].attrs
    text = (ROOT / "docs" / "export.md").read_text("utf-8")
    for kind in (LimiterFlag, Saturation):
        for flag in kind:
            row = next(line for line in text.splitlines() if line.startswith(f"| {int(flag)} |"))
            assert f"`{flag.name.lower()}`" in row


def test_unknown_name_suggests_similar(flight):
    with pytest.raises(KeyError, match="did you mean .*state_position_north_m"):
        flight["north"]
    with pytest.raises(KeyError, match="did you mean .*state_roll_rad"):
        flight["state_rol_rad"]
    with pytest.raises(KeyError, match=r"keys\(\)"):
        flight["§"]


def test_pandas_and_xarray_equal_arrays(flight):
    table = flight.to_pandas()
    at = (flight.time_s[33], "uav2")
    assert table.loc[at, "state_yaw_rad"] == flight["state_yaw_rad"][33, 2]
    assert table.index.names == ["time_s", "aircraft"]
    assert pandas.isna(table.loc[(0.0, "leader"), "formation_speed_mps"])
    data = flight.to_xarray()
    age = data["formation_age_s"].sel(aircraft="uav3", other="leader")
    np.testing.assert_array_equal(age, flight["formation_age_s"][:, 3, 0])
    assert age.units == "s"
    assert data.attrs["scenario.resolved.yaml"] == flight.info.scenario_yaml


@pytest.mark.parametrize("rows", [28, SAMPLES * 4])
def test_row_groups_do_not_change_table(flight, table, monkeypatch, rows):
    monkeypatch.setattr(flight_data, "TABLE_ROWS", rows)
    file = io.BytesIO()
    arrow_io.write_parquet(flight, file)
    assert parquet.ParquetFile(file).num_row_groups == math.ceil(SAMPLES / (rows // 4))
    assert parquet.read_table(file).to_pylist() == table.to_pylist()


def test_export_of_cut_run_has_complete_samples(tmp_path, path):
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    done = call_command("export", cut, "--format", "parquet", cwd=tmp_path, code=0, columns=120)
    assert "the run was cut short" in done.stderr
    table = parquet.read_table(tmp_path / "cut.parquet")
    assert json.loads(table.schema.metadata[b"run.json"])["finished"] is False
    assert json.loads(table.schema.metadata[b"metrics.json"]) is None


def test_run_without_samples_is_table_without_rows(tmp_path):
    empty = testbed.load_run(record(tmp_path / "run.mcap", ()))
    file = io.BytesIO()
    flight_data.write_csv(empty, file)
    assert file.getvalue().decode().count("\n") == 1
    assert empty.to_pandas().empty


def test_export_command_writes_every_format(tmp_path, path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.mcap").write_bytes(path.read_bytes())

    def export(*more, code=0):
        return call_command("export", folder, *more, cwd=tmp_path, code=code, columns=120)

    written = {
        "csv": "run.csv",
        "parquet": "run.parquet",
        "npz": "run.npz",
        "mat": "run.mat",
        "foxglove": "run.foxglove.mcap",
        "foxglove-layout": "run.foxglove.json",
        "plotjuggler": "run.plotjuggler.xml",
    }
    for form, name in written.items():
        done = export("--format", form)
        assert done.stdout == ""
        assert name in done.stderr
    names = {file.name for file in folder.iterdir()}
    assert names == {"run.mcap", RECORD_NAME, *written.values()}
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


def test_load_missing_run_raises():
    with pytest.raises(LogError, match="no-such-run"):
        testbed.load_run("no-such-run")


def test_load_imports_no_simulation_or_pandas(tmp_path):
    code = (
        "import sys\n"
        "unused = 'jsbsim', 'numba', 'pandas', 'pyarrow', 'rerun'\n"
        "sys.modules.update(dict.fromkeys(unused))  # as if not installed\n"
        "import testbed\n"
        "try: testbed.load_run('no-such-run')\n"
        "except ValueError: print('testbed.logs.flight_data' in sys.modules)"
    )
    done = run_fresh(code, folder=tmp_path, paths=[ROOT], env=environment(80))
    assert done == [0, "True\n", ""]


def test_column_names_need_no_quotes():
    word = re.compile(r"[a-z][a-z0-9_]*")
    assert all(word.fullmatch(name) for name in QUANTITIES)
