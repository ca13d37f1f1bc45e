"""Kernels of the atmosphere for many points or aircraft at once."""

from typing import NamedTuple

import numpy as np

from reference.interpreted import interpreted
from testbed.atmosphere import dryden, wake
from testbed.atmosphere.airframe_wind import LOCAL_WIND, write_sample_points
from testbed.atmosphere.airframe_wind import mean_and_gradient as _mean_and_gradient
from testbed.atmosphere.gusts import gust_factor, write_active_gusts
from testbed.atmosphere.mean_wind import make_mean_wind
from testbed.atmosphere.turbulence_field import sample_field as _sample_field
from testbed.core.compile import entry
from testbed.core.frames import rotation_rows
from testbed.core.records import AIRCRAFT, allocate

# ------------------------------------------------------------------------------ mean wind, gusts


def profile_factor(profile, heights):
    """Part (...,) of the speed at heights (...,) m."""
    wind = make_mean_wind(np.zeros(1), np.array([[1.0, 1.0, 0.0]]), profile=profile)
    return mean_velocity(wind, 0.0, heights)[..., 0]


def mean_velocity(wind, time, heights):
    """Velocity (..., 3) m/s at a time, s, and heights (...,) m."""
    found = [wind.velocity_ned(time, height) for height in np.ravel(heights).tolist()]
    return np.array(found).reshape(*np.shape(heights), 3)


@entry
def _add_gusts(gusts, time, points, displacement, out):
    for k in range(len(points)):
        for g in range(len(gusts)):
            part = gust_factor(gusts[g], time, displacement, points[k])
            for axis in range(3):
                out[k, axis] += part * gusts[g].velocity[axis]


