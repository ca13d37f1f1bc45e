"""Aircraft files: forbidden elements, limits, and crashes of JSBSim."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import children, environment
from jsbsim import get_default_root_dir as jsbsim_root
from snapshot import check_snapshot

from testbed.scenario import library
from testbed.vehicle import (
    airframe_grammar,
    airframe_validation,
    forked_trial,
    jsbsim_adapter,
)
from testbed.vehicle.jsbsim_adapter import airframe, load_executive, probe_airframes
from testbed.vehicle.jsbsim_model import AircraftError

DATA = Path(__file__).parents[1] / "data"
MAIN, MOTOR = "rascal110.xml", "Engines/rascal110_motor.xml"
PROPELLER = "Engines/propeller_18in.xml"


def copy_aircraft(place):
    home = place / "rascal110"
    shutil.copytree(library() / "aircraft" / "rascal110", home)
    (place / "beside.xml").write_text("<system name='beside'/>")
    return home


@pytest.fixture
def folder(tmp_path):
    return copy_aircraft(tmp_path)


def error_of(folder):
    with pytest.raises(AircraftError) as caught:
        airframe(folder)
    return str(caught.value)


def change(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return text[: text.index(old)].count("\n") + 1  # the line


def begin(folder):
    text = (folder / MAIN).read_text()
    return text[text.index("<fdm_config") :].split(">")[0] + ">"


WRITE = "simulation/write-state-file"


def system(content):
    return f'<system name="s">{content}</system>'


def errors_of(tmp_path, changes):
    """Change a file of as many copies of an aircraft; return each change and its error."""
    rows = []
    for number, (file, old, new) in enumerate(changes):
        folder = copy_aircraft(tmp_path / str(number))
        (folder / "Systems").mkdir(exist_ok=True)
        (folder / "Systems" / "linked.xml").symlink_to(folder.parent / "beside.xml")
        (folder / r"..\beside.xml").write_text("<system/>")
        line = change(folder / file, old, new)
        text = error_of(folder)
        place = f"{folder / file}:{line + new.startswith('<fdm_config')}: "
        assert text.startswith(place), (new, text)
        rows += [f"{file}: {new[-200:]}", text.removeprefix(place).replace(str(folder), "."), ""]
    return "\n".join(rows)


def test_forbidden_element_error_has_file_and_line(folder, tmp_path):
    """Each line of tests/data/wrong_elements.txt, as the first element of an aircraft."""
    elements = (DATA / "wrong_elements.txt").read_text("utf-8").splitlines()
    start = begin(folder)
    changes = [(MAIN, start, f"{start}\n{each}") for each in elements]
    check_snapshot("wrong_elements", errors_of(tmp_path, changes))


IMPOSSIBLE = (
    *((MAIN, "> 13 </emptywt>", f"> {each} </emptywt>") for each in ("-13", "0", "nan")),
    (MAIN, "> 1.95 <", "> -1.95 <"),
    (MAIN, "> 10.57 <", "> 0 <"),
    (MAIN, "> 9.17 <", "> -9 <"),
    (MAIN, "> 1.15 <", "> <"),
    (MAIN, '<contents unit="LBS"> 1.5', '<contents unit="LBS"> -1'),
    (MAIN, '<contents unit="LBS"> 1.5', '<contents unit="KG"> 1.5'),
    (
        MAIN,
        '<location name="CG"',
        '<pointmass name="p"><weight> -1 </weight></pointmass><location name="CG"',
    ),
    (PROPELLER, "> 18 <", "> -18 <"),
    (PROPELLER, "> 0.00085 <", "> 0 <"),
    (MOTOR, "> 2207.27 <", "> -1 <"),
    (MOTOR, "electric_engine", "system"),
)


def test_impossible_mass_or_size_has_file_and_line(tmp_path):
    check_snapshot("impossible_sizes", errors_of(tmp_path, IMPOSSIBLE))


@pytest.mark.parametrize("name", ["inertia/mass-slugs", "metrics/Sw-sqft"])
def test_impossible_size_when_loaded_is_named(folder, name):
    """A property can change a size after the files were read."""
    written = {"inertia/mass-slugs": "inertia/pointmass-weight-lbs[0]"}.get(name, name)
    value = f"<value>-100</value></function><output>{written}</output>"
    mass = (
        '<pointmass name="p"><weight> 1 </weight><location> <x> 36.4 </x> <y> 0 </y> <z> 4 </z>'
        "</location></pointmass></mass_balance>"
    )
    change(folder / MAIN, "</mass_balance>", mass)
    component = f'<fcs_function name="own/x"><function>{value}</fcs_function>'
    change(
        folder / MAIN,
        "<flight_control",
        system(f'<channel name="c">{component}</channel>') + "<flight_control",
    )
    assert f"{folder / MAIN}: {name} is -" in error_of(folder)


FLIES = "; the testbed flies aircraft with one electric engine and its propeller"
SECOND = '<engine file="rascal110_motor"><thruster file="propeller_18in"/></engine>'


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (MOTOR, "electric_engine", "piston_engine", "rascal110 has a piston engine"),
        (MOTOR, "electric_engine", "turbine_engine", "rascal110 has a turbine"),
        (MOTOR, "electric_engine", "turboprop_engine", "rascal110 has a turboprop"),
        (MOTOR, "electric_engine", "rocket_engine", "rascal110 has a rocket"),
        (PROPELLER, "propeller", "nozzle", "rascal110 has a nozzle"),
        (MAIN, "<tank", f"{SECOND}<tank", "rascal110 has 2 engines"),
    ],
)
def test_engine_not_flown_is_named_before_use(folder, file, old, new, message):
    text = (folder / file).read_text()
    if file == MAIN:
        line = change(folder / file, old, new)
    else:
        # an engine without its own elements: those of the other kind are not known in it
        line = text[: text.index(f"<{old}")].count("\n") + 1
        (folder / file).write_text("\n" * (line - 1) + f'<{new} name="x"/>')
    found = error_of(folder)
    assert found.startswith(f"{folder / file}:{line}: {message}{FLIES}")
    assert "steady flight" not in found


@pytest.mark.parametrize(
    ("name", "has"),
    [
        ("c172p", "a piston engine"),
        ("J3Cub", "a piston engine"),
        ("DHC6", "a turboprop"),
        ("T37", "a turbine"),
        ("SGS", "no engine"),
    ],
)
def test_aircraft_of_jsbsim_pass_but_for_the_engine(tmp_path, name, has):
    """Files that people have: the reason is the engine, not an element of the XML."""
    data = Path(jsbsim_root())
    for source, target in (
        ("engine", "Engines"),
        ("systems", "Systems"),
        (f"aircraft/{name}", "."),
    ):
        shutil.copytree(data / source, tmp_path / name / target, dirs_exist_ok=True)
    error = error_of(tmp_path / name)
    assert f": {name} has {has}{FLIES}" in error


def test_aircraft_without_engine_is_named(folder):
    text = (folder / MAIN).read_text()
    begin, end = text.index("<propulsion>"), text.index("</propulsion>")
    (folder / MAIN).write_text(text[:begin] + text[end + len("</propulsion>") :])
    assert f"{folder / MAIN}:1: rascal110 has no engine{FLIES}" in error_of(folder)


@pytest.mark.parametrize("name", ["Engines", "engines", "Engine", "engine"])
def test_engine_files_are_checked_in_every_folder(folder, name):
    """A good file in one folder does not hide a bad one of the same name in another."""
    (folder / "engine").mkdir()
    (folder / "Engines").rename(folder / "good")
    for file in (folder / "good").iterdir():
        shutil.copy(file, folder / "engine")
    (folder / name).mkdir(exist_ok=True)
    bad = folder / name / Path(MOTOR).name
    bad.write_text(f'<electric_engine name="x"><property>{WRITE}</property></electric_engine>')
    assert f"{bad}:1: the property {WRITE} is JSBSim's" in error_of(folder)


def test_drawn_aircraft_write_and_run_nothing(tmp_path):
    """Aircraft of JSBSim's grammar, most of which try to act; TESTBED_AIRCRAFT is their number."""
    count = int(os.environ.get("TESTBED_AIRCRAFT", "20"))
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("airframe_fuzz.py"), str(count), tmp_path],
        env=environment(80),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    print(found["seen"])
    assert found["faults"] == []
    # some of both, or the aircraft test nothing
    assert set(found["seen"]) == {"0", "2"} and min(found["seen"].values()) > 1


