"""One frame as telemetry needs it: each record turned into plain numbers once for all aircraft."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from testbed.frames import geodetic_from_ned, quaternion_xyzw
from testbed.state import Array, Frame, Origin

Rows = list[list[float]]

I16, I32 = (-(1 << 15), (1 << 15) - 1), (-(1 << 31), (1 << 31) - 1)
SENSE = 1e18  # whose squares and sums still fit single precision
U16, U32 = (0, (1 << 16) - 1), (0, (1 << 32) - 1)


def whole(value: float, bounds: tuple[int, int]) -> int:
    """The nearest whole number that fits a field of these bounds; zero for what is no number."""
    if math.isnan(value):
        return 0
    least, most = bounds
    return round(min(max(value, least), most))


def plain(values: Array) -> Rows:
    """Rows of Python's numbers; what is no number is zero, what is beyond all sense at its edge."""
    rows: Rows = np.clip(np.nan_to_num(values), -SENSE, SENSE).tolist()
    return rows


def tame(value: float) -> float:
    """The same of one number."""
    return 0.0 if math.isnan(value) else float(min(max(value, -SENSE), SENSE))


class Scene:
    """A frame, with what telemetry says of it; nothing is computed that nobody asks for.

    Attributes:
        frame: the frame itself.
        boot_ms: simulation time, ms, as a field of 32 bits has it.
    """

    def __init__(self, frame: Frame, origin: Origin) -> None:
        """Look at a frame."""
        self.frame = frame
        self.boot_ms = round(frame.time_s * 1e3) & U32[1]
        self._origin = origin

    @cached_property
    def position_ned(self) -> Rows:
        """Where each takes itself to be, (N, 3) m."""
        return plain(self.frame.estimate.position_ned)

    @cached_property
    def place(self) -> Rows:
        """The same as latitude deg, longitude deg, height above sea level m, (N, 3)."""
        return plain(geodetic_from_ned(self.frame.estimate.position_ned, self._origin))

    @cached_property
    def velocity_ned(self) -> Rows:
        """Over the ground as each takes it to be, (N, 3) m/s."""
        return plain(self.frame.estimate.velocity_ned)

    @cached_property
    def euler(self) -> Rows:
        """Roll, pitch, yaw as each takes them to be, (N, 3) rad."""
        return plain(self.frame.estimate.euler)

    @cached_property
    def quaternion_xyzw(self) -> Rows:
        """The same as quaternions, (N, 4)."""
        return plain(quaternion_xyzw(self.frame.estimate.euler))

    @cached_property
    def rates_body(self) -> Rows:
        """As each takes them to be, (N, 3) rad/s."""
        return plain(self.frame.estimate.rates_body)

    @cached_property
    def equivalent_airspeed(self) -> list[float]:
        """As each takes it to be, (N,) m/s."""
        return [tame(each) for each in self.frame.estimate.equivalent_airspeed]

    @cached_property
    def command(self) -> Rows:
        """Roll rad, pitch rad, throttle 0..1 of the fly-by-wire-A command, (N, 3)."""
        told = self.frame.command
        return plain(np.stack((told.roll, told.pitch, told.throttle), axis=1))

    @cached_property
    def surfaces(self) -> Rows:
        """Aileron, elevator, throttle, rudder as the servos are told, (N, 4)."""
        told = self.frame.surfaces
        return plain(np.stack((told.aileron, told.elevator, told.throttle, told.rudder), axis=1))

    @cached_property
    def wind_ned(self) -> Rows:
        """Of the air, (N, 3) m/s."""
        return plain(self.frame.air.wind_ned)

    @cached_property
    def lost(self) -> list[bool]:
        """Who is on the ground or broken, (N,)."""
        gone: list[bool] = self.frame.lost.tolist()
        return gone

    def has_fix(self, row: int) -> bool:
        """Whether the receiver of one has a fix."""
        failing = self.frame.failing
        return failing is None or not failing.gps_lost[row]

    def hangs(self, row: int) -> bool:
        """Whether the autopilot of one hangs."""
        failing = self.frame.failing
        return failing is not None and bool(failing.frozen[row])

    def battery(self, row: int) -> tuple[float, float] | None:
        """State of charge 0..1 and voltage V of one; None: it has no battery."""
        charge = float(self.frame.air.state_of_charge[row])
        voltage = float(self.frame.air.battery_voltage[row])
        return None if math.isnan(charge) or math.isnan(voltage) else (charge, voltage)
