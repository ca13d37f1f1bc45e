"""Machine code is kept, and never that of sources that have changed."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from testbed import compiled

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
        timeout=120,
        check=True,
    )
    return done.stdout.split()


def test_a_constant_of_another_file_is_compiled_anew(tmp_path):
    package = tmp_path / "testbed"
    package.mkdir()
    (package / "__init__.py").touch()
    shutil.copy(Path(compiled.__file__), package)
    (package / "room_twin.py").write_text(TWIN)
    (package / "numbers.py").write_text("STEP = 1\n")
    assert printed(tmp_path) == ["2", "0"]
    assert printed(tmp_path) == ["2", "1"], "it was not kept"
    (package / "numbers.py").write_text("STEP = 2\n")
    assert printed(tmp_path) == ["3", "0"]
    assert len(list((package / "__pycache__").glob("twins-*"))) == 1
    assert not list(package.glob("__pycache__/*.nb[ic]"))