def test_every_root_of_jsbsims_properties_is_known(folder):
    """JSBSim's own properties are the ones that an aircraft cannot set."""
    names = load_executive(folder).get_property_catalog()
    own = {each.strip().split("/")[0].split("[")[0] for each in names if "/" in each}
    assert own - {"air"} <= airframe_grammar.JSBSIM_PROPERTIES
    assert not any(each.startswith("/") for each in names)


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>',
        '<!DOCTYPE x [<!ENTITY passwd SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE x SYSTEM "file:///dev/zero">',
    ],
)
@pytest.mark.parametrize("file", [MAIN, MOTOR])
def test_entities_are_errors_in_every_file(folder, file, doctype):
    change(folder / file, "<!--", f"{doctype}\n<!--")
    assert f"{folder / file}:2: <!DOCTYPE> and entities are not allowed" in error_of(folder)


def test_files_that_name_each_other_are_an_error(folder):
    change(folder / MAIN, begin(folder), f'{begin(folder)}\n<system file="a"/>')
    (folder / "a.xml").write_text('<system name="a" file="b"/>')
    (folder / "b.xml").write_text('<system name="b" file="a"/>')
    assert "which names it too" in error_of(folder)


def test_links_pipes_and_huge_files(folder):
    os.mkfifo(folder / "pipe.xml")  # reading it would block
    assert airframe(folder).span > 2.0
    with (folder / MAIN).open("a") as main:
        main.write(" " * airframe_validation.MAX_BYTES)
    assert "is larger than 10,000,000 bytes" in error_of(folder)
    (folder / MAIN).rename(folder.parent / "elsewhere.xml")
    (folder / MAIN).symlink_to(folder.parent / "elsewhere.xml")
    assert "is a link out of" in error_of(folder)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (PROPELLER, "0.8   0.0172", "54    0.0172", "row lookup is not monotonically increasing"),
        (MOTOR, 'unit="WATTS"', 'unit="nan"', 'Supplied unit: "nan" does not exist'),
    ],
)
def test_crash_of_jsbsim_error_has_its_last_output(folder, file, old, new, message, capfd):
    change(folder / file, old, new)
    text = error_of(folder)
    assert text.startswith(f"{folder / file}:") and f"JSBSim: {message}" in text.replace(
        "FGTable: ", ""
    )
    assert capfd.readouterr() == ("", "")


