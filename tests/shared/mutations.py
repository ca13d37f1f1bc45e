"""Mutations of files: hostile or careless edits, bad disks and bad links."""

import io
import json
import math
import re
import struct
import zlib
from copy import deepcopy

import mcap.records
import pyarrow as arrow
import yaml
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from pyarrow import parquet

NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
TOKEN = re.compile(r"[\w./+-]+")
ODD = (
    *("nan", ".nan", "inf", "-.inf", "1e308", "-1e308", "1e-320", "-1", "0", "-0.0", "1e9", "010"),
    *("0x10", "9" * 30, "9" * 400, "1_000", "1,5", "true", "null", "~", "[]", "{}", "''", '""'),
    *("x" * 5000, "é", "\u202e", "\u2028", "\ufeff", "\x00", "\x1b[2J", '"\\ud800"', '"\\e[2J"'),
    *("../../../etc/passwd", "/dev/zero", "/dev/stdin", "..", "~root", "%s", "$HOME", "evil:Law"),
    *("evil.py:Law", "../evil.py:Law", "os:system", "antigravity:X", ":", "a:", "__import__:x"),
)
YAMLS = (
    "!!python/object/apply:os.system ['touch pwned']",
    "!!python/name:os.system",
    "!!python/object/new:subprocess.Popen [['touch', 'pwned']]",
    "!!binary aGVsbG8=",
    "!!timestamp 2001-01-01",
    "!include /etc/passwd",
    "&a [*a]",
    "*undefined",
    "<<: *undefined",
    "? [a, b]\n: c",
    "|\n  text",
    "--- second: scenario",
    "[" * 60 + "]" * 60,
    "{a: " * 3000 + "}" * 3000,
    "[" + "0, " * 5000 + "0]",
    "\t- x",
    "%YAML 9.9\n---\n",
)


