"""Journal of a study: a line per finished run, on disk before the next one is written.

The first line has the inputs of the study. The numbers of a row are in the order of a list of
names in an earlier line; each new set of names has such a line. An incomplete last line, as after a
power failure, is dropped.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from testbed.core.errors import InputError
from testbed.studies.rows import Row

SCHEMA = 2


class Journal:
    """A file of rows, locked by one process at a time."""

    def __init__(self, path: Path, inputs: Mapping[str, Any] | None = None) -> None:
        """Open an existing journal, or create one.

        Args:
            path: the file.
            inputs: of the study, for a new file; None opens an existing one.

        Raises:
            InputError: it cannot be opened, is no journal, or another process has it open.
        """
        self.path = path
        self.inputs: Mapping[str, Any] = inputs or {}
        self._offsets: dict[int, int] = {}  # of the lines, by run
        self._names: list[tuple[str, ...]] = []
        self._name_index: dict[tuple[str, ...], int] = {}
        try:
            self._file: BinaryIO = path.open("xb+" if inputs is not None else "rb+")
        except FileExistsError:
            raise InputError(
                f"{path}: another sweep has just created it (name another file with --out)"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be opened: {error.strerror}") from None
        try:
            self._lock()
            if inputs is not None:
                self._append({"journal": SCHEMA, "inputs": inputs})
            else:
                self._read()
        except BaseException:
            self._file.close()
            raise

    def __contains__(self, run: int) -> bool:
        """Tell whether the journal has a run."""
        return run in self._offsets

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._offsets)

    def add(self, row: Row) -> None:
        """Write a row to disk.

        Raises:
            InputError: it cannot be written.
        """
        names = tuple(row.metrics)
        if names not in self._name_index:
            self._add_names(names)
            self._append({"names": names})
        self._offsets[row.run] = self._append(
            {
                "run": row.run,
                "outcome": row.outcome,
                "error": row.error,
                "names": self._name_index[names],
                "values": list(row.metrics.values()),
            }
        )

    def rows(self) -> Iterator[Row]:
        """Iterate over the rows, in order of their runs."""
        for run in sorted(self._offsets):
            self._file.seek(self._offsets[run])
            line = json.loads(self._file.readline())
            numbers = dict(zip(self._names[line["names"]], line["values"], strict=True))
            yield Row(run, line["outcome"], line["error"], numbers)

    def names(self) -> tuple[str, ...]:
        """Return the names of all numbers, in order of the first run that has them.

        A name is left out if other runs have names below it: there it is a missing part.
        """
        seen: set[int] = set()
        names: dict[str, None] = {}
        for row in self.rows():
            index = self._name_index[tuple(row.metrics)]
            if index not in seen:
                seen.add(index)
                names |= dict.fromkeys(self._names[index])
            if len(seen) == len(self._names):
                break
        parents = {name[:k] for name in names for k, sign in enumerate(name) if sign == "."}
        return tuple(name for name in names if name not in parents)

    def close(self) -> None:
        """Close and unlock the file."""
        self._file.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{self.path}: another sweep is writing it (wait for it, or name another file "
                "with --out)"
            ) from None

    def _append(self, line: Mapping[str, Any]) -> int:
        """Write a line to disk, and return its offset."""
        try:
            offset = self._file.seek(0, os.SEEK_END)
            text = json.dumps(line, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
            self._file.write(text.encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from error
        return offset

    def _add_names(self, names: tuple[str, ...]) -> None:
        self._name_index[names] = len(self._names)
        self._names.append(names)

    def _read(self) -> None:
        offset = number = 0
        for number, text in enumerate(self._file, start=1):
            try:
                if not text.endswith(b"\n"):
                    raise ValueError("it is incomplete")
                self._read_line(json.loads(text), offset, number)
            except (ValueError, KeyError, TypeError) as error:
                if self._file.read(1):
                    raise InputError(
                        f"{self.path}:{number}: is no line of a journal: {error} (start the study "
                        "again with another --out)"
                    ) from None
                self._file.truncate(offset)
                break
            offset += len(text)
        if not self.inputs:
            raise InputError(f"{self.path}: is empty (remove it, and start the study again)")

    def _read_line(self, line: dict[str, Any], offset: int, number: int) -> None:
        if number == 1:
            if line["journal"] != SCHEMA:
                raise ValueError(f"its version is {line['journal']}, not {SCHEMA}")
            self.inputs = line["inputs"]
        elif "run" in line:
            if len(line["values"]) != len(self._names[line["names"]]):
                raise ValueError("the numbers of values and names differ")
            self._offsets[int(line["run"])] = offset
        else:
            self._add_names(tuple(line["names"]))
