"""Result files and journals of studies that are well-formed but wrong: one error, no traceback."""

import json
import os

import pyarrow as arrow
import pytest
from commands import call_command
from pyarrow import parquet

from testbed.cli.study_report import read_study
from testbed.core.errors import InputError
from testbed.logs import arrow_io
from testbed.studies.journal import Journal, JournalRow
from testbed.studies.table import metric_columns, read_table

DEEP = "[" * 200_000
INPUTS = {"study": {}, "versions": {"numpy": "2"}}
NAMES = {"names": ["a", "b"]}
ROW = {"run": 0, "outcome": "completed", "error": "", "names": 0, "values": [1.0, None]}


def write_journal(path, *lines):
    texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    path.write_text("".join(text + "\n" for text in texts))
    return path


def read_journal(path):
    journal = Journal(path)
    try:
        return list(journal.rows()), journal.names()
    finally:
        journal.close()


HEAD = {"journal": 2, "inputs": INPUTS}
LAST = ROW | {"run": 1}


def test_cut_journal_is_continued_and_read_again(tmp_path):
    """As after a power failure, a resume that is stopped, and another resume."""
    path = write_journal(tmp_path / "study.journal", HEAD, NAMES, ROW)
    whole = path.read_bytes()
    for cut in (1, 20, len(json.dumps(LAST))):
        path.write_bytes(whole + json.dumps(LAST).encode()[:cut])
        journal = Journal(path)
        assert len(journal) == 1
        journal.add(JournalRow(3, "completed", "", {"a": 3.0, "b": 4.0}))
        journal.close()
        rows, _ = read_journal(path)
        assert [(row.run, row.metrics["a"]) for row in rows] == [(0, 1.0), (3, 3.0)]


def test_good_journal_is_read(tmp_path):
    rows, names = read_journal(write_journal(tmp_path / "study.journal", HEAD, NAMES, ROW, LAST))
    assert [row.run for row in rows] == [0, 1]
    assert rows[0].metrics == {"a": 1.0, "b": None} and names == ("a", "b")


@pytest.mark.parametrize(
    "wrong",
    [
        *("5", "[]", "null", '"x"', DEEP, "{" * 5, '{"names": "ab"}', '{"names": [1, 2]}'),
        *('{"names": {"a": 1}}', '{"names": ["a", "a"]}', "{}"),
        *(ROW | {"run": each} for each in (-1, "0", True, 1.5, 10**30, None)),
        *(ROW | {"names": each} for each in (999, -1, "0")),
        *(ROW | {"values": ["x", 1.0]}, ROW | {"values": [[], 1.0]}, ROW | {"values": "ab"}),
        *(ROW | {"values": [10**400, 1.0]}, ROW | {"values": {"a": 1, "b": 2}}),
        *(ROW | {"outcome": "unheard of"}, ROW | {"outcome": []}, ROW | {"error": 5}),
        ROW | {"any_seed": 1},
    ],
    ids=lambda wrong: str(wrong)[:40],
)
def test_wrong_line_of_a_journal_is_named(tmp_path, wrong):
    path = write_journal(tmp_path / "study.journal", HEAD, NAMES, ROW, wrong, LAST)
    with pytest.raises(InputError, match=r"study\.journal:4: is not a line of a journal") as error:
        read_journal(path)
    assert len(str(error.value)) < 1000 and "\n" not in str(error.value)


@pytest.mark.parametrize("inputs", [5, [1], "x", None, {"study": []}, {"versions": "x"}])
def test_wrong_inputs_of_a_journal_are_named(tmp_path, inputs):
    path = write_journal(tmp_path / "study.journal", {"journal": 2, "inputs": inputs}, NAMES)
    with pytest.raises(InputError, match=r"study\.journal:1: is not a line of a journal"):
        read_journal(path)


def test_journal_with_a_run_of_another_study_raises(tmp_path):
    path = write_journal(tmp_path / "study.journal", HEAD, NAMES, ROW | {"run": 999})
    journal = Journal(path)
    with pytest.raises(InputError, match="has run 999, and the study has runs 0 to 7"):
        journal.refuse_other_runs(8)
    journal.refuse_other_runs(1000)
    journal.close()


def test_names_of_aircraft_with_dots_keep_columns(tmp_path):
    """`uav` beside `uav.1` are two aircraft; `error` beside `error.uav` is a missing part."""
    journal = Journal(tmp_path / "study.journal", INPUTS)
    numbers = {"error.uav": 1.0, "error.uav.1": 2.0, "age": 3.0}
    journal.add(JournalRow(0, "lost", "lost: uav", {"error": None, "age": None}))
    journal.add(JournalRow(1, "completed", "", numbers))
    assert journal.names() == ("age", "error.uav", "error.uav.1")
    journal.close()


