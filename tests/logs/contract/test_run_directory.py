"""Run directories: never shared, found by name, refused with a reason."""

import os
import re
from concurrent.futures import ThreadPoolExecutor

import pytest

from testbed.logs.mcap_file import LogError
from testbed.logs.run_directory import (
    LOG_NAME,
    create_run_directory,
    find_run,
    write_run_file,
)


def add_log(directory):
    (directory / LOG_NAME).write_bytes(b"")
    return directory / LOG_NAME


def test_simultaneous_runs_get_different_directories(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: create_run_directory("s", logs=tmp_path), range(64)))
    assert len(set(made)) == 64
    for directory in made:
        assert directory.parent == tmp_path / "s"
        assert re.fullmatch(r"\d{8}T\d{6}Z-[0-9a-f]{4}", directory.name)


@pytest.mark.parametrize("name", ["../../elsewhere", "/absolute", "..", "a b/ç"])
def test_scenario_name_with_slashes_is_one_folder(tmp_path, name):
    directory = create_run_directory(name, logs=tmp_path / "logs")
    assert directory.parent.parent == tmp_path / "logs"


def test_out_directory_created_or_used_if_empty(tmp_path):
    new = tmp_path / "a" / "b"
    assert create_run_directory("s", out=new) == new
    assert new.is_dir()
    assert create_run_directory("s", out=new) == new


def test_out_directory_not_empty_raises(tmp_path):
    add_log(tmp_path)
    with pytest.raises(LogError, match="not empty; name a new or an empty directory"):
        create_run_directory("s", out=tmp_path)


def test_second_run_in_one_directory_raises(tmp_path):
    mine, other = (create_run_directory("s", out=tmp_path / "run") for _ in range(2))
    write_run_file(mine, "notes", b"mine")
    with pytest.raises(LogError, match=r"run: another run has just begun in it; name a new"):
        write_run_file(other, "notes", b"its")
    assert (tmp_path / "run" / "notes").read_bytes() == b"mine"
    with pytest.raises(LogError, match=r"missing/notes: cannot be written: No such file"):
        write_run_file(tmp_path / "missing", "notes", b"")


def test_file_instead_of_folder_raises(tmp_path):
    (tmp_path / "logs").write_text("")
    with pytest.raises(LogError, match="cannot make the run directory"):
        create_run_directory("s", logs=tmp_path / "logs")
    with pytest.raises(
        LogError, match=r"^out: .*logs: cannot make the run directory: it is a file"
    ):
        create_run_directory("s", out=tmp_path / "logs")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_folder_raises(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(LogError, match="cannot make the run directory"):
        create_run_directory("s", logs=tmp_path / "logs")


def test_find_run_by_file_directory_or_scenario(tmp_path):
    older = tmp_path / "s" / "20260101T000000Z-ffff"
    newer = tmp_path / "s" / "20260102T000000Z-0000"
    unlogged = tmp_path / "s" / "20260103T000000Z-0000"
    for directory in (newer, older, unlogged):
        directory.mkdir(parents=True)
    add_log(newer)
    log = add_log(older)
    assert find_run(log, logs=tmp_path) == log
    assert find_run(older, logs=tmp_path) == log
    assert find_run("s", logs=tmp_path) == newer / LOG_NAME
    assert find_run(str(tmp_path / "s"), logs=tmp_path / "none") == newer / LOG_NAME


def test_find_run_within_a_second_takes_later_log(tmp_path):
    logs = []
    for i, name in enumerate(("f", "a", "c")):
        directory = tmp_path / "s" / f"20260101T000000Z-{name}"
        directory.mkdir(parents=True)
        logs.append(add_log(directory))
        os.utime(logs[-1], (100.0 + i, 100.0 + i))
    assert find_run("s", logs=tmp_path) == logs[-1]


def test_find_run_missing_explains(tmp_path):
    (tmp_path / "known" / "20260101T000000Z-0000").mkdir(parents=True)
    add_log(tmp_path / "known" / "20260101T000000Z-0000")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match=r"unknown: neither .* runs of: known"):
        find_run("unknown", logs=tmp_path)
    with pytest.raises(LogError, match="no runs yet"):
        find_run("unknown", logs=tmp_path / "none")
    with pytest.raises(LogError, match=r"no run\.mcap in there, and no runs below"):
        find_run(tmp_path / "empty", logs=tmp_path)
    (tmp_path / "empty" / "scenario.resolved.yaml").touch()
    with pytest.raises(LogError, match=r"no run\.mcap in there: nothing was recorded"):
        find_run(tmp_path / "empty", logs=tmp_path)
