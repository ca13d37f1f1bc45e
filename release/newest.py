"""Try other releases of JSBSim and Rerun than the pinned ones: the newest by default.

usage: python release/newest.py [jsbsim==VERSION] [rerun-sdk==VERSION]

Installs them into build/newest, without hashes, and runs the tests of flight models and of the
viewer with them in front of the pinned packages. The environment stays as it is. The exit code is
that of the tests, 0 if there is no other release, 2 if it cannot be installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.metadata import distributions, version
from pathlib import Path

ROOT = Path(__file__).parents[1]
INTO = ROOT / "build" / "newest"
NAMES = ("jsbsim", "rerun-sdk")
TESTS = (
    "tests/compiled/equations/test_compiled_states.py",
    "tests/compiled/equations/test_compiled_elements.py",
    "tests/vehicle/truth/test_airframe_tools.py",
    "tests/vehicle/truth/test_nesc_check_cases.py",
    "tests/whole/bounds/test_simulation_3.py",
    "tests/views/contract/test_view_commands.py",
    "tests/views/contract/test_viewer_process.py",
    "tests/views/contract/test_views.py",
    "tests/views/contract/test_web_viewer.py",
)


def main(names: list[str]) -> int:
    """Install, print the versions, and run the tests; return the exit code."""
    shutil.rmtree(INTO, ignore_errors=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheels = ["--no-deps", "--only-binary", ":all:", "--target", str(INTO)]
    if subprocess.run([*pip, "install", *wheels, *(names or NAMES)]).returncode:
        return 2
    found = {each.name: each.version for each in distributions(path=[str(INTO)])}
    for name, new in found.items():
        print(f"{name} {new}, pinned {version(name)}", flush=True)
    if all(new == version(name) for name, new in found.items()):
        return 0
    path = os.pathsep.join(filter(None, (str(INTO), os.environ.get("PYTHONPATH"))))
    pytest = [sys.executable, "-m", "pytest", "-q", *TESTS]
    return subprocess.run(pytest, cwd=ROOT, env=os.environ | {"PYTHONPATH": path}).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
