"""Draw a flight of a task: start places, path, wind, and what else the task leaves to chance.

A draw depends on benchmark, task, level and seed alone, by named streams: what one draws does not
move what another one draws. Numbers are rounded to a millimetre, a millidegree, a mm/s or a ms.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from testbed.benchmark.task import WINDOW, BenchmarkTask, Draw
from testbed.core.files import write_text_file
from testbed.core.random import named_stream
from testbed.core.records import Array
from testbed.guidance.recorded_path import COLUMNS, RecordedFlight, read_recording
from testbed.scenario import Scenario, ScenarioFile, find_data, open_scenario
from testbed.scenario.set_keys import SetKeys
from testbed.scenario.yaml_io import to_inline

ALTITUDES_M = 90.0, 210.0  # of corners
LEAST_START_M = 6.0  # between any two aircraft at the start
LONGEST_MPS = 34.0  # over the ground, for which a path is long enough
FAR_M = 20_000.0  # of the last leg
_TRIES = 1000
RECORDING = "recording.csv"


@dataclass(frozen=True, slots=True)
class DrawnFlight:
    """What is drawn for one flight.

    Attributes:
        seed: of the streams in the flight itself, such as lost messages.
        starts_m: by follower, [forward, right, down] of the leader's start.
        course_deg: of the leader at the start.
        points_m: corners of the path, [north, east, altitude].
        wind: speed, m/s, and the direction that it comes from, degrees.
        failed: row of the follower whose engine stops, and when, s; None: none does.
        recorded: time, s, of the recording at which the flight begins, and whether it is mirrored;
            None: the path is that of the corners.
    """

    seed: int
    starts_m: Mapping[str, tuple[float, ...]]
    course_deg: float
    points_m: Sequence[tuple[float, ...]]
    wind: tuple[float, float]
    failed: tuple[int, float] | None
    recorded: tuple[float, bool] | None


def draw_flight(
    benchmark: str,
    task: BenchmarkTask,
    level: int,
    seed: int,
    starts_m: Mapping[str, Sequence[float]],
    offsets_m: Mapping[str, Sequence[float]],
) -> DrawnFlight:
    """Draw a flight.

    Args:
        benchmark: its name, with the version.
        task: of it.
        level: from 1.
        seed: of the cell.
        starts_m: start places of the followers, before the draw.
        offsets_m: their slots.
    """
    name = f"{benchmark}/{task.name}/{level}"
    ranges = task.draws[level - 1]

    def stream(what: str) -> np.random.Generator:
        return named_stream(seed, f"{name}/{what}")

    places = {k: tuple(v) for k, v in starts_m.items()}
    if task.head.begin_at_slots:
        places = _other_slots(offsets_m, stream("slots"))
    course, points = _draw_path(ranges, task.head.duration_s, stream("path"))
    wind, others = stream("wind"), stream("others")
    failed, recorded = None, None
    if ranges.engine_out_s is not None:
        row = int(others.integers(len(places)))
        failed = row, round(float(others.uniform(*ranges.engine_out_s)), 3)
    if task.head.recording is not None and ranges.recorded_from_s is not None:
        from_s = round(float(others.uniform(*ranges.recorded_from_s)), 3)
        recorded = from_s, bool(others.integers(2))
    digest = hashlib.sha256(f"{name}/{seed}/flight".encode()).digest()
    return DrawnFlight(
        seed=int.from_bytes(digest[:8], "little") >> 1,
        starts_m=_draw_starts(places, ranges.starts_m, stream("starts")),
        course_deg=course,
        points_m=points,
        wind=(
            round(float(wind.uniform(*ranges.wind_mps)), 3),
            round(float(wind.uniform(0.0, 360.0)), 3) % 360.0,
        ),
        failed=failed,
        recorded=recorded,
    )


def _draw_starts(
    places: Mapping[str, tuple[float, ...]], widths: Sequence[float], random: np.random.Generator
) -> dict[str, tuple[float, ...]]:
    """Draw start places with at least `LEAST_START_M` between any two aircraft."""
    middle, width = np.array(list(places.values())), np.array(widths)
    for _ in range(_TRIES):
        drawn = np.round(middle + width * random.uniform(-1.0, 1.0, middle.shape), 3)
        found = np.vstack([np.zeros(3), drawn])
        apart = np.linalg.norm(found[:, np.newaxis] - found, axis=2)
        if apart[np.triu_indices(len(found), 1)].min() >= LEAST_START_M:
            return dict(zip(places, map(tuple, drawn.tolist()), strict=True))
    raise ValueError(f"no start places that are {LEAST_START_M} m apart in {_TRIES} draws")


def _other_slots(
    offsets_m: Mapping[str, Sequence[float]], random: np.random.Generator
) -> dict[str, tuple[float, ...]]:
    """Give each follower the slot of another one."""
    names = list(offsets_m)
    order = random.permutation(len(names))
    while (order == np.arange(len(names))).any():
        order = random.permutation(len(names))
    return {name: tuple(offsets_m[names[k]]) for name, k in zip(names, order.tolist(), strict=True)}


def _draw_path(
    ranges: Draw, duration_s: float, random: np.random.Generator
) -> tuple[float, list[tuple[float, ...]]]:
    """Draw the first course, degrees, and corners from the origin on, for the whole flight."""
    course = round(float(random.uniform(0.0, 360.0)), 3)
    side = 1.0 if random.integers(2) else -1.0
    north, east, altitude, length, heading = 0.0, 0.0, 150.0, 0.0, math.radians(course)
    points: list[tuple[float, ...]] = []
    while length < LONGEST_MPS * duration_s:
        leg = float(random.uniform(*ranges.legs_m))
        turn = math.radians(float(random.uniform(*ranges.turns_deg)))
        climb = float(random.uniform(*ranges.climbs_m)) * (1.0 if random.integers(2) else -1.0)
        drawn = 1.0 if random.integers(2) else -1.0
        north, east = north + leg * math.cos(heading), east + leg * math.sin(heading)
        low, high = ALTITUDES_M
        altitude += climb if low <= altitude + climb <= high else -climb
        points.append((round(north, 3), round(east, 3), round(altitude, 3)))
        heading += turn * (drawn if ranges.sides == "both" else side)
        length += leg
    # not reached; far, so that it does not matter where the others are
    north, east = north + FAR_M * math.cos(heading), east + FAR_M * math.sin(heading)
    points.append((round(north, 3), round(east, 3), round(altitude, 3)))
    return course, points


@cache
def _open(path: Path) -> tuple[ScenarioFile, Mapping[str, Any], Mapping[str, Any]]:
    """Return a scenario file, and its start places and slots by follower."""
    file = open_scenario(path)
    scenario = file.resolve()
    starts = {each.name: list(each.start_m) for each in scenario.fleet}
    return file, starts, {name: list(scenario.formation.offsets_m[name]) for name in starts}


def task_scenario(
    benchmark: str,
    task: BenchmarkTask,
    level: int,
    seed: int,
    *,
    settings: Mapping[str, Any],
    folder: Path,
) -> tuple[Scenario, DrawnFlight]:
    """Return the scenario of a flight, and what was drawn for it.

    Args:
        benchmark: its name, with the version.
        task: of it.
        level: from 1.
        seed: of the cell.
        settings: keys of the law.
        folder: to which the recording of a recorded leader is written.

    Raises:
        InputError: it cannot be flown with these settings.
    """
    file, starts_m, offsets_m = _open(task.path)
    drawn = draw_flight(benchmark, task, level, seed, starts_m, offsets_m)
    speed_mps, from_deg = drawn.wind
    begin_s, end_s = task.head.window_s
    changes: dict[str, Any] = {
        "scenario.seed": drawn.seed,
        "scenario.duration_s": task.head.duration_s,
        f"scenario.windows.{WINDOW}": [begin_s, end_s],
        "air.wind.speed_mps": speed_mps,
        "air.wind.from_deg": from_deg,
        **task.settings[level - 1],
    }
    for name, place in drawn.starts_m.items():
        changes[f"fleet.{name}.start_m"] = list(place)
    if drawn.failed is not None:
        row, at_s = drawn.failed
        name = list(drawn.starts_m)[row]
        changes[f"fleet.{name}.faults"] = [{"kind": "engine-out", "at_s": at_s}]
    if drawn.recorded is None:
        changes["leader.start.course_deg"] = drawn.course_deg
        legs = [{"kind": "waypoints", "points_m": [list(each) for each in drawn.points_m]}]
        changes["leader.path.legs"] = legs
    else:
        assert task.head.recording is not None
        path = folder / RECORDING
        from_s, mirrored = drawn.recorded
        recording = _recording(task.head.recording)
        write_part(path, recording, from_s, task.head.duration_s, drawn.course_deg, mirrored)
        changes["leader.start"] = None
        changes["leader.path"] = {"kind": "replay", "file": str(path)}
    texts = [f"{key}={to_inline(value)}" for key, value in {**changes, **settings}.items()]
    return file.resolve(texts).with_set_keys(SetKeys()), drawn


@cache
def _recording(name: str) -> RecordedFlight:
    return read_recording(find_data(name))


def write_part(
    path: Path,
    flight: RecordedFlight,
    from_s: float,
    duration_s: float,
    course_deg: float,
    mirrored: bool,
) -> None:
    """Write a part of a recorded flight, turned to a course, as a recording from 0 s on.

    Args:
        path: of the file.
        flight: the recording.
        from_s: where the part begins.
        duration_s: how long it is.
        course_deg: that its first velocity has; it begins above the origin.
        mirrored: whether right and left are exchanged.
    """
    used = (flight.time >= from_s) & (flight.time <= from_s + duration_s + 2.0)
    position, velocity = flight.position_ned[used].copy(), flight.velocity_ned[used].copy()
    euler, rates = flight.euler[used].copy(), flight.rates_body[used].copy()
    position[:, :2] -= position[0, :2]
    if mirrored:
        position[:, 1] *= -1.0
        velocity[:, 1] *= -1.0
        euler[:, [0, 2]] *= -1.0
        rates[:, [0, 2]] *= -1.0
    turn = math.radians(course_deg) - math.atan2(velocity[0, 1], velocity[0, 0])
    cos, sin = math.cos(turn), math.sin(turn)
    for each in (position, velocity):
        north, east = each[:, 0].copy(), each[:, 1].copy()
        each[:, 0], each[:, 1] = cos * north - sin * east, sin * north + cos * east
    euler[:, 2] += turn
    time = flight.time[used] - flight.time[used][0]
    rows: Array = np.column_stack(
        [time, position, velocity, euler, rates, flight.airspeed[used], flight.throttle[used]]
    )
    with write_text_file(path) as file:
        file.write(",".join(COLUMNS) + "\n")
        file.writelines(",".join(f"{each:.6f}" for each in row) + "\n" for row in rows.tolist())
