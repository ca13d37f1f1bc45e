"""The tasks of the benchmark: their files, which are frozen by digest, and their levels of chance.

A task is a file in scenarios/formation-bench-1.0. A manifest beside the tasks has the SHA-256 of
each file that decides a flight, except aircraft, whose files are part of the flight code.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, parse_json_map, read_bounded
from testbed.scenario import library
from testbed.scenario.fields import (
    Flag,
    Metres,
    Name,
    Number,
    Seconds,
    Section,
    Whole,
    merge_maps,
    raise_findings,
)
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import read

BENCHMARK = "formation-bench 1.0"
MANIFEST = "manifest.json"
LEVELS = 3
WINDOW = "scored"
Pair = tuple[Number, Number]


class Draw(Section):
    """What is drawn for a flight, and in which ranges; intervals are [from, to], uniform."""

    starts_m: tuple[Metres, Metres, Metres] = Field(
        description="Half widths of the box around a follower's start place, [forward, right, "
        "down], m."
    )
    legs_m: Pair = Field(description="Length of a leg, m.")
    turns_deg: Pair = Field(description="Change of course at a corner, degrees.")
    sides: Literal["one", "both"] = Field(
        description="Whether all corners of a flight turn to one side, or each to a drawn one."
    )
    climbs_m: Pair = Field(description="Change of altitude on a leg, up or down, m.")
    wind_mps: Pair = Field(description="Speed of the wind, m/s; its direction is any.")
    recorded_from_s: Pair | None = Field(
        None, description="Time of the recording at which the flight begins, s."
    )
    engine_out_s: Pair | None = Field(
        None, description="Time at which the engine of a drawn follower stops, s."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> Self:
        raise_findings(
            ((name,), f"is {list(value)} (write [from, to], growing)")
            for name, value in self
            if isinstance(value, tuple) and len(value) == 2 and not value[0] <= value[1]
        )
        return self


class ChanceLevel(Section):
    """What one level of chance changes of the level before."""

    draw: Mapping[str, Any] = Field(description="Keys of `draw` that change.")
    set: Mapping[str, Any] = Field({}, description="Keys of the scenario that change.")


class TaskHead(Section):
    """What is flown, and which part of it counts."""

    schema_: Whole = Field(alias="schema", ge=1, le=1, description="Version of the format.")
    name: Name = Field(description="Name of the file, without its ending.")
    question: str = Field(description="What the task asks.")
    scenario: str = Field(description="Scenario, in the folder of the task.")
    duration_s: Seconds = Field(200.0, description="Time of a flight, s.")
    window_s: tuple[Seconds, Seconds] = Field((60.0, 200.0), description="What counts, s.")
    begin_at_slots: Flag = Field(
        False, description="Whether each follower begins at the slot of another one."
    )
    recording: str | None = Field(None, description="Recorded leader, in scenarios/data.")
    set: Mapping[str, Any] = Field({}, description="Keys of the scenario, for all levels.")


class TaskFile(Section):
    """The file of a task."""

    task: TaskHead
    levels: tuple[ChanceLevel, ...] = Field(min_length=1, max_length=LEVELS)


@dataclass(frozen=True, slots=True)
class BenchmarkTask:
    """A task of the benchmark.

    Attributes:
        head: what is flown.
        draws: by level, from 1.
        settings: keys of the scenario by level.
        path: of its scenario.
    """

    head: TaskHead
    draws: tuple[Draw, ...]
    settings: tuple[Mapping[str, Any], ...]
    path: Path

    @property
    def name(self) -> str:
        """Its name."""
        return self.head.name


@dataclass(frozen=True, slots=True)
class Benchmark:
    """The tasks, as they are frozen.

    Attributes:
        name: with the version.
        digest: SHA-256 of the manifest.
        tasks: that are scored, by name.
        tuning: for tuning only.
    """

    name: str
    digest: str
    tasks: Mapping[str, BenchmarkTask]
    tuning: Mapping[str, BenchmarkTask]

    def task(self, name: str) -> BenchmarkTask:
        """Return a task of either kind."""
        return self.tasks[name] if name in self.tasks else self.tuning[name]


def default_folder() -> Path:
    """Return the folder of the tasks that come with the testbed."""
    return library() / "scenarios" / BENCHMARK.replace(" ", "-")


@cache
def load_benchmark(folder: Path | None = None) -> Benchmark:
    """Read the tasks of a folder; None: those that come with the testbed.

    Raises:
        InputError: a file is not as the manifest has it, or is no task.
    """
    folder = default_folder() if folder is None else folder
    manifest = read_bounded(folder / MANIFEST)
    try:
        found = parse_json_map(manifest)
        names = {kind: list(map(str, found[kind])) for kind in ("tasks", "tuning_tasks")}
        digests = {str(name): str(digest) for name, digest in found["files"].items()}
        title = str(found["benchmark"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{folder / MANIFEST}: is no manifest of a benchmark: {error}") from None
    for name, digest in digests.items():
        if file_digest(folder / name) != digest:
            raise InputError(
                f"{folder / name}: is not the file of {title}, whose SHA-256 is {digest} (put it "
                "back: a changed task is another benchmark)"
            )
    missing = [
        f"{name}.yaml"
        for name in (*names["tasks"], *names["tuning_tasks"])
        if f"{name}.yaml" not in digests
    ]
    if missing:
        raise InputError(f"{folder / MANIFEST}: files: has no {', '.join(missing)}")
    tasks = {kind: {each: load_task(folder, each) for each in names[kind]} for kind in names}
    digest = hashlib.sha256(manifest).hexdigest()
    return Benchmark(title, digest, tasks["tasks"], tasks["tuning_tasks"])


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        InputError: it cannot be read.
    """
    return hashlib.sha256(read_bounded(path, MAX_TABLE_BYTES)).hexdigest()


def load_task(folder: Path, name: str) -> BenchmarkTask:
    """Read the file of a task.

    Raises:
        InputError: it is no task.
    """
    path = folder / f"{name}.yaml"
    file = validate(read(path), TaskFile)
    if file.task.name != name:
        raise InputError(f"{path}: task.name: is {file.task.name} (write {name})")
    draws, settings = list[Draw](), list[Mapping[str, Any]]()
    draw: Mapping[str, Any] = {}
    changed: Mapping[str, Any] = file.task.set
    for number, level in enumerate(file.levels, start=1):
        draw, changed = merge_maps(draw, level.draw), {**changed, **level.set}
        try:
            draws.append(Draw.model_validate(draw))
        except ValueError as error:
            raise InputError(f"{path}: levels: draw of level {number}: {error}") from None
        settings.append(changed)
    return BenchmarkTask(file.task, tuple(draws), tuple(settings), folder / file.task.scenario)
