"""Machine code is cached per text of the kernel packages, and never used for another text."""

import functools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE_S

from testbed.core import compile as compiling
from testbed.core.compile import KERNEL_PACKAGES, cache_folder, source_digest

ENTRY = """
import numpy as np

from testbed.core.compile import entry, kernel
from testbed.formation.numbers import STEP


@kernel
def grown(record):
    return record.x + STEP


@entry
def step(records):
    for i in range(len(records)):
        records[i].x = grown(records[i])
"""
CALL = """
from testbed.core.records import allocate
from testbed.sim.stepping import step
import numpy as np

records = allocate(np.dtype([("x", "f8"), ("v", "f8", 3)], align=True), 2)
step(records)
hits = sum(step.stats.cache_hits.values()) if hasattr(step, "stats") else "plain"
print(records["x"].tolist(), hits)
"""


@pytest.fixture
def package(tmp_path):
    """A package with the product's core and two kernel packages of its own."""
    package = tmp_path / "testbed"
    for name in ("core", "sim", "formation"):
        (package / name).mkdir(parents=True)
        (package / name / "__init__.py").touch()
    (package / "__init__.py").touch()
    core = Path(compiling.__file__).parent
    for module in ("compile.py", "records.py"):
        shutil.copy(core / module, package / "core")
    (package / "sim" / "stepping.py").write_text(ENTRY)
    (package / "formation" / "numbers.py").write_text("STEP = 1.0\n")
    return package


def printed(package, **environment):
    inherited = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=package.parent,
        env={**inherited, "PYTHONPATH": str(package.parent), **environment},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    return done.stdout.strip()


def folders(parent):
    return sorted(each.name for each in parent.glob("kernels-*"))


def test_a_constant_of_another_file_is_compiled_anew(package):
    cache = package / "__pycache__"
    assert printed(package) == "[1.0, 1.0] 0"
    first = folders(cache)
    assert printed(package) == "[1.0, 1.0] 1", "the machine code was not cached"
    assert folders(cache) == first
    (package / "formation" / "numbers.py").write_text("STEP = 2.0\n")
    assert printed(package) == "[2.0, 2.0] 0"
    # one folder, which is another; nothing of numba's lies elsewhere
    assert len(folders(cache)) == 1
    assert folders(cache) != first
    found = [path.relative_to(cache) for path in package.rglob("*.nb[ic]")]
    assert {path.parts[0] for path in found} == set(folders(cache))


def test_numba_cache_dir_takes_the_place_of_the_package(package, tmp_path):
    wanted = tmp_path / "elsewhere"
    assert printed(package, NUMBA_CACHE_DIR=str(wanted)) == "[1.0, 1.0] 0"
    assert printed(package, NUMBA_CACHE_DIR=str(wanted)) == "[1.0, 1.0] 1"
    assert len(folders(wanted)) == 1
    assert folders(package / "__pycache__") == []


def test_without_a_compiler_a_kernel_is_python_on_records(package):
    assert printed(package, NUMBA_DISABLE_JIT="1") == "[1.0, 1.0] plain"
    assert folders(package / "__pycache__") == []


def test_the_digest_is_that_of_names_and_texts_of_kernel_packages(tmp_path):
    for each in KERNEL_PACKAGES:
        (tmp_path / each).mkdir()
        (tmp_path / each / "module.py").write_text("A = 1\n")
    (tmp_path / "reports").mkdir()
    before = source_digest(tmp_path)
    (tmp_path / "reports" / "page.py").write_text("A = 1\n")
    (tmp_path / "core" / "notes.txt").write_text("not code")
    assert source_digest(tmp_path) == before
    seen = {before}
    for each in KERNEL_PACKAGES:
        (tmp_path / each / "module.py").write_text("A = 2\n")
        seen.add(source_digest(tmp_path))
    (tmp_path / "sim" / "module.py").rename(tmp_path / "sim" / "other.py")
    seen.add(source_digest(tmp_path))
    assert len(seen) == len(KERNEL_PACKAGES) + 2


