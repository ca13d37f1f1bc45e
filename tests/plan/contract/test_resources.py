"""Memory and disk space: estimates agree with flights, and too large runs are refused."""

import json
import subprocess
import sys
from collections import namedtuple

import pytest
from cases import some
from run_flight import small_grids
from typer.testing import CliRunner
from waiting import TIMEOUT_S

import testbed
from testbed.cli.main import app
from testbed.core.errors import InputError
from testbed.plan import resources
from testbed.plan.world import build
from testbed.scenario import load_scenario, set_duration

LONG = "scenario.duration_s=86400"
VIRTUAL = "leader.path={kind: virtual, speed_mps: 22, curve: {kind: circle, radius_m: 500}}"
FAST = ("rates.physics_hz=10000", "rates.log_hz=10000")
# Prints the largest resident size, bytes, while a scenario was built and flown, of each scenario.
MEASURED = """
import gc, json, sys
from pathlib import Path
from testbed.scenario import load_scenario
from testbed.flight.loop import fly
from testbed.plan.world import build
for name, until, changes in json.loads(sys.argv[1]):
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5")  # forgets the largest size until now
    fly(build(load_scenario(name, changes)), [], lambda now, due: now >= until)
    lines = Path("/proc/self/status").read_text().splitlines()
    print(next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")))
"""
# name, time at which it ends, and changes, in the order of the memory they need
FLIGHTS = (
    ("simulation-3", 0.1, (LONG, VIRTUAL)),
    ("vee-30", 1.0, ()),  # many aircraft
    (  # many messages in flight
        *("simulation-3", 20.0),
        ("rates.physics_hz=1000", "rates.broadcast_hz=1000", "network.delay_s=20"),
    ),
)
Usage = namedtuple("Usage", "total used free")


def run_error(name, *changes, out):
    """Return the error of a run that writes nothing."""
    sets = [word for change in changes for word in ("--set", change)]
    done = CliRunner().invoke(app, ["run", name, *sets, "--out", str(out)])
    assert isinstance(done.exception, InputError)  # exit code 2
    assert not out.exists()
    return str(done.exception)


@pytest.mark.parametrize(
    "name", some(["simulation-3", "simulation-3-pixhawk", "turbulence-moderate", "vee-30"], 2)
)
def test_disk_needed_agrees_with_the_log(name, tmp_path, monkeypatch):
    small_grids(monkeypatch)
    scenario = set_duration(load_scenario(name), 12.0)
    run = testbed.run(scenario, out=tmp_path / "run")
    size = (run.directory / "run.mcap").stat().st_size
    assert resources.disk_needed(scenario) == pytest.approx(size, rel=0.15)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_needed_agrees_with_the_flight():
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, json.dumps(FLIGHTS)],
        check=True, capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    for (name, _, changes), most in zip(FLIGHTS, done.stdout.split(), strict=True):
        needed = resources.memory_needed(load_scenario(name, changes))
        assert 0.75 * needed < int(most) < 1.15 * needed, name


def test_memory_more_than_free_is_refused(tmp_path, monkeypatch):
    changes = ("rates.physics_hz=1000", "rates.broadcast_hz=1000", "network.delay_s=60")
    error = run_error("vee-100", *changes, out=tmp_path / "run")
    assert "300 s of 101 aircraft need about 152 GB of memory, and " in error
    monkeypatch.setattr(resources, "memory_free", lambda: 1e8)
    with pytest.raises(InputError, match=r"need about \d+ MB of memory, and 100 MB are free"):
        build(load_scenario("simulation-3"))


def test_disk_log_larger_than_free_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(resources.shutil, "disk_usage", lambda place: Usage(9e9, 8e9, 1e9))
    error = run_error("simulation-3", LONG, *FAST, out=tmp_path / "a" / "run")
    assert "the log of 86400 s of 4 aircraft needs about 1,486 GB" in error
    assert f"{tmp_path} has 1.0 GB" in error
    assert not (tmp_path / "a").exists()
    resources.check_disk(load_scenario("simulation-3"), tmp_path)  # 46 MB


def test_disk_run_without_log_needs_no_space(tmp_path, monkeypatch):
    monkeypatch.setattr(resources.shutil, "disk_usage", lambda place: Usage(9e9, 9e9, 0.0))
    scenario = set_duration(load_scenario("simulation-3", ["log.mcap=false"]), 0.2)
    assert testbed.run(scenario, out=tmp_path / "run").outcome == "completed"
    with pytest.raises(InputError, match=r"has 0 bytes"):
        testbed.run(set_duration(load_scenario("simulation-3"), 0.2), out=tmp_path / "other")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_free_has_the_limit_of_a_container(tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "_CGROUP", tmp_path)
    unlimited = resources.memory_free()
    assert unlimited > 1e8
    (tmp_path / "memory.max").write_text("300000000\n")
    (tmp_path / "memory.current").write_text("100000000\n")
    assert resources.memory_free() == 2e8
    (tmp_path / "memory.max").write_text("max\n")
    assert resources.memory_free() == pytest.approx(unlimited, rel=0.2)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    ("line", "folder", "limit", "used"),
    [
        ("0::/user/one", "user", "memory.max", "memory.current"),
        ("7:memory:/one", "memory/one", "memory.limit_in_bytes", "memory.usage_in_bytes"),
    ],
    ids=["a group above, version 2", "version 1"],
)
def test_memory_free_has_limits_of_all_groups(tmp_path, monkeypatch, line, folder, limit, used):
    (tmp_path / "own").write_text(f"1:cpu:/\n{line}\n")
    monkeypatch.setattr(resources, "_CGROUP", tmp_path / "groups")
    monkeypatch.setattr(resources, "_OWN_CGROUP", tmp_path / "own")
    group = tmp_path / "groups" / folder
    group.mkdir(parents=True)
    (group / limit).write_text("300000000\n")
    (group / used).write_text("100000000\n")
    assert resources.memory_free() == 2e8


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_free_has_the_limit_of_the_process(monkeypatch, tmp_path):
    """`ulimit -v` counts addresses, of which this process has some already."""
    (tmp_path / "statm").write_text("1000 900 0 0 0 500 0\n")
    monkeypatch.setattr(resources, "_STATM", tmp_path / "statm")
    page, limits = resources.resource.getpagesize(), {resources.resource.RLIMIT_AS: 10**7}
    none = resources.resource.RLIM_INFINITY
    monkeypatch.setattr(
        resources.resource, "getrlimit", lambda kind: (limits.get(kind, none), none)
    )
    assert resources.memory_free() == 10**7 - 1000 * page
