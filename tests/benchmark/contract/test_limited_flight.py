"""A stranger's program: ended by its limits, and without its parent's links."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cases import in_full

from testbed.benchmark.limited_flight import MAX_RESULT_BYTES, FlightLimits, run_limited

LIMITS = FlightLimits(cpu_s=1, wall_s=20, memory_bytes=300_000_000)


def wait_for_end(pid):
    """Wait until a process has ended, or is a zombie of another parent."""
    for _ in range(100):
        try:
            state = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False


def test_data_comes_back():
    found = run_limited(lambda folder: {"here": folder.is_dir(), "one": 1.5}, LIMITS)
    assert found.value == {"here": True, "one": 1.5}
    assert (found.failure, found.text) == ("", "")


def test_a_program_that_never_returns_is_ended():
    def work(folder):
        while True:
            pass

    found = run_limited(work, LIMITS)
    assert (found.value, found.failure) == (None, "time")
    assert "1 s of processor time" in found.text


@in_full  # it takes 2 s; without the hard limit the one by the clock, tested below, ends it
def test_a_program_that_ignores_the_soft_limit_ends():
    def work(folder):
        signal.signal(signal.SIGXCPU, signal.SIG_IGN)
        while True:
            pass

    assert run_limited(work, LIMITS).failure == "time"


def test_a_program_that_waits_is_ended():
    started = time.monotonic()
    found = run_limited(lambda folder: time.sleep(60), FlightLimits(cpu_s=5, wall_s=1))
    assert (found.failure, found.text) == ("time", "did not end within 1 s by the clock")
    assert time.monotonic() - started < 10


def test_a_program_cannot_take_all_memory():
    found = run_limited(lambda folder: bytes(400_000_000), LIMITS)
    assert found.failure == "memory"
    assert run_limited(lambda folder: len(bytes(100_000_000)), LIMITS).value == 100_000_000


def test_a_crash_is_named():
    def crash(folder):
        os.kill(os.getpid(), 11)

    found = run_limited(crash, LIMITS)
    assert (found.failure, found.text) == ("crash", "ended by SIGSEGV")


@pytest.mark.parametrize("error", [ValueError("no"), SystemExit(0), KeyboardInterrupt()])
def test_every_exception_is_one(error):
    def fail(folder):
        raise error

    found = run_limited(fail, LIMITS)
    assert found.failure == "exception"
    assert type(error).__name__ in found.text


def test_an_end_without_a_result_is_a_crash():
    assert run_limited(lambda folder: os._exit(0), LIMITS).failure == "crash"


def test_what_is_no_json_is_no_result():
    assert run_limited(lambda folder: float("nan"), LIMITS).failure == "crash"
    assert run_limited(lambda folder: object(), LIMITS).failure == "crash"


def test_a_result_is_bounded():
    found = run_limited(lambda folder: "x" * (2 * MAX_RESULT_BYTES), LIMITS)
    assert (found.value, found.failure) == (None, "crash")


def test_programs_that_it_starts_end_with_it(tmp_path):
    note = tmp_path / "pid"

    def work(folder):
        sleep = [sys.executable, "-c", "import time; time.sleep(100)"]
        note.write_text(str(subprocess.Popen(sleep).pid))
        return 1

    assert run_limited(work, LIMITS).value == 1
    assert wait_for_end(int(note.read_text()))


def test_it_has_no_links_of_its_parent():
    """Pipes of a worker to its parent are closed; pickles come through them."""
    read, write = os.pipe()

    def work(folder):
        return sorted(int(each) for each in os.listdir("/proc/self/fd"))

    found = run_limited(work, LIMITS).value
    os.close(read)
    os.close(write)
    # input, output, error, the pipe of the result, and the folder that is listed
    assert len(found) == 5


def test_limits_are_those_of_the_copy_alone(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_CPU), resource.getrlimit(resource.RLIMIT_AS)

    def work(folder):
        (folder / "large").write_bytes(bytes(2000))
        return os.getcwd() == str(folder)

    assert run_limited(work, LIMITS).value is True
    small = FlightLimits(cpu_s=1, wall_s=20, memory_bytes=300_000_000, file_bytes=1000)
    assert run_limited(work, small).failure in ("crash", "exception")
    assert (
        resource.getrlimit(resource.RLIMIT_CPU),
        resource.getrlimit(resource.RLIMIT_AS),
    ) == before


def test_a_file_can_be_opened_and_written(tmp_path):
    """The limits are no sandbox, and the text of SECURITY.md has that."""
    text = (Path(__file__).parents[3] / "SECURITY.md").read_text("utf-8")
    assert "with limits of time and memory, which is no sandbox" in " ".join(text.split())
    target = tmp_path / "opened"
    assert run_limited(lambda folder: target.write_text("x"), LIMITS).value == 1
    assert target.read_text() == "x"
