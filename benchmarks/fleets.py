"""Scenarios whose speed is measured: vees of any size, and Simulation 3 with all effects."""

from __future__ import annotations

import json
from typing import Any

from testbed.scenario import Scenario, load_scenario, set_duration

COUNTS = (1, 4, 10, 30, 100)
SPACING_M = 5.0  # between neighbours of an arm, back and aside
RADIUS_M = 1000.0  # wide enough for the outermost slots to stay inside the speed bounds
AIR = "turbulence-moderate"
RADIO = "bursty-wifi"


def vee(count: int, duration_s: float) -> Scenario:
    """Return Simulation 3 with this many flight models in a vee on a wide circle.

    Each follower has gains for the leader and the nearest aircraft ahead. A single flight model
    follows a leader that is a formula.
    """
    circle: dict[str, Any] = {
        "kind": "mission",
        "airspeed_mps": 22,
        "bank_limit_deg": 30,
        "legs": [
            {
                "kind": "loiter",
                "centre_m": [0, 0],
                "radius_m": RADIUS_M,
                "direction": "clockwise",
                "levels": [{"altitude_m": 200, "turns": 1000}],
            }
        ],
    }
    if count == 1:
        curve = {"kind": "circle", "radius_m": RADIUS_M}
        circle = {"kind": "virtual", "speed_mps": 22, "curve": curve}
    changes = {
        "scenario.published": None,
        "scenario.windows": {},
        "leader.path": circle,
        "leader.start": {"north_m": RADIUS_M, "east_m": 0, "altitude_m": 200, "course_deg": 90},
        "network.receive": "neighbours",
        "fleet": {
            "pattern": "vee",
            "count": max(count - 1, 1),
            "aircraft": "rascal110",
            "spacing_m": [SPACING_M, SPACING_M, 0],
            "neighbours": 1,
            "neighbours_from": "ahead",
        },
    }
    return set_duration(load_scenario("simulation-3", _texts(changes)), duration_s)


def all_effects() -> Scenario:
    """Return Simulation 3 in moderate turbulence, with sensor errors and a bursty network."""
    air = load_scenario(AIR)
    changes = {
        "scenario.published": None,
        "air": air.model_dump(mode="json", by_alias=True)["air"],
        "controller.bounded_speed": air.controller.bounded_speed,
        "leader.sensors": "pixhawk",
        "fleet.*.sensors": "pixhawk",
    }
    return load_scenario(RADIO, _texts(changes))


def _texts(changes: dict[str, Any]) -> list[str]:
    return [f"{key}={json.dumps(value)}" for key, value in changes.items()]
