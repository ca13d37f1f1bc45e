"""Build the air of a scenario for its aircraft."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext

import numpy as np

from testbed.atmosphere.air import Atmosphere
from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.atmosphere.gusts import PlaneFrontGust, UniformGust, make_gusts
from testbed.atmosphere.mean_wind import (
    LOGARITHMIC,
    POWER,
    MeanWind,
    Profile,
    make_mean_wind,
    read_wind,
    wind_from_direction,
)
from testbed.atmosphere.mil_f_8785c import INTENSITIES, Scales
from testbed.atmosphere.turbulence_field import (
    FINEST,
    MAX_UNRESOLVED,
    TurbulenceField,
    make_field,
    unresolved_variance,
)
from testbed.atmosphere.wake import WakeModel
from testbed.core.errors import InputError
from testbed.core.reads import unrecorded
from testbed.core.records import Airframe, Event, Records
from testbed.core.standard_atmosphere import (
    LAPSE_RATE,
    SEA_LEVEL_DENSITY,
    SEA_LEVEL_K,
    density_ratio,
)
from testbed.plan.fleet import Fleet
from testbed.scenario import find_data
from testbed.scenario.air import Air as AirSection
from testbed.scenario.air import Turbulence, Wind


def temperature_offset(air: AirSection, elevation_m: float) -> float:
    """Return how much warmer the air is than the standard atmosphere, K; at all heights.

    Args:
        air: the section of the scenario.
        elevation_m: of the ground above sea level.
    """
    if air.temperature_c is None:
        return 0.0
    return air.temperature_c - (SEA_LEVEL_K - 273.15 - LAPSE_RATE * elevation_m)


def temperature_warnings(fleet: Fleet, offset: float, height_m: float) -> Iterator[Event]:
    """Warn of aircraft that a temperature does not act on as on the others.

    Args:
        fleet: the N aircraft.
        offset: of the temperature from the standard atmosphere, K.
        height_m: of the start above the ground.
    """
    if not offset:
        return
    if not fleet.model_rows:
        text = "air.temperature_c has no effect: only flight models have an air density"
        yield Event(0.0, "warning", "run", text)
    altitude = fleet.origin.elevation_m + height_m
    density = density_ratio(np.array([altitude]), offset) / density_ratio(np.array([altitude]))
    for each in fleet.aircraft:
        if each.arduplane:
            text = (
                "ArduPlane takes its air density from a barometer in the standard atmosphere: the "
                f"true airspeed that it computes is wrong by {100 * (density[0] ** 0.5 - 1):+.1f} %"
            )
            yield Event(0.0, "warning", each.name, text)


def build_mean_wind(wind: Wind, *, height_m: float, duration_s: float) -> MeanWind:
    """Build the mean wind.

    Args:
        wind: the section of the scenario.
        height_m: at which it moves the air, that of the leader's start.
        duration_s: how long a recorded wind has to last.

    Raises:
        InputError: the recorded wind is no such file, or too short.
    """
    if wind.file is None:
        time = np.zeros(1)
        with nullcontext() if blows(wind) else unrecorded():
            velocity = wind_from_direction(np.array([wind.speed_mps]), math.radians(wind.from_deg))
    else:
        path = find_data(wind.file)
        try:
            time, velocity = read_wind(path, wind.max_gap_s, duration_s)
        except InputError as error:
            raise InputError(f"air.wind.file: {error}") from error
    with nullcontext() if blows(wind) else unrecorded():
        profile = _profile(wind)
    return make_mean_wind(time, velocity, profile=profile, advection_height=height_m)


def blows(wind: Wind) -> bool:
    """Return whether there is a mean wind, which has a direction and a profile."""
    return wind.file is not None or wind.speed_mps > 0.0


def initial_wind(mean: MeanWind, height: float) -> tuple[float, float, float]:
    """Return the velocity of the air at the start, m/s NED, at a height, m."""
    north, east, down = mean.velocity_ned(0.0, height).tolist()
    return north, east, down


def strongest_wind(air: AirSection, mean: MeanWind, height: float, duration_s: float) -> float:
    """Return the largest speed of the wind in a run, m/s, at a height, m; without turbulence.

    Gusts that last (`shape: ramp`) are added; those that pass are not.
    """
    times = mean.rows["time"]
    known = times[times <= duration_s].tolist()
    speeds = [float(np.linalg.norm(mean.velocity_ned(time, height))) for time in known]
    ramps = [gust.velocity_mps[:2] for gust in air.gusts if gust.shape == "ramp"]
    return max(speeds) + sum(math.hypot(*each) for each in ramps)


def turbulence_scales(turbulence: Turbulence) -> Scales | None:
    """Return intensities and lengths of the turbulence by height; None without turbulence."""
    if turbulence.model == "none":
        return None
    given = turbulence.sigma_mps is not None  # in place of what the others decide
    with unrecorded() if given else nullcontext():
        w20, probability = turbulence.w20_mps, turbulence.probability
        with nullcontext() if w20 is None or probability is None else unrecorded():
            standard = INTENSITIES[turbulence.intensity]
    return Scales(
        "dryden" if turbulence.model == "dryden" else "von-karman",
        standard.w20 if w20 is None else w20,
        standard.probability if probability is None else probability,
        turbulence.sigma_mps,
        turbulence.length_m,
    )


def build_air(
    air: AirSection,
    mean: MeanWind,
    names: Sequence[str],
    airframes: Sequence[Airframe],
    *,
    seed: int,
    height_m: float,
    elevation_m: float,
    dt: float,
    sheds: Sequence[bool],
) -> Atmosphere:
    """Build the air around N aircraft.

    Args:
        air: the section of the scenario.
        mean: its mean wind.
        names: N, which key the random numbers.
        airframes: N.
        seed: of the run.
        height_m: of the leader's start above the ground.
        elevation_m: of the ground above sea level.
        dt: s, between samples of the wind.
        sheds: N, whether the aircraft sheds wakes and is affected by them.

    Raises:
        InputError: the scenario's air cannot be built.
    """
    dryden = field = None
    turbulence = turbulence_scales(air.turbulence)
    if turbulence is not None and air.turbulence.model == "coherent":
        field = _field(air.turbulence, turbulence, airframes, seed, height_m)
    elif turbulence is not None:
        dryden = DrydenTurbulence(
            names,
            seed=seed,
            dt=dt,
            spans=[each.span for each in airframes],
            spectrum=turbulence.spectrum,
            scales=turbulence,
        )
    return Atmosphere(
        mean,
        airframes,
        gusts=_gusts(air, mean),
        field=field,
        dryden=dryden,
        wakes=_wakes(air, airframes, height_m, elevation_m, dt, sheds),
    )


def still_field_warnings(air: AirSection) -> Iterator[Event]:
    """Warn of a turbulence field that no wind moves over the ground."""
    wind = air.wind
    if air.turbulence.model == "coherent" and not (wind.speed_mps or wind.file):
        text = (
            "coherent turbulence without a mean wind stands still: an aircraft that circles meets "
            "the same gusts every lap (write air.wind.speed_mps)"
        )
        yield Event(0.0, "warning", "run", text)


def _profile(wind: Wind) -> Profile | None:
    profile = wind.profile
    if profile.kind == "log":
        return Profile(LOGARITHMIC, profile.height_m, profile.roughness_m)
    if profile.kind == "power":
        return Profile(POWER, profile.height_m, profile.exponent)
    return None


def _gusts(air: AirSection, mean: MeanWind) -> Records | None:
    gusts: list[UniformGust | PlaneFrontGust] = []
    for gust in air.gusts:
        pulse = gust.shape == "pulse"
        if gust.kind == "time":
            gusts.append(UniformGust(gust.velocity_mps, gust.at_s, gust.ramp_s, pulse))
            continue
        direction = math.radians(gust.towards_deg)
        gusts.append(
            PlaneFrontGust(
                gust.velocity_mps,
                gust.at_m,
                direction,
                gust.at_s,
                gust.length_m,
                gust.speed_mps,
                pulse,
            )
        )
    return make_gusts(gusts, mean) if gusts else None


def _field(
    section: Turbulence, scales: Scales, airframes: Sequence[Airframe], seed: int, height_m: float
) -> TurbulenceField:
    height = height_m if section.height_m is None else section.height_m
    sigma, length = scales(np.array(height))
    _check_scale_length(section, height, float(length.min()))
    reach = max(max(0.5 * each.span, each.arm) for each in airframes)
    return make_field(seed, sigma, length, reach_m=reach)


def _check_scale_length(section: Turbulence, height: float, length: float) -> None:
    """Check what `make_field` checks, with the scenario's keys in the message."""
    unresolved = unresolved_variance(FINEST, length)
    if unresolved <= MAX_UNRESOLVED:
        return
    key = "length_m" if section.length_m is not None else "height_m"
    cause = f"a scale length of {length:.3g} m"
    if key == "height_m":
        cause = f"{cause}, which is that of {height:g} m above the ground,"
    raise InputError(
        f"air.turbulence: of turbulence with {cause} the field lacks {100.0 * unresolved:.0f} % of "
        f"the variance, in waves shorter than its cells (write a larger air.turbulence.{key}, or "
        "model: von-karman)"
    )


def _wakes(
    air: AirSection,
    airframes: Sequence[Airframe],
    height_m: float,
    elevation_m: float,
    dt: float,
    sheds: Sequence[bool],
) -> WakeModel | None:
    wake = air.wake
    if wake is None or sum(sheds) < 2:  # no two aircraft
        return None
    offset = temperature_offset(air, elevation_m)
    return WakeModel(
        airframes,
        sheds=sheds,
        affected=sheds,
        core_spans=wake.core_spans,
        decay_s=wake.decay_s,
        memory_s=wake.memory_s,
        dt=dt,
        density=SEA_LEVEL_DENSITY * float(density_ratio(np.array(elevation_m + height_m), offset)),
    )
