"""Write an aircraft with its autopilot as a native FMU for co-simulation, FMI 2.0.

The flight model compiled from the aircraft's files, the actuation and fly-by-wire A are one
function of a block of bytes (`aircraft_functions`); `aircraft_fmu.c` has the functions of the
standard around it. Trimmed starts are made here, by JSBSim, and are data of the FMU.
"""

from __future__ import annotations

import hashlib
import io
import struct
import tempfile
import uuid
import zipfile
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.autopilot.parameters import read_params
from testbed.compiled import NotTranslated
from testbed.compiled.columns import AIR_INPUTS
from testbed.compiled.compiled_fleet import find_engine
from testbed.core.compile import is_interpreted
from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded
from testbed.core.records import NedOrigin, Record
from testbed.core.version import __version__
from testbed.fmi.aircraft_block import AUTOPILOT_HZ, StartPoint, field_offsets, make_block
from testbed.fmi.aircraft_functions import make_functions
from testbed.fmi.compilers import find_cc, find_zig, link_library
from testbed.fmi.description_writing import (
    AIRSPEED,
    DOWN,
    DescribedVariable,
    describe_model,
    identifier,
    list_variables,
)
from testbed.fmi.native_code import NativeModule
from testbed.fmi.targets import THIS, Target, targets

_WRAPPER = Path(__file__).with_name("aircraft_fmu.c")
_LICENCE = Path(__file__).with_name("licence.txt")
_WORD = 8  # bytes
_PROPELLER, _BATTERY = 2, 3  # of `air_columns`
_MAX_BYTES = 10_000_000  # of a file of an aircraft
_FAT, _FAT_ALIGNMENT = 0xCAFEBABE, 14  # of a library for several processors; a power of two
_PROCESSORS = {"x86_64": (0x01000007, 3), "arm64": (0x0100000C, 0)}
_NOTES = "LICEN[CS]E*", "COPYING*", "NOTICE*", "SOURCE.md"

Report = Callable[[str], None]


class AircraftFmu(NamedTuple):
    """What an FMU is made of.

    Attributes:
        folder: of the aircraft.
        tune: parameters of the autopilot, a file.
        airspeeds: of the trimmed starts, m/s.
        heights: of the trimmed starts above the origin, m.
        physics_hz: steps of the flight model per second.
        targets: names of platforms, see `targets`.
        cc: C compiler of this machine; None: cc on PATH.
        zig: the compiler zig; None: that on PATH.
    """

    folder: Path
    tune: Path
    airspeeds: Sequence[float]
    heights: Sequence[float] = (100.0,)
    physics_hz: int = 100
    targets: Sequence[str] = (THIS,)
    cc: Path | None = None
    zig: Path | None = None


class WrittenFmu(NamedTuple):
    """An FMU as it was made.

    Attributes:
        data: the archive.
        guid: of the FMU.
        variables: their number.
        state_bytes: of a saved state.
        sizes: of the compressed libraries by their names in the archive, bytes.
        engine: how the flight model was proved.
    """

    data: bytes
    guid: str
    variables: int
    state_bytes: int
    sizes: Mapping[str, int]
    engine: str


def make_fmu(wanted: AircraftFmu, report: Report = lambda text: None) -> WrittenFmu:
    """Make the archive of an FMU.

    Args:
        wanted: what it is made of.
        report: called with what is done next, in words.

    Raises:
        InputError: the aircraft is flown by JSBSim only, has no level flight at an airspeed, or a
            compiler is missing or fails.
    """
    if is_interpreted():
        raise InputError("an FMU is compiled: unset NUMBA_DISABLE_JIT")
    compilers = _find_compilers(wanted)
    report("compile the flight model")
    name, origin = wanted.folder.name, NedOrigin()
    engine = find_engine(wanted.folder, wanted.physics_hz)
    if engine.compiled is None:
        raise _refusal(name, engine.reasons)
    aircraft, params = engine.compiled, read_params(wanted.tune)
    blocks = list[Record]()
    for height in wanted.heights:
        for airspeed in wanted.airspeeds:
            report(f"trim at {airspeed:g} m/s, {height:g} m")
            try:
                at = StartPoint(height, origin)
                blocks.append(make_block(aircraft, params, airspeed, at, wanted.physics_hz))
            except NotTranslated as error:
                raise _refusal(name, str(error).splitlines()) from None
    report("compile the autopilot around it")
    functions = make_functions(aircraft, blocks[0].dtype, origin, wanted.physics_hz)
    native = NativeModule({"testbed_place": functions.place, "testbed_fly": functions.fly})
    places = {each: at for each, at, _ in field_offsets(blocks[0].dtype)}
    variables = list_variables(
        gusts=all(each in aircraft.columns for each in AIR_INPUTS),
        propeller=bool(aircraft.air_columns[_PROPELLER] >= 0),
        battery=bool(aircraft.air_columns[_BATTERY] >= 0),
    )
    offsets = [places[each.field] + _WORD * each.part for each in variables]
    default = _default_start(blocks)
    content = blocks[default].tobytes()
    starts = [struct.unpack_from("<d", content, at)[0] for at in offsets]
    words = f"{name} in JSBSim's model, behind ArduPlane's fly-by-wire A"

    def describe(guid: str) -> str:
        return describe_model(name, guid, variables, starts, 1.0 / AUTOPILOT_HZ, words)

    guid = _guid(describe(""), native.text, *(each.tobytes() for each in blocks))
    header = _header(guid, variables, offsets, blocks, default)
    members = {"modelDescription.xml": describe(guid).encode()}
    for target, command in compilers.items():
        report(f"link for {target}")
        kind = targets()[target]
        library = f"{identifier(name)}{kind.suffix}"
        members[f"binaries/{kind.folder}/{library}"] = _build(
            native, header, kind, command, library
        )
    members |= _documentation(wanted, engine.reasons, variables)
    data, sizes = _archive(members)
    libraries = {each: sizes[each] for each in sizes if each.startswith("binaries/")}
    size = blocks[0].dtype.itemsize
    return WrittenFmu(data, guid, len(variables) + 1, size, libraries, "; ".join(engine.reasons))


