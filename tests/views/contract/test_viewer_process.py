"""The processes of viewers: they end with their starter and listen on their own port."""

import os
import select
import signal
import socket
import subprocess
import sys
from types import SimpleNamespace

import pytest
from places import ROOT
from waiting import TIMEOUT_S, until

from testbed.core.errors import InputError
from testbed.views import viewer
from testbed.views.rerun_backend import remote


@pytest.fixture(autouse=True)
def long_timeouts(monkeypatch):
    """Allow for a busy machine, where programs start late."""
    monkeypatch.setattr(viewer, "START_S", TIMEOUT_S)


def stub(path, text):
    """Write a program that replaces the viewer."""
    path.write_text(text)
    path.chmod(0o755)
    return str(path)


def read_line(descriptor):
    """Read from a pipe; empty bytes when all writers have ended."""
    assert select.select([descriptor], [], [], TIMEOUT_S)[0], "no data, and no end of the writers"
    return os.read(descriptor, 100)


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_guarded_viewer_ends_with_killed_starter(tmp_path, ending):
    # like the viewer's own program, a script that runs another program
    alive = tmp_path / "alive"
    os.mkfifo(alive)
    program = stub(tmp_path / "rerun", f"#!/bin/sh\nexec 3> {alive}\necho up >&3\nsleep 600\n")
    scratch = tmp_path / "scratch"
    (scratch / "deep").mkdir(parents=True)
    code = (
        "import time; from testbed.views.viewer import launch\n"
        f"viewer = launch({program!r}, 1, guarded=True, folder={str(scratch)!r})\n"
        "time.sleep(600)"
    )
    reader = os.open(alive, os.O_RDONLY | os.O_NONBLOCK)
    starter = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    try:
        assert read_line(reader) == b"up\n"
        starter.send_signal(ending)
        starter.wait(TIMEOUT_S)
        assert read_line(reader) == b"", "all processes with the pipe's other end have ended"
        until(lambda: not scratch.exists())  # a moment later
    finally:
        os.close(reader)
        starter.kill()
        starter.wait()


LISTENER = """#!{python} -IS
import socket, sys, time
listener = socket.socket()
try:
    listener.bind(("127.0.0.1", int(sys.argv[sys.argv.index("--port") + 1])))
except OSError:
    {otherwise}
listener.listen()
time.sleep(600)
"""


@pytest.mark.parametrize("otherwise", ["sys.exit(0)", "time.sleep(600)"])
def test_guarded_viewer_on_taken_port_tries_another(tmp_path, monkeypatch, otherwise):
    program = stub(tmp_path / "rerun", LISTENER.format(python=sys.executable, otherwise=otherwise))
    with socket.create_server((viewer.HOST, 0)) as taken:
        ports = [taken.getsockname()[1], viewer.free_port()]
        monkeypatch.setattr(viewer, "free_port", iter(ports).__next__)
        with viewer.guarded_viewer(program) as (process, port):
            assert port == ports[1] and process.poll() is None
        assert process.poll() is not None
        until(lambda: not viewer.is_listening(port))


def test_headless_viewer_not_starting_raises_once(tmp_path, monkeypatch):
    program = stub(tmp_path / "rerun", f"#!/bin/sh\necho >> {tmp_path}/starts\nexit 1\n")
    monkeypatch.setattr(viewer, "rerun_program", lambda: program)
    with pytest.raises(InputError, match="Vulkan"), viewer.headless_viewer((640, 400)):
        pass
    assert (tmp_path / "starts").read_text() == "\n"


def test_headless_viewer_over_limit_raises(tmp_path, monkeypatch):
    program = stub(tmp_path / "rerun", LISTENER.format(python=sys.executable, otherwise="pass"))
    monkeypatch.setattr(viewer, "rerun_program", lambda: program)
    with (
        pytest.raises(InputError, match="does not answer"),
        viewer.headless_viewer((640, 400), limit_s=0.2) as port,
    ):
        until(lambda: not viewer.is_listening(port))
        raise RuntimeError("the error of a client whose viewer has ended")


def test_viewer_ending_after_it_listens_has_no_driver(tmp_path, monkeypatch):
    """As without a Vulkan driver: its client then has a connection error."""
    brief = LISTENER.replace("time.sleep(600)", "time.sleep(1.0)")
    program = stub(tmp_path / "rerun", brief.format(python=sys.executable, otherwise="pass"))
    monkeypatch.setattr(viewer, "rerun_program", lambda: program)
    with (
        pytest.raises(viewer.ViewerUnavailableError, match="Vulkan"),
        viewer.headless_viewer((640, 400)) as port,
    ):
        until(lambda: not viewer.is_listening(port))
        raise ConnectionError("transport error")


def test_error_beside_running_viewer_stays_as_it_is(tmp_path, monkeypatch):
    program = stub(tmp_path / "rerun", LISTENER.format(python=sys.executable, otherwise="pass"))
    monkeypatch.setattr(viewer, "rerun_program", lambda: program)
    monkeypatch.setattr(viewer, "END_S", 0.1)
    with pytest.raises(PermissionError, match="of a file"), viewer.headless_viewer((640, 400)):
        raise PermissionError("of a file")


def test_pause_at_retries_after_timeouts(monkeypatch):
    line = SimpleNamespace(name=remote.TIMELINE, end=5_000_000_000)
    state = SimpleNamespace(recordings=[SimpleNamespace(store_id="of run-1", timelines=[line])])
    answers, calls = iter([TimeoutError(), TimeoutError(), state]), []

    def get_state():
        answer = next(answers)
        if isinstance(answer, TimeoutError):
            raise answer
        return answer

    client = SimpleNamespace(
        get_state=get_state, set_time=lambda *_, **keywords: calls.append(keywords)
    )
    monkeypatch.setattr(remote.ViewerClient, "connect", lambda address: client)
    remote.RemoteViewer(1, "run-1").pause_at(5.0, TIMEOUT_S)
    assert calls == [{"duration": 5.0, "play_state": "paused"}]
