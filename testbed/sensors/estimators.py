"""State estimators: the truth plus the errors of sensors and filters.

A sensor that the scenario does not describe has no error. An aircraft with a GPS, barometer, gyro,
accelerometer or magnetometer in the scenario flies on a navigation filter; others fly on the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np

from testbed.core.call_list import Call, Step
from testbed.core.frames import rotation_ned_body
from testbed.core.reads import unrecorded
from testbed.core.records import AIRCRAFT, Array, Records, allocate
from testbed.scenario.sensors import Sensors
from testbed.sensors.airspeed import make_airspeed_sensors
from testbed.sensors.ekf import (
    SETTINGS,
    SIDESLIP_VARIANCE,
    aligned_states,
    make_filters,
    start_filters,
)
from testbed.sensors.sensor_errors import (
    GaussMarkovErrors,
    add_jitter_to_all,
    make_constant_biases,
    make_jitter,
    make_sensor_errors,
    view_errors,
)
from testbed.sensors.sensor_step import estimate_motions, warm_up_motions

WARM_UP_S = 60.0  # straight flight of the filters before the run
_NAVIGATION = ("gps", "barometer", "gyro", "accelerometer", "magnetometer")


class StateEstimators:
    """The state estimators of N aircraft; `warm_up` comes before the first estimate.

    Args:
        names: N names of aircraft, by which their random streams are called.
        sensors: N sections of the scenario.
        seed: of the run.
        rate_hz: estimates per second.
        sensor_faults: airspeed sensors or GPS receivers can fail.

    Attributes:
        exact: the estimate is the truth.
    """

    def __init__(
        self,
        names: Sequence[str],
        sensors: Sequence[Sensors],
        *,
        seed: int,
        rate_hz: int,
        sensor_faults: bool = False,
    ) -> None:
        dt = 1.0 / rate_hz
        self._count, self._rate_hz, self._step = len(names), rate_hz, np.zeros(1, dtype=np.intp)
        # errors, and the entry that adds them with its first arguments
        self._sensors: tuple[GaussMarkovErrors, Callable[..., bool], tuple[Any, ...]] | None = None
        self._jitter: tuple[GaussMarkovErrors, Callable[..., bool], tuple[Any, ...]] | None = None
        modelled = any(each.measured for each in sensors) or sensor_faults
        if modelled:
            errors = make_sensor_errors(names, sensors, seed=seed, dt=dt)
            args = self._sensor_arguments(names, sensors, errors, seed)
            self._sensors = errors, estimate_motions, args
        jitter = make_jitter(names, sensors, seed=seed, dt=dt)
        if jitter is not None:
            numbers = jitter.numbers
            args = jitter.coefficients, jitter.values, not modelled, numbers.block, numbers.used
            self._jitter = jitter, add_jitter_to_all, args
        self.exact = not modelled and jitter is None

    @property
    def filters(self) -> tuple[Records, Array] | tuple[None, None]:
        """Navigation filters (M,) of FILTER, and the rows (M,) of their aircraft; None: none."""
        if self._sensors is None:
            return None, None
        return self._filters[1], self._filters[0]["row"]

    def warm_up(self, aircraft: Records) -> None:
        """Fly straight up to the present truth until the filters have settled, without faults.

        All sensors run for the same time, so adding a filter does not change other aircraft's
        errors.

        Args:
            aircraft: (N,) of AIRCRAFT; truth is read.
        """
        if self._sensors is None:
            return
        errors, _, args = self._sensors
        first = -round(WARM_UP_S * self._rate_hz)
        self._start_filters(view_errors(errors), first, aircraft["truth"])
        flown = allocate(AIRCRAFT, self._count)
        truth, position = flown["truth"], aircraft["truth"]["position_ned"].copy()
        truth[...] = aircraft["truth"]
        truth["acceleration_ned"] = truth["rates_body"] = 0.0
        self._step[0] = first
        fly_on: Callable[..., bool] = warm_up_motions
        while fly_on(*args, flown, position):
            errors.numbers.refill()

    def steps(self, aircraft: Records) -> tuple[tuple[Step, ...], tuple[Step, ...]]:
        """Return the steps that write the next estimates, and the present errors on the truth.

        Args:
            aircraft: (N,) of AIRCRAFT; truth and faults are read, `estimate` is written.
        """
        parts = [each for each in (self._sensors, self._jitter) if each is not None]
        keep = tuple(Call(estimate, *args, aircraft, False) for _, estimate, args in parts)
        return tuple(_advancing(*each, aircraft) for each in parts), keep

    def _sensor_arguments(
        self, names: Sequence[str], sensors: Sequence[Sensors], errors: GaussMarkovErrors, seed: int
    ) -> tuple[Any, ...]:
        """Return the first arguments of `estimate_motions`."""
        biases = make_constant_biases(names, sensors, seed)
        airspeed_sensors = make_airspeed_sensors(sensors, biases, self._rate_hz)
        values = errors.coefficients, errors.values, view_errors(errors)
        numbers = errors.numbers.block, errors.numbers.used, self._step
        rows = np.flatnonzero([has_filter(each) for each in sensors])
        settings = make_settings([sensors[row] for row in rows.tolist()], self._rate_hz)
        settings["row"], settings["heading_bias"] = rows, biases.heading[rows]
        self._filters = settings, *make_filters(settings)
        return *values, airspeed_sensors, self._rate_hz, *self._filters, *numbers

    def _start_filters(self, errors: Records, step: int, truth: Records) -> None:
        """Start the filters at a step before the warm-up, in a known wind."""
        settings, filters, past = self._filters
        rows = settings["row"]
        nose = rotation_ned_body(truth["euler"])[:, :, 0]
        velocity = truth["velocity_ned"]
        wind = velocity - truth["airspeed"][:, np.newaxis] * nose
        states = aligned_states(settings, errors[rows], wind[rows, :2])
        position = truth["position_ned"] - WARM_UP_S * velocity
        start_filters(filters, past, step, self._rate_hz, states, position[rows], velocity[rows])


def _advancing(
    errors: GaussMarkovErrors,
    estimate: Callable[..., bool],
    args: tuple[Any, ...],
    aircraft: Records,
) -> Step:
    """Return the call that writes the next estimates, and its step where numbers are missing."""
    call = Call(estimate, *args, aircraft, True)

    def draw_and_estimate(now: float) -> None:
        errors.numbers.refill()
        call(now)

    return call, draw_and_estimate


def has_filter(sensors: Sensors) -> bool:
    """Return whether a navigation filter makes the estimate."""
    return any(getattr(sensors, name) is not None for name in _NAVIGATION)


EKF3_STEP_S = 0.012  # EKF3's own step: its process noises are per square root of that
GPS_HEIGHT_NOISE = 1.5  # EKF3's noise of a GPS height over that of a horizontal position
EXACT_SENSOR_HZ = 10  # rate of a sensor that the scenario does not describe


def make_settings(sensors: Sequence[Sensors], rate_hz: int) -> Records:
    """Return the settings (M,) of SETTINGS of M filters."""
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
    with unrecorded() if gps_height.all() else nullcontext():
        barometer = column("barometer_noise_m")
    height = np.where(gps_height, GPS_HEIGHT_NOISE * horizontal, barometer)
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