def flip(data, rng):
    """Invert some bits."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def cut(data, rng):
    """End the file early, or remove a piece."""
    one, two = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return data[:one] if rng.random() < 0.5 else data[:one] + data[two:]


def splice(data, rng):
    """Insert a copy of a piece, or random bytes."""
    one, two = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    piece = data[one:two][:2000] if rng.random() < 0.5 else rng.randbytes(rng.randrange(1, 200))
    at = rng.randrange(len(data) + 1)
    return data[:at] + piece + data[at:]


def lines(data, rng):
    """Remove, repeat or swap lines."""
    rows = data.splitlines(keepends=True)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not rows:
            break
        one, two = rng.randrange(len(rows)), rng.randrange(len(rows))
        way = rng.randrange(4)
        if way == 0:
            del rows[one]
        elif way == 1:
            rows.insert(two, rows[one])
        elif way == 2:
            rows[one], rows[two] = rows[two], rows[one]
        else:
            rows[one] = rows[one][rng.randrange(len(rows[one])) :]
    return b"".join(rows)


def replaced(data, rng, pattern, values):
    """Replace some matches of a pattern by one of the values."""
    text = data.decode("utf-8", "surrogateescape")
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        found = list(pattern.finditer(text))
        if found:
            at = rng.choice(found)
            text = text[: at.start()] + rng.choice(values) + text[at.end() :]
    return text.encode("utf-8", "surrogateescape")


def number(data, rng):
    """Change numbers, some to absurd ones."""
    near = [
        str(rng.uniform(-2, 40)),
        str(rng.randrange(-3, 200)),
        repr(10 ** rng.uniform(-9, 9)),
    ]
    return replaced(data, rng, NUMBER, (*near, *near, *near, *ODD))


def token(data, rng):
    """Change words, to others of the file or foreign ones."""
    text = data.decode("utf-8", "replace")
    own = TOKEN.findall(text)[:5000] or ["x"]
    return replaced(data, rng, TOKEN, (*(rng.choice(own) for _ in range(20)), *ODD))


def structure(data, rng):
    """Remove, move or rename keys, or change the type of values."""
    tree = yaml.safe_load(data)
    restructure(tree, rng)
    return yaml.safe_dump(tree, sort_keys=False).encode()


def restructure(tree, rng, values=()):
    """Change a tree of maps and lists in place; `values` are more values to put into it."""
    values = (None, True, 1, -1.5, 10**40, "x", [], {}, [[]], {"a": {}}, *values)
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            break
        home, key = rng.choice(places)
        other, there = rng.choice(places)
        way = rng.randrange(6)
        if way == 0:
            del home[key]
        elif way == 1:
            home[key] = deepcopy(other[there])
        elif way == 2 and isinstance(home, dict):
            home[rng.choice(("x", "", "null", "1", str(key) + "s"))] = home.pop(key)
        elif way == 3:
            home[key] = rng.choice(values)
        elif way == 4:
            home[key] = [home[key]] * rng.choice((1, 2, 300))
        else:
            home[key] = {str(key): home[key]}


def _places(tree):
    if isinstance(tree, dict | list):
        for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
            yield tree, key
            yield from _places(tree[key])


def spelled(data, rng):
    """Insert an unusual YAML construct."""
    rows = data.splitlines(keepends=True)
    odd = rng.choice(YAMLS).encode()
    at = rng.randrange(len(rows))
    if rng.random() < 0.3 or b":" not in rows[at]:
        return b"".join([*rows[:at], odd, b"\n", *rows[at:]])
    rows[at] = rows[at].partition(b":")[0] + b": " + odd + b"\n"
    return b"".join(rows)


XMLS = (
    '<input port="41234" type="SOCKET"/>',
    '<output name="pwned.csv" type="CSV" rate="100"><simulation> ON </simulation></output>',
    '<output file="pwned"/>',
    '<system file="../../evil"/>',
    '<system file="/etc/passwd"/>',
    '<system file="missing"/>',
    '<engine file="../Engines/x"/>',
    '<aerodynamics file="{self}"/>',
    '<property value="1"> simulation/write-state-file </property>',
    '<property value="1"> simulation/terminate </property>',
    '<system name="s"><channel name="c"><pure_gain name="simulation/write-state-file"><input> '
    "simulation/sim-time-sec </input></pure_gain></channel></system>",
    "<a>" * 3000 + "</a>" * 3000,
    "<function>" * 40 + "<value> 1 </value>" + "</function>" * 40,
    "<!-- " + "x" * 5000 + " -->",
    "&lol9;",
    "<![CDATA[ x ]]>",
    '<?xml-stylesheet href="x"?>',
)
DOCTYPES = (
    '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE x SYSTEM "file:///dev/zero">',
    '<!DOCTYPE x [<!ENTITY lol "lol"><!ENTITY lol9 "&lol;&lol;&lol;&lol;&lol;&lol;">]>',
)
ELEMENT = re.compile(r"<([\w]+)[^<>]*(?:/>|>(?:[^<]*)</\1>)")
BLOCK = re.compile(r"<(\w+)[^<>]*(?<!/)>.*?</\1>", re.DOTALL)
ATTRIBUTE = re.compile(r'(?<=")[^"<>]*(?=")')
TAG = re.compile(r"<[^!?][^<>]*>")


def elements(data, rng):
    """Remove, repeat, replace or empty elements."""
    text = data.decode("utf-8", "surrogateescape")
    pattern = rng.choice((ELEMENT, BLOCK))
    for _ in range(rng.choice((1, 1, 2))):
        found = list(pattern.finditer(text))
        if not found:
            break
        one, two = rng.choice(found), rng.choice(found)
        way = rng.randrange(4)
        new = ("", one.group() * 2, two.group(), re.sub(r">[^<]*<", "> <", one.group(), count=1))
        text = text[: one.start()] + new[way] + text[one.end() :]
    return text.encode("utf-8", "surrogateescape")


def planted(data, rng):
    """Insert a foreign element or document type."""
    text = data.decode("utf-8", "surrogateescape")
    if rng.random() < 0.2:
        at = text.find("?>") + 2
        return (text[:at] + rng.choice(DOCTYPES) + text[at:]).encode("utf-8", "surrogateescape")
    found = list(TAG.finditer(text))
    at = rng.choice(found).end() if found else 0
    return (text[:at] + rng.choice(XMLS) + text[at:]).encode("utf-8", "surrogateescape")


def attribute(data, rng):
    """Change attributes: units, names, files."""
    text = data.decode("utf-8", "surrogateescape")
    own = ATTRIBUTE.findall(text) or ["x"]
    values = [rng.choice(own) for _ in range(20)]
    return replaced(data, rng, ATTRIBUTE, (*values, *(o for o in ODD if '"' not in o)))


_RECORD = struct.Struct("<BQ")


def records(data, rng):
    """Change kind, length or bytes of MCAP records, remove or repeat them."""
    spans, at = [], 8
    while at + _RECORD.size <= len(data) - 8:
        end = at + _RECORD.size + _RECORD.unpack_from(data, at)[1]
        if end > len(data):
            break
        spans.append((at, end))
        at = end
    if not spans:
        return flip(data, rng)
    one, end = rng.choice(spans)
    out = bytearray(data)
    way = rng.randrange(5)
    if way == 0:
        out[one] = rng.randrange(256)
    elif way == 1:
        length = rng.choice((0, 1, 2**40, 2**63, 2**64 - 1, end - one, rng.randrange(1000)))
        out[one + 1 : one + 9] = struct.pack("<Q", length)
    elif way == 2:
        del out[one:end]
    elif way == 3:
        out[end:end] = out[one:end]
    else:
        for _ in range(rng.randrange(1, 9)):
            # half of the changes in the head of a chunk, which has its checksum
            far = min(end, one + 60) if rng.random() < 0.5 else end
            out[rng.randrange(one, far)] = rng.randrange(256)
    return bytes(out)


MAGIC = b"\x89MCAP0\r\n"
CHUNK, CHANNEL, MESSAGE, ATTACHMENT, METADATA = 6, 4, 5, 9, 12
NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1, 0, 0.5, 2**63, 10**300, "\x1b[2J", "\ud800")


def texts_of_json(value, rng):
    """Return JSON text of a changed value, or other text."""
    if rng.random() < 0.15:
        odd = ("[" * 200_000, '{"a":' * 200_000, "[]", "{}", "null", "5", '"x"', "", "{", "NaN")
        return rng.choice(odd).encode()
    tree = [deepcopy(value)]
    restructure(tree, rng, NUMBERS)
    return json.dumps(tree[0] if tree else None).encode("utf-8", "surrogatepass")


def split_records(data, at=0):
    """Return kind and content of the records of an MCAP file or a chunk."""
    found = []
    while at + _RECORD.size <= len(data):
        kind, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        found.append([kind, data[at : at + length]])
        at += length
    return found


def joined(records):
    return b"".join(_RECORD.pack(kind, len(content)) + content for kind, content in records)


def meaning(data, rng):
    """Change what a log says: its attachments, metadata, topics and messages; all checksums fit."""
    found = split_records(data[: -len(MAGIC)], len(MAGIC))
    wanted = rng.choice((ATTACHMENT, ATTACHMENT, ATTACHMENT, METADATA, CHUNK, CHUNK))
    record = rng.choice([each for each in found if each[0] == wanted])
    change = {ATTACHMENT: attachment, METADATA: metadata, CHUNK: chunk}[wanted]
    record[1] = change(record[1], rng)
    return MAGIC + joined(found) + MAGIC


def attachment(content, rng):
    stream = ReadDataStream(io.BytesIO(content))
    made = mcap.records.Attachment.read(stream)
    if made.name.endswith(".json"):
        made.data = texts_of_json(json.loads(made.data), rng)
    elif made.name.endswith(".yaml"):
        made.data = rng.choice((structure, number, token, spelled))(made.data, rng)
    else:
        made.data = flip(made.data, rng)
    if rng.random() < 0.1:
        made.name = rng.choice(("run.json", "metrics.json", "x", "../x.py", "scenario.yaml"))
    return content_of(made)


def metadata(content, rng):
    made = mcap.records.Metadata.read(ReadDataStream(io.BytesIO(content)))
    key = rng.choice(list(made.metadata))
    made.metadata[key] = rng.choice(("", "x", "4", "99", "\x1b[2J", "9" * 5000))
    if rng.random() < 0.3:
        del made.metadata[key]
    return content_of(made)


def content_of(record):
    out = RecordBuilder()
    record.write(out)
    return bytes(out.end())[_RECORD.size :]


def chunk(content, rng):
    """Change messages or channels of a chunk, and compress it again."""
    made = mcap.records.Chunk.read(ReadDataStream(io.BytesIO(content)))
    inner = split_records(zstandard.decompress(made.data, made.uncompressed_size))
    for _ in range(rng.choice((1, 1, 5, 50))):
        record = rng.choice(inner)
        if record[0] == MESSAGE:
            way, message = rng.randrange(5), bytearray(record[1])
            if way == 0:
                message[:2] = struct.pack("<H", rng.randrange(60))
            elif way == 1:
                time = rng.choice((0, 1, 10**9, 2**63, 2**64 - 1, rng.randrange(10**10)))
                message[6:14] = struct.pack("<Q", time)
            elif way == 2:
                message = message[: rng.randrange(22, len(message) + 1)]
            elif way == 3 and len(message) > 22:
                at = rng.randrange(22, len(message))
                message[at] = rng.randrange(256)
            elif way == 4 and len(message) > 40:
                at = rng.randrange(22, len(message) - 8)
                message[at : at + 8] = struct.pack("<d", rng.choice((math.nan, math.inf, 1e308)))
            record[1] = bytes(message)
        elif record[0] == CHANNEL:
            names = (b"state", b"uav1", b"events", b"lead", b"formation", b"estimate", b"\xc3\xa9")
            one, two = rng.choice(names), rng.choice(names)
            if len(one) == len(two):
                record[1] = record[1].replace(one, two)
    if rng.random() < 0.2:
        del inner[rng.randrange(len(inner))]
    data = joined(inner)
    made.data, made.compression = zstandard.compress(data), "zstd"
    made.uncompressed_size, made.uncompressed_crc = len(data), zlib.crc32(data)
    return content_of(made)


def entries(data, rng):
    """Change the JSON of some lines."""
    rows = data.splitlines(keepends=True)
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(rows))
        rows[at] = texts_of_json(json.loads(rows[at]), rng) + b"\n"
    if rng.random() < 0.3:
        rows.insert(rng.randrange(len(rows) + 1), rng.choice(rows))
    return b"".join(rows)


def table(data, rng):
    """Change columns or metadata of a Parquet file; all checksums fit."""
    whole = parquet.read_table(io.BytesIO(data))
    facts = dict(whole.schema.metadata)
    rows, names = whole.num_rows, whole.column_names
    index = rng.randrange(len(names))
    way = rng.randrange(7)
    if way < 2:
        key = rng.choice([key for key in facts if key != b"ARROW:schema"])
        odd = rng.choice((b"", b"x", b"-1", b"9" * 5000, b"\x1b[2J", b"99", b"[" * 200_000))
        facts[key] = odd
        if key.endswith(b".json") and rng.random() < 0.7:
            facts[key] = texts_of_json(json.loads(whole.schema.metadata[key]), rng)
        elif key.endswith(b".yaml") and rng.random() < 0.7:
            facts[key] = structure(whole.schema.metadata[key], rng)
        if rng.random() < 0.2:
            del facts[key]
    elif way == 2:
        whole = whole.remove_column(index)
    elif way == 3:
        whole = whole.append_column(rng.choice(names), whole.column(index))
    elif way == 4:
        whole = whole.rename_columns([*names[:index], rng.choice(ODD[-9:]), *names[index + 1 :]])
    elif way == 5:
        odd = rng.choice((None, "x", True, [1], {"a": 1}, b"\xff", 1.5, -1, 2**62, math.nan))
        whole = whole.set_column(index, names[index], arrow.array([odd] * rows))
    else:
        whole = rng.choice((whole.slice(0, 0), whole.slice(1), arrow.concat_tables([whole] * 3)))
    out = io.BytesIO()
    parquet.write_table(whole.replace_schema_metadata(facts), out)
    return out.getvalue()


ANY = (flip, cut, splice, lines, token, number, number)
ASSIGNMENT = re.compile(rb"^(\w+)[ \t,=]+([^\s,#]+).*", re.MULTILINE)
ASSIGNMENTS = (
    *(rb"\1 = \2", rb"\1\t\2 @READONLY", rb"\1,\2,9", rb"1\t1\t\1\t\2\t9", rb"1 154 \1 \2 9"),
    *(
        rb"\1 \2 // x",
        rb"\1 \2#x",
        rb"\1 \2,5",
        rb"\1 \2 5",
        rb"2 1 \1 \2 9",
        rb"\1_OF_A_LONG_NAME \2",
    ),
    *(rb"\1=", rb"=\2", rb"\1 \2\n\1 9", rb"# Stack: PX4\n\1 \2", rb"\1 \2_0", b"\\1\xc2\xa0\\2"),
)


def assignment(data, rng):
    """Write some or all parameters in another way."""
    way = rng.choice(ASSIGNMENTS)
    share = rng.choice((0.02, 0.2, 1.0))
    return ASSIGNMENT.sub(
        lambda found: found.expand(way) if rng.random() < share else found.group(), data
    )


MUTATIONS = {
    ".yaml": (*ANY, structure, structure, structure, structure, spelled, spelled),
    ".param": (*ANY, assignment, assignment, assignment),
    ".waypoints": (lines, lines, token, number, number, number),
    ".csv": ANY,
    ".xml": (*ANY, number, elements, elements, elements, planted, planted, attribute, attribute),
    ".mcap": (flip, cut, splice, *3 * (records,), *6 * (meaning,)),
    ".journal": (*ANY, *6 * (entries,)),
    ".json": (*ANY, number, number, number, token, token),
    ".parquet": (flip, cut, splice, *6 * (table,)),
}


def mutate(data, suffix, rng):
    """Return the mutated bytes of a file of this suffix, and the name of the mutation."""
    way = rng.choice(MUTATIONS[suffix])
    return way(data, rng), way.__name__
