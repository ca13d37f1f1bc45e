"""The profile `improved` against its bounds, and against the profile `tuned`."""

from __future__ import annotations

import numpy as np
import pytest
from whole_flights import FLOWN, IN_FULL, SAMPLE, UAVS, WINDOWS, cells, fly

from testbed.golden.golden_table import read_table
from testbed.scenario import library

IMPROVED = "controller.profile=improved"


def golden_errors(scenario: str, window: str) -> np.ndarray:
    """Return the RMS errors of the golden table at its own seed, m."""
    table = read_table(library() / "scenarios" / "golden" / f"{scenario}.json")
    return np.array([table.rows[f"rms_m/{window}/{name}"].by_seed[0] for name in UAVS])


def test_improved_on_the_papers_path() -> None:
    metrics = fly("simulation-3", IMPROVED, until=SAMPLE)
    for window in FLOWN:
        assert cells(metrics, window).mean() <= 0.35


@IN_FULL
def test_improved_behind_a_recorded_leader() -> None:
    """Corners at 45 to 50 degrees, with errors below those of the profile `tuned`."""
    metrics = fly("simulation-3-recorded-leader", IMPROVED, until="rectangles")
    assert (cells(metrics, "rectangles") <= (0.44, 0.85, 1.05)).all()


@IN_FULL
def test_improved_on_a_path_that_saturates() -> None:
    metrics = fly("simulation-3-hard", IMPROVED)
    assert metrics["min_separation_m"] > 3.0
    bounds = {"rectangles": (0.45, 0.60, 0.65), "circles": 0.12}
    for window in WINDOWS:
        assert (cells(metrics, window) <= bounds[window]).all(), window


@IN_FULL
@pytest.mark.parametrize("scenario", ["simulation-3-noise", "simulation-3-latency"])
def test_improved_with_noise_and_latency(scenario) -> None:
    metrics = fly(scenario, IMPROVED, until=SAMPLE)
    for window in FLOWN:
        assert (cells(metrics, window) <= golden_errors(scenario, window)).all(), window
