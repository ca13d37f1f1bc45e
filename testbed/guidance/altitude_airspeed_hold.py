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

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Record, Values

REFERENCE_GAIN = 0.3  # k_r, 1/s
ALTITUDE_GAIN = 0.25  # k_h, 1/s
CLIMB_ACCELERATION = 0.8  # m/s², largest rate of change of ḣ_r
CATCH_UP = 0.5  # m/s, limit of the correction k_h (h_r − h)
PITCH_LIMIT = math.radians(20.0)  # rad
IDEAL_PATH_GAIN = 2.0  # k_p, 1/s; the path lags the reference by 1/k_p

# Gains of an airframe; units and defaults are in `scenario.middle_loop.Guidance`.
GAINS = np.dtype(
    [
        ("path", "f8"),  # k_γ
        ("path_integral", "f8"),  # k_γi
        ("incidence_per_load", "f8"),  # k_n
        ("speed", "f8"),  # k_V
        ("speed_integral", "f8"),  # k_Vi
        ("throttle_per_climb", "f8"),  # k_c
        ("throttle_per_bank", "f8"),  # k_φ
    ]
)
# State of the hold between two steps.
HOLD = np.dtype(
    [
        ("altitude", "f8"),  # h_r, m
        ("climb", "f8"),  # ḣ_r, m/s
        ("pitch", "f8"),  # the pitch integral, rad
        ("throttle", "f8"),  # the throttle integral, 0..1
    ]
)


@kernel
def climb_demand(
    memory: Record,
    altitude: float,
    target: float,
    target_rate: float,
    climb_limit: float,
    dt: float,
) -> float:
    """Advance the reference by one step; return ḣ_d, m/s.

    Args:
        memory: record of HOLD; altitude and climb are written.
        altitude: m above the origin.
        target: h_t, m.
        target_rate: ḣ_t, m/s.
        climb_limit: m/s, with which an altitude error is corrected at most.
        dt: s.
    """
    behind = REFERENCE_GAIN * (target - memory.altitude)
    change = target_rate + _clip(behind, climb_limit) - memory.climb
    memory.climb += _clip(change, CLIMB_ACCELERATION * dt)
    memory.altitude += memory.climb * dt
    correction = _clip(ALTITUDE_GAIN * (memory.altitude - altitude), CATCH_UP)
    demand: float = memory.climb + correction
    return demand


@kernel
def hold(
    memory: Record,
    gains: Record,
    demand: float,
    climb: float,
    airspeed: float,
    roll: float,
    airspeed_target: float,
    dt: float,
) -> Values:
    """Compute pitch, rad, and throttle, 0..1.

    Args:
        memory: record of HOLD, after `climb_demand`; the integrals are written.
        gains: record of GAINS.
        demand: ḣ_d, m/s.
        climb: ḣ, m/s.
        airspeed: V, m/s.
        roll: φ, rad.
        airspeed_target: V_d, m/s.
        dt: s.
    """
    gamma_d = path_angle(demand, airspeed)
    gamma_error = gamma_d - path_angle(climb, airspeed)
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
        + gains.throttle_per_climb * memory.climb
        + gains.throttle_per_bank * (1.0 / cos_roll**2 - 1.0)
        + gains.speed * speed_error
    )
    # anti-windup: an integral stops while its command is beyond the limit in its direction
    if abs(pitch) < PITCH_LIMIT or pitch * gamma_error < 0.0:
        memory.pitch += gains.path_integral * gamma_error * dt
    if 0.0 < throttle < 1.0 or (throttle - 0.5) * speed_error < 0.0:
        memory.throttle += gains.speed_integral * speed_error * dt
    return _clip(pitch, PITCH_LIMIT), min(max(throttle, 0.0), 1.0)


@kernel
def path_angle(climb: float, speed: float) -> float:
    """Return the flight-path angle of a climb rate at a speed, m/s; at most 30°."""
    return math.asin(_clip(climb / max(speed, 1.0), 0.5))


@kernel
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
