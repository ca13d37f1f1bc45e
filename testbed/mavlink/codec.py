"""Pack and parse MAVLink frames of ArduPilot's dialect.

The definitions, headers and checksums are those of pymavlink's generated tables; serialization and
parsing are implemented here (https://mavlink.io/en/guide/serialization.html). This is the only
module that imports pymavlink, and only on the first use, because the tables take tens of ms to
load. Only the generated tables may be imported: they are under the MIT licence, while other modules
of pymavlink are under the GPL or import one that is. Their class MAVLink does not parse here: it
stores the time of a signature before it compares the hash, so that a forged frame shuts out later
ones of its sender.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import re
import struct
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from types import ModuleType
from typing import SupportsFloat, SupportsIndex

from testbed.core.errors import InputError, needs_extra
from testbed.mavlink.signing import SIGNATURE_BYTES, MessageSigner, Signing, Verdict

V1, V2 = 0xFE, 0xFD  # first byte of a frame
_HEAD_V1, _HEAD_V2, _CHECKSUM = 6, 10, 2
_SIGNED = 0x01  # the only incompatibility flag that is defined
_MARKER = re.compile(b"[\xfd\xfe]")

FieldValue = float | int | str | tuple[float | int, ...]
FieldInput = SupportsFloat | SupportsIndex | str | bytes | Iterable[SupportsFloat | SupportsIndex]


class MavlinkError(InputError):
    """A message that cannot be packed, or a log that cannot be read or written."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message and its sender. Texts are without padding; arrays are tuples."""

    name: str
    system: int
    component: int
    sequence: int
    fields: Mapping[str, FieldValue]
    frame: bytes = field(default=b"", compare=False, repr=False)  # that it was parsed from

    def number(self, name: str) -> float:
        """Return a field that is one number.

        Raises:
            TypeError: the field is a text or an array.
        """
        value = self.fields[name]
        if isinstance(value, str | tuple):
            raise TypeError(f"{self.name}.{name} is not one number")
        return float(value)


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    type_name: str  # of one element, as in the definition: uint16_t
    count: int  # of elements; 0: not an array
    required: bool  # not an extension
    code: str  # format for struct

    @property
    def is_text(self) -> bool:
        return self.type_name == "char"


@dataclass(frozen=True, slots=True)
class _Layout:
    """Wire layout of one message; fields in wire order."""

    number: int
    name: str
    seed: bytes  # CRC_EXTRA of the checksum, which differs between definitions of a message
    struct: struct.Struct
    fields: tuple[_Field, ...]
    names: tuple[str, ...]
    scalars_only: bool  # neither texts nor arrays

    def unpack(self, payload: bytes) -> dict[str, FieldValue]:
        size = self.struct.size
        values = self.struct.unpack(payload[:size].ljust(size, b"\0"))
        if self.scalars_only:
            return dict(zip(self.names, values, strict=True))
        found: dict[str, FieldValue] = {}
        rest = iter(values)
        for each in self.fields:
            if each.is_text:
                found[each.name] = next(rest).split(b"\0", 1)[0].decode("utf-8", "replace")
            else:
                found[each.name] = tuple(islice(rest, each.count)) if each.count else next(rest)
        return found

    def pack(self, values: Mapping[str, FieldInput]) -> bytes:
        if self.scalars_only and values.keys() == set(self.names):
            with contextlib.suppress(struct.error, OverflowError, TypeError):
                return self.struct.pack(*[values[name] for name in self.names])
        unknown = values.keys() - set(self.names)
        missing = [f.name for f in self.fields if f.required and f.name not in values]
        if unknown or missing:
            wrong = [f"no field {', '.join(sorted(unknown))}"] if unknown else []
            wrong += [f"{', '.join(missing)} missing"] if missing else []
            raise MavlinkError(
                f"{self.name}: {' and '.join(wrong)}; its fields are {', '.join(self.names)}"
            )
        return b"".join(self._bytes(field, values.get(field.name)) for field in self.fields)

    def _bytes(self, field: _Field, value: FieldInput | None) -> bytes:
        """Pack one field; None is an extension without a value and packs as zeros."""
        code = f"<{field.code}"
        if value is None:
            return bytes(struct.calcsize(code))
        try:
            if field.is_text and isinstance(value, str | bytes):
                text = value.encode() if isinstance(value, str) else value
                if len(text) > struct.calcsize(code):
                    raise ValueError(f"{len(text)} bytes")
                return struct.pack(code, text)
            if field.count and isinstance(value, Iterable):
                elements = list(value)
                if field.type_name == "uint8_t":
                    elements += [0] * (field.count - len(elements))
                return struct.pack(code, *elements)
            return struct.pack(code, value)
        except (struct.error, OverflowError, TypeError, ValueError) as error:
            kind = f"{field.type_name}[{field.count}]" if field.count else field.type_name
            raise MavlinkError(
                f"{self.name}.{field.name}: {value!r:.60} does not fit {kind}: {error}"
            ) from error


