"""A web viewer answers on this machine only, for as long as its command runs."""

import contextlib
import http.client
import os
import re
import signal
import socket
import urllib.request
from pathlib import Path

import pytest
from commands import call_command, environment
from forked import Forked
from record_flight import record, run_info, run_samples
from waiting import TIMEOUT_S, until

from testbed.core.errors import InputError
from testbed.views import viewer


def listening(port):
    """List the addresses on which programs listen on a port (Linux)."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    ends = [row[1].split(":") for row in rows if row[3] == viewer.TCP_LISTEN]
    return {address for address, each in ends if int(each, 16) == port}


@contextlib.contextmanager
def command(*arguments, cwd):
    """A command in a process of its own, and the file of its errors; killed if it does not end."""
    read, write = os.pipe()
    with os.fdopen(read) as errors:
        with os.fdopen(write, "w") as theirs:
            process = Forked(
                *("testbed.cli.main:main", *arguments), cwd=cwd, env=environment(99), stderr=theirs
            )
        try:
            yield process, errors
        finally:
            process.kill()


FLIGHT = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"


def ask(port, method, path, **headers):
    """Status of an answer on this machine, its first byte, and the origin that may read it."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT_S)
    body = bytes(5) if method == "POST" else None
    more = {"Content-Type": "application/grpc-web+proto"} if body else {}
    connection.request(method, path, body=body, headers=more | headers)
    answer = connection.getresponse()
    found = answer.status, bool(answer.read(1)), answer.getheader("Access-Control-Allow-Origin")
    connection.close()
    return found


def test_web_viewer_answers_any_host_until_ctrl_c(tmp_path):
    """It listens on this machine alone.

    A page that has this machine's address under its own name (DNS rebinding) reads the flight.
    Pages of other machines under other addresses get no permission to read it.
    """
    record(tmp_path / "run.mcap", run_samples(60), run_info())
    foreign, local = "http://hostile.example", "http://localhost:8000"
    words = ("view", "run.mcap", "--web", "--follow", "uav1")
    with command(*words, cwd=tmp_path) as (process, errors):
        url, access, end = (errors.readline() for _ in range(3))
        page = re.fullmatch(r"view: (http://127\.0\.0\.1:(\d+)/\?url=rerun.*)\n", url)
        ports = [int(each) for each in re.findall(r"-L (\d+):127\.0\.0\.1:\1", access)]
        page_port, port = ports
        assert page_port == int(page[2]) and f"%3A{port}%2Fproxy" in url
        with urllib.request.urlopen(page[1], timeout=TIMEOUT_S) as answer:
            assert answer.status == 200 and b"Rerun" in answer.read()
        assert [listening(each) for each in ports] == [{"0100007F"}] * 2
        assert "Ctrl-C" in end, "the run has been sent"
        name = f"hostile.example:{page_port}"
        assert ask(page_port, "GET", "/", Host=name) == (200, True, None)
        assert ask(port, "POST", FLIGHT, Host=name) == (200, True, None)
        assert ask(port, "POST", FLIGHT, Origin=foreign) == (200, True, None)
        assert ask(port, "POST", FLIGHT, Origin=local) == (200, True, local)
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0
    until(lambda: not any(listening(each) for each in ports))


def test_run_in_web_viewer_stays_until_ctrl_c(tmp_path):
    words = ("run", "simulation-3", "--duration", "0.2", "--view", "web", "--quiet", "--out", "it")
    with command(*words, cwd=tmp_path) as (process, errors):
        lines = [errors.readline() for _ in range(3)]
        assert "until Ctrl-C" in lines[2], lines
        assert (tmp_path / "it" / "metrics.json").is_file(), "the flight is over"
        page = lines[0].removeprefix("view: ").strip()
        assert page.endswith("&theme=dark"), "the viewer's colours suit a dark background"
        with urllib.request.urlopen(page, timeout=TIMEOUT_S) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0


def test_follow_without_a_view_is_a_warning(tmp_path):
    options = ("--duration", "0.1", "--out", "it", "--quiet", "--follow", "uav1")
    done = call_command("run", "simulation-3", *options, cwd=tmp_path, code=0, columns=200)
    assert "--follow uav1: nothing is shown; add --view or --rrd FILE" in done.stderr


def test_web_viewer_takes_free_ports_and_refuses_hosts(monkeypatch):
    with pytest.raises(InputError, match="write 127.0.0.1, or 0.0.0.0"):
        viewer.serve_web_viewer("192.0.2.1").__enter__()
    with socket.create_server((viewer.HOST, 0)) as taken:
        port = taken.getsockname()[1]
        assert viewer._port(viewer.HOST, port) not in (0, port)
    served = viewer.WebViewer(viewer.ANY_HOST, 9090, 9876)
    assert "ssh" not in served.directions[1] and "127.0.0.1" not in served.url
