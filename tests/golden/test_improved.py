"""The profile `improved` against the bounds it was made for, and against the paper's profile."""

from __future__ import annotations

import numpy as np
import pytest
from whole_flights import FLOWN, IN_FULL, SAMPLE, UAVS, cells, fly

from testbed.scenario import library
from testbed.study.golden_table import read_table

IMPROVED = "controller.profile=improved"
PORTIONS = ("rectangles", "circles")


def papers_profile(scenario: str, portion: str) -> np.ndarray:
    """RMS errors of the same page with the profile `paper` at its own seed, m."""
    table = read_table(library() / "scenarios" / "golden" / f"{scenario}.json")
    return np.array([table.rows[f"rms_m/{portion}/{name}"].by_seed[0] for name in UAVS])


def test_on_the_papers_path() -> None:
    metrics = fly("simulation-3", IMPROVED, until=SAMPLE)
    for portion in FLOWN:
        assert cells(metrics, portion).mean() <= 0.35


@IN_FULL
def test_behind_a_recorded_leader() -> None:
    """The paper's own numbers, on corners that are known."""
    metrics = fly("simulation-3-recorded-leader", IMPROVED, until="rectangles")
    assert (cells(metrics, "rectangles") <= 1.3).all()


@IN_FULL
def test_on_a_path_that_saturates() -> None:
    metrics = fly("simulation-3-hard", IMPROVED)
    assert metrics["min_separation_m"] > 3.0
    for portion in PORTIONS:
        assert (cells(metrics, portion) <= 1.5).all()


@IN_FULL
@pytest.mark.parametrize("scenario", ["simulation-3-noise", "simulation-3-latency"])
def test_it_costs_nothing_under_noise_and_delay(scenario) -> None:
    metrics = fly(scenario, IMPROVED, until=SAMPLE)
    for portion in FLOWN:
        assert (cells(metrics, portion) <= papers_profile(scenario, portion)).all(), portion
