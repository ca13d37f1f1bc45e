"""The golden table of a scenario: numbers by seed, and their tolerances."""

from __future__ import annotations

import json
import math
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.core.stats import student_quantile
from testbed.pool.flight_code import describe_code
from testbed.pool.scenario_snapshot import Inputs, key_digests

SCHEMA: Literal[3] = 3  # raised when a key is renamed, removed or changes its meaning
SCHEMAS = (2, SCHEMA)  # that are read: their rows are the same
MAX_GOLDEN_BYTES = 10_000_000
DECIMALS = 8  # of the numbers in a table
# how the text of a table begins, of any version, also one that is damaged
_TABLE = re.compile(rb'\s*\{\s*"schema":\s*\d+\s*(?:\}|,\s*"scenario":\s*"[^"]*",\s*"reason":)')
MIN_BAND_VALUES = 3  # with two, a band is wider than the numbers it bounds


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Rule:
    """Tolerances of one quantity.

    Args:
        label: its name in reports.
        unit: of its numbers and tolerances.
        tolerance: for the same seed.
        relative_tolerance: of small numbers, where it allows less than `tolerance`.
        min_tolerance: the least that `relative_tolerance` allows.
        uses_band: whether seeds that are not in the table are compared with a band.
        better: direction.
    """

    label: str
    unit: str
    tolerance: float
    relative_tolerance: float | None
    min_tolerance: float
    uses_band: bool
    better: Literal["lower", "higher"]

    def allowed(self, value: float) -> float:
        """Return the allowed difference from a value, in the unit."""
        if self.relative_tolerance is None:
            return self.tolerance
        return min(self.tolerance, max(self.relative_tolerance * abs(value), self.min_tolerance))


class GoldenRow(_Part):
    """One number of a flight: by seed, in the order of the table's seeds."""

    band: tuple[float, float] | None
    by_seed: tuple[float, ...]


