"""The door to pymavlink: MAVLink frames packed and found.

The only module that imports pymavlink, and only when something is first packed or found: its
tables take tens of ms. They say what every message of ArduPilot's dialect holds and looks like;
frames are put together and taken apart here (https://mavlink.io/en/guide/serialization.html).
Nothing but these tables is imported: they are generated and under the MIT licence, while other
modules of pymavlink are under the GPL or import one that is.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, SupportsFloat, SupportsIndex

from testbed.errors import InputError
from testbed.mavlink.signing import SIGNATURE, Seal, Signing, Verdict

V1, V2 = 0xFE, 0xFD  # what a frame begins with
_HEAD = struct.Struct("<BBBBBBBHB")
_HEAD_V1, _HEAD_V2, _CHECKSUM = 6, 10, 2
_SIGNED = 0x01  # the only flag a receiver must understand
_MARKER = re.compile(b"[\xfd\xfe]")

Value = float | int | str | tuple[float | int, ...]
Given = SupportsFloat | SupportsIndex | str | bytes | Iterable[SupportsFloat | SupportsIndex]


class MavlinkError(InputError):
    """A message that cannot be packed as it was given, or a log that cannot be read."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message and who sent it. Text has lost its padding; arrays are tuples."""

    name: str
    system: int
    component: int
    sequence: int
    fields: Mapping[str, Value]

    def number(self, name: str) -> float:
        """A field that is one number."""
        value = self.fields[name]
        if isinstance(value, str | tuple):
            raise TypeError(f"{self.name}.{name} is not one number")
        return float(value)


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    kind: str  # of one element, as in the definition: uint16_t
    count: int  # of elements; 0: not an array
    needed: bool  # not an extension
    code: str  # for struct

    @property
    def text(self) -> bool:
        return self.kind == "char"


@dataclass(frozen=True, slots=True)
class _Layout:
    """How one message looks on the wire; fields in the order of the wire."""

    number: int
    name: str
    seed: bytes  # of the checksum, so that two definitions of a message do not mix
    struct: struct.Struct
    fields: tuple[_Field, ...]
    names: tuple[str, ...]
    plain: bool  # neither text nor arrays

    def unpack(self, payload: bytes) -> dict[str, Value]:
        size = self.struct.size
        values = self.struct.unpack(payload[:size].ljust(size, b"\0"))
        if self.plain:
            return dict(zip(self.names, values, strict=True))
        found: dict[str, Value] = {}
        at = 0
        for field in self.fields:
            if field.text:
                found[field.name] = values[at].split(b"\0", 1)[0].decode("utf-8", "replace")
                at += 1
            elif field.count:
                found[field.name] = values[at : at + field.count]
                at += field.count
            else:
                found[field.name] = values[at]
                at += 1
        return found

    def pack(self, given: Mapping[str, Given]) -> bytes:
        if self.plain and given.keys() == set(self.names):
            with contextlib.suppress(struct.error, OverflowError, TypeError):
                return self.struct.pack(*[given[name] for name in self.names])
        unknown = given.keys() - set(self.names)
        missing = [f.name for f in self.fields if f.needed and f.name not in given]
        if unknown or missing:
            wrong = [f"no field {', '.join(sorted(unknown))}"] if unknown else []
            wrong += [f"{', '.join(missing)} missing"] if missing else []
            raise MavlinkError(
                f"{self.name}: {' and '.join(wrong)}; its fields are {', '.join(self.names)}"
            )
        return b"".join(self._bytes(field, given.get(field.name)) for field in self.fields)

    def _bytes(self, field: _Field, value: Given | None) -> bytes:
        """One field; None, an extension that was not given, is zero."""
        code = f"<{field.code}"
        if value is None:
            return bytes(struct.calcsize(code))
        try:
            if field.text and isinstance(value, str | bytes):
                text = value.encode() if isinstance(value, str) else value
                if len(text) > struct.calcsize(code):
                    raise ValueError(f"{len(text)} bytes")
                return struct.pack(code, text)
            if field.count and isinstance(value, Iterable):
                elements = list(value)
                if field.kind == "uint8_t":
                    elements += [0] * (field.count - len(elements))
                return struct.pack(code, *elements)
            return struct.pack(code, value)
        except (struct.error, OverflowError, TypeError, ValueError) as error:
            kind = f"{field.kind}[{field.count}]" if field.count else field.kind
            raise MavlinkError(
                f"{self.name}.{field.name}: {value!r:.60} does not fit {kind}: {error}"
            ) from error


