"""Worker processes: killed ones lose no flight but their own, and none outlives its parent."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import golden_scenarios
import pytest
import small_study
import worker_tasks
from cases import in_full
from commands import SEVERAL, environment
from places import SHARED
from waiting import TIMEOUT_S, until

from testbed.core.errors import ExternalProgramLost, InputError
from testbed.pool import dask_workers, flight_pool, local_workers
from testbed.pool.flight_pool import open_flight_pool
from testbed.pool.flight_task import FlightTask
from testbed.runs.stop_request import StopRequest
from testbed.scenario import library

HERE = SHARED
INTERRUPTED = 130
# A script without `if __name__ == "__main__"`: workers must not run it again.
SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import worker_tasks
from testbed.pool import local_workers
from testbed.scenario import library
from testbed.pool.flight_pool import open_flight_pool
from testbed.pool.flight_task import FlightTask
local_workers.run_task = worker_tasks.run_task
try:
    with open_flight_pool(jobs=1) as pool:
        for result in pool.run([FlightTask(0, ("run_for_ever", sys.argv[2]))]):
            print("it ended")
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.fixture
def no_flights(monkeypatch):
    """Processes that run the functions of `worker_tasks`."""
    monkeypatch.setattr("testbed.pool.local_workers.run_task", worker_tasks.run_task)


def has_ended(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    # a zombie counts: its parent has not waited for it
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def test_pool_killed_worker_loses_only_its_task(no_flights, tmp_path):
    """The task is repeated once; all others have their results. A free one is replaced."""
    scenarios = [
        ("echo", "before"),
        ("die_once", str(tmp_path / "mark")),
        ("die",),
        None,
        ("exit_worker",),
        ("describe",),
        ("echo", "after"),
    ]
    tasks = [FlightTask(k, each, "" if each else "an error") for k, each in enumerate(scenarios)]
    with open_flight_pool(jobs=2) as pool:
        results = {each.number: each for each in pool.run(tasks)}
        free = [each for each in pool._workers._free if each]
        for each in free:
            os.kill(*each._processes, signal.SIGKILL)
        until(lambda: all(each._flags.broken for each in free))
        (last,) = pool.run([FlightTask(7, ("describe",))])
    assert sorted(results) == list(range(len(scenarios)))
    assert [results[k].metrics["value"] for k in (0, 1, 6)] == ["before", "again", "after"]
    assert (results[2].outcome, results[2].metrics) == ("failed", None)
    assert results[2].error == "failed: its process was killed 2 times"
    assert (results[3].outcome, results[3].error) == ("invalid", "an error")
    assert (results[4].outcome, results[4].error) == ("failed", "failed: SystemExit: 3")
    worker = results[5].metrics["value"]
    assert set(worker["threads"].values()) == {"1"}
    assert worker["pid"] != os.getpid()
    assert has_ended(last.metrics["value"]["pid"])


class TwoByTwo:
    """Two workers whose tasks end in the order of their start."""

    def __init__(self):
        self.running, self.started = [], []

    def capacity(self):
        if len(self.running) == 2:
            future, task = self.running.pop(0)
            future.set_result(worker_tasks.run_task(task))
        return 2

    def submit(self, task):
        future = Future()
        self.started.append(task.number)
        self.running.append((future, task))
        return future


def test_pool_workers_fly_groups_one_after_another():
    """Each flies a group of its own; one without a new group helps with the last."""
    sizes, workers = {0: 3, 10: 0, 20: 3, 30: 4}, TwoByTwo()
    groups = [[FlightTask(k + i, ("echo", "a")) for i in range(n)] for k, n in sizes.items()]
    flown = flight_pool.FlightPool(workers, lambda: False).run_groups(groups)
    numbers = [next(flown).number for _ in range(9)]
    assert workers.started == [0, 20, 1, 21, 2, 22, 30, 31, 32, 33]
    assert numbers == workers.started[:9]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_pool_worker_ends_with_its_parent(tmp_path, number):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    mark = tmp_path / "mark"
    parent = subprocess.Popen(
        [sys.executable, script, HERE, mark], env=environment(80), stderr=subprocess.PIPE
    )
    try:
        worker = until(lambda: mark.exists() and int(mark.read_text()))
        parent.send_signal(number)
        _, errors = parent.communicate(timeout=TIMEOUT_S)
    finally:
        parent.kill()
    expected = -signal.SIGKILL if number == signal.SIGKILL else INTERRUPTED
    assert parent.returncode == expected, errors
    until(lambda: has_ended(worker))
    assert local_workers._PARENT_POLL_S <= 1.0  # docs/studies.md promises these
    assert local_workers._PARENT_POLL_S + local_workers._GRACE_S <= 6.0
    if number != signal.SIGKILL:
        assert errors == b""


class EndlessTasks:
    """Workers whose tasks never end."""

    def capacity(self):
        return 1

    def submit(self, task):
        return Future()


def test_pool_stops_by_a_signal_handled_after_its_wait():
    """With `queue.SimpleQueue` in place of `queue.Queue` this waits until the alarm."""

    def handle(number, frame):
        time.sleep(3 * flight_pool.POLL_S)  # as on a machine with much other load
        stop.handle(number, frame)

    def fail(number, frame):
        raise AssertionError("the pool still waits")

    stop = StopRequest()
    before = {each: signal.getsignal(each) for each in (signal.SIGUSR1, signal.SIGALRM)}
    signal.signal(signal.SIGUSR1, handle)
    signal.signal(signal.SIGALRM, fail)
    sender = threading.Timer(flight_pool.POLL_S / 2, os.kill, (os.getpid(), signal.SIGUSR1))
    try:
        signal.alarm(10)
        sender.start()
        with pytest.raises(KeyboardInterrupt):
            next(flight_pool.FlightPool(EndlessTasks(), stop).run([FlightTask(0, ("echo", "a"))]))
    finally:
        signal.alarm(0)
        sender.join()
        stop.cancel_notice()
        for number, handler in before.items():
            signal.signal(number, handler)


SAFE = """
import os, sys
import worker_tasks
from testbed.pool import local_workers
from testbed.scenario import library
from testbed.pool.flight_pool import open_flight_pool
from testbed.pool.flight_task import FlightTask
local_workers.run_task = worker_tasks.run_task
with open_flight_pool(jobs=1) as pool:
    (result,) = pool.run([FlightTask(0, ("module_folders",))])
