"""Which module may import what: layers without cycles, one module for each heavy library."""

import ast
import functools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import package_groups as packages
import pytest

import testbed

PACKAGE = Path(testbed.__file__).parent
ROOT = Path(__file__).parents[2]
FILES = {
    ".".join(("testbed", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(
        ".__init__"
    ): path
    for path in PACKAGE.rglob("*.py")
    if path.parent.name != "laws"  # which are loaded as files of users are
}


IMPORTS = (ast.Import, ast.ImportFrom)


@functools.cache
def nodes(path):
    """Imports of a file, and calls that open one; all nodes of all files would fill the memory."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        each
        for each in ast.walk(tree)
        if isinstance(each, IMPORTS) or (isinstance(each, ast.Call) and opens_file(each))
    ]


def imports(path):
    """Names that a file imports: while it is loaded, in functions, and for types alone."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively in line {node.lineno}"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found |= {full} if full in FILES else {node.module, full}
    return found


@functools.cache
def all_imports():
    """What each module of the testbed imports."""
    return {name: imports(path) for name, path in FILES.items()}


def test_laws_of_the_library_import_what_a_user_may():
    laws = sorted((PACKAGE / "laws").glob("*.py"))
    assert laws
    for path in laws:
        modules = {name for name in imports(path) if name[0].islower()}
        named = {name for name in modules if not within(name, ["testbed.law"])}
        assert named <= {"testbed", "numpy", "typing", "typing.Any"}, path


def within(module, packages):
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def importers(*packages):
    return {
        name
        for name, found in all_imports().items()
        if any(within(each, packages) for each in found)
    }


def test_modules_import_without_cycles():
    """Inside packages too, whenever the import is made; `testbed` itself is imported by none."""
    modules = FILES.keys() - {"testbed"}
    edges = {name: all_imports()[name] & modules for name in modules}
    while leaves := {name for name, needed in edges.items() if not needed - {name}}:
        edges = {name: needed - leaves for name, needed in edges.items() if name not in leaves}
    assert not edges
    assert not [name for name, found in all_imports().items() if "testbed" in found]


def forbidden(imports):
    """Return the imports between packages that the table of packages does not allow."""
    found = []
    for module, names in imports.items():
        package = module.split(".")[1] if "." in module else ""
        if package in packages.PACKAGES:
            others = {each.split(".")[1] for each in names if each in FILES and "." in each}
            found += [(module, other) for other in others - packages.allowed(package) - {"run"}]
    return sorted(found)


def test_packages_import_what_the_table_allows():
    assert forbidden(all_imports()) == []
    upwards = all_imports() | {"testbed.core.frames": {"testbed.flight.loop"}}  # control
    assert forbidden(upwards) == [("testbed.core.frames", "flight")]


def test_groups_import_downwards():
    """In the order of the table; packages of a group know each other without a circle."""
    for number, group in enumerate(packages.GROUPS):
        below = {each.name for each in packages.GROUPS[:number]}
        assert set(group.imports.split()) <= below, group.name
        known = {each.name for each in packages.GROUPS if each.name in group.imports.split()}
        for name, words in group.packages.items():
            others = set(words.split()) - set(group.packages) - {"all"}
            assert {packages.PACKAGES[each].name for each in others} <= known, name


def test_table_allows_no_more_than_is_imported():
    """Nothing is allowed that no module uses; the command line may use everything."""
    for name in packages.PACKAGES.keys() - {"cli"}:
        inside = [
            found for module, found in all_imports().items() if within(module, [f"testbed.{name}"])
        ]
        used = {
            each.split(".")[1]
            for found in inside
            for each in found
            if each in FILES and "." in each
        }
        assert packages.allowed(name) - used <= {"core", name}, name


def test_every_package_has_a_group():
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(packages.PACKAGES)
    sizes = {
        name: len([path for path in (PACKAGE / name).glob("*.py") if path.name != "__init__.py"])
        for name in packages.PACKAGES.keys() - {"cli", "views", "core"}
    }
    assert max(sizes.values()) <= 26, sizes


def test_a_name_of_a_module_tells_which_it_is():
    """One outside the command line, and what a key is, is planned as and does in flight."""
    pattern = {"cli", "scenario", "plan", "flight", "law"}
    places = {}
    for module in FILES:
        *folders, name = module.split(".")
        places.setdefault(name, set()).add(folders[1] if folders[1:] else "")
    places = {name: found - pattern - {""} for name, found in places.items() if name[0] != "_"}
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_page_and_picture_are_made_of_the_table():
    text = packages.PAGE.read_text("utf-8")
    if "TESTBED_SNAPSHOTS" in os.environ:
        packages.PAGE.write_text(packages.page(text), "utf-8")
        packages.PICTURE.write_text(packages.picture(), "utf-8")
    assert packages.PAGE.read_text("utf-8") == packages.page(text)
    assert packages.PICTURE.read_text("utf-8") == packages.picture()


def test_only_main_imports_the_command_line():
    outside = {name for name in importers("testbed.cli") if not within(name, ["testbed.cli"])}
    assert outside == {"testbed.__main__"}


ONE_MODULE = {
    ("jsbsim",): "vehicle.jsbsim_adapter",
    ("matplotlib", "mpl_toolkits"): "views.matplotlib_backend",
    ("rerun",): "views.rerun_backend",
    ("yaml",): "scenario.yaml_io",
    ("pymavlink",): "mavlink.codec",
    ("pyulog",): "flight_logs.ulog_file",
    ("mcap", "mcap_protobuf", "google.protobuf", "zstandard"): "logs.mcap_file",
    ("foxglove",): "logs.foxglove_messages",
    ("rosbags",): "logs.ros2_bag",
    ("pyarrow",): "logs.arrow_io",
    ("cma",): "tuning.tune_search",
    ("gymnasium",): "rl",
    ("pettingzoo",): "rl",
    ("joblib",): "pool.local_workers",
    ("dask", "distributed"): "pool.dask_workers",
}


@pytest.mark.parametrize(("libraries", "module"), ONE_MODULE.items(), ids=ONE_MODULE.values())
def test_a_library_is_imported_in_one_place(libraries, module):
    users = importers(*libraries)
    assert users
    assert all(within(user, [f"testbed.{module}"]) for user in users), users


def test_only_mit_tables_of_pymavlink_are_imported():
    """Most of the rest is, or imports what is, under the GPL."""
    named = {each for each in all_imports()["testbed.mavlink.codec"] if within(each, ["pymavlink"])}
    assert named == {"pymavlink.dialects.v20", "pymavlink.dialects.v20.ardupilotmega"}


def test_sockets_are_opened_in_few_places():
    places = [
        *("testbed.mavlink.udp_endpoint", "testbed.ardupilot", "testbed.views"),
        "testbed.companion.watchdog",  # to the service manager, by a socket of this computer
    ]
    for name in importers("socket", "socketserver", "asyncio", "http"):
        assert within(name, places), name


# Modules that open files themselves, with the reason. All others use `core.input_files`, which
# waits for no pipe, and `core.files`, which replaces a file whole or not at all.
OPENING = {
    "core.files": "it is the one that writes",
    "core.input_files": "it is the one that reads",
    "core.compile": "sources and locks of the package itself",
    "benchmark.limited_flight": "the null device, for a stranger's program",
    "core.kept_files": "by the open folder; whatever fails is a miss",
    "logs.file_record": "appends to the record, if it is a regular file",
    "logs.mcap_file": "a new file of its own",
    "mavlink.tlog": "a new file in a new run directory, or at a path that was checked",
    "link.ends": "a serial device",
    "fmi.archive": "new files in a temporary folder of its own",
    "studies.journal": "checks that it is a regular file; opened to write, a pipe does not block",
    "ardupilot.sitl_process": "files in a temporary folder of its own",
    "runs.companion_processes": "files in a temporary folder of its own",
    "airframes.forked_trial": "a pipe to its own child, and the null device",
    "views.feeder_process": "the null device",
    "views.viewer": "a table of the kernel",
    "plan.resources": "tables of the kernel",
    "plan.user_code": "metadata of an installed package",
    "fmi.aircraft_fmu": "data of the package itself, and a temporary folder for a compiler",
    "cli.new": "templates of the package itself",
    "cli.output": "the null device",
}


def test_files_are_opened_in_few_places():
    """Also `Path.open`, which is known by its mode; a mode is never computed."""
    found = {
        name.removeprefix("testbed.")
        for name, path in FILES.items()
        if any(isinstance(each, ast.Call) for each in nodes(path))
    }
    assert found == OPENING.keys()


def opens_file(call):
    function = call.func
    if isinstance(function, ast.Name):
        return function.id == "open"
    if not isinstance(function, ast.Attribute):
        return False
    texts = ("read_text", "read_bytes", "write_text", "write_bytes")
    of_os = isinstance(function.value, ast.Name) and function.value.id in ("os", "io")
    mode = [each.value for each in call.args[:1] if isinstance(each, ast.Constant)]
    opened = function.attr == "open" and (of_os or any(isinstance(each, str) for each in mode))
    return opened or function.attr in texts


def modules_after(statement):
    code = f"{statement}; import json, sys; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(json.loads(done.stdout))


def test_importing_schema_is_light():
    """Which imports `testbed`, too."""
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
        "pyulog",
        "rerun",
        "pyarrow",
        "pandas",
        "xarray",
        "joblib",
        "distributed",
        "cma",
    }
    loaded = modules_after("import testbed.scenario")
    assert {"testbed", "testbed.scenario.schema"} <= loaded
    assert not heavy & loaded


def text_files():
    skipped = {".git", "logs", "build", "dist", "__pycache__"}
    for here, folders, files in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name not in skipped and not name.startswith(".venv") and not name.endswith("_cache")
        ]
        for path in filter(Path.is_file, (Path(here, name) for name in files if name != ".git")):
            try:
                yield path, path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                continue  # a picture


