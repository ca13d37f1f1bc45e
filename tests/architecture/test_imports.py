"""Who may import what: the doors to heavy libraries, and the walls between the rooms."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import testbed

PACKAGE = Path(testbed.__file__).parent
ROOT = Path(__file__).parents[2]
LONGEST_MODULE = 300
LONGEST_DOOR = 400  # a door cannot be split: one module holds all that knows its library


def imports(path):
    """Every module that a file imports, at its top or inside a function."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively in line {node.lineno}"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


MODULES = {path.relative_to(PACKAGE).as_posix(): imports(path) for path in PACKAGE.rglob("*.py")}


def within(module, packages):
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def importers(*packages):
    return {path for path, found in MODULES.items() if any(within(m, packages) for m in found)}


def room(name):
    return {path: found for path, found in MODULES.items() if path.startswith(f"{name}/")}


def test_jsbsim_has_one_door():
    assert importers("jsbsim") == {"vehicle/jsbsim_door.py"}


def test_matplotlib_has_one_door():
    assert importers("matplotlib", "mpl_toolkits") == {"views/figure_door.py"}


def test_yaml_has_one_door():
    assert importers("yaml") == {"scenario/yaml_door.py"}


def test_pymavlink_has_one_door_and_only_its_generated_tables_pass():
    """They are under the MIT licence; most of the rest is, or imports what is, under the GPL."""
    assert importers("pymavlink") == {"mavlink/door.py"}
    named = {m for m in MODULES["mavlink/door.py"] if within(m, ["pymavlink"])}
    assert named == {"pymavlink.dialects.v20", "pymavlink.dialects.v20.ardupilotmega"}


def test_numba_has_one_door_and_it_is_for_twins_only():
    assert importers("numba") == {
        *("compiled.py", "unboxed.py"),
        *("guidance/helm_twin.py", "rows_twin.py", "vehicle/properties_twin.py"),
    }
    assert importers("testbed.unboxed") == {"compiled.py"}
    twins = {path for path in MODULES if path.endswith("twin.py")}
    decorated = {path for path, found in MODULES.items() if "testbed.compiled.twin" in found}
    assert decorated == twins


@pytest.mark.parametrize(
    ("packages", "home"),
    [
        (("mcap", "mcap_protobuf", "foxglove", "google.protobuf", "zstandard"), "record"),
        (("pyarrow",), "record"),
        (("rerun",), "views"),
    ],
)
def test_the_log_and_the_viewer_have_one_door_each(packages, home):
    # a door is a module, or a package of its own in its room
    doors = {tuple(path.removesuffix(".py").split("/")[:2]) for path in importers(*packages)}
    assert len(doors) == 1, doors
    room, door = doors.pop()
    assert room == home and "door" in door


def test_the_search_has_one_door():
    assert importers("cma") == {"study/cma_door.py"}


def test_who_flies_many_has_a_door_to_each_backend():
    assert importers("joblib") == {"study/processes.py"}
    assert importers("dask", "distributed") == {"study/cluster.py"}


def test_formation_knows_only_numpy_and_the_shared_vocabulary():
    ours = ("testbed.state", "testbed.frames", "testbed.compiled", "testbed.formation")
    modules = room("formation")
    assert modules
    for path, found in modules.items():
        strangers = {
            module
            for module in found
            if module.split(".")[0] not in sys.stdlib_module_names | {"numpy"}
            and not within(module, ours)
        }
        # `from testbed import frames` also names the package itself
        assert strangers <= {"testbed"}, path


FLOWN = ["air", "vehicle", "sensing", "network", "guidance", "formation"]
OBSERVERS = ["record", "metrics", "views"]
READERS = ["report"]  # of what observers left
OUTSIDE = ["links", "ardupilot"]  # programs outside, which speak MAVLink
ROOMS = [*FLOWN, *OBSERVERS, *READERS, *OUTSIDE, "mavlink", "scenario"]


def but(names, *allowed):
    return [name for name in names if name not in allowed]


