"""Aircraft files: forbidden elements, limits, and crashes of JSBSim."""

import json
import os
import shutil
import time
from pathlib import Path

import pytest
from aircraft_copies import of_jsbsim
from cases import ALL
from commands import children
from forked import run_program
from places import TESTS
from snapshot import check_snapshot

from testbed.airframes import airframe_grammar, airframe_validation, forked_trial
from testbed.airframes.powerplant import AircraftError
from testbed.core import kept_results
from testbed.core.kept_files import Place, open_kept_files
from testbed.scenario import library
from testbed.vehicle import jsbsim_adapter
from testbed.vehicle.jsbsim_adapter import (
    airframe,
    airframe_warnings,
    load_executive,
    probe_airframes,
)

DATA = TESTS / "data"
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


PART = '<{0} name="x"/>'
GAS = '<buoyant_forces><gas_cell type="HELIUM"/></buoyant_forces>'


@pytest.mark.parametrize(
    ("file", "content", "at", "message"),
    [
        (MOTOR, PART.format("rocket_engine"), (MOTOR, 1), "has a rocket engine, which has no"),
        (PROPELLER, PART.format("nozzle"), (PROPELLER, 1), "has the nozzle of a rocket engine"),
        (PROPELLER, PART.format("rotor"), (PROPELLER, 1), "has a rotor: it is no aeroplane"),
        (MAIN, f"{GAS}<propulsion>", (MAIN, "<propulsion>"), "is carried by a gas cell"),
        (MOTOR, PART.format("turbine_engine"), (MAIN, "<engine"), "has a turbine on a propeller"),
        (PROPELLER, PART.format("direct"), (MAIN, "<engine"), "an electric engine on a <direct>"),
    ],
)
def test_what_is_no_aeroplane_is_refused(folder, file, content, at, message):
    place, line = at
    if isinstance(line, str):
        text = (folder / place).read_text()
        line = text[: text.index(line)].count("\n") + 1
    if file == MAIN:
        change(folder / MAIN, "<propulsion>", content)
    else:
        (folder / file).write_text(content)
    found = error_of(folder)
    assert found.startswith(f"{folder / place}:{line}: rascal110 ")
    assert message in found
    assert "\n" not in found and "steady flight at" not in found


@pytest.mark.parametrize("name", ["c172p", "J3Cub", "DHC6", "T37", "SGS", "A4"])
def test_aircraft_of_jsbsim_are_allowed(tmp_path, name):
    """Files that people have: pistons, turboprops, jets, and a glider."""
    airframe_validation.check_airframe(of_jsbsim(name, tmp_path))


def test_all_faults_are_reported_at_once(folder):
    """In the order of the files, with what is below an unknown element left out."""
    faults = [
        (MAIN, "<mass_balance>", '<input port="1"><x/></input><mass_balance>', "<input> opens"),
        (MAIN, "> 13 </emptywt>", "> -13 </emptywt>", "<emptywt> is -13"),
        (MAIN, "<propulsion>", '<system file="no"/><propulsion>', "file='no': there is no"),
        (MAIN, "<aerodynamics>", "<aerodynamic/><aerodynamics>", "<aerodynamic> is not known"),
        (PROPELLER, "> 18 <", "> -18 <", "<diameter> is -18"),
        (MOTOR, "<power", f"<property>{WRITE}</property><power", f"the property {WRITE}"),
    ]
    lines = [(file, change(folder / file, old, new), text) for file, old, new, text in faults]
    found = error_of(folder).splitlines()
    assert len(found) == len(lines)
    for file, line, text in lines:
        start = f"{folder / file}:{line}: {text}"
        assert any(each.startswith(start) for each in found), start
    change(folder / PROPELLER, "> -18 <", "> 18 <")
    assert len(error_of(folder).splitlines()) == len(lines) - 1


def test_inertia_of_estimates_is_a_warning(folder):
    """A principal moment may be a third larger than the sum of the others, with a warning."""
    assert airframe_warnings(folder) == ()
    change(folder / MAIN, "> 1.95 <", "> 0.1 <")
    (text,) = airframe_warnings(folder)
    assert f"{folder / MAIN}: mass_balance: no rigid body has" in text and "% less than J3" in text
    change(folder / MAIN, "> 1.91 <", "> 2.91 <")
    assert "J1 + J2 ≥ J3 fails" in error_of(folder)


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
    count = int(os.environ.get("TESTBED_AIRCRAFT", "8" if ALL else "5"))
    code, output, errors = run_program(
        "import airframe_fuzz; airframe_fuzz.answer()", count, tmp_path, folder=tmp_path.parent
    )
    assert code == 0, errors[-2000:]
    found = json.loads(output)
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
    def compute(on_error):
        while True:
            pass

    monkeypatch.setattr(forked_trial, "TIMEOUT_S", 1)
    with pytest.raises(AircraftError, match="did not end within 1 s of processor time"):
        airframe_validation.probe_in_copy(folder, compute)()


def test_slow_machine_is_no_fault_of_an_aircraft(folder, monkeypatch):
    """The limit is one of processor time; work that only waits has a longer one."""
    monkeypatch.setattr(forked_trial, "TIMEOUT_S", 1)

    def wait(on_error):
        time.sleep(1.5)
        return "read"

    assert airframe_validation.probe_in_copy(folder, wait)() == "read"
    monkeypatch.setattr(forked_trial, "_WAIT_S", 1)
    with pytest.raises(AircraftError, match="did not end within 1 s without"):
        airframe_validation.probe_in_copy(folder, wait)()


def test_traits_are_determined_once_per_content(folder, tmp_path, monkeypatch):
    """And again for changed files; errors are raised when the aircraft is loaded."""
    kept = open_kept_files("kernels-0123456789abcdef", [Place(tmp_path / "kept")])
    monkeypatch.setattr(kept_results, "kept_files", lambda: kept)
    calls, before = [], set(children(os.getpid()))

    def counted(*args):
        calls.append(args)
        return airframe_validation.probe_in_copy(*args)

    monkeypatch.setattr(jsbsim_adapter, "probe_in_copy", counted)
    probe_airframes([folder, folder])
    probe_airframes([folder])
    airframe(folder)
    assert len(calls) == 1
    change(folder / MAIN, "> 1.95 <", "> 9.5 <")
    probe_airframes([folder])
    assert len(calls) == 2
    assert "mass_balance: no rigid body has" in error_of(folder)

    change(folder / MAIN, "<mass_balance>", '<input port="41234" type="SOCKET"/><mass_balance>')
    probe_airframes([folder])
    assert "<input> opens a socket" in error_of(folder)
    assert set(children(os.getpid())) <= before
