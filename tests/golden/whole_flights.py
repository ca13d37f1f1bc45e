"""Whole flights for the bounds, and how their numbers are read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import testbed
from testbed.scenario import load, shorten

UAVS = ("uav1", "uav2", "uav3")
# Where many flights are held to the same bound, `make test` flies the beginning of each, or some of
# them.
WHOLE = bool(os.environ.get("TESTBED_WHOLE"))
IN_FULL = pytest.mark.skipif(not WHOLE, reason="flown by make check-all, with TESTBED_WHOLE=1")
SAMPLE = None if WHOLE else 322.5  # s, when two of the four laps of the first portion are flown
FLOWN = ("rectangles", "circles") if WHOLE else ("rectangles",)


def fly(scenario: str, *overrides: str, until: str | float | None = None) -> Mapping[str, Any]:
    """The metrics of a whole flight, or of one up to the end of a portion or to a time, s.

    A portion that is under way at that time ends with it.
    """
    page = load(scenario, overrides)
    if until is not None:
        end = page.scenario.portions[until][1] if isinstance(until, str) else until
        page = shorten(page, end)
    flown = testbed.run(page, write=False)
    assert flown.outcome == "flown"
    engaged = flown.metrics["engaged_at_s"].values()
    assert None not in engaged, "a formation that never engaged"
    return flown.metrics


def cells(metrics: Mapping[str, Any], portion: str) -> np.ndarray:
    """RMS errors of a portion flown to its end, m, in fleet order."""
    assert metrics["portions"][portion]["complete"]
    return np.array([metrics["portions"][portion]["rms_m"][name] for name in UAVS])
