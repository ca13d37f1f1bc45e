"""What JSBSim says while it loads an aircraft, for one error with file and line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_LONGEST = 300  # characters of a record that are told


def _nobody(_: str) -> None:
    pass


class Heard:
    """The methods of JSBSim's FGLogger: a record is a level, perhaps a place, and parts of a text.

    Attributes:
        tell: is told each record of what is wrong, with its place.
    """

    tell: Callable[[str], None] = staticmethod(_nobody)

    def __init__(self) -> None:
        """Begin with nothing heard."""
        super().__init__()
        self._wrong, self._place, self._text = False, "", ""

    def set_level(self, level: Any) -> None:  # noqa: ANN401 - JSBSim's
        """Begin a record."""
        self._wrong = level.name in ("ERROR", "FATAL")
        self._place, self._text = "", ""

    def file_location(self, file: str, line: int) -> None:
        """The record is of this place."""
        self._place = f"{file}:{line}: "

    def message(self, text: str) -> None:
        """More of its text."""
        self._text += text

    def format(self, _: Any) -> None:  # noqa: ANN401
        """Colours are nobody's concern."""

    def flush(self) -> None:
        """The record is whole."""
        if self._wrong:
            self.tell(f"{self._place}JSBSim says: {' '.join(self._text.split())[:_LONGEST]}")