assert os.getcwd() not in result.metrics["value"] and "" not in result.metrics["value"]
assert "PYTHONSAFEPATH" not in os.environ
print("done")
"""
# Of the standard library and of packages that workers and the processes beside them import.
HIDDEN = ("joblib", "multiprocessing", "signal", "random", "numpy", "cloudpickle", "testbed")


def hide(folder):
    """Write modules into a folder that leave a file there when they are imported."""
    for name in HIDDEN:
        (folder / f"{name}.py").write_text(f"open({str(folder / 'ran')!r}, 'a').write('{name} ')")


def test_pool_imports_nothing_from_the_folder(tmp_path):
    hide(tmp_path)
    done = subprocess.run(
        [sys.executable, "-P", "-c", SAFE],
        cwd=tmp_path, env=environment(80, HERE), capture_output=True, text=True,
    )  # fmt: skip
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()
    assert done.stdout == "done\n", done.stderr


OWN = """
extends: own-law-integral
scenario: {name: own}
controller: {law: own:IntegralAction}
"""
STUDY = """
study:
  schema: 1
  name: small
  scenario: own.yaml
  duration_s: 1
  design: factorial
  seeds: [1]
  metrics: [min_separation_m]
vary:
  network.loss: [0, 0.4]
"""
TUNE = """
study: {schema: 1, name: small, scenario: ideal-figure-eight, duration_s: 1, seeds: [1]}
cases: {calm: {}}
gains:
  formation.k: {from: 1, to: 5}
  formation.c: {from: 1, to: 5}
