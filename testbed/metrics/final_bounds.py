"""Bounds of `expect` that a flight has violated, whatever the rest of it brings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from testbed.core.records import Array, RunInfo
from testbed.metrics.accumulator import NEVER, Accumulator
from testbed.metrics.expectations import check_expectations

# Numbers that only grow have a final largest value, those that only fall a final smallest one.
_SIDES = {
    **dict.fromkeys(("rms_m", "mean_rms_m", "estimated_rms_m", "estimated_mean_rms_m"), "max"),
    **dict.fromkeys(("percent_error", "max_error_m", "left_speed_set"), "max"),
    "min_separation_m": "min",
}


def is_violated(
    total: Accumulator,
    windows: Mapping[str, tuple[float, float]],
    info: RunInfo,
    expect: Mapping[str, Any],
) -> bool:
    """Return whether a bound is violated by the samples so far, whatever follows.

    A root mean square is at least that of a window in which all further samples are zero.

    Args:
        total: of the samples so far.
        windows: span (start, end) in s by name.
        info: of the run.
        expect: bounds of the scenario, as plain data.
    """
    known = {quantity: expect[quantity] for quantity in _SIDES if quantity in expect}
    found = check_expectations(_least(total, windows, info), known)["bounds"]
    return any(not each["met"] and each["side"] == _SIDES[each["quantity"]] for each in found)


def _least(
    total: Accumulator, windows: Mapping[str, tuple[float, float]], info: RunInfo
) -> dict[str, Any]:
    """Return the numbers of metrics.json that are compared, at their best after any rest."""
    followers = info.names[1:]

    def by_follower(values: Array) -> dict[str, float]:
        return dict(zip(followers, values.tolist(), strict=True))

    found = {}
    for p, (name, (start, end)) in enumerate(windows.items()):
        samples = math.ceil((end - start) * info.sample_rate_hz) + 1  # at most
        rms, estimated, ratio = (
            np.sqrt(each[p] / samples)
            for each in (
                total.square_error,
                total.square_estimated_error,
                total.square_error_ratio,
            )
        )
        found[name] = {
            "covered_s": total.window_samples[p] / info.sample_rate_hz,
            "rms_m": by_follower(rms),
            "mean_rms_m": float(rms.mean()),
            "estimated_rms_m": by_follower(estimated),
            "estimated_mean_rms_m": float(estimated.mean()),
            "percent_error": 100.0 * float(ratio.mean()),
            "max_error_m": by_follower(total.window_max_error[p]),
        }
    lost = [None if tick == NEVER else tick for tick in total.lost_tick.tolist()]
    return {
        "windows": found,
        "min_separation_m": total.min_separation,
        "left_speed_set": {
            name: {"times": int(times)}
            for name, times in zip(followers, total.left_speed_set, strict=True)
        },
        "lost_at_s": dict(zip(info.names, lost, strict=True)),
    }
