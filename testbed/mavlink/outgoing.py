"""Outgoing messages that are not packed yet, and STATUSTEXT messages from texts."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from testbed.mavlink.codec import FieldInput, Message

Fields = dict[str, FieldInput]

TEXT_BYTES = 50  # of a STATUSTEXT
MAX_CHUNKS = 8  # STATUSTEXTs per text; a longer text is cut
MIN_REPEAT_S = 5.0  # between two equal warnings, s of wall-clock time
MAX_WARNINGS = 64  # different ones in that time
_ASCII = str.maketrans(
    {"°": " deg", "−": "-", "–": "-", "…": "...", "·": ".", "×": "x", "µ": "u", "’": "'"}
)


class Severity(IntEnum):
    """Severity of a STATUSTEXT: MAV_SEVERITY."""

    ERROR = 3
    WARNING = 4
    INFO = 6


class OutgoingMessage(NamedTuple):
    """A message to send."""

    name: str
    fields: Fields


class Sender(NamedTuple):
    """System and component that sent a message."""

    system: int
    component: int

    @property
    def target(self) -> Fields:
        """The fields that address an answer to it."""
        return {"target_system": self.system, "target_component": self.component}


def sender_of(message: Message) -> Sender:
    """Return the sender of a message."""
    return Sender(message.system, message.component)


class StatusTexts:
    """Make STATUSTEXT messages, and suppress frequent equal warnings."""

    def __init__(self) -> None:
        self._latest_id = 0
        self._warned: dict[str, float] = {}  # wall-clock time of each recent warning

    def make_text(self, severity: Severity, text: str) -> list[OutgoingMessage]:
        """Convert a text to ASCII, in as many messages as it needs.

        A receiver joins chunks up to the first null. A text that fills its last chunk exactly is
        therefore followed by an empty one, and all chunks but the last are full.
        """
        plain = unicodedata.normalize("NFKD", text.translate(_ASCII))
        letters = plain.encode("ascii", "ignore").replace(b"\0", b" ")
        letters = letters[: TEXT_BYTES * MAX_CHUNKS - 1]
        if len(letters) <= TEXT_BYTES:
            return [OutgoingMessage("STATUSTEXT", {"severity": severity, "text": letters})]
        self._latest_id = self._latest_id % 65535 + 1
        return [
            OutgoingMessage(
                "STATUSTEXT",
                {
                    "severity": severity,
                    "text": letters[start : start + TEXT_BYTES],
                    "id": self._latest_id,
                    "chunk_seq": number,
                },
            )
            for number, start in enumerate(range(0, len(letters) + 1, TEXT_BYTES))
        ]

    def make_warning(self, text: str, wall_s: float) -> list[OutgoingMessage]:
        """Make a warning; none if the same text was sent less than `MIN_REPEAT_S` ago.

        Args:
            text: why a request was not executed.
            wall_s: wall-clock time.
        """
        latest = self._warned.get(text)
        if latest is not None and wall_s - latest < MIN_REPEAT_S:
            return []
        if len(self._warned) >= MAX_WARNINGS:
            self._warned = {
                warned: at for warned, at in self._warned.items() if wall_s - at < MIN_REPEAT_S
            }
            if len(self._warned) >= MAX_WARNINGS:
                return []
        self._warned[text] = wall_s
        return self.make_text(Severity.WARNING, text)


Handler = Callable[[Message], list[OutgoingMessage]]
