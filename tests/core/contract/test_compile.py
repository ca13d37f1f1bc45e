"""Machine code is cached per text of the kernel packages, and never used for another text."""

import json
import os
import shutil
from pathlib import Path

import numba
import pytest
from cases import ALL
from commands import call_command
from fresh import NOT_MOUNTED, run_fresh
from places import ROOT

from testbed.core import compile as compiling
from testbed.core.compile import KERNEL_PACKAGES, kept_files, source_digest
from testbed.core.kept_files import Place

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
from testbed.flight.stepping import step
import numpy as np

records = allocate(np.dtype([("x", "f8"), ("v", "f8", 3)], align=True), 2)
step(records)
hits = sum(step.dispatcher.stats.cache_hits.values()) if hasattr(step, "dispatcher") else "plain"
print(records["x"].tolist(), hits)
"""
# of two functions with one name and types, which are too long to become part of their callers
SCALED = f"""
from math import sin
import numpy as np
from testbed.core.call_list import Call
from testbed.core.compile import checked_kernel, entry_of_user_code

def called(function, digest):
    x = np.ones(1)
    Call(entry_of_user_code(function, digest), x)(0.0)
    return x[0]

def scaled_one(scale):
    def scaled(x):
        {"; ".join(f"x += sin({k} * x)" for k in range(60))}
        return scale * x

    one = checked_kernel(scaled)

    def step(x):
        x[0] = one(x[0])
        return 0

    def before(x):
        return int(one(x[0]))

    called(before, None)  # compiled before anything is kept
    return called(step, str(scale))
"""
SHARED = """
from testbed.core.compile import kept_kernel
from testbed.formation.numbers import STEP


@kept_kernel
def shared(x):
    return x + STEP
"""
LAW = """
import numpy as np
from testbed.core.call_list import Call
from testbed.core.compile import entry_of_user_code
from testbed.flight.shared import shared

def law(x):
    x[0] = {factor} * shared(x[0])
    return 0

x = np.ones(1)
Call(entry_of_user_code(law, "law of {factor}"), x)(0.0)
print(x[0], sum(shared.dispatcher.stats.cache_hits.values()))
"""
MAIN = "from testbed.cli.main import main; main()"


@pytest.fixture
def package(tmp_path):
    """A package with the product's core and two kernel packages of its own."""
    package = tmp_path / "testbed"
    for name in ("core", "flight", "formation"):
        (package / name).mkdir(parents=True)
        (package / name / "__init__.py").touch()
    (package / "__init__.py").touch()
    core = Path(compiling.__file__).parent
    for module in (
        *("call_list.py", "compile.py", "field_docs.py", "flags.py", "kept_files.py"),
        *("kernel_code.py", "machine_code.py", "records.py"),
    ):
        shutil.copy(core / module, package / "core")
    (package / "flight" / "stepping.py").write_text(ENTRY)
    (package / "formation" / "numbers.py").write_text("STEP = 1.0\n")
    return package


def printed(package, *, script=CALL, folder=None, mount="", **variables):
    """Output of a script that imports a package, after a mount that other processes do not see."""
    # without variables that say where machine code is kept
    without = ("NUMBA_", "XDG_CACHE_HOME")
    inherited = {key: value for key, value in os.environ.items() if not key.startswith(without)}
    code, output, errors = run_fresh(
        script,
        folder=folder or package.parent,
        paths=[package.parent],
        env={**inherited, "PYTHONDONTWRITEBYTECODE": "1", **variables},
        mount=mount,
    )
    if mount and code == NOT_MOUNTED:
        pytest.skip("nothing can be mounted here, neither as root nor in a user namespace")
    assert code == 0, errors
    return output.strip()


def read_only(folder):
    """Command that makes a folder read-only, also for root."""
    return f"mount --bind {folder} {folder} && mount -o remount,ro,bind {folder}"


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
    found = [path.relative_to(cache) for path in package.rglob("*.code")]
    assert {path.parts[0] for path in found} == set(folders(cache))


