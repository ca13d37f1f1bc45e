"""Whole flights of Simulation 3, disturbed, against the bounds it must keep.

Bounds are the paper's Table 1; where nothing disturbs the flight, test_paper_runs.py has half of
it. They have reasons of their own and are not fitted to what this version reaches; the tables of
`testbed check` are.
"""

from __future__ import annotations

import pytest
from whole_flights import FLOWN, IN_FULL, SAMPLE, UAVS, WHOLE, cells, fly

TABLE_1 = {"rectangles": (1.3, 1.4, 1.5), "circles": (1.3, 1.5, 1.5)}
NOISE = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")
DELAY = ("network.delay_s=0.1",)
# Flown to the end of the first portion, for its corners differ from lap to lap.
UNTIL = None if WHOLE else "rectangles"


@pytest.mark.parametrize(
    "overrides",
    [
        pytest.param(("controller.gain_scale=1.5",), id="gains-x1.5"),
        pytest.param(("controller.gain_scale=0.67",), id="gains-x0.67", marks=IN_FULL),
        pytest.param(NOISE, id="gps-ins-noise"),
        pytest.param((*DELAY, "controller.extrapolate_from=timestamp"), id="latency-compensated"),
    ],
)
def test_robust_to(overrides: tuple[str, ...]) -> None:
    """At or below Table 1 with gains off by half, with noise, and with compensated latency."""
    metrics = fly("simulation-3", *overrides, until=SAMPLE)
    for portion in FLOWN:
        assert (cells(metrics, portion) <= TABLE_1[portion]).all(), portion


def test_latency_without_compensation_lags_as_predicted() -> None:
    """0.1 s at 22 m/s is 2.2 m for UAV 1.

    UAVs 2 and 3 weigh the leader and the one ahead alike, and the one ahead lags too: UAV 2 lags by
    (2.2 + (2.2 + 2.2)) / 2 m, UAV 3 by (2.2 + (2.2 + 3.3)) / 2 m.
    """
    metrics = fly("simulation-3", *DELAY, until=SAMPLE)
    lag = 0.1 * 22.0
    second = (lag + lag + lag) / 2.0
    third = (lag + lag + second) / 2.0
    for portion in FLOWN:
        assert cells(metrics, portion) == pytest.approx([lag, second, third], abs=0.5)


def test_behind_a_recorded_leader() -> None:
    """Corners at 45 to 50 degrees, flown by the real ArduPlane; nobody is lost."""
    metrics = fly("simulation-3-recorded-leader", until=UNTIL)
    bounds = {"rectangles": (0.9, 3.6, 3.6), "circles": 0.5}
    for portion in FLOWN:
        assert (cells(metrics, portion) <= bounds[portion]).all(), portion
    assert metrics["leader_bank_deg"] > 45.0


def test_a_path_that_saturates_loses_no_formation() -> None:
    """Back within 5 m of the slot 120 s after the last saturated stretch, never nearer than 3 m."""
    metrics = fly("simulation-3-hard", until=UNTIL)
    assert metrics["min_separation_m"] > 3.0
    assert metrics["leader_bank_deg"] > 44.0
    for name in UAVS:
        recovery = metrics["recovery"][name]
        assert metrics["saturations"][name]["seconds"] > 5.0, "not hard enough to saturate"
        assert recovery["inside_for_good_from_s"] <= recovery["last_saturated_s"] + 120.0
