"""Synthetic studies with known results."""

import math
from itertools import product

import numpy as np

from testbed.logs.arrow_io import write_columns
from testbed.reports.study import StudyData, StudyFlights

METRIC = "windows.laps.mean_rms_m"
PAGE = """
study:
  schema: 1
  name: radio
  question: What does it cost?
  scenario: simulation-3
  design: factorial
  seeds: 3
  metrics: [windows.laps.mean_rms_m]
vary: {network.delay_s: [0, 0.1]}
"""


def flights_of(table, lost=()):
    """Make flights of (case, seed, settings, value); those with numbers in `lost` were lost."""
    keys = list(table[0][2])
    completed = np.array([k not in lost for k in range(len(table))])
    values = np.array([math.nan if k in lost else row[3] for k, row in enumerate(table)])
    return StudyFlights(
        run=np.arange(len(table)),
        case=[row[0] for row in table],
        seed=np.array([row[1] for row in table]),
        outcome=["completed" if each else "lost" for each in completed],
        error=["" if each else "lost: uav1 at 3.0 s" for each in completed],
        settings={key: [row[2][key] for row in table] for key in keys},
        metrics={METRIC: values},
        completed=completed,
    )


def study_of(flights, **more):
    fields = {"name": "made-up", "file": "runs.parquet", "question": "What <b>matters</b>?"}
    fields |= {"scenario": "simulation-3", "design": "factorial", "metrics": (METRIC,)}
    fields |= {"statistic": "median", "flights": flights, "planned": flights.run.size}
    fields |= {
        "command": lambda k: f"testbed run simulation-3 --seed {k}",
        "versions": {"numpy": "2"},
    }
    return StudyData(**(fields | {"files": {"study.yaml": "study: <x>\n"}} | more))


def factorial(
    seeds=6, cases=("calm", "gusty", "late"), lost=(3, 40), *, losses=(0.0, 0.1, 0.3), speeds=3
):
    """value = 1 + 4 loss + speed / 8 + 0.5 per case + noise that all points of a seed share."""
    random = np.random.default_rng(3)
    shared = random.normal(0.0, 0.2, seeds)
    table = []
    for (k, case), loss, speed, law, seed in product(
        enumerate(cases), losses, (0.0, 4.0, 8.0)[:speeds], ("paper", "chase"), range(seeds)
    ):
        point = {"network.loss": loss, "air.wind.speed_mps": speed, "controller.law": law}
        value = 1.0 + 4.0 * loss + speed / 8.0 + 0.5 * k + 0.3 * (law == "chase") + shared[seed]
        table.append((case, seed, point, value + random.normal(0.0, 0.05)))
    return study_of(flights_of(table, lost))


def drawn(count=300, lost=(5,)):
    """Points of a Monte Carlo design: the metric grows with the square of the delay."""
    random = np.random.default_rng(4)
    table = []
    for _ in range(count):
        delay, sigma = random.uniform(0.0, 0.5), math.exp(random.normal(0.0, 1.5))
        point = {"network.delay_s": delay, "air.sigma": sigma, "sensors": random.choice(["a", "b"])}
        table.append(("all", 1, point, 0.5 + 6.0 * delay**2 + random.gamma(2.0, 0.2)))
    return study_of(flights_of(table, lost), design="monte-carlo")


def write_study(path, runs=6, *, page=PAGE, lost=()):
    """A study's file as a sweep leaves it."""
    fields = {"run": "int64", "case": "string", "seed": "int64", "set.network.delay_s": "double"}
    fields |= {"outcome": "string", "error": "string", "command": "string"}
    fields |= {f"metrics.{METRIC}": "double", "metrics.min_separation_m": "double"}
    rows = [
        [
            k, "", 1 + k % 3, 0.1 * (k // 3), "lost" if k in lost else "completed",
            "lost: uav1 at 2.0 s" if k in lost else "",
            f"testbed run simulation-3 --set network.delay_s={0.1 * (k // 3):g} --seed {1 + k % 3}",
            None if k in lost else 1.0 + k, 5.0,
        ]
        for k in range(runs)
    ]  # fmt: skip
    facts = {"study.schema": "2", "complete": "false", "study.name": "radio", "study.yaml": page}
    facts |= {"runs": "6", "versions.json": '{"numpy": "2"}', "scenario.yaml": "scenario: {}\n"}
    groups = [list(map(list, zip(*rows, strict=True)))] if rows else []
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        write_columns(file, fields, groups, facts)
    return path