def test_laws_share_a_kept_kernel(package):
    """The second law loads it, and a changed constant of another file is in both."""
    (package / "flight" / "shared.py").write_text(SHARED)
    found = [printed(package, script=LAW.format(factor=each)) for each in (2.0, 3.0)]
    assert found == ["4.0 0", "6.0 1"]
    (package / "formation" / "numbers.py").write_text("STEP = 2.0\n")
    assert printed(package, script=LAW.format(factor=3.0)) == "9.0 0"


def test_numba_cache_dir_replaces_the_package_folder(package, tmp_path):
    wanted = tmp_path / "elsewhere"
    assert printed(package, NUMBA_CACHE_DIR=str(wanted)) == "[1.0, 1.0] 0"
    assert printed(package, NUMBA_CACHE_DIR=str(wanted)) == "[1.0, 1.0] 1"
    assert len(folders(wanted)) == 1
    assert folders(package / "__pycache__") == []


def test_debug_mode_runs_kernels_as_python(package):
    assert printed(package, NUMBA_DISABLE_JIT="1") == "[1.0, 1.0] plain"
    assert folders(package / "__pycache__") == []


def test_digest_covers_names_and_texts_of_packages(tmp_path):
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
    (tmp_path / "flight" / "module.py").rename(tmp_path / "flight" / "other.py")
    seen.add(source_digest(tmp_path))
    assert len(seen) == len(KERNEL_PACKAGES) + 2


def test_digest_of_other_folders_covers_all_below(tmp_path):
    (tmp_path / "studies" / "parts").mkdir(parents=True)
    seen = {source_digest(tmp_path, ["studies"])}
    for name in ("studies/plan.py", "studies/parts/rows.py", "views.py"):
        (tmp_path / name).write_text("A = 1\n")
        seen.add(source_digest(tmp_path, ["studies"]))
    assert len(seen) == 3


def test_kernel_packages_are_all_with_kernels():
    """What an entry compiles may come from any module that an entry's module imports."""
    root = Path(compiling.__file__).parents[1]
    marks = ("@entry", "@kernel", "@jitable", "register_jitable", "njit")
    found = {
        path.relative_to(root).parts[0]
        for path in root.rglob("*.py")
        if "__pycache__" not in path.parts  # there are sources of compiled aircraft, too
        if any(mark in path.read_text(encoding="utf-8") for mark in marks)
    }
    assert found <= set(KERNEL_PACKAGES)


@pytest.fixture
def places(monkeypatch):
    """`kept_files` as if only these folders could hold machine code."""

    def choose(*found):
        monkeypatch.setattr(compiling, "_places", lambda package: map(Place, found))
        return kept_files.__wrapped__()

    return choose


def test_the_first_folder_that_can_be_written_is_taken(places, tmp_path):
    (tmp_path / "file").touch()
    unwritable, good = tmp_path / "file" / "cache", tmp_path / "good"
    recent, unused = "kernels-0123456789abcdef", "kernels-fedcba9876543210"
    users = "kernels-of-the-user"  # not the testbed's: never removed
    noted = "kernels-00000000000000ff"  # has a file of the user
    earlier = "kernels-00000000000000fe"  # of an earlier version
    for name in (recent, unused, users, noted, earlier):
        (good / name).mkdir(parents=True)
        (good / name / "sim.loop.step-3.code").touch()
    (good / noted / "notes.txt").touch()
    (good / earlier / "sim").mkdir()
    (good / earlier / "sim" / "loop.step-3.py311.nbi").touch()
    for name in (unused, users, noted, earlier):
        os.utime(good / name, (0.0, 0.0))
    found = places(unwritable, good, tmp_path / "never").folder
    assert found.parent == good
    # a folder unused for long is removed, and no folder is made that is not needed
    assert folders(good) == sorted([recent, users, noted, found.name])
    assert not (tmp_path / "never").exists()


def test_no_writable_folder_gives_none(places, tmp_path):
    (tmp_path / "file").touch()
    for found in (places(), places(tmp_path / "file", tmp_path / "file" / "cache")):
        assert found.folder is None and found.folders == ()


