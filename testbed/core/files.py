"""Write output files: a regular file is replaced whole or not at all.

Anything else is written straight.

Symbolic links are followed. The new content of a regular file is written in a folder beside it,
`.testbed-XXXXXXXX.part`, and moved into place in one step: readers see the old file or the new one,
and after any failure the old one. What a killed process left of such folders is removed by the
next output into the same folder. A device, a pipe and a file to which standard output is redirected
get their content in one piece at the end.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO, TextIO, cast

from testbed.core.errors import InputError

_PREFIX, _SUFFIX = ".testbed-", ".part"
_PART = re.compile(r"\.testbed-[a-z0-9_]{8}\.part")
_PIECE_BYTES = 1 << 20
_SPOOL_BYTES = 1 << 26  # in memory; a larger output to a pipe is collected in a temporary file
_REDIRECTED = (1, 2)  # standard output and error, which may be files


class OutputPathError(OSError):
    """A path at which no file can be written; `strerror` is the whole reason."""


@contextmanager
def report_write_errors(target: object) -> Iterator[None]:
    """Turn an OSError in the block into an InputError.

    Args:
        target: the option and its path, or the path, as the message begins.

    Raises:
        InputError: a file cannot be written.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if not isinstance(error, OutputPathError):
            reason = f"cannot be written: {reason}"
        raise InputError(f"{target}: {reason}") from error


