"""Copies of an aircraft with another mass, drag, aileron power or elevator power.

A variant is an aircraft folder like any other. Of its files only the main one differs: in the
empty weight, and in factors that are properties `fit/<name>-factor`, which multiply terms of the
aerodynamics. Comments and the layout of the file stay.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from testbed.airframes.airframe_validation import MAX_BYTES
from testbed.airframes.powerplant import AircraftError
from testbed.core.files import write_file
from testbed.core.input_files import read_bounded
from testbed.vehicle.jsbsim_adapter import airframe

FACTORS = {
    "mass": "of the whole mass, at the centre of gravity of the empty weight; inertia is unchanged",
    "drag": "of all functions in the axis DRAG",
    "aileron": "of aileron deflections in the rolling moment",
    "elevator": "of elevator deflections in the pitching moment",
}
_CONTROLS = {"aileron": ("ROLL", "aileron"), "elevator": ("PITCH", "elevator")}
_DEFLECTION = r"-?\s*fcs/(?!.*-cmd-norm).*({}|elevon)"
_KILOGRAMS = {"": 0.45359237, "LBS": 0.45359237, "KG": 1.0}  # of the units of <emptywt>
_PROSE = ("description", "documentation", "note", "reference", "limitation")


@dataclass(slots=True)
class _Place:
    """An element of the file, by its bytes: `start` to `end`."""

    tag: str
    attributes: dict[str, str]
    line: int
    start: int
    end: int = 0
    text: str = ""
    children: list[_Place] = field(default_factory=list)

    def walk(self) -> Iterator[_Place]:
        """Yield this element and all below it."""
        yield self
        for each in self.children:
            yield from each.walk()


class _Insertion(NamedTuple):
    """Text in place of the bytes from `start` to `end`."""

    start: int
    end: int
    text: str


def copy_with_factors(folder: Path, copy: Path, factors: Mapping[str, float]) -> None:
    """Copy an aircraft folder, with factors of its mass, drag or control power.

    Args:
        folder: of the aircraft.
        copy: the new folder, which must not exist; the main file gets its name.
        factors: by the names in FACTORS. A factor that a variant has already is multiplied.

    Raises:
        AircraftError: a name has no place in the file, or the mass is less than that of the
            contents; the message names the file.
        OSError: the copy cannot be written.
    """
    folder = Path(folder).resolve()
    main = folder / f"{folder.name}.xml"
    content = read_bounded(main, MAX_BYTES, error=AircraftError)
    root = _parse(content, main)
    edits: list[_Insertion] = []
    declared = []
    for name, value in factors.items():
        if name == "mass":
            edits.append(_empty_weight(root, main, folder, value))
            continue
        prop = f"fit/{name}-factor"
        if (earlier := _declaration(root, prop)) is not None:
            before = float(earlier.attributes["value"])
            text = f'<property value="{before * value:.9g}"> {prop} </property>'
            edits.append(_Insertion(earlier.start, earlier.end, text))
            continue
        declared.append(f'    <property value="{value:.9g}"> {prop} </property>\n')
        wrapped = _drag(root, main) if name == "drag" else _deflections(root, main, name)
        for place in wrapped:
            edits.append(
                _Insertion(place.start, place.start, f"<product> <property> {prop} </property> ")
            )
            edits.append(_Insertion(place.end, place.end, " </product>"))
    if declared:
        start = _child(root, main, "aerodynamics").start
        text = f'<system name="fit">\n{"".join(declared)}  </system>\n\n  '
        edits.append(_Insertion(start, start, text))
    try:
        shutil.copytree(folder, copy)
    except shutil.Error as error:  # such as a pipe in it
        raise AircraftError(f"{folder}: cannot be copied: {error.args[0][0][2]}") from None
    (copy / main.name).unlink()
    with write_file(copy / f"{copy.name}.xml") as file:
        file.write(_edited(content, edits))


def _edited(content: bytes, edits: list[_Insertion]) -> bytes:
    parts, at = [], 0
    for start, end, text in sorted(edits):
        parts += [content[at:start], text.encode()]
        at = end
    return b"".join((*parts, content[at:]))


def _empty_weight(root: _Place, main: Path, folder: Path, factor: float) -> _Insertion:
    """Change the empty weight so that the whole mass, with contents, has the factor."""
    place = _child(_child(root, main, "mass_balance"), main, "emptywt")
    unit = place.attributes.get("unit", "").strip()
    if unit not in _KILOGRAMS:
        raise AircraftError(f"{main}:{place.line}: <emptywt> has the unit {unit} (write LBS or KG)")
    before, whole = float(place.text), airframe(folder).mass / _KILOGRAMS[unit]
    empty = before + (factor - 1.0) * whole
    if not empty > 0.0:
        raise AircraftError(
            f"{main}:{place.line}: <emptywt>: {factor:g} times the mass is less than the contents "
            "weigh"
        )
    attribute = f' unit="{unit}"' if unit else ""
    text = f"<emptywt{attribute}> {empty:.9g} </emptywt>"
    return _Insertion(place.start, place.end, text)


def _drag(root: _Place, main: Path) -> list[_Place]:
    """Return the operations of all functions of the drag."""
    found = []
    for function in _functions(root, main, "DRAG"):
        found += [each for each in function.children if each.tag not in _PROSE][:1]
    if not found:
        raise _missing(main, "drag", '<axis name="DRAG"> with functions')
    return found


def _deflections(root: _Place, main: Path, name: str) -> list[_Place]:
    """Return the uses of a control's deflection in its moment, and in the functions it names."""
    axis, word = _CONTROLS[name]
    named = {
        each.attributes["name"].strip(): each
        for each in _child(root, main, "aerodynamics").walk()
        if each.tag == "function" and "name" in each.attributes
    }
    pattern = re.compile(_DEFLECTION.format(word), re.IGNORECASE)
    waiting, seen, found = _functions(root, main, axis), list[int](), list[_Place]()
    while waiting:
        function = waiting.pop()
        if function.start in seen:
            continue
        seen.append(function.start)
        for each in function.walk():
            prop = each.text.strip()
            if each.tag in ("property", "p"):
                if pattern.match(prop):
                    found.append(each)
                elif prop in named:
                    waiting.append(named[prop])
            elif each.tag == "independentVar" and pattern.match(prop):
                raise AircraftError(
                    f"{main}:{each.line}: {prop} is the variable of a table, so {name} power has "
                    f"no factor (leave {name} out)"
                )
    if not found:
        raise _missing(main, name, f"deflection fcs/…{word}… in the axis {axis}")
    return found


