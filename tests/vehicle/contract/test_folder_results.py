"""Results of an aircraft's folder: one for each content of its files, also between processes."""

import os
import shutil

import pytest
from fresh import run_fresh
from places import ROOT

from testbed.core import kept_results
from testbed.core.compile import cache_folder
from testbed.core.kept_files import Place, open_kept_files
from testbed.core.records import NedOrigin
from testbed.scenario import find_aircraft
from testbed.vehicle import folder_results, jsbsim_adapter
from testbed.vehicle.folder_results import cache_by_folder, folder_digest, unchanging_folders
from testbed.vehicle.jsbsim_adapter import airframe, trim_aircraft
from testbed.vehicle.trim import TrimPoint

NAME = "kernels-0123456789abcdef"


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "rascal110"
    shutil.copytree(find_aircraft("rascal110"), found)
    return found


@pytest.fixture
def kept(tmp_path, monkeypatch):
    found = open_kept_files(NAME, [Place(tmp_path / "kept")])
    monkeypatch.setattr(kept_results, "kept_files", lambda: found)
    return found


@pytest.fixture
def loads(monkeypatch):
    """Folders that JSBSim has loaded."""
    found, load = [], jsbsim_adapter.load_executive
    monkeypatch.setattr(
        jsbsim_adapter, "load_executive", lambda folder: found.append(folder) or load(folder)
    )
    return found


def forget(function):
    """Let a function begin as in another process."""
    function._results.clear()


def test_another_process_loads_no_aircraft(folder, kept, loads):
    point = TrimPoint(22.0)
    first = airframe(folder), trim_aircraft(folder, point)
    assert loads
    loads.clear()
    for function in (airframe, jsbsim_adapter._trim_aircraft, jsbsim_adapter._find_traits):
        forget(function)
    assert (airframe(folder), trim_aircraft(folder, point)) == first
    assert not loads
    trim_aircraft(folder, TrimPoint(22.0, bank=0.1))  # control: another point
    assert loads


def test_an_edit_of_equal_size_and_time_is_seen(folder, kept, loads):
    before = airframe(folder)
    main = folder / "rascal110.xml"
    status, text = main.stat(), main.read_text()
    assert " 10.57 " in text, "the wing's area is another"
    main.write_text(text.replace(" 10.57 ", " 11.57 "))
    os.utime(main, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert main.stat().st_size == status.st_size
    assert airframe(folder).area > before.area
    main.write_text(text)
    loads.clear()
    assert airframe(folder) == before and not loads


def test_a_file_edited_meanwhile_keeps_no_result(folder, kept, monkeypatch):
    """Else the result of the new content would be that of the old one, for good."""
    main = folder / "rascal110.xml"
    text, measured = main.read_text(), jsbsim_adapter.measured_airframe

    def edited(model):
        main.write_text(text.replace(" 10.57 ", " 11.57 "))
        return measured(model)

    with monkeypatch.context() as changed, unchanging_folders():
        changed.setattr(jsbsim_adapter, "measured_airframe", edited)
        airframe(folder)
    main.write_text(text)
    assert not [each for each in os.listdir(kept.folder) if each.startswith("result-airframe")]
    airframe(folder)
    assert [each for each in os.listdir(kept.folder) if each.startswith("result-airframe")]


def test_another_jsbsim_makes_results_anew(folder, kept, loads, monkeypatch):
    airframe(folder)
    forget(airframe)
    loads.clear()
    airframe(folder)
    assert not loads
    forget(airframe)
    facts = kept_results.machine_facts()
    monkeypatch.setattr(kept_results, "machine_facts", lambda: (("jsbsim", "9.9"), *facts[1:]))
    airframe(folder)
    assert loads


def test_files_are_read_once_in_a_block(folder, monkeypatch):
    reads, read = [], folder_results._read_digest
    monkeypatch.setattr(
        folder_results, "_read_digest", lambda each: reads.append(each) or read(each)
    )
    with unchanging_folders():
        assert len({folder_digest(folder) for _ in range(3)}) == 1
        assert len(reads) == 1
    folder_digest(folder)
    folder_digest(folder)
    assert len(reads) == 3


def test_results_in_memory_are_bounded(folder):
    @cache_by_folder(2)
    def twice(folder, number):
        made.append(number)
        return 2 * number

    made = []
    assert [twice(folder, each) for each in (1, 2, 1, 3, 1, 2)] == [2, 4, 2, 6, 2, 4]
    assert made == [1, 2, 3, 2]  # the one that was not used for the longest time is left out


TWO = """
import os
import sys
from pathlib import Path
from testbed.compiled.compiled_fleet import place_row
from testbed.core.records import NedOrigin
from testbed.vehicle.trim import InitialState

start = InitialState((0.0, 0.0, -100.0))
cache = Path(os.environ["NUMBA_CACHE_DIR"])
for pair in ("01", "23"):
    children = []
    for number in pair:
        children.append(os.fork())
        if not children[-1]:
            placed = place_row(Path("rascal110").resolve(), start, NedOrigin(), 100)
            text = f"{placed.row.tobytes().hex()} {placed.leads.tobytes().hex()} {placed.trim}"
            Path(f"found-{number}").write_text(text)
            os._exit(0)
    assert [os.waitpid(each, 0)[1] for each in children] == [0, 0]
    assert len([*cache.glob("*/result-place-row-*")]) == 1
    for each in cache.glob("*/result-*") if pair == "01" else ():
        each.write_bytes(each.read_bytes()[: each.stat().st_size // 2])
"""


def test_processes_at_once_have_one_result(folder, tmp_path):
    """They begin with machine code and no results, and with half of each result."""
    cache, here = tmp_path / "cache", cache_folder()
    shutil.copytree(here, cache / here.name, ignore=shutil.ignore_patterns("result-*"))
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    code, _, errors = run_fresh(TWO, folder=tmp_path, paths=[ROOT], env=env)
    assert code == 0, errors
    found = {each.read_text() for each in tmp_path.glob("found-*")}
    assert len([*tmp_path.glob("found-*")]) == 4
    assert len(found) == 1, "a result that is read differs from one that is made"


def test_full_disk_is_no_error(folder, kept, monkeypatch):
    real = os.open

    def full(path, flags, *rest, **named):
        if flags & os.O_CREAT:
            raise OSError(28, "No space left on device")
        return real(path, flags, *rest, **named)

    with monkeypatch.context() as changed:
        changed.setattr(os, "open", full)
        first = airframe(folder)
    assert not [each for each in os.listdir(kept.folder) if each.startswith("result")]
    forget(airframe)
    assert airframe(folder) == first
    assert [each for each in os.listdir(kept.folder) if each.startswith("result")]


def test_row_of_a_start_is_equal_to_the_bit(folder, kept, loads):
    from testbed.compiled.compiled_fleet import place_row
    from testbed.vehicle.trim import InitialState

    start = InitialState((10.0, 20.0, -150.0), course=0.3, wind_ned=(3.0, -1.0, 0.0))
    made = place_row(folder, start, NedOrigin(), 100)
    forget(place_row)
    loads.clear()
    read = place_row(folder, start, NedOrigin(), 100)
    assert not loads and read is not made
    assert (read.row.tobytes(), read.leads.tobytes()) == (made.row.tobytes(), made.leads.tobytes())
    assert repr(read.trim) == repr(made.trim)
