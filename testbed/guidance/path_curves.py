"""Parameters of the analytic paths of virtual leaders, with checks.

A path begins at time 0 at its `position_ned` along its `course`. SI units, radians; speeds are
over the ground. Errors name the keys of the scenario.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY

MAX_BANK = math.radians(60.0)  # of a coordinated turn along a path
# Amplitude of the course, rad, for which both loops of a figure-eight close: the first zero of J0
# (M. Abramowitz and I. Stegun, Handbook of Mathematical Functions, table 9.5).
SWING = 2.404825557695773

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Straight:
    """A straight line at constant speed, with vertical speed `climb`."""

    position_ned: Point  # m
    course: float  # rad
    speed: float  # m/s
    climb: float = 0.0  # m/s

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
        _check_climb(self.speed, self.climb)


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle at constant speed; with vertical speed `climb`, a helix."""

    position_ned: Point  # m, on the circle
    course: float  # rad
    speed: float  # m/s
    radius: float  # m
    clockwise: bool = True  # seen from above
    climb: float = 0.0  # m/s

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
        _check_climb(self.speed, self.climb)
        _check_radius(self.radius, math.sqrt(self.speed**2 - self.climb**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureEight:
    """A level figure-eight at constant speed from its crossing; its course is a cosine of time.

        σ = σ_0 ± z (1 − cos ω t),   z = 2.4048,   ω = speed / (z radius)

    It closes because J0(z) = 0, and crosses itself at 84°. Its tightest turn, of `radius`, is
    half-way round each loop. It is 5.7 radii long and 2.1 wide.
    """

    position_ned: Point  # m, the crossing
    course: float  # rad
    speed: float  # m/s
    radius: float  # m, of the tightest turn
    clockwise: bool = True  # the first loop, seen from above

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
        _check_radius(self.radius, self.speed)

    @property
    def period(self) -> float:
        """Time for both loops, s."""
        return 2.0 * math.pi * SWING * self.radius / self.speed


@dataclass(frozen=True, slots=True, kw_only=True)
class SinusoidalPath:
    """A level sinusoidal path: constant speed ahead, amplitude (1 − cos 2π t/period) to the right.

    The ground speed is between `speed`, at the turns, and hypot(speed, 2π amplitude/period).
    """

    position_ned: Point  # m, the leftmost point
    course: float  # rad
    speed: float  # m/s, ahead
    amplitude: float  # m, half the width
    period: float  # s

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
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
class SpeedChange:
    """A level straight line at the speed `speed` + amplitude sin 2π t/period."""

    position_ned: Point  # m
    course: float  # rad
    speed: float  # m/s, mean
    amplitude: float  # m/s
    period: float  # s

    def __post_init__(self) -> None:
        """Check that the path can be flown."""
        _check_positive("speed_mps", self.speed)
        _check_positive("amplitude_mps", self.amplitude)
        _check_positive("period_s", self.period)
        if self.amplitude >= self.speed:
            raise InputError(
                f"amplitude_mps: {self.amplitude:g} m/s is not below the mean speed; write less "
                f"than {self.speed:g}, speed_mps"
            )


Curve = Straight | Circle | FigureEight | SinusoidalPath | SpeedChange


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
