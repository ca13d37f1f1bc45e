"""Probes that fly straight and level through a scenario's air and write down what they feel."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from testbed.errors import InputError
from testbed.scenario import Scenario, dump, find_aircraft
from testbed.sim.airs import make_air, make_mean, scales
from testbed.state import Array, VehicleState
from testbed.steady import Steady
from testbed.vehicle.jsbsim_door import airframe

SCHEMA = """testbed air 1: probes p of P at times k of T; SI units, angles in rad
names (P,), t (T,) s
wind_ned (P, T, 3) velocity of the air averaged over the wing: north, east, down
rates_body (P, T, 3) turn of the air about forward, right, down: dw/dy, -dw/dx, dv/dx
position_ned (P, T, 3) over the ground, from the origin of the scenario
mean_wind_ned (P, T, 3) the mean wind there, which is part of wind_ned
airspeed, course_rad (through the air, clockwise from north), height (above the ground)
span of the airframe; model of turbulence, its sigma (3,) and length (3,) at that height, or
the field's own: longitudinal, lateral, vertical; not numbers where there is none
scenario: the page as resolved, YAML"""


class Course(NamedTuple):
    """What the probes fly."""

    rate_hz: float
    duration_s: float
    airspeed: float  # m/s
    course: float  # rad, through the air: also where their noses point
    height: float  # m above the origin's ground
    separation: float | None  # m, how far a second probe flies to the right of the first


class Felt(NamedTuple):
    """What P probes felt at T times."""

    names: tuple[str, ...]  # P
    time: Array  # (T,) s
    wind_ned: Array  # (P, T, 3) m/s, velocity of the air, averaged over the wing
    rates_body: Array  # (P, T, 3) rad/s, its turn about forward, right, down
    position_ned: Array  # (P, T, 3) m, over the ground
    mean_wind_ned: Array  # (P, T, 3) m/s, the page's mean wind there
    span: float  # m, of the airframe
    sigma: Array  # (3,) m/s of the model of turbulence: longitudinal, lateral, vertical
    length: Array  # (3,) m; both not numbers where there is none

    def about_mean(self, course: float) -> Array:
        """The wind less its mean (P, T, 3) m/s: forward along a course in rad, right, down."""
        north, east, down = np.moveaxis(self.wind_ned - self.mean_wind_ned, -1, 0)
        cosine, sine = math.cos(course), math.sin(course)
        return np.stack([cosine * north + sine * east, cosine * east - sine * north, down], axis=-1)


def fly_probes(page: Scenario, flown: Course) -> Felt:
    """Fly one probe from the leader's start, or two abreast, at a height of their own.

    Probes have the leader's airframe; their turbulence is that of the leader and of the first
    follower. The mean wind carries them along; gusts and turbulence do not.
    """
    probes = 1 if flown.separation is None else 2
    names = page.aircraft_names[:probes]
    frame = airframe(find_aircraft(page.leader.aircraft))
    dt = 1.0 / flown.rate_hz
    mean_wind = make_mean(page, duration_s=0.0)  # it has to last as long as the probes fly
    if not mean_wind.steady and mean_wind.time[-1] < flown.duration_s:
        raise InputError(
            f"--duration {flown.duration_s:g}: the recorded wind ends after "
            f"{mean_wind.time[-1]:g} s; write no more than that"
        )
    # probes are alone: nobody sheds a wake
    air = make_air(page, mean_wind, names, [frame] * probes, dt=dt, sheds=[False] * probes)
    count = round(flown.duration_s * flown.rate_hz)
    time = np.arange(count) / flown.rate_hz
    wind, rates, places, mean = np.empty((4, count, probes, 3))
    ahead = np.array([math.cos(flown.course), math.sin(flown.course), 0.0])
    right = np.array([-ahead[1], ahead[0], 0.0])
    start = page.leader.start
    position = np.array([start.north_m, start.east_m, -flown.height]) + np.outer(
        [0.0, flown.separation or 0.0][:probes], right
    )
    height = np.full(probes, flown.height)
    level = np.tile([0.0, 0.0, flown.course], (probes, 1))
    still, fast = np.zeros((probes, 3)), np.full(probes, flown.airspeed)
    before, steady = mean_wind.velocity_ned(0.0, height), Steady()
    for k, now in enumerate(time.tolist()):
        blowing = mean_wind.velocity_ned(now, height)
        if k:  # exact for a wind that is steady, or linear between its rows
            over_ground = flown.airspeed * ahead + 0.5 * (before + blowing) * [1.0, 1.0, 0.0]
            position = position + over_ground * dt
        velocity = flown.airspeed * ahead + blowing * [1.0, 1.0, 0.0]
        moved = VehicleState(position, velocity, still, level, still, fast, fast)
        felt = air.felt(now, steady(moved))
        wind[k], rates[k] = felt.wind_ned, felt.rates_body
        places[k], mean[k] = position, blowing
        before = blowing
    sigma, length = np.full(3, np.nan), np.full(3, np.nan)
    known = scales(page)
    if air.field is not None:
        sigma, length = air.field.sigma, air.field.length
    elif known is not None:
        sigma, length = known(np.array(flown.height))
    wind, rates, places, mean = (
        np.ascontiguousarray(each.swapaxes(0, 1)) for each in (wind, rates, places, mean)
    )
    return Felt(names, time, wind, rates, places, mean, frame.span, sigma, length)


def to_arrays(page: Scenario, flown: Course, felt: Felt) -> dict[str, Any]:
    """What a file of it holds; `schema` says what is what."""
    return {
        "schema": np.array(SCHEMA),
        "names": np.array(felt.names),
        "t": felt.time,
        "wind_ned": felt.wind_ned,
        "rates_body": felt.rates_body,
        "position_ned": felt.position_ned,
        "mean_wind_ned": felt.mean_wind_ned,
        "airspeed": np.array(flown.airspeed),
        "course_rad": np.array(flown.course),
        "height": np.array(flown.height),
        "span": np.array(felt.span),
        "model": np.array(page.air.turbulence.model),
        "sigma": felt.sigma,
        "length": felt.length,
        "scenario": np.array(dump(page)),
    }
