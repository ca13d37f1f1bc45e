"""Disks that fail: nothing half-written is taken for whole, and errors name the user's path.

A preloaded library has writes fail after any number of bytes, with any reason. TESTBED_WRITE_ERRORS
sets the number of failures.
"""

import errno
import json
import os
import random
import shutil
import subprocess
import sys
from contextlib import suppress

import pytest
from commands import call_command, environment
from places import SHARED, TESTS

import testbed
from testbed.logs.file_record import RECORD_NAME, foreign_files
from testbed.logs.mcap_file import NO_SAMPLES, LogError
from testbed.logs.read import read_log
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.scenario import load_scenario, set_duration

FAILURES = int(os.environ.get("TESTBED_WRITE_ERRORS", "4"))
ERRORS = (errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
MOST_BYTES = 400_000
OUTPUTS = {
    "run.csv": ("export", "run", "--format", "csv"),
    "run.npz": ("export", "run", "--format", "npz"),
    "run.mat": ("export", "run", "--format", "mat"),
    "run.parquet": ("export", "run", "--format", "parquet"),
    "run.foxglove.mcap": ("export", "run", "--format", "foxglove"),
    "run.plotjuggler.xml": ("export", "run", "--format", "plotjuggler"),
    "named.csv": ("export", "run", "--format", "csv", "--out", "run/named.csv"),
    "report.html": ("report", "run"),
    "it.gif": ("video", "run", "--out=run/it.gif", "--size=100x100", "--to=0.8", "--fps=5"),
}
COMMANDS = {
    LOG_NAME: ("run", "simulation-3", "--duration=0.6", "--quiet", "--out=new"),
    METRICS_NAME: ("recover", "run"),
    "bag.ros2": ("export", "run", "--format", "ros2", "--out", "run/bag.ros2"),
    **OUTPUTS,
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run with those of its exports and its report whose writes fail."""
    folder = tmp_path_factory.mktemp("whole")
    testbed.run(set_duration(load_scenario("simulation-3"), 1.0), out=folder / "run")
    for name in list(COMMANDS)[:FAILURES]:
        if name in OUTPUTS:
            call_command(*OUTPUTS[name], cwd=folder, code=0, columns=200)
    return folder / "run"


@pytest.fixture(scope="module")
def run_failing(tmp_path_factory):
    """Return a function that runs a command whose writes below a folder fail."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("library")
    source, library = SHARED / "failing_writes.c", folder / "failing_writes.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    with (folder / "errors").open("wb") as errors:
        worker = subprocess.Popen(
            [sys.executable, SHARED / "write_error_worker.py"],
            env={**environment(200, TESTS), "LD_PRELOAD": str(library)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )

    def run(number, arguments, folder, error, after):
        values = {"UNDER": folder, "TURN": number, "ERRNO": error, "AFTER": after}
        variables = {f"FAIL_{key}": str(value) for key, value in values.items()}
        request = {"arguments": arguments, "folder": str(folder), "variables": variables}
        print(json.dumps(request), file=worker.stdin, flush=True)
        return json.loads(worker.stdout.readline())

    yield run
    worker.stdin.close()
    worker.wait()
    worker.stdout.close()


def find_fault(whole, folder, output, answer):
    """Return what is wrong after a failure; None: nothing."""
    code, text = answer
    if code not in (0, 2):
        return f"exit code {code}"
    place = "new" if output == LOG_NAME else "run"
    named = text.startswith("error: ") and f"{place}/" in text and ".testbed-" not in text
    if code == 2 and not named:
        return f"the error names no path of the user: {text}"
    if "Traceback" in text:
        return text
    run = folder / place
    if left := [each.name for each in (*folder.iterdir(), *run.glob("*")) if ".part" in each.name]:
        return f"left: {left}"
    for each in run.glob("*"):
        if each.is_file() and each.name != RECORD_NAME and not is_whole(whole, each):
            return f"{each.name} is half-written"
    if foreign := set(foreign_files(run)) - {output if code == 0 else "", RECORD_NAME}:
        return f"are not known as the testbed's: {foreign}"
    return None


def is_whole(whole, path):
    """Whether a file is complete; a log may lack its end, and says so."""
    if path.name == LOG_NAME:
        if path.read_bytes() == cut_log(whole):  # not recovered
            return True
        with suppress(LogError):
            return read_log(path).lost_bytes == 0
        return path.stat().st_size == 0 or NO_SAMPLES in reason(path)
    if path.name == METRICS_NAME:
        return "outcome" in json.loads(path.read_bytes())
    if path.name == SCENARIO_NAME:
        return load_scenario(path).name == "simulation-3"
    if path.name in OUTPUTS:  # the same run gives the same bytes
        return path.read_bytes() == (whole / path.name).read_bytes()
    return False


def cut_log(whole):
    data = (whole / LOG_NAME).read_bytes()
    return data[: len(data) * 3 // 4]


def reason(log):
    with pytest.raises(LogError) as error:
        read_log(log)
    return str(error.value)


def test_failed_writes_leave_whole_files(whole, run_failing, tmp_path):
    codes, faults = [], []
    for number in range(FAILURES):
        rng = random.Random(f"write-errors/{number}")
        output = list(COMMANDS)[number % len(COMMANDS)]
        folder = tmp_path / str(number)
        shutil.copytree(whole, folder / "run")
        if output == METRICS_NAME:  # of a run that was killed
            for each in set((folder / "run").iterdir()) - {folder / "run" / SCENARIO_NAME}:
                each.unlink()
            (folder / "run" / LOG_NAME).write_bytes(cut_log(whole))
        error, after = rng.choice(ERRORS), int(MOST_BYTES ** rng.random()) - 1
        answer = run_failing(number, COMMANDS[output], folder, error, after)
        codes.append(answer[0])
        if fault := find_fault(whole, folder, output, answer):
            faults.append(f"{number}: {output}, {os.strerror(error)} after {after}: {fault}")
        shutil.rmtree(folder)
    print({code: codes.count(code) for code in set(codes)})
    assert not faults, "\n".join(faults)
    assert codes.count(2) > len(codes) // 3  # or nothing failed
