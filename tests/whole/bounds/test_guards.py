"""Short flights of set-ups that no golden table flies: the experiments as flown, and options.

Followers as flown may never join, which a golden table refuses. TESTBED_SNAPSHOTS=1 writes the
numbers again.
"""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import some

import testbed
from testbed.scenario import library, load_scenario, set_duration

NUMBERS = Path(__file__).with_name("guards.json")
TOLERANCE_M = 1e-3  # that of golden tables
AS_FLOWN = "scenarios/studies/gap-budget/experiment-{}-as-flown.yaml"
WIND = "air.wind={speed_mps: 5, from_deg: 240}"
FLIGHTS: dict[str, tuple[str, tuple[str, ...], float]] = {
    **{f"experiment {n} as flown": (AS_FLOWN.format(n), (), 60.0) for n in (1, 2, 3)},
    **{
        f"experiment {n} as flown, seed 2": (AS_FLOWN.format(n), ("scenario.seed=2",), 60.0)
        for n in (1, 2, 3)
    },
    "no leader acceleration": (
        "simulation-3",
        ("controller.estimators.leader_acceleration=none",),
        50.0,
    ),
    "throttle error of the airspeed": (
        "simulation-3",
        (WIND, "controller.throttle_error=airspeed"),
        50.0,
    ),
    "bounds of the airspeed": (
        "simulation-3",
        (WIND, "controller.bounded_speed=airspeed", "formation.speed_mps=[19, 25]",
         "formation.kappa_mps=3"),
        50.0,
    ),
    "incidence fed forward": ("simulation-3", ("controller.pitch_feedforward=incidence",), 50.0),
}  # fmt: skip


def measure(name: str) -> dict[str, list[float]]:
    """Fly; return RMS and largest errors of the followers, m, and the smallest separation, m."""
    source, overrides, until = FLIGHTS[name]
    scenario = library() / source if source.endswith(".yaml") else source
    window = f"scenario.windows={{all: [20, {until}]}}"
    loaded = load_scenario(scenario, ("scenario.published=null", window, *overrides))
    metrics: Any = testbed.run(set_duration(loaded, until), write=False).metrics
    return {
        "rms_m": list(metrics["windows"]["all"]["rms_m"].values()),
        "max_m": list(metrics["max_error_m"].values()),
        "separation_m": [metrics["min_separation_m"]],
    }


AGAIN = [name for name in FLIGHTS if name.endswith("seed 2")]
FIRST = [name for name in FLIGHTS if name.endswith("as flown")]
DRAWN = [name for name in FLIGHTS if name not in FIRST + AGAIN or name in some(FIRST + AGAIN, 1)]


@pytest.mark.parametrize("name", DRAWN)
def test_short_flight_has_its_numbers(name: str) -> None:
    found = measure(name)
    if os.environ.get("TESTBED_SNAPSHOTS"):
        with NUMBERS.open("r+") as file:  # other tests write it at the same time
            fcntl.flock(file, fcntl.LOCK_EX)
            written = json.load(file)
            written[name] = {key: np.round(values, 6).tolist() for key, values in found.items()}
            file.seek(0)
            file.truncate()
            file.write(json.dumps(written, indent=1) + "\n")
    known = json.loads(NUMBERS.read_text())
    for key, values in known[name].items():
        assert found[key] == pytest.approx(values, abs=TOLERANCE_M), key
