"""Settings of navigation filters from the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from testbed.core.records import Array, Records, allocate
from testbed.scenario.sensors import Sensors
from testbed.sensors.ekf import SETTINGS, SIDESLIP_VARIANCE

EKF3_STEP_S = 0.012  # EKF3's own step: its process noises are per square root of that
GPS_HEIGHT_NOISE = 1.5  # EKF3's noise of a GPS height over that of a horizontal position
EXACT_SENSOR_HZ = 10  # rate of a sensor that the scenario does not describe


def make_settings(sensors: Sequence[Sensors], rate_hz: int) -> Records:
    """Return the settings (M,) of SETTINGS of M filters that step at a rate, for M aircraft."""
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
    gps_height = np.array([one.height_source == "gps" for one in estimators], dtype=bool)
    height = np.where(gps_height, GPS_HEIGHT_NOISE * horizontal, column("barometer_noise_m"))
    settings = allocate(SETTINGS, len(sensors))
    settings["row"] = np.arange(len(sensors))
    process = EKF3_STEP_S * np.stack(noises, axis=1) ** 2
    settings["process"] = np.repeat(process, [3, 3, 3, 3, 3, 2], axis=1)
    settings["fix_noise"][:, :3] = velocity.reshape(-1, 2)[:, [0, 0, 1]]
    settings["fix_noise"][:, 3:] = np.stack([horizontal, horizontal, height], axis=1)
    settings["airspeed_noise"] = column("airspeed_noise_mps")
    settings["heading_noise"] = np.radians(column("heading_noise_deg"))
    settings["sideslip_variance"] = SIDESLIP_VARIANCE
    settings["gate"] = column("gate_sigma")
    settings["airspeed_gate"] = column("airspeed_gate_sigma")
    settings["reset_after_s"] = column("reset_after_s")
    settings["gps_hz"] = _rates([one.gps for one in sensors])
    settings["barometer_hz"] = _rates([one.barometer for one in sensors])
    settings["compass_hz"] = _rates([one.magnetometer for one in sensors])
    latency = [one.gps.latency_s if one.gps else 0.0 for one in sensors]
    assumed = [one.estimator.gps_delay_s if one.gps else 0.0 for one in sensors]
    settings["latency"] = [round(each * rate_hz) for each in latency]
    settings["assumed_latency"] = [round(each * rate_hz) for each in assumed]
    settings["gps_height"] = gps_height
    return settings


def _rates(sensors: Sequence[Any]) -> list[int]:
    return [EXACT_SENSOR_HZ if each is None else each.rate_hz for each in sensors]
