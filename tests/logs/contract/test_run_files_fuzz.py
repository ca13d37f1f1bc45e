"""Run directories with anything in them: no file of the user is lost, nothing waits, no traceback.

TESTBED_RUN_DIRECTORIES sets the number of directories, which are counted from 0 and repeatable.
"""

import hashlib
import json
import os
import random
import re
import shutil
import stat
import tempfile
import traceback
from collections import Counter

import pytest
from commands import call
from record_flight import event, record, run_info, run_samples
from written_runs import time_limit

from testbed.logs.file_record import RECORD_NAME, TAIL_NAME, record_files
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.metrics.document import to_json
from testbed.metrics.observer import MetricsObserver
from testbed.reports import figures

DIRECTORIES = int(os.environ.get("TESTBED_RUN_DIRECTORIES", "6"))
LIMIT_S = 120.0  # of a command on a busy machine: only a command that waits takes so long
OURS = (LOG_NAME, METRICS_NAME, SCENARIO_NAME, "law.py", "run.csv", RECORD_NAME)
FOREIGN = (
    *("analysis.py", "run.notes.md", "report.html", "run.npz", "run.tlog", "run.ros2/notes"),
    *(TAIL_NAME, ".testbed-abcdefgh.part", "figures/a.png", "run.\udcff", "-", "a\nb", "\x1b[31m"),
    "n" * 250,
)
COMMANDS = (
    ("list", "--runs", "logs", "--json=-"),
    ("export", "{}", "--format", "csv"),
    ("export", "{}", "--format", "plotjuggler"),
    ("export", "{}", "--format", "ros2"),
    ("recover", "{}"),
    ("report", "{}"),
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run as the testbed writes it, with an export."""
    run = tmp_path_factory.mktemp("whole") / "run"
    run.mkdir()
    info = run_info(1, code={"law.py": b"class Law: ...\n"})
    meter = MetricsObserver()
    meter.begin(info)
    for sample in run_samples(30, 1, events=[event(3)]):
        meter.observe(sample)
    metrics = {**meter.summary(), "outcome": "completed"}
    metrics |= {"wall_s": 1.2, "real_time_factor": 1.0}
    record(run / LOG_NAME, run_samples(30, 1, events=[event(3)]), info, summary=metrics)
    (run / "law.py").write_bytes(info.code["law.py"])
    (run / SCENARIO_NAME).write_text(info.scenario_yaml)
    (run / METRICS_NAME).write_text(to_json(metrics))
    (run / "run.csv").write_text("an export\n")
    record_files(run, *OURS[:-1])
    return run


def contents(folder):
    """Files below a folder, as they are: kind, and digest or target, by path."""
    found = {}
    for here, folders, files in os.walk(folder):
        for name in (*files, *folders):
            path = os.path.join(here, name)
            mode = os.lstat(path).st_mode
            if stat.S_ISREG(mode):
                with open(path, "rb") as file:
                    found[path] = hashlib.sha256(file.read()).hexdigest()
            elif not stat.S_ISDIR(mode):
                found[path] = os.readlink(path) if stat.S_ISLNK(mode) else stat.S_IFMT(mode)
    return found


def add(run, rng):
    """Add a file of the user, which may have the content of one of the testbed's."""
    path = run / rng.choice(FOREIGN)
    path.parent.mkdir(exist_ok=True)
    own = (run / LOG_NAME).read_bytes() if (run / LOG_NAME).is_file() else b""
    if not os.path.lexists(path):
        path.write_bytes(rng.choice([b"", b"mine\n", rng.randbytes(50), own]) + b"!")


def replace(run, rng):
    """Put something of the user in the place of a file of the testbed."""
    path = run / rng.choice(OURS)
    if path.is_dir() or not path.is_file():
        return
    mine = run.parent / f"mine-{rng.randrange(10**9)}"
    mine.write_bytes(b"mine\n")
    path.unlink()
    rng.choice(
        [
            lambda: path.symlink_to(mine),
            lambda: path.hardlink_to(mine),
            lambda: path.symlink_to("nowhere"),
            lambda: os.mkfifo(path),
            lambda: (path.mkdir(), (path / "mine").write_text("mine")),
            lambda: path.write_text("mine\n"),
        ]
    )()


def edit(run, rng):
    """Change a byte of a text, or a number to one that is absurd."""
    path = run / rng.choice([METRICS_NAME, SCENARIO_NAME, "law.py", "run.csv"])
    if path.is_file():
        data = path.read_bytes()
        at = rng.randrange(len(data) + 1)
        digits = rng.choice([b"9" * 400, b"9" * 5000, b"1e999", b"NaN", b"\xff", b"\\ud800"])
        numbers = [each.span() for each in re.finditer(rb"\d+(\.\d+)?", data)] or [(at, at)]
        first, last = rng.choice(numbers)
        duration = re.search(rb'(?<="simulated_s": )[\d.]+', data)
        if duration and rng.random() < 0.5:
            first, last = duration.span()
        new = rng.choice([data[:at] + b"#" + data[at + 1 :], data[:first] + digits + data[last:]])
        path.unlink()
        path.write_bytes(new)


def break_record(run, rng):
    path = run / RECORD_NAME
    if path.is_file():
        data = path.read_bytes()
        lines = data.splitlines(keepends=True)
        rng.shuffle(lines)
        names = data.replace(b'"run.csv"', json.dumps(rng.choice(FOREIGN)).encode())
        absurd = data.replace(b'"size": ', b'"size": 9' + b"9" * rng.choice([1, 400, 5000]))
        cut = data[: rng.randrange(len(data) + 1)]
        path.write_bytes(rng.choice([cut, b"".join(lines), names, absurd, data * 2]))


def drop(run, rng):
    path = run / rng.choice(OURS)
    if path.is_file():
        path.unlink()


def cut(run, rng):
    if (run / LOG_NAME).is_file():
        os.truncate(run / LOG_NAME, rng.randrange((run / LOG_NAME).stat().st_size + 1))


def move_times(run, rng):
    for each in list(run.iterdir()):
        if each.is_file():
            os.utime(each, ns=(0, rng.choice([0, -(10**18), 10**18, 9 * 10**18])))


CHANGES = (add, add, replace, replace, edit, edit, break_record, drop, cut, move_times)


def is_users(path, digest, originals):
    """Whether a file is the user's: neither as the testbed wrote it nor its record, log or part."""
    name = os.path.basename(path)
    if digest in originals and originals[digest] == name:
        return False
    if isinstance(digest, str) and os.path.isfile(path) and not os.path.islink(path):
        with open(path, "rb") as file:
            head = file.read(8)
        log = b"\x89MCAP0\r\n".startswith(head[:8])
        if name == LOG_NAME and log:
            return False
        if name == RECORD_NAME:
            return False
    return True


def run_all(folder, run, rng):
    """Run commands over the directory; return the faults and the exit codes."""
    codes = []
    words = [
        ("list", "--runs", "logs"),
        [each.format(run) for each in rng.choice(COMMANDS)],
        ("prune", "logs", "--keep=1"),
        ("prune", "logs", "--size=0kB", "--yes"),
    ]
    for arguments in words:
        with tempfile.TemporaryFile("w+", errors="replace") as out:
            try:
                with time_limit(LIMIT_S):
                    code = call(arguments, cwd=folder, columns=200, out=out, err=out)
            except BaseException:
                return [f"{arguments}: {traceback.format_exc()}"], codes
            out.seek(0)
            text = out.read()
            codes.append(code)
            if code not in (0, 2) or "Traceback" in text:
                return [f"{arguments}: exit code {code}: {text}"], codes
    return [], codes


def make_directory(number, folder, whole):
    """Make the changed run of a number in a folder, beside one that is as written."""
    rng = random.Random(f"run-files/{number}")
    scenario = rng.choice(["near", os.fsdecode(b"n\xff"), "a b", "-n"])
    run = folder / "logs" / scenario / "20260101T000000Z-0001"
    shutil.copytree(whole, run)
    shutil.copytree(whole, folder / "logs" / "near" / "20260102T000000Z-0001")
    if rng.random() < 0.3:
        (run / RECORD_NAME).unlink()
    for change in rng.choices(CHANGES, k=rng.choice([0, 1, 1, 2, 4])):
        change(run, rng)
    return run, rng


def test_no_file_of_the_user_is_lost(whole, tmp_path, monkeypatch):
    if DIRECTORIES < 100:  # figures take most of the time, and are within the report's file
        monkeypatch.setattr(figures, "MAKERS", ())
    originals = {digest: os.path.basename(path) for path, digest in contents(whole).items()}
    codes, faults, pruned = Counter(), [], 0
    for number in range(DIRECTORIES):
        folder = tmp_path / str(number)
        run, rng = make_directory(number, folder, whole)
        before = contents(folder)
        mine = {path for path, digest in before.items() if is_users(path, digest, originals)}
        found, seen = run_all(folder, run, rng)
        codes.update(seen)
        after = contents(folder)
        found += [f"{path} is lost or changed" for path in mine if after.get(path) != before[path]]
        if (folder / "logs" / "near" / "20260102T000000Z-0001").exists():
            found.append("the run as written was not deleted")
        faults += [f"{number}: {each}" for each in found]
        pruned += not run.exists()
        shutil.rmtree(folder)
    print(dict(codes), f"{pruned} of {DIRECTORIES} changed runs deleted")
    assert not faults, "\n".join(faults[:20])
    assert 0 < pruned < DIRECTORIES
