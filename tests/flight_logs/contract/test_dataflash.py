"""DataFlash logs: complete, cut and damaged. TESTBED_FRAMES sets the number of damaged logs."""

import os
import random
import struct

import numpy as np
import pytest
from cases import ALL

from testbed.flight_logs.dataflash import read_messages

TRIES = int(os.environ.get("TESTBED_FRAMES", "2500")) // 10
SEED = 20261122
CODES = {
    "c": "h",
    "C": "H",
    "e": "i",
    "E": "I",
    "L": "i",
    "M": "B",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
}
CODES |= {"a": "64s"}
HEAD = b"\xa3\x95"
# The spare type is first and between the others; it is not requested.
TYPES = {
    9: ("SPAR", "QIfB", "TimeUS,Spare,Part,N"),
    1: ("ATT", "Qff", "TimeUS,Roll,Pitch"),
    2: ("MSG", "QZ", "TimeUS,Message"),
    3: ("GPS", "QBe", "TimeUS,I,Alt"),
}
WANTED = {"ATT": ("TimeUS", "Roll", "Pitch"), "MSG": ("Message",), "GPS": ("I", "Alt")}


def coded(form):
    return "<" + "".join(CODES.get(code, code) for code in form)


def definition(kind, name, form, labels, length=None):
    length = 3 + struct.calcsize(coded(form)) if length is None else length
    body = struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), labels.encode())
    return HEAD + b"\x80" + body


def message(kind, *values, types=TYPES):
    return HEAD + bytes([kind]) + struct.pack(coded(types[kind][1]), *values)


DEFINITIONS = [definition(kind, *fields) for kind, fields in TYPES.items()]
MESSAGES = [
    row
    for k in range(12)
    for row in (
        message(9, k, 7, 1.5, 0),
        message(1, 20_000 * k, 0.5 * k, -0.25 * k),
        message(9, k, 8, 1.5, 1),
        message(3, 20_000 * k, 0, 10_000 + k),
        message(2, 20_000 * k, f"text {k}".encode()),
    )
]
PARTS = [*DEFINITIONS, *MESSAGES]
LOG = b"".join(PARTS)


def content(data, wanted=WANTED):
    """Return the content of a log as Python values, for comparison."""
    read = read_messages(data, wanted)
    return {
        name: {label: values.tolist() for label, values in table.numbers.items()}
        | dict(table.texts)
        for name, table in read.tables.items()
    }


WHOLE = {
    "ATT": {
        "TimeUS": [20_000.0 * k for k in range(12)],
        "Roll": [0.5 * k for k in range(12)],
        "Pitch": [-0.25 * k for k in range(12)],
    },
    "MSG": {"Message": tuple(f"text {k}" for k in range(12))},
    "GPS": {"I": [0.0] * 12, "Alt": [(10_000 + k) / 100 for k in range(12)]},
}


def test_dataflash_reads_requested_messages():
    assert content(LOG) == WHOLE
    read = read_messages(LOG, WANTED)
    assert (read.skipped, read.cut, read.unreadable) == (0, 0, ())
    assert content(LOG, {"ATT": ("Roll", "Yaw"), "IMU": ("GyrX",)}) == {
        "ATT": {"Roll": WHOLE["ATT"]["Roll"]}
    }
    assert content(LOG, {}) == content(b"", WANTED) == {}


@pytest.mark.parametrize(
    ("code", "written", "read"),
    [
        ("b", -128, -128.0),
        ("B", 255, 255.0),
        ("M", 5, 5.0),
        ("h", -32768, -32768.0),
        ("H", 65535, 65535.0),
        ("i", -(2**31), -(2.0**31)),
        ("I", 2**32 - 1, 2.0**32 - 1),
        ("q", -(2**53), -(2.0**53)),
        ("Q", 2**53, 2.0**53),
        ("f", 1.5e-30, float(np.float32(1.5e-30))),
        ("d", 1.1e-300, 1.1e-300),
        ("c", -18000, -180.0),
        ("C", 35999, 359.99),
        ("e", -1234567, -12345.67),
        ("E", 4294967295, 42949672.95),
        ("L", -351332423, -35.1332423),
        ("n", b"ab\0d", "ab"),
        ("N", b"ABCDEFGHIJKLMNOP", "ABCDEFGHIJKLMNOP"),
        ("Z", b"\xc2\xb0\xff\0rest", "\u00b0\ufffd"),
    ],
)
def test_dataflash_decodes_every_field_type(code, written, read):
    types = {1: ("X", f"B{code}aB", "A,B,C,D")}
    data = definition(1, *types[1]) + 2 * message(1, 1, written, bytes(64), 2, types=types)
    found = read_messages(data, {"X": "ABCD"}).tables["X"]
    assert found.numbers["A"].tolist() == [1.0, 1.0]
    assert found.numbers["D"].tolist() == [2.0, 2.0]  # after the array, which is skipped
    (value,) = {*found.texts.get("B", ()), *found.numbers.get("B", np.empty(0)).tolist()}
    assert value == read


def test_dataflash_cut_log_keeps_complete_messages():
    ends = np.cumsum([len(part) for part in PARTS])
    for length in range(len(LOG), -1, -1 if ALL else -3):
        parts = int(np.searchsorted(ends, length, side="right"))
        read = read_messages(LOG[:length], WANTED)
        assert read.cut == length - (ends[parts - 1] if parts else 0)
        assert read.skipped == 0
        attitudes = read.tables["ATT"].numbers["Roll"] if "ATT" in read.tables else ()
        assert len(attitudes) == sum(part[2] == 1 for part in PARTS[4:parts])


