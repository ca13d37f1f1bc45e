"""Problems of a file, each with its place, and the error that carries them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from testbed.core.errors import InputError

MAX_LISTED = 20  # problems in the text of an error
MAX_LINE = 1000  # characters of a problem
_MAX_KEY = 80  # characters of a key
_MAX_WORD = 200  # characters of a word that is compared with known ones


@dataclass(frozen=True, slots=True)
class FilePosition:
    """A position in a file: line (0: the whole file) and column, from 1."""

    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        """Render as file:line:column, which editors understand."""
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True, slots=True)
class Problem:
    """One wrong value: its place, its path and a text with the remedy."""

    place: FilePosition | None  # None: of no single file
    text: str
    path: tuple[str, ...] = ()  # keys and list indices from the top of the file

    def __str__(self) -> str:
        """Render on one line."""
        path = ".".join(_shortened(key, _MAX_KEY) for key in self.path)
        parts = (str(self.place) if self.place else "", path, self.text)
        return _shortened(": ".join(part for part in parts if part), MAX_LINE)


class ScenarioError(InputError):
    """A scenario that cannot be used. `problems` has all of them, the text one per line."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        lines = [str(problem) for problem in self.problems[:MAX_LISTED]]
        if more := len(self.problems) - len(lines):
            lines.append(f"… and {more:,} more")
        super().__init__("\n".join(lines))


def merge_repeated(problems: Iterable[Problem]) -> list[Problem]:
    """Merge problems of one place and text; paths that differ get a `*`."""
    merged: dict[tuple[FilePosition | None, str, int], Problem] = {}
    for problem in problems:
        key = (problem.place, problem.text, len(problem.path))
        first = merged.setdefault(key, problem)
        pairs = zip(first.path, problem.path, strict=True)
        path = tuple(one if one == other else "*" for one, other in pairs)
        merged[key] = replace(first, path=path)
    return list(merged.values())


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ": did you mean 'x'?" for the nearest known word, or nothing."""
    if len(word) > _MAX_WORD:
        return ""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f": did you mean {close[0]!r}?" if close else ""
