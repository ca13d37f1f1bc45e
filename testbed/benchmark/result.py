"""The result of an entry: a JSON file with strict keys, which is read as data alone.

Nothing in it is a path or code that is run: the law comes from the command line, and its digest
must be that of the file. All numbers are finite and within bounds.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from testbed.benchmark.cell import FAILED, FLOWN, LOST_M, CellKey
from testbed.benchmark.entry import KEYS, Setting
from testbed.benchmark.seeds import PRACTICE, rank_seeds
from testbed.benchmark.task import LEVELS, Benchmark
from testbed.core.errors import InputError
from testbed.core.input_files import parse_json_map, read_bounded
from testbed.core.records import Array
from testbed.scenario.fields import Finding, Flag, Name, Number, Section, Whole, raise_findings

SCHEMA = 1
MAX_BYTES = 4_000_000
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Text = Annotated[str, Field(max_length=300)]
Seed = Annotated[Whole, Field(ge=0, lt=2**63)]
Metres = Annotated[Number, Field(ge=0, le=1e9)]
Keys = Mapping[Annotated[str, Field(max_length=100)], Setting]


class CellRecord(Section):
    """Numbers of one flight; see `cell`."""

    task: Name
    level: Annotated[Whole, Field(ge=1, le=LEVELS)]
    seed: Seed
    outcome: Literal["flown", "lost", "failed"]
    failure: Literal["", "exception", "time", "memory", "crash"]
    why: Text
    number_m: Annotated[Number, Field(ge=0, le=LOST_M)]
    lost_at_s: Metres | None
    separation_joining_m: Metres | None
    separation_window_m: Metres | None
    saturated_s: Metres | None
    effort: Metres | None

    @property
    def key(self) -> CellKey:
        """Which flight it is."""
        return CellKey(self.task, self.level, self.seed)


class TunedGain(Section):
    """A gain before and after tuning, and its bounds."""

    low: Number
    high: Number
    scale: Literal["linear", "log"]
    start: Number
    tuned: Number


class TuningRecord(Section):
    """How the gains of an entry were tuned."""

    tasks: tuple[Name, ...]
    seeds: tuple[Seed, ...]
    budget: Whole
    flights: Whole
    cost_before_m: Metres
    cost_after_m: Metres
    gains: Mapping[Annotated[str, Field(max_length=100)], TunedGain]


class EntryRecord(Section):
    """The entry."""

    name: Name
    digest: Digest
    law: Text = Field(description="Name of the law's file, for people, or a law of the testbed.")
    law_sha256: Annotated[str, Field(pattern=r"^([0-9a-f]{64})?$")]
    function: Annotated[str, Field(max_length=200)]
    set: Keys = Field(description="Settings before tuning.")
    tuning: TuningRecord | None


class MessagesRecord(Section):
    """What a follower needs to receive."""

    neighbours: Flag = Field(description="Whether a flight changes without those of followers.")
    per_s: Metres


class MarginRecord(Section):
    """Margins of all followers in one steady flight, the least; None: beyond what was tried."""

    bank_deg: Number
    problem: Text
    damping: Number | None
    factor: Number | None
    phase_deg: Number | None
    latency_s: Number | None


class SeedsRecord(Section):
    """Which seeds, and where they come from."""

    kind: Literal["practice", "pulse"]
    pulse: Annotated[str, Field(max_length=1024)]
    entries: tuple[Digest, ...] = Field(max_length=100)
    values: tuple[Seed, ...] = Field(min_length=1, max_length=1000)


class Conditions(Section):
    """All that numbers of two entries must have in common to stand in one table."""

    benchmark: Text
    benchmark_digest: Digest
    code: Mapping[Name, Text] = Field(description="Digests of the testbed's code and aircraft.")
    pins: Mapping[Name, Text] = Field(description="Versions of what flies, and the machine.")
    limits: Mapping[Name, Whole] = Field(description="Of one flight.")
    seeds: SeedsRecord


class EntryResult(Section):
    """The result of an entry."""

    schema_: Literal[1] = Field(alias="schema")
    conditions: Conditions
    entry: EntryRecord
    gains: Keys = Field(description="What was flown: settings and tuned gains.")
    cells: tuple[CellRecord, ...] = Field(max_length=100_000)
    messages: MessagesRecord | None
    margins: tuple[MarginRecord, ...] = Field(max_length=10)
    cpu_s: Metres = Field(description="Processor time of one flight, the median, s.")
    command: Text = Field(description="Repeats a cell, in place of CELL: task/level/seed.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        findings: list[Finding] = []
        if len({each.key for each in self.cells}) < len(self.cells):
            findings.append((("cells",), "has a flight twice"))
        for number, each in enumerate(self.cells):
            if each.outcome != FLOWN and each.number_m != LOST_M:
                text = (
                    f"is {each.number_m:g}, of a flight that was {each.outcome} (it is {LOST_M:g})"
                )
                findings.append((("cells", number, "number_m"), text))
            if (each.outcome == FAILED) != bool(each.failure):
                findings.append((("cells", number, "failure"), "does not fit the outcome"))
        findings += [
            (("gains", key), "is not a key of a law")
            for key in self.gains
            if not KEYS.fullmatch(key)
        ]
        tuned = {} if self.entry.tuning is None else self.entry.tuning.gains
        if dict(self.gains) != {**self.entry.set, **{k: v.tuned for k, v in tuned.items()}}:
            findings.append((("gains",), "are not the settings and the tuned gains of the entry"))
        raise_findings(findings)
        return self


def to_document(result: EntryResult) -> dict[str, Any]:
    """Return a result as plain data for JSON."""
    document: dict[str, Any] = result.model_dump(mode="json", by_alias=True)
    return document


def parse_result(data: bytes, source: str) -> EntryResult:
    """Read a result.

    Args:
        data: of the file.
        source: its name, for errors.

    Raises:
        InputError: it is no result.
    """
    try:
        return EntryResult.model_validate_json(json.dumps(parse_json_map(data)))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{source}: is no result of testbed benchmark: {where}: {first['msg']}"
        ) from None
    except ValueError as error:
        raise InputError(f"{source}: is no result of testbed benchmark: {error}") from None


def read_result(path: Path) -> EntryResult:
    """Read the file of a result.

    Raises:
        InputError: it cannot be read, or is no result.
    """
    return parse_result(read_bounded(path, MAX_BYTES), str(path))


def cell_keys(benchmark: Benchmark, seeds: Iterable[int]) -> list[CellKey]:
    """Return all flights of the benchmark, in their order."""
    numbers = tuple(seeds)
    return [
        CellKey(name, level, seed)
        for name, task in benchmark.tasks.items()
        for level in range(1, len(task.draws) + 1)
        for seed in numbers
    ]


def missing_cells(result: EntryResult, benchmark: Benchmark) -> list[CellKey]:
    """Return the flights of the benchmark that a result does not have."""
    known = {each.key for each in result.cells}
    return [key for key in cell_keys(benchmark, result.conditions.seeds.values) if key not in known]


def check_seeds(result: EntryResult) -> None:
    """Check that the seeds of a result are those that follow from what it names.

    Raises:
        InputError: they are others.
    """
    conditions = result.conditions
    seeds = conditions.seeds
    if seeds.kind == "practice":
        expected: Sequence[int] = PRACTICE
    else:
        name = f"{conditions.benchmark} {conditions.benchmark_digest}"
        expected = rank_seeds(name, seeds.entries, seeds.pulse)
        if result.entry.digest not in seeds.entries:
            raise InputError(
                f"{result.entry.name}: the seeds were drawn for other entries (fly it together "
                "with them)"
            )
    if tuple(seeds.values) != tuple(expected):
        raise InputError(f"{result.entry.name}: has other seeds than those of its {seeds.kind}")


def check_complete(result: EntryResult, benchmark: Benchmark) -> None:
    """Check that a result has all flights, and no others.

    Raises:
        InputError: it has not: what was left out might have been what is hard.
    """
    name, seeds = result.entry.name, result.conditions.seeds.values
    if missing := missing_cells(result, benchmark):
        raise InputError(
            f"{name}: has {len(missing)} flights too few, such as {missing[0]}: no rank is given "
            "to a part (fly all of them)"
        )
    if len(result.cells) > len(cell_keys(benchmark, seeds)):
        raise InputError(f"{name}: has flights that are not of the benchmark")


def check_same_conditions(results: Sequence[EntryResult]) -> None:
    """Check that results may stand in one table.

    Raises:
        InputError: they may not; with what differs.
    """
    first = results[0]
    one = _flat(first.conditions.model_dump(mode="json"))
    for other in results[1:]:
        two = _flat(other.conditions.model_dump(mode="json"))
        different = [key for key in dict.fromkeys((*one, *two)) if one.get(key) != two.get(key)]
        if different:
            key = different[0]
            raise InputError(
                f"{first.entry.name} and {other.entry.name} do not stand in one table: {key} is "
                f"{str(one.get(key))[:80]} and {str(two.get(key))[:80]} (fly both with the same)"
            )


def _flat(value: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, each in value.items():
        name = f"{prefix}{key}"
        found |= _flat(each, f"{name}.") if isinstance(each, Mapping) else {name: each}
    return found


def seed_numbers(result: EntryResult, benchmark: Benchmark) -> dict[str, Array]:
    """Return the numbers (S,) of the seeds by task: the mean over the levels, m."""
    seeds = result.conditions.seeds.values
    by_key = {each.key: each.number_m for each in result.cells}
    return {
        name: np.mean(
            [
                [by_key[CellKey(name, level, seed)] for seed in seeds]
                for level in range(1, len(task.draws) + 1)
            ],
            axis=0,
        )
        for name, task in benchmark.tasks.items()
    }