def test_crash_without_output_is_an_error(folder):
    crash = lambda on_error: os.kill(os.getpid(), 11)  # noqa: E731
    with pytest.raises(AircraftError, match=r"xml: JSBSim crashed \(SIGSEGV\)"):
        airframe_validation.probe_in_copy(folder, crash)()


def test_endless_work_is_ended(folder, monkeypatch):
    monkeypatch.setattr(forked_trial, "TIMEOUT_S", 1)
    with pytest.raises(AircraftError, match="did not end within 1 s"):
        airframe_validation.probe_in_copy(folder, lambda on_error: time.sleep(60))()


def test_traits_are_determined_once_per_content(folder, monkeypatch):
    """And again for changed files; errors are raised when the aircraft is loaded."""
    calls, before = [], set(children(os.getpid()))

    def counted(*args):
        calls.append(args)
        return airframe_validation.probe_in_copy(*args)

    monkeypatch.setattr(jsbsim_adapter, "probe_in_copy", counted)
    probe_airframes([folder, folder])
    probe_airframes([folder])
    airframe(folder)
    assert len(calls) == 1
    change(folder / MAIN, "> 1.95 <", "> 0.01 <")
    probe_airframes([folder])
    assert len(calls) == 2
    assert "mass_balance: no rigid body has" in error_of(folder)

    change(folder / MAIN, "<mass_balance>", '<input port="41234" type="SOCKET"/><mass_balance>')
    probe_airframes([folder])
    assert "<input> opens a socket" in error_of(folder)
    assert set(children(os.getpid())) <= before
