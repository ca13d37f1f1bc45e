"""Conversion of JSBSim's properties to and from records, in SI units and the testbed's signs.

Feet, revolutions per minute and JSBSim's signs (elevator positive nose down, rudder positive nose
left) occur only here and in `jsbsim_model`.
"""

from __future__ import annotations

from math import cos, pi, sin

from testbed.core.compile import entry, kernel
from testbed.core.frames import FOOT
from testbed.core.records import Array, Indices, Records, Values

# Properties of each aircraft, in the order of the fields of MOTION.
MOTION_PROPERTIES = (
    *(f"position/{each}" for each in ("lat-geod-rad", "long-gc-rad", "geod-alt-ft")),
    *(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down")),
    *(f"accelerations/{each}-ft_sec2" for each in ("udot", "vdot", "wdot")),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    *(f"velocities/{rate}-rad_sec" for rate in ("p", "q", "r")),
    *("velocities/vt-fps", "velocities/ve-fps"),
)
AIR_PROPERTIES = (
    *(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down")),
    *("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm"),
)
# Of aircraft that have a battery.
BATTERY_PROPERTIES = ("battery/state-of-charge", "battery/voltage-v")


@entry
def write_truth(
    which: Indices, rows: Indices, numbers: Array, zero: Array, scale: Array, aircraft: Records
) -> None:
    """Write the motion of some aircraft, (numbers − zero) scale.

    JSBSim's acceleration is that of u, v, w in the turning body: it becomes
    R_NB (d(u, v, w)/dt) + (R_NB ω) × velocity.

    Args:
        which: (K,) of the M flight models.
        rows: (M,) of the flight models among the aircraft.
        numbers: (M, 17) values of MOTION_PROPERTIES.
        zero: (17,)
        scale: (17,)
        aircraft: (N,) of AIRCRAFT; `truth` is written.
    """
    for k in which:
        x, t = numbers[k], aircraft[rows[k]].truth
        for axis in range(3):
            t.position_ned[axis] = (x[axis] - zero[axis]) * scale[axis]
            t.velocity_ned[axis] = (x[3 + axis] - zero[3 + axis]) * scale[3 + axis]
            t.acceleration_ned[axis] = (x[6 + axis] - zero[6 + axis]) * scale[6 + axis]
            t.euler[axis] = (x[9 + axis] - zero[9 + axis]) * scale[9 + axis]
            t.rates_body[axis] = (x[12 + axis] - zero[12 + axis]) * scale[12 + axis]
        t.airspeed = (x[15] - zero[15]) * scale[15]
        t.equivalent_airspeed = (x[16] - zero[16]) * scale[16]
        if t.euler[2] > pi:
            t.euler[2] -= 2.0 * pi
        phi, theta, psi = t.euler[0], t.euler[1], t.euler[2]
        angles = sin(phi), cos(phi), sin(theta), cos(theta), sin(psi), cos(psi)
        v, a, w = t.velocity_ned, t.acceleration_ned, t.rates_body
        ax, ay, az = _to_ned(angles, a[0], a[1], a[2])
        p, q, r = _to_ned(angles, w[0], w[1], w[2])
        a[0] = ax + q * v[2] - r * v[1]
        a[1] = ay + r * v[0] - p * v[2]
        a[2] = az + p * v[1] - q * v[0]


@kernel
def _to_ned(angles: Values, x: float, y: float, z: float) -> Values:
    """Rotate a body vector into NED by three plane rotations."""
    sf, cf, st, ct, sp, cp = angles
    across, below = cf * y - sf * z, sf * y + cf * z
    ahead = ct * x + st * below
    return cp * ahead - sp * across, sp * ahead + cp * across, ct * below - st * x


@entry
def write_air(rows: Indices, numbers: Array, aircraft: Records) -> None:
    """Write the air data, propeller speed and battery state of the flight models.

    Args:
        rows: (M,) of the flight models among the aircraft.
        numbers: (M, 8) values of AIR_PROPERTIES and BATTERY_PROPERTIES.
        aircraft: (N,) of AIRCRAFT; `air` is written.
    """
    for k in range(len(rows)):
        x, air, wind = numbers[k], aircraft[rows[k]].air, aircraft[rows[k]].wind
        for axis in range(3):
            air.wind_ned[axis] = x[axis] * FOOT
            air.wind_gradient_rates[axis] = wind.wind_gradient_rates[axis]
        air.wake_delta_cl = wind.wake_delta_cl
        air.alpha, air.beta, air.propeller_rps = x[3], x[4], x[5] / 60.0
        air.state_of_charge, air.battery_voltage = x[6], x[7]


@entry
def pack_wind(rows: Indices, aircraft: Records, numbers: Array) -> None:
    """Write `wind` of the aircraft in these rows as numbers (M, 7) for JSBSim."""
    for k in range(len(rows)):
        wind = aircraft[rows[k]].wind
        for axis in range(3):
            numbers[k, axis] = wind.wind_ned[axis] / FOOT
            numbers[k, 3 + axis] = wind.wind_gradient_rates[axis]
        numbers[k, 6] = wind.wake_delta_cl


@entry
def pack_surfaces(rows: Indices, aircraft: Records, numbers: Array) -> None:
    """Write `surfaces` of the aircraft in these rows as numbers (M, 4) for JSBSim."""
    for k in range(len(rows)):
        surfaces = aircraft[rows[k]].surfaces
        numbers[k, 0], numbers[k, 1] = surfaces.aileron, -surfaces.elevator
        numbers[k, 2], numbers[k, 3] = -surfaces.rudder, surfaces.throttle