def test_code_is_cached_in_no_folder_of_numba(package, tmp_path):
    """A folder that cannot be written any more is no reason to use one keyed by one file."""
    lost = CALL.replace(
        "from testbed.flight", "shutil.rmtree(cache); cache.touch()\nfrom testbed.flight"
    )
    begin = "import shutil\nfrom testbed.core.compile import cache_folder\ncache = cache_folder()\n"
    home = tmp_path / "home"
    home.mkdir()
    assert printed(package, script=begin + lost, HOME=str(home)) == "[1.0, 1.0] 0"
    assert [*package.rglob("*.code"), *package.rglob("*.nb[ic]"), *home.iterdir()] == []


def test_read_only_installation_is_read(package, tmp_path):
    """As in a container whose machine code was compiled with the image; new code is not kept."""
    options = {"mount": read_only(package), "HOME": str(package / "nonexistent")}
    script = f"{CALL}\nfrom testbed.core.compile import notice; print(notice())"
    assert printed(package, **options) == "[1.0, 1.0] 0"
    # control: the one before kept nothing
    expected = ["[1.0, 1.0] 0", "compiling kernels; later runs load them"]
    assert printed(package, script=script).splitlines() == expected
    found, notice = printed(package, script=script, **options).splitlines()
    assert found == "[1.0, 1.0] 1" and "no folder can keep them" in notice
    # where another place can be written, new code goes there
    (package / "flight" / "stepping.py").write_text(ENTRY)
    other = CALL.replace('("x", "f8"), ', '("x", "f4"), ')
    options["HOME"] = str(home := tmp_path / "home")
    home.mkdir()
    for hits in (0, 1):
        assert printed(package, script=other, **options) == f"[1.0, 1.0] {hits}"
    assert printed(package, **options) == "[1.0, 1.0] 1"  # from the installation
    assert len([*home.rglob("*.code")]) == 1


def test_useless_variable_is_named(package, tmp_path):
    (tmp_path / "file").touch()
    script = f"import warnings\nwarnings.simplefilter('error')\n{CALL}"
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "file")}
    with pytest.raises(AssertionError, match=r"NUMBA_CACHE_DIR .*file is not used: Not a dir"):
        printed(package, script=script, **environment)
    assert printed(package, **environment) == "[1.0, 1.0] 0"
    assert printed(package) == "[1.0, 1.0] 1", "the next place was not used"
    environment["NUMBA_CACHE_DIR"] = str(tmp_path / "own")  # the remedy
    assert printed(package, script=script, **environment) == "[1.0, 1.0] 0"


def test_full_disk_is_no_error(package, tmp_path):
    cache = tmp_path / "cache"
    cache.mkdir()
    mount = f"mount -t tmpfs -o size=4k tmpfs {cache}"
    assert printed(package, mount=mount, NUMBA_CACHE_DIR=str(cache)) == "[1.0, 1.0] 0"


GRAVITY_ENTRY = """
from testbed.core.compile import entry
from testbed.core.frames import GRAVITY

@entry
def step(records):
    records[0].x = GRAVITY
"""


@pytest.mark.parametrize("place", ["home", "nowhere", "wanted"][: 3 if ALL else 1])
def test_constant_of_core_is_never_stale(package, tmp_path, place):
    """Wherever machine code is kept, and where it is not, a change compiles anew."""
    frames = Path(compiling.__file__).parent / "frames.py"
    (package / "flight" / "stepping.py").write_text(GRAVITY_ENTRY)
    home, wanted = tmp_path / "home", tmp_path / "wanted"
    home.mkdir()
    options = {"HOME": str(home), "mount": read_only(package)}
    kept = {home / ".cache" / "testbed"}
    if place == "nowhere":
        options["HOME"], kept = str(package / "nonexistent"), set()
    if place == "wanted":
        options["NUMBA_CACHE_DIR"], kept = str(wanted), {wanted}
    for value in (9.80665, 1.62):
        text = frames.read_text().replace("GRAVITY = 9.80665", f"GRAVITY = {value}")
        (package / "core" / "frames.py").write_text(text)
        assert printed(package, **options) == f"[{value}, 0.0] 0"
    assert {path.parents[1] for path in tmp_path.rglob("*.code")} == kept


