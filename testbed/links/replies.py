"""What a vehicle says: messages that wait to be packed, and texts cut to fit."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from testbed.mavlink.door import Given, Message

Fields = dict[str, Given]

LETTERS = 50  # of a STATUSTEXT
CHUNKS = 8  # of a text; what is longer is cut
QUIET_S = 5.0  # between two texts that say the same, s of wall-clock time
REASONS = 64  # for which something was not done, said in that time
_SPELLED = str.maketrans(
    {"°": " deg", "−": "-", "–": "-", "…": "...", "·": ".", "×": "x", "µ": "u", "’": "'"}
)


class Severity(IntEnum):
    """How much a STATUSTEXT matters: MAV_SEVERITY."""

    ERROR = 3
    WARNING = 4
    INFO = 6


class Reply(NamedTuple):
    """A message to be said."""

    name: str
    fields: Fields


class Asker(NamedTuple):
    """Who said something."""

    system: int
    component: int

    @property
    def target(self) -> Fields:
        """The fields that address an answer to it."""
        return {"target_system": self.system, "target_component": self.component}


def asker(message: Message) -> Asker:
    """Who said this."""
    return Asker(message.system, message.component)


class Texts:
    """Cuts texts into STATUSTEXTs, and does not let the same be said too often."""

    def __init__(self) -> None:
        """Nothing has been said."""
        self._chunked = 0
        self._said: dict[str, float] = {}

    def say(self, severity: Severity, text: str) -> list[Reply]:
        """A text in ASCII, which every display has, in as many messages as it needs.

        A text ends at its first null: one that fills its last message exactly needs one more, and
        none but the last may end early at a blank: blanks that fill it up would show when joined.
        """
        plain = unicodedata.normalize("NFKD", text.translate(_SPELLED))
        letters = plain.encode("ascii", "ignore").replace(b"\0", b" ")[: LETTERS * CHUNKS - 1]
        if len(letters) <= LETTERS:
            return [Reply("STATUSTEXT", {"severity": severity, "text": letters})]
        self._chunked = self._chunked % 65535 + 1
        return [
            Reply(
                "STATUSTEXT",
                {
                    "severity": severity,
                    "text": letters[start : start + LETTERS],
                    "id": self._chunked,
                    "chunk_seq": number,
                },
            )
            for number, start in enumerate(range(0, len(letters) + 1, LETTERS))
        ]

    def warn(self, text: str, at_s: float) -> list[Reply]:
        """Say why something was not done; nothing if that was said a moment ago.

        Args:
            text: the reason.
            at_s: wall-clock time.
        """
        latest = self._said.get(text)
        if latest is not None and at_s - latest < QUIET_S:
            return []
        if len(self._said) >= REASONS:
            self._said = {what: when for what, when in self._said.items() if at_s - when < QUIET_S}
            if len(self._said) >= REASONS:
                return []
        self._said[text] = at_s
        return self.say(Severity.WARNING, text)


Handler = Callable[[Message, float], list[Reply]]  # a message and the wall-clock time, s
