"""The golden table of a scenario: its numbers seed by seed, and by which rules they are held."""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from testbed.errors import InputError
from testbed.study.golden_band import prediction_band

DIGITS = 8  # of what a table keeps, behind the point


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Rule(_Part):
    """How one quantity is compared."""

    label: str
    unit: str
    tolerance: float = Field(gt=0)  # for the same seed, in the unit
    share: float | None  # of small numbers the tolerance is this share of them,
    least: float = Field(gt=0)  # but never less than this
    reason: str
    banded: bool  # whether seeds that the table has not are held to a band
    better: Literal["lower", "higher"]

    def allowed(self, value: float) -> float:
        """How far a number may be from this one."""
        if self.share is None:
            return self.tolerance
        return min(self.tolerance, max(self.share * abs(value), self.least))


class BandRule(_Part):
    """How wide the bands are."""

    false_alarm: float
    reason: str


class Row(_Part):
    """One number of a flight: by seed, in the order of the table's seeds."""

    band: tuple[float, float] | None
    by_seed: tuple[float, ...]


class Table(_Part):
    """What a scenario's flights gave when somebody last said that this is right.

    `rows` are keyed `quantity/portion/follower`, without what does not apply. `page` and `files`
    decide nothing: they let a comparison name what changed since.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_version: Literal[1] = Field(1, alias="schema")
    scenario: str
    reason: str
    versions: dict[str, str]
    random: bool
    seeds: tuple[int, ...]
    rules: dict[str, Rule]
    band: BandRule
    rows: dict[str, Row]
    metrics: tuple[str, ...]
    files: dict[str, str]
    page: dict[str, Any]

    @model_validator(mode="after")
    def _whole(self) -> Table:
        for key, row in self.rows.items():
            if key.split("/")[0] not in self.rules:
                raise ValueError(f"no rule for {key}")
            if not self.seeds or len(row.by_seed) != len(self.seeds):
                raise ValueError(f"{key} has {len(row.by_seed)} numbers, not one for each seed")
        return self

    def same_seed(self, key: str, seed: int) -> float | None:
        """The row's number for a seed; for a table without dice any seed has that of the first."""
        values = self.rows[key].by_seed
        if not self.random:
            return values[0]
        return values[self.seeds.index(seed)] if seed in self.seeds else None


_ROUNDING = (
    "The law closes a loop round every aircraft, so a difference of rounding dies out: numpy's and "
    "numba's arithmetic agree to 1e-12 m, and a slot moved by 1e-6 m moves RMS errors by less than "
    "1e-7 m. A gain changed in its second digit moves them by several millimetres. Where a number "
    "is below 0.1 m a millimetre would be blind to it, so it is held to a hundredth of itself."
)
_FRAMES = (
    "A crossing is seen at the next frame, 0.04 s apart at 25 Hz; rounding can move a few "
    "crossings by one frame. No band: these times are not normal over seeds."
)


def _length(label: str, *, banded: bool, better: Literal["lower", "higher"], more: str) -> Rule:
    return Rule(
        label=label,
        unit="m",
        tolerance=1e-3,
        share=0.01,
        least=1e-6,
        reason=_ROUNDING + more,
        banded=banded,
        better=better,
    )


def _time(label: str) -> Rule:
    return Rule(
        label=label,
        unit="s",
        tolerance=0.2,
        share=None,
        least=0.2,
        reason=_FRAMES,
        banded=False,
        better="lower",
    )


RULES: Mapping[str, Rule] = {
    "rms_m": _length("RMS error", banded=True, better="lower", more=""),
    "mean_rms_m": _length("mean RMS error", banded=True, better="lower", more=""),
    "believed_mean_rms_m": _length("mean believed RMS error", banded=True, better="lower", more=""),
    "relative_position_m": _length(
        "error of its place from the leader's", banded=True, better="lower", more=""
    ),
    "min_separation_m": _length(
        "smallest separation",
        banded=False,
        better="higher",
        more=" No band: the smallest of a flight is not normal over seeds.",
    ),
    "engaged_at_s": _time("engaged at"),
    "saturated_s": _time("at a limit for"),
}
BAND = BandRule(
    false_alarm=1e-6,
    reason="Student's prediction band of one more seed. Two hundred numbers of unseen seeds leave "
    "it by chance once in 5000 checks.",
)


