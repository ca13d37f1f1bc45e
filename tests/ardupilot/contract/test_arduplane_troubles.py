"""Failures of ArduPlane, played by a stand-in, and the errors and events they cause."""

import math
import socket
import struct
import time
from pathlib import Path

import pytest
from arduplanes import FIRST, SCENARIO, SOON, binary, error_of, fly_level, make_scenario
from cases import in_full
from commands import call_command
from waiting import TIMEOUT_S

import testbed
from testbed.ardupilot.ardupilot_sitl import SitlConfig, SitlVehicle, _used_port, ports
from testbed.ardupilot.sitl_process import SitlProcess, find_binary, stop_processes
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.records import NedOrigin
from testbed.plan.world import build

assert binary  # a fixture


EXIT = ("ended with exit code 3", "it last printed:", "    stand-in: PANIC: internal error")
SILENT = ("does not answer: nothing in 2 s (autopilot.timeout_s)", "stand-in: frozen")
BOOT = 60  # packets


class FrozenClock:
    """A clock that starts when the stand-in freezes, because its boot may take any time."""

    sleep = staticmethod(time.sleep)

    def __init__(self, folders):
        self.folders, self.since = folders, None

    def monotonic(self):
        now = time.monotonic()
        logs = self.folders.glob("*/arduplane.log")
        if self.since is None and any("frozen" in each.read_text() for each in logs):
            self.since = now
        return 0.0 if self.since is None else now - self.since


@pytest.mark.parametrize(
    ("misbehaviour", "at", "text"),
    [
        pytest.param("exit", BOOT, EXIT, marks=in_full),
        ("exit", SOON, EXIT),
        ("crash", BOOT, ("was ended by signal 11", "printed:\n    Waiting for connection ....\n")),
        ("wrong-magic", 0, ("magic 12345, where ArduPlane's JSON link has 18458 or 29569",)),
        ("garbage", BOOT, ("7 bytes are not a packet",)),
        ("restart", SOON, (f"has restarted: packet 0 came after packet {SOON - 1}",)),
        pytest.param("hang", BOOT, SILENT, marks=in_full),
        ("hang", SOON, SILENT),
    ],
)
def test_misbehaving_arduplane_ends_run_with_reason(
    binary, monkeypatch, tmp_path, misbehaviour, at, text
):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", f"{misbehaviour}@{at}")
    began = time.monotonic()
    if misbehaviour == "hang":
        clock = FrozenClock(tmp_path / "folders")
        monkeypatch.setattr("testbed.ardupilot.ardupilot_sitl.time", clock)
    error = error_of(make_scenario(5.0, timeout_s=2 if misbehaviour == "hang" else TIMEOUT_S))
    assert time.monotonic() - began < TIMEOUT_S / 2
    assert error.startswith(f"leader: ArduPlane (instance {FIRST}) ")
    # what says nothing is left out: the keys of our lines, and repetitions
    assert "\t" not in error and "velocity" not in error and error.count("Loaded defaults") <= 1
    for words in text:
        assert words in error


def test_arduplane_that_never_listens_times_out(binary, monkeypatch):
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "never-listens")
    text = error_of(make_scenario(1.0, timeout_s=1.0))
    assert f"does not listen on {5760 + 10 * FIRST}/tcp: nothing in 1 s" in text


def test_arming_failure_quotes_its_messages(binary, monkeypatch):
    monkeypatch.setattr("testbed.ardupilot.startup._STAGE_TIMEOUT_S", 2.0)
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "never-arms")
    text = error_of(make_scenario(1.0))
    assert "does not arm in 2 s of its time; its messages: ArduPlane stand-in" in text


def test_unusable_parameters_end_the_run(binary, tmp_path):
    tune = tmp_path / "odd.param"
    tune.write_text("SERVO1_FUNCTION 0\n")
    text = error_of(make_scenario(1.0, f"leader.tune={tune}"), InputError)
    assert "no output moves the aileron; write SERVOn_FUNCTION 4" in text


def test_own_mode_changes_are_events(binary, monkeypatch):
    """The one shortly after the other."""
    monkeypatch.setenv("ARDUPLANE_STAND_IN", f"disarm@{SOON} mode@{SOON + 20}")
    events, _ = fly_level(make_scenario(1.0))
    found = [(event.source, event.text) for event in events if event.level == "warning"]
    assert found == [
        ("leader", "Crash: Disarming"),
        ("leader", "ArduPlane has disarmed: motor off"),
        ("leader", "ArduPlane has changed to mode 11: takes no commands"),
    ]


def test_missing_binary_is_an_error(monkeypatch, tmp_path):
    monkeypatch.delenv("ARDUPLANE", raising=False)
    with pytest.raises(InputError) as caught:
        testbed.run(make_scenario(1.0), out=tmp_path / "run")
    assert not (tmp_path / "run").exists(), "nothing is written"
    text = str(caught.value)
    for way in ("--arduplane PATH", "environment variable ARDUPLANE"):
        assert way in text
    nothing = tmp_path / "nothing"
    monkeypatch.setenv("ARDUPLANE", str(nothing))
    assert "there is no such program" in error_of(make_scenario(1.0), InputError)
    nothing.write_text("no program")
    assert "is not executable" in error_of(make_scenario(1.0), InputError)
    nothing.chmod(0o755)
    nothing.write_bytes(b"\x7fELF")
    assert "cannot be started" in error_of(make_scenario(1.0), InputError)