class Codec:
    """One end of a link: packs what it says and finds the messages in what it hears.

    Args:
        system: who speaks, 1 to 255.
        component: which part of it, 1 to 255; 1 is an autopilot.
        signing: sign what is packed, and refuse what is not signed with the same key or was heard
            before; None: pack without signatures and believe everything.

    Attributes:
        skipped: bytes that belonged to no frame.
        refused: frames that were not believed, by the reason.

    Raises:
        InputError: no such system or component.
    """

    def __init__(self, system: int, component: int, signing: Signing | None = None) -> None:
        """An end that has said and heard nothing."""
        for name, number in (("system", system), ("component", component)):
            if not 1 <= number <= 255:
                raise MavlinkError(f"MAVLink {name}: {number}; give a number of 1 to 255")
        self.skipped = 0
        self.refused: Counter[Verdict] = Counter()
        self._system, self._component = system, component
        self._seal = Seal(signing) if signing else None
        self._sequence = 0
        self._rest = b""

    def pack(self, name: str, /, **fields: Given) -> bytes:
        """The frame of a message. Extensions that are not given are zero.

        Args:
            name: of the message, as HEARTBEAT.
            fields: as in the definition; arrays in full, text and bytes also shorter.

        Raises:
            MavlinkError: there is no such message or field, one is missing, or does not fit.
        """
        layout = _named(name)
        payload = layout.pack(fields).rstrip(b"\0") or b"\0"
        flags = _SIGNED if self._seal else 0
        frame = _HEAD.pack(
            V2,
            len(payload),
            flags,
            0,
            self._sequence,
            self._system,
            self._component,
            layout.number & 0xFFFF,
            layout.number >> 16,
        )
        frame += payload
        frame += struct.pack("<H", _checksum(frame[1:] + layout.seed))
        self._sequence = (self._sequence + 1) % 256
        return self._seal.sign(frame) if self._seal else frame

    def feed(self, data: bytes, *, whole: bool = False) -> list[Message]:
        """The messages in what was heard, whatever is between them.

        Nothing is too broken to be fed, and a broken frame costs none of those after it: where
        the checksum is wrong, the search goes on one byte later. Both versions of MAVLink are
        understood.

        Args:
            data: what was heard.
            whole: `data` is a datagram: what is cut off at its end never goes on. Otherwise the
                end waits for the next call, and so do frames that seem to lie inside one that is
                not finished, for at most 280 bytes.
        """
        data = self._rest + data
        found = []
        at = 0
        while (marker := _MARKER.search(data, at)) is not None:
            self.skipped += marker.start() - at
            at = marker.start()
            length = frame_length(data, at)
            if at + length > len(data) and not whole:
                break
            frame = data[at : at + length]
            message = decode(frame)
            if message is None:
                self.skipped += 1
                at += 1
                continue
            at += length
            verdict = self._seal.judge(frame, _signed(frame)) if self._seal else "good"
            if verdict == "good":
                found.append(message)
            else:
                self.refused[verdict] += 1
        else:
            self.skipped += len(data) - at
            at = len(data)
        self._rest = data[at:]
        return found

    def advance(self, time: int) -> None:
        """Let the clock of the signatures reach this `signing_time`."""
        if self._seal:
            self._seal.advance(time)


def decode(frame: bytes) -> Message | None:
    """What one whole frame says, signed by anyone; None: it is none, or not in the dialect."""
    if len(frame) < _HEAD_V1 + _CHECKSUM or frame_length(frame, 0) != len(frame):
        return None
    old = frame[0] == V1
    number = frame[5] if old else int.from_bytes(frame[7:10], "little")
    if number not in _classes() or (not old and frame[2] & ~_SIGNED):
        return None
    layout = _layout(number)
    end = len(frame) - _CHECKSUM - (SIGNATURE if _signed(frame) else 0)
    if int.from_bytes(frame[end : end + 2], "little") != _checksum(frame[1:end] + layout.seed):
        return None
    sequence, system, component = frame[2:5] if old else frame[4:7]
    fields = layout.unpack(frame[_HEAD_V1 if old else _HEAD_V2 : end])
    return Message(layout.name, system, component, sequence, fields)


def frame_length(data: bytes, at: int) -> int:
    """How long the frame here says it is, bytes; a cut head says too little. 0: there is none."""
    head = {V1: _HEAD_V1, V2: _HEAD_V2}.get(data[at])
    if head is None:
        return 0
    body = data[at + 1] if at + 1 < len(data) else 0
    return head + body + _CHECKSUM + (SIGNATURE if _signed(data[at : at + 3]) else 0)


def _signed(frame: bytes) -> bool:
    return frame[0] == V2 and len(frame) > 2 and bool(frame[2] & _SIGNED)


def number(name: str) -> int:
    """A constant of the dialect, as MAV_TYPE_FIXED_WING.

    Raises:
        MavlinkError: there is none.
    """
    value = getattr(_dialect(), name, None)
    if not isinstance(value, int):
        raise MavlinkError(f"{name}: no constant of ArduPilot's dialect of MAVLink")
    return value


@functools.cache
def _dialect() -> ModuleType:
    from pymavlink.dialects.v20 import ardupilotmega

    dialect: ModuleType = ardupilotmega
    return dialect


def _checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX."""
    return _crc()(data)


@functools.cache
def _crc() -> Callable[[bytes], int]:
    kind = _dialect().x25crc
    return lambda data: kind(data).crc


@functools.cache
def _classes() -> dict[int, Any]:
    """What pymavlink has of every message, by number."""
    return dict(_dialect().mavlink_map)


@functools.cache
def _numbers() -> dict[str, int]:
    return {kind.msgname: number for number, kind in _classes().items()}


@functools.lru_cache(maxsize=None)
def _layout(number: int) -> _Layout:
    kind = _classes()[number]
    extensions = kind.fieldnames[len(kind.fieldnames) - len(kind.__init__.__defaults__ or ()) :]
    codes = re.findall(r"\d*[a-zA-Z]", kind.unpacker.format)
    fields = tuple(
        _Field(
            name, kind.fieldtypes[kind.fieldnames.index(name)], count, name not in extensions, code
        )
        for name, count, code in zip(
            kind.ordered_fieldnames, kind.array_lengths, codes, strict=True
        )
    )
    return _Layout(
        number,
        kind.msgname,
        bytes([kind.crc_extra]),
        struct.Struct("<" + "".join(codes)),
        fields,
        tuple(kind.ordered_fieldnames),
        not any(field.text or field.count for field in fields),
    )


def _named(name: str) -> _Layout:
    number = _numbers().get(name)
    if number is None:
        near = difflib.get_close_matches(name.upper(), _numbers(), n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise MavlinkError(f"{name}: no message of ArduPilot's dialect of MAVLink{hint}")
    return _layout(number)
