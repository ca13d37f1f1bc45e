"""`testbed link` as a program: what it refuses, how it ends, and what it leaves."""

import json
import os
import pty
import signal
import socket
import time
import tty

import pytest
from commands import call_command, environment
from forked import Forked
from link_loop import attitude, free_port
from places import ROOT
from waiting import TIMEOUT_S, until

from testbed.cli.link import NEVER
from testbed.link.emulator import LinkEmulator
from testbed.link.ends import SerialEnd

SIK = ROOT / "examples" / "sik-57600.yaml"


def ends():
    return f"udpin:127.0.0.1:{free_port()}", f"udpout:127.0.0.1:{free_port()}"


def link(*words, cwd, code=0):
    return call_command("link", *words, cwd=cwd, code=code, columns=100)


WRONG = {
    "udpin:127.0.0.1:14550 tcp:1": "'tcp:1' is no end of a link; write udpin:HOST:PORT",
    "A B --network nowhere.yaml": "nowhere.yaml",
    "A B --network wrong.yaml": "wrong.yaml:2:3: network.los: is not a key of this section: did",
    "A B --set network.loss=2": "--set network.loss=2: network.loss: is 2 (write a number",
    "A B --scenario simulation-3": "--scenario and --between go together",
    "A B --between uav1 uav2": "--scenario and --between go together",
    "A B --scenario simulation-3 --between uav1 uav9": "(write two of leader, uav1, uav2, uav3)",
    "A B --scenario simulation-3 --between uav1 uav1": "write two different aircraft",
    "A B --scenario simulation-3 --between uav1 uav2 --network wrong.yaml": "leave one of them out",
    "A B --scenario simulation-3 --between uav1 uav2 --radio sik": "there is no rate from uav1",
    "A B --scenario simulation-3 --between uav1 uav2 --radio sik "
    "--set network.links.uav1.uav2.rate.bit_per_s=57600": "there is no rate from uav2 to uav1",
    "A B --scenario telemetry-radio --between uav1 uav2 --set network.rate.bit_per_s=57600 "
    "--radio sik --unit datagrams": "--radio sik: sends frames, not datagrams",
    "A B --radio sik --unit datagrams --set network.rate.bit_per_s=1e5": "write unit: frames",
    "A pty: --unit datagrams": "a serial line has none; write unit: frames",
    "A B --duration 0": "--duration 0: write a time above 0",
    "A B --seed -1": "--seed: is -1",
    "A B --pcap it.txt": "write a name that ends in .pcap",
    "A B --pcap nowhere/it.pcap": "there is no folder",
    "A A": "another program has this port",
    "A serial:nothing:57600": "serial:nothing:57600: cannot be opened: No such file",
}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_words_are_one_error_line(line, tmp_path):
    (tmp_path / "wrong.yaml").write_text("network:\n  los: 0.1\n")
    a, b = ends()
    words = line.replace("A", a).replace(" B", f" {b}").split()
    words += [] if "--duration" in words else ["--duration", "1"]  # if it is not refused
    done = link(*words, "--quiet", cwd=tmp_path, code=2)
    lines = [each for each in done.stderr.splitlines() if not each.startswith("link:")]
    assert len(lines) == 1 and lines[0].startswith("error: ") and WRONG[line] in lines[0]
    assert [each.name for each in tmp_path.iterdir()] == ["wrong.yaml"]


def test_a_link_ends_after_its_time_with_all_files(tmp_path):
    done = link(
        *ends(), "--network", SIK, "--duration", "0.3", "--json", "it.json", "--pcap", "it.pcap",
        "--tlog", "it.tlog", "--seed", "5", cwd=tmp_path,
    )  # fmt: skip
    document = json.loads((tmp_path / "it.json").read_text())
    names = {f"it.{end}.{kind}" for end in "ab" for kind in ("pcap", "tlog")}
    assert {each.name for each in tmp_path.iterdir()} == {"it.json", *names}
    assert set(document["files"]) == names
    assert (document["seed"], document["unit"], document["radio"]) == (5, "frames", "sik")
    assert 0.3 <= document["duration_s"] < 20.0 and document["emulator"]["processor_share"] < 1.0
    assert "link: a udpin:127.0.0.1:" in done.stderr and NEVER not in done.stderr
    assert "a > b" in done.stdout and "b > a" in done.stdout


def test_the_network_may_be_that_of_two_aircraft(tmp_path):
    link(
        *ends(), "--scenario", "telemetry-radio", "--between", "uav2", "leader", "--duration=0.1",
        "--json", "it.json", "--quiet", cwd=tmp_path,
    )  # fmt: skip
    document = json.loads((tmp_path / "it.json").read_text())
    assert document["ends"] == ["uav2", "leader"] and document["unit"] == "datagrams"


@pytest.mark.parametrize("end", ["udpin:0.0.0.0:{port}", "udpout:192.0.2.1:{port}"])
def test_what_others_reach_is_never_for_flight(end, tmp_path):
    far = end.format(port=free_port())
    done = link(ends()[0], far, "--duration=0.05", cwd=tmp_path)
    assert f"warning: {far}: {NEVER}" in done.stderr.replace("\n", " ")


def test_a_serial_device_that_goes_is_exit_code_5(tmp_path, monkeypatch):
    """With the JSON of what has passed; and it is never for flight."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    run = LinkEmulator.run

    def unplug_and_run(self, *given, **options):
        os.close(ours)
        run(self, *given, **options)

    monkeypatch.setattr(LinkEmulator, "run", unplug_and_run)
    device = f"serial:{os.ttyname(theirs)}:57600"
    done = link(ends()[0], device, "--json", "it.json", cwd=tmp_path, code=5)
    os.close(theirs)
    assert NEVER in done.stderr and "the device is gone" in done.stderr
    assert json.loads((tmp_path / "it.json").read_text())["unit"] == "frames"


def test_a_pseudo_terminal_is_named_and_removed(tmp_path):
    done = link(ends()[0], f"pty:{tmp_path / 'radio'}", "--duration=0.1", cwd=tmp_path)
    assert f"serial device {tmp_path / 'radio'}" in done.stderr.replace("\n", "")
    assert list(tmp_path.iterdir()) == [] and SerialEnd.unread == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_its_json(number, tmp_path):
    a, b = ends()
    command = ["link", a, b, "--json", "it.json", "--tlog=it.tlog"]
    printed, said = tmp_path / "printed.txt", tmp_path / "said.txt"
    with printed.open("w") as stdout, said.open("w") as stderr:
        process = Forked(
            "testbed.cli.main:main", *command, cwd=tmp_path, env=environment(100),
            stdout=stdout, stderr=stderr,
        )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        until(lambda: said.read_text() or process.poll() is not None)
        assert said.read_text().startswith("link: ")
        for number_sent in range(20):
            program.sendto(attitude(number_sent), ("127.0.0.1", int(a.rpartition(":")[2])))
        time.sleep(0.5)
        process.send_signal(number)
        code = process.wait(TIMEOUT_S)
    out, err = printed.read_text(), said.read_text()
    assert code == 130 and "Traceback" not in err, err
    found = json.loads((tmp_path / "it.json").read_text())["links"]["a"]["b"]
    assert found["sent"] == found["delivered"] == 20
    assert "ATTITUDE" in out and (tmp_path / "it.b.tlog").stat().st_size > 500