class Codec:
    """Pack outgoing and parse incoming frames at one end of a link.

    Args:
        system: id of the sending system, 1 to 255.
        component: id of its component, 1 to 255; 1 is an autopilot.
        signing: sign packed frames, and reject frames that are unsigned, signed with another key,
            received before or too old; a signer may be that of several codecs. None: pack without
            signatures and accept every frame.

    Attributes:
        skipped: bytes that belonged to no frame.
        rejected: frames that failed verification, by reason.

    Raises:
        InputError: a system or component is out of range.
    """

    def __init__(
        self, system: int, component: int, signing: Signing | MessageSigner | None = None
    ) -> None:
        """Start with sequence number 0 and an empty receive buffer."""
        for name, number in (("system", system), ("component", component)):
            if not 1 <= number <= 255:
                raise MavlinkError(f"MAVLink {name}: {number}; give a number of 1 to 255")
        self.skipped = 0
        self.rejected: Counter[Verdict] = Counter()
        self._system, self._component = system, component
        self._signer = MessageSigner(signing) if isinstance(signing, Signing) else signing
        self._sequence = 0
        self._buffer = b""

    def pack(self, name: str, /, **fields: FieldInput) -> bytes:
        """Pack a message into a frame. Omitted extension fields are zero.

        Args:
            name: of the message, e.g. HEARTBEAT.
            fields: as in the definition; texts and uint8_t arrays may be shorter than the field.

        Raises:
            MavlinkError: the message or a field is unknown, a field is missing, or a value does
                not fit.
        """
        layout = _layout_of_name(name)
        payload = layout.pack(fields).rstrip(b"\0") or b"\0"
        flags = _SIGNED if self._signer else 0
        sender = self._sequence, self._system, self._component
        header = load_dialect().MAVLink_header(layout.number, flags, 0, len(payload), *sender)
        frame: bytes = header.pack() + payload
        frame += struct.pack("<H", checksum(frame[1:] + layout.seed))
        self._sequence = (self._sequence + 1) % 256
        return self._signer.sign(frame) if self._signer else frame

    def feed(self, data: bytes, *, datagram: bool = False) -> list[Message]:
        """Parse the messages in received bytes, of MAVLink 1 and 2.

        Any bytes are accepted. A damaged frame does not affect the ones after it: after a wrong
        checksum the search continues one byte later.

        Args:
            data: received bytes.
            datagram: `data` is a datagram; an incomplete frame at its end is skipped. Otherwise
                `data` continues a stream: an incomplete frame waits for the next call, and frames
                that seem to lie inside it wait too, for at most 280 bytes.
        """
        data = self._buffer + data
        found = []
        at = 0
        while (marker := _MARKER.search(data, at)) is not None:
            self.skipped += marker.start() - at
            at = marker.start()
            length = frame_length(data, at)
            if at + length > len(data) and not datagram:
                break
            frame = data[at : at + length]
            message = decode(frame)
            if message is None:
                self.skipped += 1
                at += 1
                continue
            at += length
            verdict = self._signer.verify(frame, _signed(frame)) if self._signer else "good"
            if verdict == "good":
                found.append(message)
            else:
                self.rejected[verdict] += 1
        else:
            self.skipped += len(data) - at
            at = len(data)
        self._buffer = data[at:]
        return found


