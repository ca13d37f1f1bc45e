"""Tests that passed and of which nothing has changed since: `make test` leaves them out.

A file of tests is unchanged if it, the modules that it imports, theirs, and all data are as they
were when all its tests passed. The modules are found by their imports. A file that starts programs,
imports `testbed` as a whole or reads other files of the repository depends on every file of it.
"""

import hashlib
import json
import os
import platform
import re
import subprocess
from functools import cache

from places import ROOT, SHARED

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
# imports of `testbed` itself are those of files that use it as a whole; modules of users are data
WHOLE = ROOT / "testbed" / "__init__.py"
COMPUTED = {WHOLE, ROOT / "testbed" / "plan" / "user_code.py"}
# what a file that depends on its imports alone has not: processes, other files, `import testbed`
EVERYTHING = re.compile(
    r"\bsubprocess\b|\bmultiprocessing\b|\bROOT\b|^\s*(?:import testbed$|from testbed import)", re.M
)
OF_DATA = re.compile(r'ROOT / "(?:aircraft|scenarios)"|ROOT / "tests" / "(?:data|snapshots)"')


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


def closure(path):
    """Return a file and all that it imports, directly or not."""
    found, new = set(), {path}
    while new:
        found |= new
        new = set().union(*(imported(each) for each in new)) - found
    return found


@cache
def finds_modules(path):
    """Return whether a file imports modules by names that are computed."""
    return "import_module(" in path.read_text("utf-8")


@cache
def uses_everything(path):
    """Return whether a file of the tests starts programs or reads other files."""
    return bool(EVERYTHING.search(OF_DATA.sub("", path.read_text("utf-8"))))


def environment():
    """Return what else decides a test: the interpreter and the sizes of samples."""
    sizes = {
        name: text for name, text in os.environ.items() if name.startswith(("TESTBED_", "NUMBA_"))
    }
    return json.dumps([platform.python_version(), platform.machine(), sorted(sizes.items())])


def stamp(path):
    """Return the digest of all that decides the tests of a file."""
    files = closure(path)
    own = [each for each in files if each.is_relative_to(SHARED.parent)]
    others = [each for each in files if each not in own and each not in COMPUTED]
    read = (each for each in own if each.name != "places.py")
    if any(map(uses_everything, read)) or any(map(finds_modules, others)):
        parts = [digest_below("")]
    else:
        parts = [digest_below(*DATA), *sorted(f"{each.name} {digest_of(each)}" for each in files)]
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
