"""Checks of an aircraft's XML files before JSBSim reads them in this process.

JSBSim opens sockets for `<input>`, writes files for `<output>` and for a property, follows `file=`
to any path, and expands entities without limit. An aircraft that uses any of these is rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

from testbed.core.input_files import read_bounded
from testbed.vehicle.forked_trial import ForkedResult, Work, run_forked
from testbed.vehicle.jsbsim_model import AircraftError

MAX_BYTES = 10_000_000  # of a file
MAX_FILES = 100
MAX_DEPTH = 50  # of nested elements
_SUBFOLDERS = (".", "Engines", "engine", "Systems", "systems")  # searched by JSBSim
_FORBIDDEN = {
    "input": "opens a socket",
    "output": "opens a socket or writes a file; the testbed writes the log",
}
_WRITES_FILE = "write-state-file"  # a property: JSBSim writes a file when it is set


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
            depth, is outside the folder, or makes JSBSim write a file or open a socket; the message
            has file and line.
    """
    main = folder / f"{folder.name}.xml"
    if not main.is_file():
        raise AircraftError(
            f"{folder}: no {folder.name}.xml in it; an aircraft folder has a JSBSim "
            "aircraft with the name of the folder"
        )
    home = folder.resolve()
    if not main.resolve().is_relative_to(home):
        raise AircraftError(f"{main}: is a link out of {folder}; put a copy there")
    named: dict[Path, set[Path]] = {}
    waiting = [main.resolve()]
    while waiting:
        file = waiting.pop()
        if file not in named:
            named[file] = set(_FileCheck(file, home, is_main=file == main.resolve()).named)
            waiting += named[file]
        if len(named) > MAX_FILES:
            raise AircraftError(f"{main}: names more than {MAX_FILES} files")
    _check_cycles(named, main.resolve())


class _FileCheck:
    """Check a file with JSBSim's parser; `named` has the files that it names."""

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
            self.fail(f"is not XML: {expat.ErrorString(error.code)}", error.lineno)
        except AircraftError:
            raise
        except (ValueError, LookupError) as error:
            self.fail(f"is not XML in an encoding that JSBSim reads: {error}")

    def fail(self, text: str, line: int | None = None) -> NoReturn:
        at = self.parser.CurrentLineNumber if line is None else line
        raise AircraftError(f"{self.file}:{at}: {text}") from None

    def doctype(self, *_: Any) -> None:  # noqa: ANN401 - expat's
        self.fail("<!DOCTYPE> and entities are not allowed (remove them)")

    def begin(self, name: str, attributes: Mapping[str, str]) -> None:
        if not self.open and self.is_main and name != "fdm_config":
            self.fail(f"begins with <{name}>: not a JSBSim aircraft (write <fdm_config>)")
        if len(self.open) == 1 and name in _FORBIDDEN:
            self.fail(f"<{name}> {_FORBIDDEN[name]} (remove it)")
        if len(self.open) >= MAX_DEPTH:
            self.fail(f"<{name}> is deeper than {MAX_DEPTH} elements")
        self.open.append(name)
        for value in attributes.values():
            self.text(value)
        if "file" in attributes:
            self.named += self.found(attributes["file"])

    def end(self, _: str) -> None:
        self.open.pop()

    def text(self, text: str) -> None:
        if _WRITES_FILE in text:
            self.fail(f"the property simulation/{_WRITES_FILE} writes a file (remove it)")

    def found(self, name: str) -> list[Path]:
        """Return all files that JSBSim may read for a name."""
        path = Path(name)
        if not name.isprintable() or path.is_absolute() or ".." in path.parts:
            self.fail(
                f"file={name!r} leaves the aircraft's folder (write the name of a file in it, in "
                "its Engines or in its Systems)"
            )
        if path.suffix not in ("", ".xml"):
            self.fail(f"file={name!r} is not a name that ends in .xml (write one)")
        path = path.with_suffix(".xml") if path.name else path
        candidates = [self.home / each / path for each in _SUBFOLDERS]
        files = [each.resolve() for each in candidates if each.is_file()]
        if not files:
            self.fail(
                f"file={name!r}: there is no {path} in the aircraft's folder, its Engines or its "
                "Systems (add it)"
            )
        if not all(each.is_relative_to(self.home) for each in files):
            self.fail(f"file={name!r} is a link out of the aircraft's folder (put a copy there)")
        return files


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
