"""What wind the aircraft felt: a fold like `tally`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.frames import wind_from_deg
from testbed.metrics.block import Ticks
from testbed.state import Array

CALM = 1e-6  # m/s; less is rounding


@dataclass(frozen=True, slots=True)
class Wind:
    """What remains of the frames folded so far, of N aircraft."""

    total: Array  # (N, 3) sum of the wind, m/s
    square: Array  # (N, 3) and of its squares, m²/s²
    fastest: Array  # (N,) largest speed, m/s
    roll: Array  # (N,) largest magnitude of a wake's rolling-moment coefficient


def empty(aircraft: int) -> Wind:
    """Of no frames."""
    return Wind(
        total=np.zeros((aircraft, 3)),
        square=np.zeros((aircraft, 3)),
        fastest=np.zeros(aircraft),
        roll=np.zeros(aircraft),
    )


def fold(wind: Wind, wind_ned: Array, roll_coefficient: Array) -> Wind:
    """The wind with K more frames of wind (K, N, 3) m/s and rolling moments (K, N) added.

    Zeros stand for frames that do not count.
    """
    square = wind_ned**2
    speed = np.sqrt(square.sum(axis=2))
    return Wind(
        total=wind.total + wind_ned.sum(axis=0),
        square=wind.square + square.sum(axis=0),
        fastest=np.maximum(wind.fastest, speed.max(axis=0)),
        roll=np.maximum(wind.roll, np.abs(roll_coefficient).max(axis=0)),
    )


def summarise(wind: Wind, names: Sequence[str], frames: Ticks) -> dict[str, dict[str, Any]]:
    """By aircraft: its mean wind, the RMS of what is over, the fastest, and what wakes did.

    Of each aircraft so many frames (N,) count.
    """
    frames = np.maximum(frames, 1)[:, None]
    mean = wind.total / frames
    gusts = np.sqrt(np.maximum(wind.square / frames - mean**2, 0.0))
    gusts[gusts < CALM] = 0.0
    north, east = mean[:, 0], mean[:, 1]
    from_deg, blows = wind_from_deg(mean), np.hypot(north, east) > CALM
    return {
        name: {
            "mean_ned_mps": _numbers(mean[i]),
            "mean_mps": _number(float(np.hypot(north[i], east[i]))),
            "from_deg": _number(float(from_deg[i])) if blows[i] else None,
            "gusts_rms_ned_mps": _numbers(gusts[i]),
            "fastest_mps": _number(float(wind.fastest[i])),
            "wake_roll_coefficient": _number(float(wind.roll[i])),
        }
        for i, name in enumerate(names)
    }


def describe(felt: Mapping[str, Mapping[str, Any]]) -> str | None:
    """One line on the wind of all aircraft together; None in still air.

    Gusts are the RMS over the aircraft of what each felt over its own mean wind.
    """
    felts = list(felt.values())
    if any(each["fastest_mps"] is None for each in felts):
        return "not a number"
    if max(each["fastest_mps"] for each in felts) < CALM:
        return None
    mean = np.mean([each["mean_ned_mps"] for each in felts], axis=0)
    speed = math.hypot(*mean[:2])
    text = f"{speed:.1f} m/s"
    if speed >= 0.05:
        text += f" from {round(float(wind_from_deg(mean))) % 360}°"
    gusts = np.sqrt(np.mean(np.square([each["gusts_rms_ned_mps"] for each in felts]), axis=0))
    if gusts.any():
        level = math.sqrt(0.5 * (gusts[0] ** 2 + gusts[1] ** 2))
        text += f", varying by {level:.2f} m/s level and {gusts[2]:.2f} m/s vertical (RMS)"
    return text


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _numbers(values: Array) -> list[float | None]:
    return [_number(float(value)) for value in values]
