"""Analytic paths of virtual leaders, with exact derivatives.

Horizontal vectors are complex numbers: ahead along the initial course + i to the right of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, body_rates, course, flight_path_angle
from testbed.core.records import Array
from testbed.guidance.recorded_path import SampledTrajectory

MAX_BANK = math.radians(60.0)  # of a coordinated turn along a path
# Amplitude of the course, rad, for which both loops of a figure-eight close: the first zero of J0
# (M. Abramowitz and I. Stegun, Handbook of Mathematical Functions, table 9.5).
SWING = 2.404825557695773

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveStart:
    """The start of a path."""

    position_ned: Point  # m
    course: float  # rad
    speed: float  # m/s; over the ground, ahead or the mean, see the paths

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
        self._check()

    def _check(self) -> None:
        """Check what only this kind of path has."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StraightPath(CurveStart):
    """A straight line at constant speed, with vertical speed `climb`."""

    climb: float = 0.0  # m/s

    def _check(self) -> None:
        _check_climb(self.speed, self.climb)


@dataclass(frozen=True, slots=True, kw_only=True)
class CirclePath(CurveStart):
    """A circle at constant speed, from a point on it; with vertical speed `climb`, a helix."""

    radius: float  # m
    clockwise: bool = True  # seen from above
    climb: float = 0.0  # m/s

    def _check(self) -> None:
        _check_climb(self.speed, self.climb)
        _check_radius(self.radius, math.sqrt(self.speed**2 - self.climb**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureEightPath(CurveStart):
    """A level figure-eight at constant speed, whose course is a cosine of time.

    It begins at its crossing.

        σ = σ_0 ± z (1 − cos ω t),   z = 2.4048,   ω = speed / (z radius)

    It closes because J0(z) = 0, and crosses itself at 84°. Its tightest turn, of `radius`, is
    half-way round each loop. It is 5.7 radii long and 2.1 wide.
    """

    radius: float  # m, of the tightest turn
    clockwise: bool = True  # the first loop, seen from above

    def _check(self) -> None:
        _check_radius(self.radius, self.speed)

    @property
    def period(self) -> float:
        """Time for both loops, s."""
        return 2.0 * math.pi * SWING * self.radius / self.speed


@dataclass(frozen=True, slots=True, kw_only=True)
class SinusoidalPath(CurveStart):
    """A level sinusoidal path at constant speed ahead, from its leftmost point.

    To the right it is amplitude (1 − cos 2π t/period).

    The ground speed is between `speed`, at the turns, and hypot(speed, 2π amplitude/period).
    """

    amplitude: float  # m, half the width
    period: float  # s

    def _check(self) -> None:
        _check_positive("amplitude_m", self.amplitude)
        _check_positive("period_s", self.period)
        shortest = 2.0 * math.pi * math.sqrt(self.amplitude / _max_lateral_acceleration())
        if self.period < shortest:
            bank = math.degrees(
                math.atan(self.amplitude * (2.0 * math.pi / self.period) ** 2 / GRAVITY)
            )
            raise InputError(
                f"period_s: a weave of amplitude_m {self.amplitude:g} in {self.period:g} s needs "
                f"{bank:.0f} degrees of bank, more than {math.degrees(MAX_BANK):.0f}; write "
                f"{_round_up(shortest)} or more, or a smaller amplitude_m"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedChangePath(CurveStart):
    """A level straight line at the speed `speed` + amplitude sin 2π t/period."""

    amplitude: float  # m/s
    period: float  # s

    def _check(self) -> None:
        _check_positive("amplitude_mps", self.amplitude)
        _check_positive("period_s", self.period)
        if self.amplitude >= self.speed:
            raise InputError(
                f"amplitude_mps: {self.amplitude:g} m/s is not below the mean speed; write less "
                f"than {self.speed:g}, speed_mps"
            )


Curve = StraightPath | CirclePath | FigureEightPath | SinusoidalPath | SpeedChangePath


def turn_radius(bank: float, speed: float, climb: float = 0.0) -> float:
    """Return the radius of a coordinated turn, m: g R tan φ = V² − w².

    Args:
        bank: φ, rad, above 0.
        speed: V, over the ground, m/s.
        climb: w, vertical speed, m/s.
    """
    level = math.sqrt(max(speed**2 - climb**2, 0.0))
    return level**2 / (GRAVITY * math.tan(bank))


def _max_lateral_acceleration() -> float:
    """Return the lateral acceleration, m/s², of a coordinated turn at `MAX_BANK`."""
    return GRAVITY * math.tan(MAX_BANK)


def _round_up(value: float) -> str:
    """Format a number rounded up to a tenth."""
    return f"{math.ceil(10.0 * value) / 10.0:g}"


def _check_positive(name: str, value: float) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise InputError(f"{name}: must be positive, not {value:g}")


def _check_climb(speed: float, climb: float) -> None:
    if not abs(climb) < speed:
        raise InputError(
            f"climb_mps: {climb:g} m/s is not below the speed; write less than {speed:g}, "
            "speed_mps, up or down"
        )


def _check_radius(radius: float, speed: float) -> None:
    _check_positive("radius_m", radius)
    tightest = speed**2 / _max_lateral_acceleration()
    if radius < tightest:
        bank = math.degrees(math.atan(speed**2 / (GRAVITY * radius)))
        raise InputError(
            f"radius_m: a turn of {radius:g} m at {speed:.4g} m/s needs {bank:.0f} degrees of "
            f"bank, more than {math.degrees(MAX_BANK):.0f}; write {_round_up(tightest)} or more, "
            "or a lower speed_mps"
        )


_HARMONICS = 20  # J20(SWING) / 20 is 1e-18


class Derivatives(NamedTuple):
    """A path and its derivatives at T times, NED."""

    position: Array  # (T, 3) m
    velocity: Array  # (T, 3) m/s
    acceleration: Array  # (T, 3) m/s²
    jerk: Array  # (T, 3) m/s³


class VelocityFrameRates(NamedTuple):
    """Rates of the velocity frame R(σ, γ) at T times, and their derivatives."""

    chi_dot: Array  # σ̇ (T,) rad/s
    gamma_dot: Array  # γ̇ (T,) rad/s
    chi_ddot: Array  # σ̈ (T,) rad/s²
    gamma_ddot: Array  # γ̈ (T,) rad/s²


def derivatives(curve: Curve, time: Array) -> Derivatives:
    """Compute position, velocity, acceleration and jerk of a path at times (T,) s."""
    time = np.asarray(time, dtype=np.float64)
    climb = curve.climb if isinstance(curve, StraightPath | CirclePath) else 0.0
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


def evaluate(
    curve: Curve, time: Array, wind_ned: Sequence[float] = (0.0, 0.0, 0.0)
) -> SampledTrajectory:
    """Sample a path at times (T,) s, with the fields of a recorded flight.

    The attitude is that of a coordinated turn: roll atan(σ̇ s cos γ / g), pitch γ, yaw σ; the body
    rates belong to it. The airspeed is that in a steady wind (m/s), which does not move a virtual
    leader. The throttle is zero.
    """
    position, velocity, acceleration, jerk = derivatives(curve, time)
    rates = frame_rates(Derivatives(position, velocity, acceleration, jerk))
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    slowing = (velocity[:, :2] * acceleration[:, :2]).sum(axis=1) / level
    tangent = rates.chi_dot * level / GRAVITY
    tangent_rate = (rates.chi_ddot * level + rates.chi_dot * slowing) / GRAVITY
    euler = np.stack([np.arctan(tangent), flight_path_angle(velocity), course(velocity)], axis=1)
    angle_rates = np.stack(
        [tangent_rate / (1.0 + tangent**2), rates.gamma_dot, rates.chi_dot], axis=1
    )
    return SampledTrajectory(
        position_ned=position,
        velocity_ned=velocity,
        acceleration_ned=acceleration,
        euler=euler,
        rates_body=body_rates(euler, angle_rates),
        airspeed=np.linalg.norm(velocity - np.asarray(wind_ned), axis=1),
        throttle=np.zeros(len(position)),
    )


def frame_rates(path: Derivatives) -> VelocityFrameRates:
    """Compute σ̇, γ̇, σ̈ and γ̈ of a path, for [HBH23] eq. (26).

    They are the derivatives of σ = atan2(v_E, v_N) and γ = atan2(−v_D, h), h² = v_N² + v_E².
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


# complex numbers; their types differ between releases of numpy
Complex = NDArray[Any]


def _horizontal(curve: Curve, time: Array) -> tuple[Complex, Complex, Complex, Complex]:
    """Compute ahead + i right of the start, and three derivatives, (T,)."""
    zero = np.zeros(time.shape, dtype=np.complex128)
    if isinstance(curve, StraightPath):
        level = math.sqrt(curve.speed**2 - curve.climb**2)
        return level * time + zero, level + zero, zero, zero
    if isinstance(curve, CirclePath):
        level = math.sqrt(curve.speed**2 - curve.climb**2)
        turning = 1j * math.copysign(level / curve.radius, 1.0 if curve.clockwise else -1.0)
        velocity = level * np.exp(turning * time)
        return (velocity - level) / turning, velocity, turning * velocity, turning**2 * velocity
    if isinstance(curve, FigureEightPath):
        return _figure_eight(curve, time)
    pulse = 2.0 * math.pi / curve.period
    cosine, sine = np.cos(pulse * time), np.sin(pulse * time)
    if isinstance(curve, SinusoidalPath):
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


def _figure_eight(curve: FigureEightPath, time: Array) -> tuple[Complex, Complex, Complex, Complex]:
    """Integrate e^(i z (1 − cos θ)) term by term of its Fourier series.

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