def _find_compilers(wanted: AircraftFmu) -> dict[str, tuple[str, ...]]:
    """Return the command of the compiler of each target.

    Raises:
        InputError: a compiler is missing, or two targets have the same place in an FMU.
    """
    known, folders = targets(), dict[str, str]()
    found = dict[str, tuple[str, ...]]()
    for name in wanted.targets:
        target = known[name]
        if (other := folders.setdefault(target.folder, name)) != name:
            raise InputError(
                f"--target {other} and {name} have one place in an FMU, {target.folder} (write one "
                "of them)"
            )
        if target.zig:
            zig = find_zig(wanted.zig, name)
            found[name] = (zig, "cc")
        else:
            found[name] = (find_cc(wanted.cc),)
    return found


def _refusal(name: str, reasons: Sequence[str]) -> InputError:
    text = "\n".join(f"    {each}" for each in reasons)
    return InputError(
        f"{name}: only JSBSim flies this aircraft, so there is no FMU of it: parts of it are not "
        f"compiled\n{text}"
    )


def _default_start(blocks: Sequence[Record]) -> int:
    """Return the number of the start in the middle of the airspeeds, of the first height."""
    heights = [-float(each["start"]["position_ned"][2]) for each in blocks]
    return heights.count(heights[0]) // 2


def _guid(text: str, code: str, *blocks: bytes) -> str:
    digest = hashlib.sha256()
    for part in (text.encode(), code.encode(), _WRAPPER.read_bytes(), *blocks):
        digest.update(hashlib.sha256(part).digest())
    return f"{{{uuid.uuid5(uuid.NAMESPACE_URL, digest.hexdigest())}}}"


def _header(
    guid: str,
    variables: Sequence[DescribedVariable],
    offsets: Sequence[int],
    blocks: Sequence[Record],
    default: int,
) -> str:
    """Return `model.h`, the data of `aircraft_fmu.c`."""
    names = [each.name for each in variables]
    airspeeds = [float(each["start"]["airspeed"]) for each in blocks]
    heights = [-float(each["start"]["position_ned"][2]) for each in blocks]
    text = ", ".join(dict.fromkeys(f"{each:.15g}" for each in airspeeds))
    words = [np.frombuffer(each.tobytes(), dtype="<u8") for each in blocks]
    lines = [
        f'#define GUID "{guid}"',
        f"#define PERIOD_S {1.0 / AUTOPILOT_HZ!r}",
        f"#define REALS {len(variables)}",
        f"#define WORDS {len(words[0])}",
        f"#define STARTS {len(blocks)}",
        f"#define DEFAULT_START {default}",
        f"#define START_AIRSPEED {names.index(AIRSPEED)}",
        f"#define START_DOWN {names.index(DOWN)}",
        f'#define AIRSPEEDS_TEXT "{text}"',
        _array("const char *const NAMES[]", [f'"{each}"' for each in names]),
        _array("const unsigned char KINDS[]", [f"{int(each.kind)}" for each in variables]),
        _array("const unsigned OFFSETS[]", [f"{each}" for each in offsets]),
        _array("const double AIRSPEEDS[]", [repr(each) for each in airspeeds]),
        _array("const double HEIGHTS[]", [repr(each) for each in heights]),
        _array(
            "const uint64_t BLOCKS[][WORDS]",
            ["{" + ",".join(f"{int(word):#x}" for word in each) + "}" for each in words],
        ),
    ]
    return "\n".join(lines) + "\n"


def _array(declaration: str, values: Sequence[str]) -> str:
    return f"static {declaration} = {{{', '.join(values)}}};"


