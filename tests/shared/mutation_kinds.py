"""Kinds of input files that are mutated, and how the testbed reads each."""

import json
import shutil
from contextlib import suppress
from unittest.mock import patch

import numpy as np
import small_study
from places import ROOT

from testbed.core.records import ActuatorCommand
from testbed.scenario import dump, load_guidance, load_middle_loop, load_scenario, set_duration

DATA = ROOT / "tests" / "data"
MAX_RUNS = 60  # of a study of which every run is resolved
ROWS = 40  # of a recording, to save time


class Kind:
    """One kind of input.

    Args:
        share: percent of the mutations.
        put: copies files below a home, and returns the paths that may be mutated.
        feed: reads a mutated file.
    """

    def __init__(self, share, put, feed):
        self.share, self.put, self.feed = share, put, feed


def copied(*sources, only):
    """Return a function that copies files and folders below a home; `only` selects for mutation."""

    def put(home):
        for source in sources:
            ignore = shutil.ignore_patterns("data", "golden", "__pycache__")
            to = home / source.relative_to(ROOT)
            to.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, to, ignore=ignore, dirs_exist_ok=True)
            else:
                to.write_bytes(source.read_bytes())
            if to.suffix == ".csv":
                to.write_bytes(b"".join(to.open("rb").readlines()[:ROWS]))
        return sorted(p for p in home.rglob("*") if p.is_file() and only(p))

    return put


def by_suffix(ending, *, within=""):
    return lambda path: path.suffix == ending and (not within or within in path.parent.parts)


def feed_scenario(path):
    """Resolve, dump and build it, and simulate 0.2 s."""
    from testbed.flight.loop import fly
    from testbed.plan.world import build

    scenario = load_scenario(path)
    dump(scenario)
    if "tests" in path.parts:
        return  # not flyable
    if (
        scenario.scenario.duration_s > 2000
        or len(scenario.aircraft) > 8
        or scenario.rates.autopilot_hz > 500
    ):
        return  # correct, but takes long
    begin = scenario.scenario.begin
    scenario = set_duration(scenario, 0.2 + (begin.at_s if begin else 0.0))
    world = build(scenario)
    if world.external_processes:
        return  # the programs are not installed
    fly(world, [], lambda now, due: False)


def feed_study(path):
    """Plan it, and resolve one of its runs, or all of few."""
    from testbed.studies.plan import Plan, load_study
    from testbed.studies.plan_check import check_plan

    plan = Plan(load_study(path))
    if len(plan) <= MAX_RUNS:
        check_plan(plan)
    else:
        plan[len(plan) - 1]


def feed_tune(path):
    from testbed.tuning.tune_schema import load_tune

    load_tune(path)


def feed_study_file(path):
    """Read a study, a tune, or a scenario of one of them."""
    if "tunes" in path.parts:
        feed_tune(path)
    elif path.parent.name == "studies":
        feed_study(path)
    else:
        load_scenario(path)


def feed_param(path):
    from testbed.autopilot.parameters import make_gains, read_params

    gains = make_gains([read_params(path)], 1.0 / 50.0)
    for name in gains.dtype.names:
        # unlimited where the parameters set no limit
        assert not np.isnan(gains[name]).any()


# Square with laps, a circle in a loop, actions, an endless circle, and a landing behind it.
WAYPOINTS = """QGC WPL 110
0 1 0 16 0 0 0 0 38 -3.5 300 1
1 0 3 22 15 0 0 0 0 0 100 1
2 0 3 16 0 0 0 0 38.004 -3.500 100 1
3 0 10 16 0 0 0 0 38.004 -3.495 120 1
4 0 2 178 0 24 -1 0 0 0 0 1
5 0 0 16 0 0 0 0 38.000 -3.495 410 1
6 0 2 177 2 3 0 0 0 0 0 1
7 0 3 18 2 0 -90 0 38.001 -3.5 100 1
8 0 3 206 50 0 0 0 0 0 0 1
9 0 3 31 0 100 0 0 38.001 -3.5 130 1
10 0 2 177 7 1 0 0 0 0 0 1
11 0 3 19 30 0 80 0 38.002 -3.5 130 1
12 0 3 17 0 0 70 0 38.002 -3.498 130 1
13 0 3 189 0 0 0 0 0 0 0 1
14 0 11 16 0 0 0 0 38.004 -3.499 60 1
15 0 3 21 0 0 0 0 38.000 -3.500 0 1
16 0 2 177 14 -1 0 0 0 0 0 1
17 0 3 20 0 0 0 0 0 0 0 1
"""


