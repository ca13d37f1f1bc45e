"""Output files: old content, links, devices, pipes, full disks and closed standard streams."""

import contextlib
import fcntl
import json
import os
import random
import stat
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
import views_flight
from commands import call_command, environment, refuse_all
from forked import Forked
from full_disk import full_disk
from waiting import TIMEOUT_S

from testbed.cli import air
from testbed.core.errors import InputError
from testbed.core.files import (
    check_folder_writable,
    check_writable,
    create_file,
    replacement,
    write_file,
    write_text_file,
)
from testbed.golden.golden_ci import write_junit
from testbed.logs.arrow_io import read_columns, write_columns
from testbed.metrics.document import write_json
from testbed.studies.journal import Journal, JournalRow
from testbed.studies.table import find_output
from testbed.views import RrdFile, replay

BAD_INPUT = 2
TRIM = ("trim", "rascal110", "--airspeed", "22")
OLD = "old content\n"


@contextlib.contextmanager
def reader(fifo):
    """Read a FIFO to its end in a thread; yields a list that gets the content."""
    content = []
    thread = threading.Thread(target=lambda: content.append(fifo.read_bytes()), daemon=True)
    thread.start()
    yield content
    thread.join(TIMEOUT_S)
    assert not thread.is_alive()


def names(folder):
    return sorted(each.name for each in folder.iterdir())


def null_device(path):
    """Make a node of the null device; skip where that is not allowed."""
    try:
        os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
        with open(path, "wb"):
            pass
    except OSError as error:
        pytest.skip(f"no device can be made here: {error}")


# the writer


