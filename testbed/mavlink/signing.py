"""MAVLink 2 message signing: https://mavlink.io/en/guide/message_signing.html.

Signature times count 10 µs from the start of 2015, UTC.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import stat
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from testbed.core.errors import InputError
from testbed.core.input_files import MAX_KEY_BYTES, read_bounded_text

SIGNATURE_BYTES = 13  # link id, time and the truncated hash
_HASH_BYTES = 6
_EPOCH = 1420070400  # s, 2015-01-01 in Unix time
_PER_SECOND = 100_000
_MAX_TIME = (1 << 48) - 1
_MAX_AGE = 60 * _PER_SECOND  # of the first signature of a stream

Verdict = Literal["good", "unsigned", "forged", "replayed", "outdated"]


def signing_time(unix_s: float) -> int:
    """Convert Unix time, s, to the time of a signature, 10 µs."""
    return min(max(round((unix_s - _EPOCH) * _PER_SECOND), 0), _MAX_TIME)


def read_key(path: Path) -> bytes:
    """Read a secret key: 64 hexadecimal digits, or a passphrase, whose SHA-256 is the key.

    Raises:
        InputError: the file cannot be read, or contains no key.
    """
    text = read_bounded_text(path, MAX_KEY_BYTES).strip()
    if not text:
        raise InputError(f"{path}: empty; write a passphrase or 64 hexadecimal digits")
    if re.fullmatch(r"[0-9a-fA-F]{64}", text):
        return bytes.fromhex(text)
    if re.fullmatch(r"[0-9a-fA-F]{32,}", text):
        raise InputError(f"{path}: {len(text)} hexadecimal digits; write 64, or a passphrase")
    return hashlib.sha256(text.encode()).digest()


def check_key(name: str, key: object) -> None:
    """Check a secret key; no error shows it.

    Args:
        name: of the argument, as the error begins.
        key: its value.

    Raises:
        InputError: it is not 32 bytes.
    """
    if not isinstance(key, bytes):
        raise InputError(f"{name}: is a {type(key).__name__}; give 32 bytes, as of read_key")
    if len(key) != 32:
        raise InputError(f"{name}: {len(key)} bytes; give 32")


def is_shared(path: Path) -> bool:
    """Return whether others than its owner may read or write a key file."""
    return bool(path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))


@dataclass(frozen=True, slots=True)
class Signing:
    """Key, link id and first time of one end of a signed link.

    Attributes:
        key: 32 secret bytes, common to both ends.
        link: link id that this end signs with, 0 to 255.
        time: of the first signature, see `signing_time`; a receiver rejects times that are not
            later than the last one of the same sender and link.
        strict: accept no signature from before `time`, which may be one of an earlier run; the
            specification accepts the first one of a sender and link if it is a minute old.
    """

    key: bytes = field(repr=False)
    link: int = 0
    time: int = 0
    strict: bool = False

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            InputError: a value is out of range.
        """
        check_key("signing key", self.key)
        if not 0 <= self.link <= 255:
            raise InputError(f"signing link: {self.link}; give a number of 0 to 255")
        if not 0 <= self.time <= _MAX_TIME:
            raise InputError(f"signing time: {self.time}; give 10 µs since 2015, 0 to 2⁴⁸ − 1")


class MessageSigner:
    """Sign outgoing frames and verify incoming ones.

    A stream is a link id, system and component. Its latest time is stored to reject replays; ends
    that share a key share a signer, so that a frame sent to one of them is rejected as a replay by
    the others.
    """

    def __init__(self, signing: Signing) -> None:
        self._signing = signing
        self._time = signing.time
        self._latest: dict[tuple[int, int, int], int] = {}

    def advance(self, time: int) -> None:
        """Advance the clock, 10 µs, to this time; an earlier time changes nothing."""
        self._time = max(self._time, min(time, _MAX_TIME))

    def sign(self, frame: bytes) -> bytes:
        """Append a signature with a new time to a frame with its checksum.

        The time counts as received, so that a frame that is sent back is a replay.
        """
        self._latest[self._signing.link, frame[5], frame[6]] = self._time
        signed = frame + bytes([self._signing.link]) + struct.pack("<Q", self._time)[:6]
        self.advance(self._time + 1)
        return signed + self._hash(signed)

    def verify(self, frame: bytes, signed: bool) -> Verdict:
        """Verify a frame whose checksum is right; only a good one updates times."""
        if not signed:
            return "unsigned"
        if not hmac.compare_digest(self._hash(frame[:-_HASH_BYTES]), frame[-_HASH_BYTES:]):
            return "forged"
        time = int.from_bytes(frame[-_HASH_BYTES - 6 : -_HASH_BYTES], "little")
        stream = (frame[-SIGNATURE_BYTES], frame[5], frame[6])
        latest = self._latest.get(stream)
        first = self._time - _MAX_AGE  # of a stream
        if self._signing.strict:
            first = max(first, self._signing.time)
        if latest is None and time < first:
            return "outdated"
        if latest is not None and time <= latest:
            return "replayed"
        self._latest[stream] = time
        self.advance(time)
        return "good"

    def _hash(self, signed: bytes) -> bytes:
        return hashlib.sha256(self._signing.key + signed).digest()[:_HASH_BYTES]
