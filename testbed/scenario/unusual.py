"""Numbers of a scenario that are allowed, and larger than those of real flights.

Bounds of the schema refuse what no flight has; a number below them may still be a slip of units or
digits. Each number has a rule by its key, and most keys end with their unit.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from testbed.scenario.fields import Section, is_number
from testbed.scenario.load import middle_loop_gains
from testbed.scenario.schema import Scenario
from testbed.scenario.single_aircraft import SingleAircraft

# Largest usual magnitude by pattern of the key, in its unit; the first pattern that fits holds.
# Keys are without names and indices: fleet.sensors.gps.noise_m. Shares, angles and choices have no
# rule: their bounds are those of their nature. Gains in 1/s have none either: what is usual depends
# on the control period, see `check_rate`.
USUAL: tuple[tuple[str, float], ...] = (
    # estimates and sensors
    ("*.sensors.*_m", 200.0),
    ("*.sensors.*_mps", 20.0),
    ("*.sensors.*_deg", 90.0),
    ("*.sensors.*_pa", 500.0),
    ("*.sensors.*.scale", 0.5),
    ("*.sensors.*.scale_sigma", 0.5),
    ("*.sensors.*_dps*", 50.0),
    ("*.sensors.*_mps2*", 20.0),
    ("*.sensors.*_mps3", 20.0),
    ("*.sensors.*_radps*", 5.0),
    ("*.sensors.*gate_sigma", 100.0),
    ("*.sensors.*.rate_hz", 1000.0),
    ("*.sensors.estimator.reset_after_s", 600.0),
    # aircraft and paths
    ("*.battery.cells", 14.0),
    ("*.faults.when.*", 1e4),  # in the unit of the quantity
    ("*.path.bank_limit_deg", 60.0),
    ("*.path.climb_limit_mps", 20.0),
    ("*.path.curve.climb_mps", 20.0),
    ("*.path.legs.laps", 1000.0),
    ("*.path.legs.levels.turns", 1000.0),
    # law and middle loop
    ("formation.*gains", 1000.0),
    ("formation*.k", 20.0),
    ("formation*.b", 20.0),
    ("formation*.c.per_speed_squared", 1.0),
    ("formation*.nu1", 5e5),
    ("formation*.nu2", 1e4),
    ("formation*.barrier.nu", 20.0),
    ("controller.loiter_bank_deg", 50.0),
    ("controller.gains.limits.pitch_deg", 60.0),
    ("controller.gains.limits.roll_deg", 75.0),
    ("controller.gains.*_deg", 45.0),
    ("controller.gains.*_mps", 60.0),
    ("controller.gains.*_s", 10.0),
    ("controller.gains.*", 20.0),
    # network
    ("*latency_s", 1.0),
    ("*gps_delay_s", 1.0),
    ("network*.delay_s", 10.0),
    ("network*.spread_s", 10.0),
    ("network*.every_s", 60.0),
    ("network.tdma.frame_s", 10.0),
    ("network.broadcast.period_s", 10.0),
    ("network.clocks.offset_s", 60.0),
    ("network.clocks.drift_ppm", 1000.0),
    ("network.clocks.resolution_s", 1.0),
    ("network*.bits", 100.0),
    ("network*.gap", 1000.0),
    ("network*.queue_packets", 2000.0),
    ("network*.packets", 100.0),
    ("network*_bytes", 2000.0),
    ("network*.bit_per_s", 1e10),
    ("network*.drop", 1e7),
    ("network*.range_loss", 1e5),  # m
    ("network*.shadowing.loss", 180.0),  # degrees
    # air
    ("air.wind.profile.roughness_m", 5.0),
    ("air.turbulence.sigma_mps", 10.0),
    ("air.turbulence.length_m", 5000.0),
    ("air.wake.memory_s", 120.0),
    ("air.*_mps", 30.0),
    # what is left, by unit
    ("limits.stall_deg", 45.0),
    ("scenario.windows", 14_400.0),
    ("*timeout_s", 600.0),
    ("*failsafe_s", 600.0),
    ("*_m", 10_000.0),
    ("*_mps", 100.0),
    ("*_s", 14_400.0),
    ("*_hz", 2000.0),
)
# Numbers without effect on a flight.
_NOT_FLOWN = ("scenario.published", "scenario.origin", "expect", "network.trace.begin_s")


@functools.cache
def usual_limit(key: str) -> float | None:
    """Return the largest usual magnitude of a key without names and indices; None: no rule."""
    if any(key == each or key.startswith(f"{each}.") for each in _NOT_FLOWN):
        return None
    return next((limit for pattern, limit in USUAL if fnmatchcase(key, pattern)), None)


def unusual_numbers(scenario: Scenario | SingleAircraft) -> Iterator[str]:
    """Yield a text for each key with numbers beyond the usual; of many like keys one."""
    found: dict[str, list[tuple[str, float]]] = {}
    sections: list[tuple[str, str, Section]] = [("", "", scenario)]
    if isinstance(scenario, Scenario):
        sections += [
            ("controller.gains.", "controller.gains.", middle_loop_gains(scenario, each))
            for each in dict.fromkeys(f.aircraft for f in scenario.fleet if f.vehicle == "jsbsim")
        ]
    for key, shown, section in sections:
        for at, name, value in _numbers(key, shown, section):
            limit = usual_limit(at)
            if limit is not None and abs(value) > limit:
                found.setdefault(at, []).append((name, value))
    for at, numbers in found.items():
        name, value = max(numbers, key=lambda each: abs(each[1]))
        sign = "-" if value < 0 else ""
        others = f", and {len(numbers) - 1} more such numbers" if numbers[1:] else ""
        yield f"{name} is {value:g}{others}; usual are up to {sign}{usual_limit(at):g}"


def _numbers(key: str, shown: str, value: Any) -> Iterator[tuple[str, str, float]]:  # noqa: ANN401
    """Yield key without names and indices, key with them, and value of each number."""
    if isinstance(value, Section):
        for name in type(value).model_fields:
            field = getattr(value, name)
            if field is not None and not isinstance(field, str | bool):
                yield from _numbers(f"{key}{name}.", f"{shown}{name}.", field)
    elif isinstance(value, Mapping):
        for name, each in value.items():
            yield from _numbers(key, f"{shown}{name}.", each)
    elif isinstance(value, tuple):
        for index, each in enumerate(value):
            yield from _numbers(key, f"{shown}{index}.", each)
    elif is_number(value):
        yield key[:-1], shown[:-1], value