def test_file_is_replaced_whole(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text(OLD)
    with write_text_file(path) as file:
        file.write("new")
        file.flush()
        assert path.read_text() == OLD
    assert path.read_text() == "new"
    assert names(tmp_path) == ["out.txt"]


def test_file_keeps_its_mode_and_new_one_has_default(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.touch(mode=0o640)
    for path in (old, new):
        with write_file(path) as file:
            file.write(b"x")
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(old.stat().st_mode) == 0o640
    assert stat.S_IMODE(new.stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OSError])
def test_old_content_stays_after_an_error(tmp_path, error):
    path = tmp_path / "out.txt"
    path.write_text(OLD)
    with pytest.raises(error), write_text_file(path) as file:
        file.write("new")
        raise error
    with pytest.raises(error), replacement(path) as new:
        new.write_text("new")
        raise error
    with pytest.raises(OSError, match="cannot be written"), replacement(path):
        pass  # the program that should have made the file has failed
    assert path.read_text() == OLD
    assert names(tmp_path) == ["out.txt"]


def test_link_is_followed_and_stays(tmp_path):
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "target", tmp_path / "link"
    link.symlink_to("folder/target")
    for content in ("first", "second"):  # a new target, and an old one
        with write_text_file(link) as file:
            file.write(content)
        assert link.is_symlink() and target.read_text() == content
    assert names(tmp_path) == ["folder", "link"] and names(tmp_path / "folder") == ["target"]


def test_device_gets_content_and_stays(tmp_path):
    node = tmp_path / "null"
    null_device(node)
    with write_file(node) as file:
        file.write(b"content")
    with replacement(node) as new:
        new.write_bytes(b"content")
    assert stat.S_ISCHR(node.stat().st_mode)
    assert names(tmp_path) == ["null"]


def test_fifo_reader_gets_whole_content(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with reader(fifo) as content, write_file(fifo) as file:
        file.write(b"abc")
        file.seek(0)  # as writers of archives do
        file.write(b"A")
    assert content == [b"Abc"] and stat.S_ISFIFO(fifo.stat().st_mode)
    with reader(fifo) as content, replacement(fifo) as new:
        new.write_bytes(b"x" * 300_000)
    assert content == [b"x" * 300_000]


def test_parts_of_killed_processes_are_removed(tmp_path):
    dead, live, foreign = (
        tmp_path / name
        for name in (".testbed-abcdefgh.part", ".testbed-12345678.part", ".testbed-notes.part")
    )
    filled = tmp_path / ".testbed-00000000.part"  # the testbed has one new file in a folder
    for folder in (dead, live, foreign, filled):
        folder.mkdir()
        (folder / "new").write_text("part")
    (filled / "notes.txt").touch()
    lock = os.open(live, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    with write_file(tmp_path / "out") as file:
        file.write(b"x")
    os.close(lock)
    assert names(tmp_path) == [filled.name, live.name, foreign.name, "out"]


def test_two_writers_of_a_file_do_not_meet(tmp_path):
    path = tmp_path / "out"
    with write_file(path) as first:
        with write_file(path) as second:
            second.write(b"second")
        assert path.read_bytes() == b"second"
        first.write(b"first")
    assert path.read_bytes() == b"first" and names(tmp_path) == ["out"]


def test_unwritable_paths_are_refused(tmp_path):
    (tmp_path / "file").touch()
    for path, reason in (
        (tmp_path / "missing" / "out", "there is no folder"),
        (tmp_path / "file" / "out", "there is no folder"),
        (tmp_path, "this is a folder"),
        (tmp_path / ("n" * 300), "File name too long"),
    ):
        with pytest.raises(OSError, match=reason):
            check_writable(path)
        with pytest.raises(OSError, match=reason), write_file(path):
            pass
    with pytest.raises(OSError, match="is a file"):
        check_folder_writable(tmp_path / "file")
    check_folder_writable(tmp_path / "new" / "folders")
    assert names(tmp_path) == ["file"]


def test_missing_permission_is_refused():
    # not tmp_path, which another user cannot enter
    with tempfile.TemporaryDirectory() as name:
        top, user = Path(name), os.geteuid()
        top.chmod(0o777)
        folder, file = top / "folder", top / "file"
        folder.mkdir(mode=0o555)
        file.touch(mode=0o444)
        if user == 0:
            os.seteuid(65534)
        try:
            for path in (folder / "out", file):
                with pytest.raises(OSError, match="no permission to write"):
                    check_writable(path)
            with pytest.raises(OSError, match="no permission to write"):
                check_folder_writable(folder / "new")
        finally:
            os.seteuid(user)


# each kind of output


def _arrays(path):
    air._save(path, {"x": np.zeros(20_000)})


def _figure(path):
    from testbed.views.matplotlib_backend import save_figure
    from testbed.views.panels import Panel, PanelGrid

    panel = Panel(title="", x_label="", y_label="", lines=())
    save_figure(PanelGrid("title", "", rows=((panel,),), widths=(1.0,)), path)


def _recording(path):
    replay(RrdFile(path), views_flight.log(2, 1.0))


KINDS = {
    "metrics.json": lambda path: write_json(path, {"numbers": [0.1] * 5_000}),
    "junit.xml": lambda path: write_junit(path, "<testsuites/>\n" * 5_000),
    "arrays.npz": _arrays,
    "figure.png": _figure,
    "view.rrd": _recording,
}


@pytest.mark.parametrize("name", KINDS)
def test_full_disk_keeps_the_old_file(tmp_path, name):
    path = tmp_path / name
    path.write_text(OLD)
    with full_disk(4_000), pytest.raises((OSError, InputError), match="File too large"):
        KINDS[name](path)
    assert path.read_text() == OLD and names(tmp_path) == [name]
    KINDS[name](path)
    assert path.stat().st_size > 4_000


def test_new_file_on_a_full_disk_is_removed(tmp_path):
    with full_disk(10), pytest.raises(OSError, match="File too large"):
        create_file(tmp_path / "new", b"x" * 100)
    assert names(tmp_path) == []


def test_journal_on_a_full_disk_keeps_whole_lines(tmp_path):
    """A failed line leaves no part, and closing the journal writes nothing more."""
    path = tmp_path / "x.journal"
    journal = Journal(path, {"study": {}})
    journal.add(JournalRow(0, "completed", "", {"a": 1.0}))
    before = path.read_bytes()
    with full_disk(len(before) + 20), pytest.raises(InputError, match="x.journal: cannot be writ"):
        journal.add(JournalRow(1, "completed", "", {"a": 2.0}))
    with full_disk(len(before)):
        journal.close()
    assert path.read_bytes() == before
    again = Journal(path)
    assert list(again.rows()) == [JournalRow(0, "completed", "", {"a": 1.0})]
    again.close()


def test_study_in_an_unwritable_place_is_refused(tmp_path):
    (tmp_path / "study.parquet").mkdir()
    for out, reason in (
        (tmp_path / ("n" * 300), "File name too long"),
        (tmp_path / "study.parquet", "this is a folder"),
    ):
        with pytest.raises(InputError, match=reason):
            find_output("study", out, resume=False)


def test_parquet_bit_flip_in_pages_is_detected(tmp_path):
    path = tmp_path / "x.parquet"
    columns = [
        list(range(400)),
        [0.1 * k for k in range(400)],
        [f"name {k % 7}" for k in range(400)],
    ]
    with write_file(path) as file:
        fields = {"a": "int64", "b": "double", "c": "string"}
        write_columns(file, fields, [columns], {"key": "text"})
    data, (whole, _) = path.read_bytes(), read_columns(path)
    footer = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    random_words, detected = random.Random(1), 0
    for _ in range(300):
        position, bit = random_words.randrange(4, footer), random_words.randrange(8)
        flipped = bytearray(data)
        flipped[position] ^= 1 << bit
        path.write_bytes(flipped)
        try:
            found, _ = read_columns(path)
        except (OSError, ValueError):
            detected += 1
        else:  # in what readers do not use, such as statistics
            assert all(np.array_equal(found[name], whole[name]) for name in whole)
    assert detected > 200


# commands

COMMANDS = """t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd
0,0,0,0.5
0.1,0,0,0.5
"""


def test_respond_on_a_full_disk_keeps_the_old_file(tmp_path):
    out = tmp_path / "out.csv"
    (tmp_path / "commands.csv").write_text(COMMANDS)
    out.write_text(OLD)
    arguments = ("respond", "rascal110", "commands.csv", "out.csv")
    call_command(*arguments, cwd=tmp_path, code=0, columns=80)
    assert len(out.read_text().splitlines()) == 3
    content = out.read_text()
    with full_disk(200):
        done = call_command(*arguments, cwd=tmp_path, code=BAD_INPUT, columns=80)
    assert done.stderr == "error: out.csv: cannot be written: File too large\n"
    assert out.read_text() == content and names(tmp_path) == ["commands.csv", "out.csv"]


def test_respond_names_the_gyro_filter(tmp_path):
    """That of an aircraft, or with --sitl-rate that of SITL; a turn differs."""
    turn = "".join(f"{0.1 * k:g},0,{0.5 * (k > 2)},0.5\n" for k in range(10))
    (tmp_path / "commands.csv").write_text(COMMANDS.splitlines(keepends=True)[0] + turn)
    arguments = ("respond", "rascal110", "commands.csv")
    own = call_command(*arguments, "own.csv", cwd=tmp_path, code=0, columns=200)
    assert own.stderr.startswith("gyro filter: INS_GYRO_FILTER, as on an aircraft")
    options = ("sitl.csv", "--sitl-rate", "200")
    sitl = call_command(*arguments, *options, cwd=tmp_path, code=0, columns=200)
    assert sitl.stderr == "gyro filter: that of SITL at 200 Hz\n"
    assert (tmp_path / "own.csv").read_text() != (tmp_path / "sitl.csv").read_text()


def test_impossible_names_are_refused_before_work(tmp_path):
    (tmp_path / "file").touch()
    refuse_all("outputs", tmp_path)


def test_json_to_a_descriptor_of_a_shell(tmp_path):
    """A pipe by its descriptor, as `--json >(command)` of a shell gives it."""
    read, write = os.pipe()
    call_command(*TRIM, "--json", f"/dev/fd/{write}", cwd=tmp_path, code=0, columns=80)
    os.close(write)
    with open(read, "rb") as pipe:
        assert json.loads(pipe.read())["aircraft"] == "rascal110"


def shell(tmp_path, arguments, redirection, **variables):
    """Run a command with redirected standard streams; return its exit code and standard error."""
    script = f'exec "$@" {redirection}'
    done = subprocess.run(
        ["sh", "-c", script, "sh", sys.executable, "-m", "testbed", *arguments],
        cwd=tmp_path,
        env=environment(80) | variables,
        capture_output=True,
        timeout=TIMEOUT_S,
    )
    stderr = done.stderr.decode(errors="replace")
    assert "Traceback" not in stderr and "Exception ignored" not in stderr, stderr
    return done.returncode, stderr, done.stdout


def forked(tmp_path, arguments, *, to="out", errors_to="err"):
    """Run a command, with files as output and errors; return its exit code and the errors."""
    with open(tmp_path / to, "wb") as out, open(tmp_path / errors_to, "wb") as err:
        streams = {"stdout": out, "stderr": err}
        process = Forked(MAIN, *arguments, cwd=tmp_path, env=environment(80), **streams)
        code = process.wait(TIMEOUT_S)
    stderr = "" if errors_to == "/dev/full" else (tmp_path / errors_to).read_text()
    assert "Traceback" not in stderr and "Exception ignored" not in stderr, stderr
    return code, stderr


MAIN = "testbed.cli.entry:main"
FULL = "error: standard output: cannot be written: No space left on device\n"


@pytest.mark.parametrize("command", ["list", "schema"])
def test_full_stream_has_no_traceback(tmp_path, command):
    assert forked(tmp_path, [command], to="/dev/full") == (BAD_INPUT, FULL)


def test_full_errors_have_no_traceback(tmp_path):
    assert forked(tmp_path, ["validate", "missing"], errors_to="/dev/full") == (BAD_INPUT, "")


def test_closed_stream_has_no_traceback(tmp_path):
    error = "error: --json -: standard output is closed\n"
    assert shell(tmp_path, (*TRIM, "--json", "-"), ">&-")[:2] == (BAD_INPUT, error)


def test_ascii_output_has_no_traceback(tmp_path):
    code, _, stdout = shell(tmp_path, TRIM, "", PYTHONIOENCODING="ascii")
    assert code == 0 and b"angle of attack  -0.156? " in stdout


def test_run_with_closed_streams_has_a_whole_log(tmp_path):
    """The log does not get the descriptor of standard error, on which JSBSim prints."""
    flight = ("run", "simulation-3", "--duration=0.2", "--out=out", "--json=x.json")
    assert shell(tmp_path, flight, ">&- 2>&- <&-")[:2] == (0, "")
    call_command("export", "out", "--format", "csv", cwd=tmp_path, code=0, columns=80)
    assert json.loads((tmp_path / "x.json").read_text())["outcome"] == "completed"


def test_json_is_written_though_stdout_is_full(tmp_path):
    assert forked(tmp_path, (*TRIM, "--json=x.json"), to="/dev/full") == (BAD_INPUT, FULL)
    assert json.loads((tmp_path / "x.json").read_text())["aircraft"] == "rascal110"


def test_json_to_dev_stdout_follows_redirection(tmp_path):
    """The file to which standard output is redirected stays the same file."""
    code, _ = forked(tmp_path, (*TRIM, "--json", "/dev/stdout"), to="both")
    text = (tmp_path / "both").read_text()
    assert code == 0 and '"aircraft": "rascal110"' in text and "angle of attack" in text
