"""What a virtual leader flies: curves that are formulas, as data, refused where nobody could fly.

A curve begins at time 0 at its `position_ned` along its `course`. SI units, radians; speeds are
over the ground. Errors name the fields as the page writes them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from testbed.errors import InputError
from testbed.frames import GRAVITY

STEEPEST_BANK = math.radians(60.0)  # of a coordinated turn along a curve; nobody follows a tighter
# Where the course of a figure-eight must swing to for both loops to close: the first zero of J0
# (M. Abramowitz and I. Stegun, Handbook of Mathematical Functions, table 9.5).
SWING = 2.404825557695773

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Straight:
    """A straight line at constant speed; `climb` is the vertical part of the speed."""

    position_ned: Point  # m
    course: float  # rad
    speed: float  # m/s
    climb: float = 0.0  # m/s

    def __post_init__(self) -> None:
        """Refuse what nobody can fly."""
        _check_positive("speed_mps", self.speed)
        _check_climb(self.speed, self.climb)


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle at constant speed, or with a `climb`, the vertical part of the speed, a helix."""

    position_ned: Point  # m, on the circle
    course: float  # rad
    speed: float  # m/s
    radius: float  # m
    clockwise: bool = True  # seen from above
    climb: float = 0.0  # m/s

    def __post_init__(self) -> None:
        """Refuse what nobody can fly."""
        _check_positive("speed_mps", self.speed)
        _check_climb(self.speed, self.climb)
        _check_radius(self.radius, math.sqrt(self.speed**2 - self.climb**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureEight:
    """A level figure-eight at constant speed, from its crossing; the course is a cosine of time.

        σ = σ_0 ± z (1 − cos ω t),   z = 2.4048,   ω = speed / (z radius)

    It closes because J0(z) = 0, crosses itself at 84°, turns hardest, on `radius`, half-way round
    each loop, and is 5.7 radii long and 2.1 wide.
    """

    position_ned: Point  # m, the crossing
    course: float  # rad
    speed: float  # m/s
    radius: float  # m, of the tightest turn
    clockwise: bool = True  # the first loop, seen from above

    def __post_init__(self) -> None:
        """Refuse what nobody can fly."""
        _check_positive("speed_mps", self.speed)
        _check_radius(self.radius, self.speed)

    @property
    def period(self) -> float:
        """Time for both loops, s."""
        return 2.0 * math.pi * SWING * self.radius / self.speed


@dataclass(frozen=True, slots=True, kw_only=True)
class Weave:
    """A level weave: constant speed ahead, a cosine to the right, amplitude (1 − cos 2π t/period).

    The ground speed grows from `speed` where the weave turns to hypot(speed, 2π amplitude/period)
    in the middle.
    """

    position_ned: Point  # m, where it is farthest to the left
    course: float  # rad
    speed: float  # m/s, ahead
    amplitude: float  # m, half the width
    period: float  # s

    def __post_init__(self) -> None:
        """Refuse what nobody can fly."""
        _check_positive("speed_mps", self.speed)
        _check_positive("amplitude_m", self.amplitude)
        _check_positive("period_s", self.period)
        shortest = 2.0 * math.pi * math.sqrt(self.amplitude / _hardest())
        if self.period < shortest:
            bank = math.degrees(
                math.atan(self.amplitude * (2.0 * math.pi / self.period) ** 2 / GRAVITY)
            )
            raise InputError(
                f"period_s: a weave of amplitude_m {self.amplitude:g} in {self.period:g} s needs "
                f"{bank:.0f} degrees of bank, more than {math.degrees(STEEPEST_BANK):.0f}; write "
                f"{_up(shortest)} or more, or a smaller amplitude_m"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedChange:
    """A level straight line at a speed that swings, speed + amplitude sin 2π t/period."""

    position_ned: Point  # m
    course: float  # rad
    speed: float  # m/s, the mean
    amplitude: float  # m/s
    period: float  # s

    def __post_init__(self) -> None:
        """Refuse what nobody can fly."""
        _check_positive("speed_mps", self.speed)
        _check_positive("amplitude_mps", self.amplitude)
        _check_positive("period_s", self.period)
        if self.amplitude >= self.speed:
            raise InputError(
                f"amplitude_mps: a swing of {self.amplitude:g} m/s about {self.speed:g} m/s flies "
                "backwards; write less than speed_mps"
            )


Curve = Straight | Circle | FigureEight | Weave | SpeedChange


def _hardest() -> float:
    """The largest acceleration across the path, m/s²."""
    return GRAVITY * math.tan(STEEPEST_BANK)


def _up(value: float) -> str:
    """The number rounded up to a tenth, as something to write."""
    return f"{math.ceil(10.0 * value) / 10.0:g}"


def _check_positive(name: str, value: float) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise InputError(f"{name}: must be positive, not {value:g}")


def _check_climb(speed: float, climb: float) -> None:
    if not abs(climb) < speed:
        raise InputError(
            f"climb_mps: {climb:g} m/s is all of the speed or more; write less than {speed:g}, "
            "speed_mps, up or down"
        )


def _check_radius(radius: float, speed: float) -> None:
    _check_positive("radius_m", radius)
    tightest = speed**2 / _hardest()
    if radius < tightest:
        bank = math.degrees(math.atan(speed**2 / (GRAVITY * radius)))
        raise InputError(
            f"radius_m: a turn of {radius:g} m at {speed:.4g} m/s needs {bank:.0f} degrees of "
            f"bank, more than {math.degrees(STEEPEST_BANK):.0f}; write {_up(tightest)} or more, "
            "or a lower speed_mps"
        )
