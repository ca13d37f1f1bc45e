"""Tests that passed and of which nothing has changed since: `make test` leaves them out.

A file of tests is unchanged if it, the modules that it imports, theirs, and all data are as they
were when all its tests passed. Modules are found by the imports, by the names of the testbed in a
text (`-m testbed.cli`, a patched function), and by the commands whose names stand in a text; other
files by `ROOT / "docs"`. A file that reaches the repository in another way depends on all of it.
"""

import ast
import hashlib
import json
import os
import platform
import re
import subprocess
from functools import cache
from typing import NamedTuple

from places import ROOT, SHARED, TESTS

import testbed
from testbed.cli.main import _MODULES as OF_COMMANDS

FILE = ROOT / "build" / "test-stamps.json"
IMPORT = re.compile(
    r"^\s*(?:from\s+([\w.]+)\s+import\s+(\(.*?\)|[^\n]*)|import\s+([\w.]+))", re.M | re.S
)
DATA = (
    "aircraft",
    "scenarios",
    "tests/data",
    "tests/snapshots",
    "requirements.lock",
    "pyproject.toml",
)
# These import modules by computed names: that of a public name, of a command, and of a user.
WHOLE = ROOT / "testbed" / "__init__.py"
COMMANDS = ROOT / "testbed" / "cli" / "main.py"
COMPUTED = {WHOLE, COMMANDS, ROOT / "testbed" / "plan" / "user_code.py"}
NAME = re.compile(r"\btestbed(?:\.\w+)+")
IN_TEXT = re.compile(r"\bfrom testbed import ([\w, ]+)")
FOLDERS = {"ROOT": ROOT, "TESTS": TESTS, "SHARED": SHARED}


class Reached(NamedTuple):
    """What a file outside the testbed reaches without importing it.

    Attributes:
        modules: names of modules.
        paths: files and folders.
        words: of its texts, among them names of commands.
        everything: it reaches the repository in a way that cannot be followed.
    """

    modules: frozenset
    paths: frozenset
    words: frozenset
    everything: bool


def wanted():
    """Return whether tests may be left out: not in CI, and not with ALL=1."""
    return not any(os.environ.get(name) for name in ("CI", "ALL", "TESTBED_SHARD"))


