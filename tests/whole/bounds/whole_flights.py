"""Whole flights for the bounds, and access to their metrics."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import testbed
from testbed.scenario import load_scenario, set_duration

UAVS = ("uav1", "uav2", "uav3")
WINDOWS = ("rectangles", "circles")
# Of many flights with the same bound, `make test` flies the beginning of each, or some of them.
WHOLE = bool(os.environ.get("TESTBED_WHOLE"))
IN_FULL = pytest.mark.skipif(not WHOLE, reason="flown by make check-all, with TESTBED_WHOLE=1")
SAMPLE = None if WHOLE else 322.5  # s, when two of the four laps of the first window are flown
FLOWN = WINDOWS if WHOLE else ("rectangles",)

# The path of the paper's simulations with one level lap, one that climbs, and a circle that climbs.
SHORT_PATH = (
    "leader.path.legs.1.laps=1",
    "leader.path.legs.2.laps=1",
    "leader.path.legs.3.levels=[{altitude_m: 100, turns: 1}, {altitude_m: 130, turns: 3}]",
    "scenario.duration_s=440",
    "scenario.windows={rectangles: [95, 322.5], circles: [370, 440]}",
)


def fly(scenario: str, *overrides: str, until: str | float | None = None) -> Mapping[str, Any]:
    """Return the metrics of a whole flight, or up to the end of a window or a time, s.

    A window that contains that time ends with it.
    """
    loaded = load_scenario(scenario, overrides)
    if until is not None:
        end = loaded.scenario.windows[until][1] if isinstance(until, str) else until
        loaded = set_duration(loaded, end)
    result = testbed.run(loaded, write=False)
    assert result.outcome == "completed"
    joined = result.metrics["joined_at_s"].values()
    assert None not in joined, "a follower never joined the formation"
    return result.metrics


def cells(metrics: Mapping[str, Any], window: str) -> np.ndarray:
    """Return the RMS errors of a complete window, m, in fleet order."""
    assert metrics["windows"][window]["complete"]
    return np.array([metrics["windows"][window]["rms_m"][name] for name in UAVS])