def gust_velocity(gusts, time, points, displacement):
    """Velocity (..., 3) m/s of all gusts at points (..., 3) m NED."""
    points = np.asarray(points, dtype=float)
    out = np.zeros((points.size // 3, 3))
    _add_gusts(gusts, time, points.reshape(-1, 3), displacement, out)
    return out.reshape(points.shape)


def active_gusts(gusts, wind, time, position):
    """Which gust reaches which of N aircraft at (N, 3) m: (G, N)."""
    aircraft = allocate(AIRCRAFT, len(position))
    aircraft["truth"]["position_ned"] = position
    out = np.zeros((len(gusts), len(position)), dtype=bool)
    write_active_gusts(gusts, wind.rows, wind.profile, aircraft, time, out)
    return out


# --------------------------------------------------------------------------- airframes, the field


@interpreted
def _sample_points(position, euler, body, out):
    for i in range(len(position)):
        write_sample_points(position[i], rotation_rows(euler[i]), body[i], out[i])


def sample_points(position, euler, body):
    """The points (N, 5, 3) NED, m, of airframes at positions (N, 3) with attitudes (N, 3)."""
    out = np.empty(body.shape)
    _sample_points(position, euler, body, out)
    return out


@interpreted
def _gradients(air, euler, body, average, rates):
    for i in range(len(air)):
        rotation = rotation_rows(euler[i])
        _mean_and_gradient(air[i], rotation, body[i], average[i], rates[i])


def mean_and_gradient(air, euler, body):
    """Average (N, 3) NED and rates about body axes (N, 3) of a wind at the points (N, 5, 3)."""
    average, rates = np.empty((2, len(air), 3))
    _gradients(air, euler, body, average, rates)
    return average, rates


@entry
def _field(values, levels, centre, points, out):
    for i in range(len(centre)):
        _sample_field(values, levels, centre[i], points[i], out[i])


def sample_field(grid, centre, points):
    """Velocities (N, K, 3) of the air, m/s NED, at K points of each of N airframes."""
    out = np.empty(points.shape)
    _field(*grid, np.ascontiguousarray(centre), np.ascontiguousarray(points), out)
    return out


# ----------------------------------------------------------------------------------- turbulence


class Filters(NamedTuple):
    """One step of N aircraft through M Dryden fields. Axes: 0 lateral with r, 1 vertical with q."""

    decay: np.ndarray  # (N, M + 1) of M longitudinal states and that of p
    noise: np.ndarray  # (N, M + 1)
    gain: np.ndarray  # (N, M + 1) m/s, rad/s
    transition: np.ndarray  # (N, 2, M, 3, 3)
    root: np.ndarray  # (N, 2, M, 3, 3) lower triangular, root rootᵀ = 1 − transition transitionᵀ
    speed: np.ndarray  # (N, 2, M, 2) m/s per state
    rate: np.ndarray  # (N, 2, M, 3) rad/s per state


def filter_records(spectrum, distance, sigma, length, span):
    """FIRST_ORDER (N, M + 1) and THIRD_ORDER (N, 2, M) of N aircraft for one step."""
    mixture = np.stack(dryden.MIXTURES[spectrum])
    n, parts = len(distance), mixture.shape[1]
    first_order = allocate(dryden.FIRST_ORDER, n, parts + 1)
    third_order = allocate(dryden.THIRD_ORDER, n, 2, parts)
    args = (np.array(each, dtype=float) for each in (distance, sigma, length, span))
    for each in zip(*args, first_order, third_order, strict=True):
        dryden.write_filters(mixture, *each)
    return first_order, third_order


def make_filters(spectrum, distance, sigma, length, span):
    """The filters of N aircraft for one step, as arrays."""
    first_order, third_order = filter_records(spectrum, distance, sigma, length, span)
    return Filters(
        *(np.array(first_order[name]) for name in ("decay", "noise", "gain")),
        *(np.array(third_order[name]) for name in ("transition", "root", "speed", "rate")),
    )


def turbulence_axes(height, velocity_through_air_ned, euler):
    """The matrices (N, 3, 3) that take turbulence from its axes to NED."""
    north, east, _ = np.transpose(velocity_through_air_ned)
    agents = zip(height, north, east, euler, strict=True)
    return np.array([dryden.turbulence_axes(*each) for each in agents])


# ---------------------------------------------------------------------------------------- wakes


def horseshoe(at, half_span, core):
    """Velocity (..., 3) m/s of a horseshoe vortex of unit circulation, forward, right and down."""
    args = np.broadcast_arrays(half_span, core, *np.moveaxis(np.asarray(at, dtype=float), -1, 0))
    strength = 1.0 / (4.0 * np.pi)
    columns = zip(*(each.ravel().tolist() for each in args), strict=True)
    found = [wake.horseshoe(strength, *each) for each in columns]
    return np.array(found).reshape(*args[0].shape, 3)


def wake_delta_cl(downwash, airspeed, roll_gain):
    """Rolling-moment coefficient, right wing down, of a downwash (M,) m/s at the stations."""
    flow = np.zeros((3, len(downwash)))
    flow[2] = downwash
    moment = wake.add_moment(0.0, 1.0, flow, (0.0, 0.0, 1.0))
    return wake.wake_delta_cl(float(roll_gain), moment, float(airspeed))


def trail_crossing(model, trail, place):
    """Where a trail of a wake model passes a place (3,) m."""
    return wake.trail_crossing(model.wake[0], model.trails[trail], tuple(map(float, place)))


def add_wakes(model, position, velocity, acceleration, euler, ambient):
    """Wind (N, 3) and rolling-moment coefficient (N,) of a wake model's next step."""
    aircraft = allocate(AIRCRAFT, len(position))
    local = allocate(LOCAL_WIND, len(position))
    truth = aircraft["truth"]
    truth["position_ned"], truth["velocity_ned"] = position, velocity
    truth["acceleration_ned"], truth["euler"] = acceleration, euler
    local["ambient_wind"] = ambient
    model.bind(aircraft, local)(0.0)
    wind = aircraft["wind"]
    return np.array(wind["wind_ned"]), np.array(wind["wake_delta_cl"])
