"""What must be known of a JSBSim file to copy it: files that it names, and what is cut out of it.

`airframe_import` says which parts are cut, and why.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

from testbed.airframes.airframe_grammar import (
    GRAMMAR,
    MAIN,
    Element,
    Text,
    property_problem,
    row_of,
)
from testbed.airframes.airframe_power import FileLine
from testbed.airframes.airframe_validation import MAX_BYTES
from testbed.airframes.powerplant import AircraftError
from testbed.core.input_files import read_bounded

_CUT = ("output", "input")
_DOCTYPE = b"<!DOCTYPE"
_PROPERTY = re.compile(r"[\w./\[\]-]+", re.ASCII)


class Cut(NamedTuple):
    """An element or an attribute that was cut out.

    Attributes:
        place: where it was.
        element: as it is written, "<output>".
    """

    place: FileLine
    element: str


class NamedFile(NamedTuple):
    """A file that an element names."""

    place: FileLine
    element: str
    name: str


class FileScan:
    """What must be known of a file to copy it: files that it names, and what is cut out."""

    def __init__(self, file: Path, *, is_main: bool) -> None:
        """Read one file.

        Raises:
            AircraftError: it cannot be read, or is not XML; with file and line.
        """
        self.file, self._is_main = file, is_main
        self.data = read_bounded(file, MAX_BYTES, error=AircraftError)
        self.uses: list[NamedFile] = []
        self.cuts: list[Cut] = []
        self.problems: list[str] = []
        self._spans: list[tuple[int, int]] = []
        self._depth = 0
        self._rows: list[Element | None] = []  # of the open elements; None: not known
        self._text: list[str] = []  # since the last tag
        self._tag: tuple[int, list[str]] | None = None  # first byte, attributes to cut
        self._output = 0  # first byte of the last element whose text is written to
        self._begun: tuple[int, int] | None = None  # first byte and depth of what is cut
        self._parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._doctype
        parser.EndDoctypeDeclHandler = self._end_doctype
        parser.DefaultHandler = self._other  # with which entities are not expanded
        if b"\0" in self.data:
            raise AircraftError(f"{file}:1: is not UTF-8 or ASCII (save the file as UTF-8)")
        _parse(parser, self.data, file)
        if self._spans and not self.problems:  # an attribute may use an entity
            _parse(expat.ParserCreate(), self.remaining(), file)

    def remaining(self) -> bytes:
        """Return the file without what is cut out, whose line breaks stay."""
        parts, last = [], 0
        for begin, end in self._spans:
            parts += [self.data[last:begin], b"\n" * self.data.count(b"\n", begin, end)]
            last = end
        return b"".join((*parts, self.data[last:]))

    def _place(self) -> FileLine:
        return FileLine(self.file, self._parser.CurrentLineNumber)

    def _begin(self, name: str, attributes: Mapping[str, str]) -> None:
        self._close_tag()
        self._depth += 1
        parent = self._rows[-1] if self._rows else None
        row = GRAMMAR.get(name) if self._depth == 1 else parent and row_of(parent, name)
        self._rows.append(row)
        if self._begun is not None:
            return
        place = self._place()
        if self._depth == 1 and self._is_main and name != MAIN:
            self.problems.append(
                f"{place}: begins with <{name[:40]}>, and a JSBSim aircraft with <{MAIN}> "
                "(give the file of an aircraft)"
            )
        if self._is_main and self._depth == 2 and name in _CUT:
            self._begun = self._parser.CurrentByteIndex, self._depth
            self.cuts.append(Cut(place, f"<{name}>"))
        elif "file" in attributes and name in GRAMMAR and GRAMMAR[name].folders:
            self.uses.append(NamedFile(place, name, attributes["file"]))
        if row is not None and row.text is not Text.PROSE:
            self._text, self._output = [], self._parser.CurrentByteIndex
            unknown = [each for each in attributes if not self._is_known(row, each)]
            self._tag = self._parser.CurrentByteIndex, unknown
            self.cuts += [Cut(place, f'{each}="…" of <{name}>') for each in unknown]

    def _is_known(self, row: Element, attribute: str) -> bool:
        """Return whether JSBSim reads an attribute of an element."""
        if attribute in (*row.attributes.split(), "name", "unit"):
            return True
        return attribute == "file" or (self._depth == 1 and attribute.startswith(("xmlns", "xsi:")))

    def _close_tag(self) -> None:
        """Cut attributes of the last tag, which ends before this event."""
        if self._tag is None:
            return
        (begin, unknown), self._tag = self._tag, None
        tag = self.data[begin : self._parser.CurrentByteIndex]
        for each in unknown:
            written = rb"\s+%b\s*=\s*(\"[^\"]*\"|'[^']*')" % re.escape(each.encode())
            if found := re.search(written, tag):
                self._spans.append((begin + found.start(), begin + found.end()))

    def _end(self, name: str) -> None:
        self._close_tag()
        row = self._rows.pop()
        if self._begun is not None and self._begun[1] == self._depth:
            # of <output/> the byte behind it, which may be the end tag of the aircraft
            end = self._parser.CurrentByteIndex
            if self.data.startswith(f"</{name}".encode(), end):
                end = self.data.index(b">", end) + 1
            self._spans.append((self._begun[0], end))
            self._begun = None
        elif self._begun is None and row is not None and name == "output":
            self._check_output(row)
        self._depth -= 1

    def _check_output(self, row: Element) -> None:
        """Cut an output to a property that the testbed sets, as to stop a flight after a crash."""
        text = "".join(self._text).strip()
        if row.text is Text.WRITES and _PROPERTY.fullmatch(text) and property_problem(text):
            begin = self._output
            end = self.data.index(b">", self._parser.CurrentByteIndex) + 1
            self._spans = [span for span in self._spans if span[0] < begin]
            self._spans.append((begin, end))
            line = self._parser.CurrentLineNumber
            self.cuts.append(Cut(FileLine(self.file, line), f"<output>{text}</output>"))

    def _doctype(self, *_: Any) -> None:  # noqa: ANN401 - expat's
        self.cuts.append(Cut(self._place(), "<!DOCTYPE>"))
        begin = self.data.rindex(_DOCTYPE, 0, self._parser.CurrentByteIndex)
        self._spans.append((begin, begin))

    def _end_doctype(self) -> None:
        begin, _ = self._spans[-1]
        self._spans[-1] = begin, self._parser.CurrentByteIndex + 1

    def _other(self, text: str) -> None:
        self._close_tag()
        self._text.append(text)
        if text.startswith("&"):
            self.problems.append(
                f"{self._place()}: uses the entity {text[:40]} (write its text in its place)"
            )


def _parse(parser: Any, data: bytes, file: Path) -> None:  # noqa: ANN401 - expat's
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        text = expat.ErrorString(error.code)
        raise AircraftError(f"{FileLine(file, error.lineno)}: is not XML: {text}") from None
    except (ValueError, LookupError) as error:
        raise AircraftError(f"{file}:1: is not XML in a known encoding: {error}") from None
