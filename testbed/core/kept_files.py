"""Files that the testbed keeps for itself between runs, such as machine code and proofs.

A kept file that is missing, damaged or of another user is a miss: its content is made anew, and
replaces it. Reading raises no error, and nothing in a file is used before its checksum is compared.

A folder is used only if no other user may write it. That is decided on the open folder, by which
its files are then read: neither a link nor a renamed folder can lead elsewhere later.
"""

from __future__ import annotations

import errno
import functools
import grp
import hashlib
import os
import pwd
import secrets
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

MAX_BYTES = 256_000_000  # of a kept file
REPORTED = "TESTBED_KEPT_FILES_REPORTED"  # in the environment of a process whose parent has warned
_MAGIC = b"testbed kept file 1\n"
_HEAD_BYTES = len(_MAGIC) + hashlib.sha256().digest_size
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_NOFOLLOW | os.O_CLOEXEC
_CREATE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_ACL = "system.posix_acl_access"


class Place(NamedTuple):
    """A folder that may hold a folder of kept files."""

    path: Path
    mode: int = 0o700  # of the folder of kept files, where it is made
    variable: str = ""  # of the environment that names it


class KeptFiles:
    """Kept files in folders of one name.

    Attributes:
        folder: to which files are written; None: no folder can be written.
    """

    def __init__(self, name: str, opened: Iterable[tuple[Path, int]], folder: Path | None) -> None:
        """Use folders that are open; see `open_kept_files`.

        Args:
            name: of each folder.
            opened: folders, with their descriptors.
            folder: that can be written; one of these, or None.
        """
        self._name, self._opened, self.folder = name, dict(opened), folder

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders that are read."""
        return tuple(self._opened)

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None: there is none that is whole and can be trusted."""
        for folder in self._opened.values():
            with suppress(OSError, MemoryError):
                data = _read_trusted(folder, name)
                head, content = data[:_HEAD_BYTES], data[_HEAD_BYTES:]
                if head == _MAGIC + self._digest(name, content):
                    return content
        return None

    def write(self, name: str, content: bytes) -> None:
        """Write or replace a file in one step, unless that is impossible, as on a full disk."""
        if self.folder is None:
            return
        path, new = self.folder / name, self.folder / f".{secrets.token_hex(8)}.part"
        with suppress(OSError):
            handle = os.open(new, _CREATE, 0o644)
            try:
                with open(handle, "wb") as file:
                    file.write(_MAGIC + self._digest(name, content))
                    file.write(content)
                with suppress(OSError):  # an empty folder in its place
                    path.rmdir()
                new.replace(path)
            except BaseException:
                new.unlink(missing_ok=True)
                raise

    def _digest(self, name: str, content: bytes) -> bytes:
        """Return the checksum of a file, which is another in another place."""
        digest = hashlib.sha256(f"{self._name}/{name}\0".encode())
        digest.update(content)
        return digest.digest()


def open_kept_files(
    name: str, places: Iterable[Place], made: Callable[[Path, Path], None] = lambda *_: None
) -> KeptFiles:
    """Open the folders of kept files of a name, up to the first that can be written.

    Folders that other users may write are not used, nor is one that an environment variable names
    and that can neither be read nor written; a warning has the reason.

    Args:
        name: of the folder in each place.
        places: that may hold it, the first is preferred.
        made: called with the place and the folder, where the folder is new.
    """
    opened, folder = [], None
    for place in places:
        path = Path(os.path.realpath(place.path)) / name
        try:
            is_new = _make(path, place.mode)
        except (OSError, ValueError) as error:  # ValueError: NUL in the path
            _report_unusable(place, error)
            continue
        try:
            handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            _report_unusable(place, error)
            continue
        if reason := _distrust(path, handle, place):
            os.close(handle)
            _report(reason)
            continue
        path = Path(os.path.realpath(path))
        writable = _is_writable(path)
        opened.append((path, handle))
        if writable:
            folder = path
            if is_new:
                made(place.path, path)
            break
    return KeptFiles(name, opened, folder)


