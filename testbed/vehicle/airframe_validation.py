"""Checks of an aircraft's XML files before JSBSim reads them in this process.

JSBSim opens sockets, writes files, loads other aircraft and expands entities where files say so. An
aircraft has elements, files and properties of `airframe_grammar` only; all else is refused.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.parsers import expat

from testbed.core.input_files import read_bounded
from testbed.vehicle.airframe_grammar import (
    ENGINES,
    GRAMMAR,
    MAIN,
    THRUSTERS,
    Element,
    Name,
    Text,
    property_problem,
    row_of,
)
from testbed.vehicle.forked_trial import ForkedResult, Work, run_forked
from testbed.vehicle.jsbsim_model import AircraftError

MAX_BYTES = 10_000_000  # of a file
MAX_FILES = 100
MAX_DEPTH = 50  # of nested elements
_FILE_NAME = re.compile(r"(?!\.)[\w .,()+-]+(/(?!\.)[\w .,()+-]+)*", re.ASCII)
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

# What the testbed flies: one engine and its thruster, of these kinds. The others have the words for
# the error.
_FLOWN_ENGINES = ("electric_engine", "brushless_dc_motor")
_FLOWN_THRUSTERS = ("propeller",)
_WORDS = {
    "piston_engine": "a piston engine",
    "turbine_engine": "a turbine",
    "turboprop_engine": "a turboprop",
    "rocket_engine": "a rocket",
    "nozzle": "a nozzle",
    "rotor": "a rotor",
    "direct": "a direct thrust",
}
_FLIES = "the testbed flies aircraft with one electric engine and its propeller"
_REMEDY = "write <electric_engine> or <brushless_dc_motor>, and <propeller>"


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


class FileLine(NamedTuple):
    """A line of a file."""

    file: Path
    line: int

    def __str__(self) -> str:
        """Return the place as errors have it."""
        return f"{self.file}:{self.line}"


def check_airframe(folder: Path) -> None:
    """Check the aircraft of a folder and every file that it names.

    Raises:
        AircraftError: there is no aircraft, or a file is not XML, exceeds the limits on size and
            depth, is outside the folder, or has something that is not in `GRAMMAR`, or a mass or
            size that no aircraft has; or the engine is of a kind that the testbed does not fly.
            The message has file and line.
    """
    main = _main_file(folder)
    _check_power(folder.name, check_files(main), main)


def check_files(main: Path) -> dict[Path, FileCheck]:
    """Check the main file of an aircraft, and all that it names, by the rules of `GRAMMAR`.

    Raises:
        AircraftError: as `check_airframe`, but for the engine.
    """
    home = main.parent.resolve()
    checked: dict[Path, FileCheck] = {}
    waiting: list[tuple[Path, tuple[str, ...]]] = [(main.resolve(), (MAIN,))]
    while waiting:
        file, kinds = waiting.pop()
        if file not in checked:
            check = checked[file] = FileCheck(file, home, kinds)
            waiting += [(each, use.kinds) for use in check.uses for each in use.files]
        elif checked[file].kind not in kinds:
            raise AircraftError(_wrong_kind(FileLine(file, 1), checked[file].kind, kinds))
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


def _check_power(name: str, checked: Mapping[Path, FileCheck], main: Path) -> None:
    """Check that the testbed can fly the engine and the thruster."""
    found = {
        group: [(each, place) for check in checked.values() for each, place in check.parts(group)]
        for group in ("engine", "thruster")
    }
    for group, kinds in (("engine", _FLOWN_ENGINES), ("thruster", _FLOWN_THRUSTERS)):
        for kind, place in found[group]:
            if kind not in kinds:
                raise AircraftError(f"{place}: {name} has {_WORDS[kind]}; {_FLIES} ({_REMEDY})")
    mounted = [place for check in checked.values() for place in check.mounted]
    if len(mounted) != 1:
        place = mounted[1] if mounted else FileLine(main, 1)
        count = f"{len(mounted)} engines" if mounted else "no engine"
        raise AircraftError(f"{place}: {name} has {count}; {_FLIES}")


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


class FileCheck:
    """Check a file with JSBSim's parser.

    Attributes:
        kind: the first element.
        uses: files that it names.
        mounted: places of engines on the aircraft.
    """

    def __init__(self, file: Path, home: Path, kinds: tuple[str, ...]) -> None:
        """Check one file, of an aircraft in the folder `home`.

        Raises:
            AircraftError: as `check_files`.
        """
        self.file, self.home, self.kinds = file, home, kinds
        self.kind = ""
        self.uses: list[_Use] = []
        self.mounted: list[FileLine] = []
        self._parts: list[tuple[str, FileLine]] = []
        self._open: list[_Open] = []
        self._prose = 0  # depth below the first element of prose
        self._parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._add_text
        try:
            parser.Parse(_content(file), True)
        except expat.ExpatError as error:
            self._fail(f"is not XML: {expat.ErrorString(error.code)}", error.lineno)
        except AircraftError:
            raise
        except (ValueError, LookupError) as error:
            self._fail(f"is not XML in an encoding that JSBSim reads: {error}")

    def parts(self, group: str) -> Iterable[tuple[str, FileLine]]:
        """Return kind and place of each engine or thruster that is described in the file."""
        kinds = (ENGINES if group == "engine" else THRUSTERS).split()
        return [each for each in self._parts if each[0] in kinds]

    def _fail(self, text: str, line: int | None = None) -> NoReturn:
        at = self._parser.CurrentLineNumber if line is None else line
        raise AircraftError(f"{FileLine(self.file, at)}: {text}") from None

    def _doctype(self, *_: Any) -> None:  # noqa: ANN401 - expat's
        self._fail("<!DOCTYPE> and entities are not allowed (remove them)")

    def _begin(self, name: str, attributes: Mapping[str, str]) -> None:
        if len(self._open) + self._prose >= MAX_DEPTH:
            self._fail(f"<{_short(name)}> is deeper than {MAX_DEPTH} elements")
        if self._prose or (self._open and self._open[-1].row.text is Text.PROSE):
            self._prose += 1
            return
        row = self._row(name)
        line = self._parser.CurrentLineNumber
        self._open.append(_Open(name, row, line, attributes.get("unit", "").strip()))
        if row.text is not Text.PROSE:
            self._check_attributes(name, row, attributes)
        if name == "engine":
            self.mounted.append(FileLine(self.file, line))
        if name in _WORDS or name in _FLOWN_ENGINES or name in _FLOWN_THRUSTERS:
            self._parts.append((name, FileLine(self.file, line)))

    def _row(self, name: str) -> Element:
        if not self._open:
            self.kind = name
            if name not in self.kinds:
                self._fail(_wrong_kind(None, name, self.kinds))
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
            self._fail(f"<{_short(name)}> {remedy}")
        return row

    def _check_attributes(self, name: str, row: Element, attributes: Mapping[str, str]) -> None:
        known = (*row.attributes.split(), *_WITHOUT_MEANING, *(("file",) if row.folders else ()))
        for key in attributes:
            if key in known or (len(self._open) == 1 and key.startswith(_NAMESPACES)):
                continue
            some = ", ".join(each for each in known if each not in _WITHOUT_MEANING)
            have = f"it may have {some}, name and unit" if some else "it may have name and unit"
            self._fail(f"the attribute {_short(key)} of <{name}> is not known ({have})")
        if "file" in attributes:
            kinds = tuple(row.kinds.split()) or (name,)
            self.uses.append(_Use(self._found(attributes["file"], row.folders), kinds))
        if row.name is not Name.WORD and attributes.get("name"):
            given = attributes["name"]
            pattern = "{}" if row.name is Name.CONTROL and "/" in given else row.name.value
            self._check_property(pattern.format(given))
        if "copyto" in attributes:
            self._check_property(attributes["copyto"])

    def _end(self, _: str) -> None:
        if self._prose:
            self._prose -= 1
            return
        ended = self._open.pop()
        if ended.row.text is Text.WRITES:
            for line in filter(None, map(str.strip, "".join(ended.text).splitlines())):
                self._check_property(line, ended.line)
        elif ended.row.text in (Text.POSITIVE, Text.NOT_NEGATIVE):
            value = self._number(ended)
            self._open[-1].values[ended.name] = value, ended.unit, ended.line
        elif ended.name == "tank":
            self._check_tank(ended)

    def _add_text(self, text: str) -> None:
        if not self._prose and self._open and self._open[-1].row.text in _CHECKED:
            self._open[-1].text.append(text)

    def _check_property(self, name: str, line: int | None = None) -> None:
        if problem := property_problem(name):
            self._fail(f"the property {_short(name)} {problem}", line)

    def _number(self, element: _Open) -> float:
        text, limit = "".join(element.text).strip(), element.row.text
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        good = value > 0.0 if limit is Text.POSITIVE else value >= 0.0
        if not (good and math.isfinite(value) and "_" not in text):
            self._fail(
                f"<{element.name}> is {_short(text)}; it must be {limit.value}", element.line
            )
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
            self._fail(
                f"<contents> of the tank is {fuel:g}, and its <capacity> is {room:g} {room_unit} "
                "(write 0 to the capacity)".replace("  ", " "),
                line,
            )

    def _found(self, name: str, folders: tuple[str, ...]) -> list[Path]:
        """Return all files that JSBSim may read for a name."""
        places = " or its ".join(("the aircraft's folder", *folders[1:2]))
        if not _FILE_NAME.fullmatch(name):
            self._fail(
                f"file={_short(name)!r} leaves the aircraft's folder, or is no plain name (write "
                f"the name of a file in {places})"
            )
        path = name if name.endswith(".xml") else f"{name}.xml"
        candidates = [self.home / each / path for each in folders]
        files = [each.resolve() for each in candidates if each.is_file()]
        if not files:
            self._fail(f"file={name!r}: there is no {path} in {places} (add it)")
        if not all(each.is_relative_to(self.home) for each in files):
            self._fail(f"file={name!r} is a link out of the aircraft's folder (put a copy there)")
        return files


def _wrong_kind(place: FileLine | None, kind: str, kinds: tuple[str, ...]) -> str:
    wanted = " or ".join(f"<{each}>" for each in kinds)
    text = f"begins with <{_short(kind)}> (write {wanted})"
    return f"{place}: {text}" if place else text


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
