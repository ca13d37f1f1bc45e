"""The XML files of an aircraft, looked at and tried out before JSBSim may read them here.

JSBSim opens sockets for `<input>`, writes files for `<output>` and for a property, follows `file=`
to anywhere, and expands entities without end. None of it is asked for by who flies an aircraft.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

from testbed.vehicle.jsbsim_model import AircraftError
from testbed.vehicle.trial import Trial, attempt

MOST_BYTES = 10_000_000  # of a file
MOST_FILES = 100
DEEPEST = 50  # elements in one another
_PLACES = (".", "Engines", "engine", "Systems", "systems")  # where JSBSim looks, in the folder
_SPEAKS = {
    "input": "opens a socket",
    "output": "opens a socket or writes a file; the testbed writes the log",
}
_WRITES = "write-state-file"  # a property: JSBSim writes a file when it is set


def explored(folder: Path, explore: Callable[[Callable[[str], None]], Any]) -> Callable[[], Any]:
    """Begin to find something out of an aircraft in a copy of this process.

    Args:
        folder: of the aircraft.
        explore: takes what is told each thing that is wrong, and answers with plain data.

    Returns:
        What waits for the answer, to be called once; it raises AircraftError with what JSBSim has
        against the aircraft.

    Raises:
        AircraftError: as `check_airframe`.
    """
    check_airframe(folder)
    return partial(_answer, folder, attempt(explore))


def _answer(folder: Path, ended: Callable[[], Trial]) -> Any:  # noqa: ANN401
    trial = ended()
    if trial.answer is not None:
        return trial.answer
    # later records repeat from afar what the first one says that has a place
    placed = [text for text in trial.said if text.startswith(f"{folder}/")]
    text = next(iter((*placed, *filter(None, (trial.error, *trial.said)))), "")
    text = text or f"JSBSim {trial.end} and does not say why"
    main = folder / f"{folder.name}.xml"
    raise AircraftError(text if text.startswith(f"{folder}/") else f"{main}: {text}")


def check_airframe(folder: Path) -> None:
    """Look at the aircraft of a folder and at every file it names.

    Raises:
        AircraftError: naming file and line, if there is no aircraft, a file is not XML, is larger
            or deeper than any aircraft, lies outside the folder, or asks JSBSim to write a file or
            to open a socket.
    """
    main = folder / f"{folder.name}.xml"
    if not main.is_file():
        raise AircraftError(
            f"{folder}: no {folder.name}.xml in it; an aircraft folder holds a JSBSim "
            f"aircraft named like the folder"
        )
    home = folder.resolve()
    if not main.resolve().is_relative_to(home):
        raise AircraftError(f"{main}: is a link out of {folder}; put a copy there")
    named: dict[Path, set[Path]] = {}
    waiting = [main.resolve()]
    while waiting:
        file = waiting.pop()
        if file not in named:
            named[file] = set(_Look(file, home, is_main=file == main.resolve()).named)
            waiting += named[file]
        if len(named) > MOST_FILES:
            raise AircraftError(f"{main}: names more than {MOST_FILES} files")
    _refuse_circles(named, main.resolve())


class _Look:
    """One file, read once by the parser that JSBSim uses, too; what it names lies in `named`."""

    def __init__(self, file: Path, home: Path, *, is_main: bool) -> None:
        self.file, self.home, self.is_main = file, home, is_main
        self.named: list[Path] = []
        self.open: list[str] = []
        self.parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self.doctype
        parser.StartElementHandler = self.begin
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.text
        try:
            parser.Parse(_content(file), True)
        except expat.ExpatError as error:
            self.refuse(f"is not XML: {expat.ErrorString(error.code)}", error.lineno)
        except AircraftError:
            raise
        except (ValueError, LookupError) as error:
            self.refuse(f"is not XML in an encoding that JSBSim reads: {error}")

    def refuse(self, text: str, line: int | None = None) -> NoReturn:
        at = self.parser.CurrentLineNumber if line is None else line
        raise AircraftError(f"{self.file}:{at}: {text}") from None

    def doctype(self, *_: Any) -> None:  # noqa: ANN401 - expat's
        self.refuse("<!DOCTYPE> and entities are not read (leave them out)")

    def begin(self, name: str, attributes: Mapping[str, str]) -> None:
        if not self.open and self.is_main and name != "fdm_config":
            self.refuse(f"begins with <{name}>: not a JSBSim aircraft (write <fdm_config>)")
        if len(self.open) == 1 and name in _SPEAKS:
            self.refuse(f"<{name}> {_SPEAKS[name]} (remove it)")
        if len(self.open) >= DEEPEST:
            self.refuse(f"<{name}> is deeper than {DEEPEST} elements")
        self.open.append(name)
        for value in attributes.values():
            self.text(value)
        if "file" in attributes:
            self.named += self.found(attributes["file"])

    def end(self, _: str) -> None:
        self.open.pop()

    def text(self, text: str) -> None:
        if _WRITES in text:
            self.refuse(f"the property simulation/{_WRITES} writes a file (leave it out)")

    def found(self, name: str) -> list[Path]:
        """All files that JSBSim may mean by a name."""
        path = Path(name)
        if not name.isprintable() or path.is_absolute() or ".." in path.parts:
            self.refuse(
                f"file={name!r} leaves the aircraft's folder (write the name of a file in it, in "
                "its Engines or in its Systems)"
            )
        if path.suffix not in ("", ".xml"):
            self.refuse(f"file={name!r} is not a name that ends in .xml (write one)")
        path = path.with_suffix(".xml") if path.name else path
        every = [self.home / place / path for place in _PLACES]
        there = [each.resolve() for each in every if each.is_file()]
        if not there:
            self.refuse(
                f"file={name!r}: there is no {path} in the aircraft's folder, its Engines or its "
                "Systems (add it)"
            )
        if not all(each.is_relative_to(self.home) for each in there):
            self.refuse(f"file={name!r} is a link out of the aircraft's folder (put a copy there)")
        return there


def _content(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise AircraftError(f"{file}: cannot be read: {error.strerror}") from error
    if len(data) > MOST_BYTES:
        raise AircraftError(f"{file}: is larger than {MOST_BYTES:,} bytes: not an aircraft")
    return data


def _refuse_circles(named: Mapping[Path, set[Path]], main: Path) -> None:
    """Refuse files that name one another in a circle, which JSBSim would follow for ever."""
    finished: set[Path] = set()
    chain: list[tuple[Path, Iterator[Path]]] = [(main, iter(named[main]))]
    while chain:
        file, rest = chain[-1]
        following = next(rest, None)
        if following is None:
            finished.add(file)
            chain.pop()
        elif any(following == above for above, _ in chain):
            raise AircraftError(f"{file}: names {following}, which names it in turn (remove one)")
        elif following not in finished:
            chain.append((following, iter(named[following])))