def _make(path: Path, mode: int) -> bool:
    """Make a folder unless it is there; return whether it is new."""
    if path.is_dir():
        return False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from None
    try:
        path.mkdir(mode)
    except FileExistsError:  # made by another process meanwhile, or no folder
        return False
    return True


def _is_writable(folder: Path) -> bool:
    """Return whether files can be made in a folder, and mark it as used."""
    try:
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
    except OSError:
        return False
    return True


def _read_trusted(folder: int, name: str) -> bytes:
    """Return the bytes of a regular file that no other user may write.

    Raises:
        OSError: there is none.
    """
    handle = os.open(name, _READ, dir_fd=folder)
    with open(handle, "rb") as file:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_BYTES:
            raise OSError
        if not _is_owner_trusted(status) or _may_others_write(status, handle):
            raise OSError
        return file.read(MAX_BYTES)


def _distrust(path: Path, handle: int, place: Place) -> str:
    """Return why an open folder is not used; empty: no other user may write it.

    In its parent other users may write if its sticky bit is set, as in /tmp: only the parent's
    owner, who is trusted, could rename or remove the folder there.
    """
    parent = path.parent
    above, status = os.stat(parent), os.fstat(handle)
    owned = "write a folder of your own to NUMBA_CACHE_DIR"
    for each, found in ((parent, above), (path, status)):
        if not _is_owner_trusted(found):
            return f"{path} is not used: {each} belongs to {_user_name(found.st_uid)} ({owned})"
    if not above.st_mode & stat.S_ISVTX and _may_others_write(above, parent):
        return (
            f"{path} is not used: other users may write {parent}, of mode "
            f"{stat.S_IMODE(above.st_mode):04o} (write chmod go-w {parent}, or {owned[6:]})"
        )
    if _may_others_write(status, handle):
        return (
            f"{path} is not used: other users may write it, as its mode is "
            f"{stat.S_IMODE(status.st_mode):04o} (remove it)"
        )
    return ""


def _is_owner_trusted(status: os.stat_result) -> bool:
    """Return whether a file is of this user, of root, or of the owner of the testbed's code."""
    return status.st_uid in _trusted_owners()


@functools.cache
def _trusted_owners() -> tuple[int, ...]:
    return os.geteuid(), 0, os.stat(__file__).st_uid


def _may_others_write(status: os.stat_result, path: Path | int) -> bool:
    """Return whether the mode of a file lets users write it that are not its owner."""
    if status.st_mode & stat.S_IWOTH:
        return True
    return bool(status.st_mode & stat.S_IWGRP) and not _is_group_private(status, path)


def _is_group_private(status: os.stat_result, path: Path | int) -> bool:
    """Return whether the owner of a file is the only member of its group.

    Where each user has a group of the same name, files are often writable for the group.
    """
    with suppress(OSError, AttributeError):  # there are none
        os.getxattr(path, _ACL)
        return False  # the bits of the group are those of other users
    try:
        owner, group = pwd.getpwuid(status.st_uid), grp.getgrgid(status.st_gid)
        users = {each.pw_uid for each in pwd.getpwall() if each.pw_gid == status.st_gid}
    except (KeyError, OSError):
        return False
    alone = owner.pw_gid == status.st_gid and group.gr_name == owner.pw_name
    return alone and users <= {status.st_uid} and set(group.gr_mem) <= {owner.pw_name}


def _user_name(uid: int) -> str:
    try:
        return f"the user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"the user {uid}"


def _report_unusable(place: Place, error: Exception) -> None:
    """Warn of a place that can be neither read nor written, if a variable names it."""
    if place.variable:
        reason = getattr(error, "strerror", None) or str(error)
        _report(f"{place.variable} {place.path} is not used: {reason} (write a folder of your own)")


def _report(text: str) -> None:
    if REPORTED not in os.environ:
        warnings.warn(text, stacklevel=2)
