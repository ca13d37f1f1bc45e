"""Errors that JSBSim logs while it loads an aircraft, with file and line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_MAX_TEXT = 300  # characters of a log record


def _ignore(_: str) -> None:
    pass


class JsbsimLogCapture:
    """The methods of JSBSim's FGLogger: a record has a level, a text in parts, and maybe a place.

    Attributes:
        on_error: called with each error, and its place.
    """

    on_error: Callable[[str], None] = staticmethod(_ignore)

    def __init__(self) -> None:
        """Start without a record."""
        super().__init__()
        self._is_error, self._place, self._text = False, "", ""

    def set_level(self, level: Any) -> None:  # noqa: ANN401 - JSBSim's
        """Begin a record."""
        self._is_error = level.name in ("ERROR", "FATAL")
        self._place, self._text = "", ""

    def file_location(self, file: str, line: int) -> None:
        """Set the place of the record."""
        self._place = f"{file}:{line}: "

    def message(self, text: str) -> None:
        """Append to the text of the record."""
        self._text += text

    def format(self, _: Any) -> None:  # noqa: ANN401
        """Ignore colours."""

    def flush(self) -> None:
        """Report the record if it is an error."""
        if self._is_error:
            self.on_error(f"{self._place}JSBSim: {' '.join(self._text.split())[:_MAX_TEXT]}")
