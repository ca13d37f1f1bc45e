"""Sets of sensor errors that have a name, as a page would write them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "truth": {},
    # The error an INS with a standard GPS receiver leaves: metres that wander slowly, velocity and
    # attitude that are good but jittery.
    "gps-ins": {
        "position": {"sigma_m": 0.3, "time_constant_s": 10.0},
        "velocity": {"sigma_mps": 0.05, "time_constant_s": 0.2},
        "attitude": {"sigma_deg": 0.3, "time_constant_s": 0.2},
    },
    # An autopilot board of the hobby's better kind in the open: a single-frequency receiver whose
    # drift is mostly the ionosphere's, and so everyone's, and MEMS sensors on a quiet mount.
    "pixhawk": {
        "gps": {
            "rate_hz": 5,
            "latency_s": 0.12,
            "noise_m": [0.1, 0.2],
            "velocity_noise_mps": [0.07, 0.15],
            "shared_drift_m": [1.3, 2.6],
            "shared_time_constant_s": 600.0,
            "own_drift_m": [0.25, 0.5],
            "own_time_constant_s": 60.0,
        },
        "barometer": {
            "noise_m": 0.2,
            "shared_drift_m": 1.0,
            "shared_time_constant_s": 600.0,
            "own_drift_m": 0.3,
            "own_time_constant_s": 300.0,
        },
        "airspeed": {"noise_pa": 2.0, "offset_sigma_pa": 5.0, "scale_sigma": 0.02},
        "gyro": {"noise_dps_rthz": 0.02, "bias_dps": 0.1, "bias_time_constant_s": 1000.0},
        "accelerometer": {
            "noise_mps2_rthz": 0.03,
            "bias_mps2": 0.07,
            "bias_time_constant_s": 300.0,
        },
        "magnetometer": {"noise_deg": 0.5, "offset_sigma_deg": 2.0},
    },
    # Few satellites seen from between trees, an old receiver that is later than the estimator
    # takes it to be, a shaken airframe.
    "degraded": {
        "gps": {
            "rate_hz": 2,
            "latency_s": 0.22,
            "noise_m": [0.5, 1.0],
            "velocity_noise_mps": [0.3, 0.5],
            "shared_drift_m": [2.1, 4.2],
            "shared_time_constant_s": 600.0,
            "own_drift_m": [1.5, 3.0],
            "own_time_constant_s": 60.0,
        },
        "barometer": {
            "noise_m": 0.5,
            "shared_drift_m": 1.0,
            "shared_time_constant_s": 600.0,
            "own_drift_m": 1.0,
            "own_time_constant_s": 300.0,
        },
        "airspeed": {"noise_pa": 5.0, "offset_sigma_pa": 20.0, "scale_sigma": 0.05},
        "gyro": {"noise_dps_rthz": 0.1, "bias_dps": 0.3, "bias_time_constant_s": 1000.0},
        "accelerometer": {
            "noise_mps2_rthz": 0.1,
            "bias_mps2": 0.2,
            "bias_time_constant_s": 300.0,
        },
        "magnetometer": {"noise_deg": 1.0, "offset_sigma_deg": 5.0},
    },
}


def on_top(preset: Mapping[str, Any], page: Mapping[str, Any]) -> dict[str, Any]:
    """Return a preset changed by what a page says: maps merge key by key, the rest replaces."""
    merged = dict(preset)
    for key, value in page.items():
        below = merged.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            merged[key] = {**below, **value}
        else:
            merged[key] = value
    return merged
