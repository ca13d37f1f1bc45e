"""Warn before the flight of sensor settings that fly as other numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator

from testbed.core.records import Event, join_names
from testbed.scenario import Scenario

TOLERANCE = 1e-6  # of a period


def sensor_warnings(scenario: Scenario) -> Iterator[Event]:
    """Warn of each GPS latency that is not a whole number of autopilot periods."""
    rate_hz = scenario.rates.autopilot_hz
    found: dict[str, list[str]] = {}
    for each in scenario.aircraft:
        sensors = each.sensors
        if sensors.gps is None:
            continue
        for key, value in (
            ("gps.latency_s", sensors.gps.latency_s),
            ("estimator.gps_delay_s", sensors.estimator.gps_delay_s),
        ):
            periods = value * rate_hz
            if abs(periods - round(periods)) > TOLERANCE:
                low, high = math.floor(periods) / rate_hz, math.ceil(periods) / rate_hz
                text = (
                    f"sensors.{key}: {value:g} s flies as {round(periods) / rate_hz:g} s, a whole "
                    f"number of periods of rates.autopilot_hz, {rate_hz} Hz (write {low:g} or "
                    f"{high:g}, or another rate)"
                )
                found.setdefault(text, []).append(each.name)
    for text, names in found.items():
        if len(names) == 1:
            yield Event(0.0, "warning", names[0], text)
        else:
            yield Event(0.0, "warning", "run", f"{join_names(names)}: {text}")
