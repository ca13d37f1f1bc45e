"""Ground stations read all parameters of a vehicle through a bad radio, over UDP and as serial.

TESTBED_BAD_LINKS=1 runs them, and what reports of the radio change for four aircraft on it; the
links themselves, also as a serial device, are in tests/link. With pytest -s they print times.
"""

import json
import os
import re
import signal
import time
from contextlib import contextmanager

import pytest
from commands import call_command, environment
from external_run import ROOT, clients, free_port, run_client, start_run
from forked import Forked
from mavproxy import start_mavproxy
from waiting import TIMEOUT_S, until

from testbed.mavlink.tlog import Tlog

ALL = bool(os.environ.get("TESTBED_BAD_LINKS"))
SIK = ROOT / "examples" / "sik-57600.yaml"
LONGEST_S = 60.0
with_all = pytest.mark.skipif(not ALL, reason="TESTBED_BAD_LINKS=1 runs it")


class Link:
    """A link as a program."""

    def __init__(self, process, folder):
        self._process, self._folder = process, folder

    def stop(self):
        """Interrupt it, and return its summary."""
        self._process.send_signal(signal.SIGINT)
        assert self._process.wait(TIMEOUT_S) == 130, (self._folder / "link.txt").read_text()
        return json.loads((self._folder / "link.json").read_text())


@contextmanager
def start_link(folder, a, b, *options):
    folder.mkdir(exist_ok=True)
    command = ["link", a, b, "--json", "link.json"]
    command += ["--tlog", "link.tlog", "--pcap", "link.pcap", *options]
    with (folder / "link.txt").open("w") as output:
        process = Forked(
            *("testbed.cli.main:main", *command),
            cwd=folder,
            env=environment(100),
            stdout=output,
            stderr=output,
        )
        try:
            until(lambda: "link: " in (folder / "link.txt").read_text() or process.poll())
            assert process.poll() is None, (folder / "link.txt").read_text()
            yield Link(process, folder)
        finally:
            process.kill()
            process.wait(TIMEOUT_S)


def lost_of(link):
    """Frames of the vehicle that were offered, and lost by reason."""
    found = link["links"]["b"]["a"]
    return found["sent"], found["lost"]


def parameters_by_mavproxy(folder, kind, *options):
    """Let MAVProxy read all parameters; return how many, after how long, and the link's summary."""
    vehicle, station = free_port(), free_port()
    a, master = f"udpout:127.0.0.1:{station}", f"udpin:127.0.0.1:{station}"
    if kind == "pty":
        a, master = f"pty:{folder / 'radio'}", folder / "radio"
    folder.mkdir(exist_ok=True)
    with (
        start_link(folder, a, f"udpin:127.0.0.1:{vehicle}", *options) as link,
        # the leader alone is on this port
        start_run(folder / "flight", f"--mavlink=udpout:127.0.0.1:{vehicle}+3") as flight,
    ):
        until(lambda: "systems" in flight.output)
        began = time.monotonic()
        with start_mavproxy(folder / "ground", flight, master) as ground:
            ground.see("Received ")
            seconds = time.monotonic() - began
            ground.type("param show RLL_RATE_P")
            ground.see("RLL_RATE_P       0.944")
        return int(re.search(r"Received (\d+) parameters", ground.output)[1]), seconds, link.stop()


def check_records(folder, link):
    """What was recorded at the station's end is a part of what the vehicle sent, and a flight log.

    Args:
        folder: in which the link ran.
        link: its summary.
    """
    sent_by_vehicle, heard = (
        [message for _, message in Tlog(folder / f"link.{end}.tlog")] for end in "ba"
    )
    frames = {message.frame for message in sent_by_vehicle if message.system == 1}
    got = [message.frame for message in heard if message.system == 1]
    arrived = link["links"]["b"]["a"]
    assert set(got) < frames
    assert len(got) == arrived["delivered"] - arrived["on_way_at_end"]
    words = "import", folder / "link.a.tlog", "--system", 1, "--mode", "any"
    call_command(*words, "--out", "it.csv", cwd=folder, code=0, columns=100)
    assert len((folder / "it.csv").read_text().splitlines()) > 20


