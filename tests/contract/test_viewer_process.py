"""A viewer of a picture ends with whoever started it, and listens where it was told to."""

import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from patience import PATIENCE_S, until

from testbed.errors import InputError
from testbed.views import viewer
from testbed.views.rerun_door import remote


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """On a busy machine programs may begin late."""
    monkeypatch.setattr(viewer, "START_S", PATIENCE_S)


def stub(path, text):
    """A program in place of the viewer."""
    path.write_text(text)
    path.chmod(0o755)
    return str(path)


def read_line(descriptor):
    """What comes through a pipe; nothing when all who could write have ended."""
    assert select.select([descriptor], [], [], PATIENCE_S)[0], "nothing came, and nobody ended"
    return os.read(descriptor, 100)


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_a_viewer_and_its_scratch_files_go_when_its_starter_is_killed(tmp_path, ending):
    # as with the viewer's own program, a script round another program
    alive = tmp_path / "alive"
    os.mkfifo(alive)
    program = stub(tmp_path / "rerun", f"#!/bin/sh\nexec 3> {alive}\necho up >&3\nsleep 600\n")
    scratch = tmp_path / "scratch"
    (scratch / "deep").mkdir(parents=True)
    code = (
        "import time; from testbed.views.viewer import launched\n"
        f"viewer = launched({program!r}, 1, tether=True, folder={str(scratch)!r})\n"
        "time.sleep(600)"
    )
    reader = os.open(alive, os.O_RDONLY | os.O_NONBLOCK)
    starter = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[2])
    try:
        assert read_line(reader) == b"up\n"
        starter.send_signal(ending)
        starter.wait(PATIENCE_S)
        assert read_line(reader) == b"", "all that held the pipe's other end are gone"
        until(lambda: not scratch.exists())  # in a moment, not at once
    finally:
        os.close(reader)
        starter.kill()
        starter.wait()


LISTENER = """#!{python} -IS
import socket, sys, time
door = socket.socket()
try:
    door.bind(("127.0.0.1", int(sys.argv[sys.argv.index("--port") + 1])))
except OSError:
    {otherwise}
door.listen()
time.sleep(600)
"""


@pytest.mark.parametrize("otherwise", ["sys.exit(0)", "time.sleep(600)"])
def test_a_port_that_somebody_else_takes_is_not_mistaken_for_the_viewer(
    tmp_path, monkeypatch, otherwise
):
    program = stub(tmp_path / "rerun", LISTENER.format(python=sys.executable, otherwise=otherwise))
    with socket.create_server((viewer.HOST, 0)) as taken:
        ports = [taken.getsockname()[1], viewer.free_port()]
        monkeypatch.setattr(viewer, "free_port", iter(ports).__next__)
        with viewer.tethered(program) as (process, port):
            assert port == ports[1] and process.poll() is None
        assert process.poll() is not None
        until(lambda: not viewer.listening(port))


def test_a_viewer_that_does_not_start_is_not_tried_again(tmp_path, monkeypatch):
    program = stub(tmp_path / "rerun", f"#!/bin/sh\necho >> {tmp_path}/starts\nexit 1\n")
    monkeypatch.setattr(viewer, "program", lambda: program)
    with pytest.raises(InputError, match="Vulkan"), viewer.headless((640, 400)):
        pass
    assert (tmp_path / "starts").read_text() == "\n"


def test_a_viewer_that_is_ended_in_the_midst_is_not_waited_for(tmp_path, monkeypatch):
    program = stub(tmp_path / "rerun", LISTENER.format(python=sys.executable, otherwise="pass"))
    monkeypatch.setattr(viewer, "program", lambda: program)
    with (
        pytest.raises(InputError, match="does not answer"),
        viewer.headless((640, 400), limit_s=0.2) as port,
    ):
        until(lambda: not viewer.listening(port))
        raise RuntimeError("what a client says when its viewer is gone")


def test_a_viewer_that_is_too_busy_to_answer_is_asked_again(monkeypatch):
    line = SimpleNamespace(name=remote.TIMELINE, end=5_000_000_000)
    there = SimpleNamespace(recordings=[SimpleNamespace(store_id="of run-1", timelines=[line])])
    answers, told = iter([TimeoutError(), TimeoutError(), there]), []

    def get_state():
        answer = next(answers)
        if isinstance(answer, TimeoutError):
            raise answer
        return answer

    client = SimpleNamespace(get_state=get_state, set_time=lambda *_, **what: told.append(what))
    monkeypatch.setattr(remote.ViewerClient, "connect", lambda address: client)
    remote.Remote(1, "run-1").stop_at(5.0, PATIENCE_S)
    assert told == [{"duration": 5.0, "play_state": "paused"}]
