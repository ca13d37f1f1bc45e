"""Read topics of ULog files, the .ulg files that PX4 writes on board, by pyulog.

A message has a header, 16 bits of the length of its payload and a character of its type; a data
message belongs to a topic, whose fields another message defines. Source:
https://docs.px4.io/main/en/dev_log/ulog_file_format.html.

pyulog trusts the file: one message can define a topic of billions of fields, and damaged lengths
make it read parts of a file again and again. It is given the messages of the requested topics only,
with checked definitions.
"""

from __future__ import annotations

import io
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.errors import describe_error, needs_extra, raise_memory_shortage
from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, read_bounded
from testbed.core.records import Array
from testbed.mavlink.codec import MavlinkError

SIGNATURE = b"ULog\x01\x12\x35"  # first bytes of a log
TIME = "timestamp"  # field of every topic, µs since boot
_HEADER = 16  # bytes of signature, version and time of the start
_HEAD = struct.Struct("<HB")  # size of the payload, type
_TYPES = frozenset(b"BFIMPQARDLCSO")
_ADDED, _DATA, _FORMAT, _INFO, _PARAM, _DROPOUT, _FLAG_BITS = b"ADFIPOB"
_MIN_PAYLOAD = 2  # bytes, of every type
_SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"  # a message that PX4 writes now and then
_FLAGS = struct.Struct("<8s8s3Q")
_APPENDED = 1  # of the incompatible flags: data are appended behind the offsets
_ADD = struct.Struct("<BH")  # instance and number of a topic; its name follows
_INTEGERS = b"int8_t uint8_t int16_t uint16_t int32_t uint32_t int64_t uint64_t"
_PLAIN = frozenset((*_INTEGERS.split(), b"float", b"double", b"bool", b"char"))
_DEFINITION = re.compile(rb"([\w-]{1,100}):(.*)", re.DOTALL)
_FIELD = re.compile(rb"(\w{1,40})(?:\[(\d{1,4})\])? (\w{1,100})")
_MAX_FIELDS = 1000  # of a topic, arrays counted by their elements; PX4's have up to some 100
_MAX_FORMATS = 5000  # of a log; PX4 has some 250


@dataclass(frozen=True, slots=True)
class UlogContents:
    """The requested topics of a log.

    Attributes:
        topics: by name; fields (M,) by name, `TIME` in s among them, in file order.
        params: latest value of the requested parameters.
        system: name of the firmware; "": not known.
        notes: about damage, dropouts and instances that were left out.
        unreadable: requested topics whose definition is damaged.
    """

    topics: Mapping[str, Mapping[str, Array]]
    params: Mapping[str, float]
    system: str
    notes: tuple[str, ...]
    unreadable: tuple[str, ...]


@dataclass(slots=True)
class _Scan:
    """What the messages of a log say, before they are decoded."""

    formats: dict[bytes, bytes] = field(default_factory=dict)  # payload by topic
    added: dict[int, tuple[bytes, int]] = field(default_factory=dict)  # topic, instance by number
    data: dict[int, bytearray] = field(default_factory=dict)  # messages of requested topics
    counts: Counter[int] = field(default_factory=Counter)  # messages by number
    params: bytearray = field(default_factory=bytearray)  # messages of requested parameters
    system: str = ""
    dropouts_ms: list[int] = field(default_factory=lambda: [0, 0])  # count, duration
    damaged: int = 0  # bytes
    cut: int = 0  # bytes of an incomplete last message


