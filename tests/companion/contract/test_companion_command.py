"""The command companion: a flight by processes of its own, its files, and what it refuses."""

import json
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from cases import ALL
from commands import call_command, environment
from forked import Forked
from link_loop import free_port
from places import ROOT
from waiting import TIMEOUT_S, until

import testbed
from testbed.companion.start import digest_of

SCENARIO_TEXT = """
scenario: {schema: 2, name: pair, duration_s: 60}
leader:
  aircraft: rascal110
  path:
    kind: mission
    airspeed_mps: 22
    legs: [{kind: waypoints, points_m: [[900, 0, 100], [900, 900, 100]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-12, 8, 2]}
formation:
  offsets_m: {uav1: [-10, 5, 0]}
  leader_gains: {uav1: 1}
"""
SIMULATED_S = 6
LOCAL = ("--autopilot", "udpin:127.0.0.1:14999", "--formation", "hub:127.0.0.1:14998")


def write_scenario(folder):
    scenario = folder / "scenario.yaml"
    scenario.write_text(SCENARIO_TEXT, "utf-8")
    return scenario


def start(folder, name, *options):
    """Start a companion in a folder; its standard error is in a file."""
    errors = folder / f"{name}.txt"
    with errors.open("wb") as output:
        process = Forked(
            *("testbed.cli.main:main", "companion", "scenario.yaml", "--as", name, *options),
            cwd=folder,
            env=environment(100),
            stderr=output,
        )
    until(
        lambda: process.poll() is not None or b"companion of" in errors.read_bytes(),
        f"no companion of {name}",
    )
    assert process.poll() is None, errors.read_text()
    return process


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """In lockstep, signed: a run, and the companions of its leader and its follower."""
    folder = tmp_path_factory.mktemp("flight")
    write_scenario(folder)
    ports = [free_port() for _ in range(2)]
    peers = "peers:" + ",".join(f"127.0.0.1:{free_port()}" for _ in range(2))
    key = folder / "key.txt"
    key.write_text("a passphrase of ours", "utf-8")
    key.chmod(0o600)
    signed = ("--mavlink-key", str(key))
    companions = [
        start(
            folder,
            name,
            *("--autopilot", f"udpin:127.0.0.1:{port}", "--formation", peers, "--lockstep"),
            *("--out", name, "--json", f"{name}.json", *signed),
        )
        for name, port in zip(("leader", "uav1"), ports, strict=True)
    ]
    try:
        mavlink = [word for port in ports for word in ("--mavlink", f"udpout:127.0.0.1:{port}")]
        external = "fleet.uav1.commanded_by={kind: external, lockstep: true}"
        command = ["run", "scenario.yaml", "--set", external, *mavlink, "--pace", "0", *signed]
        command += ["--duration", SIMULATED_S, "--out", "run", "--quiet"]
        call_command(*command, cwd=folder, code=0, columns=100)
    finally:
        for each in companions:
            each.send_signal(signal.SIGTERM)
        codes = [each.wait(TIMEOUT_S) for each in companions]
    return SimpleNamespace(folder=folder, codes=codes)


def statistics(flight, name):
    return json.loads((flight.folder / f"{name}.json").read_text("utf-8"))


def test_companions_end_by_a_signal(flight):
    assert flight.codes == [0, 0]
    assert "Traceback" not in (flight.folder / "uav1.txt").read_text("utf-8")


def test_every_sample_has_one_command(flight):
    found = statistics(flight, "uav1")
    assert found["samples"] == found["commands"] == 25 * SIMULATED_S + 1
    assert statistics(flight, "leader")["commands"] == 0
    assert found["steps_without_message"] == {"leader": 0}
    assert found["age_s"]["leader"]["max"] == 0.0  # in lockstep


def test_statistics_have_latency_memory_and_share(flight):
    found = statistics(flight, "uav1")
    latency = found["state_to_command_s"]
    assert 0.0 < latency["p50"] <= latency["p99"] <= latency["max"] < 30.0
    assert found["step_s"]["p50"] < 0.01
    assert 20.0 < found["peak_memory_mb"] < 2_000.0
    assert 0.0 < found["processor_share"] < 1.0
    assert found["ready_cpu_s"] < found["first_command_cpu_s"]


