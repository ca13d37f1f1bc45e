"""Numbers of the README and of the result pages: equal to the golden tables and to each other."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import yaml
from places import ROOT
from result_tables import (
    CONDITIONS,
    EXPERIMENTS,
    FREEDOMS,
    HARD_PATHS,
    MARKS,
    PAPER,
    SIMULATIONS,
    missing_texts,
    page,
    six,
    table,
    the_row,
)
from run_flight import Collector

from testbed.core.frames import GRAVITY
from testbed.runs.run import run
from testbed.scenario import library, load_scenario, set_duration

UAVS = ("uav1", "uav2", "uav3")
WINDOWS = ("rectangles", "circles")
PRINTED = 0.005 + 1e-3  # m: rounded to two digits, and the tolerance of golden tables
EXPERIMENT_SEEDS = range(5)  # indices of the seeds of docs/results/experiments.md


def golden(scenario: str) -> dict[str, list[float]]:
    """Return the RMS errors of a golden table by key, m, one per seed."""
    text = (ROOT / "scenarios" / "golden" / f"{scenario}.json").read_text(encoding="utf-8")
    return {key: row["by_seed"] for key, row in json.loads(text)["rows"].items()}


def golden_errors(scenario: str) -> list[float]:
    """Return the RMS errors of a golden table at its first seed, m, by window and follower."""
    rows = golden(scenario)
    return [rows[f"rms_m/{window}/{name}"][0] for window in WINDOWS for name in UAVS]


# golden tables

GOLDEN_ROWS = {
    "simulation-1": (PAPER, "Simulation 1", "profile `tuned`"),
    "simulation-2": (PAPER, "Simulation 2", "profile `tuned`"),
    "simulation-3": (PAPER, "Simulation 3", "profile `tuned`"),
    "simulation-3-improved": (PAPER, "Simulation 3", "profile `improved`"),
    "simulation-3-noise": (CONDITIONS, "GPS/INS noise: `simulation-3-noise`", "`tuned`"),
    "simulation-3-latency": (
        CONDITIONS,
        "latency 0.1 s, compensated: `simulation-3-latency`",
        "`tuned`",
    ),
    "simulation-3-30deg": (HARD_PATHS, "`simulation-3-30deg`", "`tuned`"),
    "simulation-3-hard": (HARD_PATHS, "`simulation-3-hard`", "`tuned`"),
    "simulation-3-recorded-leader": (HARD_PATHS, "`simulation-3-recorded-leader`", "`tuned`"),
}


def test_pasted_errors_of_the_readme_equal_golden_ones():
    lines = [line.split() for line in page("README.md").splitlines()]
    pasted = [line for line in lines if line and re.fullmatch(r"uav\d", line[0])][:3]
    found = [float(line[column]) for column in (1, 4) for line in pasted]
    assert found == pytest.approx(golden_errors("simulation-3"), abs=PRINTED)


@pytest.mark.parametrize("scenario", GOLDEN_ROWS)
def test_pasted_errors_equal_the_golden_table(scenario):
    heading, *start = GOLDEN_ROWS[scenario]
    cells = the_row(table(SIMULATIONS, heading), *start)
    found = [float(cell) for cell in (*cells[:3], *cells[4:7])]
    assert found == pytest.approx(golden_errors(scenario), abs=PRINTED)


def test_pasted_errors_of_experiments_are_golden():
    """Mean and range of five seeds."""
    rows = table(
        "docs/results/experiments.md", "window | follower | [HBH23], m | testbed, m | largest"
    )
    assert len(rows) == 6
    for experiment, window, follower, _, cell, *_ in rows:
        by_seed = golden(experiment.lower().replace(" ", "-"))[f"rms_m/{window}/{follower}"]
        values = [by_seed[index] for index in EXPERIMENT_SEEDS]
        found = [float(number) for number in re.findall(r"[\d.]+", cell)]
        assert found == pytest.approx([np.mean(values), min(values), max(values)], abs=PRINTED), (
            experiment,
            window,
            follower,
        )


# rows that two tables have


@pytest.mark.parametrize(
    ("instead", "label"),
    [
        ("", "profile `tuned`"),
        ("own phases, 10 Hz", "`tuned`, own phases at 10 Hz"),
        ("`authors`", "profile `authors`"),
    ],
)
def test_freedoms_have_the_means_of_the_results(instead, label):
    (row,) = (each for each in table(SIMULATIONS, FREEDOMS) if each[2] == instead)
    for simulation in (1, 2, 3):
        cells = the_row(table(SIMULATIONS, PAPER), f"Simulation {simulation}", label)
        means = [cell.rstrip(MARKS) for cell in row[1 + 2 * simulation : 3 + 2 * simulation]]
        assert means == [cells[3], cells[7]]


def test_freedoms_have_the_noise_of_the_results():
    (row,) = (each for each in table(SIMULATIONS, FREEDOMS) if each[2] == "GPS/INS noise")
    cells = the_row(
        table(SIMULATIONS, CONDITIONS), "GPS/INS noise: `simulation-3-noise`", "`tuned`"
    )
    assert row[7:9] == [cells[3], cells[7]]


def test_experiments_page_has_rascals_of_simulation_3():
    (row,) = (r for r in table(EXPERIMENTS, "RMS error, m | laps") if "Rascals" in r[0])
    expected = six(the_row(table(SIMULATIONS, PAPER), "Simulation 3", "profile `tuned`"))
    assert row[1:7] == expected


# numbers in the prose, computed from scenarios and tables


def simulation_claims() -> Iterator[str]:
    """Yield texts of docs/results/simulations.md."""
    scenario = load_scenario("simulation-3")
    path, windows = scenario.leader.path, scenario.scenario.windows
    square, high = path.legs[1].points_m, path.legs[2].points_m
    side, loiter = square[1][0], path.legs[3]
    assert path.legs[1].laps + path.legs[2].laps == 4
    yield f"a square of {side:g} m, four laps"
    yield "evaluated from {:g} s to {:g} s; on the last".format(*windows["rectangles"])
    step = high[1][2] - square[1][2]
    speed = path.airspeed_mps
    # it climbs between turns, which take their radius from both ends of a side
    radius = speed**2 / (GRAVITY * np.tan(np.radians(path.bank_limit_deg)))
    climb = step / (side - 2.0 * radius) * speed
    yield f"are {step:g} m higher, which makes climbs and descents of {climb:.0f} m/s"
    altitudes = [level.altitude_m for level in loiter.levels]
    steps = np.abs(np.diff(altitudes))
    yield (
        f"a circle of {loiter.radius_m:g} m radius with steps of {steps.min():g} to "
        f"{steps.max():g} m of altitude at {path.climb_limit_mps:g} m/s"
    )
    yield f"the leader at {speed:g} m/s, its bank limited to {path.bank_limit_deg:g}°"
    freedoms = table(SIMULATIONS, FREEDOMS)
    kappa = {each[2]: each[-1] for each in freedoms}
    yield (
        f"κ along the path is {freedoms[0][-1]} m/s; the paper's is "
        f"{scenario.formation.kappa_mps:g} m/s"
    )
    yield f"corners at 30° of bank, κ {kappa['30°']} m/s"
    sensors = load_scenario("simulation-3-noise").leader.sensors
    position = sensors.position.sigma_m
    yield (
        f"{position:g} m of position over {sensors.position.time_constant_s:g} s, "
        f"{sensors.velocity.sigma_mps:g} m/s and {sensors.attitude.sigma_deg:g}° over "
        f"{sensors.velocity.time_constant_s:g} s"
    )
    yield f"Perfect tracking of such estimates would leave {position * np.sqrt(6.0):.2f} m"
    late = load_scenario("simulation-3-latency").network.delay_s
    lags = the_row(table(SIMULATIONS, CONDITIONS), "predicted lag at that latency")[1:4]
    assert [float(lag) for lag in lags] == pytest.approx(
        [speed * late, 1.5 * speed * late, 1.75 * speed * late], abs=0.005
    )
    yield (
        f"Positions are {speed * late:.1f} m old ({speed:g} m/s × {late:g} s). Each follower "
        "settles at the mean of the old positions it receives: UAV 2 lags "
        f"{float(lags[1]):g} m, UAV 3 {lags[2]} m."
    )
    recorded = load_scenario("simulation-3-recorded-leader").scenario.windows
    yield "laps from {:g} s to {:g} s, circles from {:g} s to {:g} s".format(
        *recorded["rectangles"], *recorded["circles"]
    )
    hard = load_scenario("simulation-3-hard").leader.path
    corner = hard.legs[1].points_m[1]
    yield (
        f"{corner[0]:g} × {corner[1]:g} m at {hard.bank_limit_deg:g}° of bank with climbs and "
        f"descents of {hard.climb_limit_mps:g} m/s"
    )
    closest = the_row(table(SIMULATIONS, HARD_PATHS), "`simulation-3-recorded-leader`", "`tuned`")[
        9
    ]
    distance, at = re.fullmatch(r"([\d.]+) m at (\d+) s", closest).groups()
    yield f"two aircraft come within {distance} m of each other** at {at} s"


def experiment_claims() -> Iterator[str]:
    """Yield texts of docs/results/experiments.md."""
    each = [load_scenario(f"experiment-{n}") for n in (1, 2, 3)]
    one, two, three = each
    (k,) = {scenario.formation.k for scenario in each}
    (kappa,) = {scenario.formation.kappa_mps for scenario in each}
    (speed,) = {scenario.leader.path.airspeed_mps for scenario in each}
    banks = [scenario.leader.path.bank_limit_deg for scenario in each]
    low = one.formation.speed_mps[0]
    wind = one.air.wind.speed_mps
    yield f"| leader's airspeed | {speed:g} m/s | Experiment 1 upwind: {speed - wind:g} m/s"
    assert speed - wind == low
    yield f"| {wind:g} m/s from north-west | circle of {circle_radius(one):g} m, then rectangles |"
    yield f"| {two.air.wind.speed_mps:g} m/s from south-west | rectangles |"
    yield f"| {banks[0]:g}° in Experiment 1, otherwise {banks[1]:g}° |"
    assert banks[1] == banks[2]
    yield f"| altitude | {one.leader.start.altitude_m:g} m | the altitudes of Experiment 3 are " + (
        "{:g} and {:g} m |".format(*three.formation.altitudes_m.values())
    )
    sizes = ["{:g} × {:g} m".format(*rectangle(scenario)) for scenario in each]
    assert sizes[1] == sizes[2]
    yield f"| rectangle | {sizes[0]}; with {banks[1]:g}° of bank {sizes[1]} |"
    yield f"| k | {k:g} m/s | below |"
    yield f"| κ | {kappa:g} m/s |"
    text = (library() / "aircraft/skywalker_x8/middle_loop.yaml").read_text(encoding="utf-8")
    tuned = yaml.safe_load(text)["tuned"]
    yield f"| P gain of the flight path | {tuned['flight_path']['p']:g} |"
    yield f"| I gain of the course | {tuned['course']['i']:g} |"


def circle_radius(scenario: Any) -> float:
    return next(leg.radius_m for leg in scenario.leader.path.legs if leg.kind == "loiter")


def rectangle(scenario: Any) -> tuple[float, float]:
    """Return the long and the short side of the rectangles, m."""
    legs = [leg for leg in scenario.leader.path.legs if leg.kind == "waypoints"]
    long, short = sorted(np.ptp(np.array(legs[-1].points_m)[:, :2], axis=0), reverse=True)
    return long, short


@pytest.mark.parametrize(
    ("name", "claims"),
    [
        (SIMULATIONS, simulation_claims),
        (EXPERIMENTS, experiment_claims),
    ],
)
def test_prose_has_the_computed_numbers(name, claims):
    assert missing_texts(name, claims()) == []


def test_every_error_is_at_most_055_of_table_1():
    rows = table(SIMULATIONS, PAPER)
    for simulation in (1, 2, 3):
        start = f"Simulation {simulation}"
        printed, tuned, improved = (
            np.array(six(the_row(rows, start, label)), dtype=float)
            for label in ("[HBH23] Table 1", "profile `tuned`", "profile `improved`")
        )
        assert (tuned <= 0.55 * printed).all()
        assert (improved < tuned).all()


def test_rascal_turns_less_than_its_bank():
    """docs/results/simulations.md: by 7 %, in a steady turn on the circle of Simulation 3."""
    circle = "levels: [{altitude_m: 100, turns: 5}]"
    scenario = load_scenario(
        "simulation-3",
        [
            "log.mcap=false",
            "scenario.published=null",
            "scenario.windows={turn: [40, 60]}",
            "leader.start={north_m: 120, east_m: 0, altitude_m: 100, course_deg: 90}",
            "leader.path.legs=[{kind: loiter, centre_m: [0, 0], radius_m: 120, "
            f"direction: clockwise, {circle}}}]",
        ],
    )
    collector = Collector()
    run(set_duration(scenario, 60.0), write=False, observers=[collector])
    frames = [frame for frame in collector.frames if frame.time_s >= 40.0]
    velocity = np.array([frame.truth.velocity_ned[0] for frame in frames])
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    rate = np.gradient(course, [frame.time_s for frame in frames])
    bank = np.array([frame.truth.euler[0, 0] for frame in frames])
    airspeed = np.array([frame.truth.airspeed[0] for frame in frames])
    less = 100.0 * (1.0 - (rate * airspeed / (9.80665 * np.tan(bank))).mean())
    prose = page(SIMULATIONS)
    assert f"A Rascal turns {less:.0f} % less than g tan φ / V" in prose
    assert f"has the same {less:.0f} % error" in prose
