"""Trim: the steady flight of an aircraft at a given airspeed, flight-path angle and bank.

Steady means that all six accelerations of the body axes vanish while the aircraft turns at the
coordinated rate g tan φ / (V cos γ). Six unknowns answer for them: angle of attack, sideslip,
aileron, elevator, rudder and throttle; the propeller turns at the speed where its torque balances
the motor's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY
from testbed.state import Array

_STEP = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])  # of the finite differences
_LONGEST = np.array([0.08, 0.05, 0.3, 0.3, 0.3, 0.3])  # of one Newton step
_LOW = np.array([-0.3, -0.3, -1.0, -1.0, -1.0, 0.0])
_HIGH = np.array([0.5, 0.3, 1.0, 1.0, 1.0, 1.0])
_ITERATIONS = 40
_GOOD = 1e-8  # m/s² and rad/s²: where Newton's steps no longer matter


class TrimError(InputError):
    """There is no steady flight at the point asked for."""


@dataclass(frozen=True, slots=True)
class TrimPoint:
    """The flight asked for."""

    airspeed: float  # true, m/s
    flight_path_angle: float = 0.0  # rad, climbing positive
    bank: float = 0.0  # rad, right wing down positive
    altitude: float = 400.0  # m above sea level


@dataclass(frozen=True, slots=True)
class Placement:
    """How an aircraft stands in the air, at a heading of zero."""

    velocity_body: tuple[float, float, float]  # u, v, w through still air, m/s
    rates_body: tuple[float, float, float]  # p, q, r, rad/s
    roll: float  # rad
    pitch: float  # rad
    course: float  # rad, of the velocity, when the heading is zero


@dataclass(frozen=True, slots=True)
class Controls:
    """Commands in the sense of `state.Surfaces`."""

    aileron: float
    elevator: float
    rudder: float
    throttle: float


@dataclass(frozen=True, slots=True)
class TrimResult:
    """Steady flight and what holds it."""

    point: TrimPoint
    alpha: float  # rad
    beta: float  # rad
    controls: Controls
    propeller_rps: float  # revolutions per second
    placement: Placement
    residual: float  # largest of the accelerations left, m/s² and rad/s²


class TrimModel(Protocol):
    """A flight model that can be put anywhere and asked what it would do."""

    def accelerations(self, placement: Placement, controls: Controls, *, spin: bool) -> Array:
        """u̇, v̇, ẇ (m/s²), ṗ, q̇, ṙ (rad/s²); with `spin` the propeller settles first."""

    @property
    def propeller_rps(self) -> float:
        """Revolutions per second."""


def place(point: TrimPoint, alpha: float, beta: float) -> Placement:
    """Attitude, velocity and rates of a steady turn; level flight is the turn of rate zero.

    The pitch attitude follows from γ by solving sin γ = a sin θ − b cos θ, where a and b are the
    components of the direction of flight along and across the wings' plane.
    """
    v, gamma, phi = point.airspeed, point.flight_path_angle, point.bank
    along = math.cos(alpha) * math.cos(beta)
    side = math.sin(beta)
    below = math.sin(alpha) * math.cos(beta)
    across = math.sin(phi) * side + math.cos(phi) * below
    theta = math.asin(math.sin(gamma) / math.hypot(along, across)) + math.atan2(across, along)
    east = math.cos(phi) * side - math.sin(phi) * below
    north = along * math.cos(theta) + across * math.sin(theta)
    turn = GRAVITY * math.tan(phi) / (v * math.cos(gamma))
    rates = (
        -turn * math.sin(theta),
        turn * math.sin(phi) * math.cos(theta),
        turn * math.cos(phi) * math.cos(theta),
    )
    return Placement(
        velocity_body=(v * along, v * side, v * below),
        rates_body=rates,
        roll=phi,
        pitch=theta,
        course=math.atan2(east, north),
    )


def trim(model: TrimModel, point: TrimPoint) -> TrimResult:
    """Find steady flight by Newton's method with limited steps.

    Raises:
        TrimError: if the controls saturate or the accelerations cannot be made to vanish.
    """
    if not point.airspeed > 0.0 or abs(point.bank) > 1.4 or abs(point.flight_path_angle) > 1.4:
        raise TrimError(f"{_words(point)}: airspeed must be positive, angles below 80°")
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
    f = _residual(model, point, x, spin=True)
    best_x, best = x, np.inf
    for _ in range(_ITERATIONS):
        size = float(np.max(np.abs(f)))
        if size < best:
            best_x, best = x, size
        if size < _GOOD:
            break
        jacobian = np.empty((6, 6))
        for j in range(6):
            step = -_STEP[j] if x[j] + _STEP[j] > _HIGH[j] else _STEP[j]
            moved = x.copy()
            moved[j] += step
            jacobian[:, j] = (_residual(model, point, moved, spin=j == 5) - f) / step
        newton = np.linalg.lstsq(jacobian, -f, rcond=None)[0]
        newton *= min(1.0, float(np.min(_LONGEST / np.maximum(np.abs(newton), 1e-12))))
        x = np.minimum(_HIGH, np.maximum(_LOW, x + newton))
        f = _residual(model, point, x, spin=True)
    if best > 1e-4:
        raise TrimError(
            f"{_words(point)}: no steady flight; accelerations of {best:.2g} m/s² or rad/s² are "
            f"left at throttle {best_x[5]:.2f}, elevator {best_x[3]:+.2f}"
        )
    residual = float(np.max(np.abs(_residual(model, point, best_x, spin=True))))
    return TrimResult(
        point=point,
        alpha=float(best_x[0]),
        beta=float(best_x[1]),
        controls=Controls(*(float(value) for value in best_x[2:])),
        propeller_rps=model.propeller_rps,
        placement=place(point, float(best_x[0]), float(best_x[1])),
        residual=residual,
    )


def _residual(model: TrimModel, point: TrimPoint, x: Array, *, spin: bool) -> Array:
    placement = place(point, float(x[0]), float(x[1]))
    return model.accelerations(placement, Controls(*(float(v) for v in x[2:])), spin=spin)


def _words(point: TrimPoint) -> str:
    return (
        f"trim at {point.airspeed:g} m/s, climb angle {math.degrees(point.flight_path_angle):g}°, "
        f"bank {math.degrees(point.bank):g}°, altitude {point.altitude:g} m"
    )