def test_the_kernel_packages_are_those_that_hold_kernels():
    """What an entry compiles may come from any module that an entry's module imports."""
    root = Path(compiling.__file__).parents[1]
    marks = ("@entry", "@kernel", "@jitable", "register_jitable", "njit")
    found = {
        path.relative_to(root).parts[0]
        for path in root.rglob("*.py")
        if any(mark in path.read_text(encoding="utf-8") for mark in marks)
    }
    assert found <= set(KERNEL_PACKAGES)


@pytest.fixture
def parents(monkeypatch):
    """`cache_folder` as if only these folders could hold machine code."""

    def choose(*found):
        monkeypatch.setattr(compiling, "_parents", lambda package: iter(found))
        return cache_folder.__wrapped__()

    return choose


def test_the_first_folder_that_can_be_written_is_taken(parents, tmp_path):
    (tmp_path / "file").touch()
    unwritable, good = tmp_path / "file" / "cache", tmp_path / "good"
    (good / "kernels-of-another-installation").mkdir(parents=True)
    (good / "kernels-unused").mkdir()
    os.utime(good / "kernels-unused", (0.0, 0.0))
    found = parents(unwritable, good, tmp_path / "never")
    assert found.parent == good
    # a folder unused for long is removed, and no folder is made that is not needed
    assert folders(good) == sorted(["kernels-of-another-installation", found.name])
    assert not (tmp_path / "never").exists()


def test_without_a_folder_that_can_be_written_there_is_none(parents, tmp_path):
    (tmp_path / "file").touch()
    assert parents() is None
    assert parents(tmp_path / "file", tmp_path / "file" / "cache") is None


def test_a_folder_that_only_can_be_read_is_not_taken(parents, tmp_path, monkeypatch):
    monkeypatch.setattr(compiling.os, "access", lambda *_: False)
    assert parents(tmp_path) is None


def test_an_entry_without_a_cache_is_compiled_all_the_same(package, tmp_path):
    (tmp_path / "file").touch()
    nowhere = str(tmp_path / "file" / "cache")
    assert printed(package, NUMBA_CACHE_DIR=nowhere) == "[1.0, 1.0] 0"
    assert printed(package, NUMBA_CACHE_DIR=nowhere) == "[1.0, 1.0] 0"


def test_compiling_is_announced_once_and_loading_not_at_all():
    numba = pytest.importorskip("numba")
    said = []

    def first(x):
        return x + 1

    with compiling.compiling(lambda: said.append("begin")):
        one, two = (numba.njit(function) for function in (first, lambda x: x - 1))
        assert (one(1), two(1), one(1.0)) == (2, 0, 2.0)
    assert said == ["begin"]
    with compiling.compiling(lambda: said.append("again")):
        one(2)
    assert said == ["begin"]


def test_prepared_entries_compile_no_more():
    numba = pytest.importorskip("numba")
    step = numba.njit(lambda x, y: x + y)
    compiling.prepare([functools.partial(step, 1.0, 2), functools.partial(max, 1, 2)])
    assert len(step.signatures) == 1
    assert step(3.0, 4) == 7.0
    assert len(step.signatures) == 1


FLIGHT = """
import testbed
from testbed.scenario import load, set_duration

class Last:
    def begin(self, info):
        pass

    def observe(self, sample):
        self.sample = sample

    def end(self, summary, events):
        pass

last = Last()
scenario = set_duration(load("telemetry-radio"), 0.4)
testbed.run(scenario, write=False, observers=[last])
print([array.tobytes().hex() for array in (*last.sample.truth, *last.sample.estimate)])
"""


def test_debugger_and_compiler_fly_the_same_bits():
    """NUMBA_DISABLE_JIT=1 runs every kernel of a flight as Python."""
    printed = [
        subprocess.run(
            [sys.executable, "-c", FLIGHT],
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=True,
        ).stdout
        for environment in ({}, {"NUMBA_DISABLE_JIT": "1"})
    ]
    assert printed[0] == printed[1]