def positions(run):
    return np.stack([run[f"state_position_{axis}_m"] for axis in ("north", "east", "down")], -1)


@pytest.mark.parametrize("name", ["leader", "uav1"])
def test_log_has_what_the_run_has(flight, name):
    """The own row as the autopilot has it, that of the other by its messages."""
    run, own = (testbed.load_run(flight.folder / each) for each in ("run", name))
    assert np.array_equal(own.time_s, run.time_s)
    apart = np.linalg.norm(positions(own) - positions(run), axis=-1)
    assert 0.0 < np.nanmax(apart) < 0.02  # 1e-7 degrees
    assert np.isfinite(apart[2:]).all()


def test_log_has_the_commands(flight):
    run, own = (testbed.load_run(flight.folder / each) for each in ("run", "uav1"))
    given, sent = run["command_roll_rad"][:, 1], own["command_roll_rad"][:, 1]
    # the run logs a command with the sample after it
    assert np.allclose(sent[:-1], given[1:], atol=1e-6)
    assert np.ptp(sent) > 0.01


def test_files_are_whole_and_read_by_commands(flight):
    folder = flight.folder / "uav1"
    names = {each.name for each in folder.iterdir()}
    assert {"run.mcap", "metrics.json", "companion.json", "scenario.resolved.yaml"} <= names
    metrics = json.loads((folder / "metrics.json").read_text("utf-8"))
    assert metrics["recorded"] and metrics["simulated_s"] == SIMULATED_S
    for words in (
        # the page of a log of real aircraft: test_formation_from_logs.py
        *([("report", "uav1", "--out", "uav1.html")] if ALL else []),
        ("compare", "run", "uav1", "--numbers", "--within", "0.5"),
        ("export", "uav1", "--format", "csv", "--out", "csv"),
    ):
        code = 3 if words[0] == "compare" else 0
        call_command(*words, cwd=flight.folder, code=code, columns=100)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--as", "uav7", *LOCAL), "--as uav7: no aircraft of the scenario"),
        (
            ("--as", "uav1", *LOCAL[:3], "multicast:239.255.41.1:14600@10.0.0.5"),
            "leads out of this computer (write --mavlink-key FILE",
        ),
        (
            ("--as", "uav1", "--autopilot", "serial:/dev/null:57600", *LOCAL[2:]),
            "leads out of this computer (write --mavlink-key FILE",
        ),
        (
            ("--as", "uav1", "--autopilot", "udpin:0.0.0.0:14999", *LOCAL[2:], "--lockstep"),
            "--lockstep: commands without the pilot's switch",
        ),
        (
            ("--as", "uav1", "--autopilot", "udpin:0.0.0.0:14999", *LOCAL[2:], "--at-once"),
            "--at-once: commands without the pilot's switch",
        ),
        (("--as", "uav1", "--autopilot", "tcp:1", *LOCAL[2:]), "is no end of a link"),
    ],
)
def test_wrong_options_are_one_error_line(options, reason, tmp_path):
    write_scenario(tmp_path)
    done = call_command("companion", "scenario.yaml", *options, cwd=tmp_path, code=2, columns=300)
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ") and reason in line
    assert [each.name for each in tmp_path.iterdir()] == ["scenario.yaml"]


def test_help_begins_with_what_was_never_flown():
    done = call_command("companion", "--help", cwd=ROOT, code=0, columns=80)
    text = " ".join(done.stdout.split())
    first = text.index("Never flown on an aircraft, on a Raspberry Pi or against a real ArduPlane")
    assert first < text.index("safety pilot") < text.index("SET_ATTITUDE_TARGET")


def test_digest_is_of_the_content_only(tmp_path):
    """Not by the folder it is in; by a number of it, of its bounds, and of its law's file."""
    digests = {}
    for name, change in {
        "one": [],
        "other": [],
        "gain": ["formation.offsets_m.uav1=[-10,6,0]"],
        "bound": ["controller.companion.flight.state_age_s=0.7"],
    }.items():
        folder = tmp_path / name
        folder.mkdir()
        scenario = testbed.load_scenario(str(write_scenario(folder)), change)
        digests[name] = digest_of(scenario, folder)
    assert digests["one"] == digests["other"]
    assert len(set(digests.values())) == 3
