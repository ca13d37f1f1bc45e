"""What a run will take is known before it takes it, and refused where there is not as much."""

import subprocess
import sys
from collections import namedtuple

import pytest
from patience import PATIENCE_S
from typer.testing import CliRunner

import testbed
from testbed.cli import app
from testbed.errors import InputError
from testbed.scenario import load, shorten
from testbed.sim import sizes
from testbed.sim.world import build, clock_of

LONG = "scenario.duration_s=86400"
FAST = ("rates.physics_hz=10000", "rates.log_hz=10000")
# Prints the most that was resident, in bytes, after a page was built and flown for some seconds.
MEASURED = """
import sys
from pathlib import Path
from testbed.scenario import load
from testbed.sim.loop import fly
from testbed.sim.world import build
name, until, *changes = sys.argv[1:]
fly(build(load(name, changes)), [], lambda now, due: now >= float(until))
lines = Path("/proc/self/status").read_text().splitlines()
print(next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")))
"""
Usage = namedtuple("Usage", "total used free")


def refused(name, *changes, out):
    """The error of a run, of which nothing is left."""
    sets = [word for change in changes for word in ("--set", change)]
    done = CliRunner().invoke(app, ["run", name, *sets, "--out", str(out)])
    assert isinstance(done.exception, InputError)  # exit code 2
    assert not out.exists()
    return str(done.exception)


@pytest.mark.parametrize(
    "name", ["simulation-3", "simulation-3-pixhawk", "turbulence-moderate", "vee-30"]
)
def test_a_log_is_as_large_as_was_foretold(name, tmp_path):
    page = shorten(load(name), 12.0)
    run = testbed.run(page, out=tmp_path / "run")
    size = (run.directory / "run.mcap").stat().st_size
    assert sizes.disk_needed(page) == pytest.approx(size, rel=0.15)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    ("name", "until", "changes"),
    [
        ("ideal-figure-eight", 0.1, ("scenario.duration_s=3000",)),  # its path is computed first
        ("simulation-3", 20.0, ("rates.physics_hz=1000", "rates.broadcast_hz=1000",
                                "network.delay_s=20")),
        ("vee-30", 5.0, ()),
    ],
    ids=["a path", "messages on their way", "aircraft"],
)  # fmt: skip
def test_a_flight_takes_no_more_memory_than_was_foretold_and_not_much_less(name, until, changes):
    page = load(name, changes)
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, name, str(until), *changes],
        check=True, capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip
    most = int(done.stdout)
    assert 0.75 * sizes.memory_needed(page, clock_of(page)) < most
    assert most < 1.15 * sizes.memory_needed(page, clock_of(page))


def test_more_memory_than_there_is_is_refused_with_the_estimate(tmp_path, monkeypatch):
    changes = (LONG, "rates.physics_hz=10000", "rates.autopilot_hz=10000")
    said = refused("ideal-figure-eight", *changes, out=tmp_path / "run")
    assert "86400 s of 4 aircraft need about 345.8 GB of memory, and " in said
    monkeypatch.setattr(sizes, "memory_free", lambda: 1e8)
    with pytest.raises(InputError, match=r"need about 0\.2 GB of memory, and 0\.1 GB are free"):
        build(load("simulation-3"))


def test_a_log_without_room_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(sizes.shutil, "disk_usage", lambda place: Usage(9e9, 8e9, 1e9))
    said = refused("simulation-3", LONG, *FAST, out=tmp_path / "a" / "run")
    assert "the log of 86400 s of 4 aircraft needs about 1486.1 GB" in said
    assert f"{tmp_path} has 1.0 GB" in said
    assert not (tmp_path / "a").exists()
    sizes.check_disk(load("simulation-3"), tmp_path)  # 46 MB


def test_a_flight_that_leaves_no_log_needs_no_room(tmp_path, monkeypatch):
    monkeypatch.setattr(sizes.shutil, "disk_usage", lambda place: Usage(9e9, 9e9, 0.0))
    page = shorten(load("simulation-3", ["log.mcap=false"]), 0.2)
    assert testbed.run(page, out=tmp_path / "run").outcome == "flown"
    with pytest.raises(InputError, match=r"has 0\.0 MB"):
        testbed.run(shorten(load("simulation-3"), 0.2), out=tmp_path / "other")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_limit_of_a_container_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(sizes, "_CGROUP", tmp_path)
    whole = sizes.memory_free()
    assert whole > 1e8
    (tmp_path / "memory.max").write_text("300000000\n")
    (tmp_path / "memory.current").write_text("100000000\n")
    assert sizes.memory_free() == 2e8
    (tmp_path / "memory.max").write_text("max\n")
    assert sizes.memory_free() == pytest.approx(whole, rel=0.2)
