"""`help()` of every public name: fields with shapes and units, arguments, and errors."""

import importlib
import inspect
import pydoc
import re
from dataclasses import fields, is_dataclass

import pytest
from places import ROOT

import testbed
from testbed.core import records

REFERENCE = ROOT / "docs" / "reference" / "python.md"
ARRAYS = re.compile(r"Array|Indices|NDArray")


def public_names():
    """Yield everything that testbed, testbed.law and the reference export: (name, object)."""
    for name in testbed.__all__:
        if not name.startswith("_"):
            yield f"testbed.{name}", getattr(testbed, name)
    for name in testbed.law.__all__:
        yield f"testbed.law.{name}", getattr(testbed.law, name)
    for name, kind in vars(records).items():
        if inspect.isclass(kind) and kind.__module__ == records.__name__ and name[0] != "_":
            yield f"testbed.core.records.{name}", kind
    for path in re.findall(r"^::: (testbed[.\w]+\.\w+)$", REFERENCE.read_text("utf-8"), re.M):
        module, _, name = path.rpartition(".")
        parent = importlib.import_module(module) if "." in module else testbed
        if not inspect.ismodule(found := getattr(parent, name)):
            yield path, found


PUBLIC = dict(public_names())


def test_reference_and_package_have_names():
    assert {"testbed.Simulation", "testbed.Run", "testbed.load_run", "testbed.law.Inbox"} <= set(
        PUBLIC
    )
    assert len(PUBLIC) > 40


@pytest.mark.parametrize("name", PUBLIC)
def test_help_describes_the_name(name):
    found = PUBLIC[name]
    text = inspect.getdoc(found) or ""
    assert len(text.split()) >= 3, "no docstring"
    shown = pydoc.plain(pydoc.render_doc(found))
    assert text.splitlines()[0] in shown
    if inspect.isfunction(found):
        named = [each for each in inspect.signature(found).parameters if each != "self"]
        assert len(named) < 2 or all(re.search(rf"\b{each}\b", text) for each in named)


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, each in PUBLIC.items()
        if is_dataclass(each) or (inspect.isclass(each) and hasattr(each, "_fields"))
    ],
)
def test_help_describes_each_field(name):
    """Each field has a line; an array has its shape in it."""
    kind = PUBLIC[name]
    text = inspect.getdoc(kind)
    types = kind.__annotations__
    known = [each.name for each in fields(kind)] if is_dataclass(kind) else kind._fields
    for each in known:
        line = re.search(rf"^ *{each}: (\S.*)$|`{each}`", text, re.M)
        assert line, f"{name}.{each} is not described"
        if ARRAYS.search(str(types[each])) and "Mapping" not in str(types[each]):
            assert re.search(r"\([nNkK0-9]", line[1]), f"{name}.{each} has no shape"


@pytest.mark.parametrize("kind", [testbed.Simulation, testbed.Aircraft, testbed.FlightData])
def test_help_describes_methods_and_properties(kind):
    for name, member in inspect.getmembers_static(kind):
        if not name.startswith("_") and not inspect.ismemberdescriptor(member):
            assert inspect.getdoc(member), f"{kind.__name__}.{name}"


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [
        (records.VehicleState, records.MOTION),
        (records.AirData, records.AIRCRAFT),
        (records.WindInput, records.WIND),
        (records.FbwaCommand, records.COMMAND),
        (records.ActuatorCommand, records.ACTUATORS),
        (records.FaultState, records.FAULTS),
        (records.Broadcast, records.MESSAGE),
        (records.FormationState, records.FOLLOWER),
        (records.Messages, records.LINK),
    ],
)
def test_documented_shapes_are_those_of_records(kind, dtype):
    """Shapes beyond the axes of aircraft and followers: (N, 3) is three numbers in a record."""
    shapes = {name: dtype[name].shape for name in dtype.names}
    if kind is records.AirData:
        shapes = {
            name: dtype[part][name].shape for part in ("air", "wind") for name in dtype[part].names
        }
    checked = 0
    for name in kind._fields:
        axes = re.search(rf"^ *{name}: \(([^)]*)\)", kind.__doc__, re.M)[1].split(",")
        inner = tuple(int(axis) for axis in axes if axis.strip().isdigit())
        if name in shapes:
            assert shapes[name] == inner, name
            checked += 1
    assert checked >= len(kind._fields) - 1  # age_s of FormationState is of the links
