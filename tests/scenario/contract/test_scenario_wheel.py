"""Files of an installed wheel."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from places import ROOT

from testbed.scenario import list_aircraft, list_data, list_scenarios


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("formation_testbed-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_wheel_finds_all_files_of_checkout(installed, tmp_path):
    code = (
        "import testbed.scenario as s\n"
        "print(s.library())\n"
        "print(*s.list_aircraft(), *s.list_scenarios(), *s.list_data())\n"
        "scenario = s.load_scenario('simulation-3')\n"
        "print(s.find_tune(scenario.leader.aircraft, scenario.leader.tune).suffix)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(installed)},
        check=True,
        capture_output=True,
        text=True,
    )
    library, names, suffix = done.stdout.splitlines()
    assert Path(library) == installed / "testbed" / "_data"
    assert names.split() == [*list_aircraft(), *list_scenarios(), *list_data()]
    assert suffix == ".param"
    assert (installed / "testbed" / "py.typed").is_file()


def test_wheel_contains_aircraft_and_scenarios(installed):
    for folder in ("aircraft", "scenarios"):
        here = {p.relative_to(ROOT) for p in (ROOT / folder).rglob("*") if p.is_file()}
        there = installed / "testbed" / "_data"
        assert here == {p.relative_to(there) for p in (there / folder).rglob("*") if p.is_file()}
