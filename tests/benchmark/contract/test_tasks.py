"""The frozen tasks: their digests, what they draw, and that every flight can be built."""

import json
import shutil
from functools import cache

import numpy as np
import pytest
from cases import ALL

from testbed.benchmark.draws import LEAST_START_M, draw_flight, task_scenario
from testbed.benchmark.task import LEVELS, default_folder, load_benchmark
from testbed.core.errors import InputError
from testbed.guidance.recorded_path import read_recording
from testbed.scenario import find_data, open_scenario

# Of formation-bench 1.0, for ever: a task that must change is 1.1, in a folder of its own.
DIGEST = "dfe0d066cdab5c073b5ff027517fb54be011ffa9478b2e5674477b1b9ce4f500"
TASKS = (
    *("calm-corners", "recorded-leader", "loss", "wind", "turbulence", "sensors"),
    *("engine-out", "vee", "hard-path", "slot-change"),
)


@pytest.fixture(scope="module")
def benchmark():
    return load_benchmark()


@cache
def places(path):
    """Start places and slots by follower."""
    scenario = open_scenario(path).resolve()
    starts = {each.name: each.start_m for each in scenario.fleet}
    return starts, dict(scenario.formation.offsets_m)


def draw(benchmark, task, level, seed):
    return draw_flight(benchmark.name, task, level, seed, *places(task.path))


def test_the_tasks_are_frozen(benchmark):
    assert benchmark.digest == DIGEST
    assert tuple(benchmark.tasks) == TASKS
    assert all(len(task.draws) == LEVELS for task in benchmark.tasks.values())
    assert not set(benchmark.tuning) & set(TASKS)


def test_a_changed_task_is_an_error(tmp_path):
    folder = tmp_path / "tasks"
    shutil.copytree(default_folder(), folder)
    shutil.copytree(default_folder().parent / "data", tmp_path / "data")
    assert load_benchmark(folder).digest == DIGEST
    text = (folder / "wind.yaml").read_text()
    (folder / "wind.yaml").write_text(text.replace("[8, 8]", "[7, 7]"))
    load_benchmark.cache_clear()
    with pytest.raises(InputError, match=r"wind\.yaml: is not the file of formation-bench 1\.0"):
        load_benchmark(folder)


def test_a_manifest_names_each_task(tmp_path):
    folder = tmp_path / "tasks"
    shutil.copytree(default_folder(), folder)
    shutil.copytree(default_folder().parent / "data", tmp_path / "data")
    found = json.loads((folder / "manifest.json").read_text())
    del found["files"]["vee.yaml"]
    (folder / "manifest.json").write_text(json.dumps(found))
    with pytest.raises(InputError, match=r"has no vee\.yaml"):
        load_benchmark(folder)


@pytest.mark.parametrize("name", TASKS)
def test_every_task_draws_places_path_and_wind(benchmark, name):
    """Two seeds differ in each of them, at each level; one seed gives one flight."""
    task = benchmark.tasks[name]
    for level in range(1, LEVELS + 1):
        one, two = (draw(benchmark, task, level, seed) for seed in (1, 2))
        assert one == draw(benchmark, task, level, 1)
        assert one.seed != two.seed
        assert one.starts_m != two.starts_m
        assert one.course_deg != two.course_deg
        assert one.points_m != two.points_m
        assert one.wind[1] != two.wind[1]
        assert one.wind[0] > 0.0
        assert (one.recorded is None) == (name != "recorded-leader")
        assert (one.failed is None) == (name != "engine-out")


def test_a_draw_depends_on_benchmark_task_and_level(benchmark):
    task = benchmark.tasks["wind"]
    found = [
        draw_flight(name, which, level, 1, *places(task.path))
        for name, which, level in (
            (benchmark.name, task, 1),
            ("formation-bench 1.1", task, 1),
            (benchmark.name, benchmark.tasks["loss"], 1),
            (benchmark.name, task, 2),
        )
    ]
    assert len({each.course_deg for each in found}) == len(found)


def test_start_places_are_apart_and_within_the_box(benchmark):
    for task in benchmark.tasks.values():
        for level, ranges in enumerate(task.draws, start=1):
            for seed in range(20 if ALL else 8):
                found = draw(benchmark, task, level, seed).starts_m
                drawn = np.vstack([np.zeros(3), *found.values()])
                apart = np.linalg.norm(drawn[:, np.newaxis] - drawn, axis=2)
                assert apart[np.triu_indices(len(drawn), 1)].min() >= LEAST_START_M
                if not task.head.begin_at_slots:
                    middle = np.array(list(places(task.path)[0].values()))
                    assert (np.abs(drawn[1:] - middle) <= np.array(ranges.starts_m) + 1e-9).all()


def test_levels_of_chance_grow(benchmark):
    for task in benchmark.tasks.values():
        boxes = [np.prod(each.starts_m) for each in task.draws]
        legs = [each.legs_m[1] - each.legs_m[0] for each in task.draws]
        assert boxes == sorted(boxes)
        assert boxes[0] < boxes[-1]
        assert legs == sorted(legs)


def test_no_follower_begins_at_its_own_slot(benchmark):
    task = benchmark.tasks["slot-change"]
    offsets = places(task.path)[1]
    for seed in range(20):
        for name, place in draw(benchmark, task, 1, seed).starts_m.items():
            nearest = min(
                offsets, key=lambda each: np.linalg.norm(np.subtract(offsets[each], place))
            )
            assert nearest != name


@pytest.mark.parametrize("name", [*TASKS, "tuning-air", "tuning-radio"])
def test_every_level_can_be_flown(benchmark, name, tmp_path):
    task = benchmark.task(name)
    for level in range(1, len(task.draws) + 1):
        scenario, drawn = task_scenario(
            benchmark.name, task, level, 7, settings={}, folder=tmp_path
        )
        assert scenario.scenario.seed == drawn.seed
        assert scenario.air.wind.speed_mps == drawn.wind[0]
        assert scenario.air.wind.from_deg == drawn.wind[1]
        assert {each.name: each.start_m for each in scenario.fleet} == drawn.starts_m
        assert scenario.controller.bounded_speed == "airspeed"


def test_a_recording_is_turned_and_keeps_its_motion(benchmark, tmp_path):
    """Speeds, heights and banks are those of the recording; only course and side differ."""
    task = benchmark.tasks["recorded-leader"]
    whole = read_recording(find_data(task.head.recording))
    sides = set()
    for seed in (1, 2, 3, 4) if ALL else (1, 3):
        scenario, drawn = task_scenario(benchmark.name, task, 1, seed, settings={}, folder=tmp_path)
        part = read_recording(scenario.leader.path.file)
        from_s, mirrored = drawn.recorded
        sides.add(mirrored)
        first = int(np.searchsorted(whole.time, from_s))
        used = slice(first, first + len(part.time))
        speed = np.linalg.norm(whole.velocity_ned[used], axis=1)
        assert np.linalg.norm(part.velocity_ned, axis=1) == pytest.approx(speed, abs=1e-5)
        assert part.position_ned[:, 2] == pytest.approx(whole.position_ned[used, 2], abs=1e-5)
        side = -1.0 if mirrored else 1.0
        assert part.euler[:, 0] == pytest.approx(side * whole.euler[used, 0], abs=1e-5)
        course = np.degrees(np.arctan2(part.velocity_ned[0, 1], part.velocity_ned[0, 0])) % 360.0
        assert course == pytest.approx(drawn.course_deg, abs=1e-3)
        assert part.time[-1] >= task.head.duration_s
    assert sides == {True, False}
