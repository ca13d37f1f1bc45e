"""What is said about a wrong page: where, what, and what to write instead."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from testbed.errors import InputError

MOST_TOLD = 50  # problems in the text of an error


@dataclass(frozen=True, slots=True)
class Place:
    """A position in a text: file and, counted from 1, line and column; line 0 is the whole file."""

    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        """Render as an editor understands it: file:line:column."""
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong."""

    place: Place | None  # none: not of one file
    text: str
    path: tuple[str, ...] = ()  # keys and list indices from the top of the page

    def __str__(self) -> str:
        """Render on one line."""
        parts = (str(self.place) if self.place else "", ".".join(self.path), self.text)
        return ": ".join(part for part in parts if part)


class ScenarioError(InputError):
    """A page that cannot be flown. `problems` has everything found; the text is one per line."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        """Carry the problems, in the order given."""
        self.problems = tuple(problems)
        told = [str(problem) for problem in self.problems[:MOST_TOLD]]
        if more := len(self.problems) - len(told):
            told.append(f"and {more:,} more")
        super().__init__("\n".join(told))


def folded(problems: Iterable[Problem]) -> list[Problem]:
    """The problems, each once: what is wrong in one place of the text may be so for many aircraft.

    Where their paths differ is then a `*`.
    """
    kept: dict[tuple[Place | None, str, int], Problem] = {}
    for problem in problems:
        key = (problem.place, problem.text, len(problem.path))
        first = kept.setdefault(key, problem)
        same = zip(first.path, problem.path, strict=True)
        path = tuple(one if one == other else "*" for one, other in same)
        kept[key] = replace(first, path=path)
    return list(kept.values())


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ": did you mean 'x'?" for the nearest known word, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f": did you mean {close[0]!r}?" if close else ""
