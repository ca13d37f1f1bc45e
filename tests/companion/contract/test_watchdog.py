"""What a companion tells systemd, by a real socket; and the unit that starts it."""

import configparser
import os
import re
import shutil
import socket
import subprocess
import uuid

import pytest
from places import ROOT

from testbed.companion.checks import EngagementLimits
from testbed.companion.watchdog import Watchdog
from testbed.scenario.companion_flight import CompanionFlight

UNIT = ROOT / "examples" / "companion.service"
REAL_TIME = ROOT / "examples" / "companion-real-time.conf"


@pytest.fixture(params=["file", "abstract"])
def manager(request, tmp_path):
    """A socket as that of systemd, and its name in $NOTIFY_SOCKET."""
    name = f"testbed-{uuid.uuid4()}"
    path = str(tmp_path / "notify") if request.param == "file" else f"@{name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(path if path.startswith("/") else f"\0{name}")
        listening.settimeout(5)
        yield listening, path


def received(listening):
    """Return what has come."""
    found = []
    listening.setblocking(False)
    while True:
        try:
            found.append(listening.recv(1024).decode())
        except BlockingIOError:
            return found


def test_messages_reach_the_manager(manager):
    listening, path = manager
    watchdog = Watchdog({"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "1000000"})
    watchdog.ready()
    watchdog.status("formation waits:\n not armed")
    for k in range(101):  # two seconds of passes
        watchdog.alive(50.0 + 0.02 * k)
    watchdog.close()
    watchdog.ready()  # nothing, from now on
    found = received(listening)
    assert found[:2] == ["READY=1", "STATUS=formation waits: not armed"]
    assert found[-1] == "STOPPING=1"
    assert set(found[2:-1]) == {"WATCHDOG=1"} and 8 <= len(found[2:-1]) <= 9


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "x"},
        {"WATCHDOG_USEC": "9", "WATCHDOG_PID": "1"},
    ],
)
def test_no_watchdog_is_fed_that_does_not_watch(manager, given):
    listening, path = manager
    watchdog = Watchdog({"NOTIFY_SOCKET": path, **given})
    for k in range(100):
        watchdog.alive(0.1 * k)
    watchdog.close()
    assert received(listening) == ["STOPPING=1"]


def test_own_process_id_is_watched(manager):
    listening, path = manager
    given = {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}
    watchdog = Watchdog({"NOTIFY_SOCKET": path, **given})
    watchdog.alive(0.0)
    watchdog.close()
    assert received(listening) == ["WATCHDOG=1", "STOPPING=1"]


@pytest.mark.parametrize("path", ["", "relative", "/nowhere/notify", "@none-listens"])
def test_a_missing_manager_ends_nothing(path):
    watchdog = Watchdog({"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "1000000"})
    watchdog.ready()
    watchdog.alive(0.0)
    watchdog.close()


def test_a_manager_that_does_not_read_blocks_nothing(manager):
    _, path = manager
    watchdog = Watchdog({"NOTIFY_SOCKET": path})
    for _ in range(2000):  # more than a socket takes
        watchdog.status("x" * 200)
    watchdog.close()


def read(path):
    """Return the sections of a unit; the keys of some stand more than once."""
    found = configparser.RawConfigParser(strict=False, delimiters=("=",), comment_prefixes=("#",))
    found.optionxform = str
    found.read_string(path.read_text(encoding="utf-8"))
    return found


def test_unit_watches_restarts_and_confines():
    unit = read(UNIT)["Service"]
    assert (unit["Type"], unit["WatchdogSec"], unit["Restart"]) == ("notify", "1", "on-failure")
    assert unit["User"] not in ("", "root")
    assert "testbed companion" in unit["ExecStart"] and "--mavlink-key" in unit["ExecStart"]
    confined = ("NoNewPrivileges", "ProtectHome", "PrivateTmp", "RestrictRealtime")
    assert [unit[each] for each in confined] == ["yes"] * 4
    assert unit["ProtectSystem"] == "strict" and unit["DevicePolicy"] == "closed"
    assert unit["CapabilityBoundingSet"] == ""
    # a stop leaves the formation before it ends
    assert float(unit["TimeoutStopSec"]) > 2.5
    # one pass of the loop that is late ends the engagement, not the process
    limits = EngagementLimits(CompanionFlight(), "leader", ("leader",))
    assert float(unit["WatchdogSec"]) > limits.flight.pause_s


def test_unit_has_no_real_time_class_unless_asked():
    assert "CPUSchedulingPolicy" not in read(UNIT)["Service"]
    asked = read(REAL_TIME)["Service"]
    assert asked["CPUSchedulingPolicy"] == "fifo" and asked["RestrictRealtime"] == "no"
    assert 0 < int(asked["LimitRTTIME"]) <= 500_000  # µs without a blocking call
    assert 0 < int(asked["CPUSchedulingPriority"]) <= 20


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing")
def test_systemd_accepts_the_unit(tmp_path):
    """The program and the user of the unit are those of another machine."""
    command = re.compile(r"^ExecStart=(?:.*\\\n)*.*", re.M)
    text, count = command.subn("ExecStart=/bin/true", UNIT.read_text(encoding="utf-8"))
    assert count == 1
    mine = tmp_path / "companion.service"
    mine.write_text(text, encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", str(mine)], capture_output=True, text=True, timeout=60
    )
    problems = [line for line in done.stderr.splitlines() if "companion.service" in line]
    assert not problems
    mine.write_text(text.replace("Type=notify", "Type=notified\nWatchdog=1"), encoding="utf-8")
    wrong = subprocess.run(
        ["systemd-analyze", "verify", str(mine)], capture_output=True, text=True, timeout=60
    )
    assert wrong.stderr.count("companion.service:") >= 2  # control
