"""Files of FMUs: what is refused, in one line with the file, and that nothing else is written."""

import stat
import struct
import zipfile

import pytest
from c_fmus import TOKEN, archive, description, law_fmu, need_compiler

from testbed.core.errors import InputError
from testbed.fmi.archive import MAX_ENTRIES, Archive, platform_of
from testbed.fmi.law_variables import match_variables
from testbed.fmi.model_description import read_description
from testbed.plan.fmu_law import load_fmu
from testbed.scenario import ScenarioError, load_scenario

DESCRIPTION = "modelDescription.xml"
BINARY = f"binaries/{platform_of(2)[0]}/law{platform_of(2)[1]}"


def link_entry(name):
    """A ZIP file with a symbolic link in place of a file."""
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return {DESCRIPTION: description(), info: "/etc/passwd"}


WRONG_ARCHIVES = {
    "no_zip": (b"PK, but no more", "is no FMU"),
    "above": (archive({DESCRIPTION: description(), "../../evil": b"x"}), "leads out"),
    "absolute": (archive({DESCRIPTION: description(), "/tmp/evil": b"x"}), "leads out"),
    "backslash": (archive({DESCRIPTION: description(), "..\\evil": b"x"}), "leads out"),
    "link": (archive(link_entry("resources/x")), "is no plain file"),
    "bomb": (archive({DESCRIPTION: description(), "x": bytes(65_000_000)}), "is larger than 64 MB"),
    "many": (archive({f"{k}": b"" for k in range(MAX_ENTRIES + 1)}), "entries"),
    "no_description": (archive({"x": b"x"}), "has no modelDescription.xml"),
}


@pytest.mark.parametrize("case", WRONG_ARCHIVES)
def test_wrong_archive_is_refused(tmp_path, case):
    """One line with the file; nothing is unpacked."""
    data, text = WRONG_ARCHIVES[case]
    file = tmp_path / "law.fmu"
    file.write_bytes(data)
    with pytest.raises(InputError, match=rf"law\.fmu: .*{text}") as found:
        Archive(file)
    assert "\n" not in str(found.value)
    assert [*tmp_path.iterdir()] == [file]


def test_size_in_the_directory_is_not_believed(tmp_path):
    """An entry that is larger than the archive says is refused while it is read."""
    data = bytearray(archive({DESCRIPTION: description() + " " * 10_000_000}))
    at = data.rindex(b"PK\x01\x02")
    struct.pack_into("<I", data, at + 24, 5_000)
    file = tmp_path / "law.fmu"
    file.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"law\.fmu: modelDescription\.xml is (larger|damaged)"):
        read_description(Archive(file))


def described(folder, text, version=2, **how):
    """What the FMU of a changed description says."""
    file = folder / "law.fmu"
    file.write_bytes(archive({DESCRIPTION: description(version, text=text, **how)}))
    return read_description(Archive(file))


WRONG_DESCRIPTIONS = {
    "version": (lambda x: x.replace('fmiVersion="2.0"', 'fmiVersion="1.0"'), "is of FMI 1.0"),
    "exchange": (lambda x: x.replace("CoSimulation", "ModelExchange"), "no co-simulation FMU"),
    "tool": (
        lambda x: x.replace("<CoSimulation", '<CoSimulation needsExecutionTool="true"'),
        "needs the program that has written it",
    ),
    "identifier": (lambda x: x.replace('"law" can', '"../law" can'), "is no name of C"),
    "entities": (lambda x: f'<!DOCTYPE x [<!ENTITY a "b">]>{x}', "has a document type"),
    "deep": (lambda x: "<a>" * 100 + "</a>" * 100, "is nested deeper"),
    "no_xml": (lambda x: x[:-20], "is no XML"),
    "reference": (
        lambda x: x.replace('valueReference="100"', 'valueReference="-1"'),
        "whole number",
    ),
    "twice": (lambda x: x.replace('"own.position_ned[2]"', '"now"'), "two variables 'now'"),
}


@pytest.mark.parametrize("case", WRONG_DESCRIPTIONS)
def test_wrong_description_is_refused(tmp_path, case):
    """One line with the file."""
    text, reason = WRONG_DESCRIPTIONS[case]
    with pytest.raises(InputError, match=rf"law\.fmu: .*{reason}") as found:
        described(tmp_path, text)
    assert "\n" not in str(found.value)


def put(old, new):
    """What replaces a text of a description, which must be there."""

    def change(text):
        assert old in text
        return text.replace(old, new)

    return change


