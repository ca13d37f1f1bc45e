"""Files of an aircraft: found, copied, cut and declared, byte by byte, or refused all at once."""

import re

import pytest

from testbed.airframes.powerplant import AircraftError
from testbed.commissioning.airframe_import import (
    MAX_DECLARED,
    check_folder_name,
    copy_aircraft,
    declare,
    declare_missing,
)

MAIN = b"""<?xml version="1.0"?>
<!-- kite -->
<fdm_config name="kite" version="2.0">
  <metrics file="Sizes"/>
  <propulsion>
    <engine file="motor"> <thruster file="disc"/> </engine>
  </propulsion>
  <system file="Systems/gear.xml"/>
  <flight_control name="fcs"> <channel name="a">
    <pure_gain name="fcs/a"> <input>fcs/b</input> <output>fcs/c</output> </pure_gain>
  </channel></flight_control>
  <input port="5137"/>
  <output name="a>b" type="CSV">
     <rate> 10 </rate>
  </output >\t<output file="out"></output></fdm_config>
"""


@pytest.fixture
def tree(tmp_path):
    """A tree like JSBSim's, with the aircraft `kite`; return it and a function that writes."""

    def write(path, data):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        return file

    write("aircraft/kite/kite.xml", MAIN)
    write("aircraft/kite/Sizes.xml", b"<metrics/>")
    write("aircraft/kite/Engine/motor.xml", b"<electric_engine/>")
    write("aircraft/kite/Systems/gear.xml", b"<!DOCTYPE system [\n <!ENTITY x '1'>\n]>\n<system/>")
    write("engine/disc.xml", b"<propeller/>")
    return tmp_path, write


def copy(root, shared=None):
    source = root / "aircraft" / "kite" / "kite.xml"
    return copy_aircraft(source, root / "new" / "dragon", shared or root / "nothing")


def test_files_go_to_their_folders(tree):
    root, _ = tree
    copied = copy(root)
    assert copied.main == root / "new" / "dragon" / "dragon.xml"
    names = {str(each.relative_to(copied.main.parent)) for each in copied.sources}
    assert names == {
        *("dragon.xml", "Sizes.xml", "Engines/motor.xml", "Engines/disc.xml", "Systems/gear.xml")
    }
    disc = copied.main.parent / "Engines" / "disc.xml"
    assert copied.sources[disc] == root / "engine" / "disc.xml"
    assert disc.read_bytes() == b"<propeller/>"


def test_cuts_leave_all_other_bytes_and_lines(tree):
    root, _ = tree
    copied = copy(root)
    places = [(each.place.file.name, each.place.line, each.element) for each in copied.cuts]
    assert places == [
        ("kite.xml", 12, "<input>"),
        ("kite.xml", 13, "<output>"),
        ("kite.xml", 15, "<output>"),
        ("gear.xml", 1, "<!DOCTYPE>"),
    ]
    begin = MAIN.index(b"<input port")
    expected = MAIN[:begin] + b"\n  \n\n\t</fdm_config>\n"
    assert copied.main.read_bytes() == expected
    assert expected.count(b"\n") == MAIN.count(b"\n")
    assert (copied.main.parent / "Systems" / "gear.xml").read_bytes() == b"\n\n\n<system/>"


def test_unread_attributes_and_outputs_are_cut(tree):
    root, write = tree
    gear = (
        b'<system name="a">\n<channel><switch name="b" unit="c">\n<test  Logic="AND"\n login=\'1\' '
        b'value="login=">x</test><output>\n simulation/integrator/rate/rotational </output>'
        b"<output>systems/own</output></switch></channel></system>"
    )
    write("aircraft/kite/Systems/gear.xml", gear)
    copied = copy(root)
    assert (copied.main.parent / "Systems" / "gear.xml").read_bytes() == (
        b'<system name="a">\n<channel><switch name="b" unit="c">\n<test\n '
        b'value="login=">x</test>\n<output>systems/own</output></switch></channel></system>'
    )
    assert [each.element for each in copied.cuts if each.place.file.name == "gear.xml"] == [
        'Logic="…" of <test>',
        'login="…" of <test>',
        "<output>simulation/integrator/rate/rotational</output>",
    ]


def test_file_without_cuts_is_equal(tree):
    root, write = tree
    odd = b"\xef\xbb\xbf<metrics  name='\xc3\xa9'\r\n>\r\n<!-- <output/> --></metrics >"
    write("aircraft/kite/Sizes.xml", odd)
    assert (copy(root).main.parent / "Sizes.xml").read_bytes() == odd


def test_all_missing_files_are_named_at_once(tree):
    root, write = tree
    (root / "aircraft/kite/Sizes.xml").unlink()
    (root / "engine/disc.xml").unlink()
    write("aircraft/kite/Engine/motor.xml", b"<electric_engine>")
    with pytest.raises(AircraftError) as refused:
        copy(root)
    lines = str(refused.value).splitlines()
    assert len(lines) == 3
    assert re.search(r"kite\.xml:4: file='Sizes': there is no Sizes\.xml in ", lines[0])
    assert re.search(r"kite\.xml:6: file='disc': there is no disc\.xml in ", lines[1])
    assert re.search(r"motor\.xml:1: is not XML", lines[2])
    assert not (root / "new").exists()