def test_scenario_that_names_a_program_is_refused(monkeypatch, tmp_path):
    """The option or the environment names it; `validate` says what a run would start."""
    (program := tmp_path / "program").write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\n")
    program.chmod(0o755)
    (tmp_path / "two.yaml").write_text(SCENARIO)
    named = f"leader.autopilot={{kind: ardupilot, binary: {program}}}"
    for command in ("validate", "run"):
        done = call_command(command, "two.yaml", "--set", named, cwd=tmp_path, code=2, columns=500)
        assert (
            "leader.autopilot: has the key binary, but no scenario names a program" in done.stderr
        )
        assert "--arduplane PATH" in done.stderr
    monkeypatch.delenv("ARDUPLANE", raising=False)
    for said in ("not set", str(program)):
        words = ("validate", "two.yaml", "--set", "leader.autopilot=ardupilot")
        done = call_command(*words, cwd=tmp_path, code=0, columns=500)
        assert f"leader: a run starts the program of --arduplane or ARDUPLANE ({said})" in (
            done.stderr
        )
        monkeypatch.setenv("ARDUPLANE", str(program))
    assert not (tmp_path / "ran").exists()


def test_program_gets_an_allow_list_of_the_environment(monkeypatch, tmp_path):
    program = tmp_path / "arduplane"
    program.write_text(f"#!/bin/sh\nenv > {tmp_path}/seen\n")
    program.chmod(0o755)
    for name in ("ARDUPLANE_OF_MINE", "LC_NUMERIC", "AWS_SECRET_ACCESS_KEY", "SSH_AUTH_SOCK"):
        monkeypatch.setenv(name, name)
    process = SitlProcess(program, FIRST, NedOrigin(0.0, 0.0, 0.0), 0.0, "")
    stop_after(process)
    seen = {line.partition("=")[0] for line in (tmp_path / "seen").read_text().splitlines()}
    assert {"PATH", "HOME", "ARDUPLANE_OF_MINE", "LC_NUMERIC"} <= seen
    assert not seen & {"AWS_SECRET_ACCESS_KEY", "SSH_AUTH_SOCK", "PYTHONPATH"}


def stop_after(process):
    try:
        process.wait(time.monotonic() + 20.0)
    finally:
        stop_processes([process])


def test_binary_precedence(monkeypatch, tmp_path):
    files = {name: tmp_path / name for name in ("option", "environment")}
    for file in files.values():
        file.write_text("#!/bin/sh\n")
        file.chmod(0o755)
    monkeypatch.setenv("ARDUPLANE", str(files["environment"]))
    assert find_binary(files["option"]) == files["option"]
    assert find_binary(None) == files["environment"]


def test_port_in_use_is_named(binary):
    udp, tcp = socket.SOCK_DGRAM, socket.SOCK_STREAM
    for kind, port in ((udp, 9002), (udp, 5501), (tcp, 5760), (tcp, 5763)):
        with socket.socket(socket.AF_INET, kind) as taken:
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind(("127.0.0.1", port + 10 * FIRST))
            if kind == tcp:
                taken.listen(1)
                taken.setblocking(False)
            text = error_of(make_scenario(1.0), InputError)
            if kind == tcp:  # the connection that another ArduPlane waits for is not taken
                with pytest.raises(BlockingIOError):
                    taken.accept()
        assert f"port {port + 10 * FIRST} of ArduPlane's instance {FIRST} is in use" in text
        assert "or by an arduplane that runs without one" in text


def test_closed_connection_leaves_its_port_free():
    """A connection that ArduPlane closed first blocks its port only for sockets without reuse."""
    port = ports(FIRST)[1]
    with socket.create_server(("127.0.0.1", port)) as server:
        with socket.create_connection(("127.0.0.1", port)) as client:
            server.accept()[0].close()
            assert client.recv(1) == b""
    assert _used_port(FIRST) is None


def test_output_tail_cut_in_state_has_no_keys(tmp_path):
    """Lines that are cut off hide the heading of the keys."""
    process = SitlProcess.__new__(SitlProcess)
    process._log = tmp_path / "arduplane.log"
    keys = "".join(f"\tkey_{number}\n" for number in range(600))
    process._log.write_text(f"JSON received:\n{keys}ready\nready\n")
    assert process.output_tail() == "it last printed:\n    ready"


def test_noise_on_physics_port_is_an_error(binary):
    world = build(make_scenario(1.0, timeout_s=5))
    (process,) = world.external_processes
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        try:
            for plane in process._all:
                plane.start(None, lambda: None)
            packet = struct.pack("<HHI16H", 1, 2, 3, *[0] * 16)
            stranger.sendto(packet, ("127.0.0.1", 9002 + 10 * FIRST))
            message = "or another program that sends to .*: magic 1, where"
            with pytest.raises(ExternalProgramLost, match=message):
                plane.receive_pwm()
        finally:
            process.close()


def test_repetitions_in_a_pause_are_dropped():
    config = SitlConfig("one", [FIRST], False, Path(), 5.0, 0.0, math.nan)
    plane = SitlVehicle(config, NedOrigin(), physics_hz=200, autopilot_hz=50)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as arduplane:
        arduplane.settimeout(TIMEOUT_S)
        arduplane.connect(("127.0.0.1", 9002 + 10 * FIRST))

        def send(count):
            arduplane.send(struct.pack("<HHI16H", 18458, 200, count, *[count] * 16))

        try:
            plane.start(None, lambda: None)
            plane.set_inputs((0.0, 0.0, 0.0), 22.0, math.nan)
            for count in range(3):
                send(count)
                assert plane.receive_pwm()[0] == count
                send(count)  # it repeats itself, while the run is paused
                send(count)
                time.sleep(0.6)
                plane.send_state([0.0] * 15)
                assert f'"timestamp":{0.005 * (count + 1):.9f}'.encode() in arduplane.recv(2048)
            send(3)
            assert plane.receive_pwm()[0] == 3
            arduplane.settimeout(0.01)
            with pytest.raises(TimeoutError):  # each state was sent once
                arduplane.recv(2048)
        finally:
            plane.close()
