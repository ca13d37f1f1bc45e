"""Aircraft files: forbidden elements, limits, and crashes of JSBSim."""

import os
import shutil
import time

import pytest
from commands import children

from testbed.scenario import library
from testbed.vehicle import airframe_validation, forked_trial, jsbsim_adapter
from testbed.vehicle.jsbsim_adapter import airframe, probe_airframes
from testbed.vehicle.jsbsim_model import AircraftError

MAIN, MOTOR = "rascal110.xml", "Engines/rascal110_motor.xml"
PROPELLER = "Engines/propeller_18in.xml"


@pytest.fixture
def folder(tmp_path):
    home = tmp_path / "rascal110"
    shutil.copytree(library() / "aircraft" / "rascal110", home)
    (tmp_path / "beside.xml").write_text("<system name='beside'/>")
    return home


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


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<input port="41234" type="SOCKET"/>', "<input> opens a socket (remove it)"),
        ('<output name="x.csv" type="CSV"/>', "<output> opens a socket or writes a file"),
        ('<system file="../beside"/>', "file='../beside' leaves the aircraft's folder"),
        ('<system file="/etc/passwd"/>', "file='/etc/passwd' leaves the aircraft's folder"),
        ('<system file="Systems/../../beside"/>', "leaves the aircraft's folder"),
        ('<system file="linked"/>', "file='linked' is a link out of the aircraft's folder"),
        ('<system file="missing"/>', "there is no missing.xml in the aircraft's folder"),
        ('<system file="SOURCE.md"/>', "is not a name that ends in .xml"),
        (
            '<system name="s"><property value="1">simulation/write-state-file</property></system>',
            "the property simulation/write-state-file writes a file (remove it)",
        ),
        ("<a>" * 60 + "</a>" * 60, "<a> is deeper than 50 elements"),
        ("&passwd;", "is not XML: undefined entity"),
    ],
)
def test_forbidden_element_error_has_file_and_line(folder, element, message):
    (folder / "Systems").mkdir(exist_ok=True)
    (folder / "Systems" / "linked.xml").symlink_to(folder.parent / "beside.xml")
    line = change(folder / MAIN, begin(folder), f"{begin(folder)}\n{element}") + 1
    text = error_of(folder)
    assert text.startswith(f"{folder / MAIN}:{line}: ") and message in text


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
    (folder / "a.xml").write_text('<system name="a"><system file="b"/></system>')
    (folder / "b.xml").write_text('<system name="b"><system file="a"/></system>')
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