class GoldenTable(_Part):
    """Reference numbers of a scenario, with the reason for which they were accepted.

    `rows` have keys `quantity/window/follower`, without the parts that do not apply.
    `scenario_digests`, `files` and `value_digests` decide nothing: a comparison uses them to name
    what changed. Tolerances are those of `RULES`. `schema_version` is that of the file.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_version: Literal[2, 3] = Field(SCHEMA, alias="schema")
    scenario: str
    reason: str
    versions: dict[str, str]
    code: str = ""  # of the testbed that wrote the table; empty in early tables
    random: bool  # whether the seed changes any number
    seeds: tuple[int, ...]
    rows: dict[str, GoldenRow]
    metrics: tuple[str, ...]
    files: dict[str, str]  # digests by name
    value_digests: dict[str, str]  # `key_digests` of the YAML and .param files, by name
    scenario_digests: dict[str, str]  # `key_digests` of the resolved scenario, by section

    @model_validator(mode="after")
    def _check_rows(self) -> GoldenTable:
        for key, row in self.rows.items():
            if key.split("/")[0] not in RULES:
                raise ValueError(f"no rule for {key}")
            if not self.seeds or len(row.by_seed) != len(self.seeds):
                raise ValueError(f"{key} has {len(row.by_seed)} numbers, not one for each seed")
        return self

    def same_seed(self, key: str, seed: int) -> float | None:
        """Return a row's number for a seed: None if the table does not have it.

        Where the seed changes nothing, every seed has the number of the first.
        """
        values = self.rows[key].by_seed
        if not self.random:
            return values[0]
        return values[self.seeds.index(seed)] if seed in self.seeds else None


def _length(label: str, *, uses_band: bool, better: Literal["lower", "higher"]) -> Rule:
    # Rounding is far smaller, and changes of the product are larger: moving a slot by 0.001 mm
    # changes an RMS error by less than 0.0001 mm, changing a gain by 3 % by several millimetres.
    return Rule(label, "m", 1e-3, 0.01, 1e-6, uses_band, better)


def _time(label: str) -> Rule:
    # Times are counted in samples, 0.04 s apart, and rounding can move an event by a few of them.
    # They are not normally distributed over seeds, so they have no band.
    return Rule(label, "s", 0.2, None, 0.2, uses_band=False, better="lower")


RULES: Mapping[str, Rule] = {
    "rms_m": _length("RMS error", uses_band=True, better="lower"),
    "mean_rms_m": _length("mean RMS error", uses_band=True, better="lower"),
    "estimated_mean_rms_m": _length("mean estimated RMS error", uses_band=True, better="lower"),
    "relative_position_error_m": _length(
        "error of the estimated position relative to the leader", uses_band=True, better="lower"
    ),
    # a minimum is not normally distributed over seeds
    "min_separation_m": _length("minimum separation", uses_band=False, better="higher"),
    "joined_at_s": _time("joined at"),
    "saturated_s": _time("time in saturation"),
}
# Probability that a correct number is outside its band: of two hundred numbers of new seeds, one is
# outside by chance in one of 5000 checks.
FALSE_ALARM = 1e-6


def row_label(key: str) -> str:
    """Return a row's key as text: window and follower, then the quantity's label."""
    quantity, *where = key.split("/")
    label = RULES[quantity].label if quantity in RULES else quantity
    return " ".join((*where, label)) if where else label


def prediction_band(
    values: Sequence[float], *, false_alarm: float, min_half_width: float, new_values: int = 1
) -> tuple[float, float]:
    """Return the band that holds the mean of more values of the same kind.

    Mean ± t s √(1/m + 1/n) of n independent normal values, where s has n − 1 degrees of freedom and
    m is `new_values`. An RMS error over many correlation times of its noise is nearly normal.

    Args:
        values: n numbers of 0 or more, one per seed; at least `MIN_BAND_VALUES`.
        false_alarm: probability that a correct value is outside, both sides together.
        min_half_width: for rounding.
        new_values: m, the number of values whose mean is compared.

    Raises:
        ValueError: there are too few values.
    """
    n = len(values)
    if n < MIN_BAND_VALUES:
        raise ValueError(f"a band needs {MIN_BAND_VALUES} values, not {n}")
    mean = statistics.fmean(values)
    deviation = statistics.stdev(values) * math.sqrt(1.0 / new_values + 1.0 / n)
    half = max(student_quantile(false_alarm, n - 1) * deviation, min_half_width)
    return max(mean - half, 0.0), mean + half


def table_numbers(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the numbers of a flight for a table, by row key."""
    rows: dict[str, float | None] = {}
    relative = metrics["relative_position_error_m"]
    for window, numbers in metrics["windows"].items():
        rows |= {
            f"rms_m/{window}/{name}": rms
            for name, rms in numbers["rms_m"].items()
            if rms is not None or metrics["lost_at_s"][name] is None  # lost aircraft have none
        }
        rows[f"mean_rms_m/{window}"] = numbers["mean_rms_m"]
        if any(relative.values()):  # otherwise estimates are exact, and the two means are equal
            rows[f"estimated_mean_rms_m/{window}"] = numbers["estimated_mean_rms_m"]
    rows |= {f"relative_position_error_m/{name}": rms for name, rms in relative.items() if rms}
    rows["min_separation_m"] = metrics["min_separation_m"]
    rows |= {f"joined_at_s/{name}": time_s for name, time_s in metrics["joined_at_s"].items()}
    limits = metrics["saturations"]
    rows |= {f"saturated_s/{name}": limit["seconds"] for name, limit in limits.items()}
    return rows