def measure(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """The numbers of a flight that a table keeps, by row, from its metrics document."""
    rows: dict[str, float | None] = {}
    relative = metrics["relative_position_m"]
    for portion, cells in metrics["portions"].items():
        rows |= {
            f"rms_m/{portion}/{name}": rms
            for name, rms in cells["rms_m"].items()
            if rms is not None or metrics["lost_at_s"][name] is None  # the lost have none
        }
        rows[f"mean_rms_m/{portion}"] = cells["mean_rms_m"]
        if any(relative.values()):  # an exact estimate believes the truth
            rows[f"believed_mean_rms_m/{portion}"] = cells["believed_mean_rms_m"]
    rows |= {f"relative_position_m/{name}": rms for name, rms in relative.items() if rms}
    rows["min_separation_m"] = metrics["min_separation_m"]
    rows |= {f"engaged_at_s/{name}": at for name, at in metrics["engaged_at_s"].items()}
    limits = metrics["saturations"]
    rows |= {f"saturated_s/{name}": limit["seconds"] for name, limit in limits.items()}
    return rows


def metric_names(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """What the metrics document has, sorted: its keys and those of its portions."""
    portions = list(metrics["portions"].values())
    return tuple(sorted([*metrics, *(f"portions.*.{key}" for key in (*portions, {})[0])]))


def make_table(
    flights: Mapping[int, Mapping[str, Any]],
    *,
    scenario: str,
    reason: str,
    random: bool,
    files: Mapping[str, str],
    page: Mapping[str, Any],
) -> Table:
    """The table of these flights: metrics by seed, all sound and of one structure.

    Numbers are kept to a hundredth of the least tolerance.
    """
    measured = [measure(metrics) for metrics in flights.values()]
    first = next(iter(flights.values()))
    rows = {
        key: _make_row(key, [_number(each[key]) for each in measured], random)
        for key in measured[0]
    }
    return Table(
        scenario=scenario,
        reason=reason,
        versions=dict(first["versions"]),
        random=random,
        seeds=tuple(flights),
        rules=dict(RULES),
        band=BAND,
        rows=rows,
        metrics=metric_names(first),
        files=dict(files),
        page=dict(page),
    )


def _make_row(key: str, values: Sequence[float], random: bool) -> Row:
    rule = RULES[key.split("/")[0]]
    band = None
    if random and rule.banded:
        least = rule.allowed(statistics.fmean(values))
        low, high = prediction_band(values, false_alarm=BAND.false_alarm, least=least)
        band = round(low, DIGITS), round(high, DIGITS)
    return Row(band=band, by_seed=tuple(round(value, DIGITS) for value in values))


def _number(value: float | None) -> float:
    if value is None:
        raise ValueError("a sound flight has every number")
    return value


def read_table(path: Path) -> Table:
    """The table of a file.

    Raises:
        InputError: it cannot be read, or is not a table of this version.
    """
    try:
        return Table.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(f"{path}: not a golden table: {where}: {first['msg']}") from None


def write_table(path: Path, table: Table) -> None:
    """Write the table beside its place, then put it there in one move.

    Raises:
        InputError: the folder cannot be made or written.
    """
    text = to_text(table.model_dump(mode="json", by_alias=True)) + "\n"
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def to_text(value: object, indent: int = 0) -> str:
    """JSON with a line for each thing that holds no map, so that a diff reads well."""
    inner = " " * (indent + 2)
    if isinstance(value, Mapping) and any(map(_holds_map, value.values())):
        items = [f"{inner}{json.dumps(k)}: {to_text(v, indent + 2)}" for k, v in value.items()]
        return "{\n" + ",\n".join(items) + "\n" + " " * indent + "}"
    if isinstance(value, list) and any(map(_holds_map, value)):
        items = [inner + to_text(each, indent + 2) for each in value]
        return "[\n" + ",\n".join(items) + "\n" + " " * indent + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _holds_map(value: object) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and any(map(_holds_map, value)))
