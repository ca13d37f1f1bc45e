"""Who flies many pages: nothing is lost with a process, and none outlives who started it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import crew_tasks
import pytest
from commands import environment
from patience import PATIENCE_S, until

from testbed.errors import InputError
from testbed.study.crew import Task, crew

HERE = Path(__file__).parent
INTERRUPTED = 130
# A script without `if __name__ == "__main__"`: what it starts must not start it again.
SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import crew_tasks
import testbed.study.processes as room
from testbed.study.crew import Task, crew
room.fly = crew_tasks.act
try:
    with crew(jobs=1) as ours:
        for flown in ours.fly([Task(0, ("linger", sys.argv[2]))]):
            print("it ended")
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.fixture
def idle(monkeypatch):
    """Processes that carry out tasks of `crew_tasks`."""
    monkeypatch.setattr("testbed.study.processes.fly", crew_tasks.act)


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    # one that has ended, and that nobody here waits for
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def test_a_killed_process_takes_only_its_own_task_with_it_and_that_once(idle, tmp_path):
    pages = [
        ("say", "before"),
        ("die_once", str(tmp_path / "mark")),
        ("die",),
        "no page",
        ("raise_it",),
        ("tell",),
        ("say", "after"),
    ]
    with crew(jobs=2) as ours:
        flown = {each.number: each for each in ours.fly(map(Task, range(len(pages)), pages))}
        more = list(ours.fly([Task(7, ("tell",)), Task(8, ("tell",))]))
    assert sorted(flown) == list(range(len(pages)))
    assert [flown[k].metrics["said"] for k in (0, 1, 6)] == ["before", "again", "after"]
    assert (flown[2].outcome, flown[2].metrics) == ("failed", None)
    assert flown[2].error == "failed: its process was killed 2 times"
    assert (flown[3].outcome, flown[3].error) == ("cannot be flown", "no page")
    assert (flown[4].outcome, flown[4].error) == ("failed", "failed: SystemExit: 3")
    said = flown[5].metrics["said"]
    assert set(said["threads"].values()) == {"1"}
    assert said["pid"] != os.getpid()
    assert all(gone(each.metrics["said"]["pid"]) for each in more)


@pytest.mark.parametrize("ended_by", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_who_started_it(tmp_path, ended_by):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    mark = tmp_path / "mark"
    parent = subprocess.Popen(
        [sys.executable, script, HERE, mark], env=environment(80), stderr=subprocess.PIPE
    )
    try:
        worker = until(lambda: mark.exists() and int(mark.read_text()))
        parent.send_signal(ended_by)
        _, errors = parent.communicate(timeout=PATIENCE_S)
    finally:
        parent.kill()
    expected = -signal.SIGKILL if ended_by == signal.SIGKILL else INTERRUPTED
    assert parent.returncode == expected, errors
    until(lambda: gone(worker))
    if ended_by != signal.SIGKILL:
        assert errors == b""


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"backend": "ray"}, "write joblib or dask"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "goes with --backend dask"),
        ({"backend": "dask"}, "--scheduler tcp://HOST:8786"),
        ({"backend": "dask", "scheduler": "tcp://127.0.0.1:1", "jobs": 2}, "leave it out"),
    ],
)
def test_a_crew_that_cannot_be_had_is_refused(asked, says):
    with pytest.raises(InputError, match=says), crew(**asked):
        pass


def test_without_dask_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(InputError, match="pip install distributed"),
        crew(backend="dask", scheduler="tcp://127.0.0.1:1"),
    ):
        pass


def test_a_scheduler_that_is_not_there_is_refused(monkeypatch):
    pytest.importorskip("distributed", reason="the extra dask of pyproject.toml")
    monkeypatch.setattr("testbed.study.cluster.CONNECT_S", 0.2)
    with (
        pytest.raises(InputError, match="127.0.0.1:1: nobody answers there"),
        crew(backend="dask", scheduler="tcp://127.0.0.1:1"),
    ):
        pass
