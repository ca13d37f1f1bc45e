"""The state estimators of all aircraft: the truth plus the errors of their sensors and filters.

A sensor that the scenario does not describe has no error. An aircraft with a GPS, barometer, gyro,
accelerometer or magnetometer in the scenario flies on a navigation filter; others fly on the truth.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from testbed.core.compile import Kernel
from testbed.core.frames import rotation_ned_body
from testbed.core.records import AIRCRAFT, Records, allocate
from testbed.scenario.sensors import Sensors
from testbed.sensors.airspeed import make_airspeed_sensors
from testbed.sensors.ekf import aligned_states, make_filters, start_filters
from testbed.sensors.ekf_settings import make_settings
from testbed.sensors.errors import (
    GaussMarkovErrors,
    make_constant_biases,
    make_sensor_errors,
    view_errors,
)
from testbed.sensors.jitter import add_jitter_to_all, make_jitter
from testbed.sensors.sensor_step import estimate_airspeeds, estimate_motions

WARM_UP_S = 60.0  # straight flight of the filters before the run
_NAVIGATION = ("gps", "barometer", "gyro", "accelerometer", "magnetometer")


class Estimators:
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
        """See the class."""
        dt = 1.0 / rate_hz
        self._count, self._rate_hz, self._step = len(names), rate_hz, 0
        self._sensors: tuple[GaussMarkovErrors, Kernel] | None = None
        self._filters: tuple[Records, Records, Records] | None = None
        self._jitter: tuple[GaussMarkovErrors, Kernel] | None = None
        modelled = any(each.measured for each in sensors) or sensor_faults
        if modelled:
            errors = make_sensor_errors(names, sensors, seed=seed, dt=dt)
            self._sensors = errors, self._make_sensor_step(names, sensors, errors, seed)
        jitter = make_jitter(names, sensors, seed=seed, dt=dt)
        if jitter is not None:
            given = jitter.coefficients, jitter.values, not modelled
            self._jitter = jitter, functools.partial(add_jitter_to_all, *given)
        self.exact = not modelled and jitter is None

    def warm_up(self, aircraft: Records) -> None:
        """Fly straight up to the present truth until the filters have settled, without faults.

        The sensors of all aircraft run as long, so that a filter more or less leaves the errors of
        the other aircraft as they are.

        Args:
            aircraft: (N,) of AIRCRAFT; truth is read.
        """
        if self._sensors is None:
            return
        errors, write_estimates = self._sensors
        first = -round(WARM_UP_S * self._rate_hz)
        self._start_filters(view_errors(errors), first, aircraft["truth"])
        flown = allocate(AIRCRAFT, self._count)
        truth, position = flown["truth"], aircraft["truth"]["position_ned"]
        truth[...] = aircraft["truth"]
        truth["acceleration_ned"] = truth["rates_body"] = 0.0
        for step in range(first, 0):
            truth["position_ned"] = position + step / self._rate_hz * truth["velocity_ned"]
            write_estimates(flown, errors.draw(), step, True)

    def estimate(self, aircraft: Records, *, advance: bool) -> None:
        """Write the next estimates, or the present errors on the present truth.

        Args:
            aircraft: (N,) of AIRCRAFT; truth and faults are read, `estimate` is written.
            advance: once per period, for the next errors; in between they stay as they are.
        """
        if self._sensors is not None:
            errors, write_estimates = self._sensors
            numbers = errors.draw() if advance else errors.values
            write_estimates(aircraft, numbers, self._step, advance)
            self._step += advance
        if self._jitter is not None:
            errors, add_jitter = self._jitter
            add_jitter(aircraft, errors.draw() if advance else errors.values, advance)
        if self.exact:
            aircraft["estimate"] = aircraft["truth"]

    def kernels(self) -> list[Kernel]:
        """Return the compiled calls of these estimators, for `core.compile.prepare`."""
        aircraft, calls = allocate(AIRCRAFT, self._count), []
        if self._sensors is not None:
            errors, write_estimates = self._sensors
            calls.append(functools.partial(write_estimates, aircraft, errors.values, 0, True))
        if self._jitter is not None:
            errors, add_jitter = self._jitter
            calls.append(functools.partial(add_jitter, aircraft, errors.values, True))
        return calls

    def _make_sensor_step(
        self,
        names: Sequence[str],
        sensors: Sequence[Sensors],
        errors: GaussMarkovErrors,
        seed: int,
    ) -> Kernel:
        """Return the call that steps all sensors and filters."""
        biases = make_constant_biases(names, sensors, seed)
        airspeed_sensors = make_airspeed_sensors(sensors, biases, self._rate_hz)
        values = errors.coefficients, errors.values, view_errors(errors)
        rows = np.flatnonzero([has_filter(each) for each in sensors])
        if not rows.size:
            return functools.partial(estimate_airspeeds, *values, airspeed_sensors, self._rate_hz)
        settings = make_settings([sensors[row] for row in rows.tolist()], self._rate_hz)
        settings["row"], settings["heading_bias"] = rows, biases.heading[rows]
        self._filters = settings, *make_filters(settings)
        return functools.partial(
            estimate_motions, *values, airspeed_sensors, self._rate_hz, *self._filters
        )

    def _start_filters(self, errors: Records, step: int, truth: Records) -> None:
        """Switch on the filters at a step before the warm-up, in a wind that they know."""
        if self._filters is None:
            return
        settings, filters, past = self._filters
        rows = settings["row"]
        nose = rotation_ned_body(truth["euler"])[:, :, 0]
        velocity = truth["velocity_ned"]
        wind = velocity - truth["airspeed"][:, np.newaxis] * nose
        states = aligned_states(settings, errors[rows], wind[rows, :2])
        position = truth["position_ned"] - WARM_UP_S * velocity
        start_filters(filters, past, step, self._rate_hz, states, position[rows], velocity[rows])


def has_filter(sensors: Sensors) -> bool:
    """Return whether a navigation filter makes the estimate."""
    return any(getattr(sensors, name) is not None for name in _NAVIGATION)
