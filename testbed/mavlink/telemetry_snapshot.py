"""One sample for telemetry: each record converted to Python numbers once for all aircraft."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from testbed.core.frames import quaternion_xyzw
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import Array, FbwaCommand, NedOrigin, Sample

Rows = list[list[float]]

I16, I32 = (-(1 << 15), (1 << 15) - 1), (-(1 << 31), (1 << 31) - 1)
MAX_MAGNITUDE = 1e18  # whose squares and sums still fit single precision
U16, U32 = (0, (1 << 16) - 1), (0, (1 << 32) - 1)


def to_integer(value: float, bounds: tuple[int, int]) -> int:
    """Round and clamp to the range of an integer field; NaN becomes 0."""
    if math.isnan(value):
        return 0
    low, high = bounds
    return round(min(max(value, low), high))


def to_rows(values: Array) -> Rows:
    """Convert to lists of finite numbers; NaN becomes 0, magnitudes are clamped."""
    rows: Rows = np.clip(np.nan_to_num(values), -MAX_MAGNITUDE, MAX_MAGNITUDE).tolist()
    return rows


def to_finite(value: float) -> float:
    """Convert to a finite number; NaN becomes 0, the magnitude is clamped."""
    return 0.0 if math.isnan(value) else float(min(max(value, -MAX_MAGNITUDE), MAX_MAGNITUDE))


def _rows_of(read: Callable[[Sample], Array]) -> cached_property[Rows]:
    """Make an attribute of a snapshot that converts an array of its sample on first use."""
    return cached_property(lambda snapshot: to_rows(read(snapshot.sample)))


class TelemetrySnapshot:
    """The values of a sample that telemetry uses, each converted on first use.

    Attributes:
        sample: the sample.
        boot_ms: simulation time, ms, modulo 2³².
    """

    position_ned = _rows_of(lambda sample: sample.estimate.position_ned)  # (N, 3) m
    velocity_ned = _rows_of(lambda sample: sample.estimate.velocity_ned)  # (N, 3) m/s over ground
    acceleration_ned = _rows_of(lambda sample: sample.estimate.acceleration_ned)  # (N, 3) m/s²
    euler = _rows_of(lambda sample: sample.estimate.euler)  # (N, 3) roll, pitch, yaw, rad
    quaternion_xyzw = _rows_of(lambda sample: quaternion_xyzw(sample.estimate.euler))  # (N, 4)
    rates_body = _rows_of(lambda sample: sample.estimate.rates_body)  # (N, 3) rad/s
    wind_ned = _rows_of(lambda sample: sample.air.wind_ned)  # (N, 3) m/s, velocity of the air

    def __init__(self, sample: Sample, origin: NedOrigin) -> None:
        """Refer to a sample, which must not change."""
        self.sample = sample
        self.boot_ms = round(sample.time_s * 1e3) & U32[1]
        self._origin = origin

    @cached_property
    def geodetic(self) -> Rows:
        """Estimated latitude deg, longitude deg and height above sea level m, (N, 3)."""
        return to_rows(geodetic_from_ned(self.sample.estimate.position_ned, self._origin))

    @cached_property
    def equivalent_airspeed(self) -> list[float]:
        """Estimated equivalent airspeeds, (N,) m/s."""
        return [to_finite(each) for each in self.sample.estimate.equivalent_airspeed]

    @cached_property
    def commands(self) -> list[FbwaCommand[float]]:
        """Fly-by-wire-A commands, N."""
        return [FbwaCommand._make(row) for row in to_rows(np.stack(self.sample.command, axis=1))]

    @cached_property
    def surfaces(self) -> Rows:
        """Servo commands for aileron, elevator, throttle and rudder, (N, 4)."""
        servos = self.sample.surfaces
        columns = (servos.aileron, servos.elevator, servos.throttle, servos.rudder)
        return to_rows(np.stack(columns, axis=1))

    @cached_property
    def lost(self) -> list[bool]:
        """Return whether each aircraft has crashed or broken, (N,)."""
        lost: list[bool] = self.sample.lost.tolist()
        return lost

    def has_fix(self, row: int) -> bool:
        """Check whether the GPS receiver of an aircraft has a fix."""
        faults = self.sample.faults
        return faults is None or not faults.gps_lost[row]

    def autopilot_frozen(self, row: int) -> bool:
        """Check whether the autopilot of an aircraft is frozen."""
        faults = self.sample.faults
        return faults is not None and bool(faults.frozen[row])

    def battery(self, row: int) -> tuple[float, float] | None:
        """Return state of charge 0..1 and voltage V; None: no battery."""
        charge = float(self.sample.air.state_of_charge[row])
        voltage = float(self.sample.air.battery_voltage[row])
        return None if math.isnan(charge) or math.isnan(voltage) else (charge, voltage)
