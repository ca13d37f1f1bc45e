"""The record of the files that the testbed wrote into a folder, and what follows from it.

`.testbed-files` beside the files has a line of JSON for each: name, size, time of change and
SHA-256. A file is the testbed's if it is as recorded. One that no line names is the testbed's only
if its name is exact and its content proves it: runs that were killed or are older than the record.
All other files are the user's: they are neither deleted nor replaced unasked.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.core.files import is_abandoned
from testbed.core.input_files import open_regular, parse_json_map, read_bounded
from testbed.logs.header import CODE_SUFFIX
from testbed.logs.mcap_file import TAIL_NAME as TAIL_METADATA
from testbed.logs.mcap_file import has_own_header, read, read_attachments, tail_path
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.metrics.document import timeless_json, to_json

RECORD_NAME = ".testbed-files"
TAIL_NAME = tail_path(Path(LOG_NAME)).name
_MAX_RECORD_BYTES = 10_000_000
_PIECE_BYTES = 1 << 20
_MAX_PROOF_BYTES = 100_000_000  # of a file that its content proves to be the testbed's
_KEYS = {"name": str, "size": int, "changed_ns": int, "sha256": str}


def record_files(folder: Path, *names: str) -> None:
    """Record files of a folder, or folders in it with all their files, as written just now.

    Names without a file are left out. What cannot be recorded, as on a full disk, is the user's
    from then on.
    """
    with suppress(OSError, InputError):
        found = [each for name in names for each in _names_below(folder, name)]
        lines = [_describe(folder, each) for each in found]
        if lines:
            if os.path.lexists(folder / RECORD_NAME) and not _is_own(folder, RECORD_NAME, {}):
                return  # a file of the user has its name
            # a line of its own, also after one that was cut; one write, as others may append
            text = "".join(f"\n{json.dumps(each)}" for each in lines) + "\n"
            flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
            handle = os.open(folder / RECORD_NAME, flags | os.O_CLOEXEC, 0o666)
            try:
                status = os.fstat(handle)  # a file with another name too may be the user's
                if stat.S_ISREG(status.st_mode) and status.st_nlink == 1:
                    os.write(handle, text.encode())
            finally:
                os.close(handle)


def record_output(path: Path, *, default: bool) -> None:
    """Record the output of a command.

    Args:
        path: of the file or folder.
        default: nobody named it. A path that an option named is recorded in a run directory only.
    """
    if default or os.path.isfile(path.parent / RECORD_NAME):
        record_files(path.parent, path.name)


def check_default_output(path: Path, remedy: str) -> Path:
    """Return the path of an output that no option names.

    Args:
        path: of the output.
        remedy: end of the error: what to write instead.

    Raises:
        InputError: the file there is not as the testbed wrote it.
    """
    if os.path.lexists(path) and not _is_own(path.parent, path.name, _read_record(path.parent)):
        raise InputError(f"{path}: exists, and is not as the testbed wrote it; {remedy}")
    return path


def check_folder_output(folder: Path, names: Iterable[str], option: str) -> None:
    """Check that a command may write files into a folder that an option names.

    Args:
        folder: new, empty, or with files.
        names: of the files.
        option: with its value, as the error begins.

    Raises:
        InputError: one of the files exists and is not as the testbed wrote it.
    """
    base, prefix = _record_place(folder)
    record = _read_record(base)
    for name in names:
        path = folder / name
        if os.path.lexists(path) and not _is_own(base, prefix + name, record):
            raise InputError(
                f"{option}: {path} exists, and is not as the testbed wrote it; move it, or name "
                "another folder"
            )


def record_folder_output(folder: Path, names: Iterable[str]) -> None:
    """Record files that a command wrote into a folder that an option names."""
    base, prefix = _record_place(folder)
    record_files(base, *(prefix + name for name in names))


def _record_place(folder: Path) -> tuple[Path, str]:
    """Return the folder of the record of another one's files, and the prefix of their names.

    A folder in a run directory has no record of its own: `prune` deletes it with the run.
    """
    folder = folder.resolve()
    if os.path.isfile(folder.parent / RECORD_NAME) and not os.path.lexists(folder / RECORD_NAME):
        return folder.parent, f"{folder.name}/"
    return folder, ""


def delete_tail(log: Path) -> None:
    """Delete the tail of a log, which nothing reads once the log is finished.

    A file of the user that has its name stays.
    """
    path = tail_path(log)
    with suppress(OSError, InputError):
        if stat.S_ISREG(path.lstat().st_mode) and _is_tail(path):
            path.unlink()


def foreign_files(folder: Path) -> tuple[str, ...]:
    """Return what is the user's in a folder: names relative to it, of empty folders with a /."""
    record = _read_record(folder)
    return tuple(name for name in _entries(folder) if not _is_own(folder, name, record))


