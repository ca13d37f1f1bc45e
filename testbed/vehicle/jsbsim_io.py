"""Conversion of JSBSim's properties to and from records, in SI units and the testbed's signs.

Feet, revolutions per minute and JSBSim's signs (elevator positive nose down, rudder positive nose
left) occur only here and in `jsbsim_model`.
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import FOOT
from testbed.core.geodetic import LocalFrame, to_ned
from testbed.core.records import Array, BoolArray, Indices, Records, Values

# Properties of each aircraft, in the order of the fields of MOTION.
MOTION_PROPERTIES = (
    *(f"position/{each}" for each in ("lat-geod-rad", "long-gc-rad", "geod-alt-ft")),
    *(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down")),
    *(f"accelerations/{each}-ft_sec2" for each in ("udot", "vdot", "wdot")),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    *(f"velocities/{rate}-rad_sec" for rate in ("p", "q", "r")),
    *("velocities/vt-fps", "velocities/ve-fps"),
)
AIR_PROPERTIES = ("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm")
WIND, CONTROLS = range(2)  # inputs of flight models
_THROTTLE = 3  # column of `pack_surfaces`
# Of aircraft that have a battery.
BATTERY_PROPERTIES = ("battery/state-of-charge", "battery/voltage-v")


@entry
def write_truth(
    rows: Indices, numbers: Array, frame: Values, aircraft: Records, which: Indices
) -> None:
    """Write the motion of some aircraft.

    JSBSim's acceleration is that of u, v, w in the turning body: it becomes
    R_NB (d(u, v, w)/dt) + (R_NB ω) × velocity.

    Args:
        rows: (M,) of the flight models among the aircraft.
        numbers: (M, 17) values of MOTION_PROPERTIES.
        frame: fields of the origin's local frame, for RADIANS, as a plain tuple: numba takes
            1.5 µs longer to identify a named one.
        aircraft: (N,) of AIRCRAFT; `truth` is written.
        which: (K,) of the M flight models.
    """
    local = LocalFrame(*frame)
    for k in which:
        x, t = numbers[k], aircraft[rows[k]].truth
        north, east, down = to_ned(local, x[0], x[1], x[2] * FOOT)
        t.position_ned[0], t.position_ned[1], t.position_ned[2] = north, east, down
        for axis in range(3):
            t.velocity_ned[axis] = x[3 + axis] * FOOT
            t.acceleration_ned[axis] = x[6 + axis] * FOOT
            t.euler[axis] = x[9 + axis]
            t.rates_body[axis] = x[12 + axis]
        t.airspeed, t.equivalent_airspeed = x[15] * FOOT, x[16] * FOOT
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
    """Write the flow angles, propeller speed and battery state of the flight models.

    Args:
        rows: (M,) of the flight models among the aircraft.
        numbers: (M, 5) values of AIR_PROPERTIES and BATTERY_PROPERTIES.
        aircraft: (N,) of AIRCRAFT; `air` is written.
    """
    for k in range(len(rows)):
        x, air = numbers[k], aircraft[rows[k]].air
        air.alpha, air.beta, air.propeller_rps = x[0], x[1], x[2] / 60.0
        air.state_of_charge, air.battery_voltage = x[3], x[4]


@entry
def pack_wind(rows: Indices, aircraft: Records, numbers: Array, changed: BoolArray) -> None:
    """Write `wind` of the aircraft in these rows as numbers (M, 7) for JSBSim; set `changed`."""
    changed[WIND] = True
    for k in range(len(rows)):
        wind = aircraft[rows[k]].wind
        for axis in range(3):
            numbers[k, axis] = wind.wind_ned[axis] / FOOT
            numbers[k, 3 + axis] = wind.wind_gradient_rates[axis]
        numbers[k, 6] = wind.wake_delta_cl


@entry
def pack_surfaces(rows: Indices, aircraft: Records, numbers: Array, changed: BoolArray) -> None:
    """Write `surfaces` of the aircraft in these rows as numbers (M, 4); set `changed`."""
    changed[CONTROLS] = True
    for k in range(len(rows)):
        surfaces = aircraft[rows[k]].surfaces
        numbers[k, 0], numbers[k, 1] = surfaces.aileron, -surfaces.elevator
        numbers[k, 2], numbers[k, 3] = -surfaces.rudder, surfaces.throttle


@entry
def lead_controls(controls: Array, lead: Array, last: Array, first: Array, which: Indices) -> None:
    """Write the controls of the first frame after a change, so that they act on time.

    JSBSim evaluates accelerations at the end of a frame and integrates them in the next one: a
    control acts a frame late. The extrapolation of Adams-Bashforth methods makes a step act half a
    frame early. In the first frame a control goes half of its change too far, which makes up for
    the half frame that is left. At the end of that frame the accelerations contain this.

    Args:
        controls: (M, 4) of `pack_surfaces`, from now on.
        lead: (M, 4) share of a change that is added in the first frame, see `control_leads`.
        last: (M, 4) before the change; becomes `controls`.
        first: (M, 4) of the first frame; written. In it surfaces may exceed their travel: held to
            it, they would act late where they reach their stops, as at the entry of a corner.
        which: (K,) of the M flight models.
    """
    for k in which:
        for j in range(4):
            value = controls[k, j] + lead[k, j] * (controls[k, j] - last[k, j])
            first[k, j] = min(max(value, 0.0), 1.0) if j == _THROTTLE else value
            last[k, j] = controls[k, j]


def control_leads(share: float, *, surfaces_lag: bool) -> Array:
    """Return the shares (4,) of `lead_controls` for an aircraft.

    Args:
        share: of controls that act at once, and of the throttle.
        surfaces_lag: surfaces follow their commands with a lag, which begins in the same frame.
    """
    return np.array([0.0 if surfaces_lag else share] * _THROTTLE + [share])
