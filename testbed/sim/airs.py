"""The page's air, built for the aircraft that fly in it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from testbed.air.air import Air
from testbed.air.field import FINEST, MOST_MISSING, Field, make_field, missing_share
from testbed.air.gusts import Gusts, PlacedGust, TimedGust, make_gusts
from testbed.air.independent import Independent
from testbed.air.mean import (
    LogProfile,
    MeanWind,
    PowerProfile,
    Profile,
    blowing_from,
    make_mean_wind,
)
from testbed.air.mil import INTENSITIES, Scales
from testbed.air.recorded import read_wind
from testbed.air.wake import Wakes
from testbed.errors import InputError
from testbed.scenario import Scenario, find_data
from testbed.state import Airframe, Array, Event
from testbed.vehicle.trim import Vector

SEA_LEVEL_DENSITY = 1.225  # kg/m³


def density_ratio(altitude: Array) -> Array:
    """Air density over its value at sea level, ISA troposphere, from altitudes in m."""
    return (1.0 - 2.25577e-5 * altitude) ** 4.25588


def make_mean(page: Scenario, duration_s: float | None = None) -> MeanWind:
    """The mean wind of a page, which carries the air at the height of the leader's start.

    Args:
        page: the scenario.
        duration_s: how long a recorded wind has to last; default: as long as the run.

    Raises:
        InputError: the recorded wind is no such file, or too short.
    """
    wind = page.air.wind
    if wind.file is None:
        time = np.zeros(1)
        velocity = blowing_from(np.array([wind.speed_mps]), math.radians(wind.from_deg))
    else:
        path = find_data(wind.file)
        lasting = page.scenario.duration_s if duration_s is None else duration_s
        time, velocity = read_wind(path, wind.longest_gap_s, lasting)
    carrying = page.leader.start.altitude_m
    return make_mean_wind(time, velocity, profile=_profile(page), carrying_height=carrying)


def start_wind(mean: MeanWind, height: float) -> Vector:
    """Velocity of the air at the start, m/s, at a height, m."""
    north, east, down = mean.velocity_ned(0.0, np.array(height)).tolist()
    return north, east, down


def scales(page: Scenario) -> Scales | None:
    """Intensities and lengths of the page's turbulence by height; None: there is none."""
    asked = page.air.turbulence
    if asked.model == "none":
        return None
    standard = INTENSITIES[asked.intensity]
    return Scales(
        "dryden" if asked.model == "dryden" else "von-karman",
        standard.w20 if asked.w20_mps is None else asked.w20_mps,
        standard.probability if asked.probability is None else asked.probability,
        asked.sigma_mps,
        asked.length_m,
    )


def make_air(
    page: Scenario,
    mean: MeanWind,
    names: Sequence[str],
    airframes: Sequence[Airframe],
    *,
    dt: float,
    sheds: Sequence[bool],
) -> Air:
    """The air of a page round N aircraft.

    Args:
        page: the scenario.
        mean: its mean wind.
        names: N, which key the random numbers.
        airframes: N.
        dt: s, how often it is felt.
        sheds: N, who sheds and feels wakes.

    Raises:
        InputError: what the page asks for cannot be built.
    """
    own = field = None
    known = scales(page)
    if known is not None and page.air.turbulence.model == "coherent":
        field = _field(page, known, airframes)
    elif known is not None:
        own = Independent(
            names,
            seed=page.scenario.seed,
            dt=dt,
            spans=[each.span for each in airframes],
            spectrum=known.spectrum,
            scales=known,
        )
    return Air(
        mean,
        airframes,
        gusts=_gusts(page, mean),
        field=field,
        own=own,
        wakes=_wakes(page, airframes, dt, sheds),
    )


def standing(page: Scenario) -> Iterator[Event]:
    """A warning of a field through which no wind carries the aircraft."""
    wind = page.air.wind
    if page.air.turbulence.model == "coherent" and not (wind.speed_mps or wind.file):
        text = (
            "coherent turbulence without a mean wind stands still: who circles meets its gusts "
            "again every lap (write air.wind.speed_mps)"
        )
        yield Event(0.0, "warning", "run", text)


def _profile(page: Scenario) -> Profile | None:
    asked = page.air.wind.profile
    if asked.kind == "log":
        return LogProfile(asked.height_m, asked.roughness_m)
    if asked.kind == "power":
        return PowerProfile(asked.height_m, asked.exponent)
    return None


def _gusts(page: Scenario, mean: MeanWind) -> Gusts | None:
    gusts: list[TimedGust | PlacedGust] = []
    for asked in page.air.gusts:
        pulse = asked.shape == "pulse"
        if asked.kind == "time":
            gusts.append(TimedGust(asked.velocity_mps, asked.at_s, asked.ramp_s, pulse))
            continue
        towards = math.radians(asked.towards_deg)
        gusts.append(
            PlacedGust(
                asked.velocity_mps,
                asked.at_m,
                towards,
                asked.at_s,
                asked.length_m,
                asked.speed_mps,
                pulse,
            )
        )
    return make_gusts(gusts, mean) if gusts else None


def _field(page: Scenario, known: Scales, airframes: Sequence[Airframe]) -> Field:
    asked = page.air.turbulence.height_m
    height = page.leader.start.altitude_m if asked is None else asked
    sigma, length = known(np.array(height))
    _refuse_small(page, height, float(length.min()))
    reach = max(max(0.5 * each.span, each.arm) for each in airframes)
    return make_field(page.scenario.seed, sigma, length, reach_m=reach)


def _refuse_small(page: Scenario, height: float, length: float) -> None:
    """Say with the page's keys what `make_field` says of its own."""
    lost = missing_share(FINEST, length)
    if lost <= MOST_MISSING:
        return
    asked = page.air.turbulence
    key = "length_m" if asked.length_m is not None else "height_m"
    cause = f"a scale length of {length:.3g} m"
    if key == "height_m":
        cause = f"{cause}, which is that of {height:g} m above the ground,"
    raise InputError(
        f"air.turbulence: of turbulence with {cause} the field lacks {100.0 * lost:.0f} % of the "
        f"variance, in waves shorter than its cells (write a larger air.turbulence.{key}, or "
        "model: von-karman)"
    )


def _wakes(
    page: Scenario, airframes: Sequence[Airframe], dt: float, sheds: Sequence[bool]
) -> Wakes | None:
    asked = page.air.wake
    if asked is None or sum(sheds) < 2:  # nobody to feel it
        return None
    altitude = page.scenario.origin.elevation_m + page.leader.start.altitude_m
    return Wakes(
        span=np.array([each.span for each in airframes]),
        area=np.array([each.area for each in airframes]),
        lift_slope=np.array([each.lift_slope for each in airframes]),
        mass=np.array([each.mass for each in airframes]),
        sheds=np.array(sheds),
        feels=np.array(sheds),
        core_spans=asked.core_spans,
        decay_s=asked.decay_s,
        memory_s=asked.memory_s,
        dt=dt,
        density=SEA_LEVEL_DENSITY * float(density_ratio(np.array(altitude))),
    )
