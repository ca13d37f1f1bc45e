"""Elements of an aircraft's files, with the place of each, as far as they are translated."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from testbed.airframes.airframe_grammar import GRAMMAR, MAIN, Element, Text, row_of
from testbed.airframes.airframe_validation import MAX_BYTES
from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded

_FOOT = 3.2808399  # of a metre, as JSBSim has it
# JSBSim's factors; its other units are not translated
_FACTORS = {
    **{(each, each): 1.0 for each in ("FT", "IN", "SLUG*FT2", "WATTS", "RAD", "DEG", "SEC")},
    ("DEG", "RAD"): math.pi / 180.0,
    ("IN", "FT"): 1.0 / 12.0,
    ("M", "FT"): _FOOT,
    ("FT", "IN"): 12.0,
    ("M", "IN"): _FOOT * 12.0,
    ("KG*M2", "SLUG*FT2"): 1.0 / 1.35594,
    ("HP", "WATTS"): 1.0 / 0.001341022,
    **{(each, each): 1.0 for each in ("VOLTS", "OHMS", "AMPERES")},
}


class NotTranslated(InputError):
    """Parts of an aircraft that only JSBSim flies.

    The message has a line for each, with file, line and element.
    """


@dataclass(slots=True)
class XmlNode:
    """An element of a file.

    Attributes:
        tag: its name.
        attributes: those of the file.
        file, line: where it begins.
        row: of the table of elements.
        text: its own, without that of its children.
        children: elements in it, but for texts for people.
        is_refused: it is not translated, and why is a reason already.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    row: Element
    text: str = ""
    children: list[XmlNode] = field(default_factory=list)
    is_refused: bool = False

    def describe(self, reason: str) -> str:
        """Return a reason with the place of this element."""
        return f"{self.file}:{self.line}: <{self.tag}> {reason}"

    def fail(self, reason: str) -> NoReturn:
        """Raise NotTranslated with the place of this element."""
        raise NotTranslated(self.describe(reason))

    def all(self, *tags: str) -> list[XmlNode]:
        """Return the children with one of these names."""
        return [each for each in self.children if each.tag in tags]

    def find(self, tag: str) -> XmlNode | None:
        """Return the only child of a name, or None."""
        found = self.all(tag)
        if len(found) > 1:
            found[1].fail(f"occurs more than once in <{self.tag}>")
        return found[0] if found else None

    def child(self, tag: str) -> XmlNode:
        """Return the only child of a name, which must be there."""
        found = self.find(tag)
        return self.fail(f"has no <{tag}>") if found is None else found

    @property
    def word(self) -> str:
        """Text without blanks around it."""
        return self.text.strip()

    @property
    def number(self) -> float:
        """The text as a number."""
        try:
            return float(self.word)
        except ValueError:
            self.fail(f"is {self.word!r} and no number")

    def attribute(self, name: str, default: float) -> float:
        """Return an attribute as a number."""
        text = self.attributes.get(name, "").strip()
        try:
            return float(text) if text else default
        except ValueError:
            self.fail(f"has {name}={text!r}, which is no number")

    def value(self, tag: str, unit: str = "", default: float | None = None) -> float:
        """Return the number of a child in a unit of JSBSim."""
        child = self.find(tag)
        if child is None:
            return self.fail(f"has no <{tag}>") if default is None else default
        return child.number * child.factor(unit)

    def factor(self, unit: str) -> float:
        """Return what the numbers of this element are multiplied by for a unit."""
        given = self.attributes.get("unit", "").strip()
        if not given or not unit:
            return 1.0
        if (given, unit) not in _FACTORS:
            self.fail(f"has the unit {given}")
        return _FACTORS[given, unit]

    def vector(self, unit: str, *tags: str) -> tuple[float, float, float]:
        """Return three children, x y z unless named, in a unit."""
        factor = self.factor(unit)
        x, y, z = (self.value(each, default=0.0) * factor for each in tags or "xyz")
        return x, y, z

    def rows(self) -> list[list[float]]:
        """Return the numbers of the text, line by line."""
        try:
            lines = [[float(each) for each in line.split()] for line in self.text.splitlines()]
        except ValueError:
            self.fail("has a word between its numbers")
        return [line for line in lines if line]

    def walk(self) -> Iterator[XmlNode]:
        """Yield this element and all below it."""
        yield self
        for each in self.children:
            yield from each.walk()


def read_aircraft(folder: Path, reasons: list[str]) -> XmlNode:
    """Read the main file of an aircraft that `check_airframe` has accepted, and what it names.

    Elements with an attribute `file` get the children of the file's first element.

    Args:
        folder: of the aircraft.
        reasons: gets one for each element or attribute that is not translated.
    """
    folder = folder.resolve()
    return _read(folder / f"{folder.name}.xml", GRAMMAR[MAIN], folder, reasons)


def _read(file: Path, row: Element, home: Path, reasons: list[str]) -> XmlNode:
    top: list[XmlNode] = []
    stack: list[XmlNode | None] = []  # None: below prose
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def begin(tag: str, attributes: dict[str, str]) -> None:
        parent = stack[-1] if stack else None
        if stack and (parent is None or parent.row.text is Text.PROSE):
            stack.append(None)
            return
        found = row_of(parent.row, tag) if parent else _root_row(row, tag)
        node = XmlNode(tag, attributes, file, parser.CurrentLineNumber, found or Element())
        node.is_refused = parent is not None and parent.is_refused
        if not node.is_refused and (why := _refusal(node, found, parent)):
            node.is_refused = True
            reasons.append(node.describe(why))
        stack.append(node if found is not None else None)
        if parent is None:
            top.append(node)
        elif found is None or found.text is not Text.PROSE:
            parent.children.append(node)

    def end(_: str) -> None:
        stack.pop()

    def add_text(text: str) -> None:
        if stack and stack[-1] is not None:
            stack[-1].text += text

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = add_text
    parser.Parse(read_bounded(file, MAX_BYTES, error=InputError), True)
    for node in top[0].walk():
        if "file" in node.attributes and not node.is_refused:
            _include(node, home, reasons)
    return top[0]


def _root_row(row: Element, tag: str) -> Element:
    kinds = row.kinds.split()
    return GRAMMAR[tag] if kinds else row


def _refusal(node: XmlNode, row: Element | None, parent: XmlNode | None) -> str:
    """Return why the table does not have an element or an attribute as translated, or nothing."""
    if row is None:
        return "is not known here"
    missing = row.not_translated
    if missing is None and row.text is not Text.PROSE:
        return "is not translated"
    if parent is not None and node.tag in (parent.row.not_translated or "").split():
        return f"in <{parent.tag}> is not translated"
    for attribute in node.attributes:
        if attribute in (missing or "").split():
            return f"with the attribute {attribute} is not translated"
    return ""


_PATTERN = re.compile(r"\.xml$")


def _include(node: XmlNode, home: Path, reasons: list[str]) -> None:
    """Put the first element of the file that an element names in its place, or below it."""
    name = node.attributes["file"]
    path = name if _PATTERN.search(name) else f"{name}.xml"
    files = {(home / each / path).resolve() for each in node.row.folders}
    found = [each for each in files if each.is_file()]
    if len(found) != 1:
        node.is_refused = True
        reasons.append(node.describe(f"file={name!r} is the name of {len(found)} files"))
        return
    root = _read(found[0], node.row, home, reasons)
    node.children += [root] if node.row.kinds else root.children