FORBIDDEN = {
    "air": [*but(ROOMS, "air"), "sim", "study"],
    "vehicle": [*but(ROOMS, "vehicle", "scenario"), "sim", "study"],
    "sensing": [*but(ROOMS, "sensing", "scenario"), "sim", "study"],
    "network": [*but(ROOMS, "network", "scenario"), "sim", "study"],
    "guidance": [*but(ROOMS, "guidance", "scenario"), "sim", "study"],
    "record": [*but(FLOWN, "formation"), *READERS, "sim", "study"],
    "metrics": [*but(FLOWN, "formation"), *READERS, "sim", "record", "views", "study"],
    "views": [*but(FLOWN, "formation"), *READERS, "sim", "study"],
    "report": [*but(FLOWN, "formation"), *OUTSIDE, "mavlink", "sim", "study"],
    "mavlink": [*but(ROOMS, "mavlink"), "sim", "study"],
    "links": [*but(ROOMS, "links", "mavlink"), "sim", "study"],
    "ardupilot": [*but(ROOMS, "ardupilot", "mavlink"), "sim", "study"],
    "scenario": [*but(ROOMS, "scenario"), "sim", "frames", "state", "study"],
    "sim": ["cli", "views", "report", "study"],
    "study": ["cli", "views", "report"],
}


@pytest.mark.parametrize(("name", "others"), FORBIDDEN.items(), ids=FORBIDDEN)
def test_a_room_does_not_know_its_neighbours(name, others):
    modules = room(name)
    assert modules
    walls = [f"testbed.{other}" for other in others]
    for path, found in modules.items():
        assert not {module for module in found if within(module, walls)}, path


def test_sockets_and_programs_outside_have_few_doors():
    opened = {"links/endpoint.py", "ardupilot/"}
    for module in ("socket", "socketserver", "asyncio", "http"):
        for path in importers(module):
            assert any(path.startswith(door) for door in opened) or path.startswith("views/"), path


def test_nobody_imports_the_command_line():
    assert importers("testbed.cli") <= {"__main__.py"}


def modules_after(statement):
    code = f"{statement}; import json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(json.loads(done.stdout))


@pytest.mark.parametrize("statement", ["import testbed", "import testbed.scenario"])
def test_importing_the_page_loads_nothing_heavy(statement):
    heavy = {
        "numpy",
        "numba",
        "scipy",
        "matplotlib",
        "jsbsim",
        "mcap",
        "foxglove",
        "google.protobuf",
        "pymavlink",
        "rerun",
        "pyarrow",
        "pandas",
        "xarray",
        "joblib",
        "distributed",
        "cma",
    }
    loaded = modules_after(statement)
    assert "testbed" in loaded
    assert not heavy & loaded


@pytest.mark.parametrize("path", sorted(MODULES))
def test_a_module_is_short(path):
    longest = LONGEST_DOOR if path.endswith("door.py") else LONGEST_MODULE
    assert len((PACKAGE / path).read_text(encoding="utf-8").splitlines()) <= longest


def text_files():
    skipped = {".git", "logs", "build", "dist", "__pycache__"}
    for here, folders, files in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name not in skipped and not name.startswith(".venv") and not name.endswith("_cache")
        ]
        for path in filter(Path.is_file, (Path(here, name) for name in files)):
            try:
                yield path, path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue  # a picture


def test_no_file_names_a_folder_of_one_machine():
    machine = re.compile(r"(?<![\w.~*}>$-])/(work|root|home|Users|opt|mnt|srv)/\w|\b[A-Z]:\\\w")
    named = [
        f"{path.relative_to(ROOT)}: {hit.group()}"
        for path, text in text_files()
        if (hit := machine.search(text))
    ]
    assert not named


def test_the_lock_names_no_index():
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "--hash=sha256:" in lock
    assert not re.search(r"://|--(extra-)?index-url|--find-links|-f ", lock)
    pins = re.findall(r"^([a-z0-9-]+)==(\S+)", lock, re.MULTILINE)
    assert ("jsbsim", "1.3.3") in pins
