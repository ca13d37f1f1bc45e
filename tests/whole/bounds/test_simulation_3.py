"""Bounds of whole flights of Simulation 3 with disturbances.

Bounds are the paper's Table 1; without disturbances test_paper_runs.py requires half of it. They
are not fitted to the present version; the tables of `testbed check` are. Where the present version
flies far below the paper's numbers, the bounds are 10 to 20 % above what it flies.
"""

from __future__ import annotations

import pytest
from whole_flights import FLOWN, IN_FULL, SAMPLE, UAVS, WHOLE, cells, fly

TABLE_1 = {"rectangles": (1.3, 1.4, 1.5), "circles": (1.3, 1.5, 1.5)}
GAINS = ("controller.gain_scale=1.5",)
NOISE = ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins")
DELAY = ("network.delay_s=0.1",)
OWN_PHASES = ("rates.synchronous=false", "rates.control_hz=10", "rates.broadcast_hz=10")
# 10 to 20 % above what is flown: with higher gains less than with those of the profile
BOUNDS = {
    GAINS: {"rectangles": (0.62, 0.67, 0.58), "circles": 0.19},
    OWN_PHASES: {"rectangles": (0.85, 1.2, 1.15), "circles": (0.42, 0.85, 0.92)},
}
# to the end of the first window, as its corners differ from lap to lap
UNTIL = None if WHOLE else "rectangles"


@pytest.mark.parametrize(
    "overrides",
    [
        pytest.param(GAINS, id="gains-x1.5"),
        pytest.param(("controller.gain_scale=0.67",), id="gains-x0.67", marks=IN_FULL),
        pytest.param(NOISE, id="gps-ins-noise"),
        pytest.param(OWN_PHASES, id="own-phases-10-hz"),
        pytest.param((*DELAY, "controller.extrapolate_from=timestamp"), id="latency-compensated"),
    ],
)
def test_table_1_holds_with_disturbances(overrides: tuple[str, ...]) -> None:
    """With gains changed by half, noise, compensated latency, and unsynchronised 10 Hz."""
    metrics = fly("simulation-3", *overrides, until=SAMPLE)
    bounds = BOUNDS.get(overrides, TABLE_1)
    for window in FLOWN:
        assert (cells(metrics, window) <= bounds[window]).all(), window


def test_uncompensated_latency_lags_as_predicted() -> None:
    """0.1 s at 22 m/s is 2.2 m for UAV 1.

    UAVs 2 and 3 weigh the leader and the one ahead equally, and that one lags too: UAV 2 lags by
    (2.2 + (2.2 + 2.2)) / 2 m, UAV 3 by (2.2 + (2.2 + 3.3)) / 2 m.
    """
    metrics = fly("simulation-3", *DELAY, until=SAMPLE)
    lag = 0.1 * 22.0
    second = (lag + lag + lag) / 2.0
    third = (lag + lag + second) / 2.0
    for window in FLOWN:
        assert cells(metrics, window) == pytest.approx([lag, second, third], abs=0.5)


def test_errors_behind_a_recorded_leader() -> None:
    """Corners at 45 to 50 degrees, flown by the real ArduPlane; no aircraft is lost."""
    metrics = fly("simulation-3-recorded-leader", until=UNTIL)
    bounds = {"rectangles": (0.8, 1.2, 1.3), "circles": 0.35}
    for window in FLOWN:
        assert (cells(metrics, window) <= bounds[window]).all(), window
    assert metrics["leader_bank_deg"] > 45.0


def test_formation_recovers_from_saturation() -> None:
    """Within 5 m of the slots 120 s after the last saturation, and never closer than 3 m."""
    metrics = fly("simulation-3-hard")
    assert metrics["min_separation_m"] > 3.0
    assert metrics["leader_bank_deg"] > 44.0
    for name in UAVS:
        recovery = metrics["recovery"][name]
        assert metrics["saturations"][name]["seconds"] > 5.0, "not hard enough to saturate"
        assert recovery["in_slot_since_s"] <= recovery["last_saturated_s"] + 120.0
