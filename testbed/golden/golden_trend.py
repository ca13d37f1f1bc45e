"""Numbers of a scenario over kept results of `testbed check --json`, one file for each commit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from testbed.core.errors import InputError
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.golden.golden_table import RULES
from testbed.scenario.fields import is_number

MAX_BYTES = 50_000_000  # of a file
MAX_FILES = 10_000


@dataclass(frozen=True, slots=True)
class TrendRow:
    """A number of a scenario over the files.

    Args:
        scenario: its name.
        key: of the row in golden tables, `rms_m/circles/uav1`.
        measured: (K,) the number in each file; None where a file does not have it.
        golden: (K,) that of the golden table at the time.
        passed: (K,) whether it passed.
    """

    scenario: str
    key: str
    measured: tuple[float | None, ...]
    golden: tuple[float | None, ...]
    passed: tuple[bool | None, ...]

    @property
    def unit(self) -> str:
        """Unit of the numbers."""
        return RULES[self.key.split("/")[0]].unit

    @property
    def ends(self) -> tuple[float, float] | None:
        """The first and the last known number; None: there is none."""
        known = [each for each in self.measured if each is not None]
        return (known[0], known[-1]) if known else None

    @property
    def change(self) -> float | None:
        """Change from the first to the last known number, in percent of the first."""
        return 100.0 * (self.ends[1] / self.ends[0] - 1.0) if self.ends and self.ends[0] else None

    @property
    def direction(self) -> Literal["better", "worse", ""]:
        """Whether the last number is better or worse than the first, by more than the rule."""
        if self.ends is None:
            return ""
        first, last = self.ends
        rule = RULES[self.key.split("/")[0]]
        if abs(last - first) <= rule.allowed(first):
            return ""
        return "better" if (last < first) == (rule.better == "lower") else "worse"


@dataclass(frozen=True, slots=True)
class Trend:
    """Numbers over files.

    Args:
        labels: (K,) of the files, in order of their names: these without the ending.
        rows: in order of their first appearance.
    """

    labels: tuple[str, ...]
    rows: tuple[TrendRow, ...]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(dict.fromkeys(row.scenario for row in self.rows))

    def of(self, scenario: str) -> list[TrendRow]:
        """Return the rows of a scenario."""
        return [row for row in self.rows if row.scenario == scenario]


def read_trend(folder: Path, scenarios: Sequence[str] = ()) -> Trend:
    """Read all files `*.json` of a folder, in order of their names.

    Args:
        folder: of files that `testbed check --json FILE` wrote.
        scenarios: names to read; none: all.

    Raises:
        InputError: there is no such folder or file, a file is something else, or no file has a
            scenario.
    """
    if not folder.is_dir():
        raise InputError(f"--trend {folder}: there is no such folder")
    paths = sorted(folder.glob("*.json"))
    if not paths or len(paths) > MAX_FILES:
        raise InputError(
            f"--trend {folder}: has {len(paths):,} files *.json (keep one of each commit: testbed "
            f"check --json {folder}/DATE-COMMIT.json)"
        )
    found = [_read_rows(path) for path in paths]
    known = dict.fromkeys(name for rows in found for name, _ in rows)
    for name in scenarios:
        if name not in known:
            raise InputError(f"{name}: is in no file of {folder} (they have {', '.join(known)})")
    keys = dict.fromkeys(key for rows in found for key in rows)
    return Trend(
        tuple(path.stem for path in paths),
        tuple(
            TrendRow(
                *key,
                *(
                    tuple(rows.get(key, {}).get(name) for rows in found)
                    for name in ("measured", "golden", "passed")
                ),
            )
            for key in keys
            if not scenarios or key[0] in scenarios
        ),
    )


def _read_rows(path: Path) -> dict[tuple[str, str], Mapping[str, Any]]:
    """Read the rows of a file by scenario and key.

    Raises:
        InputError: it cannot be read, or is not of `testbed check --json`.
    """
    try:
        document = parse_json_map(read_bounded(path, MAX_BYTES, error=InputError))
        if document.get("schema") != 2:
            raise ValueError("its schema is not 2")
        rows = {}
        for verdict in document["scenarios"]:
            for key, row in verdict["rows"].items():
                if key.split("/")[0] in RULES:
                    rows[str(verdict["scenario"]), str(key)] = _checked(row)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: is not a result of testbed check --json: {error!r:.200} (move it)"
        ) from None
    return rows


def _checked(row: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return golden and measured number of a row.

    Raises:
        ValueError, KeyError, TypeError: a value is missing or of another type.
    """
    for name in ("golden", "measured"):
        if row[name] is not None and not is_number(row[name]):
            raise ValueError(f"{name} is not a number")
    if not isinstance(row["passed"], bool):
        raise TypeError("passed is neither true nor false")
    return row


def to_document(trend: Trend) -> dict[str, Any]:
    """Return the trend as plain data for JSON."""
    return {
        "schema": 1,
        "files": list(trend.labels),
        "scenarios": {
            scenario: {
                row.key: {
                    "unit": row.unit,
                    "measured": list(row.measured),
                    "golden": list(row.golden),
                    "change_percent": row.change,
                }
                for row in trend.of(scenario)
            }
            for scenario in trend.scenarios
        },
    }
