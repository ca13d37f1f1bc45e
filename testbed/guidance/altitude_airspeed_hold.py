"""Altitude and airspeed hold through the pitch and throttle of fly-by-wire A.

A reference altitude h_r follows the target h_t with a climb rate of limited change. Two loops,
each a feed-forward and a PI controller, follow h_r and the airspeed:

    ḣ_r = ḣ_t + k_r (h_t − h_r)        ḣ_d = ḣ_r + k_h (h_r − h)
    θ   = γ_d + θ_0 + k_n (1/cos φ − 1) + k_γ (γ_d − γ) + k_γi ∫ (γ_d − γ)
    T   = T_0 + k_c ḣ_r + k_φ (1/cos² φ − 1) + k_V (V_d − V) + k_Vi ∫ (V_d − V)

with sin γ = ḣ / V. The integrals start at the trimmed θ_0 and T_0, and so contain the incidence
and the throttle of level flight. The reference limits the vertical motion that followers must
repeat. An ideal vehicle has no incidence and no throttle; it follows the reference with
γ̇ = k_p (γ_d − γ).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from testbed.core.compile import jitable


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldGains:
    """Gains of the hold; the defaults are tuned on the Rascal 110 at 22 m/s."""

    reference: float = 0.3  # k_r, 1/s
    altitude: float = 0.25  # k_h, 1/s
    climb_acceleration: float = 0.8  # m/s², largest rate of change of ḣ_r
    catch_up: float = 0.5  # m/s, limit of the correction k_h (h_r − h)
    path: float = 0.5  # k_γ
    path_integral: float = 0.3  # k_γi, 1/s
    incidence_per_load: float = 0.05  # k_n, rad per g
    speed: float = 0.15  # k_V, per m/s
    speed_integral: float = 0.035  # k_Vi, per m/s per s
    throttle_per_climb: float = 0.08  # k_c, per m/s
    throttle_per_bank: float = 0.12  # k_φ
    pitch_limit: float = math.radians(20.0)  # rad
    ideal_path: float = 2.0  # k_p, 1/s; the path lags the reference by 1/k_p


class HoldMemory(NamedTuple):
    """State of the hold between two steps."""

    altitude: float  # h_r, m
    climb: float  # ḣ_r, m/s
    pitch: float  # the pitch integral, rad
    throttle: float  # the throttle integral, 0..1


class Reference(NamedTuple):
    """Reference altitude with its rate, and the commanded rate."""

    altitude: float  # h_r, m
    climb: float  # ḣ_r, m/s
    demand: float  # ḣ_d, m/s


@jitable
def climb_reference(
    memory: HoldMemory,
    altitude: float,
    altitude_target: float,
    climb_target: float,
    climb_limit: float,
    dt: float,
    gains: HoldGains,
) -> Reference:
    """Advance the reference by one step; altitudes up in m, speeds in m/s.

    The targets are the desired altitude and its rate; an altitude error is corrected with at most
    `climb_limit`.
    """
    behind = gains.reference * (altitude_target - memory.altitude)
    change = climb_target + _clip(behind, climb_limit) - memory.climb
    climb_r = memory.climb + _clip(change, gains.climb_acceleration * dt)
    altitude_r = memory.altitude + climb_r * dt
    demand = climb_r + _clip(gains.altitude * (altitude_r - altitude), gains.catch_up)
    return Reference(altitude_r, climb_r, demand)


@jitable
def hold(
    memory: HoldMemory,
    altitude: float,
    climb: float,
    airspeed: float,
    roll: float,
    altitude_target: float,
    climb_target: float,
    airspeed_target: float,
    climb_limit: float,
    dt: float,
    gains: HoldGains,
) -> tuple[float, float, HoldMemory]:
    """Compute pitch (rad), throttle (0..1) and memory; altitudes up in m, speeds in m/s.

    The targets and `climb_limit` are those of `climb_reference`.
    """
    reference = climb_reference(
        memory,
        altitude=altitude,
        altitude_target=altitude_target,
        climb_target=climb_target,
        climb_limit=climb_limit,
        dt=dt,
        gains=gains,
    )
    gamma_d = _path_angle(reference.demand, airspeed)
    gamma_error = gamma_d - _path_angle(climb, airspeed)
    cos_roll = max(math.cos(roll), 0.2)
    pitch = (
        gamma_d
        + memory.pitch
        + gains.incidence_per_load * (1.0 / cos_roll - 1.0)
        + gains.path * gamma_error
    )
    speed_error = airspeed_target - airspeed
    throttle = (
        memory.throttle
        + gains.throttle_per_climb * reference.climb
        + gains.throttle_per_bank * (1.0 / cos_roll**2 - 1.0)
        + gains.speed * speed_error
    )
    # anti-windup: an integral stops while its command is beyond the limit in its direction
    pitch_integral, throttle_integral = memory.pitch, memory.throttle
    if abs(pitch) < gains.pitch_limit or pitch * gamma_error < 0.0:
        pitch_integral += gains.path_integral * gamma_error * dt
    if 0.0 < throttle < 1.0 or (throttle - 0.5) * speed_error < 0.0:
        throttle_integral += gains.speed_integral * speed_error * dt
    return (
        _clip(pitch, gains.pitch_limit),
        min(max(throttle, 0.0), 1.0),
        HoldMemory(reference.altitude, reference.climb, pitch_integral, throttle_integral),
    )


@jitable
def hold_path(
    memory: HoldMemory,
    altitude: float,
    climb: float,
    speed: float,
    altitude_target: float,
    climb_target: float,
    climb_limit: float,
    dt: float,
    gains: HoldGains,
) -> tuple[float, HoldMemory]:
    """Compute γ̇ (rad/s) of an ideal vehicle, and the memory.

    Altitudes are up in m, speeds in m/s.

    The targets and `climb_limit` are those of `climb_reference`; the speed is over the ground.
    """
    reference = climb_reference(
        memory,
        altitude=altitude,
        altitude_target=altitude_target,
        climb_target=climb_target,
        climb_limit=climb_limit,
        dt=dt,
        gains=gains,
    )
    error = _path_angle(reference.demand, speed) - _path_angle(climb, speed)
    held = HoldMemory(reference.altitude, reference.climb, memory.pitch, memory.throttle)
    return gains.ideal_path * error, held


@jitable
def _path_angle(climb: float, speed: float) -> float:
    return math.asin(_clip(climb / max(speed, 1.0), 0.5))


@jitable
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
