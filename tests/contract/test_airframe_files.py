"""What an aircraft's XML may not ask of JSBSim, and what JSBSim may not do to who loads it."""

import os
import shutil
import time

import pytest
from commands import children

from testbed.scenario import library
from testbed.vehicle import airframe_files, jsbsim_door, trial
from testbed.vehicle.jsbsim_door import airframe, explore
from testbed.vehicle.jsbsim_model import AircraftError

MAIN, MOTOR = "rascal110.xml", "Engines/rascal110_motor.xml"
PROPELLER = "Engines/propeller_18in.xml"


@pytest.fixture
def folder(tmp_path):
    home = tmp_path / "rascal110"
    shutil.copytree(library() / "aircraft" / "rascal110", home)
    (tmp_path / "beside.xml").write_text("<system name='beside'/>")
    return home


def refusal(folder):
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
    ("element", "said"),
    [
        ('<input port="41234" type="SOCKET"/>', "<input> opens a socket (remove it)"),
        ('<output name="x.csv" type="CSV"/>', "<output> opens a socket or writes a file"),
        ('<system file="../beside"/>', "file='../beside' leaves the aircraft's folder"),
        ('<system file="/etc/passwd"/>', "file='/etc/passwd' leaves the aircraft's folder"),
        ('<system file="Systems/../../beside"/>', "leaves the aircraft's folder"),
        ('<system file="linked"/>', "file='linked' is a link out of the aircraft's folder"),
        ('<system file="nobody"/>', "there is no nobody.xml in the aircraft's folder"),
        ('<system file="SOURCE.md"/>', "is not a name that ends in .xml"),
        (
            '<system name="s"><property value="1">simulation/write-state-file</property></system>',
            "the property simulation/write-state-file writes a file (leave it out)",
        ),
        ("<a>" * 60 + "</a>" * 60, "<a> is deeper than 50 elements"),
        ("&passwd;", "is not XML: undefined entity"),
    ],
)
def test_what_an_aircraft_may_not_ask_for_is_refused_by_file_and_line(folder, element, said):
    (folder / "Systems").mkdir(exist_ok=True)
    (folder / "Systems" / "linked.xml").symlink_to(folder.parent / "beside.xml")
    line = change(folder / MAIN, begin(folder), f"{begin(folder)}\n{element}") + 1
    text = refusal(folder)
    assert text.startswith(f"{folder / MAIN}:{line}: ") and said in text


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>',
        '<!DOCTYPE x [<!ENTITY passwd SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE x SYSTEM "file:///dev/zero">',
    ],
)
@pytest.mark.parametrize("file", [MAIN, MOTOR])
def test_entities_are_refused_in_every_file(folder, file, doctype):
    change(folder / file, "<!--", f"{doctype}\n<!--")
    assert f"{folder / file}:2: <!DOCTYPE> and entities are not read" in refusal(folder)


def test_files_that_name_one_another_are_refused(folder):
    change(folder / MAIN, begin(folder), f'{begin(folder)}\n<system file="a"/>')
    (folder / "a.xml").write_text('<system name="a"><system file="b"/></system>')
    (folder / "b.xml").write_text('<system name="b"><system file="a"/></system>')
    assert "which names it in turn (remove one)" in refusal(folder)


def test_a_model_that_is_a_link_out_a_pipe_or_huge_is_refused(folder):
    os.mkfifo(folder / "pipe.xml")  # whoever reads it waits for ever
    assert airframe(folder).span > 2.0
    with (folder / MAIN).open("a") as main:
        main.write(" " * airframe_files.MOST_BYTES)
    assert "is larger than 10,000,000 bytes: not an aircraft" in refusal(folder)
    (folder / MAIN).rename(folder.parent / "elsewhere.xml")
    (folder / MAIN).symlink_to(folder.parent / "elsewhere.xml")
    assert "is a link out of" in refusal(folder)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (PROPELLER, "0.8   0.0172", "54    0.0172", "row lookup is not monotonically increasing"),
        (MOTOR, 'unit="WATTS"', 'unit="nan"', 'Supplied unit: "nan" does not exist'),
    ],
)
def test_where_jsbsim_crashes_the_error_has_what_it_said_last(folder, file, old, new, said, capfd):
    change(folder / file, old, new)
    text = refusal(folder)
    assert text.startswith(f"{folder / file}:") and f"JSBSim says: {said}" in text.replace(
        "FGTable: ", ""
    )
    assert capfd.readouterr() == ("", "")


def test_a_crash_without_a_word_is_an_error(folder):
    explore = lambda tell: os.kill(os.getpid(), 11)  # noqa: E731
    with pytest.raises(AircraftError, match=r"xml: JSBSim crashed \(SIGSEGV\)"):
        airframe_files.explored(folder, explore)()


def test_what_never_ends_is_ended(folder, monkeypatch):
    monkeypatch.setattr(trial, "LONGEST_S", 1)
    with pytest.raises(AircraftError, match="did not come to an end within 1 s"):
        airframe_files.explored(folder, lambda tell: time.sleep(60))()


def test_what_is_found_out_meanwhile_is_found_out_once(folder, monkeypatch):
    """And anew of files that have changed; what is wrong is for who loads the aircraft."""
    asked, done = [], []

    def counted(*given):
        asked.append(given)
        return airframe_files.explored(*given)

    def meanwhile():
        done.append(len(asked))

    monkeypatch.setattr(jsbsim_door, "explored", counted)
    explore([folder, folder], meanwhile)
    explore([folder], meanwhile)
    airframe(folder)
    assert done == [1, 1] and len(asked) == 1
    change(folder / MAIN, "> 1.95 <", "> 0.01 <")
    explore([folder], meanwhile)
    assert len(asked) == 2
    assert "mass_balance: no rigid body has" in refusal(folder)

    change(folder / MAIN, "<mass_balance>", '<input port="41234" type="SOCKET"/><mass_balance>')
    explore([folder], meanwhile)
    assert "<input> opens a socket" in refusal(folder)


def test_nobody_is_left_to_wait_for_where_something_else_fails(folder):
    with pytest.raises(ZeroDivisionError):
        explore([folder], lambda: 1 // 0)
    assert not children(os.getpid())
