"""Limit cycles of a follower whose bank is near its limit, predicted by a describing function.

The roll command of the middle loop is limited. Behind the limit B + A sin ωt has the steady command
as its mean, which sets the bias B, and a first harmonic N A with N below 1. A cycle exists where
N L(jω) = -1, for the loop L opened at the roll command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.linear.linear_system import LinearSystem

_FREQUENCY_HZ = np.geomspace(0.05, 3.0, 2000)
_BISECTIONS = 60


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """A steady oscillation of a follower's bank.

    Attributes:
        frequency_hz: of it.
        roll_deg: amplitude of its first harmonic.
    """

    frequency_hz: float
    roll_deg: float


@dataclass(frozen=True, slots=True)
class LimitedSine:
    """A bias and a sine behind an upper limit whose mean is given.

    Attributes:
        amplitude: of the sine before the limit, of the distance of the mean to the limit.
        gain: N, first harmonic behind the limit over that amplitude.
    """

    amplitude: float
    gain: float


def limit_sine(clear: float) -> LimitedSine:
    """Return the describing function of an upper limit with a mean behind it.

    Args:
        clear: (limit - B) / A, between -1 and 1; from there on the sine meets the limit.
    """
    root = math.sqrt(1.0 - clear * clear)
    gain = 0.5 + (math.asin(clear) + clear * root) / math.pi
    cut = (root - clear * math.acos(clear)) / math.pi  # mean of what the limit takes, over A
    return LimitedSine(1.0 / (clear + cut), gain)


def find_limit_cycle(
    formation: LinearSystem,
    follower: str,
    latency_s: float,
    room_deg: float,
) -> LimitCycle | None:
    """Predict the limit cycle of a follower whose roll command is late.

    Args:
        formation: linearised without that latency.
        follower: its name.
        latency_s: of its roll command, additional.
        room_deg: from its steady roll command to the limit.

    Returns:
        None: oscillations decay, because the loop bears the latency.
    """
    roll = f"{follower}.roll"
    late = np.exp(-2j * np.pi * _FREQUENCY_HZ * latency_s)
    loop = formation.loop(roll).frequency_response(_FREQUENCY_HZ)[:, 0, 0] * late
    crossing = np.flatnonzero((loop.imag[:-1] * loop.imag[1:] < 0.0) & (loop.real[:-1] < -1.0))
    if not len(crossing):
        return None
    here = int(crossing[np.abs(loop.real[crossing]).argmax()])
    gain = -1.0 / float(loop.real[here])
    low, high = -1.0, 1.0  # the gain of the limit rises with the clearance
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if limit_sine(middle).gain < gain else (low, middle)
    amplitude_deg = limit_sine(low).amplitude * room_deg
    frequency = _FREQUENCY_HZ[here : here + 1]
    opened = formation.coupled_with(follower).opened(roll)
    bank = opened.select(roll, f"{follower}.attitude.roll").frequency_response(frequency)
    return LimitCycle(float(frequency[0]), gain * amplitude_deg * float(np.abs(bank.item())))