def _functions(root: _Place, main: Path, axis: str) -> list[_Place]:
    return [
        function
        for each in _child(root, main, "aerodynamics").children
        if each.tag == "axis" and each.attributes.get("name", "").strip() == axis
        for function in each.children
        if function.tag == "function"
    ]


def _declaration(root: _Place, prop: str) -> _Place | None:
    """Return where a property gets its first value."""
    for system in root.children:
        for each in system.children:
            if each.tag == "property" and each.text.strip() == prop and "value" in each.attributes:
                return each
    return None


def _child(place: _Place, main: Path, tag: str) -> _Place:
    for each in place.children:
        if each.tag == tag:
            return each
    raise AircraftError(f"{main}:{place.line}: <{place.tag}> has no <{tag}> in this file")


def _missing(main: Path, name: str, what: str) -> AircraftError:
    return AircraftError(f"{main}: has no {what}, so {name} has no factor (leave {name} out)")


def _parse(content: bytes, main: Path) -> _Place:
    """Read a file whose aircraft JSBSim can load."""
    top: list[_Place] = []
    stack: list[_Place] = []
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def begin(tag: str, attributes: dict[str, str]) -> None:
        place = _Place(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex)
        (stack[-1].children if stack else top).append(place)
        stack.append(place)

    def end(_: str) -> None:
        place = stack.pop()
        at = parser.CurrentByteIndex
        if content.startswith(b"</", at):
            place.end = content.index(b">", at) + 1
        else:
            place.end = content.index(b"/>", place.start) + 2

    def add_text(text: str) -> None:
        if stack:
            stack[-1].text += text

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = add_text
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise AircraftError(f"{main}:{error.lineno}: {error}") from None
    return top[0]
