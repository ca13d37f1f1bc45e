"""Platforms that an FMU has a library for."""

from __future__ import annotations

import platform
from typing import NamedTuple

from llvmlite import binding


class Target(NamedTuple):
    """A platform."""

    folder: str  # below binaries/ of an FMU, by the standard
    suffix: str  # of a library
    triples: tuple[str, ...]  # of LLVM; of several the library has the code of each
    zig: tuple[str, ...]  # the same for zig; empty: the C compiler of this machine
    words: str  # what it runs on


THIS = "host"
_FOLDERS = {("Linux", "x86_64"): "linux64", ("Darwin", "x86_64"): "darwin64"}
_FOLDERS[("Darwin", "arm64")] = "darwin64"


def _host() -> Target:
    """Return the target of this machine, Linux or macOS."""
    system, machine = platform.system(), platform.machine()
    folder = _FOLDERS.get((system, machine), f"{machine}-{system.lower()}")
    words = f"{system}, {machine}, as new as this one"
    if system == "Darwin":
        return Target(folder, ".dylib", (f"{machine}-apple-macosx11.0.0",), (), words)
    own: str = binding.get_process_triple()
    return Target(folder, ".so", (own,), (), words)


def targets() -> dict[str, Target]:
    """Return the targets by their names."""
    return {
        THIS: _host(),
        "linux-x86-64": Target(
            "linux64",
            ".so",
            ("x86_64-unknown-linux-gnu",),
            ("x86_64-linux-gnu.2.17",),
            "Linux of 2014 and later, glibc 2.17",
        ),
        # FMI 2.0 has no name for it; this is that of FMI 3.0
        "linux-arm64": Target(
            "aarch64-linux",
            ".so",
            ("aarch64-unknown-linux-gnu",),
            ("aarch64-linux-gnu.2.17",),
            "Linux on 64-bit ARM, glibc 2.17",
        ),
        "macos": Target(
            "darwin64",
            ".dylib",
            ("x86_64-apple-macosx11.0.0", "arm64-apple-macosx11.0.0"),
            ("x86_64-macos.11.0", "aarch64-macos.11.0"),
            "macOS 11 and later, both processors",
        ),
        "windows": Target(
            "win64",
            ".dll",
            ("x86_64-w64-windows-gnu",),
            ("x86_64-windows-gnu",),
            "Windows 10 and later",
        ),
    }
