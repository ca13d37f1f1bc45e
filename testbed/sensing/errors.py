"""The random errors of the sensors of N aircraft: white noise and first-order Gauss-Markov drifts.

Every error is a column of one array and follows e ← keep e + fresh z from draw to draw, with z
standard normal. White noise keeps nothing. A drift of standard deviation σ and time constant τ
keeps exp(−dt/τ), so that its variance does not depend on dt. A white noise of two-sided density N²
has the standard deviation N/√dt in samples dt apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.scenario.sensors import Sensors
from testbed.state import Array
from testbed.streams import stream

BLOCK = 256  # draws made at a time; a draw's value does not depend on it

# Columns of the array. Those that all receivers and all barometers share come first.
GPS_SHARED, BARO_SHARED = slice(0, 3), 3
GPS_OWN, GPS_NOISE, GPS_VELOCITY = slice(4, 7), slice(7, 10), slice(10, 13)
BARO_OWN, BARO_NOISE = 13, 14
PITOT_NOISE = 15
GYRO_BIAS, GYRO_NOISE = slice(16, 19), slice(19, 22)
FORCE_BIAS, FORCE_NOISE = slice(22, 25), slice(25, 28)
HEADING_NOISE = 28
COLUMNS = 29
_SHARED = 4
# The streams of an aircraft, and of what is the same for all, with how many columns each has.
_OWN = {"gps": 9, "barometer": 2, "airspeed": 1, "gyro": 6, "accelerometer": 6, "magnetometer": 1}
_SKY = {"gps": 3, "barometer": 1}


class Levels(NamedTuple):
    """How the errors of N aircraft behave."""

    sigma: Array  # (N, COLUMNS) standard deviation, of drifts that of the stationary process
    time_constant_s: Array  # (N, COLUMNS) of drifts; zero: white


class Offsets(NamedTuple):
    """Errors that stay what they are, of N aircraft."""

    pressure: Array  # (N,) Pa, added to the dynamic pressure
    scale: Array  # (N,) share of the dynamic pressure, added to it
    heading: Array  # (N,) rad


def make_levels(sensors: Sequence[Sensors], dt: float) -> Levels:
    """The levels of N pages of sensors, drawn every `dt` s; a missing sensor has no error."""
    sigma, tau = np.zeros((2, len(sensors), COLUMNS))
    for row, each in enumerate(sensors):
        s, t = sigma[row], tau[row]
        if (gps := each.gps) is not None:
            s[GPS_SHARED], t[GPS_SHARED] = _axes(gps.shared_drift_m), gps.shared_time_constant_s
            s[GPS_OWN], t[GPS_OWN] = _axes(gps.own_drift_m), gps.own_time_constant_s
            s[GPS_NOISE] = _axes(gps.noise_m)
            s[GPS_VELOCITY] = _axes(gps.velocity_noise_mps)
        if (baro := each.barometer) is not None:
            s[BARO_SHARED], t[BARO_SHARED] = baro.shared_drift_m, baro.shared_time_constant_s
            s[BARO_OWN], t[BARO_OWN] = baro.own_drift_m, baro.own_time_constant_s
            s[BARO_NOISE] = baro.noise_m
        if (pitot := each.airspeed) is not None:
            s[PITOT_NOISE] = pitot.noise_pa
        if (gyro := each.gyro) is not None:
            s[GYRO_BIAS] = math.radians(gyro.bias_dps)
            t[GYRO_BIAS] = gyro.bias_time_constant_s
            s[GYRO_NOISE] = math.radians(gyro.noise_dps_rthz) / math.sqrt(dt)
        if (force := each.accelerometer) is not None:
            s[FORCE_BIAS], t[FORCE_BIAS] = force.bias_mps2, force.bias_time_constant_s
            s[FORCE_NOISE] = force.noise_mps2_rthz / math.sqrt(dt)
        if (compass := each.magnetometer) is not None:
            s[HEADING_NOISE] = math.radians(compass.noise_deg)
    return Levels(sigma, tau)


def make_offsets(names: Sequence[str], sensors: Sequence[Sensors], seed: int) -> Offsets:
    """What is known to be wrong, and what is drawn once for each aircraft."""
    out = Offsets(*np.zeros((3, len(names))))
    for row, (name, each) in enumerate(zip(names, sensors, strict=True)):
        pressure, scale, heading = stream(seed, f"sensors/{name}/offsets").standard_normal(3)
        if (pitot := each.airspeed) is not None:
            out.pressure[row] = pitot.offset_pa + pitot.offset_sigma_pa * pressure
            out.scale[row] = max(pitot.scale + pitot.scale_sigma * scale, -1.0)
        if (compass := each.magnetometer) is not None:
            offset_deg = compass.offset_deg + compass.offset_sigma_deg * heading
            out.heading[row] = math.radians(offset_deg)
    return out


class SensorErrors:
    """The errors of N aircraft from draw to draw: each sensor has a stream of its own.

    What receivers share is drawn once for all, from the streams "sky/gps" and "sky/barometer".

    Args:
        names: N names of aircraft.
        levels: of their errors.
        seed: of the run.
        dt: s from draw to draw.

    Attributes:
        now: the errors (N, COLUMNS); each draw changes them.
        parts: (2, N, COLUMNS) what they keep, and how much of a draw they take.
    """

    def __init__(self, names: Sequence[str], levels: Levels, *, seed: int, dt: float) -> None:
        """See the class."""
        tau = np.where(levels.time_constant_s > 0.0, levels.time_constant_s, 1.0)
        keep = np.where(levels.time_constant_s > 0.0, np.exp(-dt / tau), 0.0)
        self.parts = np.array([keep, levels.sigma * np.sqrt(1.0 - keep**2)])
        self._sky = [(stream(seed, f"sky/{sensor}"), width) for sensor, width in _SKY.items()]
        self._own = [
            [(stream(seed, f"sensors/{name}/{sensor}"), width) for sensor, width in _OWN.items()]
            for name in names
        ]
        self._draws: Sequence[Array] = ()
        self._next = 0
        self.now = levels.sigma * self.draw()

    def advance(self) -> Array:
        """The next errors, as they are `now`."""
        keep, fresh = self.parts
        self.now[:] = keep * self.now + fresh * self.draw()
        return self.now

    def draw(self) -> Array:
        """The next standard normal numbers (N, COLUMNS)."""
        if self._next == len(self._draws):
            draws = np.empty((BLOCK, len(self._own), COLUMNS))
            draws[:, :, :_SHARED] = _block(self._sky)[:, np.newaxis]
            for row, streams in enumerate(self._own):
                draws[:, row, _SHARED:] = _block(streams)
            self._draws, self._next = list(draws), 0
        self._next += 1
        return self._draws[self._next - 1]


def _axes(pair: tuple[float, float]) -> tuple[float, float, float]:
    """North, east and down from horizontal and vertical."""
    return pair[0], pair[0], pair[1]


def _block(streams: Sequence[tuple[np.random.Generator, int]]) -> Array:
    return np.concatenate([each.standard_normal((BLOCK, width)) for each, width in streams], axis=1)
