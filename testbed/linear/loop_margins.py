"""Margins of a loop, from its frequency response."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array

MAX_GAIN, MIN_GAIN, MAX_LATENCY_S = 10.0, 0.001, 1.0  # that are reported
FREQUENCIES = np.geomspace(2e-4, 1.0, 3000)  # of loops, as a share of half the control rate


class CommandMargins(NamedTuple):
    """How much one command of one follower can change; nothing where the flight is unstable.

    Attributes:
        gain: largest factor; inf: none found.
        least_gain: smallest factor; 0: none needed.
        latency_s: largest additional latency; inf: none found.
        phase_deg: at the crossing with the least; inf: the loop crosses 1 nowhere.
        distance: least of |1 + L|.
    """

    gain: float
    least_gain: float
    latency_s: float
    phase_deg: float
    distance: float


def margins_of(loop: Array, dt: float, *, stable: bool) -> CommandMargins:
    """Return the margins of a loop.

    As a factor or a latency grows, a pole becomes unstable where 1 + L is 0 with it for the first
    time, at some frequency.

    Args:
        loop: (F,) L at FREQUENCIES.
        dt: s, control period.
        stable: whether the closed loop is.
    """
    distance = float(np.abs(1.0 + loop).min())
    if not stable:
        return CommandMargins(1.0, 1.0, 0.0, 0.0, distance)
    _, real = _crossings(loop.imag, loop.real)
    factors = -1.0 / real[real < 0.0]
    if loop.real[-1] < 0.0:  # at half the control rate L is real
        factors = np.append(factors, -1.0 / loop.real[-1])
    gain = float(factors[factors > 1.0].min(initial=math.inf))
    least = float(factors[factors < 1.0].max(initial=0.0))
    where, phase = _crossings(np.abs(loop) - 1.0, np.unwrap(np.angle(loop)))
    angular = np.interp(where, np.arange(len(loop)), FREQUENCIES) * np.pi / dt
    latency = float((np.mod(phase + np.pi, 2.0 * np.pi) / angular).min(initial=math.inf))
    to_point = np.abs(np.mod(phase, 2.0 * np.pi) - np.pi)
    return CommandMargins(
        gain if gain <= MAX_GAIN else math.inf,
        least if least >= MIN_GAIN else 0.0,
        latency if latency <= MAX_LATENCY_S else math.inf,
        float(np.degrees(to_point).min(initial=math.inf)),
        distance,
    )


def _crossings(values: Array, others: Array) -> tuple[Array, Array]:
    """Return where values (F,) cross 0, as an index with a fraction, and others (F,) there."""
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    part = values[before] / (values[before] - values[before + 1])
    return before + part, others[before] + part * (others[before + 1] - others[before])
