"""Run directories: never shared, found again, refused with a reason."""

import os
import re
from concurrent.futures import ThreadPoolExecutor

import pytest

from testbed.record.door import LogError
from testbed.record.rundir import LOG_NAME, create_run_directory, find_run, leave


def flown(directory):
    (directory / LOG_NAME).write_bytes(b"")
    return directory / LOG_NAME


def test_runs_at_the_same_moment_get_directories_of_their_own(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: create_run_directory("s", logs=tmp_path), range(64)))
    assert len(set(made)) == 64
    for directory in made:
        assert directory.parent == tmp_path / "s"
        assert re.fullmatch(r"\d{8}T\d{6}Z-[0-9a-f]{4}", directory.name)


@pytest.mark.parametrize("name", ["../../elsewhere", "/absolute", "..", "a b/ç"])
def test_a_scenario_name_is_one_folder_below_the_logs(tmp_path, name):
    directory = create_run_directory(name, logs=tmp_path / "logs")
    assert directory.parent.parent == tmp_path / "logs"


def test_a_named_directory_is_made_or_used_when_empty(tmp_path):
    new = tmp_path / "a" / "b"
    assert create_run_directory("s", out=new) == new
    assert new.is_dir()
    assert create_run_directory("s", out=new) == new


def test_a_named_directory_that_holds_something_is_refused(tmp_path):
    flown(tmp_path)
    with pytest.raises(LogError, match="not empty; name a new or an empty directory"):
        create_run_directory("s", out=tmp_path)


def test_of_two_that_find_a_directory_empty_the_first_to_write_has_it(tmp_path):
    mine, other = (create_run_directory("s", out=tmp_path / "run") for _ in range(2))
    leave(mine, "page", b"mine")
    with pytest.raises(LogError, match=r"run: another run has just begun in it; name a new"):
        leave(other, "page", b"its")
    assert (tmp_path / "run" / "page").read_bytes() == b"mine"
    with pytest.raises(LogError, match=r"gone/page: cannot be written: No such file"):
        leave(tmp_path / "gone", "page", b"")


def test_a_file_in_the_way_is_refused(tmp_path):
    (tmp_path / "logs").write_text("")
    with pytest.raises(LogError, match="cannot make the run directory"):
        create_run_directory("s", logs=tmp_path / "logs")
    with pytest.raises(LogError, match="cannot make the run directory"):
        create_run_directory("s", out=tmp_path / "logs")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_is_read_only_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(LogError, match="cannot make the run directory"):
        create_run_directory("s", logs=tmp_path / "logs")


def test_a_run_is_found_by_file_directory_and_scenario(tmp_path):
    older = tmp_path / "s" / "20260101T000000Z-ffff"
    newer = tmp_path / "s" / "20260102T000000Z-0000"
    unlogged = tmp_path / "s" / "20260103T000000Z-0000"
    for directory in (newer, older, unlogged):
        directory.mkdir(parents=True)
    flown(newer)
    log = flown(older)
    assert find_run(log, logs=tmp_path) == log
    assert find_run(older, logs=tmp_path) == log
    assert find_run("s", logs=tmp_path) == newer / LOG_NAME
    assert find_run(str(tmp_path / "s"), logs=tmp_path / "none") == newer / LOG_NAME


def test_within_a_second_the_later_log_is_the_latest(tmp_path):
    logs = []
    for i, name in enumerate(("f", "a", "c")):
        directory = tmp_path / "s" / f"20260101T000000Z-{name}"
        directory.mkdir(parents=True)
        logs.append(flown(directory))
        os.utime(logs[-1], (100.0 + i, 100.0 + i))
    assert find_run("s", logs=tmp_path) == logs[-1]


def test_a_run_that_is_not_there_is_explained(tmp_path):
    (tmp_path / "known" / "20260101T000000Z-0000").mkdir(parents=True)
    flown(tmp_path / "known" / "20260101T000000Z-0000")
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