def delete_folder(folder: Path) -> None:
    """Delete a run directory that has no foreign files; what makes it a run goes last.

    Raises:
        OSError: something cannot be deleted; `filename` is its path.
    """
    last = (LOG_NAME, METRICS_NAME, RECORD_NAME, SCENARIO_NAME)
    names = [name for name in _entries(folder) if name not in last]
    for name in (*names, *last):
        if not name.endswith("/"):
            (folder / name).unlink(missing_ok=name in last)
    for here, _, _ in os.walk(folder, topdown=False):
        os.rmdir(here)


def _entries(folder: Path, prefix: str = "") -> Iterator[str]:
    """Yield the names of all files below a folder, and of empty or closed folders with a /."""
    try:
        found = sorted(os.scandir(folder / prefix), key=lambda each: each.name)
    except OSError:
        found = []
    for each in found:
        if each.is_dir(follow_symlinks=False):
            yield from _entries(folder, f"{prefix}{each.name}/")
        else:
            yield prefix + each.name
    if prefix and not found:
        yield prefix


def _names_below(folder: Path, name: str) -> list[str]:
    """Return the name of a file, or of all files in a folder, relative to the folder of both."""
    path = folder / name
    if path.is_dir():
        return [each for each in _entries(folder, f"{name}/") if each[-1] != "/"]
    return [name] if path.exists() else []


def _describe(folder: Path, name: str) -> dict[str, Any]:
    status = (folder / name).lstat()
    digest = _digest(folder / name, status.st_size)
    values = (name, status.st_size, status.st_mtime_ns, digest)
    return dict(zip(_KEYS, values, strict=True))


def _digest(path: Path, size: int) -> str:
    digest = hashlib.sha256()
    with open_regular(path, size) as file:
        while piece := file.read(_PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()


def _read_record(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the last line of each file; lines that are damaged or cut are left out."""
    record: dict[str, dict[str, Any]] = {}
    with suppress(InputError):
        for line in read_bounded(folder / RECORD_NAME, _MAX_RECORD_BYTES).splitlines():
            if (entry := _parse(line)) is not None:
                record[entry["name"]] = entry
    return record


def _parse(line: bytes) -> dict[str, Any] | None:
    with suppress(ValueError):
        entry = parse_json_map(line)
        if entry.keys() == _KEYS.keys():
            if all(type(entry[key]) is kind for key, kind in _KEYS.items()):
                return entry
    return None


def _is_own(folder: Path, name: str, record: dict[str, dict[str, Any]]) -> bool:
    path, (top, below, _) = folder / name, name.partition("/")
    if below and is_abandoned(folder / top):
        return True
    with suppress(OSError, InputError, ValueError):
        status = path.lstat()
        if not stat.S_ISREG(status.st_mode):
            return False
        if name not in record:
            return _is_proven(path, name)
        size, changed_ns, digest = (record[name][key] for key in list(_KEYS)[1:])
        if status.st_size != size:
            return False
        # a copy has another time; to digest every file of many runs would take long
        return bool(status.st_mtime_ns == changed_ns or _digest(path, size) == digest)
    return False


def _is_tail(path: Path) -> bool:
    """Return whether a file is the tail of a log.

    Raises:
        LogError: it is no log.
    """
    return read(path).metadata.keys() == {TAIL_METADATA}


def _is_proven(path: Path, name: str) -> bool:
    """Return whether the content of a file that is not recorded is the testbed's.

    Raises:
        InputError, ValueError: it is not.
    """
    if name == RECORD_NAME:
        *lines, last = read_bounded(path, _MAX_RECORD_BYTES).split(b"\n")
        cut = last.startswith(b"{") or not last
        return cut and all(not line or _parse(line) is not None for line in lines)
    if name == LOG_NAME:
        return has_own_header(path)
    if name == TAIL_NAME:
        return _is_tail(path)
    if name in (METRICS_NAME, SCENARIO_NAME) or ("/" not in name and name.endswith(CODE_SUFFIX)):
        data = read_bounded(path, _MAX_PROOF_BYTES)
        if name == METRICS_NAME:
            metrics = parse_json_map(data)
            if to_json(metrics).encode() != data:
                return False
            data = timeless_json(metrics).encode()
        return read_attachments(path.with_name(LOG_NAME)).get(name) == data
    return False