WRONG_VARIABLES = {
    "name": (put("own.velocity_ned[1]", "own.velocity[1]"), {}, "no field: did you mean 'own.vel"),
    "unit": (put('unit="m/s" start="0"', 'unit="km/h" start="0"'), {}, "unit 'km/h' .write m/s"),
    "type": (put('<Real unit="s" start="0"/>', '<Integer start="0"/>'), {}, "is Int32 .write Real"),
    "start": (put('unit="s" start="0"', 'unit="s" start="nan"'), {}, "start value 'nan'"),
    "range": (put('unit="s" start="0"', 'unit="s" min="1" start="0"'), {}, "not between its min 1"),
    "index": (put("position_ned[1,2]", "position_ned[5,2]"), {}, "index 5 .the formation has 4"),
    "axis": (put("own.position_ned[3]", "own.position_ned[4]"), {}, "index 4 .it has 3 numbers"),
    "step": (put('stepSize="0.02"', 'stepSize="0.03"'), {}, "0.03 s does not divide the control"),
    "output": (put('name="roll"', 'name="rol"'), {}, "no field: did you mean 'roll'"),
    "mixed": (put(' unit="rad"', ""), {"names": {"roll": "speed"}}, "outputs of several commands"),
    "incomplete": (lambda x: x, {"names": {"roll": "none"}}, "has no output roll"),
    "causality": (put('name="closing"', 'name="own.airspeed"'), {}, "write the causality input"),
    "option": (lambda x: x, {"options": {"closin": 1.0}}, "no parameter 'closin': did you mean"),
    "value": (lambda x: x, {"options": {"closing": True}}, "is True .write a number"),
    "map": (lambda x: x, {"names": {"nov": "now"}}, "no variable 'nov': did you mean 'now'"),
    "field": (lambda x: x, {"names": {"now": "inbox.age_s"}}, "one number of inbox.age_s"),
}


@pytest.mark.parametrize("case", WRONG_VARIABLES)
def test_wrong_variable_is_refused(tmp_path, case):
    """One line with file, line and the nearest name."""
    text, how, reason = WRONG_VARIABLES[case]
    model = described(tmp_path, text)
    with pytest.raises(InputError, match=reason) as found:
        match_variables(model, how.get("names", {}), how.get("options", {}), 4, 0.04)
    assert "law.fmu" in str(found.value) and "\n" not in str(found.value)


def test_array_of_fixed_size_is_refused(tmp_path):
    """An array of 3.0 with a number in place of N fits one formation only."""
    old, new = '<Dimension valueReference="20"/>', '<Dimension start="5"/>'
    model = described(tmp_path, put(old, new), 3)
    match_variables(model, {}, {}, 5, 0.04)
    with pytest.raises(InputError, match="a dimension of 5, which is 4 here"):
        match_variables(model, {}, {}, 4, 0.04)


def test_map_names_what_is_named_otherwise(tmp_path):
    """Names of a tool are fields by the map, also without their indices, or not used."""
    text = put('"own.position_ned[', '"In_Pos[')
    names = {"In_Pos": "own.position_ned", "inbox.failed[1]": "none"}
    found = match_variables(described(tmp_path, text), names, {}, 4, 0.04)
    plain = match_variables(described(tmp_path, lambda x: x), {}, {}, 4, 0.04)
    assert found.inputs == plain.inputs and plain.flags and not found.flags


def test_units_of_the_fmu_are_known(tmp_path):
    """A unit of another name is known by its base units; one with a factor is refused."""
    units = '<UnitDefinitions><Unit name="mps"><BaseUnit m="1" s="-1"{}/></Unit></UnitDefinitions>'

    def text(factor):
        change = put('unit="m/s"', 'unit="mps"')
        before = "<DefaultExperiment"
        return lambda x: change(x).replace(before, units.format(factor) + before)

    match_variables(described(tmp_path, text("")), {}, {}, 4, 0.04)
    with pytest.raises(InputError, match="unit 'mps' .write m/s"):
        match_variables(described(tmp_path, text(' factor="0.5"')), {}, {}, 4, 0.04)


def test_missing_binary_names_platforms(tmp_path):
    """An FMU for another platform says which it has."""
    file = tmp_path / "law.fmu"
    file.write_bytes(archive({DESCRIPTION: description(), "binaries/win64/law.dll": b"MZ"}))
    with pytest.raises(InputError, match=r"law\.fmu: has no binaries/.* .it has win64"):
        load_fmu(file)


def test_damaged_binary_is_refused(tmp_path):
    """What is no library of this platform is an error, not a crash."""
    file = tmp_path / "law.fmu"
    file.write_bytes(archive({DESCRIPTION: description(), BINARY: b"no ELF"}))
    with pytest.raises(InputError, match=r"law\.fmu: binaries/.* cannot be loaded"):
        load_fmu(file)


def test_wrong_token_is_refused(tmp_path):
    """An FMU whose description is that of another binary makes no instance."""
    need_compiler()
    file = law_fmu(tmp_path / "law.fmu", text=put(TOKEN, "{another}"))
    with pytest.raises(InputError, match=r"makes no instance; is guid .*'\{another\}'"):
        load_fmu(file).instantiate("uav1", object)


def test_fmu_above_the_scenario_is_refused(tmp_path):
    """A file outside of the scenario's folder is not loaded, also not by a link."""
    need_compiler()
    law_fmu(tmp_path / "law.fmu")
    below = tmp_path / "below"
    below.mkdir()
    (below / "linked.fmu").symlink_to(tmp_path / "law.fmu")
    for name in ("../law.fmu", "linked.fmu"):
        file = below / "flight.yaml"
        file.write_text(f"extends: simulation-3\ncontroller: {{law: {name}}}\n")
        with pytest.raises(ScenarioError, match="is not in the folder of the file that names it"):
            load_scenario(file)


def test_map_needs_an_fmu():
    """`controller.map` of another law is an error."""
    with pytest.raises(ScenarioError, match="names variables of an FMU"):
        load_scenario("simulation-3", ["controller.map={a: now}"])