def test_no_file_names_a_folder_of_one_machine():
    folders = ("work", "root", "home", "Users", "opt", "mnt", "srv")
    machine = re.compile(rf"(?<![\w.~*}}>$-])/({'|'.join(folders)})/\w|\b[A-Z]:\\\w")
    parts = (*(f"/{each}/" for each in folders), ":\\")  # found sooner than the expression
    named = [
        f"{path.relative_to(ROOT)}: {hit.group()}"
        for path, text in text_files()
        if any(each in text for each in parts) and (hit := machine.search(text))
    ]
    assert not named


def test_the_lock_names_no_index():
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "--hash=sha256:" in lock
    assert not re.search(r"://|--(extra-)?index-url|--find-links|-f ", lock)
    pins = re.findall(r"^([a-z0-9-]+)==(\S+)", lock, re.MULTILINE)
    assert ("jsbsim", "1.3.3") in pins


# By what runs code that is not imported by its name: the modules that use it, and why.
RUNS_CODE = {
    "subprocess": {
        "core.child_guard",  # the command that its starter gives it
        "ardupilot.sitl_process",  # ArduPlane: of the option or the environment
        "fmi.compilers",  # cc and zig: of the options or PATH
        "runs.companion_processes",  # this Python and package, for the companions of a run
        "views.view",  # this Python, for the views' process
        "views.viewer",  # rerun, beside this Python
    },
    "pickle": {
        "core.machine_code",  # kept files, whose folder no other user may write
        "plan.user_code",  # dumps only: whether a law's memory has changed
        "core.forked",  # what its own child sends
        "views.feeder_process",  # what its own parent sends
        "views.view",
    },
    "importlib": {
        "plan.user_code",  # laws and functions of scenarios: `find_code` is the gate
        "testbed",  # names of its own that load on demand
        "rl",
        "cli.main",  # the modules of its commands, by the names in `PANELS`
    },
    "runpy": set(),
    "marshal": set(),
    "shelve": set(),
    "webbrowser": set(),
}
CALLS = re.compile(
    r"(?<![.\w])(?:eval|exec|__import__)\(|os\.(?:system|popen|exec\w+|spawn\w+|posix_spawn\w*)\("
    r"|allow_pickle=True|shell=True|unsafe_load|joblib\.load\(|torch\.load\("
)


def test_code_is_run_in_known_places_only():
    """A scenario, study or log reaches none of them but `plan.user_code`."""
    harmless = ("importlib.metadata", "importlib.resources")
    for package, known in RUNS_CODE.items():
        used = {
            name.removeprefix("testbed.")
            for name, found in all_imports().items()
            if any(within(each, (package,)) and not within(each, harmless) for each in found)
        }
        assert used == known, package
    found = {n for n, path in FILES.items() if CALLS.search(path.read_text(encoding="utf-8"))}
    # sources that `compiled` has written: numbers, and names of its own making
    assert found == {"testbed.core.compile"}
    assert {
        n for n, each in all_imports().items() if "testbed.core.compile.entry_of_source" in each
    } == {"testbed.compiled.compiled_aircraft"}