def table(rows=4):
    """Columns and metadata of a good result file."""
    columns = {
        "run": arrow.array(range(rows), arrow.int64()),
        "case": arrow.array([""] * rows),
        "seed": arrow.array([1 + k % 2 for k in range(rows)], arrow.int64()),
        "set.network.delay_s": arrow.array([0.1 * (k // 2) for k in range(rows)]),
        "outcome": arrow.array(["completed"] * rows),
        "error": arrow.array([""] * rows),
        "command": arrow.array([f"testbed run x --seed {k}" for k in range(rows)]),
        "metrics.windows.laps.mean_rms_m": arrow.array([1.0 + k for k in range(rows)]),
    }
    metadata = {"study.schema": "2", "complete": "true", "study.name": "radio", "study.yaml": "x"}
    metadata |= {"runs": str(rows), "versions.json": '{"numpy": "2"}', "scenario.yaml": "{}"}
    return columns, metadata


def write(path, columns, metadata):
    schema = arrow.schema([(k, v.type) for k, v in columns.items()], metadata=metadata)
    parquet.write_table(arrow.Table.from_arrays(list(columns.values()), schema=schema), path)
    return path


def test_good_result_file_is_read(tmp_path):
    path = write(tmp_path / "study.parquet", *table())
    assert read_study(path, metrics=(), statistic="median").planned == 4


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"versions.json": DEEP}, "metadata versions.json: is nested deeper than 40 levels"),
        ({"versions.json": "[1]"}, "metadata versions.json: is not a map"),
        ({"versions.json": "{"}, "metadata versions.json: Expecting"),
        ({"runs": "x"}, "metadata runs: 'x' is not a number of runs"),
        ({"runs": "-1"}, "metadata runs: '-1'"),
        ({"runs": "9" * 5000}, "metadata runs: '999"),
        ({"study.schema": "x"}, "is of version x"),
        ({"study.schema": "[" * 200_000}, r"is of version \[{20}; this"),
    ],
)
def test_wrong_metadata_of_a_result_is_named(tmp_path, metadata, message):
    columns, good = table()
    path = write(tmp_path / "study.parquet", columns, good | metadata)
    with pytest.raises(InputError, match=rf"study\.parquet: {message}"):
        read_study(path, metrics=(), statistic="median")


@pytest.mark.parametrize("name", table()[0])
@pytest.mark.parametrize("kind", ["missing", "lists", "null", "bytes"])
def test_wrong_column_of_a_result_is_named(tmp_path, name, kind):
    columns, metadata = table()
    wrong = {
        "lists": arrow.array([[1]] * 4),
        "null": arrow.nulls(4),
        "bytes": arrow.array([b"\xff"] * 4),
    }
    if kind == "missing":
        del columns[name]
    else:
        columns[name] = wrong[kind]
    path = write(tmp_path / "study.parquet", columns, metadata)
    if kind == "missing" and "." in name:
        read_table(path)
        return
    with pytest.raises(InputError, match=rf"study\.parquet: .*({name}|not the result of a study)"):
        read_study(path, metrics=(), statistic="median")


def test_result_with_repeated_columns_raises(tmp_path):
    columns, metadata = table()
    arrays, names = [*columns.values(), columns["run"]], [*columns, "run"]
    whole = arrow.Table.from_arrays(arrays, names=names).replace_schema_metadata(metadata)
    parquet.write_table(whole, tmp_path / "study.parquet")
    with pytest.raises(InputError, match="has several columns run"):
        read_table(tmp_path / "study.parquet")


def test_result_of_more_values_than_any_study_raises(tmp_path, monkeypatch):
    """A run-length encoded column of a thousand million rows has some kilobytes."""
    path = write(tmp_path / "study.parquet", *table())
    monkeypatch.setattr(arrow_io, "_MAX_VALUES", 20)
    with pytest.raises(InputError, match="4 rows of 8 columns in .* at most 20 values"):
        read_table(path)


@pytest.mark.parametrize("data", [b"", b"PAR1" * 3, b"PAR1" + bytes(100) + b"PAR1"])
def test_file_that_is_no_parquet_is_named(tmp_path, data):
    path = tmp_path / "study.parquet"
    path.write_bytes(data)
    for read in (read_table, metric_columns):
        with pytest.raises(InputError, match=r"study\.parquet: is not a Parquet file: "):
            read(path)


def test_study_report_of_wrong_file_exits_with_2(tmp_path):
    columns, metadata = table()
    columns["metrics.windows.laps.mean_rms_m"] = arrow.array(["x"] * 4)
    write(tmp_path / "study.parquet", columns, metadata)
    done = call_command("study-report", "study.parquet", cwd=tmp_path, code=2, columns=200)
    assert "column metrics.windows.laps.mean_rms_m: is not of type double" in done.stderr


def test_parquet_is_read_without_threads(tmp_path):
    """Threads of pyarrow that are there when the program ends can abort it.

    Counted in a process forked from this one, of which only one thread is copied.
    """
    path = tmp_path / "a.parquet"
    with path.open("wb") as file:
        arrow_io.write_columns(file, {"a": "int64"}, [[[1, 2, 3]]], {})
    counts, child = [], os.fork()
    if not child:
        try:
            counts.append(len(os.listdir("/proc/self/task")))
            arrow_io.read_columns(path)
            counts.append(len(os.listdir("/proc/self/task")))
        finally:
            os._exit(counts != [1, 1])
    assert os.waitpid(child, 0) == (child, 0)
