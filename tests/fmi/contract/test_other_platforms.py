"""Libraries that zig builds: their formats and symbols, and flights of those that run here."""

import math
import os
import platform
import re
import shutil
import struct
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmi2_importer import Archive, Instance
from waiting import TIMEOUT_S

import testbed
from testbed.core.library import library
from testbed.fmi import aircraft_fmu
from testbed.fmi.aircraft_fmu import AircraftFmu, make_fmu

ZIG = shutil.which("zig") or shutil.which("python-zig")
pytestmark = [
    pytest.mark.skipif(
        os.environ.get("TESTBED_FMUS") != "1",
        reason="TESTBED_FMUS=1: the first build by zig takes ten minutes",
    ),
    pytest.mark.skipif(ZIG is None, reason="neither zig nor python-zig is on PATH"),
]
RASCAL = library() / "aircraft" / "rascal110"
OTHERS = "linux-x86-64", "linux-arm64", "macos", "windows"
MOST_BYTES = 100_000  # compressed, of one platform; macOS has two
FOREIGN = re.compile(rb"Py[A-Z_]\w+|numba|NRT_")
COMMAND = ["command.pitch", "command.roll", "command.throttle"]
# reads commands, writes positions
DRIVER = """
#include <stdio.h>
#include "aircraft_fmu.c"
int main(void) {
  double in[3], out[3];
  unsigned where[] = {FIRST, FIRST + 1, FIRST + 2}, what[] = {0, 1, 2};
  void *it = fmi2Instantiate("a", fmi2CoSimulation, GUID, "", NULL, 0, 0);
  fmi2EnterInitializationMode(it);
  if (fmi2ExitInitializationMode(it)) return 2;
  for (int k = 0; fread(in, 8, 3, stdin) == 3; k++) {
    fmi2SetReal(it, what, 3, in);
    if (fmi2DoStep(it, k * 0.02, 0.02, 1)) return 3;
    fmi2GetReal(it, where, 3, out);
    fwrite(out, 8, 3, stdout);
  }
  return 0;
}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The FMU of all platforms, unpacked, and the sources of its first library."""
    sources, folder = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("fmu")
    link = aircraft_fmu.link_library

    def keep(command, files, target):
        if not any(sources.iterdir()):
            for each in files[0].parent.glob("*.[cho]"):
                shutil.copy(each, sources)
        link(command, files, target)

    wanted = AircraftFmu(RASCAL, RASCAL / "autopilot.param", [20.0], targets=OTHERS, zig=Path(ZIG))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(aircraft_fmu, "link_library", keep)
        made = make_fmu(wanted)
    (folder / "it.fmu").write_bytes(made.data)
    with zipfile.ZipFile(folder / "it.fmu") as archive:
        archive.extractall(folder)
    return made, folder / "binaries", sources


def test_libraries_are_small_and_without_python(built):
    made, folder, _ = built
    assert len(made.sizes) == len(OTHERS)
    names = {f"fmi2{each}".encode() for each in ("DoStep", "GetFMUstate", "Instantiate")}
    for path, size in made.sizes.items():
        content = (folder.parent / path).read_bytes()
        assert size < MOST_BYTES, path
        assert not FOREIGN.search(content) and all(name in content for name in names)


def test_formats_are_those_of_the_platforms(built):
    _, folder, _ = built
    for name, machine in (("linux64", 62), ("aarch64-linux", 183)):
        content = (folder / name / "rascal110.so").read_bytes()
        assert content[:5] == b"\x7fELF\x02" and struct.unpack_from("<H", content, 18) == (machine,)
        needed = set(re.findall(rb"lib\w+\.so\.\d+", content))
        assert needed <= {b"libc.so.6", b"libm.so.6", b"libpthread.so.0", b"libdl.so.2"}
        versions = {tuple(map(int, each)) for each in re.findall(rb"GLIBC_(\d+)\.(\d+)", content)}
        assert versions and max(versions) <= (2, 17)
    content = (folder / "win64" / "rascal110.dll").read_bytes()
    (at,) = struct.unpack_from("<I", content, 60)
    assert content[:2] == b"MZ" and content[at : at + 6] == b"PE\0\0\x64\x86"
    assert struct.unpack_from("<H", content, at + 22)[0] & 0x2000  # a DLL
    imported = set(re.findall(rb"[\w-]+\.dll", content)) - {b"rascal110.dll"}
    assert imported and all(re.match(rb"KERNEL32|api-ms-win-crt", each) for each in imported)
    content = (folder / "darwin64" / "rascal110.dylib").read_bytes()
    magic, count = struct.unpack_from(">II", content)
    assert (magic, count) == (0xCAFEBABE, 2)
    for k, processor in enumerate((0x01000007, 0x0100000C)):
        kind, _, at, size, _ = struct.unpack_from(">IIIII", content, 8 + 20 * k)
        one = content[at : at + size]
        head = struct.unpack_from("<IIIII", one)
        assert (kind, head[0], head[1], head[3]) == (processor, 0xFEEDFACF, processor, 6)
        assert set(re.findall(rb"/usr/lib/\w[\w.]*dylib", one)) == {b"/usr/lib/libSystem.B.dylib"}
        assert k == 0 or 0x1D in commands_of(one, head[4])  # signed, which ARM requires


def commands_of(library, count):
    """Kinds of the load commands of a library of macOS."""
    found, at = [], 32
    for _ in range(count):
        kind, size = struct.unpack_from("<II", library, at)
        found.append(kind)
        at += size
    return found


def commands():
    time_s = 0.02 * np.arange(3000)
    roll = 0.6 * np.sin(0.31 * time_s) * np.where(time_s < 30.0, 1.0, -1.0)
    pitch, throttle = 0.08 * np.sin(0.7 * time_s), 0.5 + 0.3 * np.sin(0.2 * time_s)
    return np.stack([pitch, roll, throttle], axis=-1)


@pytest.fixture(scope="module")
def positions():
    """Those of the testbed, 60 s long."""
    aircraft, found = testbed.Aircraft("rascal110", airspeed_mps=20.0), []
    for each in commands().tolist():
        found.append(aircraft.step(*each).position_ned)
    return np.array(found)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the library is for x86-64")
def test_library_for_old_linux_flies_the_same_numbers(built, positions, tmp_path):
    instance = Instance(Archive(built[0].data, tmp_path)).begin()
    names, found = [f"position_ned[{k}]" for k in (1, 2, 3)], []
    for each in commands().tolist():
        instance.set(COMMAND, each)
        instance.step()
        found.append(instance.get(names))
    np.testing.assert_array_equal(found, positions)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the object file is for x86-64")
def test_another_mathematics_differs_by_rounding(built, positions, tmp_path):
    """With the C library musl, in a program of its own: 60 s without Python."""
    _, _, sources = built
    root = Archive(built[0].data, tmp_path).reals["position_ned[1]"]
    (sources / "driver.c").write_text(f"#define FIRST {root}\n{DRIVER}")
    line = [ZIG, "cc", "-target", "x86_64-linux-musl", "-static", "-O2", "-o", "driver"]
    built_ = subprocess.run(
        [*line, "driver.c", "flight.o", "-lm"], cwd=sources, capture_output=True, text=True
    )
    assert built_.returncode == 0, built_.stderr
    done = subprocess.run(
        [str(sources / "driver")],
        input=commands().tobytes(),
        capture_output=True,
        timeout=TIMEOUT_S,
        check=True,
    )
    found = np.frombuffer(done.stdout).reshape(-1, 3)
    assert found.shape == positions.shape
    worst = np.abs(found - positions).max()
    assert 0.0 < worst < 1e-9 and math.isfinite(worst)
