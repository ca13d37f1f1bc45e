"""Checks of an aircraft's XML files before JSBSim reads them in this process.

JSBSim opens sockets, writes files, loads other aircraft and expands entities where files say so. An
aircraft has elements, files and properties of `airframe_grammar` only; all else is refused.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

from testbed.airframes.airframe_grammar import (
    GRAMMAR,
    MAIN,
    Element,
    Name,
    Text,
    property_problem,
    row_of,
)
from testbed.airframes.airframe_power import (
    AirframeFault,
    FileLine,
    PowerParts,
    kind_faults,
    pair_faults,
)
from testbed.airframes.forked_trial import ForkedResult, Work, run_forked
from testbed.airframes.powerplant import AircraftError
from testbed.core.input_files import read_bounded

MAX_BYTES = 10_000_000  # of a file
MAX_FILES = 100
MAX_DEPTH = 50  # of nested elements
FILE_NAME = re.compile(r"(?!\.)[\w .,()+-]+(/(?!\.)[\w .,()+-]+)*", re.ASCII)
_WITHOUT_MEANING = ("name", "unit")  # attributes of any element
_NAMESPACES = ("xmlns", "xsi:")  # attributes of the first element
# Elements that people have in their files, and what to do without them.
_REMEDIES = {
    "input": "opens a socket (remove it)",
    "output": "opens a socket or writes a file; the testbed writes the log (remove it)",
    "child": "loads another aircraft; a scenario's fleet has several (remove it)",
    "planet": "replaces the Earth; the testbed's is WGS 84 (remove it)",
}
_CHECKED = (Text.WRITES, Text.POSITIVE, Text.NOT_NEGATIVE)
_POUNDS = {"": 1.0, "LBS": 1.0, "KG": 2.2046226218}

_MOST_FAULTS = 50  # in a message


def probe_in_copy(folder: Path, probe: Work) -> Callable[[], Any]:
    """Check an aircraft, and start to examine it in a copy of this process.

    Args:
        folder: of the aircraft.
        probe: gets a function that reports an error, and returns plain data.

    Returns:
        A function that waits for the result, to be called once; it raises AircraftError with the
        error of JSBSim.

    Raises:
        AircraftError: as `check_airframe`.
    """
    check_airframe(folder)
    return partial(_result, folder, run_forked(probe))


def _result(folder: Path, wait: Callable[[], ForkedResult]) -> Any:  # noqa: ANN401
    found = wait()
    if found.value is not None:
        return found.value
    # the first record with a place is the cause; later ones follow from it
    placed = [text for text in found.messages if text.startswith(f"{folder}/")]
    text = next(iter((*placed, *filter(None, (found.error, *found.messages)))), "")
    text = text or f"JSBSim {found.end} without an error message"
    main = folder / f"{folder.name}.xml"
    raise AircraftError(text if text.startswith(f"{folder}/") else f"{main}: {text}")


def check_airframe(folder: Path) -> None:
    """Check the aircraft of a folder and every file that it names.

    Raises:
        AircraftError: there is no aircraft, or a file is not XML, exceeds the limits on size and
            depth, is outside the folder, or has something that is not in `GRAMMAR`, or a mass or
            size that no aircraft has; or it is no aeroplane, or has an engine that JSBSim does not
            fly as it says. The message has all faults, each in a line with file and line.
    """
    main = _main_file(folder)
    checked = check_files(main)
    parts = {file: check.parts for file, check in checked.items()}
    # of what is no aeroplane, nothing else matters
    raise_faults(kind_faults(folder.name, parts))
    faults = [fault for check in checked.values() for fault in check.faults]
    raise_faults([*faults, *pair_faults(folder.name, parts)])


def has_planet(main: Path) -> bool:
    """Return whether the main file of an aircraft has a planet, which JSBSim would take."""
    found: list[int] = []
    depth = 0
    parser = expat.ParserCreate()

    def begin(name: str, _: Mapping[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 2 and name == "planet":
            found.append(parser.CurrentLineNumber)

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.Parse(_content(main), True)
    return bool(found)


def raise_faults(faults: Sequence[AirframeFault]) -> None:
    """Raise the faults of an aircraft, if there are any.

    Raises:
        AircraftError: there are; each has a line of the message.
    """
    if faults:
        lines = [f"{place}: {text}" for place, text in faults[:_MOST_FAULTS]]
        if more := len(faults) - len(lines):
            lines.append(f"and {more} more")
        raise AircraftError("\n".join(lines))


def check_files(main: Path) -> dict[Path, FileCheck]:
    """Check the main file of an aircraft, and all that it names, by the rules of `GRAMMAR`.

    Returns:
        The checks of all files that could be read, with their faults.

    Raises:
        AircraftError: there are too many files, or they name one another in a cycle.
    """
    home = main.parent.resolve()
    checked: dict[Path, FileCheck] = {}
    waiting: list[tuple[Path, tuple[str, ...]]] = [(main.resolve(), (MAIN,))]
    while waiting:
        file, kinds = waiting.pop()
        if file not in checked:
            check = checked[file] = FileCheck(file, home, kinds)
            waiting += [(each, use.kinds) for use in check.uses for each in use.files]
        elif (kind := checked[file].kind) and kind not in kinds:
            checked[file].faults.append(AirframeFault(FileLine(file, 1), _wrong_kind(kind, kinds)))
        if len(checked) > MAX_FILES:
            raise AircraftError(f"{main}: names more than {MAX_FILES} files")
    _check_cycles(
        {
            file: {each for use in check.uses for each in use.files}
            for file, check in checked.items()
        },
        main.resolve(),
    )
    return checked


def _main_file(folder: Path) -> Path:
    main = folder / f"{folder.name}.xml"
    if not main.is_file():
        raise AircraftError(
            f"{folder}: no {folder.name}.xml in it; an aircraft folder has a JSBSim "
            "aircraft with the name of the folder"
        )
    if not main.resolve().is_relative_to(folder.resolve()):
        raise AircraftError(f"{main}: is a link out of {folder}; put a copy there")
    return main


@dataclass(slots=True)
class _Open:
    """An element that has begun and not ended."""

    name: str
    row: Element
    line: int
    unit: str = ""
    text: list[str] = field(default_factory=list)  # parts, of elements whose text is checked
    # values of its children, by their names: number, unit, line
    values: dict[str, tuple[float, str, int]] = field(default_factory=dict)


class _Use(NamedTuple):
    """Files that JSBSim may read for an attribute `file`, and their first element."""

    files: list[Path]
    kinds: tuple[str, ...]


class _UnreadableError(Exception):
    """The rest of a file cannot be checked."""


class FileCheck:
    """Check a file with JSBSim's parser.

    Attributes:
        kind: the first element; "" if there is none of the right kind.
        uses: files that it names.
        faults: in the order of the file.
        parts: engines, thrusters and gas cells in it.
    """

    def __init__(self, file: Path, home: Path, kinds: tuple[str, ...]) -> None:
        """Check one file, of an aircraft in the folder `home`.

        Raises:
            AircraftError: the file cannot be opened, or is too large.
        """
        self.file, self.home, self.kinds = file, home, kinds
        self.kind = ""
        self.uses: list[_Use] = []
        self.faults: list[AirframeFault] = []
        self.parts = PowerParts()
        self._open: list[_Open] = []
        self._skipped = 0  # depth below the first element of prose, or that is not known
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._add_text
        try:
            parser.Parse(_content(file), True)
        except expat.ExpatError as error:
            self._report(f"is not XML: {expat.ErrorString(error.code)}", error.lineno)
        except _UnreadableError:
            pass
        except (ValueError, LookupError) as error:
            if isinstance(error, AircraftError):
                raise
            self._report(f"is not XML in an encoding that JSBSim reads: {error}")

    def _report(self, text: str, line: int | None = None) -> None:
        at = self._parser.CurrentLineNumber if line is None else line
        self.faults.append(AirframeFault(FileLine(self.file, at), text))

    def _end_check(self, text: str) -> NoReturn:
        """Report a fault after which the file cannot be read on."""
        self._report(text)
        raise _UnreadableError

    def _doctype(self, *doctype: Any) -> None:  # noqa: ANN401 - expat's
        text = "<!DOCTYPE> and entities are not allowed (remove them)"
        if doctype[-1]:  # it declares entities
            self._end_check(text)
        self._report(text)

    def _begin(self, name: str, attributes: Mapping[str, str]) -> None:
        if len(self._open) + self._skipped >= MAX_DEPTH:
            self._end_check(f"<{_short(name)}> is deeper than {MAX_DEPTH} elements")
        if self._skipped or (self._open and self._open[-1].row.text is Text.PROSE):
            self._skipped += 1
            return
        row = self._row(name)
        if row is None:
            self._skipped += 1
            return
        line = self._parser.CurrentLineNumber
        self.parts.begin(name, FileLine(self.file, line))
        self._open.append(_Open(name, row, line, attributes.get("unit", "").strip()))
        if row.text is not Text.PROSE:
            self._check_attributes(name, row, attributes)

    def _row(self, name: str) -> Element | None:
        """Return the row of an element that begins; None, and a fault: it is not known there."""
        if not self._open:
            if name not in self.kinds:
                self._end_check(_wrong_kind(name, self.kinds))
            self.kind = name
            return GRAMMAR[name]
        parent = self._open[-1]
        row = row_of(parent.row, name)
        if row is None:
            remedy = _REMEDIES.get(name)
            if remedy is None:
                known = [each.partition(":")[0] for each in parent.row.children.split()]
                near = difflib.get_close_matches(name, known, n=1)
                remedy = (
                    "is not known in "
                    + f"<{parent.name}> ("
                    + (f"did you mean <{near[0]}>?)" if near else "remove it)")
                )
            self._report(f"<{_short(name)}> {remedy}")
        return row

    def _check_attributes(self, name: str, row: Element, attributes: Mapping[str, str]) -> None:
        known = (*row.attributes.split(), *_WITHOUT_MEANING, *(("file",) if row.folders else ()))
        for key in attributes:
            if key in known or (len(self._open) == 1 and key.startswith(_NAMESPACES)):
                continue
            some = ", ".join(each for each in known if each not in _WITHOUT_MEANING)
            have = f"it may have {some}, name and unit" if some else "it may have name and unit"
            self._report(f"the attribute {_short(key)} of <{name}> is not known ({have})")
        if "file" in attributes and row.folders:
            kinds = tuple(row.kinds.split()) or (name,)
            use = _Use(self._found(attributes["file"], row.folders), kinds)
            self.uses.append(use)
            self.parts.add_files(use.files)
        if row.name is not Name.WORD and attributes.get("name"):
            given = attributes["name"]
            pattern = "{}" if row.name is Name.CONTROL and "/" in given else row.name.value
            self._check_property(pattern.format(given))
        if "copyto" in attributes:
            self._check_property(attributes["copyto"])

    def _end(self, name: str) -> None:
        if self._skipped:
            self._skipped -= 1
            return
        ended = self._open.pop()
        self.parts.end(name)
        if ended.row.text is Text.WRITES:
            for line in filter(None, map(str.strip, "".join(ended.text).splitlines())):
                self._check_property(line, ended.line)
        elif ended.row.text in (Text.POSITIVE, Text.NOT_NEGATIVE):
            value = self._number(ended)
            if value is not None:
                self._open[-1].values[ended.name] = value, ended.unit, ended.line
        elif ended.name == "tank":
            self._check_tank(ended)

    def _add_text(self, text: str) -> None:
        if not self._skipped and self._open and self._open[-1].row.text in _CHECKED:
            self._open[-1].text.append(text)

    def _check_property(self, name: str, line: int | None = None) -> None:
        if problem := property_problem(name):
            self._report(f"the property {_short(name)} {problem}", line)

    def _number(self, element: _Open) -> float | None:
        """Return the number of an element; None, and a fault: it is none, or beyond its limit."""
        text, limit = "".join(element.text).strip(), element.row.text
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        good = value > 0.0 if limit is Text.POSITIVE else value >= 0.0
        if not (good and math.isfinite(value) and "_" not in text):
            self._report(
                f"<{element.name}> is {_short(text)}; it must be {limit.value}", element.line
            )
            return None
        return value

    def _check_tank(self, tank: _Open) -> None:
        """Check that the contents are not more than the capacity."""
        if not {"capacity", "contents"} <= tank.values.keys():
            return
        (room, room_unit, _), (fuel, unit, line) = tank.values["capacity"], tank.values["contents"]
        if room_unit in _POUNDS and unit in _POUNDS:
            fuel *= _POUNDS[unit] / _POUNDS[room_unit]
        elif unit != room_unit:
            return
        if fuel > room * (1.0 + 1e-9):
            self._report(
                f"<contents> of the tank is {fuel:g}, and its <capacity> is {room:g} {room_unit} "
                "(write 0 to the capacity)".replace("  ", " "),
                line,
            )

    def _found(self, name: str, folders: tuple[str, ...]) -> list[Path]:
        """Return all files that JSBSim may read for a name."""
        own = folders[0] == "."
        places = f"the aircraft's folder {folders[0]}"
        if own:
            places = " or its ".join(("the aircraft's folder", *folders[1:2]))
        if not FILE_NAME.fullmatch(name):
            self._report(
                f"file={_short(name)!r} leaves the aircraft's folder, or is no plain name (write "
                f"the name of a file in {places})"
            )
            return []
        path = name if name.endswith(".xml") else f"{name}.xml"
        candidates = [self.home / each / path for each in folders]
        files = [each.resolve() for each in candidates if each.is_file()]
        if not files:
            beside = not own and (self.home / path).is_file()
            what = "move the one beside the aircraft there" if beside else "add it"
            self._report(f"file={name!r}: there is no {path} in {places} ({what})")
        inside = [each for each in files if each.is_relative_to(self.home)]
        if len(inside) < len(files):
            self._report(f"file={name!r} is a link out of the aircraft's folder (put a copy there)")
        return inside


def _wrong_kind(kind: str, kinds: tuple[str, ...]) -> str:
    wanted = " or ".join(f"<{each}>" for each in kinds)
    return f"begins with <{_short(kind)}> (write {wanted})"


def _short(text: str) -> str:
    """Return a text from a file in one line of at most 60 characters, as errors have it."""
    text = "".join(each if each.isprintable() else "?" for each in " ".join(text.split()))
    return text if len(text) <= 60 else f"{text[:60]}…"


def _content(file: Path) -> bytes:
    return read_bounded(file, MAX_BYTES, error=AircraftError)


def _check_cycles(named: Mapping[Path, set[Path]], main: Path) -> None:
    """Reject files that name one another in a cycle, which JSBSim would follow endlessly."""
    finished: set[Path] = set()
    chain: list[tuple[Path, Iterator[Path]]] = [(main, iter(named[main]))]
    while chain:
        file, rest = chain[-1]
        following = next(rest, None)
        if following is None:
            finished.add(file)
            chain.pop()
        elif any(following == above for above, _ in chain):
            raise AircraftError(f"{file}: names {following}, which names it too (remove one)")
        elif following not in finished:
            chain.append((following, iter(named[following])))
