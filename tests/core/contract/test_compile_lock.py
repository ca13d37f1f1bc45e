"""Of several processes one compiles the kernels; the others wait, and print that once."""

import os
import threading
import time

import pytest
from commands import ROOT, call_command
from fresh import run_fresh
from waiting import TIMEOUT_S, until
from worker_tasks import run_task

from testbed.core.compile import compile_turn, is_compiling, notice
from testbed.pool.flight_pool import FlightPool
from testbed.pool.flight_task import FlightTask
from testbed.runs.stop_request import RunStopped

# In one process or two of them, prepares an entry, and prints whether it was compiled and what the
# progress was.
PREPARE = """
import os, time
from functools import partial
from testbed.core.compile import compiling, prepare
from slow_kernel import slow

begin, other = time.time() + 0.2, os.fork() if {two} else 0
seen, compiled = [], []
with compiling(lambda: compiled.append(1)):
    while time.time() < begin:
        time.sleep(0.001)
    prepare([(slow, (1.0,))], lambda done, total: seen.append((done, total)))
print(len(compiled), seen, flush=True)
if other:
    os.waitpid(other, 0)
"""
KERNEL = "from testbed.core.compile import entry\n\n@entry\ndef slow(x):\n" + "".join(
    f"    x += (x + {k}.0) ** 0.5 if x > {k}.0 else x ** {k}\n" for k in range(20)
)


def test_of_two_processes_one_compiles(tmp_path):
    """The other waits, says so like the first, and loads the machine code."""
    (tmp_path / "slow_kernel.py").write_text(KERNEL + "    return x\n")
    (tmp_path / "cache").mkdir()
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def prepare(*, two):
        options = {"folder": tmp_path, "paths": [ROOT, tmp_path], "env": environment}
        code, output, errors = run_fresh(PREPARE.format(two=two), **options)
        assert code == 0, errors
        return sorted(output.splitlines())

    first, second = prepare(two=True)
    assert first[0] == "0" and second == "1 [(0, 1), (1, 1)]"
    assert first in ("0 [(0, 1), (1, 1)]", "0 []")
    assert prepare(two=False) == ["0 []"]


def test_compiling_is_seen_by_others_until_it_ends(tmp_path):
    assert not is_compiling(tmp_path) and not is_compiling(None)
    with compile_turn(tmp_path, ["a"]) as announce:
        assert not is_compiling(tmp_path)
        announce()
        assert is_compiling(tmp_path)
    assert not is_compiling(tmp_path)


def test_a_turn_is_waited_for_only_the_first_time(tmp_path):
    order = []

    def prepare():
        with compile_turn(tmp_path, ["a"], lambda: order.append("waits")):
            order.append("second")

    with compile_turn(tmp_path, ["a"]) as announce:
        announce()
        other = threading.Thread(target=prepare)
        other.start()
        until(lambda: order == ["waits"])
        order.append("first")
    other.join(TIMEOUT_S)
    assert order == ["waits", "first", "second"]
    with compile_turn(tmp_path, ["b"]):
        prepare()
    assert order[3:] == ["second"]


def test_wait_for_turn_can_be_stopped(tmp_path):
    def stop():
        raise RunStopped

    with compile_turn(tmp_path, ["a"]) as announce:
        announce()
        with pytest.raises(RunStopped), compile_turn(tmp_path, ["a"], check=stop):
            pass


def test_a_folder_that_cannot_be_written_locks_nothing(tmp_path):
    for folder in (None, tmp_path / "missing"):
        with compile_turn(folder, ["a"]) as announce:
            announce()
        assert not is_compiling(folder)


class OneThread:
    """A pool of one worker, which is a thread of this process."""

    def capacity(self):
        return 1

    def lost_worker(self, error):
        return False

    def shutdown(self):
        pass

    def submit(self, task):
        from concurrent.futures import ThreadPoolExecutor

        return ThreadPoolExecutor(1).submit(task.scenario, task)


def test_a_pool_reports_compiling_once(tmp_path, monkeypatch):
    monkeypatch.setattr("testbed.pool.flight_pool.cache_folder", lambda: tmp_path)
    lines = []

    def fly(task):
        with compile_turn(tmp_path, [str(task.number)]) as announce:
            announce()
            until(lambda: len(lines) == 1)
            time.sleep(0.3)  # some looks of the pool
        return run_task(FlightTask(task.number, ("echo", "flown")))

    pool = FlightPool(OneThread(), lambda: False, lines.append)
    results = list(pool.run([FlightTask(0, fly), FlightTask(1, fly)]))
    assert [each.metrics["value"] for each in results] == ["flown", "flown"]
    assert lines == [notice()]


def test_run_prints_that_it_compiles(tmp_path, monkeypatch):
    """Without a terminal it is one line of standard error; --quiet leaves it out."""

    def prepare(kernels, progress, check):
        if progress:
            for done in (0, 1, 2):
                progress(done, 2)

    monkeypatch.setattr("testbed.flight.loop.prepare", prepare)
    arguments = ("run", "ideal-figure-eight", "--duration", "1")
    done = call_command(*arguments, cwd=tmp_path, code=0, columns=80)
    assert done.stderr.splitlines().count(notice()) == 1
    done = call_command(*arguments, "--quiet", cwd=tmp_path, code=0, columns=80)
    assert notice() not in done.stderr
