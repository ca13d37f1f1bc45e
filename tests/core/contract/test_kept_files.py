"""Kept files are whole and of this user, or made anew; no damage to them changes or ends a run."""

import json
import os
import random
import shutil
import stat
import subprocess
import sys
import time
import warnings
from types import ModuleType

import numba
import numpy as np
import pytest
from file_damage import KINDS, MARK, damage
from waiting import TIMEOUT_S

from testbed.core import compile as compiling
from testbed.core import kept_files
from testbed.core.kept_files import KeptFiles, Place, open_kept_files

WHOLE = "TESTBED_KEPT_FILES" in os.environ  # also each kind of damage to all files of a flight
NAME = "kernels-0123456789abcdef"


def opened(path, **options):
    """Open kept files; a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return open_kept_files(NAME, [Place(path, **options)])


def refused(*places):
    """Return the warning of places of which the first is not used."""
    with pytest.warns(UserWarning) as found:
        kept = open_kept_files(NAME, places)
    assert len(found) == 1
    return kept, str(found[0].message)


@pytest.fixture
def kept(tmp_path):
    return opened(tmp_path / "cache")


@pytest.fixture
def mark(tmp_path, monkeypatch):
    monkeypatch.setenv(MARK, str(tmp_path / "mark"))
    return tmp_path / "mark"


def test_content_is_read_as_written(kept):
    for content in (b"", b"a" * 100_000):
        kept.write("one", content)
        assert kept.read("one") == content
    assert kept.read("two") is None
    assert stat.S_IMODE(kept.folder.stat().st_mode) == 0o700
    assert [each.name for each in kept.folder.iterdir()] == ["one"]


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_file_is_a_miss_and_replaced(kept, kind):
    for name in ("one", "two.code"):
        kept.write(name, name.encode() * 50)
    assert damage(kind, kept.folder) == 2
    assert kept.read("one") is None
    kept.write("one", b"again")
    assert kept.read("one") == (None if kind == "a full folder" else b"again")


def test_file_of_another_folder_is_a_miss(kept, tmp_path):
    kept.write("one", b"of this code")
    other = open_kept_files("kernels-fedcba9876543210", [Place(tmp_path / "cache")])
    shutil.copy(kept.folder / "one", other.folder)
    assert other.read("one") is None and kept.read("one") == b"of this code"


# each takes half a second; that damaged files are misses is tested above, with all
SAMPLE = random.Random(4).sample([*KINDS], 5)


@pytest.mark.parametrize("kind", KINDS if WHOLE else ["empty", "a planted pickle", *SAMPLE])
def test_damaged_machine_code_is_compiled_anew(kept, kind, monkeypatch, mark):
    """The numbers are the same, nothing is printed, and the next process loads it again."""
    monkeypatch.setattr(compiling, "kept_files", lambda: kept)
    function = step_of(1.5)

    def fly():
        entry = compiling.entry(function)
        return entry(2.0), sum(entry.dispatcher.stats.cache_hits.values())

    assert fly() == (4.5, 0) and fly() == (4.5, 1)
    assert damage(kind, kept.folder) == 1
    assert fly() == (4.5, 0)
    assert fly() == (4.5, 0 if kind == "a full folder" else 1)
    assert not mark.exists()


def step_of(gain):
    """A function of a module, compiled in a moment."""
    module = sys.modules.setdefault("kept_step", ModuleType("kept_step"))
    exec(f"def step(x):\n    return {gain} * x + {gain}\n", module.__dict__)
    return module.step


def test_machine_code_of_another_entry_is_not_run(kept, monkeypatch):
    """Also where checksums are right, as by a mistake in the names of files."""
    monkeypatch.setattr(compiling, "kept_files", lambda: kept)
    entry = compiling.entry(step_of(1.5))
    entry(np.zeros(2))
    content = kept.read(next(kept.folder.glob("*.code")).name)
    monkeypatch.setattr(KeptFiles, "read", lambda self, name: content)
    entry = compiling.entry(step_of(1.5))
    assert entry(1.0) == 3.0 and not entry.dispatcher.stats.cache_hits
    assert (
        entry(np.zeros(2)).tolist() == [1.5, 1.5] and entry.dispatcher.stats.cache_hits
    )  # control


def test_large_file_is_not_read(kept, monkeypatch):
    kept.write("one", b"a" * 1000)
    assert kept.read("one") is not None
    monkeypatch.setattr(kept_files, "MAX_BYTES", 1000)
    assert kept.read("one") is None


def test_readable_folder_is_read_the_next_written(tmp_path, monkeypatch):
    opened(tmp_path / "image").write("one", b"1")
    writable = kept_files._is_writable
    monkeypatch.setattr(
        kept_files, "_is_writable", lambda path: "image" not in str(path) and writable(path)
    )
    kept = open_kept_files(NAME, [Place(tmp_path / "image"), Place(tmp_path / "home")])
    kept.write("two", b"2")
    assert (kept.read("one"), kept.read("two")) == (b"1", b"2")
    assert kept.folder == tmp_path / "home" / NAME
    assert kept.folders == (tmp_path / "image" / NAME, kept.folder)
    only = open_kept_files(NAME, [Place(tmp_path / "image")])
    only.write("two", b"2")
    assert only.folder is None and only.read("one") == b"1" and only.read("two") is None


def test_folder_that_is_opened_counts_as_used(tmp_path):
    """Its time tells for how long a folder of machine code was not used."""
    folder = opened(tmp_path / "cache").folder
    os.utime(folder, (0.0, 0.0))
    assert opened(tmp_path / "cache").folder == folder
    assert time.time() - folder.stat().st_mtime < 3600.0


def planted(path, mode):
    """A folder of kept files with this mode, made by someone."""
    opened(path).write("one", b"planted")
    (path / NAME).chmod(mode)


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722, 0o1777])
def test_folder_that_others_may_write_is_named(tmp_path, mode, monkeypatch):
    monkeypatch.setattr(kept_files, "_is_group_private", lambda *_: False)
    planted(tmp_path / "cache", mode)
    kept, text = refused(Place(tmp_path / "cache"), Place(tmp_path / "next"))
    assert kept.folder == tmp_path / "next" / NAME and kept.read("one") is None
    folder = tmp_path / "cache" / NAME
    assert f"{folder} is not used: other users may write it, as its mode is {mode:04o}" in text
    assert text.endswith("(remove it)")
    shutil.rmtree(folder)  # the remedy
    assert opened(tmp_path / "cache").folder == folder


def test_place_that_others_may_write_is_named(tmp_path):
    planted(tmp_path / "cache", 0o700)
    (tmp_path / "cache").chmod(0o777)
    kept, text = refused(Place(tmp_path / "cache"), Place(tmp_path / "next"))
    assert kept.folder == tmp_path / "next" / NAME
    assert f"other users may write {tmp_path / 'cache'}, of mode 0777 (write chmod go-w" in text
    (tmp_path / "cache").chmod(0o755)  # the remedy
    assert opened(tmp_path / "cache").read("one") == b"planted"
    (tmp_path / "cache").chmod(0o1777)  # as /tmp: no other user can replace the folder in it
    assert opened(tmp_path / "cache").read("one") == b"planted"


def test_folder_of_another_user_is_named(tmp_path, monkeypatch):
    planted(tmp_path / "cache", 0o755)
    (tmp_path / "cache").chmod(0o1777)
    assert opened(tmp_path / "cache").read("one") == b"planted"
    if os.geteuid():
        monkeypatch.setattr(kept_files, "_trusted_owners", lambda: (0,))
    else:
        os.chown(tmp_path / "cache" / NAME, 65534, 65534)
    kept, text = refused(Place(tmp_path / "cache"))
    assert kept.folder is None and kept.folders == ()
    assert "belongs to the user" in text and "write a folder of your own to NUMBA_CACHE" in text


def test_link_to_a_folder_of_others_is_not_followed(tmp_path):
    """Wherever a link lies, the folder to which it leads is looked at."""
    planted(tmp_path / "theirs", 0o777)
    (tmp_path / "cache").mkdir(mode=0o755)
    (tmp_path / "cache" / NAME).symlink_to(tmp_path / "theirs" / NAME)
    kept, _ = refused(Place(tmp_path / "cache"))
    assert kept.read("one") is None
    (tmp_path / "theirs" / NAME).chmod(0o755)
    assert opened(tmp_path / "cache").read("one") == b"planted"  # a user's own link is followed
    (tmp_path / "link").symlink_to(tmp_path / "cache")
    assert opened(tmp_path / "link").read("one") == b"planted"


def test_folder_that_is_exchanged_later_is_not_read(kept, tmp_path):
    kept.write("one", b"1")
    kept.folder.rename(tmp_path / "moved")
    planted(tmp_path / "cache", 0o777)
    assert kept.read("one") == b"1"


def test_folder_is_not_exchanged_for_another_thing(tmp_path):
    for k, make in enumerate((lambda p: p.touch(), lambda p: p.symlink_to("no"), os.mkfifo)):
        (tmp_path / f"{k}").mkdir()
        make(tmp_path / f"{k}" / NAME)
        assert opened(tmp_path / f"{k}").folder is None


def test_group_of_one_user_may_write(tmp_path, monkeypatch):
    """Many systems give each user a group of the same name, and files that it may write."""
    path = tmp_path / "cache"
    opened(path)
    status, user = path.stat(), kept_files.pwd.getpwuid(os.geteuid())

    class Group:
        gr_name, gr_mem = user.pw_name, []

    monkeypatch.setattr(kept_files.grp, "getgrgid", lambda gid: Group)
    monkeypatch.setattr(kept_files.pwd, "getpwall", lambda: [user])
    if status.st_gid != user.pw_gid:
        pytest.skip("files here have another group than the user")
    assert kept_files._is_group_private(status, path)
    path.chmod(0o775)
    assert opened(path).folder is not None
    for members, users in ((["other"], [user]), ([], [user, user[:2] + (77,) + user[3:]])):
        Group.gr_mem = members
        found = [kept_files.pwd.struct_passwd(each) for each in users]
        monkeypatch.setattr(kept_files.pwd, "getpwall", lambda found=found: found)
        assert not kept_files._is_group_private(status, path)
        assert refused(Place(path))[0].folder is None


def test_warning_is_given_once_for_all_processes(tmp_path, monkeypatch):
    planted(tmp_path / "cache", 0o777)
    refused(Place(tmp_path / "cache"))
    monkeypatch.setenv(kept_files.REPORTED, "1")
    assert opened(tmp_path / "cache").folder is None


def test_checksum_costs_little(kept):
    """The machine code of a flight is 3 MB: at most some milliseconds of a start of a second."""
    kept.write("one", os.urandom(3_000_000))
    begin = time.process_time()
    kept.read("one")
    assert time.process_time() - begin < 0.1


FLIGHT = "run ideal-figure-eight --duration 1 --set log.mcap=false --quiet --json -"


def fly(cache):
    """Fly a second in a process of its own; return the metrics, and the lines it has printed."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "testbed", *FLIGHT.split()],
        cwd=cache.parent,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=4 * TIMEOUT_S,
    )
    assert done.returncode == 0, done.stderr
    metrics = json.loads(done.stdout)
    return {**metrics, "wall_s": None, "real_time_factor": None}, done.stderr.splitlines()


@pytest.fixture(scope="module")
def whole_cache(tmp_path_factory):
    """A cache with all kernels of the flight, and the metrics of the flight that compiled them."""
    cache = tmp_path_factory.mktemp("whole") / "cache"
    metrics, _ = fly(cache)
    return cache, metrics


@pytest.mark.skipif(not WHOLE, reason="TESTBED_KEPT_FILES=1: each compiles all kernels of a flight")
@pytest.mark.parametrize("kind", KINDS)
def test_flight_with_a_damaged_cache_is_the_same(kind, whole_cache, tmp_path, mark):
    intact, expected = whole_cache
    cache = tmp_path / "cache"
    shutil.copytree(intact, cache)
    (folder,) = cache.glob("kernels-*")
    assert damage(kind, folder) > 20
    found, lines = fly(cache)
    assert found == expected and len(lines) <= 1
    assert not mark.exists()


def test_numba_has_what_the_kept_code_uses():
    """Names of numba's that are not public; another version could lack them."""
    from numba.core import caching, compiler

    assert set(caching._Cache.__abstractmethods__) == {
        *("cache_path", "load_overload", "save_overload", "enable", "disable", "flush"),
    }
    assert callable(compiler.CompileResult._rebuild) and numba.__version__