def make_mission(home):
    path = home / "square.waypoints"
    path.write_text(WAYPOINTS)
    return [path]


def feed_mission(path):
    """Plan the items, and resume each part and fly each item from here; the lines are not ours."""
    from testbed.core.errors import InputError
    from testbed.core.numbers import parse_number
    from testbed.core.records import NedOrigin
    from testbed.guidance.flight_plan import GuidanceMission
    from testbed.mavlink.mission_plans import plan_from_items
    from testbed.mavlink.vehicle_control import MissionItem, Rejection

    def plan(first):
        found = plan_from_items(items, here, params, 60.0, origin, first)
        if isinstance(found, Rejection):
            assert found.text.isprintable()
            raise InputError(f"{path.name}: {found.text}")
        segments = found.plan.segments
        assert len(segments) == len(found.items) == len(found.airspeeds)
        assert 0 <= found.plan.repeat_from < len(segments)
        assert set(found.items) <= set(range(1, len(items)))
        assert np.isfinite(
            [(*each.start, *each.end, each.turn, each.radius) for each in segments]
        ).all()
        return found

    items = []
    for line in path.read_text(errors="replace").splitlines()[1:]:
        values = [parse_number(word) for word in line.split()[:12]]
        if len(values) < 12 or None in values:
            raise InputError(f"{path.name}: {line!r}")
        _, _, frame, command, *four, x, y, z, _ = values
        items.append(MissionItem(int(command), int(frame), tuple(four), x, y, z))
    origin = NedOrigin(latitude_deg=38.0, longitude_deg=-3.5, elevation_m=300.0)
    params, here = GuidanceMission(legs=(), airspeed=22.0), (0.0, 0.0, 100.0)
    if len(items) < 2:
        return
    whole = plan(1)
    for first in range(0, len(whole.items), 1 + len(whole.items) // 20):
        left = whole.resume(first, here)
        assert 0 <= left.plan.repeat_from < len(left.items)
    for number in range(1, len(items)):
        plan_from_items(items, here, params, 60.0, origin, number)


def feed_gains(path):
    folder = path.parent
    if path.name == "guidance.yaml":
        load_guidance(folder)
    else:
        load_middle_loop(folder, "tuned")


def feed_table(path):
    """Read a recording by its name: leader, wind, trace, delays or commands."""
    from testbed.atmosphere.mean_wind import read_wind
    from testbed.commissioning.command_files import read_commands
    from testbed.guidance.recorded_path import read_recording, sample_recording
    from testbed.network.channel import make_channel
    from testbed.network.links import resolve_links
    from testbed.network.trace import TraceFile

    if "leader" in path.name:
        sample_recording(read_recording(path), np.linspace(0.0, 0.3, 7))
    elif "wind" in path.name:
        read_wind(path, 10.0, 0.5)
    elif "trace" in path.name:
        TraceFile(path).trace("lead", "uav1")
    elif "delays" in path.name:
        scenario = load_scenario(
            ROOT / "scenarios" / "simulation-3.yaml",
            [f"network.jitter={{distribution: empirical, file: {path}}}"],
        )
        make_channel(resolve_links(scenario.aircraft_names, scenario.network), 1)
    else:
        read_commands(path)


def feed_aircraft(path):
    """Load, linearize and trim an aircraft, and simulate five steps."""
    from testbed.core.records import NedOrigin
    from testbed.vehicle.fleet import JsbsimFleet
    from testbed.vehicle.jsbsim_adapter import airframe, linearize_aircraft
    from testbed.vehicle.trim import InitialState, TrimPoint

    folder = path if path.suffix != ".xml" else path.parent
    if folder.name in ("Engines", "Systems"):
        folder = folder.parent
    airframe(folder)
    linearize_aircraft(folder, TrimPoint(airspeed=20.0))
    start = InitialState(position_ned=(0.0, 0.0, -100.0), course=0.0, airspeed=20.0)
    fleet = JsbsimFleet([folder], [start], NedOrigin(), 200)
    for _ in range(5):
        fleet.step(ActuatorCommand(*(np.full(1, each) for each in (0.1, 0.1, 0.1, 0.5))), 4)
        fleet.lost(fleet.read())
        fleet.air()
    assert fleet.geometry is not None


def feed_log(path):
    """Read, print, report, compare and recover a log."""
    from testbed.golden.compare_runs import compare_runs
    from testbed.logs.flight_data import FlightData
    from testbed.logs.read import read_log, samples
    from testbed.reports import read_run, run_page
    from testbed.reports.html import render_page
    from testbed.runs.recover import recover

    log = read_log(path)
    repr(log)
    for _ in samples(log):
        pass
    if log.tick.size:
        render_page(run_page(read_run(path)))
        compare_runs(log, log) if log.metrics else None
    flight = FlightData(log)
    repr(flight)
    flight.documents()
    recover(path)


def make_log(home):
    """Simulate a second with a log."""
    import matplotlib.font_manager  # noqa: F401 - looks for fonts once, with a program

    import testbed

    scenario = set_duration(load_scenario("simulation-3"), 1.0)
    testbed.run(scenario, out=home / "run")
    return [home / "run" / "run.mcap"]


def make_study(home):
    """Fly a small study, and interrupt it once; return the result file and the journal."""
    import matplotlib.font_manager  # noqa: F401 - looks for fonts once, with a program

    from testbed.studies.sweep import sweep

    workers = small_study.InThisProcess()
    file, whole, half = (home / name for name in ("run/small.yaml", "run/whole", "run/half"))
    home.joinpath("run").mkdir()
    small_study.write(file.parent)

    def stop(done, total):
        if done == 4:
            raise KeyboardInterrupt

    with patch("testbed.pool.flight_pool._open_workers", lambda *_: workers):
        sweep(file, whole)
        with suppress(KeyboardInterrupt):
            sweep(file, half, progress=stop)
    return [whole / "study.parquet", half / "study.journal"]


def feed_result(path):
    """Report the result file of a study, or read its journal as a sweep that goes on does."""
    from testbed.cli.study_report import _document, read_study
    from testbed.reports.html import render_page
    from testbed.reports.study import study_page
    from testbed.studies.journal import Journal
    from testbed.studies.plan import Plan, load_study
    from testbed.studies.run_choice import choose_runs
    from testbed.studies.sweep import _refuse_changed_inputs
    from testbed.studies.table import StudyOutput, make_metadata, read_rows, write_table

    if path.suffix == ".parquet":
        read_rows(path)
        data = read_study(path, metrics=(), statistic="median")
        render_page(study_page(data))
        json.dumps(_document(data), allow_nan=False)
        return
    plan = Plan(load_study(path.parents[1] / "small.yaml"))
    journal = Journal(path)
    try:
        first = json.loads(path.read_bytes().splitlines()[0])["inputs"]
        _refuse_changed_inputs(StudyOutput(path.with_suffix(".parquet")), journal.inputs, first)
        journal.refuse_other_runs(len(plan))
        metadata = make_metadata(plan, dict.fromkeys(plan.cases, ""), {})
        choice = choose_runs(plan)
        for row in journal.rows():
            choice.add(row)
        write_table(path.with_name("again.parquet"), plan, journal, choice, metadata)
    finally:
        journal.close()


def make_benchmark(home):
    """Write an entry of a benchmark with its law, a result of two flights, and copy the tasks."""
    from testbed.benchmark.campaign import conditions, practice_seeds
    from testbed.benchmark.cell import lost_numbers
    from testbed.benchmark.entry import open_entries
    from testbed.benchmark.task import default_folder, load_benchmark

    tasks, entry, result = home / "tasks", home / "entry.yaml", home / "result.json"
    shutil.copytree(default_folder(), tasks)
    (home / "law.py").write_text("raise RuntimeError('imported')\n")
    entry.write_text(
        "entry: {schema: 1, name: mine}\nset: {formation.k: 2}\n"
        "tune:\n  formation.a: {from: 0.5, to: 2, start: 1}\n"
        "  formation.b: {from: 0, to: 1, start: 0.1}\n"
    )
    head = {"task": "wind", "level": 1, "outcome": "lost", "failure": "", "why": "lost: uav1"}
    document = {
        "schema": 1,
        "conditions": conditions(load_benchmark(), practice_seeds()).model_dump(mode="json"),
        "entry": {
            **{"name": "hbh23", "digest": open_entries(["hbh23"])[0].digest, "law": "hbh23"},
            **{"law_sha256": "", "function": "", "set": {}, "tuning": None},
        },
        "cells": [{**head, **lost_numbers(), "seed": seed} for seed in (1, 2)],
        **{"gains": {}, "messages": None, "margins": [], "cpu_s": 0.1, "command": "testbed"},
    }
    result.write_text(json.dumps(document, indent=1))
    return [entry, result, *sorted(tasks.glob("*-*.yaml"))]


def feed_benchmark(path):
    """Read an entry, a task, or a result, of which it makes the page."""
    from testbed.benchmark.entry import open_entries
    from testbed.benchmark.ranking import ranking
    from testbed.benchmark.result import read_result, to_document
    from testbed.benchmark.task import load_benchmark, load_task
    from testbed.reports.benchmark_page import benchmark_page, row_lines
    from testbed.reports.html import render_page

    if path.name == "entry.yaml":
        (entry,) = open_entries([f"{path.with_name('law.py')}:law"], [path])
        assert len(entry.digest) == 64
    elif path.suffix == ".yaml":
        load_task(path.parent, path.stem)
    else:
        result = read_result(path)
        json.dumps(to_document(result), allow_nan=False)
        found = ranking([result], load_benchmark())
        render_page(benchmark_page(found))
        list(row_lines(found))


AIRCRAFT = ROOT / "aircraft"
SOURCES = (ROOT / "scenarios", DATA / "scenarios", AIRCRAFT)
KINDS = {
    "scenarios": Kind(
        14,
        copied(
            *SOURCES,
            only=lambda p: (
                p.suffix == ".yaml"
                and not {"aircraft", "studies", "formation-bench-1.0"} & {*p.parts}
            ),
        ),
        feed_scenario,
    ),
    "studies": Kind(
        14, copied(*SOURCES, only=by_suffix(".yaml", within="studies")), feed_study_file
    ),
    "params": Kind(20, copied(*SOURCES, AIRCRAFT, only=by_suffix(".param")), feed_param),
    "missions": Kind(12, make_mission, feed_mission),
    "gains": Kind(12, copied(AIRCRAFT, only=by_suffix(".yaml")), feed_gains),
    "tables": Kind(
        20,
        copied(
            *(ROOT / "scenarios" / "data").glob("*.csv"),
            *(DATA / "scenarios").glob("*.csv"),
            *DATA.glob("*.csv"),
            only=by_suffix(".csv"),
        ),
        feed_table,
    ),
    "aircraft": Kind(8, copied(AIRCRAFT, only=by_suffix(".xml")), feed_aircraft),
    "logs": Kind(12, make_log, feed_log),
    "results": Kind(12, make_study, feed_result),
    "benchmarks": Kind(30, make_benchmark, feed_benchmark),
}
