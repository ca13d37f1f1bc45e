"""Made-up studies, with answers that are known."""

import math
from itertools import product

import numpy as np

from testbed.report.study.rows import Rows, Study

METRIC = "portions.laps.mean_rms_m"


def rows_of(table, lost=()):
    """Rows of (case, seed, settings, value); those of these numbers were lost."""
    keys = list(table[0][2])
    good = np.array([k not in lost for k in range(len(table))])
    values = np.array([math.nan if k in lost else row[3] for k, row in enumerate(table)])
    return Rows(
        run=np.arange(len(table)),
        case=[row[0] for row in table],
        seed=np.array([row[1] for row in table]),
        outcome=["flown" if each else "lost" for each in good],
        error=["" if each else "lost: uav1 at 3.0 s" for each in good],
        settings={key: [row[2][key] for row in table] for key in keys},
        metrics={METRIC: values},
        good=good,
    )


def study_of(rows, **more):
    how = {"name": "made-up", "file": "runs.parquet", "question": "What <b>matters</b>?"}
    how |= {"scenario": "simulation-3", "design": "factorial", "metrics": (METRIC,)}
    how |= {"statistic": "median", "rows": rows, "planned": rows.run.size}
    how |= {"command": lambda k: f"testbed run simulation-3 --seed {k}", "versions": {"numpy": "2"}}
    return Study(**(how | {"pages": {"study.yaml": "study: <x>\n"}} | more))


def factorial(seeds=6, cases=("calm", "gusty", "late"), lost=(3, 40)):
    """value = 1 + 4 loss + speed / 8 + 0.5 per case + noise that all points of a seed share."""
    dice = np.random.default_rng(3)
    shared = dice.normal(0.0, 0.2, seeds)
    table = []
    for (k, case), loss, speed, law, seed in product(
        enumerate(cases), (0.0, 0.1, 0.3), (0.0, 4.0, 8.0), ("paper", "chase"), range(seeds)
    ):
        point = {"network.loss": loss, "air.wind.speed_mps": speed, "controller.law": law}
        value = 1.0 + 4.0 * loss + speed / 8.0 + 0.5 * k + 0.3 * (law == "chase") + shared[seed]
        table.append((case, seed, point, value + dice.normal(0.0, 0.05)))
    return study_of(rows_of(table, lost))


def drawn(count=300, lost=(5,)):
    """Points of a Monte Carlo design: the metric grows with the square of the delay."""
    dice = np.random.default_rng(4)
    table = []
    for _ in range(count):
        delay, sigma = dice.uniform(0.0, 0.5), math.exp(dice.normal(0.0, 1.5))
        point = {"network.delay_s": delay, "air.sigma": sigma, "sensors": dice.choice(["a", "b"])}
        table.append(("all", 1, point, 0.5 + 6.0 * delay**2 + dice.gamma(2.0, 0.2)))
    return study_of(rows_of(table, lost), design="monte-carlo")
