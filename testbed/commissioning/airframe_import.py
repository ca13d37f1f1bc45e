"""Copy a JSBSim aircraft with all files that it names into a folder of its own.

JSBSim keeps engines and systems that several aircraft share beside the folder `aircraft`; an
aircraft of the testbed has all its files in its own folder. What has no effect on a flight of the
testbed, or none that it allows, is cut out: `<output>` and `<input>` of the whole aircraft,
`<!DOCTYPE>`, attributes that JSBSim does not read, and outputs to JSBSim's own properties, by which
aircraft stop the flight after a crash. All other bytes are kept, and a cut leaves its line breaks,
so that lines have the numbers of the original.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import escape

from testbed.airframes.airframe_grammar import GRAMMAR
from testbed.airframes.airframe_scan import Cut, FileScan, NamedFile
from testbed.airframes.airframe_validation import FILE_NAME, MAX_BYTES, MAX_FILES
from testbed.airframes.powerplant import AircraftError
from testbed.core.files import write_file
from testbed.core.input_files import read_bounded

MAX_DECLARED = 40  # properties that other programs give an aircraft
_DECLARED = "declared"  # name of the <system> with properties that are missing
_FOLDER_NAME = re.compile(r"[A-Za-z0-9][\w.+-]*", re.ASCII)
_MISSING = re.compile(r"The property (\S+) does not exist")
# Where files are looked for beside the folder `aircraft`, by their folder in an aircraft.
_SHARED = {"Engines": "engine", "Systems": "systems"}


@dataclass(slots=True)
class CopiedAircraft:
    """An aircraft in its own folder.

    Attributes:
        main: the copied `NAME.xml`.
        sources: original of each copied file, by the copy.
        cuts: what is not in the copies, in the order of the files.
        declared: properties that were added, because no file has them.
    """

    main: Path
    sources: dict[Path, Path] = field(default_factory=dict)
    cuts: list[Cut] = field(default_factory=list)
    declared: list[str] = field(default_factory=list)

    def in_originals(self, text: str) -> str:
        """Return an error with the original files in place of their copies."""
        # a longer path first: one may begin another
        for copy in sorted(self.sources, key=lambda each: -len(str(each))):
            text = text.replace(str(copy), str(self.sources[copy]))
        return text


def check_folder_name(name: str) -> None:
    """Check the name of a new folder of an aircraft.

    Raises:
        AircraftError: it is no plain name.
    """
    if not _FOLDER_NAME.fullmatch(name):
        raise AircraftError(
            f"the name {name[:40]!r}: an aircraft has letters, digits and _ . + - in its name, and "
            "begins with a letter or digit (write --into and another name)"
        )


def copy_aircraft(source: Path, folder: Path, shared: Path) -> CopiedAircraft:
    """Copy an aircraft and every file that it names.

    Files are looked for in the folder of the aircraft, its `Engines` and `Systems`, then in
    `engine` and `systems` of the tree that it lies in (aircraft/NAME/NAME.xml), then in those that
    come with JSBSim.

    Args:
        source: the JSBSim file of the aircraft.
        folder: for the copy, not there yet; its last part is the aircraft's name.
        shared: folder of JSBSim's own `engine` and `systems`.

    Raises:
        AircraftError: a file is missing, is not XML or leaves its folder; all of these at once.
        OSError: the copy cannot be written.
    """
    check_folder_name(folder.name)
    source = Path(source)
    copied = CopiedAircraft(folder / f"{folder.name}.xml")
    search = _Search(source.resolve().parent, shared)
    problems: list[str] = []
    waiting = [(source, copied.main)]
    contents: dict[Path, bytes] = {}
    while waiting:
        original, copy = waiting.pop(0)
        if copy in contents:
            if copied.sources.get(copy, original) != original:
                problems.append(
                    f"{original}: the new folder has another file {copy.name} "
                    "(write another --into)"
                )
            continue
        try:
            scan = FileScan(original, is_main=copy == copied.main)
        except AircraftError as error:
            problems.append(str(error))
            contents[copy] = b""
            continue
        problems += scan.problems
        contents[copy] = scan.remaining()
        copied.sources[copy] = original
        copied.cuts += scan.cuts
        for use in scan.uses:
            try:
                found, where = search.find(use)
            except AircraftError as error:
                problems.append(str(error))
                continue
            waiting.append((found, folder / where))
        if len(contents) > MAX_FILES:
            problems.append(f"{source}: names more than {MAX_FILES} files")
            break
    if problems:
        raise AircraftError("\n".join(dict.fromkeys(problems)))
    for copy, content in contents.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        _write(copy, content)
    return copied


def declare_missing(copied: CopiedAircraft, load: Callable[[], Any]) -> None:
    """Declare properties that no file has, with the value 0, until the aircraft can be loaded.

    Aircraft of FlightGear read properties that its other parts set.

    Args:
        copied: the aircraft; `declared` is extended.
        load: loads it, and moves it.

    Raises:
        AircraftError: of `load`, if it is about something else, or after `MAX_DECLARED` names.
    """
    while True:
        try:
            load()
        except AircraftError as error:
            missing = _MISSING.search(str(error))
            if missing is None or missing[1] in copied.declared:
                raise
            if len(copied.declared) == MAX_DECLARED:
                raise AircraftError(
                    f"{copied.main}: reads more than {MAX_DECLARED} properties that no file has "
                    f"({', '.join(copied.declared[:3])}, …): a part of the aircraft is missing"
                ) from None
            declare(copied, missing[1])
        else:
            return


def declare(copied: CopiedAircraft, name: str) -> None:
    """Add a property with the value 0 to the aircraft, in the line of its first section."""
    before = _declaration(copied.declared)
    copied.declared.append(name)
    data = read_bounded(copied.main, error=AircraftError, limit=MAX_BYTES)
    at = data.index(before) if before else _first_section(copied.main, data)
    after = data[at + len(before) :]
    _write(copied.main, data[:at] + _declaration(copied.declared) + after)


def _write(file: Path, content: bytes) -> None:
    with write_file(file) as stream:
        stream.write(content)


def _declaration(names: list[str]) -> bytes:
    """Return the element that declares properties; empty without names."""
    if not names:
        return b""
    properties = "".join(f'<property value="0">{escape(name)}</property>' for name in names)
    return f'<system name="{_DECLARED}">{properties}</system>'.encode()


def _first_section(file: Path, data: bytes) -> int:
    """Return where the first section of the aircraft begins that JSBSim calculates with."""
    parser = expat.ParserCreate()
    found: list[int] = []

    def begin(name: str, _: Mapping[str, str]) -> None:
        if name == "metrics" and not found:
            found.append(parser.CurrentByteIndex)

    parser.StartElementHandler = begin
    parser.Parse(data, True)
    if not found:
        raise AircraftError(f"{file}: has no <metrics> (an aircraft has wing area, span and chord)")
    return found[0]


class _Search:
    """Where the files of an aircraft may lie."""

    def __init__(self, own: Path, shared: Path) -> None:
        """Search the aircraft's folder, the tree that it lies in, and JSBSim's own."""
        self._own = own
        self._trees = tuple(dict.fromkeys((own.parent.parent, shared.resolve())))

    def find(self, use: NamedFile) -> tuple[Path, Path]:
        """Return the file that an element names, and its path in the new folder.

        Raises:
            AircraftError: there is none, or its name leaves the folder.
        """
        if not FILE_NAME.fullmatch(use.name):
            raise AircraftError(
                f"{use.place}: file={use.name[:60]!r} is no plain name (copy the file beside the "
                "aircraft, and write its name)"
            )
        path = use.name if use.name.endswith(".xml") else f"{use.name}.xml"
        for root, candidate, where in self._candidates(use.element, path):
            if candidate.is_file():
                found = candidate.resolve()
                if not found.is_relative_to(root.resolve()):
                    raise AircraftError(
                        f"{use.place}: file={use.name!r} is a link out of {root} (put a copy there)"
                    )
                return found, where
        raise AircraftError(
            f"{use.place}: file={use.name!r}: there is no {path} {self._places(use.element)}"
        )

    def _candidates(self, element: str, path: str) -> Iterator[tuple[Path, Path, Path]]:
        """Yield the root, a candidate in it, and its place in the new folder."""
        folders, kind = GRAMMAR[element].folders, _folder(element)
        # an engine beside the aircraft goes to where JSBSim looks
        beside = Path(path) if kind is None or "." in folders else Path(kind, path)
        yield self._own, self._own / path, beside
        if kind is None:
            return
        for spelling in folders:
            if spelling != ".":
                yield self._own, self._own / spelling / path, Path(kind, path)
        for tree in self._trees:
            yield tree / _SHARED[kind], tree / _SHARED[kind] / path, Path(kind, path)

    def _places(self, element: str) -> str:
        kind = _folder(element)
        if kind is None:
            return f"in {self._own}"
        shared = " or ".join(str(tree / _SHARED[kind]) for tree in self._trees)
        return f"in {self._own}, its {kind}, or {shared}"


def _folder(element: str) -> str | None:
    """Return the folder of an aircraft for the files of an element; None: the aircraft's own."""
    return next((each for each in GRAMMAR[element].folders if each != "."), None)