def test_command_flies_from_a_read_only_installation(tmp_path):
    """As in a container with another user, whose home does not exist; an entry is compiled."""
    command = "ideal-figure-eight --duration 0.1 --set log.mcap=false --quiet --json -".split()
    call_command("run", *command, cwd=tmp_path, code=0, columns=80)
    lost = compiling.cache_folder().glob("testbed.flight.steps.has_events-*.code")
    mounts = [read_only(ROOT), *(f"mount --bind /dev/null {each}" for each in lost)]
    assert mounts[1:], "no machine code is lost"
    done = printed(
        ROOT / "testbed",
        script=f"import sys; sys.argv = {['testbed', 'run', *command]}; {MAIN}",
        folder=tmp_path,
        mount=" && ".join(mounts),
        HOME=str(ROOT / "nonexistent"),
    )
    assert json.loads(done)["outcome"] == "completed"


def test_only_compiling_is_announced_and_once():
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


def unkept(function):
    """An entry whose machine code is not kept."""
    return compiling.CompiledFunction(function, lambda: numba.njit(function))


def test_prepared_entries_compile_no_more():
    step = unkept(lambda x, y: x + y)
    compiling.prepare([(step, (1.0, 2))])
    assert len(step.signatures) == 1
    assert step(3.0, 4) == 7.0
    assert len(step.signatures) == 1


def test_entries_bound_in_a_block_are_registered():
    step = unkept(lambda x, y: x + y)
    with compiling.registering():
        bound = compiling.bind_entry(step, 1.0, like=(2,))
        with compiling.registering():
            compiling.bind_entry(step, like=(3.0, 4))
            assert [args for _, args in compiling.registered()] == [(3.0, 4)]
        entries = compiling.registered()
    assert bound(5) == 6.0
    assert entries == ((step, (1.0, 2)),)
    assert compiling.bind_entry(step, 1.0, like=(2,))(6) == 7.0
    assert compiling.registered() == ()


def test_prepare_counts_equal_entries_once(monkeypatch):
    monkeypatch.setattr(compiling, "cache_folder", lambda: None)  # others that compile are not seen
    step, seen = unkept(lambda x: x + 1.0), []
    calls = [(step, (x,)) for x in (1.0, 2.0, 3)]
    compiling.prepare(calls, lambda *progress: seen.append(progress))
    assert seen == [(0, 2), (1, 2), (2, 2)]


def test_prepare_stops_between_entries():
    first, second = unkept(lambda x: x + 1.0), unkept(lambda x: x - 1.0)

    def check():
        if first.signatures:
            raise TimeoutError

    with pytest.raises(TimeoutError):
        compiling.prepare([(each, (1.0,)) for each in (first, second)], check=check)
    assert len(first.signatures) == 1 and not second.signatures


def test_python_cannot_call_an_entry_of_user_code():
    """It has no wrapper for Python, so that a call would end the process."""
    with pytest.raises(TypeError, match="is called by its address"):
        compiling.entry_of_user_code(lambda x: x, None)(1.0)


FLIGHT = """
import testbed
from testbed.scenario import load_scenario, set_duration

with testbed.Simulation(set_duration(load_scenario("telemetry-radio"), 0.2)) as flight:
    while flight.outcome is None:
        state = flight.step()
found = [array.tobytes().hex() for array in (*state.truth, *state.estimate)]
print(found)
"""


@pytest.mark.parametrize("counted", [False, True])
def test_code_of_two_processes_is_not_mixed(package, counted):
    """Negative control: functions with numba's own numbers, which are those of a count."""
    script = SCALED
    if counted:
        script += """
import itertools
import testbed.core.machine_code
from numba.core.bytecode import FunctionIdentity
FunctionIdentity._unique_ids = itertools.count(1000)
"""

    def called(*scales):
        values = f"[float(scaled_one(each)) for each in {scales}]"
        return json.loads(printed(package, script=f"{script}\nprint({values})"))

    (one,), (three,) = called(1.0), called(3.0)
    assert three == pytest.approx(3.0 * one)
    assert (called(1.0, 3.0) == [one, three]) is not counted


def test_debugger_and_compiler_fly_the_same_bits():
    """NUMBA_DISABLE_JIT=1 runs every kernel of a flight as Python."""
    exec(FLIGHT, compiled := {})
    assert printed(ROOT / "testbed", script=FLIGHT, NUMBA_DISABLE_JIT="1") == str(compiled["found"])