def metric_names(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the sorted keys of a metrics document and of its windows."""
    windows = list(metrics["windows"].values())
    own = [key for key in metrics if key != "expect"]  # of the scenario, and no number of a flight
    return tuple(sorted([*own, *(f"windows.*.{key}" for key in (*windows, {})[0])]))


def make_table(
    flights: Mapping[int, Mapping[str, Any]],
    *,
    scenario: str,
    reason: str,
    random: bool,
    inputs: Inputs,
) -> GoldenTable:
    """Make a table from metrics documents by seed, all valid and of one structure.

    Numbers are rounded to a hundredth of the smallest tolerance.
    """
    measured = [table_numbers(metrics) for metrics in flights.values()]
    first = next(iter(flights.values()))
    rows = {
        key: _make_row(key, [_number(each[key]) for each in measured], random)
        for key in measured[0]
    }
    return GoldenTable(
        scenario=scenario,
        reason=reason,
        versions=dict(first["versions"]),
        code=describe_code(),
        random=random,
        seeds=tuple(flights),
        rows=rows,
        metrics=metric_names(first),
        files=dict(inputs.files),
        value_digests={name: key_digests(each) for name, each in inputs.values.items()},
        scenario_digests={name: key_digests(each) for name, each in inputs.scenario.items()},
    )


def _make_row(key: str, values: Sequence[float], random: bool) -> GoldenRow:
    rule = RULES[key.split("/")[0]]
    band = None
    if random and rule.uses_band:
        allowed = rule.allowed(statistics.fmean(values))
        low, high = prediction_band(values, false_alarm=FALSE_ALARM, min_half_width=allowed)
        band = round(low, DECIMALS), round(high, DECIMALS)
    return GoldenRow(band=band, by_seed=tuple(round(value, DECIMALS) for value in values))


def _number(value: float | None) -> float:
    if value is None:
        raise ValueError("a valid flight has every number")
    return value


def read_table(path: Path) -> GoldenTable:
    """Read a table.

    Raises:
        InputError: the file cannot be read, or is no table of `SCHEMAS`.
    """
    data = read_bounded(path, MAX_GOLDEN_BYTES)
    older = _of_schema_2(data)
    try:
        if older is not None:
            return GoldenTable.model_validate(older)
        return GoldenTable.model_validate_json(data)
    except ValidationError as error:
        first = error.errors()[0]
        if first["loc"] == ("schema",):
            raise InputError(
                f"{path}: is of schema {first['input']!r:.20}; this version reads "
                f"{' and '.join(map(str, SCHEMAS))}"
            ) from None
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(f"{path}: not a golden table: {where}: {first['msg']}") from None


def _of_schema_2(data: bytes) -> dict[str, Any] | None:
    """Return the content of a table of schema 2 with the keys of this one; None: it is none.

    It had copies of the scenario, of values in files and of the rules in place of digests.
    """
    try:
        table = parse_json_map(data)
    except ValueError:
        return None
    if table.get("schema") != SCHEMAS[0]:
        return None
    old = {key: table.pop(key, {}) for key in ("rules", "band", "values", "resolved_scenario")}
    for key, copies in (("value_digests", "values"), ("scenario_digests", "resolved_scenario")):
        sections = old[copies] if isinstance(old[copies], dict) else {}
        table[key] = {name: key_digests(each) for name, each in sections.items()}
    return table


def is_table(path: Path) -> bool:
    """Return whether a file is a golden table of any version, perhaps a damaged one.

    Raises:
        InputError: it cannot be read.
    """
    return _TABLE.match(read_bounded(path, MAX_GOLDEN_BYTES)) is not None


def write_table(path: Path, table: GoldenTable) -> None:
    """Write a table in one step.

    Raises:
        InputError: the folder cannot be made or written.
    """
    text = to_text(table.model_dump(mode="json", by_alias=True)) + "\n"
    with report_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_text_file(path) as file:
            file.write(text)


def to_text(value: object, indent: int = 0) -> str:
    """Return JSON with one line for each value that contains no map, for readable diffs."""
    inner = " " * (indent + 2)
    if isinstance(value, Mapping) and any(map(_contains_map, value.values())):
        items = [f"{inner}{json.dumps(k)}: {to_text(v, indent + 2)}" for k, v in value.items()]
        return "{\n" + ",\n".join(items) + "\n" + " " * indent + "}"
    if isinstance(value, list) and any(map(_contains_map, value)):
        items = [inner + to_text(each, indent + 2) for each in value]
        return "[\n" + ",\n".join(items) + "\n" + " " * indent + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _contains_map(value: object) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and any(map(_contains_map, value))
    )
