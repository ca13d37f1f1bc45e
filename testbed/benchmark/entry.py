"""Entries: a law, the settings that it is flown with, and the bounds in which it is tuned.

An entry is a stranger's program. Its law is the file that the command names, or a law that comes
with the testbed; the file of its settings names no path and no code.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded
from testbed.scenario import find_code
from testbed.scenario.control import BUILT_IN
from testbed.scenario.fields import Finding, Flag, Name, Number, Section, Whole, raise_findings
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import read
from testbed.tuning.tune_schema import MIN_GAINS, GainBounds

Setting = Flag | Number | Name | tuple[Number, ...]
Settings = Mapping[str, Setting]
# What an entry may set: what belongs to a law. All else is the task's.
KEYS = re.compile(
    r"controller\.(options|safety|estimators)\.[A-Za-z_][\w.]*|controller\.extrapolate_from"
    r"|formation\.(k|a|b|c|barrier\.nu|control_function\.(nu1|nu2|m))"
)
_FUNCTION = re.compile(r"[A-Za-z_]\w{0,63}", re.ASCII)
_ALLOWED = (
    "controller.options.…, controller.safety.…, controller.estimators.…, "
    "controller.extrapolate_from, formation.k, a, b, c"
)
ENTRIES = Path(__file__).parent / "entries"  # those that come with the testbed


class EntryHead(Section):
    """What an entry is called."""

    schema_: Whole = Field(alias="schema", ge=1, le=1, description="Version of the format.")
    name: Name = Field(description="Name of the entry in tables.")


class EntryFile(Section):
    """The settings of an entry."""

    entry: EntryHead
    set: Mapping[str, Setting] = Field({}, description="Keys of the scenario that the law has.")
    tune: Mapping[str, GainBounds] = Field(
        {}, description="Gains that are tuned, and between which bounds; none by default."
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        findings: list[Finding] = [
            ((section, key), f"is not of the law (write {_ALLOWED})")
            for section, keys in (("set", self.set), ("tune", self.tune))
            for key in keys
            if not KEYS.fullmatch(key)
        ]
        for key, bounds in self.tune.items():
            start = self.set.get(key) if bounds.start is None else bounds.start
            if start is None or isinstance(start, tuple | str):
                findings.append((("tune", key, "start"), "is needed (write where a search begins)"))
            elif not bounds.low <= start <= bounds.high or bounds.low == bounds.high:
                findings.append((("tune", key), f"does not have {start:g} between its bounds"))
            elif bounds.scale == "log" and not bounds.low > 0.0:
                findings.append((("tune", key, "from"), "must be above 0 for scale: log"))
        if 0 < len(self.tune) < MIN_GAINS:
            findings.append((("tune",), f"has one gain (write {MIN_GAINS} or more, or none)"))
        raise_findings(findings)
        return self


class ShippedEntry(EntryFile):
    """The same of an entry that comes with the testbed, which names its law."""

    law: str = Field(description="A law that comes with the testbed.")


@dataclass(frozen=True, slots=True)
class EntryLaw:
    """The code of an entry.

    Attributes:
        reference: of `controller.law`.
        file: whose digest is checked before it is imported; None: it is the testbed's own.
        sha256: of that file; "": none.
    """

    reference: str
    file: Path | None = None
    sha256: str = ""

    def describe(self) -> str:
        """Return file and digest as a line."""
        if self.file is None:
            return f"{self.reference}, of the testbed"
        return f"{self.file}:{self.function} SHA-256 {self.sha256}"

    @property
    def function(self) -> str:
        """The name behind the last colon; "" of a law without one."""
        return self.reference.rpartition(":")[2] if ":" in self.reference else ""

    def check(self) -> None:
        """Check that the file is what it was.

        Raises:
            InputError: it has changed.
        """
        if self.file is not None and digest_of(self.file) != self.sha256:
            raise InputError(f"{self.file}: has changed since it was read (start again)")


@dataclass(frozen=True, slots=True)
class Entry:
    """What is flown: law, settings, and what is tuned.

    Attributes:
        name: in tables.
        law: its code.
        set: settings before tuning.
        tune: bounds by key; empty: flown as it is.
    """

    name: str
    law: EntryLaw
    set: Settings
    tune: Mapping[str, GainBounds]

    @property
    def starts(self) -> tuple[float, ...]:
        """Where the search of each gain begins."""
        found = [self.set.get(k) if b.start is None else b.start for k, b in self.tune.items()]
        return tuple(float(each) for each in found if isinstance(each, int | float))

    @property
    def digest(self) -> str:
        """SHA-256 of law, settings and bounds, which decide all its numbers."""
        text = {
            "name": self.name,
            "law": [self.law.sha256 or self.law.reference, self.law.function],
            "set": dict(self.set),
            "tune": {
                key: [bounds.low, bounds.high, bounds.scale, start]
                for (key, bounds), start in zip(self.tune.items(), self.starts, strict=True)
            },
        }
        return hashlib.sha256(json.dumps(text, sort_keys=True).encode()).hexdigest()


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a law's file.

    Raises:
        InputError: it cannot be read.
    """
    return hashlib.sha256(read_bounded(path)).hexdigest()


def shipped_names() -> tuple[str, ...]:
    """Return the names of the entries that come with the testbed."""
    return tuple(sorted(path.stem for path in ENTRIES.glob("*.yaml")))


def open_law(text: str) -> EntryLaw:
    """Return the law of a word of the command, LAW.py:function.

    Raises:
        InputError: there is no such file, or the word is another.
    """
    path, colon, function = text.rpartition(":")
    if not colon or not path.endswith(".py") or not _FUNCTION.fullmatch(function):
        known = ", ".join(shipped_names())
        raise InputError(f"{text}: is no law (write LAW.py:function, or an entry: {known})")
    file = Path(path).absolute()
    return EntryLaw(f"{file}:{function}", file, digest_of(file))


def open_entries(words: Iterable[str], settings: Iterable[Path] = ()) -> list[Entry]:
    """Return the entries of the words of a command.

    Args:
        words: LAW.py:function, or names of entries that come with the testbed.
        settings: files of settings, for the laws among the words in their order.

    Raises:
        InputError: one does not exist, or two have the same name.
    """
    files, found = list(settings), list[Entry]()
    for word in words:
        if word in shipped_names():
            found.append(_open_shipped(word))
            continue
        law = open_law(word)
        if files:
            file = validate(read(files.pop(0)), EntryFile)
            found.append(Entry(file.entry.name, law, file.set, file.tune))
        else:
            found.append(Entry(law.function.strip("_") or "law", law, {}, {}))
    if files:
        raise InputError(f"--entry {files[0]}: there is no LAW.py:function for it (write one)")
    for number, each in enumerate(found):
        if each.name in [other.name for other in found[:number]]:
            raise InputError(
                f"{each.name}: is the name of two entries (write another name into the file of "
                "--entry)"
            )
    return found


def _open_shipped(name: str) -> Entry:
    file = validate(read(ENTRIES / f"{name}.yaml"), ShippedEntry)
    if file.law == BUILT_IN:
        return Entry(file.entry.name, EntryLaw(file.law), file.set, file.tune)
    path, _, _ = find_code(file.law).rpartition(":")
    found = Path(path)
    digest = digest_of(found) if found.suffix == ".py" else ""
    return Entry(file.entry.name, EntryLaw(file.law, None, digest), file.set, file.tune)