@cache
def digest_of(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def repository():
    """Return the files of the repository: those of git that exist, and new ones."""
    command = [
        "git",
        "-C",
        str(ROOT),
        "ls-files",
        "-z",
        "--cached",
        "--others",
        "--exclude-standard",
    ]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
    return sorted({ROOT / name for name in names if name and (ROOT / name).is_file()})


@cache
def digest_below(*folders):
    places = tuple(str(ROOT / each) for each in folders)
    found = [path for path in repository() if str(path).startswith(places)]
    lines = [f"{path.relative_to(ROOT)} {digest_of(path)}" for path in found]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@cache
def module_files(name):
    """Return the files of a module of the testbed or of the tests, with those of its packages."""
    words, found = name.split("."), []
    if words[0] == "testbed":
        for count in range(1, len(words) + 1):
            base = ROOT.joinpath(*words[:count])
            found += [
                each for each in (base / "__init__.py", base.with_suffix(".py")) if each.is_file()
            ]
    else:
        base = SHARED / words[0]
        others = [SHARED.parent / "reference" / f"{word}.py" for word in words[1:]]
        found = [each for each in (base.with_suffix(".py"), *others) if each.is_file()]
    return found


@cache
def imported(path):
    """Return the files that a file imports."""
    found = set()
    if path == WHOLE:
        return found
    for source, names, plain in IMPORT.findall(path.read_text("utf-8")):
        found.update(module_files(source or plain))
        for name in re.findall(r"\w+", re.sub(r"#[^\n]*", "", names)):
            found.update(module_files(f"{source}.{name}"))
        beside = path.with_name(f"{(source or plain).split('.')[0]}.py")
        found.update([beside] if beside.is_file() else [])
    return found


@cache
def closure(path):
    """Return a file and all that it imports, directly or not."""
    found, new = frozenset(), frozenset([path])
    while new:
        found |= new
        new = frozenset().union(*map(imported, new)) - found
    return found


@cache
def reached(path):
    """Return what a file outside the testbed reaches without importing it."""
    tree = ast.parse(path.read_text("utf-8"))
    parents, nodes = {}, [tree]
    modules, paths, words, everything = set(), set(), set(), False
    for node in nodes:
        parent, children = parents.get(node), list(ast.iter_child_nodes(node))
        parents.update(dict.fromkeys(children, node))
        nodes += children
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if isinstance(parent, ast.Expr):  # a docstring
                continue
            modules.update(map(module_of, NAME.findall(node.value)))
            for names in IN_TEXT.findall(node.value):
                modules.update(module_of(f"testbed.{each}") for each in names.split(", "))
            words.update(re.findall(r"[\w-]+", node.value))
            everything |= "from testbed import (" in node.value
        elif isinstance(node, ast.ImportFrom) and node.module == "testbed":
            modules.update(module_of(f"testbed.{each.name}") for each in node.names)
            everything |= node.names[0].name == "*"
        elif isinstance(node, ast.alias) and node.name in ("testbed", *FOLDERS):
            everything |= node.asname is not None
        elif isinstance(node, ast.Attribute) and node.attr in FOLDERS:
            everything = True
        elif isinstance(node, ast.Name) and node.id == "testbed":
            named = isinstance(parent, ast.Attribute) and not parent.attr.startswith("_")
            modules.update([module_of(f"testbed.{parent.attr}")] if named else ())
            everything |= not named
        elif isinstance(node, ast.Name) and node.id in FOLDERS:
            below = []
            while isinstance(parent, ast.BinOp) and isinstance(parent.right, ast.Constant):
                below.append(parent.right.value)
                parent = parents[parent]
            # `[ROOT]` and `environment(80, SHARED)` are folders of modules to import
            listed = isinstance(parent, ast.List) or (
                isinstance(parent, ast.Call) and ast.unparse(parent.func) in ("str", "environment")
            )
            paths.update([FOLDERS[node.id].joinpath(*below)] if below else ())
            everything |= not below and not listed
        elif isinstance(node, ast.Name) and node.id == "__file__":
            everything |= not isinstance(parent, ast.List)  # a program that starts itself
    return Reached(frozenset(modules), frozenset(paths), frozenset(words), everything)


def module_of(name):
    """Return the module of a name of the testbed; public names are in modules of their own."""
    public = name.split(".")[1]
    return testbed._MODULES.get(public, name)


@cache
def computed(path):
    """Return names of the modules that a file of the testbed imports by `import_module`."""
    text = path.read_text("utf-8")
    if path in COMPUTED or "import_module(" not in text:
        return frozenset()
    return frozenset(NAME.findall(text))


@cache
def decisive(path):
    """Return the files that decide the tests of a file, and paths of others; None: all."""
    files, paths, new = frozenset(), set(), closure(path)
    while new:
        files |= new
        found = [reached(each) for each in files if is_outside(each)]
        if any(each.everything for each in found):
            return None
        names = set().union(*(each.modules for each in found), *map(computed, files))
        if COMMANDS in files:
            words = set().union(*(each.words for each in found))
            names |= {module for name, module in OF_COMMANDS.items() if {*name.split()} <= words}
        added = set().union(*map(module_files, names))
        for each in set().union(*(each.paths for each in found)) - paths:
            paths.add(each)
            added.update(one for one in programs() if one.is_relative_to(each))
        new = frozenset().union(*map(closure, added - files)) - files
    return files, {each.relative_to(ROOT).as_posix() for each in paths}


@cache
def is_outside(path):
    """Return whether a file is one of the tests or a program beside the testbed."""
    return not path.is_relative_to(ROOT / "testbed") and path.name != "places.py"


@cache
def programs():
    return [path for path in repository() if path.suffix == ".py"]


def environment():
    """Return what else decides a test: the interpreter and the sizes of samples."""
    sizes = {
        name: text for name, text in os.environ.items() if name.startswith(("TESTBED_", "NUMBA_"))
    }
    return json.dumps([platform.python_version(), platform.machine(), sorted(sizes.items())])


def stamp(path):
    """Return the digest of all that decides the tests of a file."""
    if (found := decisive(path)) is None:
        parts = [digest_below("")]
    else:
        files, paths = found
        parts = [digest_below(*DATA, *sorted(paths))]
        parts += sorted(f"{each} {digest_of(each)}" for each in files)
    return hashlib.sha256("\n".join([environment(), *parts]).encode()).hexdigest()


def read_stamps():
    try:
        found = json.loads(FILE.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def unchanged():
    """Return the number of tests of each file that is as it was when its tests passed."""
    known = {ROOT / name: found for name, found in read_stamps().items()}
    return {
        str(path): found["tests"]
        for path, found in known.items()
        if path.is_file() and found["stamp"] == stamp(path)
    }


def write_stamps(passed, failed):
    """Write the stamps of files of tests that passed, and remove those of others.

    Args:
        passed: number of tests by file.
        failed: files.
    """
    stamps = {k: v for k, v in read_stamps().items() if ROOT / k not in failed}
    for path, tests in passed.items():
        stamps[str(path.relative_to(ROOT))] = {"stamp": stamp(path), "tests": tests}
    FILE.parent.mkdir(exist_ok=True)
    new = FILE.with_suffix(f".{os.getpid()}")
    new.write_text(json.dumps(stamps, indent=1, sort_keys=True), "utf-8")
    new.replace(FILE)
