"""The travel of JSBSim's <kinematic> between its settings."""

from __future__ import annotations

from testbed.core.compile import kernel
from testbed.core.records import Array


@kernel
def travel(position: float, target: float, dt: float, settings: Array, times: Array) -> float:
    """Move towards a target at the rate of the interval that the position is in, for some time.

    Args:
        position: now.
        target: where the travel ends, held to the settings.
        dt: time, s.
        settings: (K,) positions that increase.
        times: (K,) s, from the setting before.
    """
    left, target = dt, min(max(target, settings[0]), settings[-1])
    while left > 0.0 and position != target:
        k = 1
        while k < len(settings) and (
            settings[k] < position if target < position else settings[k] <= position
        ):
            k += 1
        if k == len(settings):
            return position  # beyond the settings
        if times[k] <= 0.0:
            return target
        rate = (settings[k] - settings[k - 1]) / times[k]
        end = min(max(target, settings[k - 1]), settings[k])
        needed = abs((end - position) / rate)
        if left < needed:
            position += left * rate if position < target else -(left * rate)
            needed = left
        else:
            position = end
        left -= needed
    return position
