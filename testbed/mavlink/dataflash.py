"""Read DataFlash logs of ArduPlane, the .bin files that it writes on board.

Messages and units: https://ardupilot.org/plane/docs/logmessages.html.

A message consists of the bytes A3 95, its type, and its fields, little-endian and without gaps.
Messages of type 128, FMT, define length, name and fields of the other types
(https://github.com/ArduPilot/ardupilot/blob/master/libraries/AP_Logger/README.md).
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, read_bounded
from testbed.core.records import Array
from testbed.mavlink.codec import MavlinkError
from testbed.mavlink.flight_log import (
    RAD_PER_DEG,
    ColumnSource,
    FlightLog,
    MessageTable,
    ModeInterval,
    field_source,
    increasing,
    transformed_source,
    true_airspeed_source,
)
from testbed.mavlink.servo_outputs import (
    SERVO_COLUMNS,
    demand_source,
    output_source,
    throttle_output_source,
)

HEAD = b"\xa3\x95"
FMT = 0x80
_FIELDS = 3  # offset of the fields, bytes
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
}  # type of a field and its divisor; None: a text, or an array, which is skipped
_SIZES = {code: np.dtype(kind).itemsize for code, (kind, _) in _CODES.items()}

_Offsets = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Table:
    """The M messages of one name, with the requested fields, in file order.

    Attributes:
        numbers: (M,) each, in units instead of hundredths, and degrees for L.
        texts: M each, without padding.
    """

    numbers: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Contents:
    """The requested messages of a log.

    Attributes:
        tables: by name, without names that have no messages.
        unreadable: requested names whose definition is damaged.
        skipped: bytes outside of messages: noise, damaged or undefined messages, and the message
            before each of these, whose end cannot be verified.
        cut: bytes of an incomplete last message.
    """

    tables: Mapping[str, Table]
    unreadable: tuple[str, ...]
    skipped: int
    cut: int


@dataclass(frozen=True, slots=True)
class _Definition:
    name: str
    length: int  # of a message, bytes
    fields: tuple[tuple[str, int, str], ...] | None  # label, offset, code; None: unknown


def read_messages(data: bytes, wanted: Mapping[str, Collection[str]]) -> Contents:
    """Read the requested messages and fields.

    A message is valid if another one, or the end of the file, follows it. Definitions apply to
    the whole file, wherever they are.

    Args:
        data: a complete file, which may be damaged.
        wanted: fields by message name; undefined fields are omitted.
    """
    octets = np.frombuffer(data, np.uint8)
    starts = _headers(octets)
    types = octets[starts + 2]
    definitions = _definitions(octets, starts, types)
    lengths = np.zeros(256, np.int64)
    lengths[FMT] = _DEFINITION.itemsize
    for number, definition in definitions.items():
        lengths[number] = definition.length
    ends = starts + lengths[types]
    candidates = _is_boundary(octets, ends) & (lengths[types] > 0)
    valid = _remove_nested(starts, ends, candidates, len(data))
    end = int(ends[valid].max(initial=0))
    cut = _cut_bytes(data, end, lengths)
    types = types[valid]
    counts = np.bincount(types, minlength=256)
    starts = starts[valid]
    tables, unreadable = {}, []
    for name, labels in wanted.items():
        named = [number for number, definition in definitions.items() if definition.name == name]
        known = [number for number in named if definitions[number].fields is not None]
        if named and not known:
            unreadable.append(name)
        for number in sorted(known, key=lambda number: counts[number]):
            if counts[number]:  # damage may give a name to two types: the more frequent is last
                where = starts[types == number]
                tables[name] = _table(octets, where, definitions[number], labels)
    skipped = len(data) - int(np.sum(lengths * counts)) - cut
    return Contents(tables, tuple(unreadable), skipped, cut)


def _headers(octets: NDArray[np.uint8]) -> _Offsets:
    """Find all offsets at which a message may start."""
    first = np.flatnonzero(octets[:-2] == HEAD[0])
    both: _Offsets = first[octets[first + 1] == HEAD[1]]
    return both


def _is_boundary(octets: NDArray[np.uint8], offsets: _Offsets) -> NDArray[np.bool_]:
    """Check at each offset whether a message may start there, or the file ends."""
    boundary = offsets <= len(octets)
    for k, octet in enumerate(HEAD):
        beyond = offsets + k >= len(octets)
        boundary &= beyond | (octets[np.where(beyond, 0, offsets + k)] == octet)
    return boundary


def _remove_nested(
    starts: _Offsets, ends: _Offsets, candidates: NDArray[np.bool_], stop: int
) -> NDArray[np.bool_]:
    """Decide between candidates of which one lies inside another.

    The inner one is invalid, unless both have the same end: then the outer one has lost bytes, and
    its length reaches the end of a later message.
    """
    valid = candidates.copy()
    outer = np.flatnonzero(candidates & (ends > np.append(starts[1:], stop)))
    for k, beyond in zip(outer, np.searchsorted(starts, ends[outer]), strict=True):
        inside = slice(k + 1, beyond)
        if valid[k] and (candidates[inside] & (ends[inside] == ends[k])).any():
            valid[k] = False
        elif valid[k]:
            valid[inside] = False
    return valid


def _cut_bytes(data: bytes, end: int, lengths: NDArray[np.int64]) -> int:
    """Count the bytes of an incomplete message at this offset; 0: none."""
    rest = len(data) - end
    if not rest or not HEAD.startswith(data[end : end + 2]):
        return 0
    return rest if rest < _FIELDS or lengths[data[end + 2]] > rest else 0


def _definitions(
    octets: NDArray[np.uint8], starts: _Offsets, types: NDArray[np.uint8]
) -> dict[int, _Definition]:
    """Find for each type the definition that fits most of its messages.

    A damaged definition may have the number of another type, or a length that contradicts its
    fields.
    """
    found: defaultdict[int, Counter[_Definition]] = defaultdict(Counter)
    where = starts[(types == FMT) & (starts + _DEFINITION.itemsize <= len(octets))]
    for row in _gather(octets, where, _DEFINITION).tolist():
        found[row[1]].update(_interpretations(*row[2:]))
    found.pop(FMT, None)

    def best(number: int, candidates: Counter[_Definition]) -> _Definition:
        offsets = starts[types == number]
        fits = {
            length: np.count_nonzero(_is_boundary(octets, offsets + length))
            for length in {candidate.length for candidate in candidates}
        }
        return max(candidates, key=lambda each: (fits[each.length], candidates[each]))

    return {
        number: next(iter(candidates)) if len(candidates) == 1 else best(number, candidates)
        for number, candidates in found.items()
        if candidates
    }


def _interpretations(length: int, name: bytes, form: bytes, labels: bytes) -> list[_Definition]:
    """Parse a definition: none if it is noise, two if it is inconsistent."""
    name, form, labels = (text.split(b"\0", 1)[0] for text in (name, form, labels))
    if not _NAME.fullmatch(name) or not _FORMAT.fullmatch(form):
        return []
    text = name.decode()
    codes = form.decode()
    if not set(codes) <= _CODES.keys():
        return [_Definition(text, length, None)] if length > _FIELDS else []
    sizes = [_SIZES[code] for code in codes]
    offsets = [_FIELDS + sum(sizes[:k]) for k in range(len(sizes))]
    size = offsets[-1] + sizes[-1]
    split = labels.split(b",")
    fields = None
    if len(split) == len(codes) and all(_LABEL.fullmatch(label) for label in split):
        fields = tuple(zip((label.decode() for label in split), offsets, codes, strict=True))
    interpretations = [_Definition(text, size, fields)]
    if _FIELDS < length != size:
        interpretations.append(_Definition(text, length, None))
    return interpretations


def _table(
    octets: NDArray[np.uint8], where: _Offsets, definition: _Definition, labels: Collection[str]
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
    rows = _gather(octets, where, layout)
    numbers: dict[str, Array] = {}
    texts = {}
    for label, (_, _, divisor) in fields.items():
        if divisor is None:
            texts[label] = tuple(
                text.split(b"\0", 1)[0].decode("utf-8", "replace") for text in rows[label].tolist()
            )
        else:
            with np.errstate(invalid="ignore"):  # damage may make a signalling NaN
                numbers[label] = rows[label].astype(np.float64) / divisor
    return Table(numbers, texts)


def _gather(octets: NDArray[np.uint8], where: _Offsets, layout: np.dtype[Any]) -> NDArray[Any]:
    """Read a record of this layout at each of these offsets."""
    if not len(where):
        return np.empty(0, layout)
    records = len(octets) - layout.itemsize + 1  # a record may start at every byte
    return np.ndarray((records,), layout, octets, strides=(1,))[where]


SIGNATURE = HEAD + bytes([FMT])  # first bytes of a log: the definition of FMT
_ATTITUDE = "ATT"
_REMEDY = "have it logged (LOG_BITMASK, or LOG_DISARMED for the ground)"


def _output_field(number: int) -> str:
    return f"C{number}"


_OUTPUTS = tuple(_output_field(n) for n in range(1, 15))
# By message: its fields, and the field with the number of the sensor, of which the first is used.
_FIELDS_BY_MESSAGE: Mapping[str, tuple[tuple[str, ...], str | None]] = {
    "ATT": (("DesRoll", "Roll", "DesPitch", "Pitch", "Yaw"), None),
    "IMU": (("GyrX", "GyrY", "GyrZ"), "I"),
    "ARSP": (("Airspeed",), "I"),
    "CTUN": (("As", "E2T", "ThO"), None),
    "RCOU": (_OUTPUTS, None),
    "AETR": (("Ail", "Elev", "Thr", "Rudd"), None),
    "POS": (("Alt", "RelHomeAlt"), None),
    "GPS": (("Alt", "VZ"), "I"),
    "BARO": (("Alt", "CRt"), "I"),
    "XKF1": (("VD",), "C"),
    "AOA": (("AOA", "SSA"), None),
}
_SEA_LEVEL = (field_source("POS", "Alt"), field_source("GPS", "Alt"))


COLUMNS: Mapping[str, tuple[ColumnSource, ...]] = {
    "theta_cmd_rad": (field_source("ATT", "DesPitch", RAD_PER_DEG, held=True),),
    "phi_cmd_rad": (field_source("ATT", "DesRoll", RAD_PER_DEG, held=True),),
    "throttle_cmd": (
        field_source("AETR", "Thr", 0.01, held=True),
        field_source("CTUN", "ThO", 0.01, held=True),
        throttle_output_source("RCOU", _output_field),
    ),
    "phi_rad": (field_source("ATT", "Roll", RAD_PER_DEG),),
    "theta_rad": (field_source("ATT", "Pitch", RAD_PER_DEG),),
    "psi_rad": (field_source("ATT", "Yaw", RAD_PER_DEG),),
    "p_radps": (field_source("IMU", "GyrX"),),
    "q_radps": (field_source("IMU", "GyrY"),),
    "r_radps": (field_source("IMU", "GyrZ"),),
    "airspeed_mps": tuple(
        true_airspeed_source(source, (field_source("CTUN", "E2T"),), _SEA_LEVEL)
        for source in (field_source("ARSP", "Airspeed"), field_source("CTUN", "As"))
    ),
    "altitude_m": (
        field_source("POS", "RelHomeAlt"),
        field_source("BARO", "Alt"),
        transformed_source(
            field_source("GPS", "Alt"), lambda values: values - values[0], "{} above its first"
        ),
    ),
    "v_down_mps": (
        field_source("XKF1", "VD"),
        field_source("GPS", "VZ"),
        field_source("BARO", "CRt", -1.0),
    ),
    "beta_rad": (field_source("AOA", "SSA", RAD_PER_DEG),),
    "alpha_rad": (field_source("AOA", "AOA", RAD_PER_DEG),),
    **{
        column: (output_source("RCOU", _output_field, column), demand_source(column))
        for column in SERVO_COLUMNS
    },
}

_MESSAGES = {
    "theta_cmd_rad": "ATT.DesPitch",
    "phi_cmd_rad": "ATT.DesRoll",
    "throttle_cmd": "AETR or CTUN",
    "p_radps": "IMU",
    "q_radps": "IMU",
    "r_radps": "IMU",
    "airspeed_mps": "ARSP or CTUN",
    "altitude_m": "POS, BARO or GPS",
    "v_down_mps": "XKF1, GPS or BARO",
    "beta_rad": "AOA",
    "alpha_rad": "AOA",
    **dict.fromkeys(SERVO_COLUMNS, "RCOU or AETR"),
}


def read_log(path: Path) -> FlightLog:
    """Read the .bin log of an ArduPlane flight; times are from its boot.

    Raises:
        MavlinkError: it cannot be read, or is not a log of ArduPlane.
    """
    data = read_bounded(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError)
    requested = {
        name: ("TimeUS", *fields, *([sensor] if sensor else []))
        for name, (fields, sensor) in _FIELDS_BY_MESSAGE.items()
    }
    requested |= {
        "MODE": ("TimeUS", "ModeNum", "Mode"),
        "PARM": ("Name", "Value"),
        "MSG": ("Message",),
    }
    contents = read_messages(data, requested)
    found = contents.tables
    if texts := found.get("MSG"):
        _check_vehicle(path, texts.texts.get("Message", ()))
    tables = {}
    for name, (_, sensor) in _FIELDS_BY_MESSAGE.items():
        if name in found and (table := _message_table(found[name], sensor)):
            tables[name] = table
    end = max((float(table.time[-1]) for table in tables.values()), default=0.0)
    notes = _notes(contents)
    return FlightLog(
        path=path,
        tables=tables,
        params=_params(found["PARM"]) if "PARM" in found else {},
        modes=_mode_intervals(found["MODE"], end) if "MODE" in found else (),
        notes=notes,
        attitude=_ATTITUDE,
        columns=COLUMNS,
        messages=_MESSAGES,
        remedy=f"{_REMEDY}, or download it again: {'; '.join(notes)}" if notes else _REMEDY,
        home=(field_source("POS", "Alt"), field_source("POS", "RelHomeAlt")),
    )


def _message_table(table: Table, sensor: str | None) -> MessageTable | None:
    """Take the messages of the first sensor, without times that decrease."""
    numbers = table.numbers
    if "TimeUS" not in numbers:
        return None
    time = 1e-6 * numbers["TimeUS"]
    keep = np.isfinite(time)
    if sensor is not None and sensor in numbers:  # older logs do not number them
        keep &= numbers[sensor] == 0.0
    keep[keep] = increasing(time[keep])
    if not keep.any():
        return None
    return MessageTable(time[keep], {name: values[keep] for name, values in numbers.items()})


def _params(table: Table) -> dict[str, float]:
    names, values = table.texts.get("Name", ()), table.numbers.get("Value", np.empty(0))
    return dict(zip(names, values.tolist(), strict=False))


def _mode_intervals(table: Table, log_end: float) -> tuple[ModeInterval, ...]:
    numbers = table.numbers
    modes = numbers.get("ModeNum", numbers.get("Mode"))
    if modes is None or "TimeUS" not in numbers:
        return ()
    valid = np.isfinite(modes) & np.isfinite(numbers["TimeUS"])
    starts = (1e-6 * numbers["TimeUS"][valid]).tolist()
    ends = [*starts, log_end][1:]
    return tuple(
        ModeInterval(int(mode), start, end)
        for mode, start, end in zip(modes[valid].tolist(), starts, ends, strict=True)
    )


def _check_vehicle(path: Path, texts: Iterable[str]) -> None:
    """Reject logs of other vehicles, whose modes have other numbers.

    Raises:
        MavlinkError: a text is of another vehicle.
    """
    for text in texts:
        if vehicle := re.match(r"Ardu(Copter|Rover|Sub)|APMrover2|Blimp|AntennaTracker", text):
            raise MavlinkError(f"{path}: a log of {vehicle.group()}; give one of ArduPlane")
        if text.startswith("ArduPlane"):
            return


def _notes(contents: Contents) -> tuple[str, ...]:
    notes = []
    if contents.skipped:
        notes.append(f"{contents.skipped} bytes are damaged and were left out")
    if contents.unreadable:
        notes.append(f"the definition of {', '.join(contents.unreadable)} is damaged")
    if contents.cut:
        notes.append(f"the last message is cut off after {contents.cut} bytes")
    return tuple(notes)
