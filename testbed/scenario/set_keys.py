"""Keys that the user has set, and those among them that no part of the flight reads.

`note_set_keys` keeps which keys come from the scenario's own file and from settings, with their
places; keys of files that it extends are none. `recorded_reads` notes what the builders of the
flight read; `unused_keys` compares the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from testbed.core.reads import Reads
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.control import BUILT_IN
from testbed.scenario.fields import Section
from testbed.scenario.pattern import is_pattern_key
from testbed.scenario.problems import FilePosition, Problem
from testbed.scenario.sections import Limits, Rates, Sections
from testbed.scenario.yaml_io import Node, walk

Keys = tuple[str, ...]
# The files, names and exit codes of every run have these, or no run at all.
_OF_EVERY_RUN: tuple[Keys, ...] = (
    ("expect",),
    ("log",),
    ("limits", "on_violation"),
    ("controller", "companion", "flight"),  # of the same scenario on aircraft
    *(
        ("scenario", key)
        for key in (
            *("schema", "name", "question", "expectation", "published"),
            *("duration_s", "seed", "windows", "begin"),
        )
    ),
)
_TAGS = ("kind", "example")  # fields of a section that its class stands for
_PRESET = "preset"


@dataclass(frozen=True, slots=True)
class SetKey:
    """A key that the user has set.

    Args:
        path: from the top of the scenario, indices of lists as texts.
        place: where it is set.
        group: equal for the keys that one line or setting stands for.
        by_setting: whether it is a setting, not a line of the file.
    """

    path: Keys
    place: FilePosition
    group: object
    by_setting: bool


@dataclass(frozen=True, slots=True, eq=False)
class SetKeys:
    """All keys that the user has set. It does not decide whether two scenarios are equal.

    Args:
        keys: in the order of the scenario.
        uncut: the scenario before faults were left out that begin after its flight; None: it has
            all. A key that acts with such a fault is none without effect.
    """

    keys: tuple[SetKey, ...] = ()
    uncut: Sections | None = None

    def __eq__(self, other: object) -> bool:
        """Return that they are equal: the same scenario may come from other files."""
        return isinstance(other, SetKeys)

    def __hash__(self) -> int:
        """Return what is equal for equal ones."""
        return 0

    def without_faults(self, dropped: Mapping[Keys, Sequence[int]], uncut: Sections) -> SetKeys:
        """Return the keys where some faults are dropped, by the path of their list."""
        kept = []
        for each in self.keys:
            for at, indices in dropped.items():
                if each.path[: len(at)] == at and len(each.path) > len(at):
                    index = int(each.path[len(at)])
                    if index in indices:
                        break
                    index -= sum(one < index for one in indices)
                    rest = each.path[len(at) + 1 :]
                    kept.append(replace(each, path=(*at, str(index), *rest)))
                    break
            else:
                kept.append(each)
        if self.uncut is None and any(dropped.values()):
            return SetKeys(tuple(kept), uncut)
        return SetKeys(tuple(kept), self.uncut)


@dataclass(frozen=True, slots=True)
class UnusedKey:
    """A key that is set, and that no part of the flight reads."""

    key: SetKey
    reason: str

    @property
    def problem(self) -> Problem:
        """Its place, and what to write instead."""
        return Problem(self.key.place, f"has no effect: {self.reason}", self.key.path)


def find_set_keys(tree: Node, own: Node, settings: Sequence[Any], *, in_library: bool) -> SetKeys:
    """Return the keys that the user has set.

    Args:
        tree: with all files merged, settings applied, and patterns expanded.
        own: tree of the scenario's own file, merged with those that it extends.
        settings: of `load.Setting`.
        in_library: the own file comes with the testbed.
    """
    lengths = {
        each.place.source: len(each.keys) + (is_pattern_key(each.keys) and len(each.keys) > 1)
        for each in settings
    }
    source = own.place.source
    from_file = [] if _is_resolved(own) else [source]
    if settings and in_library:
        from_file = []  # what a setting puts out of action is no mistake of that file
    found = []
    for path, node in _leaves(tree):
        place = node.place
        if place.source in lengths:
            group: object = (place.source, path[lengths[place.source] :])
            found.append(SetKey(path, place, group, by_setting=True))
        elif place.source in from_file and node.folder != Path():  # patterns generate others
            found.append(SetKey(path, place, place, by_setting=False))
    return SetKeys(tuple(found))


def _is_resolved(tree: Node) -> bool:
    """Return whether a file has every key, as `scenario.resolved.yaml` of a run."""

    def has(path: Keys, model: type[Section]) -> bool:
        node, _, missing = walk(tree, path)
        return (
            not missing
            and isinstance(node.value, dict)
            and model.model_fields.keys() <= set(node.value)
        )

    return has((), Sections) and has(("rates",), Rates) and has(("limits",), Limits)


def _leaves(node: Node, path: Keys = ()) -> Iterator[tuple[Keys, Node]]:
    """Yield scalars, and lists without maps, that are not null."""
    if isinstance(node.value, dict):
        for name, child in node.value.items():
            yield from _leaves(child, (*path, name))
    elif isinstance(node.value, tuple) and _has_map(node):
        for index, child in enumerate(node.value):
            yield from _leaves(child, (*path, str(index)))
    elif node.value is not None and node.value != ():
        yield path, node


def _has_map(node: Node) -> bool:
    if isinstance(node.value, tuple):
        return any(map(_has_map, node.value))
    return isinstance(node.value, dict)


@contextmanager
def recorded_reads(scenario: Section, classes: Sequence[type] = ()) -> Iterator[Reads]:
    """Note which keys of a scenario this thread reads in the block.

    Args:
        scenario: with its sections.
        classes: of further objects that can be registered.
    """
    reads = Reads(ignored=("testbed.scenario.", "pydantic"))
    register_section(reads, scenario, [()])
    with reads.active((Section, *classes)):
        yield reads


def register_section(
    reads: Reads, section: Section, paths: Sequence[Keys], also: Sequence[Keys] = ()
) -> None:
    """Name the keys that a section and those in it stand for.

    Args:
        reads: that notes them.
        section: of a scenario, or of a file that it names.
        paths: of the section.
        also: further keys that are read with each of its fields.
    """
    fields: dict[str, list[Keys]] = {}
    for name, field in type(section).model_fields.items():
        value = section.__dict__[name]
        below = [(*path, field.alias or name) for path in paths]
        parts = list(_sections_in(value, below))
        for part, at in parts:
            register_section(reads, part, at, also)
        if parts:  # its class is known, and nothing else of it
            tagged = ((part, at, tag) for part, at in parts for tag in _TAGS)
            fields[name] = [
                (*path, tag)
                for part, at, tag in tagged
                if tag in type(part).model_fields
                for path in at
            ]
        else:
            fields[name] = [*below, *also]
    reads.register(section, fields)


def read_all(section: Section) -> None:
    """Read all fields of a section, of which some are used in flight only."""
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, Section):
            read_all(value)


def _sections_in(value: object, paths: Sequence[Keys]) -> Iterator[tuple[Section, list[Keys]]]:
    """Yield the sections in a value, with their paths."""
    if isinstance(value, Section):
        yield value, list(paths)
    elif isinstance(value, Mapping):
        for name, each in value.items():
            yield from _sections_in(each, [(*path, str(name)) for path in paths])
    elif isinstance(value, tuple):
        for index, each in enumerate(value):
            yield from _sections_in(each, [(*path, str(index)) for path in paths])


def unused_keys(scenario: Sections, keys_set: SetKeys, reads: Reads) -> list[UnusedKey]:
    """Return the keys that the user has set and that nothing has read, in their order."""
    read = {tuple(map(str, path)) for path in reads.found}
    above = {path[:length] for path in read for length in range(len(path))}
    groups: dict[object, list[SetKey]] = {}
    for key in keys_set.keys:
        groups.setdefault(key.group, []).append(key)
    found = []
    for keys in groups.values():
        if not any(_is_read(key.path, read, above) for key in keys):
            found.append(UnusedKey(keys[0], explain_unused(scenario, keys[0].path)))
    return found


class KeyUse:
    """Which keys have an effect in some of several flights, as of a study or a batch.

    A key that has none in any flight that sets it is an error: it can never act. One that has
    some is worth a warning, and so is a key of a file that settings put out of action.
    """

    def __init__(self) -> None:
        self._used: set[tuple[bool, Keys]] = set()
        self._unused: dict[tuple[bool, Keys], UnusedKey] = {}
        self._free: set[tuple[bool, Keys]] = set()  # of a file that is flown without settings

    def add(self, keys: SetKeys, unused: Sequence[UnusedKey]) -> None:
        """Add a flight with the keys that it sets, and those without effect."""
        without = {each.key.group for each in unused}
        by_setting = any(each.by_setting for each in keys.keys)
        for key in keys.keys:
            name = key.by_setting, key.path
            if key.group not in without:
                self._used.add(name)
            if not by_setting:
                self._free.add(name)
        for each in unused:
            self._unused.setdefault((each.key.by_setting, each.key.path), each)

    def is_new(self, keys: SetKeys) -> bool:
        """Return whether a flight sets keys that are not known to have an effect."""
        return not {(each.by_setting, each.path) for each in keys.keys} <= self._used

    @property
    def refused(self) -> list[UnusedKey]:
        """Keys that never act."""
        return [each for name, each in self._unused.items() if self._never(name)]

    @property
    def warned(self) -> list[UnusedKey]:
        """Keys that act in other flights only, or that settings put out of action."""
        return [each for name, each in self._unused.items() if not self._never(name)]

    def _never(self, name: tuple[bool, Keys]) -> bool:
        return name not in self._used and (name[0] or name in self._free)


def _is_read(path: Keys, read: set[Keys], above: set[Keys]) -> bool:
    """Return whether a key is read, or what is below it, or the list or map that it is in."""
    if path[-1] == _PRESET:
        path = path[:-1]
    if any(path[: len(each)] == each for each in _OF_EVERY_RUN):
        return True
    return path in above or any(path[: length + 1] in read for length in range(len(path)))


def explain_unused(scenario: Sections, path: Keys) -> str:
    """Say why a key has no effect in a flight, and what to write."""
    section, law = path[0], scenario.controller.law
    aircraft: AircraftSection | None = scenario.leader if section == "leader" else None
    if section == "fleet" and len(path) > 1 and path[1].isdigit():
        aircraft = scenario.fleet[int(path[1])]
    if aircraft is not None:
        if section == "leader" and scenario.leader.path.kind != "mission":
            kind = scenario.leader.path.kind
            return (
                f"a leader with a path of kind {kind} repeats that path, and does not use it "
                "(leave it out, or write a path of kind: mission)"
            )
        if aircraft.vehicle == "unicycle":
            return (
                f"{aircraft.name} is an ideal vehicle, which has no part that uses it (leave it "
                "out, or write vehicle: jsbsim)"
            )
        if "sensors" in path:
            return (
                f"no sensor of {aircraft.name} uses it in this setting (leave it out, or describe "
                "the sensor or error that it belongs to)"
            )
    if section in ("controller", "formation") and law != BUILT_IN:
        name = law.rpartition("/")[2]
        return (
            f"controller.law is {name}, and neither it nor what flies its commands uses this key "
            "(leave it out, or write law: hbh23)"
        )
    if section in ("controller", "formation") and all(
        each.vehicle == "unicycle" for each in scenario.fleet
    ):
        return (
            "all followers are ideal vehicles, which have no part that uses it (leave it out, or "
            "write vehicle: jsbsim)"
        )
    if path[:2] == ("air", "wind"):
        return "no wind blows (leave it out, or write air.wind.speed_mps above 0)"
    if path[:2] == ("air", "turbulence"):
        return f"air.turbulence.model is {scenario.air.turbulence.model} (leave it out)"
    return "no part of this flight uses it (leave it out)"
