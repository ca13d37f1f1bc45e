"""Integer time: everything happens on a tick of the base rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from testbed.errors import InputError


@dataclass(frozen=True, slots=True)
class Clock:
    """Periods in ticks of the base rate; t = k dt, never a sum."""

    base_rate_hz: int
    autopilot: int
    control: int
    broadcast: int
    log: int

    @property
    def stride(self) -> int:
        """The most ticks that can be flown at once without passing over an event."""
        return math.gcd(self.autopilot, self.control, self.broadcast, self.log)

    def time_s(self, tick: int) -> float:
        """Simulation time of a tick, s."""
        return tick / self.base_rate_hz

    def ticks(self, duration_s: float) -> int:
        """Ticks in a duration, rounded to the nearest."""
        return round(duration_s * self.base_rate_hz)


def make_clock(
    *, physics_hz: int, autopilot_hz: int, control_hz: int, broadcast_hz: int, log_hz: int
) -> Clock:
    """The clock of these rates.

    Raises:
        InputError: a rate does not divide the base rate.
    """
    rates = {
        "autopilot_hz": autopilot_hz,
        "control_hz": control_hz,
        "broadcast_hz": broadcast_hz,
        "log_hz": log_hz,
    }
    for name, rate in rates.items():
        if rate <= 0 or physics_hz % rate:
            raise InputError(f"rates.{name}: {rate} does not divide physics_hz {physics_hz}")
    periods = {name.removesuffix("_hz"): physics_hz // rate for name, rate in rates.items()}
    return Clock(base_rate_hz=physics_hz, **periods)