@pytest.mark.parametrize("noise", [b"\0", bytes(64), b"\xa3", b"\x95\xa3", b"\xff" * 300])
def test_dataflash_noise_loses_one_message(noise):
    for k in range(1, len(MESSAGES)):
        before = b"".join([*DEFINITIONS, *MESSAGES[: k - 1]])
        after = b"".join(MESSAGES[k:])
        read = read_messages(before + MESSAGES[k - 1] + noise + after, WANTED)
        assert read.skipped == len(MESSAGES[k - 1]) + len(noise)
        assert content(before + MESSAGES[k - 1] + noise + after) == content(before + after)


def test_dataflash_missing_bytes_lose_one_message():
    for k, part in enumerate(MESSAGES[:-1]):
        before, after = PARTS[: 4 + k], PARTS[5 + k :]
        rest = content(b"".join(before + after))
        for lost in range(1, len(part) - 1, 1 if ALL else 4):  # a single byte is noise
            data = b"".join([*before, part[:-lost], *after])
            assert content(data) == rest
            assert read_messages(data, WANTED).skipped == len(part) - lost


def test_dataflash_nested_header_is_ignored():
    inside = message(1, 5, 5.0, 5.0) + HEAD + b"\x01"
    data = LOG + message(2, 1, inside) + message(2, 2, inside + message(3, 1, 1, 1) + HEAD)
    read = read_messages(data, WANTED)
    assert read.tables["ATT"].numbers["Roll"].tolist() == WHOLE["ATT"]["Roll"]
    assert len(read.tables["MSG"].texts["Message"]) == 14
    assert read.skipped == 0


def test_dataflash_undefined_types_are_skipped():
    undefined = HEAD + b"\x63" + bytes(30)
    data = b"".join([*DEFINITIONS, *(part + undefined for part in MESSAGES)])
    assert content(data) == WHOLE
    assert read_messages(data, WANTED).skipped == 33 * len(MESSAGES)


def changed(data, at):
    for value in {0, 1, 3, 0x2C, 0x41, 0x80, 0xFF, data[at] ^ 0x20} - {data[at]}:
        yield data[:at] + bytes([value]) + data[at + 1 :]


def test_dataflash_unused_bad_definition_is_ignored():
    for at in range(len(DEFINITIONS[0])):
        for data in changed(LOG, at):
            assert content(data) == WHOLE


def test_dataflash_bad_definition_loses_own_messages():
    """A damaged length loses nothing: the fields imply one, too, and only one of them fits."""
    begin, length = len(DEFINITIONS[0]), len(DEFINITIONS[1])
    others = {name: WHOLE[name] for name in ("MSG", "GPS")}
    for at in range(begin, begin + length):
        for data in changed(LOG, at):
            found = content(data)
            attitude = found.pop("ATT", {})
            assert found == others
            # a field of another name, or of another type of the same size
            kept = [label for label in attitude if attitude[label] == WHOLE["ATT"][label]]
            assert len(kept) >= len(attitude) - (at - begin in range(9, 25))
            if at - begin == 4:
                assert attitude == WHOLE["ATT"]


def test_dataflash_unreadable_definition_is_named():
    data = LOG.replace(b"TimeUS,Roll", b"TimeUS-Roll")
    read = read_messages(data, WANTED)
    assert read.unreadable == ("ATT",)
    assert read.skipped == 0
    assert read_messages(data, {"GPS": ("Alt",)}).unreadable == ()


def test_dataflash_fitting_definition_is_used():
    wrong = definition(1, "ATT", "Qf", "TimeUS,Roll")
    for data in (wrong + LOG, LOG + wrong, wrong + wrong + LOG):
        assert content(data) == WHOLE


def test_dataflash_definitions_may_follow_messages():
    assert content(b"".join([*MESSAGES, *DEFINITIONS])) == WHOLE


def damaged(rng):
    data = bytearray(LOG)
    for _ in range(rng.randrange(1, 8)):
        at = (
            rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(len(DEFINITIONS) * 89)
        )
        way, size = rng.randrange(6), rng.randrange(1, 200)
        if way == 0:
            data[at : at + size] = b""
        elif way == 1:
            data[at:at] = rng.randbytes(size)
        elif way == 2:
            data[at:at] = bytes(rng.choices(HEAD + bytes([0x80, *TYPES]), k=size))
        elif way == 3:
            data[at : at + size] = LOG[(other := rng.randrange(len(LOG))) : other + size]
        else:
            data[at : at + 1] = rng.randbytes(1)
    return bytes(data)


def test_dataflash_damage_accounts_for_every_byte():
    rng = random.Random(SEED + 1)
    everything = {name: labels.split(",") for name, _, labels in TYPES.values()}
    for _ in range(TRIES):
        data = damaged(rng)
        read = read_messages(data, everything)
        assert 0 <= read.skipped <= len(data) - read.cut
        for table in read.tables.values():
            lengths = {len(column) for column in (*table.numbers.values(), *table.texts.values())}
            assert len(lengths) <= 1
    for size in range(200):
        read_messages(bytes(rng.choices(HEAD + bytes([0x80, 1, 89]), k=size)), everything)
        read_messages(rng.randbytes(size), everything)