def read_topics(
    path: Path, wanted: Mapping[str, Collection[str]], params: Collection[str]
) -> UlogContents:
    """Read the requested topics and parameters, of a topic the lowest instance.

    Args:
        path: the log.
        wanted: fields by topic; undefined fields are omitted. An element of an array is `q[0]`.
        params: names.

    Raises:
        MissingExtraError: pyulog is not installed.
        MavlinkError: the file cannot be read, is no ULog, or cannot be decoded.
    """
    data = read_bounded(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError)
    if len(data) < _HEADER or not data.startswith(SIGNATURE):
        raise MavlinkError(f"{path}: no ULog: its header is cut off; download it again")
    scan = _scan(path, data, {name.encode() for name in wanted}, {name.encode() for name in params})
    chosen, notes = _choose_instances(scan)
    readable = {n: name for n, name in chosen.items() if _is_readable(scan.formats.get(name, b""))}
    decoded = _decode(path, data[:_HEADER], scan, readable)
    topics = {}
    for each in decoded.data_list:
        time = 1e-6 * each.data[TIME].astype(np.float64)
        fields = {name: each.data[name] for name in wanted[each.name] if name in each.data}
        with np.errstate(invalid="ignore"):  # damage may make a signalling NaN
            topics[each.name] = {TIME: time} | {n: v.astype(np.float64) for n, v in fields.items()}
        if others := scan.counts[each.msg_id] - len(time):
            notes.append(f"{each.name}: {others} messages of another length were left out")
    values = decoded.initial_parameters.items()
    return UlogContents(
        topics,
        {name: float(value) for name, value in values if isinstance(value, int | float)},
        scan.system,
        (*_damage_notes(scan), *notes),
        tuple(sorted({name.decode() for name in chosen.values()} - topics.keys())),
    )


def _scan(path: Path, data: bytes, wanted: Collection[bytes], params: Collection[bytes]) -> _Scan:
    """Sort the messages of a log by what they are for.

    Raises:
        MavlinkError: its flags say that it cannot be read, or it defines too many topics.
    """
    scan = _Scan()
    for begin, stop in _parts(path, data):
        for kind, start, end in _messages(data, begin, stop, scan):
            payload = start + _HEAD.size
            if kind == _DATA:
                number = data[payload] | data[payload + 1] << 8
                scan.counts[number] += 1
                if number in scan.data:
                    scan.data[number] += data[start:end]
                elif number not in scan.added:
                    scan.damaged += end - start
            elif kind == _FORMAT:
                if found := _DEFINITION.fullmatch(data, payload, end):
                    scan.formats.setdefault(found[1], data[payload:end])
                if len(scan.formats) > _MAX_FORMATS:
                    raise MavlinkError(
                        f"{path}: defines more than {_MAX_FORMATS:,} topics; give a log of PX4"
                    )
            elif kind == _ADDED and end - payload > _ADD.size:
                instance, number = _ADD.unpack_from(data, payload)
                name = data[payload + _ADD.size : end]
                if number not in scan.added:
                    scan.added[number] = name, instance
                    if name in wanted:
                        scan.data[number] = bytearray()
            elif kind == _PARAM:
                number_type, name, value = _key(data[payload:end])
                if name in params and number_type in (b"int32_t", b"float") and len(value) == 4:
                    scan.params += data[start:end]
            elif kind == _INFO and _key(data[payload:end])[1] == b"sys_name":
                scan.system = _key(data[payload:end])[2][:40].decode("utf-8", "replace")
            elif kind == _DROPOUT:
                scan.dropouts_ms[0] += 1
                scan.dropouts_ms[1] += data[payload] | data[payload + 1] << 8
    return scan


def _parts(path: Path, data: bytes) -> list[tuple[int, int]]:
    """Return the parts of a log in which messages follow each other, begin and end.

    Data may be appended to a log, behind a last message that was cut off.

    Raises:
        MavlinkError: the flags of the log say that it has to be read in another way.
    """
    offsets: list[int] = []
    size, kind = _HEAD.unpack_from(data.ljust(_HEADER + _HEAD.size, b"\0"), _HEADER)
    first = _HEADER + _HEAD.size
    if kind == _FLAG_BITS and size >= _FLAGS.size and first + size <= len(data):
        _, flags, *offsets = _FLAGS.unpack_from(data, first)
        if flags[0] & ~_APPENDED or any(flags[1:]):
            raise MavlinkError(
                f"{path}: a ULog with flags of a newer format ({flags.hex()}); give a log of PX4 "
                "up to 1.16"
            )
        if not flags[0]:
            offsets = []
    ends = sorted({each for each in offsets if first < each < len(data)})
    return list(zip([_HEADER, *ends], [*ends, len(data)], strict=True))


