"""From the page to the settings of navigation filters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.scenario.sensors import Sensors
from testbed.sensing.navigation import SETTINGS, STEP_S, Counts, Settings
from testbed.state import Array

GPS_HEIGHT = 1.5  # EKF3's noise of a GPS height, in that of a horizontal position
_PERFECT_HZ = 10  # how often a sensor is read that the page does not describe


def make_settings(sensors: Sequence[Sensors], rate_hz: int) -> Settings:
    """The settings of filters for M pages of sensors that step at a rate."""
    estimators = [each.estimator for each in sensors]

    def column(name: str) -> Array:
        return np.array([getattr(one, name) for one in estimators], dtype=np.float64)

    noises = (
        column("gyro_noise_radps"),
        column("accelerometer_noise_mps2"),
        np.zeros(len(sensors)),
        column("gyro_bias_noise_radps2"),
        column("accelerometer_bias_noise_mps3"),
        column("wind_noise_mps2"),
    )
    horizontal, velocity = column("gps_position_noise_m"), column("gps_velocity_noise_mps")
    by_gps = np.array([one.height_source == "gps" for one in estimators], dtype=bool)
    height = np.where(by_gps, GPS_HEIGHT * horizontal, column("barometer_noise_m"))
    each = np.zeros(len(sensors), dtype=SETTINGS)
    process = STEP_S * np.stack(noises, axis=1) ** 2
    each["process"] = np.repeat(process, [3, 3, 3, 3, 3, 2], axis=1)
    each["position_noise"] = np.stack([horizontal, horizontal, height], axis=1)
    each["velocity_noise"] = velocity.reshape(-1, 2)[:, [0, 0, 1]]
    each["airspeed_noise"] = column("airspeed_noise_mps")
    each["heading_noise"] = np.radians(column("heading_noise_deg"))
    each["gate"], each["airspeed_gate"] = column("gate_sigma"), column("airspeed_gate_sigma")
    each["reset_after_s"] = column("reset_after_s")
    each["gps_hz"] = _rates([one.gps for one in sensors])
    each["barometer_hz"] = _rates([one.barometer for one in sensors])
    each["compass_hz"] = _rates([one.magnetometer for one in sensors])
    latency = [one.gps.latency_s if one.gps else 0.0 for one in sensors]
    assumed = [one.estimator.gps_delay_s if one.gps else 0.0 for one in sensors]
    each["latency"], each["assumed"] = _steps(latency, rate_hz), _steps(assumed, rate_hz)
    each["gps_height"] = by_gps
    return Settings(each, rate_hz)


def _rates(sensors: Sequence[Any]) -> Counts:
    rates = [_PERFECT_HZ if each is None else each.rate_hz for each in sensors]
    return np.array(rates, dtype=np.int64)


def _steps(delays_s: Sequence[float], rate_hz: int) -> Counts:
    return np.array([round(delay * rate_hz) for delay in delays_s], dtype=np.int64)
