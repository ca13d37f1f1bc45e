"""Ranges of quantities: bounds of the keys of a scenario, and of columns of files in their place.

A number that a file gives has the bounds of the key in whose place it stands: both are made from
the same `Range`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the schema, which is imported at every start, needs no arrays
    from testbed.core.records import Array, BoolArray

MAX_DISTANCE_M = 1e6  # a flat frame on the earth ends far below
MAX_SPEED_MPS = 340.0  # of sound; the flight models are subsonic


@dataclass(frozen=True, slots=True)
class Range:
    """Smallest and largest value of a quantity.

    Attributes:
        low: smallest value.
        high: largest value.
        unit: of both.
        key: of a scenario, whose bounds these are; empty: of none.
        slack: beyond both ends, what files may have by rounding; such values become the ends.
    """

    low: float
    high: float
    unit: str = ""
    key: str = ""
    slack: float = 0.0

    def outside(self, values: Array) -> BoolArray:
        """Mask values (…) beyond the ends and the slack."""
        found: BoolArray = (values < self.low - self.slack) | (values > self.high + self.slack)
        return found

    def clip(self, values: Array) -> Array:
        """Return values (…) with those in the slack at the ends."""
        return values.clip(self.low, self.high)

    def problem(self, name: str, value: float) -> str:
        """Describe a value of a column that is outside."""
        unit = f" {self.unit}" if self.unit else ""
        ends = f"{self.low:.4g} to {self.high:.4g}{unit}"
        allowed = f", and {self.key} allows {ends}" if self.key else f"; allowed are {ends}"
        what = f"write {self.unit}" if self.unit else "write a share of 1"
        return f"{name} is {value:g}{allowed} ({what}, or remove the row)"


# Keys of a scenario.
DELAY = Range(0, 60, "s", "network.delay_s")
WIND_SPEED = Range(0, 60, "m/s", "air.wind.speed_mps")
WIND_FROM = Range(-360, 360, "deg", "air.wind.from_deg")
GUST_SPEED = Range(-60, 60, "m/s", "air.gusts.velocity_mps")
ORIGIN_LATITUDE = Range(-85, 85, "deg", "scenario.origin.latitude_deg")
ORIGIN_LONGITUDE = Range(-180, 180, "deg", "scenario.origin.longitude_deg")
ORIGIN_ELEVATION = Range(-500, 9000, "m", "scenario.origin.elevation_m")
POSITION = Range(-MAX_DISTANCE_M, MAX_DISTANCE_M, "m", "leader.path.legs.points_m")
VELOCITY = Range(-MAX_SPEED_MPS, MAX_SPEED_MPS, "m/s", "leader.path.curve.climb_mps")
THROTTLE = Range(0, 1, "", "controller.gains.trim_throttle", slack=0.01)

# Quantities of recordings that no key has. The horizontal components of a wind are between minus
# and plus the largest speed, and an aircraft may stand still.
WIND_COMPONENT = Range(-WIND_SPEED.high, WIND_SPEED.high, "m/s", WIND_SPEED.key)
AIRSPEED = Range(0.0, MAX_SPEED_MPS, "m/s")
LONGITUDE = Range(-360.0, 360.0, "deg")  # any turn of it; readers wrap it
CLOCK = Range(-math.inf, math.inf, "s")  # times of a file count from any zero
ADDED_DELAY = Range(-math.inf, math.inf, "s")  # the sum with delay_s is a `DELAY`
UNWRAPPED = Range(-math.inf, math.inf, "rad")  # headings may count turns
HALF_TURN = Range(-math.pi, math.pi, "rad", slack=1e-3)
PITCH = Range(-0.5 * math.pi, 0.5 * math.pi, "rad", slack=1e-3)
TURN = Range(-2.0 * math.pi, 2.0 * math.pi, "rad", slack=1e-3)
RATE = Range(-35.0, 35.0, "rad/s")  # 2000 deg/s, the range of gyros
PULSE = Range(0.0, 3000.0, "µs")

# Columns of recordings of flights: leaders, tracks of formations, commands with responses.
RECORDED: Mapping[str, Range] = {
    "t_s": CLOCK,
    "unix_s": CLOCK,
    "latitude_deg": ORIGIN_LATITUDE,
    "longitude_deg": LONGITUDE,
    **dict.fromkeys(("height_m", "altitude_m", "north_m", "east_m", "down_m"), POSITION),
    **dict.fromkeys(("v_north_mps", "v_east_mps", "v_down_mps"), VELOCITY),
    **dict.fromkeys(("wind_north_mps", "wind_east_mps"), WIND_COMPONENT),
    **dict.fromkeys(("ground_speed_mps", "airspeed_mps"), AIRSPEED),
    **dict.fromkeys(("roll_rad", "phi_rad", "course_rad"), TURN),
    **dict.fromkeys(("pitch_rad", "theta_rad", "theta_cmd_rad"), PITCH),
    **dict.fromkeys(("yaw_rad", "psi_rad"), UNWRAPPED),
    **dict.fromkeys(("phi_cmd_rad", "alpha_rad", "beta_rad"), HALF_TURN),
    **dict.fromkeys(("p_radps", "q_radps", "r_radps"), RATE),
    **dict.fromkeys(("throttle", "throttle_cmd"), THROTTLE),
    **dict.fromkeys(("pwm_ail", "pwm_ele", "pwm_thr", "pwm_rud"), PULSE),
}