@contextmanager
def write_file(path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a binary file that gets its content when the block ends without an error.

    Args:
        path: of the file, device or pipe.
        durable: wait until a regular file is on the disk before it replaces the old one.

    Raises:
        OSError: it cannot be written; a regular file is as before.
    """
    check_writable(path)
    if _is_replaceable(path):
        with replacement(path) as new, new.open("wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
    else:
        with tempfile.SpooledTemporaryFile(_SPOOL_BYTES) as spool:
            yield cast("BinaryIO", spool)
            spool.seek(0)
            _send(spool, path)


@contextmanager
def write_text_file(path: Path) -> Iterator[TextIO]:
    """Open a text file as `write_file` does: UTF-8, lines end as they are written."""
    with write_file(path) as binary:
        text = io.TextIOWrapper(
            # surrogates, as in the name of a file that is not UTF-8, are written as escapes
            binary,
            encoding="utf-8",
            errors="backslashreplace",
            newline="",
        )
        yield text
        text.detach()  # which flushes it


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """Give the path of a new file that replaces `path` without an error.

    For programs and libraries that open files by their names. The new file does not exist yet.

    Raises:
        OSError: it cannot be written; a regular file at `path` is as before.
    """
    check_writable(path)
    replaceable = _is_replaceable(path)
    target = Path(os.path.realpath(path))
    with _part_folder(target.parent if replaceable else Path(tempfile.gettempdir())) as folder:
        new = folder / path.name
        with _errors_name(path, new):
            yield new
        if not new.exists():  # the program that should have made it gave no reason
            raise OutputPathError(errno.EIO, "cannot be written")
        if replaceable:
            _copy_owner_and_mode(target, new)
            os.replace(new, target)
        else:
            with new.open("rb") as file:
                _send(file, path)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give the path of a new folder that becomes `path` without an error.

    Raises:
        OSError: `path` exists, or it cannot be created.
    """
    if os.path.lexists(path):
        raise OutputPathError(errno.EEXIST, "it exists; remove it or write another name")
    check_writable(path)
    with _part_folder(Path(os.path.realpath(path)).parent) as folder:
        new = folder / path.name
        with _errors_name(path, new):
            yield new
        os.rename(new, path)


@contextmanager
def _errors_name(path: Path, new: Path) -> Iterator[None]:
    """Name the path that the user knows in errors about the new file."""
    try:
        yield
    except InputError as error:
        error.args = tuple(str(each).replace(str(new), str(path)) for each in error.args)
        raise


def create_file(path: Path, data: bytes) -> None:
    """Write a file that must not exist; after a failure it does not exist.

    Raises:
        FileExistsError: it exists.
        OSError: it cannot be written.
    """
    with open(path, "xb", buffering=0) as file:
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[file.write(rest) :]
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def check_writable(path: Path) -> None:
    """Check that a file can be written, without changing anything.

    Raises:
        OSError: it cannot; `strerror` is the reason.
    """
    try:
        status = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        status = None
    if status and stat.S_ISDIR(status.st_mode):
        raise OutputPathError(errno.EISDIR, "this is a folder; write the name of a file")
    if status and _descriptor(path) is not None:
        return
    if status and not _may(path, os.W_OK):
        raise _access_error(Path(path))
    if status is None or stat.S_ISREG(status.st_mode):
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise OutputPathError(errno.ENOENT, f"there is no folder {folder}")
        if not _may(folder, os.W_OK | os.X_OK):
            raise _access_error(folder)


def check_folder_writable(path: Path) -> None:
    """Check that files can be written to a folder, or it can be created.

    Raises:
        OSError: they cannot; `strerror` is the reason.
    """
    for each in (path, *path.absolute().parents):
        try:
            status = os.stat(each)
        except FileNotFoundError:
            continue
        if not stat.S_ISDIR(status.st_mode):
            name = "this" if each == path else str(each)
            raise OutputPathError(errno.ENOTDIR, f"{name} is a file; write the name of a folder")
        if not _may(each, os.W_OK | os.X_OK):
            raise _access_error(each)
        return


def format_bytes(count: float) -> str:
    """Format a size, in bytes, kB, MB or GB."""
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB"):
        if size < 999.5:
            break
        size, unit = size / 1e3, larger
    return f"{size:.1f} {unit}" if size < 9.95 and unit != "bytes" else f"{size:,.0f} {unit}"


def lock_file(file: IO[Any] | int) -> bool:
    """Lock an open file until it is closed; return whether it is locked.

    False: it is locked by another opener, in any process of this machine. A file system without
    locks counts as locked.

    Args:
        file: the file or its descriptor, also of a folder.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def unlock_file(file: IO[Any]) -> None:
    """Unlock a file before it is closed: a forked child, which has it too, would hold the lock."""
    with suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_UN)


def reserve_standard_descriptors() -> tuple[int, ...]:
    """Open the null device for standard input, output and error where they are closed.

    A file opened later would otherwise get their numbers, and with it what libraries print.

    Returns:
        The descriptors that were closed.
    """
    closed = []
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest free number
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)
            os.set_inheritable(descriptor, True)
            closed.append(descriptor)
    return tuple(closed)


def _is_replaceable(path: Path) -> bool:
    """Return whether a path is a regular file or does not exist."""
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return True
    return stat.S_ISREG(status.st_mode) and _descriptor(path) is None


def _descriptor(path: Path) -> int | None:
    """Return the descriptor of standard output or error that has this file open, or None."""
    for descriptor in _REDIRECTED:
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                return descriptor
    return None


def _send(source: IO[bytes], path: Path) -> None:
    """Write the rest of a file to a device, a pipe or an open descriptor."""
    descriptor = _descriptor(path)
    if descriptor is None:
        target = os.open(path, os.O_WRONLY | os.O_NOCTTY)
    else:
        target = os.dup(descriptor)
    # a reader of standard output, such as `head`, may have enough
    ignored = () if descriptor is None else (BrokenPipeError,)
    with suppress(*ignored), open(target, "wb", buffering=0) as file:
        while piece := source.read(_PIECE_BYTES):
            rest = memoryview(piece)
            while rest:
                rest = rest[file.write(rest) :]


def _may(path: Path, mode: int) -> bool:
    return os.access(path, mode, effective_ids=os.access in os.supports_effective_ids)


def _access_error(path: Path) -> OutputPathError:
    if os.statvfs(path).f_flag & os.ST_RDONLY:
        return OutputPathError(errno.EROFS, f"{path} is on a read-only file system")
    return OutputPathError(errno.EACCES, f"no permission to write {path}")


def _copy_owner_and_mode(old: Path, new: Path) -> None:
    """Give a new file the owner and the mode of an existing one."""
    try:
        status = old.stat()
    except FileNotFoundError:
        return
    with suppress(OSError):  # only root can give files away
        os.chown(new, status.st_uid, status.st_gid)
    os.chmod(new, stat.S_IMODE(status.st_mode))


@contextmanager
def _part_folder(parent: Path) -> Iterator[Path]:
    """Make a folder for new files, locked while it is used and removed afterwards."""
    _remove_abandoned(parent)
    folder, lock = _make_locked(parent)
    try:
        yield folder
    finally:
        _remove(folder)
        os.close(lock)


def _make_locked(parent: Path) -> tuple[Path, int]:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, suffix=_SUFFIX, dir=parent))
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:  # another process has found it before it was locked
            continue
        if lock_file(lock) and folder.is_dir():
            return folder, lock
        os.close(lock)  # another process is removing it


def _remove_abandoned(parent: Path) -> None:
    """Remove the folders of processes that were killed: those that are not locked."""
    with suppress(OSError), os.scandir(parent) as entries:
        for entry in [each for each in entries if _PART.fullmatch(each.name)]:
            with _locked_abandoned(Path(entry.path)) as abandoned:
                if abandoned:
                    _remove(Path(entry.path))


def is_abandoned(folder: Path) -> bool:
    """Return whether a folder is one that a killed process of the testbed has left."""
    with _locked_abandoned(folder) as abandoned:
        return abandoned


@contextmanager
def _locked_abandoned(folder: Path) -> Iterator[bool]:
    """Lock a folder of the testbed that no process uses; yield whether it is one.

    There is at most one new file in it, or a new folder.
    """
    lock = None
    try:
        if _PART.fullmatch(folder.name):
            with suppress(OSError):  # also where there are no locks
                lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                yield len(os.listdir(folder)) <= 1
                return
        yield False
    finally:
        if lock is not None:
            os.close(lock)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
