"""What is opened to programs outside: this machine alone unless asked, and said aloud."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from cases import ALL
from commands import SEVERAL, environment
from forked import run_program

from testbed.mavlink.udp_endpoint import Endpoint, parse_address
from testbed.pool.dask_workers import cluster_notices
from testbed.runs.external_options import ExternalOptions, announcements
from testbed.scenario import load_scenario
from testbed.views import LiveViewer, viewer

KEY = bytes(32)
LOOPBACK = "0100007F", "0" * 24 + "01000000"  # as Linux's tables have it
PORT = 14650


def said(*addresses, page="simulation-3", changes=(), **more):
    options = ExternalOptions(mavlink=tuple(map(parse_address, addresses)), **more)
    return list(announcements(options, load_scenario(page, changes)))


@pytest.mark.parametrize("text", [str(PORT), f"udpout::{PORT}", f"udpin::{PORT}", f"udp::{PORT}"])
def test_link_without_host_is_loopback_and_announced(text):
    address = parse_address(text)
    endpoint = Endpoint(address, lambda: 0.0)
    try:
        with socket.socket(fileno=os.dup(endpoint.fileno())) as ours:
            assert ours.getsockname()[0] == "127.0.0.1"
    finally:
        endpoint.close()
    (line,) = said(text)
    assert line == f"MAVLink: leader to uav3 are systems 1 to 4, {address}, as fast as possible"
    assert f"127.0.0.1:{PORT}" in line


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "example.org"])
@pytest.mark.parametrize(
    ("key", "who"), [(None, "any program that"), (KEY, "any program with the key that")]
)
def test_any_other_address_is_warned_of_by_name(host, key, who):
    first, warning = said(f"udpin:{host}:{PORT}", signing_key=key)
    assert f"udpin:{host}:{PORT}" in first and ("signed" in first) == (key is not None)
    assert (
        warning
        == f"warning: {host} is not only this machine: {who} reaches it can command the aircraft"
    )
    lines = said(str(PORT), f"udpout:{host}:{PORT}", signing_key=key)
    assert [line.startswith("warning") for line in lines] == [False, False, True]


def test_single_flight_opens_no_port():
    assert said() == []


# of a process: `refuse` is its audit hook, which stays until its end
OFFLINE = """
import sys
def refuse(event, arguments):
    if event.startswith("socket."):
        raise AssertionError(f"{event}{arguments}")
sys.addaudithook(refuse)
"""


# drawing all figures takes seconds
ONE_FIGURE = """
import sys
from testbed.reports import figures
figures.MAKERS, sys.argv[1:2] = figures.MAKERS[:1], []
"""


def test_flight_needs_no_network(tmp_path):
    """Neither a socket nor the name of a host, from the first import to the report."""
    commands = ["run simulation-3 --duration=1 --quiet --out=it"]
    files = ["export it --format=csv", "report it"]
    if ALL:
        commands += files
    done = subprocess.run(
        [sys.executable, "-c", OFFLINE + SEVERAL, *commands],
        cwd=tmp_path, env=environment(80), capture_output=True, text=True,
    )  # fmt: skip
    assert re.findall(r"^exit (\d+)", done.stderr, re.M) == ["0"] * len(commands), done.stderr
    if not ALL:  # in a process that has imported everything
        _, _, errors = run_program(OFFLINE + ONE_FIGURE + SEVERAL, *files, folder=tmp_path)
        assert re.findall(r"^exit (\d+)", errors, re.M) == ["0"] * len(files), errors
    _, _, errors = run_program(OFFLINE + "import socket; socket.socket()", folder=tmp_path)
    assert "AssertionError: socket." in errors


@pytest.mark.parametrize(
    ("scheduler", "warned"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://[::1]:8786", False),
        ("10.0.0.4:8786", True),
        ("tcp://cluster.example.org:8786", True),
    ],
)
def test_remote_cluster_is_announced_with_a_warning(scheduler, warned):
    first, *more = cluster_notices(scheduler)
    assert first == f"cluster: {scheduler}"
    assert len(more) == warned
    host = scheduler.removeprefix("tcp://").removesuffix(":8786")
    assert all(each.startswith(f"warning: {host} is another machine") for each in more)


def listening(process):
    """Addresses, as Linux's tables have them, on which a group of processes listens or hears."""
    found = {}
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for row in map(str.split, Path("/proc/net", table).read_text().splitlines()[1:]):
            if row[3] == viewer.TCP_LISTEN or table.startswith("udp"):
                found[f"socket:[{row[9]}]"] = row[1].rpartition(":")[0]
    ours = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            if os.getpgid(int(each.name)) == process:
                links = [os.readlink(link) for link in (each / "fd").iterdir()]
                ours += [found[link] for link in links if link in found]
        except OSError:  # it has ended
            continue
    return ours


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="Linux's tables of sockets")
def test_viewer_is_loopback_and_announced(tmp_path):
    program = viewer.rerun_program()
    with viewer.guarded_viewer(program, "--save", str(tmp_path / "it.rrd")) as (process, port):
        assert process.poll() is None
        addresses = listening(process.pid)
    assert addresses and set(addresses) <= set(LOOPBACK)
    told = LiveViewer(port=port).address
    assert told == f"a Rerun viewer on 127.0.0.1:{port}, which this machine alone reaches"
