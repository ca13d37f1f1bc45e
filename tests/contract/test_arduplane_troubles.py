"""ArduPlane as an autopilot, by a stand-in: what goes wrong, and what is said of it."""

import socket
import struct
import time

import pytest
from arduplanes import FIRST, PAGE, SOON, binary, complaint, level, page
from patience import PATIENCE_S

import testbed
from testbed.ardupilot.process import find_binary
from testbed.errors import InputError, PartnerLost
from testbed.scenario import ScenarioError, load
from testbed.sim.world import build

assert binary  # a fixture


EXIT = ("ended with exit code 3", "it last printed:", "    stand-in: PANIC: out of cheese")
SILENT = ("is silent: nothing in 2 s (autopilot.patience_s)", "stand-in: thinking")
BOOT = 60  # packets


class Hanging:
    """A clock that begins to go when the stand-in hangs: its start may take any time."""

    sleep = staticmethod(time.sleep)

    def __init__(self, folders):
        self.folders, self.since = folders, None

    def monotonic(self):
        now = time.monotonic()
        logs = self.folders.glob("*/arduplane.log")
        if self.since is None and any("thinking" in each.read_text() for each in logs):
            self.since = now
        return 0.0 if self.since is None else now - self.since


@pytest.mark.parametrize(
    ("trouble", "at", "said"),
    [
        ("exit", BOOT, EXIT),
        ("exit", SOON, EXIT),
        ("crash", SOON, ("was ended by signal 11", "JSON received:")),
        ("wrong-magic", 0, ("magic 12345, where ArduPlane's JSON link has 18458 or 29569",)),
        ("garbage", SOON, ("7 bytes are no packet",)),
        ("restart", SOON, (f"has begun anew: packet 0 came after packet {SOON - 1}",)),
        ("hang", BOOT, SILENT),
        ("hang", SOON, SILENT),
    ],
)
def test_misbehaviour_ends_the_run_with_a_reason(binary, monkeypatch, tmp_path, trouble, at, said):
    monkeypatch.setenv("STAND_IN", f"{trouble}@{at}")
    began = time.monotonic()
    if trouble == "hang":
        clock = Hanging(tmp_path / "folders")
        monkeypatch.setattr("testbed.ardupilot.link.time", clock)
    text = complaint(page(5.0, patience_s=2 if trouble == "hang" else PATIENCE_S))
    assert time.monotonic() - began < PATIENCE_S / 2
    assert text.startswith(f"leader: ArduPlane (instance {FIRST}) ")
    for words in said:
        assert words in text


def test_one_that_never_listens_is_given_up(binary, monkeypatch):
    monkeypatch.setenv("STAND_IN", "never-listens")
    said = complaint(page(1.0, patience_s=1.0))
    assert f"does not listen on {5760 + 10 * FIRST}/tcp: nothing in 1 s" in said


def test_one_that_does_not_arm_says_what_it_said(binary, monkeypatch):
    monkeypatch.setattr("testbed.ardupilot.bring_up._STAGE_S", 2.0)
    monkeypatch.setenv("STAND_IN", "never-arms")
    said = complaint(page(1.0))
    assert "does not arm in 2 s of its time; it said: ArduPlane stand-in" in said


def test_parameters_that_cannot_be_flown_end_it_too(binary, tmp_path):
    tune = tmp_path / "odd.param"
    tune.write_text("SERVO1_FUNCTION 0\n")
    with pytest.warns(UserWarning, match="SERVO1_FUNCTION"):
        said = complaint(page(1.0, f"leader.tune={tune}"), InputError)
    assert "no output moves the aileron; write SERVOn_FUNCTION 4" in said


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("disarm", "ArduPlane has disarmed: its motor stands still"),
        ("mode", "ArduPlane has changed to mode 11: it heeds no sticks of ours"),
    ],
)
def test_what_it_does_by_itself_is_told(binary, monkeypatch, trouble, said):
    monkeypatch.setenv("STAND_IN", f"{trouble}@{SOON}")
    told = [(event.source, event.level, event.text) for event in level(page(1.0))[0]]
    assert ("leader", "warning", said) in told
    assert (("leader", "warning", "Crash: Disarming") in told) == (trouble == "disarm")


