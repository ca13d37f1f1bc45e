"""Rows of a study, and their journal: a line per finished run, each written durably.

The first line has the inputs of the study. The numbers of a row are in the order of a list of
names in an earlier line; each new set of names has such a line. An incomplete last line, as after a
power failure, is dropped.
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from testbed.core.errors import InputError
from testbed.core.files import report_write_errors
from testbed.core.input_files import parse_json_map
from testbed.metrics.flat_numbers import Numbers
from testbed.pool.flight_task import OUTCOMES

METRICS = "metrics."  # prefix of columns with numbers of metrics.json
SET = "set."  # prefix of columns with the keys that vary

_ERROR = ".mean_rms_m"


@dataclass(frozen=True, slots=True)
class JournalRow:
    """Result of one run.

    Args:
        run: its number in the plan.
        outcome: one of `flight_task.OUTCOMES`.
        error: reason for any outcome but "completed", or the violated bounds of a completed run.
        metrics: numbers by name, as `windows.circles.mean_rms_m`; None for null.
        any_seed: whether it has the same numbers with any other seed; False: unknown.
    """

    run: int
    outcome: str
    error: str
    metrics: Numbers
    any_seed: bool = False


def default_metric(names: Iterable[str]) -> tuple[str, ...]:
    """Return the name of the last window's mean RMS error, if any."""
    errors = [name for name in names if name.startswith("windows.") and name.endswith(_ERROR)]
    return tuple(errors[-1:])


SCHEMA = 2
_MAX_LINE_BYTES = 64_000_000
_MAX_NAMES = 1_000_000  # in all lines
_MAX_RUNS = 2**53


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
        self._count = 0  # of all names read
        try:
            new = inputs is not None
            self._file: BinaryIO = path.open("xb+") if new else path.open("rb+")
        except FileExistsError:
            raise InputError(
                f"{path}: another sweep has just created it (name another file with --out)"
            ) from None
        except OSError as error:
            raise InputError(f"{path}: cannot be opened: {error.strerror}") from None
        try:
            if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                raise InputError(f"{path}: is not a regular file (name another file with --out)")
            self._lock()
            if inputs is not None:
                try:
                    self._append({"journal": SCHEMA, "inputs": inputs})
                except InputError:
                    path.unlink(missing_ok=True)  # without inputs it is no journal
                    raise
            else:
                self._read()
        except BaseException:
            self._file.close()
            raise

    def __contains__(self, run: int) -> bool:
        """Return whether the journal has a run."""
        return run in self._offsets

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._offsets)

    def add(self, row: JournalRow) -> None:
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
                **({"any_seed": True} if row.any_seed else {}),
            }
        )

    def rows(self, needs: Callable[[int], bool] = lambda run: True) -> Iterator[JournalRow]:
        """Iterate over the rows of the runs that are needed, in order of their runs."""
        for run in filter(needs, sorted(self._offsets)):
            self._file.seek(self._offsets[run])
            line = parse_json_map(self._file.readline())
            numbers = dict(zip(self._names[line["names"]], line["values"], strict=True))
            any_seed = line.get("any_seed", False)
            yield JournalRow(run, line["outcome"], line["error"], numbers, any_seed)

    def names(self, needs: Callable[[int], bool] = lambda run: True) -> tuple[str, ...]:
        """Return the names of the numbers of needed runs, in order of the first that has them.

        A name is left out if other runs have names below it: there it is a missing part.
        """
        seen: set[int] = set()
        names: dict[str, None] = {}
        for row in self.rows(needs):
            index = self._name_index[tuple(row.metrics)]
            if index not in seen:
                seen.add(index)
                names |= dict.fromkeys(self._names[index])
            if len(seen) == len(self._names):
                break
        # names of aircraft may have dots: `uav` beside `uav.1` in one run is no missing part
        whole = {name for index in seen for name in _with_names_below(self._names[index])}
        missing = _with_names_below(names) - whole
        return tuple(name for name in names if name not in missing)

    def refuse_other_runs(self, runs: int) -> None:
        """Refuse rows of runs that a study of this many runs does not have.

        Raises:
            InputError: naming one.
        """
        last = max(self._offsets, default=-1)
        if last >= runs:
            raise InputError(
                f"{self.path}: has run {last}, and the study has runs 0 to {runs - 1} (start the "
                "study again with another --out)"
            )

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
        text = json.dumps(line, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        rest = memoryview(text.encode() + b"\n")
        descriptor = self._file.fileno()  # unbuffered, so that nothing is written again by close()
        with report_write_errors(self.path):
            offset = end = self._file.seek(0, os.SEEK_END)
            try:
                while rest:
                    written = os.pwrite(descriptor, rest, end)
                    rest, end = rest[written:], end + written
                os.fsync(descriptor)
            except OSError:
                os.ftruncate(descriptor, offset)  # no part of a line stays
                raise
        return offset

    def _add_names(self, names: tuple[str, ...]) -> None:
        self._name_index[names] = len(self._names)
        self._names.append(names)

    def _read(self) -> None:
        offset = number = 0
        lines = iter(lambda: self._file.readline(_MAX_LINE_BYTES), b"")
        for number, text in enumerate(lines, start=1):
            try:
                if not text.endswith(b"\n"):
                    raise ValueError("it is incomplete or too long")
                self._read_line(parse_json_map(text), offset, number)
            except (ValueError, KeyError, TypeError) as error:
                if self._file.read(1):
                    raise InputError(
                        f"{self.path}:{number}: is not a line of a journal: {error} (start the "
                        "study again with another --out)"
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
            inputs = line["inputs"]
            if not (isinstance(inputs, dict) and all(isinstance(v, dict) for v in inputs.values())):
                raise ValueError("its inputs are not maps")
            self.inputs = inputs
        elif "run" in line:
            self._offsets[self._check_row(line)] = offset
        else:
            names = line["names"]
            if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
                raise ValueError("its names are not a list of texts")
            self._count += len(names)
            if len(set(names)) < len(names) or self._count > _MAX_NAMES:
                raise ValueError("it has repeated or too many names")
            self._add_names(tuple(names))

    def _check_row(self, line: Mapping[str, Any]) -> int:
        """Return the run of a row.

        Raises:
            ValueError, KeyError, TypeError: a field is missing or of another type.
        """
        run, index, values = line["run"], line["names"], line["values"]
        if not (_is_index(run, _MAX_RUNS) and _is_index(index, len(self._names))):
            raise ValueError("its run or its names are out of range")
        if not isinstance(values, list) or len(values) != len(self._names[index]):
            raise ValueError("the numbers of values and names differ")
        if not all(value is None or _is_number(value) for value in values):
            raise ValueError("a value is not a number")
        if line["outcome"] not in OUTCOMES or not isinstance(line["error"], str):
            raise ValueError("its outcome is unknown, or its error is not a text")
        if not isinstance(line.get("any_seed", False), bool):
            raise ValueError("its any_seed is neither true nor false")
        return int(run)


def _with_names_below(names: Iterable[str]) -> set[str]:
    """Return the names that are the beginning of others, before a dot."""
    found = set(names)
    return {name[:k] for name in found for k, sign in enumerate(name) if sign == "."} & found


def _is_index(value: Any, count: int) -> bool:  # noqa: ANN401 - any JSON value
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count


def _is_number(value: Any) -> bool:  # noqa: ANN401 - any JSON value
    return isinstance(value, float) or _is_index(value, _MAX_RUNS)
