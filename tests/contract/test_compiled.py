"""Machine code is kept, and never that of sources that have changed."""

import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE_S

import testbed
from testbed import compiled, standing_in
from testbed.scenario import load, shorten

pytest.importorskip("numba")

TWIN = """
from testbed.compiled import twin
from testbed.numbers import STEP

@twin
def step(x):
    return x + STEP

print(step(1), sum(step.stats.cache_hits.values()))
"""


def printed(folder):
    done = subprocess.run(
        [sys.executable, "-c", "import testbed.room_twin"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    return done.stdout.split()


def test_a_constant_of_another_file_is_compiled_anew(tmp_path):
    package = tmp_path / "testbed"
    package.mkdir()
    (package / "__init__.py").touch()
    for module in (compiled, standing_in):
        shutil.copy(module.__file__, package)
    (package / "room_twin.py").write_text(TWIN)
    (package / "numbers.py").write_text("STEP = 1\n")
    assert printed(tmp_path) == ["2", "0"]
    assert printed(tmp_path) == ["2", "1"], "it was not kept"
    (package / "numbers.py").write_text("STEP = 2\n")
    assert printed(tmp_path) == ["3", "0"]
    assert len(list((package / "__pycache__").glob("twins-*"))) == 1
    assert not list(package.glob("__pycache__/*.nb[ic]"))


def test_what_no_twin_leads_to_costs_no_machine_code():
    package = Path(compiled.__file__).parent
    sources = set(compiled._sources(package))
    assert {"compiled.py", "frames.py", "state.py", "vehicle/twin.py"} <= sources
    others = {"cli.py", "console.py", "sim/loop.py", "record/door.py"}
    assert not (others | {"vehicle/fleet.py", "sim/control.py"}) & sources


def test_a_module_of_the_package_itself_is_followed(tmp_path):
    """However it is imported."""
    (tmp_path / "room").mkdir()
    for name, text in (
        ("room/a_twin.py", "from testbed import frames\nfrom testbed.room import own\n"),
        ("frames.py", "import testbed.state\n"),
        ("state.py", "from testbed.state_of import (\n    what,\n)\n"),
        ("state_of.py", ""),
        ("room/own.py", ""),
        ("other.py", ""),
    ):
        (tmp_path / name).write_text(text)
    found = {"room/a_twin.py", "frames.py", "state.py", "state_of.py", "room/own.py"}
    assert set(compiled._sources(tmp_path)) == found


def test_every_module_that_a_twin_loads_is_a_source():
    """The second route: what Python itself has loaded after importing some of them."""
    code = (
        "import testbed.air.field_twin, testbed.network.fates_twin, testbed.sensing.fusion_twin;"
        "import sys; print(*(m.__file__ for n, m in sys.modules.items() "
        "if n.startswith('testbed') and m.__file__))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    loaded = {Path(file) for file in done.stdout.split()}
    package = Path(compiled.__file__).parent
    # a package's own __init__ is loaded on the way to what is in it, and loads the rest of the page
    passed = {
        file for file in loaded if file.name == "__init__.py" or file.parent.name == "scenario"
    }
    assert loaded - passed <= {package / name for name in compiled._sources(package)}


MIXED = """
import gc
from typing import NamedTuple

import numpy as np

from testbed.compiled import bound, twin


class Pair(NamedTuple):
    wide: np.ndarray
    flag: bool


@twin
def mixed(flag, pair, count, rows, view, weight, out, x, n):
    out[0] = x + weight * pair.wide[1, 2] + 10.0 * rows[0] + view[1, 1]
    out[1] = n + count + 100 * flag + 1000 * pair.flag
    return len(rows) + n


def given(flag):
    wide, rows = np.arange(6.0).reshape(2, 3), np.array([3, 4], np.int32)
    view = np.arange(24.0).reshape(4, 6)[::2, ::3]
    return flag, Pair(wide, not flag), 7, rows, view, 0.5


for flag in (True, False):
    ours, theirs = np.zeros((2, 2))
    call = bound(mixed, *given(flag), theirs, more=(0.0, 0))
    gc.collect()
    litter = [np.full(1000, -1.0) for _ in range(100)]
    for x, n in ((1.0, 2), (-3.5, 4)):
        assert mixed(*given(flag), ours, x, n) == call(x, n) == 2 + n
        assert ours.tolist() == theirs.tolist(), (ours, theirs)
    assert ours[1] == 11 + (100 if flag else 1000)
try:
    bound(mixed, "text")
except TypeError as error:
    print(error)
"""


def test_bound_arguments_are_those_of_a_call_and_stay_alive(tmp_path):
    """Arrays, numbers and truths, alone and in records, and behind them what comes at each call."""
    (tmp_path / "mixed.py").write_text(MIXED)
    environment = {key: value for key, value in os.environ.items() if key != "TESTBED_NUMPY"}
    done = subprocess.run(
        [sys.executable, "mixed.py"],
        cwd=tmp_path,
        env=environment | {"NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "an argument of unicode_type cannot be bound\n"


@pytest.mark.parametrize(
    "name",
    ["simulation-3", "simulation-3-recorded-leader", "ideal-figure-eight", "mixed-fleet"],
)
def test_a_longer_flight_binds_no_more(name, monkeypatch):
    """Whatever flies together, compiled code is bound when a flight begins, not at every tick."""
    count = 0

    def counted(*given, **named):
        nonlocal count
        count += 1
        return bound(*given, **named)

    bound = compiled.bound
    for module in pkgutil.walk_packages(testbed.__path__, "testbed."):
        if module.name.endswith("twin"):
            twins = importlib.import_module(module.name)
            if hasattr(twins, "bound"):
                monkeypatch.setattr(twins, "bound", counted)
    monkeypatch.setattr(compiled, "bound", counted)
    counts = []
    for seconds in (1.0, 3.0):
        count = 0
        testbed.run(shorten(load(name), seconds), write=False)
        counts.append(count)
    assert counts[0] == counts[1] > 3
