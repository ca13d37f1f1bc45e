"""PWM pulses of RC channels and servo outputs, and the fly-by-wire-A commands of RC pulses.

In fly-by-wire A ArduPlane takes roll and pitch as shares of their limits: the share of a pulse
between RCn_TRIM and RCn_MIN or RCn_MAX, times ROLL_LIMIT_DEG, PTCH_LIM_MAX_DEG or
PTCH_LIM_MIN_DEG. Throttle is the share between RCn_MIN and RCn_MAX. Dead zones (RCn_DZ) have no
effect in this mode. Pulses are in µs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from testbed.core.records import FbwaCommand

ROLL, PITCH, THROTTLE, YAW = 1, 2, 3, 4  # channels, by ArduPlane's RCMAP_ defaults
MIN_US, TRIM_US, MAX_US = 1000.0, 1500.0, 2000.0  # default range of a channel


class PwmRange(NamedTuple):
    """The pulses of a channel or servo output, µs."""

    min: float = MIN_US
    trim: float = TRIM_US
    max: float = MAX_US
    reversed: bool = False

    def signed_from_pwm(self, pulse: float) -> float:
        """Convert a pulse to its share −1..1 of the way from trim to an end."""
        way = self.max - self.trim if pulse >= self.trim else self.trim - self.min
        share = 0.0 if way <= 0.0 else min(max((pulse - self.trim) / way, -1.0), 1.0)
        return -share if self.reversed else share

    def pwm_from_signed(self, share: float) -> float:
        """Convert a share −1..1 to a pulse; the inverse of `signed_from_pwm`, NaN as −1."""
        share = -share if self.reversed else share
        way = self.max - self.trim if share >= 0.0 else self.trim - self.min
        return self.trim + max(-1.0, min(share, 1.0)) * way

    def unsigned_from_pwm(self, pulse: float) -> float:
        """Convert a pulse to its share 0..1 of the range."""
        way = self.max - self.min
        share = 0.0 if way <= 0.0 else min(max((pulse - self.min) / way, 0.0), 1.0)
        return 1.0 - share if self.reversed else share

    def pwm_from_unsigned(self, share: float) -> float:
        """Convert a share 0..1 to a pulse; the inverse of `unsigned_from_pwm`, NaN as 0."""
        share = max(0.0, min(share, 1.0))
        return self.min + (1.0 - share if self.reversed else share) * (self.max - self.min)


class AngleLimits(NamedTuple):
    """Limits of commanded angles, rad; defaults are ArduPlane's."""

    roll: float = math.radians(45.0)
    pitch_max: float = math.radians(20.0)
    pitch_min: float = math.radians(-25.0)

    def clamp(self, roll: float, pitch: float) -> tuple[float, float]:
        """Clamp roll and pitch, rad, to the limits."""
        return (
            min(max(roll, -self.roll), self.roll),
            min(max(pitch, self.pitch_min), self.pitch_max),
        )


class RcScaling(NamedTuple):
    """Scaling between stick pulses and fly-by-wire-A commands of one aircraft."""

    roll: PwmRange
    pitch: PwmRange
    throttle: PwmRange
    limits: AngleLimits

    def roll_angle(self, pulse: float) -> float:
        """Convert a pulse of the roll channel to a roll command, rad."""
        return self.roll.signed_from_pwm(pulse) * self.limits.roll

    def pitch_angle(self, pulse: float) -> float:
        """Convert a pulse of the pitch channel to a pitch command, rad."""
        share = self.pitch.signed_from_pwm(pulse)
        return share * self.limits.pitch_max if share > 0.0 else -share * self.limits.pitch_min

    def throttle_share(self, pulse: float) -> float:
        """Convert a pulse of the throttle channel to a throttle command, 0..1."""
        return self.throttle.unsigned_from_pwm(pulse)

    def pulses(self, command: FbwaCommand[float]) -> tuple[float, float, float]:
        """Convert a command to the pulses of roll, pitch and throttle, clamped to the limits."""
        limits = self.limits
        pitch_limit = limits.pitch_max if command.pitch > 0.0 else -limits.pitch_min
        return (
            self.roll.pwm_from_signed(_share(command.roll, limits.roll)),
            self.pitch.pwm_from_signed(_share(command.pitch, pitch_limit)),
            self.throttle.pwm_from_unsigned(command.throttle),
        )


def rc_scaling(parameters: Mapping[str, float]) -> RcScaling:
    """Read the scaling from parameters under ArduPlane's names; others have its defaults."""

    def channel(number: int) -> PwmRange:
        defaults = PwmRange()
        return PwmRange(
            parameters.get(f"RC{number}_MIN", defaults.min),
            parameters.get(f"RC{number}_TRIM", defaults.trim),
            parameters.get(f"RC{number}_MAX", defaults.max),
        )

    names = ("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG")
    limits = AngleLimits(
        *(
            math.radians(parameters[name]) if name in parameters else default
            for name, default in zip(names, AngleLimits(), strict=True)
        )
    )
    return RcScaling(channel(ROLL), channel(PITCH), channel(THROTTLE), limits)


def _share(angle: float, limit: float) -> float:
    return angle / limit if limit > 0.0 else 0.0