objective: {metric: windows.approach.mean_rms_m, aggregate: mean}
search: {max_flights: 8, population: 4, held_out_seeds: [7, 8, 9]}
"""


COMMANDS = (
    "sweep small.yaml --jobs=1",
    "tune tune.yaml --jobs=1",
    "check exact.yaml --update --reason=first --seeds=3 --jobs=1",
)


@in_full  # the workers are those of `test_pool_imports_nothing_from_the_folder`
def test_commands_import_nothing_from_the_folder(tmp_path):
    """Only the law of a scenario, which lies beside it."""
    hide(tmp_path)
    shutil.copy(library() / "scenarios" / "integral_action.py", tmp_path / "own.py")
    (tmp_path / "own.yaml").write_text(OWN)
    small_study.write(tmp_path, STUDY)
    golden_scenarios.write(tmp_path, "exact")
    (tmp_path / "tune.yaml").write_text(TUNE)
    done = subprocess.run(
        [sys.executable, "-P", "-c", SEVERAL, *COMMANDS],
        cwd=tmp_path, env=environment(80), capture_output=True, text=True,
    )  # fmt: skip
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()
    ends = [line for line in done.stderr.splitlines() if line.startswith("exit ")]
    assert [end.split()[1] for end in ends] == ["0"] * len(COMMANDS), done.stderr + done.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"backend": "ray"}, "write joblib or dask"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "needs --backend dask"),
        ({"backend": "dask"}, "--scheduler tcp://HOST:8786"),
        ({"backend": "dask", "scheduler": "tcp://127.0.0.1:1", "jobs": 2}, "leave --jobs out"),
    ],
)
def test_pool_options_that_exclude_each_other(options, message):
    with pytest.raises(InputError, match=message), open_flight_pool(**options):
        pass


def test_pool_without_dask_names_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match=r"pip install \"formation-testbed\[dask\]\""),
        open_flight_pool(backend="dask", scheduler="tcp://127.0.0.1:1"),
    ):
        pass


def refuse_connection(*_, **__):
    raise OSError("connection refused")


@pytest.mark.parametrize("dask", ["replaced", pytest.param("real", marks=in_full)])
def test_pool_absent_scheduler_is_a_lost_program(dask, monkeypatch):
    """Importing Dask takes a second and a half."""
    if dask == "replaced":
        fake = SimpleNamespace(Client=refuse_connection)
        monkeypatch.setitem(sys.modules, "distributed", fake)
    else:
        pytest.importorskip("distributed", reason="the extra dask of pyproject.toml")
    monkeypatch.setattr(dask_workers, "CONNECT_S", 0.2)
    with (
        pytest.raises(ExternalProgramLost, match="127.0.0.1:1: does not answer"),
        open_flight_pool(backend="dask", scheduler="tcp://127.0.0.1:1"),
    ):
        pass


class LostCluster:
    """A client of a cluster whose scheduler or workers have gone."""

    def __init__(self, workers):
        self.workers = workers

    def nthreads(self):
        return self.workers()

    def submit(self, *task):
        future = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future

    def shutdown(self, wait):
        raise RuntimeError("cannot schedule new futures after shutdown")


@pytest.mark.parametrize(
    ("workers", "words"),
    [
        (refuse_connection, "connection refused"),
        (lambda: {"tcp://1": 1}, "its scheduler has ended"),
        (dict, "no workers for 0 s"),
    ],
)
def test_pool_lost_cluster_is_a_lost_program(workers, words, monkeypatch):
    """Scheduler or workers: exit code 5, and what is to be done."""
    for name in ("FIRST_WORKER_S", "_COUNT_INTERVAL_S"):
        monkeypatch.setattr(dask_workers, name, 0.0)
    cluster = LostCluster(workers)
    lost = dask_workers.DaskWorkers.__new__(dask_workers.DaskWorkers)
    lost._client = lost._executor = cluster
    lost._counted_s, lost._had_workers_s, lost._capacity = -1.0, 0.0, 1
    pool = flight_pool.FlightPool(lost, StopRequest())
    with pytest.raises(ExternalProgramLost, match=f"the cluster is lost.*{words}.*--resume"):
        list(pool.run([FlightTask(0, ("echo", "it"))]))
    lost.shutdown()
