"""What the files of a new aircraft are derived from: trims, steps, a minute of fly-by-wire A.

All numbers come from the flight model itself, none from an aircraft that flew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.airframes.powerplant import AircraftError
from testbed.commissioning.check_flight import CheckFlight, check_and_soften
from testbed.commissioning.envelope import Envelope, find_envelope
from testbed.commissioning.first_gains import (
    LevelFlight,
    first_guidance,
    first_middle_loop,
    first_params,
)
from testbed.commissioning.speed_step import SpeedStep, speed_step
from testbed.commissioning.step_responses import StepResponses, measure_steps, start_of
from testbed.core.errors import InputError
from testbed.core.records import NedOrigin
from testbed.core.standard_atmosphere import SEA_LEVEL_DENSITY, density_ratio
from testbed.scenario import MiddleLoopGains
from testbed.vehicle.jsbsim_adapter import (
    airframe,
    find_cruise,
    trim_aircraft,
    trim_or_suggest,
)
from testbed.vehicle.trim import TrimError, TrimPoint, TrimResult

ALTITUDE = 400.0  # m above sea level, of all trims
_SLOW = 20.0  # m/s: slower cruises are rounded to 0.1 m/s, others to 1 m/s
_SPEED_CHANGE = 0.02  # of the cruise, for slopes over speed
_BANK, _CLIMB = math.radians(30.0), math.radians(2.0)
_SPEED_STEP = 2.0  # m/s, of the speed model


@dataclass(frozen=True, slots=True)
class DerivedAircraft:
    """What was measured on an aircraft, and the gains that follow."""

    envelope: Envelope
    level: LevelFlight
    steps: StepResponses
    check: CheckFlight  # the last flight; its parameters are the aircraft's
    flights: tuple[CheckFlight, ...]  # with this one and those before it
    middle_loop: dict[str, Any]
    guidance: dict[str, float]
    speed: SpeedStep | None  # None: it has no engine


def derive(
    folder: Path,
    airspeed: float | None = None,
    report: Callable[[str], None] = lambda text: None,
) -> DerivedAircraft:
    """Derive autopilot, middle loop and guidance of the aircraft in a folder.

    Args:
        folder: with `<folder name>.xml`; nothing is written to it.
        airspeed: cruise, m/s, true; None: that of a lift coefficient of 0.4, or near it.
        report: called with what begins.

    Raises:
        AircraftError: the aircraft cannot be loaded.
        TrimError: it has no steady flight.
        InputError: its controls have no effect, or it cannot follow the autopilot.
    """
    report("trim")
    cruise = _find_cruise(folder, airspeed)
    report(f"speed range, from {cruise.point.airspeed:.4g} m/s")
    point = cruise.point
    _, origin = start_of(point)
    envelope = find_envelope(folder, cruise, origin)
    level = _level_flight(folder, envelope, origin)
    report("step responses")
    steps = measure_steps(folder, point)
    report("60 s of fly-by-wire A")
    flights: list[CheckFlight] = []
    params = first_params(steps, level)
    check = check_and_soften(folder, point, params, flights.append)
    if check.problem:
        tried = f", with gains softened {check.softenings} times" if check.softenings else ""
        raise InputError(
            f"{folder.name}: trims at {cruise.point.airspeed:.4g} m/s, but {check.problem}{tried}"
        )
    middle_loop = first_middle_loop(steps, level, check.params)
    speed = None
    if steps.throttle_acceleration > 0.0:
        report("step of speed")
        gains = MiddleLoopGains.model_validate(middle_loop)
        speed = speed_step(
            folder, gains, check.params, airspeed=cruise.point.airspeed, step=_SPEED_STEP
        )
    return DerivedAircraft(
        envelope=envelope,
        level=level,
        steps=steps,
        check=check,
        flights=tuple(flights),
        middle_loop=middle_loop,
        guidance=first_guidance(middle_loop, level),
        speed=speed,
    )


def _find_cruise(folder: Path, airspeed: float | None) -> TrimResult:
    """Find level flight at a speed, or at a round one near a lift coefficient of 0.4."""
    speed = airspeed
    if speed is None:
        found = find_cruise(folder, altitude=ALTITUDE).point.airspeed
        speed = round(found, 0 if found >= _SLOW else 1)
    point = TrimPoint(speed, altitude=ALTITUDE)
    return trim_or_suggest(folder, point, start_of(point)[1])


def _level_flight(folder: Path, envelope: Envelope, origin: NedOrigin) -> LevelFlight:
    """Measure slopes about the cruise by trims; 0 where there is no trim beside it."""
    cruise = envelope.cruise
    speed = cruise.point.airspeed
    change = _SPEED_CHANGE * speed

    def beside(point: TrimPoint) -> TrimResult | None:
        try:
            return trim_aircraft(folder, point, origin)
        except TrimError:
            return None

    point = cruise.point
    slow, fast = (beside(replace(point, airspeed=speed + each)) for each in (-change, change))
    banked = beside(replace(point, bank=_BANK))
    climbing = None if envelope.glides else beside(replace(point, flight_path_angle=_CLIMB))
    throttle = cruise.controls.throttle
    low, high = (each or cruise for each in (slow, fast))
    between = high.point.airspeed - low.point.airspeed
    per_speed = (high.controls.throttle - low.controls.throttle) / between if between else 0.0
    per_climb = per_bank = 0.0
    if climbing:
        per_climb = (climbing.controls.throttle - throttle) / math.sin(_CLIMB)
    load = 1.0 / math.cos(_BANK) - 1.0
    if banked:
        per_bank = (banked.controls.throttle - throttle) / (math.cos(_BANK) ** -2 - 1.0)
        incidence = (banked.alpha - cruise.alpha) / load
    else:  # lift grows with the square of the speed
        incidence = 0.5 * speed * (low.alpha - high.alpha) / between if between else 0.0
    lift = _lag_of_path(folder, speed)
    return LevelFlight(
        airspeed=speed,
        lowest=envelope.lowest,
        highest=envelope.highest,
        pitch=cruise.placement.pitch,
        throttle=throttle,
        throttle_per_speed=per_speed,
        throttle_per_climb=per_climb,
        throttle_per_bank=per_bank,
        incidence_per_load=max(incidence, 0.0),
        path_lag_s=lift,
    )


def _lag_of_path(folder: Path, speed: float) -> float:
    """Return 1/|Z_w|: m / (½ ρ V S C_Lα), s."""
    size = airframe(folder)
    if not size.lift_slope > 0.0:
        raise AircraftError(
            f"{folder.name}: its lift coefficient does not grow with the angle of attack near 0, "
            "so the lag of its flight path is not known (write the gains by hand)"
        )
    density = SEA_LEVEL_DENSITY * float(density_ratio(np.array(ALTITUDE)))
    return size.mass / (0.5 * density * speed * size.area * size.lift_slope)
