"""Read DataFlash logs of ArduPlane, the .bin files that it writes on board.

Messages and units: https://ardupilot.org/plane/docs/logmessages.html.

A message consists of the bytes A3 95, its type, and its fields, little-endian and without gaps.
Messages of type 128, FMT, define length, name and fields of the other types
(https://github.com/ArduPilot/ardupilot/blob/master/libraries/AP_Logger/README.md).
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, read_bounded
from testbed.core.records import Array
from testbed.flight_logs.flight_log import (
    RAD_PER_DEG,
    ColumnSource,
    FlightLog,
    MessageTable,
    ModeInterval,
    check_order,
    field_source,
    increasing,
    order_notes,
    transformed_source,
    true_airspeed_source,
    undamaged,
)
from testbed.flight_logs.log_identity import UNKNOWN_VEHICLE, is_plane
from testbed.flight_logs.log_position import DATAFLASH
from testbed.flight_logs.servo_outputs import (
    SERVO_COLUMNS,
    demand_source,
    output_source,
    throttle_output_source,
)
from testbed.mavlink.codec import MavlinkError

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
class DataflashTable:
    """The M messages of one name, with the requested fields, in file order.

    Attributes:
        numbers: (M,) each, in units instead of hundredths, and degrees for L.
        texts: M each, without padding.
        offsets: (M,) of the messages in the file, bytes.
    """

    numbers: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]]
    offsets: _Offsets


_NO_MESSAGES = DataflashTable({}, {}, np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class Contents:
    """The requested messages of a log.

    Attributes:
        tables: by name, without names that have no messages.
        unreadable: requested names whose definition is damaged.
        skipped: bytes outside of messages: noise, damaged or undefined messages, and the message
            before each of these, whose end cannot be verified.
        cut: bytes of an incomplete last message.
        types: name and fields of each type, with the divisors of raw values; None: of a text or
            an array.
    """

    tables: Mapping[str, DataflashTable]
    unreadable: tuple[str, ...]
    skipped: int
    cut: int
    types: Mapping[int, tuple[str, tuple[tuple[str, float | None], ...]]]


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
    types_read = {
        number: (
            definition.name,
            tuple((label, _CODES[code][1]) for label, _, code in definition.fields or ()),
        )
        for number, definition in definitions.items()
    }
    return Contents(tables, tuple(unreadable), skipped, cut, types_read)


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
) -> DataflashTable:
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
    return DataflashTable(numbers, texts, where)


def _gather(octets: NDArray[np.uint8], where: _Offsets, layout: np.dtype[Any]) -> NDArray[Any]:
    """Read a record of this layout at each of these offsets."""
    if not len(where):
        return np.empty(0, layout)
    records = len(octets) - layout.itemsize + 1  # a record may start at every byte
    return np.ndarray((records,), layout, octets, strides=(1,))[where]


SIGNATURE = HEAD + bytes([FMT])  # first bytes of a log: the definition of FMT
_ATTITUDE = "ATT"
_CORE = "C"
_RESTART = 1.0  # s by which the clock steps back, and which the next log takes at least
_PLANE_BUILD = 3  # VER.BU
_MIN_COUNT = 0.01  # of the messages, from which on a number is a sensor
_REMEDY = "have it logged (LOG_BITMASK, or LOG_DISARMED for the ground)"


def _output_field(number: int) -> str:
    return f"C{number}"


_OUTPUTS = tuple(_output_field(n) for n in range(1, 15))
_ANGLE = ("deg", "degheading")
_GEODETIC = {"Lat": ("deglatitude",), "Lng": ("deglongitude",), "Alt": ("m",)}
# By message: its fields with their units by UNIT and FMTU, of which empty and unknown ones are not
# checked, and the field with the number of the sensor or of the EKF's core. The lowest number is
# used; of the cores the one that flew the aircraft.
_FIELDS_BY_MESSAGE: Mapping[str, tuple[Mapping[str, tuple[str, ...]], str | None]] = {
    "ATT": (dict.fromkeys(("DesRoll", "Roll", "DesPitch", "Pitch", "Yaw"), _ANGLE), None),
    "IMU": (dict.fromkeys(("GyrX", "GyrY", "GyrZ"), ("rad/s",)), "I"),
    "ARSP": ({"Airspeed": ("m/s",)}, "I"),
    "CTUN": ({"As": ("m/s",), "E2T": (), "ThO": ("%",)}, None),
    "RCOU": (dict.fromkeys(_OUTPUTS, ("us",)), None),
    "AETR": ({"Ail": (), "Elev": (), "Thr": ("%",), "Rudd": ()}, None),
    "POS": ({**_GEODETIC, "RelHomeAlt": ("m",)}, None),
    "GPS": (
        {
            **_GEODETIC,
            "VZ": ("m/s",),
            "Spd": ("m/s",),
            "GCrs": _ANGLE,
            "Status": (),
            "GWk": (),
            "GMS": ("s",),
        },
        "I",
    ),
    "BARO": ({"Alt": ("m",), "CRt": ("m/s",)}, "I"),
    "XKF2": (dict.fromkeys(("VWN", "VWE"), ("m/s",)), _CORE),
    "XKF1": (dict.fromkeys(("VN", "VE", "VD"), ("m/s",)), _CORE),
    "AOA": ({"AOA": ("deg",), "SSA": ("deg",)}, None),
}
_UNITS: Mapping[tuple[str, str], tuple[str, ...]] = {
    (name, label): units
    for name, fields in (*((n, f) for n, (f, _) in _FIELDS_BY_MESSAGE.items()), ("MODE", {}))
    for label, units in {"TimeUS": ("s",), **fields}.items()
}
_NO_MULTIPLIER = "-?"  # ids of FMTU: there is none, or it is not known
_US = 1e-6  # s, of TimeUS
_RAW = {"TimeUS": _US, "GMS": 1e-3}  # multipliers of fields that are read as raw values
_SAME_MULTIPLIER = 1e-6  # relative; logs have them in single precision
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
        true_airspeed_source(source, field_source("CTUN", "E2T"), _SEA_LEVEL)
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


def read_log(path: Path) -> FlightLog:
    """Read the .bin log of an ArduPlane flight; times are from its boot.

    Raises:
        MavlinkError: it cannot be read, is not a log of ArduPlane, is several logs, or has other
            units.
    """
    data = read_bounded(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError)
    _check_one_log(path, data)
    requested = {
        name: ("TimeUS", *fields, *([sensor] if sensor else []))
        for name, (fields, sensor) in _FIELDS_BY_MESSAGE.items()
    }
    requested |= {
        "MODE": ("TimeUS", "ModeNum", "Mode"),
        "PARM": ("Name", "Value"),
        "MSG": ("Message",),
        "VER": ("BU", "FWS"),
        "XKF4": ("PI",),
        "FMTU": ("FmtType", "UnitIds", "MultIds"),
        "UNIT": ("Id", "Label"),
        "MULT": ("Id", "Mult"),
    }
    contents = read_messages(data, requested)
    found = contents.tables
    params = _params(found.get("PARM", _NO_MESSAGES))
    plane = _check_vehicle(path, found, params)
    _check_units(path, contents)
    core = _flying_core(found)
    tables: dict[str, MessageTable] = {}
    left_out: dict[str, int] = {}
    instances: list[str] = []
    attitude = _NO_MESSAGES
    for name, (_, sensor) in _FIELDS_BY_MESSAGE.items():
        if name in found and "TimeUS" in found[name].numbers:
            rows = found[name]
            if sensor is not None and sensor in rows.numbers:  # older logs do not number them
                rows, note = _one_instance(name, rows, sensor, core)
                instances.extend(note)
            time = _US * rows.numbers["TimeUS"]
            keep = increasing(time)
            left_out[name] = len(time) - int(np.count_nonzero(keep))
            if name == _ATTITUDE:
                _check_one_clock(path, time)
                check_order(path, name, int(np.count_nonzero(keep)), len(time))
            if keep.any():
                fields = {label: values[keep] for label, values in rows.numbers.items()}
                tables[name] = MessageTable(time[keep], fields)
                if name == _ATTITUDE:
                    attitude = DataflashTable(fields, {}, rows.offsets[keep])
    end = max((float(table.time[-1]) for table in tables.values()), default=0.0)
    notes = _notes(contents)
    mode_messages = found.get("MODE", _NO_MESSAGES)
    modes, left_out["MODE"] = _mode_intervals(mode_messages, attitude, end)
    return FlightLog(
        path=path,
        tables=tables,
        params=params,
        modes=modes,
        notes=(
            *([] if plane else [UNKNOWN_VEHICLE]),
            *notes,
            *instances,
            *order_notes(left_out, "MODE"),
        ),
        attitude=_ATTITUDE,
        columns=COLUMNS,
        remedy=f"{_REMEDY}, or download it again: {'; '.join(notes)}" if notes else _REMEDY,
        home=(field_source("POS", "Alt"), field_source("POS", "RelHomeAlt")),
        motion=DATAFLASH,
    )


def _check_one_log(path: Path, data: bytes) -> None:
    """Reject files of several logs, one after the other.

    A log starts with the definition of FMT, which is followed by another definition.
    """
    start = data[: _DEFINITION.itemsize] + SIGNATURE
    second = data.find(start, 1)
    if second > 0:
        raise MavlinkError(
            f"{path}: several logs in one file, the second from byte {second} on; give one of them"
        )


def _check_one_clock(path: Path, time: Array) -> None:
    """Reject logs whose clock starts again, because the flight is another one.

    Damage may repeat a few messages.
    """
    valid = time[undamaged(time)]
    starts = np.flatnonzero(np.diff(valid) < -_RESTART) + 1
    runs = [run for run in np.split(valid, starts) if len(run) and run[-1] - run[0] > _RESTART]
    if len(runs) > 1:
        parts = ", ".join(f"{run[0]:.1f} to {run[-1]:.1f} s" for run in runs)
        raise MavlinkError(
            f"{path}: several flights, because the clock of {_ATTITUDE} steps back: {parts}; give "
            "a log of one of them"
        )


def _one_instance(
    name: str, table: DataflashTable, sensor: str, core: int | None
) -> tuple[DataflashTable, tuple[str, ...]]:
    """Take the messages of one sensor or core, and say which others there are."""
    numbers = table.numbers[sensor]
    counts = Counter(numbers[np.isfinite(numbers)].astype(int).tolist())
    # damage makes single messages of other numbers
    usual = [number for number, count in counts.items() if count >= _MIN_COUNT * len(numbers)]
    chosen = core if sensor == _CORE and core in usual else min(usual or counts)
    mine = numbers == chosen
    fields = {label: values[mine] for label, values in table.numbers.items()}
    taken = DataflashTable(fields, {}, table.offsets[mine])
    others = ", ".join(f"{counts[n]} of {n}" for n in sorted(counts) if n != chosen)
    note = f"{name}: number {chosen} is used; left out: {others}"
    return taken, (note,) if others else ()


def _flying_core(found: Mapping[str, DataflashTable]) -> int | None:
    """Return the EKF core that was the primary one for most of the log."""
    cores = found.get("XKF4", _NO_MESSAGES).numbers.get("PI")
    if cores is None or not np.isfinite(cores).any():
        return None
    cores = cores[np.isfinite(cores)]
    return int(Counter(cores.tolist()).most_common(1)[0][0])


def _params(table: DataflashTable) -> dict[str, float]:
    names, values = table.texts.get("Name", ()), table.numbers.get("Value", np.empty(0))
    return dict(zip(names, values.tolist(), strict=False))


def _mode_intervals(
    table: DataflashTable, attitude: DataflashTable, log_end: float
) -> tuple[tuple[ModeInterval, ...], int]:
    """Find the intervals in each mode, and count the messages without a credible time.

    The time of a message must be that of the attitudes before and after it in the file, within
    1 s, and not before that of an earlier mode. After a message without it the mode is unknown
    until the next one.

    Args:
        table: MODE.
        attitude: ATT in order of time, as used.
        log_end: latest time, s.
    """
    numbers = table.numbers
    modes = numbers.get("ModeNum", numbers.get("Mode"))
    if modes is None or "TimeUS" not in numbers:
        return (), 0
    start = _US * numbers["TimeUS"]
    time = _US * attitude.numbers.get("TimeUS", np.empty(0))
    next_one = np.searchsorted(attitude.offsets, table.offsets)
    before, after = np.append(-np.inf, time)[next_one], np.append(time, log_end)[next_one]
    valid = np.isfinite(modes) & (start >= before - _RESTART) & (start <= after + _RESTART)
    valid &= start >= np.maximum.accumulate(np.where(valid, start, -np.inf))
    begins = np.maximum.accumulate(np.where(valid, start, before))
    ends = np.append(begins[1:], log_end)
    intervals = zip(
        modes[valid].tolist(), begins[valid].tolist(), ends[valid].tolist(), strict=True
    )
    left_out = len(valid) - int(np.count_nonzero(valid))
    return tuple(ModeInterval(int(mode), begin, end) for mode, begin, end in intervals), left_out


def _check_vehicle(
    path: Path, found: Mapping[str, DataflashTable], params: Mapping[str, float]
) -> bool:
    """Check whether the log says that it is of ArduPlane; other modes have other numbers.

    Raises:
        MavlinkError: it says that it is of another vehicle.
    """
    version, texts = found.get("VER", _NO_MESSAGES), found.get("MSG", _NO_MESSAGES)
    banners = (*version.texts.get("FWS", ()), *texts.texts.get("Message", ()))
    builds = Counter(version.numbers.get("BU", np.empty(0)).tolist())
    plane = is_plane(path, banners, params, first=True)
    if not builds:
        return plane
    build = builds.most_common(1)[0][0]
    if build != _PLANE_BUILD and not plane:
        raise MavlinkError(
            f"{path}: a log of another vehicle than ArduPlane (VER.BU is {build:g}, not "
            f"{_PLANE_BUILD}); give one of ArduPlane"
        )
    return True


def _check_units(path: Path, contents: Contents) -> None:
    """Check the units and multipliers that the log declares.

    A multiplier is that of raw values: 0.01 for a field in hundredths.

    Raises:
        MavlinkError: a field that is read has another unit or multiplier.
    """
    declared = contents.tables.get("FMTU", _NO_MESSAGES)
    if "FmtType" not in declared.numbers:
        return
    labels = _by_id(contents.tables.get("UNIT", _NO_MESSAGES), "Label")
    multipliers = _by_id(contents.tables.get("MULT", _NO_MESSAGES), "Mult")
    numbers = declared.numbers["FmtType"].tolist()
    none = ("",) * len(numbers)
    ids = (declared.texts.get(each, none) for each in ("UnitIds", "MultIds"))
    for number, units, factors in zip(numbers, *ids, strict=True):
        name, fields = contents.types.get(number, ("", ()))
        for k, (label, divisor) in enumerate(fields):
            known, unit = _UNITS.get((name, label)), labels.get(units[k : k + 1], "")
            if known and unit not in ("", "UNKNOWN", *known):
                raise MavlinkError(
                    f"{path}: {name}.{label} is in {unit}; give a log of ArduPlane, which has it "
                    f"in {known[0]}"
                )
            factor = factors[k : k + 1]
            given = multipliers.get(factor, 0.0)
            if (name, label) not in _UNITS or divisor is None or factor in _NO_MULTIPLIER:
                continue
            assumed = _RAW.get(label, 1.0) / divisor
            if 0.0 < given < math.inf and not math.isclose(
                given, assumed, rel_tol=_SAME_MULTIPLIER
            ):
                raise MavlinkError(
                    f"{path}: {name}.{label} has the multiplier {given:g}; give a log of "
                    f"ArduPlane, in which it is {assumed:g}"
                )


def _by_id(table: DataflashTable, field: str) -> dict[str, Any]:
    """Return the values of a field by the character that is their id."""
    if "Id" not in table.numbers:
        return {}
    values: Sequence[Any] = table.texts.get(field) or table.numbers.get(field, np.empty(0)).tolist()
    pairs = zip(table.numbers["Id"].tolist(), values, strict=False)
    # damage may make an id negative
    return {chr(int(number) % 256): value for number, value in pairs if math.isfinite(number)}


def _notes(contents: Contents) -> tuple[str, ...]:
    notes = []
    if contents.skipped:
        notes.append(f"{contents.skipped} bytes are damaged and were left out")
    if contents.unreadable:
        notes.append(f"the definition of {', '.join(contents.unreadable)} is damaged")
    if contents.cut:
        notes.append(f"the last message is cut off after {contents.cut} bytes")
    return tuple(notes)
