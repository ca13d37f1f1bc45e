"""Where and how an aircraft begins."""

from __future__ import annotations

from dataclasses import dataclass

from testbed.vehicle.trim import STILL, Vector


@dataclass(frozen=True, slots=True)
class Start:
    """Where and how an aircraft begins, in trim in the air that carries it.

    In wind the nose is turned so that the track over the ground has the course asked for; airspeed
    and flight-path angle are those of the motion through the air.
    """

    position_ned: Vector  # m from the origin
    course: float = 0.0  # rad, over the ground
    airspeed: float = 22.0  # true, m/s
    flight_path_angle: float = 0.0  # rad, through the air
    bank: float = 0.0  # rad
    wind_ned: Vector = STILL  # m/s, velocity of the air, which stays so until `blow`
    state_of_charge: float = 1.0  # 0..1 of its battery, where it has one