def decode(frame: bytes) -> Message | None:
    """Parse one complete frame without verifying its signature.

    Returns:
        The message; None if the frame is damaged or its message is not in the dialect.
    """
    if len(frame) < _HEAD_V1 + _CHECKSUM or frame_length(frame, 0) != len(frame):
        return None
    old = frame[0] == V1
    number = frame[5] if old else int.from_bytes(frame[7:10], "little")
    if number not in load_dialect().mavlink_map or (not old and frame[2] & ~_SIGNED):
        return None
    layout = _layout(number)
    end = len(frame) - _CHECKSUM - (SIGNATURE_BYTES if _signed(frame) else 0)
    if int.from_bytes(frame[end : end + 2], "little") != checksum(frame[1:end] + layout.seed):
        return None
    sequence, system, component = frame[2:5] if old else frame[4:7]
    fields = layout.unpack(frame[_HEAD_V1 if old else _HEAD_V2 : end])
    return Message(layout.name, system, component, sequence, fields, frame)


def frame_length(data: bytes, at: int) -> int:
    """Read the length of the frame that starts at this offset, bytes.

    Returns:
        The length; too small if the header is incomplete; 0 if no frame starts here.
    """
    head = {V1: _HEAD_V1, V2: _HEAD_V2}.get(data[at])
    if head is None:
        return 0
    body = data[at + 1] if at + 1 < len(data) else 0
    return head + body + _CHECKSUM + (SIGNATURE_BYTES if _signed(data[at : at + 3]) else 0)


def _signed(frame: bytes) -> bool:
    return frame[0] == V2 and len(frame) > 2 and bool(frame[2] & _SIGNED)


def constant(name: str) -> int:
    """Return a constant of the dialect, e.g. MAV_TYPE_FIXED_WING.

    Raises:
        MavlinkError: the dialect has no such constant.
    """
    value = getattr(load_dialect(), name, None)
    if not isinstance(value, int):
        raise MavlinkError(f"{name}: no constant of ArduPilot's dialect of MAVLink")
    return value


@functools.cache
def load_dialect() -> ModuleType:
    """Import the generated tables.

    Raises:
        MissingExtraError: pymavlink is not installed.
    """
    with needs_extra("mavlink", "MAVLink"):
        from pymavlink.dialects.v20 import ardupilotmega

    dialect: ModuleType = ardupilotmega
    return dialect


def checksum(data: bytes) -> int:
    """Compute the CRC-16/MCRF4XX."""
    found: int = load_dialect().x25crc(data).crc
    return found


@functools.cache
def _numbers_by_name() -> dict[str, int]:
    return {each.msgname: number for number, each in load_dialect().mavlink_map.items()}


@functools.lru_cache(maxsize=None)
def _layout(number: int) -> _Layout:
    definition = load_dialect().mavlink_map[number]
    required = len(definition.fieldnames) - len(definition.__init__.__defaults__ or ())
    extensions = definition.fieldnames[required:]
    types = dict(zip(definition.fieldnames, definition.fieldtypes, strict=True))
    codes = re.findall(r"\d*[a-zA-Z]", definition.unpacker.format)
    fields = tuple(
        _Field(name, types[name], count, name not in extensions, code)
        for name, count, code in zip(
            definition.ordered_fieldnames, definition.array_lengths, codes, strict=True
        )
    )
    return _Layout(
        number,
        definition.msgname,
        bytes([definition.crc_extra]),
        struct.Struct("<" + "".join(codes)),
        fields,
        tuple(definition.ordered_fieldnames),
        not any(field.is_text or field.count for field in fields),
    )


def _layout_of_name(name: str) -> _Layout:
    number = _numbers_by_name().get(name)
    if number is None:
        near = difflib.get_close_matches(name.upper(), _numbers_by_name(), n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise MavlinkError(f"{name}: no message of ArduPilot's dialect of MAVLink{hint}")
    return _layout(number)
