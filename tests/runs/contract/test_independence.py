"""Numbers do not depend on observers, folder, locale, load or processes, to the bit."""

import os
import socket
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml
from cases import some
from commands import call_command, environment
from run_flight import Collector, small_grids
from waiting import TIMEOUT_S

import testbed
from testbed.logs.mcap_file import read
from testbed.mavlink.udp_endpoint import parse_address
from testbed.runs.external_options import NO_EXTERNAL
from testbed.scenario import dump, load_scenario, loads

# Everything that draws from a seed: turbulence, sensors, a radio that loses, delays and repeats.
BUSY = [
    "scenario.duration_s=3",
    "scenario.windows=null",
    "scenario.published=null",
    "air.wind={speed_mps: 4, from_deg: 30}",
    "air.turbulence={model: dryden, intensity: moderate}",
    "leader.sensors=pixhawk",
    "fleet.*.sensors=pixhawk",
    "network.loss=0.2",
    "network.delay_s=0.05",
    "network.jitter={distribution: normal, spread_s: 0.02}",
    "network.duplicate=0.05",
]
SEEN = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")


def fly(scenario, **how):
    keeper = Collector()
    testbed.run(scenario, observers=[keeper], **({"write": False} | how))
    return keeper.frames


def assert_same(own, others, aircraft=None):
    """To the bit; of so many aircraft, or of all."""
    assert len(own) == len(others) > 50
    for one, other in zip(own, others, strict=True):
        for name in SEEN if aircraft is None else SEEN[:3]:
            for field, array in zip(getattr(one, name)._fields, getattr(one, name), strict=True):
                their = getattr(getattr(other, name), field)
                np.testing.assert_array_equal(
                    their if aircraft is None else their[:aircraft],
                    array,
                    err_msg=f"{name}.{field}",
                )


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("simulation-3", BUSY)


@pytest.fixture(scope="module")
def alone(scenario):
    """Samples of a flight without other observers."""
    return fly(scenario)


def test_logging(scenario, alone, tmp_path):
    assert_same(alone, fly(scenario, write=True, out=tmp_path / "run"))


def test_telemetry(scenario, alone):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(TIMEOUT_S)
        address = parse_address(f"udpout:127.0.0.1:{ground.getsockname()[1]}")
        assert_same(alone, fly(scenario, external=replace(NO_EXTERNAL, mavlink=(address,))))
        assert ground.recv(300)[0] == 0xFD  # a message was sent


def backwards(value):
    """The same scenario, its keys in the opposite order; lists stay as they are."""
    if isinstance(value, dict):
        return {key: backwards(value[key]) for key in reversed(value)}
    return [backwards(each) for each in value] if isinstance(value, list) else value


def test_the_order_of_keys(scenario, alone):
    tree = yaml.safe_load(dump(scenario))
    turned = yaml.safe_dump(backwards(tree), sort_keys=False)
    assert next(iter(yaml.safe_load(turned))) == list(tree)[-1]
    assert_same(alone, fly(loads(turned)))


@pytest.mark.parametrize("turbulence", [*some(["dryden", "von-karman"], 1), "coherent"])
def test_silent_aircraft_without_wake_changes_nothing(turbulence, monkeypatch):
    small_grids(monkeypatch)
    changes = [*BUSY, f"air.turbulence={{model: {turbulence}, intensity: moderate}}"]
    scenario = load_scenario("simulation-3", changes)
    tree = yaml.safe_load(dump(scenario))
    tree["fleet"].append(tree["fleet"][-1] | {"name": "shadow", "start_m": [-90, 40, 5]})
    tree["formation"]["offsets_m"]["shadow"] = [-60, 30, 5]
    tree["formation"]["leader_gains"]["shadow"] = 1
    tree["network"]["transmitter_off_s"] = {"shadow": [[0, 10]]}
    assert_same(fly(scenario), fly(loads(yaml.safe_dump(tree))), aircraft=4)


ELSEWHERE = {
    "LC_ALL": "C",
    "LANG": "de_DE.UTF-8",
    "PYTHONHASHSEED": "7",
    "TZ": "Asia/Kathmandu",
    "COLUMNS": "40",
    "HOME": "/nonexistent",
    "TERM": "dumb",
}


def test_directory_locale_hashes_and_other_runs_beside(tmp_path):
    """A new process flies elsewhere, and this one beside it; their logs are the same.

    A slow run cuts its log into shorter chunks, so that not all bytes are the same: all messages
    are, their times, and what is attached.
    """
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    command = ["run", "simulation-3", "--out", "run", "-q"]
    for change in BUSY:
        command += ["--set", change]
    for folder in (here, elsewhere):
        folder.mkdir()
    with subprocess.Popen(
        [sys.executable, "-m", "testbed", *command],
        cwd=elsewhere,
        env=environment(80) | ELSEWHERE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            call_command(*command, cwd=here, code=0, columns=80)
            _, output = process.communicate(timeout=TIMEOUT_S)
        finally:
            process.kill()
    assert process.returncode == 0, output
    logs = [read(folder / "run" / "run.mcap") for folder in (here, elsewhere)]
    assert logs[0] == logs[1]
    assert [os.listdir(folder) for folder in (here, elsewhere)] == [["run"]] * 2
