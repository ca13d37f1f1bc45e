"""The archive of an FMU: read as a ZIP file whose entries are checked before any is used.

Source: FMI 2.0.4, section 2.3, and FMI 3.0.1, section 2.5.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import stat
import sys
import tempfile
import weakref
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path, PurePosixPath
from shutil import rmtree

from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded

SUFFIX = ".fmu"
MAX_BYTES = 64_000_000  # of the archive, and of all that is in it
MAX_ENTRIES = 5_000
MAX_DESCRIPTION_BYTES = 8_000_000
DESCRIPTION = "modelDescription.xml"
_PIECE = 1 << 20
_STORED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_KINDS = (0, stat.S_IFREG, stat.S_IFDIR)  # 0: of a program that stores no mode
_BROKEN = zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError, RuntimeError
_SYSTEMS = {"Linux": ("linux", ".so"), "Darwin": ("darwin", ".dylib"), "Windows": ("win", ".dll")}
_MACHINES = {"AMD64": "x86_64", "arm64": "aarch64"}


class Archive:
    """An FMU that has been read and whose entries are checked.

    Attributes:
        path: of the file.
        data: its bytes.
        digest: SHA-256 of them, in hexadecimal digits.
        names: of all files in it.
    """

    def __init__(self, path: Path) -> None:
        """Read and check an archive; nothing is unpacked.

        Raises:
            InputError: it cannot be read, is no ZIP file, is too large, or has an entry that is no
                plain file inside of it; the text begins with the path.
        """
        self.path, self._process = path, os.getpid()
        self._removal: weakref.finalize[..., Archive] | None = None
        self.data = read_bounded(path, MAX_BYTES, error=InputError)
        self.digest = hashlib.sha256(self.data).hexdigest()
        try:
            self._zip = zipfile.ZipFile(io.BytesIO(self.data))
            entries = self._zip.infolist()
        except (*_BROKEN, ValueError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: is no FMU: {error} (write a ZIP file of FMI)") from error
        if len(entries) > MAX_ENTRIES:
            raise InputError(f"{path}: has {len(entries)} entries (an FMU has {MAX_ENTRIES} here)")
        if sum(each.file_size for each in entries) > MAX_BYTES:
            raise InputError(f"{path}: is larger than {MAX_BYTES // 10**6} MB when it is unpacked")
        self._entries: dict[str, zipfile.ZipInfo] = {}
        for each in entries:
            if reason := _why_refused(each):
                raise InputError(f"{path}: entry {each.filename[:80]!r} {reason}")
            if each.is_dir():
                continue
            if each.filename in self._entries:
                raise InputError(f"{path}: has two entries {each.filename[:80]!r}")
            self._entries[each.filename] = each
        self.names = tuple(self._entries)
        if DESCRIPTION not in self._entries:
            raise InputError(f"{path}: has no {DESCRIPTION} (write an FMU of FMI 2.0 or 3.0)")

    def read(self, name: str, limit: int = MAX_BYTES) -> bytes:
        """Return the content of an entry.

        Raises:
            InputError: it is damaged, or larger than `limit` or than its size in the archive.
        """
        entry = self._entries[name]
        limit = min(limit, entry.file_size)
        pieces, size = list[bytes](), 0
        try:
            with self._zip.open(entry) as file:
                while piece := file.read(_PIECE):
                    size += len(piece)
                    if size > limit:
                        raise InputError(f"{self.path}: {name} is larger than {limit} bytes")
                    pieces.append(piece)
        except _BROKEN as error:
            raise InputError(f"{self.path}: {name} is damaged: {error}") from error
        if entry.file_size > limit:
            raise InputError(f"{self.path}: {name} is larger than {limit} bytes")
        return b"".join(pieces)

    def binary_name(self, version: int, identifier: str) -> str:
        """Return the entry of the binary of this platform.

        Args:
            version: of FMI, 2 or 3.
            identifier: modelIdentifier, the name of the binary.

        Raises:
            InputError: there is none; the text has the platforms that there are.
        """
        folder, suffix = platform_of(version)
        name = f"binaries/{folder}/{identifier}{suffix}"
        if name in self._entries:
            return name
        others = sorted({each.split("/")[1] for each in self.names if each.startswith("binaries/")})
        raise InputError(
            f"{self.path}: has no {name} (it has {', '.join(others) or 'no binaries'}; export it "
            "for this platform)"
        )

    def unpack(self, binary: str) -> Path:
        """Unpack a binary with its folder, and the resources, into a folder of this process.

        The folder is for this account alone. It is removed by `remove`, or at the end of the
        process; not by a forked process.
        """
        beside = f"{binary.rpartition('/')[0]}/"
        folder = Path(tempfile.mkdtemp(prefix="testbed-fmu-"))
        self._removal = weakref.finalize(self, _remove, folder, os.getpid())
        (folder / "resources").mkdir()
        for name in self.names:
            if name.startswith((beside, "resources/")):
                file = folder / name
                file.parent.mkdir(parents=True, exist_ok=True)
                with open(file, "xb") as out:  # of a new folder: no link is followed
                    out.write(self.read(name))
                file.chmod(0o700 if name.startswith(beside) else 0o600)
        return folder

    def remove(self) -> None:
        """Remove what was unpacked; repeatable."""
        if self._removal is not None and os.getpid() == self._process:
            self._removal()

    @property
    def has_resources(self) -> bool:
        """Whether there are files that instances may read."""
        return any(each.startswith("resources/") for each in self.names)


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # else of a fork, whose parent still needs it
        with suppress(OSError):
            rmtree(folder)


def _why_refused(entry: zipfile.ZipInfo) -> str:
    """Return what is wrong with an entry; "": nothing."""
    name = entry.filename
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or any(c in name for c in "\\:\0"):
        return "leads out of the archive"
    if stat.S_IFMT(entry.external_attr >> 16) not in _KINDS:
        return "is no plain file (write the file in place of a link)"
    if entry.flag_bits & 1:
        return "is encrypted"
    if entry.compress_type not in _STORED:
        return "has another compression than ZIP's deflate"
    return ""


def platform_of(version: int) -> tuple[str, str]:
    """Return the folder of binaries for this platform, and the suffix of their names.

    Args:
        version: of FMI, 2 or 3.
    """
    system, suffix = _SYSTEMS.get(platform.system(), ("unknown", ".so"))
    machine = _MACHINES.get(platform.machine(), platform.machine())
    system = {"win": "windows"}.get(system, system) if version == 3 else system
    if version == 3 or machine != "x86_64":
        return f"{machine}-{system}", suffix
    return f"{system}{64 if sys.maxsize > 2**32 else 32}", suffix
