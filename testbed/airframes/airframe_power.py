"""Which engines and thrusters are flown: those of an aeroplane, as far as JSBSim's files say so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from testbed.airframes.airframe_grammar import ENGINES, THRUSTERS

_FLIES = "the testbed flies aeroplanes with engines on propellers, with jets, or without an engine"
_REFUSED = {
    "rocket_engine": (
        "has a rocket engine, which has no throttle setting at which a flight is steady; " + _FLIES
    ),
    "nozzle": "has the nozzle of a rocket engine; " + _FLIES,
    "rotor": "has a rotor: it is no aeroplane; " + _FLIES,
    "gas_cell": "is carried by a gas cell: it is no aeroplane; " + _FLIES,
}
_SHAFT = {
    "electric_engine": "an electric engine",
    "brushless_dc_motor": "an electric motor",
    "piston_engine": "a piston engine",
    "turboprop_engine": "a turboprop",
}
_KINDS = frozenset((*ENGINES.split(), *THRUSTERS.split(), "gas_cell"))


class FileLine(NamedTuple):
    """A line of a file."""

    file: Path
    line: int

    def __str__(self) -> str:
        """Return the place as errors have it."""
        return f"{self.file}:{self.line}"


class AirframeFault(NamedTuple):
    """A fault of an aircraft."""

    place: FileLine
    text: str


@dataclass(slots=True)
class _Mount:
    """An engine of the aircraft, with its thruster."""

    place: FileLine
    kinds: list[str] = field(default_factory=list)  # of its elements in the same file
    files: list[Path] = field(default_factory=list)  # that describe them


class PowerParts:
    """Engines, thrusters and gas cells in a file.

    Attributes:
        kinds: names and places of the elements that describe them.
        mounts: engines of the aircraft that are placed in the file.
        files: that the file names, outside its mounts.
    """

    def __init__(self) -> None:
        self.kinds: list[tuple[str, FileLine]] = []
        self.mounts: list[_Mount] = []
        self.files: list[Path] = []
        self._mount: _Mount | None = None  # of the open <engine>

    def begin(self, name: str, place: FileLine) -> None:
        """Take an element that begins."""
        if name == "engine":
            self._mount = _Mount(place)
            self.mounts.append(self._mount)
        elif name in _KINDS:
            self.kinds.append((name, place))
            if self._mount:
                self._mount.kinds.append(name)

    def end(self, name: str) -> None:
        """Take the end of an element."""
        if name == "engine":
            self._mount = None

    def add_files(self, files: Iterable[Path]) -> None:
        """Take the files that an element names."""
        (self._mount or self).files.extend(files)


def kind_faults(name: str, parts: Mapping[Path, PowerParts]) -> list[AirframeFault]:
    """Return why an aircraft is no aeroplane, by the parts of its files: one fault of each kind."""
    found = dict[str, AirframeFault]()
    for each in parts.values():
        for kind, place in each.kinds:
            if kind in _REFUSED:
                found.setdefault(kind, AirframeFault(place, f"{name} {_REFUSED[kind]}"))
    if "rocket_engine" in found:
        found.pop("nozzle", None)  # its own
    return list(found.values())


def pair_faults(name: str, parts: Mapping[Path, PowerParts]) -> list[AirframeFault]:
    """Return which engines of an aircraft do not fit their thrusters.

    Args:
        name: of the aircraft.
        parts: of each of its files.
    """
    faults = list[AirframeFault]()
    for each in parts.values():
        for mount in each.mounts:
            kinds = {*mount.kinds, *_kinds_of(mount.files, parts)}
            if text := _wrong_pair(kinds):
                faults.append(AirframeFault(mount.place, f"{name} has {text}"))
    return faults


def _kinds_of(files: Iterable[Path], parts: Mapping[Path, PowerParts]) -> Iterator[str]:
    """Yield the kinds of parts in some files and those that they name."""
    waiting, seen = list(files), set[Path]()
    while waiting:
        file = waiting.pop()
        if file in seen or file not in parts:
            continue
        seen.add(file)
        yield from (kind for kind, _ in parts[file].kinds)
        waiting += parts[file].files


def _wrong_pair(kinds: set[str]) -> str | None:
    """Return what is wrong with an engine on its thruster, or None."""
    if "turbine_engine" in kinds and "propeller" in kinds:
        return (
            "a turbine on a propeller: JSBSim takes the turbine's thrust in pounds for the power "
            "of the shaft in ft lb/s (write <turboprop_engine>, or <direct> in place of the "
            "propeller)"
        )
    for engine, words in _SHAFT.items():
        if engine in kinds and "direct" in kinds:
            return (
                f"{words} on a <direct> thruster: JSBSim takes the power of the shaft in ft lb/s "
                "for a thrust in pounds (write <propeller>)"
            )
    return None
