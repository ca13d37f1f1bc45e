"""MAVLink 2 signatures: who may speak on a link, and what has been said before.

https://mavlink.io/en/guide/message_signing.html. Times count 10 µs from the start of 2015, UTC.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from testbed.errors import InputError

SIGNATURE = 13  # bytes: link, time, and the start of the hash
_HASH = 6  # bytes of it that are sent
_EPOCH = 1420070400  # s, 2015-01-01 in Unix time
_PER_SECOND = 100_000
_LATEST = (1 << 48) - 1
_PATIENCE = 60 * _PER_SECOND  # how far behind ours the clock of a newcomer may be

Verdict = Literal["good", "unsigned", "forged", "replayed"]


def signing_time(unix_s: float) -> int:
    """The time of a signature, 10 µs, from Unix time in s."""
    return min(max(round((unix_s - _EPOCH) * _PER_SECOND), 0), _LATEST)


def read_key(path: Path) -> bytes:
    """The secret key in a file: 64 hexadecimal digits, or a passphrase as ground stations take it.

    Raises:
        InputError: it cannot be read, or there is nothing in it.
    """
    try:
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read this key: {error}") from error
    if not text:
        raise InputError(f"{path}: empty; write a passphrase or 64 hexadecimal digits")
    if re.fullmatch(r"[0-9a-fA-F]{64}", text):
        return bytes.fromhex(text)
    if re.fullmatch(r"[0-9a-fA-F]{32,}", text):
        raise InputError(f"{path}: {len(text)} hexadecimal digits; write 64, or a passphrase")
    return hashlib.sha256(text.encode()).digest()


@dataclass(frozen=True, slots=True)
class Signing:
    """What both ends of a signed link share, and where this end begins.

    Attributes:
        key: 32 secret bytes.
        link: which of its links this end signs for, 0 to 255.
        time: of the first signature, `signing_time`; a receiver that has heard a later one from
            the same sender and link refuses it.
    """

    key: bytes = field(repr=False)
    link: int = 0
    time: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot sign.

        Raises:
            InputError: naming what to give instead.
        """
        if len(self.key) != 32:
            raise InputError(f"signing key: {len(self.key)} bytes; give 32")
        if not 0 <= self.link <= 255:
            raise InputError(f"signing link: {self.link}; give a number of 0 to 255")
        if not 0 <= self.time <= _LATEST:
            raise InputError(f"signing time: {self.time}; give 10 µs since 2015, 0 to 2⁴⁸ − 1")


class Seal:
    """Signs what is sent and judges what is heard; remembers the last time of every stream."""

    def __init__(self, signing: Signing) -> None:
        """Begin with nothing heard."""
        self._signing = signing
        self._time = signing.time
        self._heard: dict[tuple[int, int, int], int] = {}

    def advance(self, time: int) -> None:
        """Let the clock, 10 µs, reach this time; it never goes back."""
        self._time = max(self._time, min(time, _LATEST))

    def sign(self, frame: bytes) -> bytes:
        """The frame, its checksum included, with its signature. Every signature has a new time."""
        signed = frame + bytes([self._signing.link]) + struct.pack("<Q", self._time)[:6]
        self.advance(self._time + 1)
        return signed + self._hash(signed)

    def judge(self, frame: bytes, signed: bool) -> Verdict:
        """What to think of a frame whose checksum is right; only a good one is remembered."""
        if not signed:
            return "unsigned"
        if not hmac.compare_digest(self._hash(frame[:-_HASH]), frame[-_HASH:]):
            return "forged"
        time = int.from_bytes(frame[-_HASH - 6 : -_HASH], "little")
        stream = (frame[-SIGNATURE], frame[5], frame[6])
        latest = self._heard.get(stream, self._time - _PATIENCE - 1)
        if time <= latest:
            return "replayed"
        self._heard[stream] = time
        self.advance(time)
        return "good"

    def _hash(self, signed: bytes) -> bytes:
        return hashlib.sha256(self._signing.key + signed).digest()[:_HASH]
