"""Fly probes straight and level through the air of a scenario, and record the wind."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, Array, allocate
from testbed.scenario import Scenario, dump, find_aircraft
from testbed.sim.build_air import build_air, build_mean_wind, turbulence_scales
from testbed.vehicle.jsbsim_adapter import airframe

SCHEMA = """testbed air 2: probes p of P at times k of T; SI units, angles in rad
names (P,), t (T,) s
wind_ned (P, T, 3) velocity of the air averaged over the wing: north, east, down
wind_gradient_rates (P, T, 3) rotation of the air about forward, right, down: dw/dy, -dw/dx, dv/dx
position_ned (P, T, 3) over the ground, from the origin of the scenario
mean_wind_ned (P, T, 3) the mean wind there, which is part of wind_ned
airspeed, course_rad (through the air, clockwise from north), height (above the ground)
span of the airframe; model of turbulence, its sigma (3,) and length (3,) at that height, or
those of the field: longitudinal, lateral, vertical; NaN where there is none
scenario: resolved, YAML"""


class ProbePath(NamedTuple):
    """Straight and level flight of the probes."""

    rate_hz: float
    duration_s: float
    airspeed: float  # m/s
    course: float  # rad, through the air, clockwise from north; also the heading
    height: float  # m above the ground of the origin
    separation: float | None  # m, of a second probe to the right of the first


class ProbeRecord(NamedTuple):
    """Wind at P probes and T times."""

    names: tuple[str, ...]  # P
    time: Array  # (T,) s
    wind_ned: Array  # (P, T, 3) m/s, velocity of the air, averaged over the wing
    wind_gradient_rates: Array  # (P, T, 3) rad/s, rotation of the air about forward, right, down
    position_ned: Array  # (P, T, 3) m, over the ground
    mean_wind_ned: Array  # (P, T, 3) m/s, the scenario's mean wind there
    span: float  # m, of the airframe
    sigma: Array  # (3,) m/s of the turbulence model: longitudinal, lateral, vertical
    length: Array  # (3,) m; both are NaN where there is none

    def about_mean(self, course: float) -> Array:
        """Return the wind minus its mean (P, T, 3) m/s: along a course (rad), right, down."""
        north, east, down = np.moveaxis(self.wind_ned - self.mean_wind_ned, -1, 0)
        cosine, sine = math.cos(course), math.sin(course)
        return np.stack([cosine * north + sine * east, cosine * east - sine * north, down], axis=-1)


def fly_probes(scenario: Scenario, path: ProbePath) -> ProbeRecord:
    """Fly one probe from the leader's start, or two side by side.

    Probes have the leader's airframe, and the turbulence of the leader and of the first follower.
    They drift with the mean wind, but not with gusts and turbulence.

    Raises:
        InputError: a recorded wind is shorter than the flight.
    """
    probes = 1 if path.separation is None else 2
    names = scenario.aircraft_names[:probes]
    frame = airframe(find_aircraft(scenario.leader.aircraft))
    dt = 1.0 / path.rate_hz
    mean_wind = build_mean_wind(
        scenario, duration_s=0.0
    )  # checked below against the probes' duration
    if not mean_wind.steady and mean_wind.end_s < path.duration_s:
        raise InputError(
            f"--duration {path.duration_s:g}: the recorded wind ends after "
            f"{mean_wind.end_s:g} s; write no more than that"
        )
    frames, no_wakes = [frame] * probes, [False] * probes
    air = build_air(scenario, mean_wind, names, frames, dt=dt, sheds=no_wakes)
    aircraft = allocate(AIRCRAFT, probes)
    truth, sample = aircraft["truth"], aircraft["wind"]
    air.bind(aircraft)
    count = round(path.duration_s * path.rate_hz)
    time = np.arange(count) / path.rate_hz
    wind, rates, positions, mean = np.empty((4, count, probes, 3))
    forward = np.array([math.cos(path.course), math.sin(path.course), 0.0])
    right = np.array([-forward[1], forward[0], 0.0])
    start = scenario.leader.start
    position = np.array([start.north_m, start.east_m, -path.height]) + np.outer(
        [0.0, path.separation or 0.0][:probes], right
    )
    truth["euler"] = [0.0, 0.0, path.course]
    truth["airspeed"] = truth["equivalent_airspeed"] = path.airspeed
    mean_before = mean_wind.velocity_ned(0.0, path.height)
    for k, now in enumerate(time.tolist()):
        mean_now = mean_wind.velocity_ned(now, path.height)
        if k:  # exact for a steady wind, and for one that is linear between its rows
            drift = 0.5 * (mean_before + mean_now) * [1.0, 1.0, 0.0]
            position = position + (path.airspeed * forward + drift) * dt
        truth["position_ned"] = position
        truth["velocity_ned"] = path.airspeed * forward + mean_now * [1.0, 1.0, 0.0]
        air.sample_wind(now)
        wind[k], rates[k] = sample["wind_ned"], sample["wind_gradient_rates"]
        positions[k], mean[k] = position, mean_now
        mean_before = mean_now
    sigma, length = np.full(3, np.nan), np.full(3, np.nan)
    scales_at = turbulence_scales(scenario)
    if air.field is not None:
        sigma, length = air.field.sigma, air.field.length
    elif scales_at is not None:
        sigma, length = scales_at(np.array(path.height))
    wind, rates, positions, mean = (
        np.ascontiguousarray(each.swapaxes(0, 1)) for each in (wind, rates, positions, mean)
    )
    return ProbeRecord(names, time, wind, rates, positions, mean, frame.span, sigma, length)


def to_arrays(scenario: Scenario, path: ProbePath, record: ProbeRecord) -> dict[str, Any]:
    """Return the arrays of an .npz file; `schema` describes them."""
    return {
        "schema": np.array(SCHEMA),
        "names": np.array(record.names),
        "t": record.time,
        "wind_ned": record.wind_ned,
        "wind_gradient_rates": record.wind_gradient_rates,
        "position_ned": record.position_ned,
        "mean_wind_ned": record.mean_wind_ned,
        "airspeed": np.array(path.airspeed),
        "course_rad": np.array(path.course),
        "height": np.array(path.height),
        "span": np.array(record.span),
        "model": np.array(scenario.air.turbulence.model),
        "sigma": record.sigma,
        "length": record.length,
        "scenario": np.array(dump(scenario)),
    }