def test_own_file_precedes_shared_ones(tree):
    root, write = tree
    write("aircraft/kite/Engines/disc.xml", b"<propeller>own</propeller>")
    write("wheel/engine/disc.xml", b"<propeller>wheel</propeller>")
    copied = copy(root, root / "wheel")
    assert (copied.main.parent / "Engines/disc.xml").read_bytes() == b"<propeller>own</propeller>"
    (root / "aircraft/kite/Engines/disc.xml").unlink()
    (root / "engine/disc.xml").unlink()
    copied = copy_aircraft(root / "aircraft/kite/kite.xml", root / "b" / "b", root / "wheel")
    assert (copied.main.parent / "Engines/disc.xml").read_bytes() == b"<propeller>wheel</propeller>"


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "a/../../b", ".hidden", "a\\b", ""])
def test_name_that_leaves_the_folder_is_refused(tree, name):
    root, write = tree
    write("aircraft/secret.xml", b"<metrics/>")
    write("aircraft/kite/kite.xml", MAIN.replace(b'"Sizes"', f'"{name}"'.encode()))
    with pytest.raises(AircraftError, match=r"kite\.xml:4: file=.* is no plain name"):
        copy(root)


def test_link_out_of_the_folder_is_refused(tree):
    root, write = tree
    secret = write("secret.xml", b"<metrics/>")
    (root / "aircraft/kite/Sizes.xml").unlink()
    (root / "aircraft/kite/Sizes.xml").symlink_to(secret)
    with pytest.raises(AircraftError, match=r"kite\.xml:4: file='Sizes' is a link out of"):
        copy(root)


def test_used_entity_is_refused_with_its_line(tree):
    root, write = tree
    gear = b'<!DOCTYPE a [<!ENTITY x "1">]>\n<system>\n&x;</system>'
    write("aircraft/kite/Systems/gear.xml", gear)
    with pytest.raises(AircraftError, match=r"gear\.xml:3: uses the entity &x; \(write its text"):
        copy(root)
    write("aircraft/kite/Systems/gear.xml", gear.replace(b"&x;", b'<channel name="&x;"/>'))
    with pytest.raises(AircraftError, match=r"gear\.xml:3: is not XML: undefined entity"):
        copy(root)


def test_file_of_another_kind_is_refused(tree):
    root, write = tree
    write("aircraft/kite/kite.xml", b"<FDM_CONFIG/>")
    with pytest.raises(AircraftError, match=r"kite\.xml:1: begins with <FDM_CONFIG>"):
        copy(root)
    write("aircraft/kite/kite.xml", "<fdm_config/>".encode("utf-16"))
    with pytest.raises(AircraftError, match="is not UTF-8 or ASCII"):
        copy(root)


def missing(name):
    return AircraftError(f"x.xml:3: JSBSim: GetValue() The property {name} does not exist")


def test_missing_properties_are_declared_in_one_line(tree):
    root, _ = tree
    copied = copy(root)
    names = ["fcs/flaps", "/sim/a-b[1]"]
    errors = [missing(name) for name in names]

    def load():
        if errors:
            raise errors.pop(0)

    before = copied.main.read_bytes()
    declare_missing(copied, load)
    assert copied.declared == names
    added = (
        b'<system name="declared"><property value="0">fcs/flaps</property>'
        b'<property value="0">/sim/a-b[1]</property></system>'
    )
    assert copied.main.read_bytes() == before.replace(b"<metrics", added + b"<metrics", 1)


def test_other_errors_end_the_declarations(tree):
    root, _ = tree
    copied = copy(root)

    def fail():
        raise AircraftError("JSBSim cannot load it")

    with pytest.raises(AircraftError, match="cannot load it"):
        declare_missing(copied, fail)

    def always_the_same():
        raise missing("fcs/a")

    with pytest.raises(AircraftError, match="does not exist"):
        declare_missing(copied, always_the_same)
    numbers = iter(range(1000))

    def always_another():
        raise missing(f"fcs/b{next(numbers)}")

    with pytest.raises(AircraftError, match=f"more than {MAX_DECLARED} properties"):
        declare_missing(copied, always_another)


def test_declaration_needs_a_place(tree):
    root, write = tree
    write("aircraft/kite/kite.xml", b"<fdm_config/>")
    with pytest.raises(AircraftError, match="has no <metrics>"):
        declare(copy(root), "fcs/a")


@pytest.mark.parametrize("name", ["787-8", "t6texan2", "pogo-jsbsim", "A4", "a.b_c+d"])
def test_plain_folder_names_are_allowed(name):
    check_folder_name(name)


@pytest.mark.parametrize("name", ["", ".", "..", ".git", "-x", "a b", "a/b", "ä", "a\n"])
def test_other_folder_names_are_refused(name):
    with pytest.raises(AircraftError, match="--into"):
        check_folder_name(name)


def test_errors_name_the_original_files(tree):
    root, _ = tree
    copied = copy(root)
    text = f"{copied.main}:7: bad; {copied.main.parent / 'Engines' / 'motor.xml'}:2: worse"
    source = root / "aircraft" / "kite"
    assert copied.in_originals(text) == (
        f"{source / 'kite.xml'}:7: bad; {source / 'Engine' / 'motor.xml'}:2: worse"
    )
