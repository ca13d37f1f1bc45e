"""Initial state of an aircraft."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.vehicle.trim import STILL, Vector


@dataclass(frozen=True, slots=True)
class InitialState:
    """Initial state of an aircraft, in trim relative to the air.

    In wind the heading is corrected so that the track over the ground has the given course.
    """

    position_ned: Vector  # m from the origin
    course: float = 0.0  # rad, over the ground
    airspeed: float = 22.0  # true, m/s
    flight_path_angle: float = 0.0  # rad, through the air
    bank: float = 0.0  # rad
    wind_ned: Vector = STILL  # m/s, initial velocity of the air
    state_of_charge: float = 1.0  # 0..1 of its battery, where it has one
    cells: int = 0  # of its battery, in series; 0: those of the airframe
    temperature_offset: float = 0.0  # K, of the air, to the standard atmosphere