def test_a_program_that_is_not_there_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.delenv("ARDUPLANE", raising=False)
    with pytest.raises(InputError) as caught:
        testbed.run(page(1.0), out=tmp_path / "run")
    assert not (tmp_path / "run").exists(), "nothing is begun"
    said = str(caught.value)
    for way in ("--arduplane PATH", "ARDUPLANE", "binary: PATH"):
        assert way in said
    nothing = tmp_path / "nothing"
    assert "there is no such program" in complaint(page(1.0, binary=nothing), InputError)
    nothing.write_text("no program")
    assert "is not executable" in complaint(page(1.0, binary=nothing), InputError)
    nothing.chmod(0o755)
    nothing.write_bytes(b"\x7fELF")
    assert "cannot be started" in complaint(page(1.0, binary=nothing), InputError)


def test_the_page_comes_before_the_command_line_and_that_before_the_environment(
    monkeypatch, tmp_path
):
    files = {name: tmp_path / name for name in ("page", "line", "environment")}
    for file in files.values():
        file.write_text("#!/bin/sh\n")
        file.chmod(0o755)
    monkeypatch.setenv("ARDUPLANE", str(files["environment"]))
    assert find_binary(str(files["page"]), files["line"]) == files["page"]
    assert find_binary(None, files["line"]) == files["line"]
    assert find_binary(None, None) == files["environment"]


def test_a_port_that_is_taken_is_named(binary):
    for kind, port in ((socket.SOCK_DGRAM, 9002), (socket.SOCK_STREAM, 5760)):
        with socket.socket(socket.AF_INET, kind) as taken:
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind(("127.0.0.1", port + 10 * FIRST))
            if kind == socket.SOCK_STREAM:
                taken.listen(1)
            said = complaint(page(1.0), InputError)
        assert f"port {port + 10 * FIRST} of ArduPlane's instance {FIRST} is taken" in said


def test_noise_on_the_physics_port_before_the_boot_is_refused_by_name(binary):
    world = build(page(1.0, patience_s=5))
    (partner,) = world.partners
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        try:
            for plane in partner._every:
                plane.start(None, lambda: None)
            packet = struct.pack("<HHI16H", 1, 2, 3, *[0] * 16)
            stranger.sendto(packet, ("127.0.0.1", 9002 + 10 * FIRST))
            with pytest.raises(PartnerLost, match="or whoever sends to .*: magic 1, where"):
                plane.collect()
        finally:
            partner.close()


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["fleet.uav1.vehicle=ideal"], "fleet.0.autopilot: is ardupilot, and an ideal vehicle"),
        (["leader.vehicle=ideal"], "leader.autopilot: is ardupilot, and an ideal vehicle"),
        (
            ["leader.path={kind: virtual, speed_mps: 22, curve: {kind: straight}}"],
            "a leader with a path of kind virtual is flown by nobody",
        ),
        (
            ["fleet.uav1.autopilot={kind: ardupilot, instance: 3}"],
            "fleet.2.autopilot: 3 is that of uav1, too (write another",
        ),
        (
            ["rates.autopilot_hz=25", "rates.control_hz=25"],
            "rates.autopilot_hz: is 25, and ArduPlane, which flies leader, has 50 Hz and more",
        ),
    ],
)
def test_a_page_that_contradicts_itself_says_what_to_write(overrides, said):
    with pytest.raises(ScenarioError) as caught:
        load("simulation-3-ardupilot", overrides)
    assert said in str(caught.value)


def test_the_program_of_a_page_is_relative_to_the_page(tmp_path, monkeypatch):
    text = PAGE.replace(
        "aircraft: rascal110\n  path",
        "aircraft: rascal110\n  autopilot: {kind: ardupilot, binary: bin/ap}\n  path",
    )
    (tmp_path / "own.yaml").write_text(text)
    monkeypatch.chdir("/")
    assert load(tmp_path / "own.yaml").leader.autopilot.binary == str(tmp_path / "bin" / "ap")
