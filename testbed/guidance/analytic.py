"""Virtual leaders: paths known as formulas, with every derivative exact.

Horizontal vectors are written as complex numbers, ahead along the initial course + i to the right
of it, so that one formula holds both components and its derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.frames import GRAVITY, body_rates, course, flight_path_angle
from testbed.guidance.curves import SWING, Circle, Curve, FigureEight, Straight, Weave
from testbed.guidance.replay import Track
from testbed.state import Array

_HARMONICS = 20  # J20(SWING) / 20 is 1e-18


class Derivatives(NamedTuple):
    """A path and its derivatives at T times, NED."""

    position: Array  # (T, 3) m
    velocity: Array  # (T, 3) m/s
    acceleration: Array  # (T, 3) m/s²
    jerk: Array  # (T, 3) m/s³


class VelocityFrameRates(NamedTuple):
    """How the velocity frame R(σ, γ) of a path turns at T times, with derivatives."""

    course_rate: Array  # σ̇ (T,) rad/s
    climb_angle_rate: Array  # γ̇ (T,) rad/s
    course_acceleration: Array  # σ̈ (T,) rad/s²
    climb_angle_acceleration: Array  # γ̈ (T,) rad/s²


def derivatives(curve: Curve, time: Array) -> Derivatives:
    """Position, velocity, acceleration and jerk of a curve at times (T,) s, exactly."""
    time = np.asarray(time, dtype=np.float64)
    climb = curve.climb if isinstance(curve, Straight | Circle) else 0.0
    turn = complex(math.cos(curve.course), math.sin(curve.course))
    north, east, down = curve.position_ned
    still = np.zeros_like(time)
    rows = []
    for order, ahead_right in enumerate(_horizontal(curve, time)):
        level = turn * ahead_right
        vertical = (-climb * time, still - climb, still, still)[order]
        rows.append(np.stack([level.real, level.imag, vertical], axis=-1))
    rows[0] += (north, east, down)
    return Derivatives(*rows)


def evaluate(curve: Curve, time: Array, wind_ned: Sequence[float] = (0.0, 0.0, 0.0)) -> Track:
    """The curve at times (T,) s, so that it can lead where a recording leads.

    Attitude is the bank atan(σ̇ s cos γ / g) of a coordinated turn, γ and σ; the body rates are
    theirs. The airspeed is that in a steady wind (m/s), which moves no virtual leader. The throttle
    is zero: there is no motor.
    """
    position, velocity, acceleration, jerk = derivatives(curve, time)
    rates = frame_rates(Derivatives(position, velocity, acceleration, jerk))
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    slowing = (velocity[:, :2] * acceleration[:, :2]).sum(axis=1) / level
    tangent = rates.course_rate * level / GRAVITY
    tangent_rate = (rates.course_acceleration * level + rates.course_rate * slowing) / GRAVITY
    euler = np.stack(
        [np.arctan(tangent), flight_path_angle(velocity), course(velocity)],
        axis=1,
    )
    angle_rates = np.stack(
        [tangent_rate / (1.0 + tangent**2), rates.climb_angle_rate, rates.course_rate], axis=1
    )
    return Track(
        position_ned=position,
        velocity_ned=velocity,
        acceleration_ned=acceleration,
        euler=euler,
        rates_body=body_rates(euler, angle_rates),
        airspeed=np.linalg.norm(velocity - np.asarray(wind_ned), axis=1),
        throttle=np.zeros(len(position)),
    )


def frame_rates(path: Derivatives) -> VelocityFrameRates:
    """σ̇, γ̇, σ̈ and γ̈ of a path, exactly: what [HBH23] eq. (26) is made of.

    By differentiating σ = atan2(v_E, v_N) and γ = atan2(−v_D, h), h² = v_N² + v_E², twice.
    """
    vn, ve, vd = path.velocity.T
    an, ae, ad = path.acceleration.T
    jn, je, jd = path.jerk.T
    h2 = vn * vn + ve * ve
    h = np.sqrt(h2)
    h_rate = (vn * an + ve * ae) / h
    h_acceleration = (an * an + ae * ae + vn * jn + ve * je - h_rate**2) / h
    sigma_rate = (vn * ae - ve * an) / h2
    sigma_acceleration = (vn * je - ve * jn - 2.0 * h * h_rate * sigma_rate) / h2
    s2 = h2 + vd * vd
    gamma_rate = (vd * h_rate - h * ad) / s2
    change = 2.0 * (h * h_rate + vd * ad)  # of s²
    gamma_acceleration = (vd * h_acceleration - h * jd - change * gamma_rate) / s2
    return VelocityFrameRates(sigma_rate, gamma_rate, sigma_acceleration, gamma_acceleration)


# complex numbers; what numpy says of their types differs between its releases
Complex = NDArray[Any]


def _horizontal(curve: Curve, time: Array) -> tuple[Complex, Complex, Complex, Complex]:
    """Ahead + i right of the start, and three derivatives, (T,)."""
    zero = np.zeros(time.shape, dtype=np.complex128)
    if isinstance(curve, Straight):
        level = math.sqrt(curve.speed**2 - curve.climb**2)
        return level * time + zero, level + zero, zero, zero
    if isinstance(curve, Circle):
        level = math.sqrt(curve.speed**2 - curve.climb**2)
        turning = 1j * math.copysign(level / curve.radius, 1.0 if curve.clockwise else -1.0)
        velocity = level * np.exp(turning * time)
        return (velocity - level) / turning, velocity, turning * velocity, turning**2 * velocity
    if isinstance(curve, FigureEight):
        return _figure_eight(curve, time)
    pulse = 2.0 * math.pi / curve.period
    cosine, sine = np.cos(pulse * time), np.sin(pulse * time)
    if isinstance(curve, Weave):
        right = 1j * curve.amplitude
        return (
            curve.speed * time + right * (1.0 - cosine),
            curve.speed + right * pulse * sine,
            right * pulse**2 * cosine,
            -right * pulse**3 * sine,
        )
    swing = curve.amplitude
    return (
        curve.speed * time + swing / pulse * (1.0 - cosine) + zero,
        curve.speed + swing * sine + zero,
        swing * pulse * cosine + zero,
        -swing * pulse**2 * sine + zero,
    )


def _figure_eight(curve: FigureEight, time: Array) -> tuple[Complex, Complex, Complex, Complex]:
    """The position is the integral of e^(i z (1 − cos θ)) term by term of its Fourier series.

    e^(−i z cos θ) = J0(z) + 2 Σ (−i)^k J_k(z) cos kθ (Jacobi and Anger; Abramowitz and Stegun
    9.1.44-45), with J0(z) = 0.
    """
    pulse = curve.speed / (SWING * curve.radius)
    theta = pulse * time
    nodes = 2.0 * np.pi * np.arange(64) / 64.0
    series = np.zeros(time.shape, dtype=np.complex128)
    for k in range(1, _HARMONICS + 1):
        # Bessel's integral by the trapezium rule, exact to rounding for a periodic function
        bessel = np.cos(k * nodes - SWING * np.sin(nodes)).mean()
        series += 2.0 * (-1j) ** k * bessel / k * np.sin(k * theta)
    position = SWING * curve.radius * np.exp(1j * SWING) * series
    velocity = curve.speed * np.exp(1j * SWING * (1.0 - np.cos(theta)))
    turn = SWING * pulse * np.sin(theta)
    change = SWING * pulse**2 * np.cos(theta)
    acceleration, jerk = 1j * turn * velocity, (1j * change - turn**2) * velocity
    if curve.clockwise:
        return position, velocity, acceleration, jerk
    return position.conj(), velocity.conj(), acceleration.conj(), jerk.conj()