@with_all
def test_mavproxy_reads_parameters_by_a_serial_radio(tmp_path, capsys):
    count, seconds, link = parameters_by_mavproxy(tmp_path / "it", "pty", "--network", SIK)
    sent, lost = lost_of(link)
    with capsys.disabled():
        print(f"\nMAVProxy, pty, SiK: {count} parameters in {seconds:.1f} s; {sent} frames, {lost}")
    assert count == 76 and seconds < LONGEST_S
    assert 0.0 < lost["lost"] < 0.12 * sent and link["emulator"]["radio_reports"] > 5
    assert link["emulator"]["unread"] == link["emulator"]["not_sent"] == 0
    check_records(tmp_path / "it", link)


@with_all
@pytest.mark.parametrize("kind", ["pty", "udp"])
def test_mavsdk_reads_all_parameters_by_a_radio(kind, tmp_path, capsys):
    vehicle, station, device = free_port(), free_port(), tmp_path / "radio"
    python = clients() / "python"
    script = __file__.replace("test_bad_link", "read_with_mavsdk")
    a, url = f"udpout:127.0.0.1:{station}", f"udpin://127.0.0.1:{station}"
    if kind == "pty":
        a, url = f"pty:{device}", f"serial://{device}:57600"
    with (
        start_link(tmp_path / "link", a, f"udpin:127.0.0.1:{vehicle}", "--network", SIK) as link,
        start_run(tmp_path / "flight", f"--mavlink=udpout:127.0.0.1:{vehicle}+3") as flight,
    ):
        until(lambda: "systems" in flight.output)
        lines = run_client(flight, python, "-u", script, url)
        summary = link.stop()
    found = json.loads(next(each for each in lines.splitlines() if each.startswith("{")))
    sent, lost = lost_of(summary)
    with capsys.disabled():
        print(
            f"\nMAVSDK, {kind}, SiK: {found['count']} parameters in {found['seconds']:.1f} s;",
            end="",
        )
        print(f" {sent} frames, {lost}")
    assert found["count"] == 76 and found["seconds"] < LONGEST_S
    assert lost["lost"] > 0
    if kind == "pty":
        assert summary["emulator"]["radio_reports"] > 5
        assert summary["emulator"]["unread"] == summary["emulator"]["not_sent"] == 0
    check_records(tmp_path / "link", summary)


@with_all
def test_mavproxy_reads_all_parameters_by_udp(tmp_path, capsys):
    times = {}
    for name, options in (("SiK", ("--network", SIK)), ("clean", ("--unit", "frames"))):
        count, times[name], link = parameters_by_mavproxy(tmp_path / name, "udp", *options)
        assert count == 76
        with capsys.disabled():
            print(f"\nMAVProxy, UDP, {name}: {count} parameters in {times[name]:.1f} s; ", end="")
            print(*lost_of(link))
    assert times["clean"] < times["SiK"] < LONGEST_S


@with_all
def test_reports_of_the_radio_empty_its_queue(tmp_path, capsys):
    """Four aircraft on one radio for 40 s: with reports fewer frames are dropped by the queue."""
    dropped = {}
    for radio in ("sik", "null"):
        vehicle = free_port()
        ends = f"udpin:127.0.0.1:{free_port()}", f"udpin:127.0.0.1:{vehicle}"
        with (
            start_link(
                tmp_path / radio,
                *ends,
                "--network",
                SIK,
                "--set",
                f"radio={radio}",
                "--set",
                "network.rate={bit_per_s: 38400, queue_packets: 50}",
            ) as link,  # fmt: skip
            start_run(tmp_path / f"flight-{radio}", f"--mavlink=udpout:127.0.0.1:{vehicle}"),
        ):
            time.sleep(40.0)
            sent, lost = lost_of(link.stop())
        dropped[radio] = lost.get("queue", 0)
        with capsys.disabled():
            print(f"\nfour aircraft, 38.4 kbit/s, radio: {radio}: {sent} frames, {lost}")
    assert dropped["null"] > 200 and dropped["sik"] < 0.5 * dropped["null"]