def _build(
    native: NativeModule, header: str, target: Target, command: tuple[str, ...], name: str
) -> bytes:
    """Return the library of a target, which is linked by its name."""
    libraries = list[bytes]()
    for k, triple in enumerate(target.triples):
        with tempfile.TemporaryDirectory(prefix="testbed-fmu-") as place:
            folder = Path(place)
            sources = [folder / "aircraft_fmu.c", folder / "flight.o"]
            sources[0].write_bytes(_WRAPPER.read_bytes())
            sources[1].write_bytes(native.object_code(triple))
            (folder / "model.h").write_text(header, "utf-8")
            for_target = ("-target", target.zig[k]) if target.zig else ()
            library = folder / name
            link_library((*command, *for_target), sources, library)
            libraries.append(library.read_bytes())
    return libraries[0] if len(libraries) == 1 else _universal(target.triples, libraries)


def _universal(triples: Sequence[str], libraries: Sequence[bytes]) -> bytes:
    """Return a library of macOS for several processors: a table, then each library, aligned."""
    step = 1 << _FAT_ALIGNMENT
    table, body, at = struct.pack(">II", _FAT, len(libraries)), b"", step
    for triple, library in zip(triples, libraries, strict=True):
        kind, variant = _PROCESSORS[triple.split("-")[0]]
        table += struct.pack(">IIIII", kind, variant, at, len(library), _FAT_ALIGNMENT)
        padded = library + bytes(-len(library) % step)
        body, at = body + padded, at + len(padded)
    return table.ljust(step, b"\0") + body


def _documentation(
    wanted: AircraftFmu, reasons: Sequence[str], variables: Sequence[DescribedVariable]
) -> dict[str, bytes]:
    """Return the files of documentation/: a page, and licences and sources of the aircraft."""
    folder, name = wanted.folder, wanted.folder.name
    files = sorted([*folder.rglob("*.xml"), wanted.tune])
    digests = [(_name_in(folder, each), _sha256(each)) for each in files]
    rows = "\n".join(
        f"<tr><td>{escape(each.name)}</td><td>{each.kind.name.lower()}</td>"
        f"<td>{each.unit}</td><td>{escape(each.words)}</td></tr>"
        for each in variables
    )
    listed = "\n".join(
        f"<tr><td>{escape(file)}</td><td><code>{digest}</code></td></tr>"
        for file, digest in digests
    )
    airspeeds = ", ".join(f"{each:g}" for each in wanted.airspeeds)
    heights = ", ".join(f"{each:g}" for each in wanted.heights)
    page = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(name)}</title></head><body>
<h1>{escape(name)}</h1>
<p>The flight model of a JSBSim aircraft behind ArduPlane's fly-by-wire A as the testbed models it,
made by testbed {__version__}: {escape("; ".join(reasons))}. {wanted.physics_hz} steps of the flight
model and {AUTOPILOT_HZ} of the autopilot per second.</p>
<p>It starts in level flight at start.airspeed, one of {airspeeds} m/s, trimmed {heights} m above
the origin, in the wind that wind_ned has when the initialization ends. The origin is at 38° north,
0° east, 300 m above sea level. Commands that are not set are those of the trim. Inputs are sampled
at communication points, whose steps are multiples of {1.0 / AUTOPILOT_HZ:g} s. Where ended is not
flying, fmi2DoStep returns fmi2Discard with fmi2Terminated, and outputs keep their values.</p>
<h2>Variables</h2><table>{rows}</table>
<h2>Airframe</h2><p>SHA-256 of the files that it is made of.</p><table>{listed}</table>
<h2>Licences</h2><p>licenses/ has that of the testbed, which the library is compiled from, and the
licence files of the aircraft's folder.</p>
</body></html>
"""
    members = {
        "documentation/index.html": page.encode(),
        "documentation/licenses/testbed.txt": _LICENCE.read_bytes(),
    }
    for pattern in _NOTES:
        for each in sorted(folder.glob(pattern)):
            if each.is_file():
                inside = f"documentation/licenses/{name}/{each.name}"
                members[inside] = read_bounded(each, _MAX_BYTES)
    return members


def _name_in(folder: Path, file: Path) -> str:
    resolved = file.resolve()
    inside = resolved.is_relative_to(folder.resolve())
    return resolved.relative_to(folder.resolve()).as_posix() if inside else file.name


def _sha256(file: Path) -> str:
    return hashlib.sha256(read_bounded(file, _MAX_BYTES)).hexdigest()


def _archive(members: Mapping[str, bytes]) -> tuple[bytes, dict[str, int]]:
    """Return a zip archive, the same for the same members, and the compressed sizes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in members.items():
            info = zipfile.ZipInfo(name)  # of 1980
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
        sizes = {each.filename: each.compress_size for each in archive.infolist()}
    return out.getvalue(), sizes
