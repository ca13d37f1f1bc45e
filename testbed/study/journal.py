"""Rows of a study as they come: one line each, on disk before the next, so that nothing is lost.

The first line says what the study was begun with. A row's numbers stand in the order of names that
a line before it gave; there is such a line for every new set of names. A last line that is cut
short, as when the machine went down, is taken as not written.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from testbed.errors import InputError
from testbed.study.rows import Row

SCHEMA = 1


class Journal:
    """A file of rows, held by one process at a time."""

    def __init__(self, path: Path, begun: Mapping[str, Any] | None = None) -> None:
        """Open one that is there, or begin it.

        Args:
            path: the file.
            begun: what the study is begun with, for a new file.

        Raises:
            InputError: it cannot be opened, is no journal, or another process writes it.
        """
        self.path = path
        self.begun: Mapping[str, Any] = begun or {}
        self._at: dict[int, int] = {}  # where a run's line begins
        self._names: list[tuple[str, ...]] = []
        self._numbers: dict[tuple[str, ...], int] = {}
        try:
            self._file: BinaryIO = path.open("xb+" if begun is not None else "rb+")
        except FileExistsError:
            raise InputError(
                f"{path}: another sweep has just begun it (name another file with --out)"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be opened: {error.strerror}") from None
        try:
            self._hold()
            if begun is not None:
                self._put({"journal": SCHEMA, "begun": begun})
            else:
                self._read()
        except BaseException:
            self._file.close()
            raise

    def __contains__(self, run: int) -> bool:
        """Whether a run is here."""
        return run in self._at

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self._at)

    def add(self, row: Row) -> None:
        """Put a row on the disk.

        Raises:
            InputError: it cannot be written.
        """
        names = tuple(row.metrics)
        if names not in self._numbers:
            self._learn(names)
            self._put({"names": names})
        self._at[row.run] = self._put(
            {
                "run": row.run,
                "outcome": row.outcome,
                "error": row.error,
                "names": self._numbers[names],
                "values": list(row.metrics.values()),
            }
        )

    def rows(self) -> Iterator[Row]:
        """Rows in order of their runs."""
        for run in sorted(self._at):
            self._file.seek(self._at[run])
            line = json.loads(self._file.readline())
            numbers = dict(zip(self._names[line["names"]], line["values"], strict=True))
            yield Row(run, line["outcome"], line["error"], numbers)

    def names(self) -> tuple[str, ...]:
        """The names of all numbers, in order of the first run that has them.

        The path to a number that is missing is no name where other runs have something below it.
        """
        seen: set[int] = set()
        every: dict[str, None] = {}
        for row in self.rows():
            kind = self._numbers[tuple(row.metrics)]
            if kind not in seen:
                seen.add(kind)
                every |= dict.fromkeys(self._names[kind])
            if len(seen) == len(self._names):
                break
        above = {name[:k] for name in every for k, sign in enumerate(name) if sign == "."}
        return tuple(name for name in every if name not in above)

    def close(self) -> None:
        """Let it go."""
        self._file.close()

    def _hold(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{self.path}: another sweep is at work on it (wait for it, or name another file "
                "with --out)"
            ) from None

    def _put(self, line: Mapping[str, Any]) -> int:
        try:
            at = self._file.seek(0, os.SEEK_END)
            text = json.dumps(line, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
            self._file.write(text.encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error
        return at

    def _learn(self, names: tuple[str, ...]) -> None:
        self._numbers[names] = len(self._names)
        self._names.append(names)

    def _read(self) -> None:
        at = number = 0
        for number, text in enumerate(self._file, start=1):
            try:
                if not text.endswith(b"\n"):
                    raise ValueError("it is cut short")
                self._take(json.loads(text), at, number)
            except (ValueError, KeyError, TypeError) as error:
                if self._file.read(1):
                    raise InputError(
                        f"{self.path}:{number}: is no line of a journal: {error}; begin the study "
                        "anew with another --out"
                    ) from None
                self._file.truncate(at)
                break
            at += len(text)
        if not self.begun:
            raise InputError(f"{self.path}: is empty: no study was begun; remove it and begin anew")

    def _take(self, line: dict[str, Any], at: int, number: int) -> None:
        if number == 1:
            if line["journal"] != SCHEMA:
                raise ValueError(f"its version is {line['journal']}, not {SCHEMA}")
            self.begun = line["begun"]
        elif "run" in line:
            if len(line["values"]) != len(self._names[line["names"]]):
                raise ValueError("its numbers are not as many as their names")
            self._at[int(line["run"])] = at
        else:
            self._learn(tuple(line["names"]))
