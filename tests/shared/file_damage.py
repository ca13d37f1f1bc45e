"""Kinds of damage to a kept file: by crashes, full disks, copies, other programs, other users."""

import os
import pickle
import random
import shutil
import stat
from pathlib import Path

MARK = "TESTBED_TEST_MARK"  # in the environment: a file that a planted pickle would make


class Planted:
    """Makes a file where it is unpickled."""

    def __reduce__(self):
        return (exec, (f"import os; open(os.environ[{MARK!r}], 'w').close()",))


def _cut(share):
    def damage(path, others, rng):
        os.truncate(path, int(path.stat().st_size * share))

    return damage


def _put(content):
    def damage(path, others, rng):
        path.write_bytes(content)

    return damage


def _flip(low, high):
    """Flip a bit at a place between two shares of the file."""

    def damage(path, others, rng):
        data = bytearray(path.read_bytes())
        if not data:
            return  # the file of a lock
        at = min(int(rng.uniform(low, high) * len(data)), len(data) - 1)
        data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)

    return damage


def _random(path, others, rng):
    path.write_bytes(rng.randbytes(3000))


def _same_head(path, others, rng):
    data = path.read_bytes()
    path.write_bytes(data[:60] + rng.randbytes(max(len(data) - 60, 60)))


def _append(path, others, rng):
    with path.open("ab") as file:
        file.write(b"\0")


def _lose_last(path, others, rng):
    os.truncate(path, max(path.stat().st_size - 1, 0))


def _zeros(path, others, rng):
    path.write_bytes(bytes(path.stat().st_size))


def _grow(path, others, rng):
    os.truncate(path, 10**12)  # has no blocks


def _folder(path, others, rng):
    path.unlink()
    path.mkdir()


def _full_folder(path, others, rng):
    _folder(path, others, rng)
    (path / "notes.txt").touch()


def _dangling(path, others, rng):
    path.unlink()
    path.symlink_to(path.parent / "nothing")


def _linked(path, others, rng):
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def _pipe(path, others, rng):
    path.unlink()
    os.mkfifo(path)


def _exchange(path, others, rng):
    """Put another kept file in its place, as it is."""
    shutil.copyfile(rng.choice(others), path) if others else path.unlink()


def _unreadable(path, others, rng):
    path.chmod(0)
    _pretend_other_owner(path)


def _pretend_other_owner(path):
    if not os.geteuid():
        os.chown(path, 65534, 65534)


def _writable_for_all(path, others, rng):
    path.chmod(0o666)


def _foreign(path, others, rng):
    """Give it to another user; who is not root makes it writable for that user."""
    _pretend_other_owner(path) if not os.geteuid() else path.chmod(0o666)


KINDS = {
    "missing": lambda path, others, rng: path.unlink(),
    "empty": _cut(0.0),
    "a tenth": _cut(0.1),
    "half": _cut(0.5),
    "without its last byte": _lose_last,
    "with another byte": _append,
    "zeros": _zeros,
    "random bytes": _random,
    "random content": _same_head,
    "bit of the head": _flip(0.0, 1e-4),
    "bit of the first half": _flip(0.0, 0.5),
    "bit of the second half": _flip(0.5, 1.0),
    "another pickle": _put(pickle.dumps({"a": 1})),
    "a planted pickle": _put(pickle.dumps(Planted())),
    "text": _put(b"not machine code\n"),
    "JSON": _put(b'{"compared": 0, "unequal": "wrong"}'),
    "terabyte": _grow,
    "a folder": _folder,
    "a full folder": _full_folder,
    "a dangling link": _dangling,
    "a link": _linked,
    "a pipe": _pipe,
    "another file": _exchange,
    "not readable": _unreadable,
    "writable for all": _writable_for_all,
    "another user's": _foreign,
}


def damage(kind: str, folder: Path, seed: int = 1) -> int:
    """Damage each file of a folder in one way; return how many there were."""
    rng = random.Random(f"{kind} {seed}")
    files = sorted(each for each in folder.rglob("*") if stat.S_ISREG(each.lstat().st_mode))
    intact = folder.with_name(f"{folder.name}-intact")
    shutil.copytree(folder, intact)
    for path in files:
        others = [each for each in sorted(intact.rglob("*.code")) if each.name != path.name]
        KINDS[kind](path, others, rng)
    shutil.rmtree(intact)
    return len(files)