def _messages(data: bytes, begin: int, stop: int, scan: _Scan) -> Iterator[tuple[int, int, int]]:
    """Yield type, begin and end of the messages between two offsets.

    A message is valid if another one of a known type, or the end, follows it. After damage the next
    one is a message of synchronisation. Bytes that are left out are counted.
    """
    at = begin
    while at < stop:
        end = stop + 1  # a header that is cut off
        if at + _HEAD.size <= stop:
            end = at + _HEAD.size + (data[at] | data[at + 1] << 8)
        followed = end <= stop and (end + 2 >= stop or data[end + 2] in _TYPES)
        if followed and end - at >= _HEAD.size + _MIN_PAYLOAD:
            yield data[at + 2], at, end
            at = end
            continue
        following = data.find(_SYNC, at + 1, stop)
        if following < 0 and end > stop:
            scan.cut += stop - at
            return
        following = stop if following < 0 else following
        scan.damaged += following - at
        at = following


def _key(payload: bytes) -> tuple[bytes, bytes, bytes]:
    """Return type, name and value of a parameter or information; empty: it is damaged."""
    length = payload[0] + 1
    kind, _, name = payload[1:length].partition(b" ")
    return kind, name, payload[length:]


def _is_readable(definition: bytes) -> bool:
    """Check that a topic has a time, and not too many plain fields with different names."""
    _, _, text = definition.partition(b":")
    fields = [_FIELD.fullmatch(each) for each in text.split(b";") if each]
    if not all(fields) or not fields:
        return False
    found = [each.groups() for each in fields if each]
    size = sum(int(count or 1) for _, count, _ in found)
    return (
        len({name for _, _, name in found}) == len(found)
        and size <= _MAX_FIELDS
        and all(kind in _PLAIN for kind, _, _ in found)
        and (b"uint64_t", None, TIME.encode()) in found
    )


def _choose_instances(scan: _Scan) -> tuple[dict[int, bytes], list[str]]:
    """Return the topics to read by number, and notes on other instances of them."""
    of_name: dict[bytes, list[tuple[int, int]]] = {}
    for number, messages in scan.data.items():
        if messages:
            name, instance = scan.added[number]
            of_name.setdefault(name, []).append((instance, number))
    notes = []
    for name, found in of_name.items():
        (first, _), *others = sorted(found)
        if others:
            listed = ", ".join(
                f"{scan.counts[number]} of {instance}" for instance, number in others
            )
            notes.append(f"{name.decode()}: instance {first} is used; left out: {listed}")
    return {min(found)[1]: name for name, found in of_name.items()}, notes


def _decode(path: Path, header: bytes, scan: _Scan, readable: Mapping[int, bytes]) -> Any:  # noqa: ANN401
    """Return pyulog's reading of these topics.

    Raises:
        MissingExtraError: pyulog is not installed.
        MavlinkError: pyulog raises an error.
    """
    with needs_extra("px4", "PX4's logs"):
        from pyulog import ULog

    log = bytearray(header)
    for name in readable.values():
        log += _message(_FORMAT, scan.formats[name])
    log += scan.params
    for number, name in readable.items():
        log += _message(_ADDED, _ADD.pack(0, number) + name)
    for number in readable:
        log += scan.data.pop(number)
    try:
        with redirect_stdout(io.StringIO()):  # pyulog prints its warnings
            return ULog(io.BytesIO(log))
    except Exception as error:
        raise_memory_shortage(error)
        reason = " ".join(describe_error(error).split())
        raise MavlinkError(
            f"{path}: pyulog cannot decode it: {reason}; download the log again"
        ) from error


def _message(kind: int, payload: bytes) -> bytes:
    return _HEAD.pack(len(payload), kind) + payload


def _damage_notes(scan: _Scan) -> Iterable[str]:
    if scan.damaged:
        yield f"{scan.damaged} bytes are damaged and were left out"
    if scan.cut:
        yield f"the last message is cut off after {scan.cut} bytes"
    count, duration_ms = scan.dropouts_ms
    if count:
        number = f"{count} dropout{'s' * (count != 1)}"
        yield f"{number} of the logger, {1e-3 * duration_ms:g} s in all: messages are missing there"
