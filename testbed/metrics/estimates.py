"""What the estimates were worth: how far aircraft were from where they believed to be, as a fold.

Position, velocity, attitude and airspeed are those of an autopilot's estimate less the truth. What
is common to a follower and its leader a formation does not feel, so the error of their relative
position is summed on its own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from testbed.frames import wrap_pi
from testbed.metrics.block import Ticks
from testbed.state import Array, Truths

_NAMES = ("horizontal_m", "height_m", "velocity_mps", "tilt_deg", "heading_deg", "airspeed_mps")
_UNITS = np.array([1.0, 1.0, 1.0, math.degrees(1.0), math.degrees(1.0), 1.0])
_FORMS = {
    "horizontal_m": "{:.2f} m horizontal",
    "height_m": "{:.2f} m height",
    "velocity_mps": "{:.2f} m/s",
    "airspeed_mps": "airspeed {:.2f} m/s",
    "tilt_deg": "tilt {:.1f}°",
    "heading_deg": "heading {:.1f}°",
}

Numbers = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Estimates:
    """What remains of the frames folded so far, of N aircraft, n = N − 1 of them followers."""

    square: Array  # (N, 6) sums of squares in the order of `_NAMES`; rad²
    largest: Array  # (N,) horizontal, m
    relative: Array  # (n,) sum of squares of own position less the leader's, m²


def empty(aircraft: int) -> Estimates:
    """Of no frames."""
    return Estimates(
        square=np.zeros((aircraft, len(_NAMES))),
        largest=np.zeros(aircraft),
        relative=np.zeros(aircraft - 1),
    )


def fold(estimates: Estimates, off: Sequence[Array], lost: Truths) -> Estimates:
    """The numbers with K more frames added.

    Args:
        estimates: of the frames before.
        off: estimate less truth of K frames: position (K, N, 3), velocity, euler, airspeed (K, N).
        lost: (K, N) aircraft that do not count.
    """
    position, velocity, euler, airspeed = off
    roll, pitch, yaw = np.moveaxis(wrap_pi(euler), -1, 0)
    north, east, down = np.moveaxis(position, -1, 0)
    horizontal = north**2 + east**2
    speed = np.sum(velocity**2, axis=-1)
    square = np.stack(
        (horizontal, down**2, speed, roll**2 + pitch**2, yaw**2, airspeed**2), axis=-1
    )
    relative = np.sum((position[:, 1:] - position[:, :1]) ** 2, axis=-1)
    if lost.any():
        square[lost] = 0.0
        relative[lost[:, 1:] | lost[:, :1]] = 0.0
    return Estimates(
        square=estimates.square + square.sum(axis=0),
        largest=np.maximum(estimates.largest, np.sqrt(square[..., 0]).max(axis=0)),
        relative=estimates.relative + relative.sum(axis=0),
    )


def summarise(
    estimates: Estimates, names: Sequence[str], *, frames: Ticks, paired: Ticks
) -> dict[str, dict[str, Any]]:
    """RMS errors by aircraft, and those of the position relative to the leader's by follower.

    Args:
        estimates: of all frames.
        names: N, the leader first.
        frames: (N,) in which an aircraft was not lost.
        paired: (n,) in which neither a follower nor its leader was.
    """
    rms = np.sqrt(estimates.square / np.maximum(frames, 1)[:, None]) * _UNITS
    relative = np.sqrt(estimates.relative / np.maximum(paired, 1))
    values = np.column_stack((rms, estimates.largest)).tolist()
    keys = (*_NAMES, "largest_horizontal_m")
    return {
        "estimate_error": {
            name: {key: _number(value) for key, value in zip(keys, row, strict=True)}
            for name, row in zip(names, values, strict=True)
        },
        "relative_position_m": {
            name: _number(value) for name, value in zip(names[1:], relative.tolist(), strict=True)
        },
    }


def exact(off: Mapping[str, Numbers]) -> bool:
    """Whether no estimate of a metrics document ever erred."""
    return not any(each != 0.0 for numbers in off.values() for each in numbers.values())


def describe(off: Mapping[str, Numbers], relative: Numbers) -> list[str]:
    """What the estimates were worth in up to four lines; none where they were exact.

    Numbers are RMS over the aircraft whose estimates erred; how many these are is said if they are
    not all.

    Args:
        off: `estimate_error` of the metrics document.
        relative: its `relative_position_m`.
    """
    if exact(off):
        return []
    known = {name: each for name, each in off.items() if None not in each.values()}
    erred = [each for each in known.values() if any(each.values())]
    lines = []
    if erred:
        rms = {key: _together([each[key] for each in erred]) for key in _NAMES}
        shown = [form.format(rms[key]) for key, form in _FORMS.items() if rms[key]]
        lines = [", ".join(shown[:3]), ", ".join(shown[3:])]
        felt = {name: each for name, each in relative.items() if each is not None}
        if any(felt.values()):
            worst = max(felt, key=lambda name: felt[name])
            most = f", at worst {felt[worst]:.2f} m ({worst})" if len(felt) > 1 else ""
            lines.append(f"relative to the leader {_together(felt.values()):.2f} m{most}")
        if len(erred) < len(off):
            lines.append(f"over the {len(erred)} of {len(off)} aircraft that err")
    if len(known) < len(off):
        unknown = ", ".join(name for name in off if name not in known)
        lines.append(f"not a number: {unknown}")
    return [line for line in lines if line]


def _together(values: Collection[float | None]) -> float:
    """The root of the mean square."""
    return math.sqrt(sum(each**2 for each in values if each is not None) / len(values))


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
