"""The binary format of DataFlash logs: messages one after another, some of which define the others.

A message is the bytes A3 95, its type, and its fields: little-endian, without gaps. Those of type
128, FMT, say how long the messages of a type are, what they are called and which fields they hold
(https://github.com/ArduPilot/ardupilot/blob/master/libraries/AP_Logger/README.md).
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array

HEAD = b"\xa3\x95"
FMT = 0x80
_FIELDS = 3  # bytes before the fields
_DEFINITION = np.dtype(
    [("head", "S3"), ("type", "u1"), ("length", "u1"), ("name", "S4"), ("format", "S16")]
    + [("labels", "S64")]
)
_NAME, _FORMAT, _LABEL = (re.compile(p) for p in (rb"\w{1,4}", rb"[a-zA-Z]{1,16}", rb"\w+"))
_CODES = {
    "a": ("V64", None),
    "b": ("<i1", 1.0),
    "B": ("<u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "n": ("S4", None),
    "N": ("S16", None),
    "Z": ("S64", None),
    "c": ("<i2", 100.0),
    "C": ("<u2", 100.0),
    "e": ("<i4", 100.0),
    "E": ("<u4", 100.0),
    "L": ("<i4", 1e7),
    "M": ("<u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}  # what a field is, and by what it is divided; None: it is text, or an array, which is passed over
_SIZES = {code: np.dtype(kind).itemsize for code, (kind, _) in _CODES.items()}

_Places = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Table:
    """The messages of one name in the order of the file, M of them, and the fields asked for.

    Attributes:
        numbers: (M,) each; hundredths have become units, and L degrees.
        texts: M each, without their padding.
    """

    numbers: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Contents:
    """What was asked for of a log.

    Attributes:
        tables: by name; those without a message are left out.
        unreadable: names that were asked for, and whose definition is damaged.
        skipped: bytes that belong to no message: noise, messages damaged or not defined, and the
            message before each of these, of which it cannot be known.
        cut: bytes of a last message that has no end.
    """

    tables: Mapping[str, Table]
    unreadable: tuple[str, ...]
    skipped: int
    cut: int


@dataclass(frozen=True, slots=True)
class _Definition:
    name: str
    length: int  # of a message, bytes
    fields: tuple[tuple[str, int, str], ...] | None  # label, offset, code; None: not known


def read_messages(data: bytes, wanted: Mapping[str, Collection[str]]) -> Contents:
    """The messages of these names, with these fields of them; nothing else is decoded.

    A message counts where another begins at its end, or the file ends there. Definitions serve
    the whole file, wherever they stand.

    Args:
        data: a whole file, however damaged.
        wanted: fields by the name of the message; those the log does not define are left out.
    """
    octets = np.frombuffer(data, np.uint8)
    begins = _heads(octets)
    kinds = octets[begins + 2]
    definitions = _definitions(octets, begins, kinds)
    lengths = np.zeros(256, np.int64)
    lengths[FMT] = _DEFINITION.itemsize
    for kind, definition in definitions.items():
        lengths[kind] = definition.length
    ends = begins + lengths[kinds]
    taken = _chain(begins, ends, _joined(octets, ends) & (lengths[kinds] > 0), len(data))
    end = int(ends[taken].max(initial=0))
    cut = _cut(data, end, lengths)
    kinds = kinds[taken]
    counts = np.bincount(kinds, minlength=256)
    begins = begins[taken]
    tables, unreadable = {}, []
    for name, labels in wanted.items():
        named = [kind for kind, definition in definitions.items() if definition.name == name]
        known = [kind for kind in named if definitions[kind].fields is not None]
        if named and not known:
            unreadable.append(name)
        for kind in sorted(known, key=lambda kind: counts[kind]):
            if counts[kind]:  # damage can give one name to two types: the commoner is the last
                tables[name] = _table(octets, begins[kinds == kind], definitions[kind], labels)
    skipped = len(data) - int(np.sum(lengths * counts)) - cut
    return Contents(tables, tuple(unreadable), skipped, cut)


def _heads(octets: NDArray[np.uint8]) -> _Places:
    """Where a message may begin."""
    first = np.flatnonzero(octets[:-2] == HEAD[0])
    both: _Places = first[octets[first + 1] == HEAD[1]]
    return both


def _joined(octets: NDArray[np.uint8], ends: _Places) -> NDArray[np.bool_]:
    """Whether a message may begin at each of these places, or the file ends there."""
    joined = ends <= len(octets)
    for k, octet in enumerate(HEAD):
        beyond = ends + k >= len(octets)
        joined &= beyond | (octets[np.where(beyond, 0, ends + k)] == octet)
    return joined


def _chain(
    begins: _Places, ends: _Places, whole: NDArray[np.bool_], stop: int
) -> NDArray[np.bool_]:
    """Which of the whole messages to take, where one seems to lie inside another.

    It is none, unless both end together: then the outer one has lost bytes, and its length reaches
    as far as a message behind it.
    """
    taken = whole.copy()
    holding = np.flatnonzero(whole & (ends > np.append(begins[1:], stop)))
    for k, beyond in zip(holding, np.searchsorted(begins, ends[holding]), strict=True):
        inside = slice(k + 1, beyond)
        if taken[k] and (whole[inside] & (ends[inside] == ends[k])).any():
            taken[k] = False
        elif taken[k]:
            taken[inside] = False
    return taken


def _cut(data: bytes, end: int, lengths: NDArray[np.int64]) -> int:
    """How many bytes the file holds of a message that begins here and does not end."""
    rest = len(data) - end
    if not rest or not HEAD.startswith(data[end : end + 2]):
        return 0
    return rest if rest < _FIELDS or lengths[data[end + 2]] > rest else 0


def _definitions(
    octets: NDArray[np.uint8], begins: _Places, kinds: NDArray[np.uint8]
) -> dict[int, _Definition]:
    """Of every type the definition under which most of its messages end where others begin.

    One that is damaged may speak of another's type, or its length and its fields may disagree.
    """
    found: defaultdict[int, Counter[_Definition]] = defaultdict(Counter)
    where = begins[(kinds == FMT) & (begins + _DEFINITION.itemsize <= len(octets))]
    for row in _gathered(octets, where, _DEFINITION).tolist():
        found[row[1]].update(_readings(*row[2:]))
    found.pop(FMT, None)

    def best(kind: int, readings: Counter[_Definition]) -> _Definition:
        places = begins[kinds == kind]
        joins = {
            length: np.count_nonzero(_joined(octets, places + length))
            for length in {reading.length for reading in readings}
        }
        return max(readings, key=lambda reading: (joins[reading.length], readings[reading]))

    return {
        kind: next(iter(readings)) if len(readings) == 1 else best(kind, readings)
        for kind, readings in found.items()
        if readings
    }


def _readings(length: int, name: bytes, form: bytes, labels: bytes) -> list[_Definition]:
    """What a definition may mean: none if it is noise, two if its length or format is damaged."""
    name, form, labels = (text.split(b"\0", 1)[0] for text in (name, form, labels))
    if not _NAME.fullmatch(name) or not _FORMAT.fullmatch(form):
        return []
    called = name.decode()
    codes = form.decode()
    if not set(codes) <= _CODES.keys():
        return [_Definition(called, length, None)] if length > _FIELDS else []
    sizes = [_SIZES[code] for code in codes]
    offsets = [_FIELDS + sum(sizes[:k]) for k in range(len(sizes))]
    size = offsets[-1] + sizes[-1]
    split = labels.split(b",")
    fields = None
    if len(split) == len(codes) and all(_LABEL.fullmatch(label) for label in split):
        fields = tuple(zip((label.decode() for label in split), offsets, codes, strict=True))
    readings = [_Definition(called, size, fields)]
    if _FIELDS < length != size:
        readings.append(_Definition(called, length, None))
    return readings


def _table(
    octets: NDArray[np.uint8], where: _Places, definition: _Definition, labels: Collection[str]
) -> Table:
    fields = {
        label: (offset, *_CODES[code])
        for label, offset, code in definition.fields or ()
        if label in labels and code != "a"
    }
    layout = np.dtype(
        {
            "names": list(fields),
            "formats": [kind for _, kind, _ in fields.values()],
            "offsets": [offset for offset, _, _ in fields.values()],
            "itemsize": definition.length,
        }
    )
    rows = _gathered(octets, where, layout)
    numbers: dict[str, Array] = {}
    texts = {}
    for label, (_, _, divisor) in fields.items():
        if divisor is None:
            texts[label] = tuple(
                text.split(b"\0", 1)[0].decode("utf-8", "replace") for text in rows[label].tolist()
            )
        else:
            with np.errstate(invalid="ignore"):  # damage can make a NaN that signals
                numbers[label] = rows[label].astype(np.float64) / divisor
    return Table(numbers, texts)


def _gathered(octets: NDArray[np.uint8], where: _Places, layout: np.dtype[Any]) -> NDArray[Any]:
    """A record of this layout from each of these places, none of which is too near the end."""
    if not len(where):
        return np.empty(0, layout)
    records = len(octets) - layout.itemsize + 1  # one begins at every byte
    return np.ndarray((records,), layout, octets, strides=(1,))[where]
