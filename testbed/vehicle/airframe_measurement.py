"""Traits, size, mass, lift and contact points of an aircraft, measured in JSBSim."""

from __future__ import annotations

import itertools
import math

import numpy as np

from testbed.core.frames import FOOT, GRAVITY
from testbed.core.records import Airframe, NedOrigin
from testbed.core.standard_atmosphere import SEA_LEVEL_DENSITY
from testbed.vehicle.jsbsim_model import POUND, JsbsimModel, Traits
from testbed.vehicle.trim import STILL, Controls, Placement

SLOWEST_PROBE = 20.0  # m/s, airspeed at which small aircraft are examined
CRUISE_LIFT = 0.4  # lift coefficient, at which larger ones are
_NO_EFFECT = 1e-6  # m/s², rad/s² and rad, above rounding
_CONVERGES = 0.1  # of the change before: more is a lag
_TILT = 1.0  # rad, of the attitudes in which contact points are found
_INCIDENCE = 0.02  # rad, far from the stall
_ALPHAS = np.radians(np.arange(0.0, 45.1, 0.1))  # searched for the stall


def find_probe_speed(model: JsbsimModel) -> float:
    """Return the airspeed at which an aircraft is examined, m/s: that of a lift coefficient of 0.4.

    It is 20 m/s for small aircraft that are slower.
    """
    model.locate((0.0, 0.0, -1000.0), NedOrigin())
    ahead = Placement((SLOWEST_PROBE, 0.0, 0.0), STILL, 0.0, 0.0, 0.0)
    model.place(ahead, Controls(0.0, 0.0, 0.0, 0.0), spin=False)
    weight = model.node("inertia/weight-lbs").get_double_value()
    area = model.node("metrics/Sw-sqft").get_double_value()
    density = model.node("atmosphere/rho-slugs_ft3").get_double_value()
    if not (0.0 < weight < math.inf and 0.0 < area < math.inf):
        return SLOWEST_PROBE  # refused by its sizes
    return max(SLOWEST_PROBE, FOOT * math.sqrt(2.0 * weight / (density * area * CRUISE_LIFT)))


def find_traits(model: JsbsimModel) -> Traits:
    """Find traits by commands in flight; `model` must assume rudder and lag."""
    model.probe_speed = find_probe_speed(model)
    ahead = Placement((model.probe_speed, 0.0, 0.0), STILL, 0.0, 0.0, 0.0)
    # at throttle 0 the propeller of a motor creeps without end; most piston engines stand there
    throttle = 0.0 if model.power.burns_fuel else 0.5
    neutral = Controls(0.0, 0.0, 0.0, throttle)
    model.locate((0.0, 0.0, -1000.0), NedOrigin())
    before = model.accelerations(ahead, neutral, spin=True)
    yawed = model.accelerations(ahead, Controls(0.0, 0.0, 0.5, throttle), spin=True)
    model.accelerations(ahead, neutral, spin=True)
    pulled = Controls(0.1, 0.1, 0.0, throttle)
    has_lag = _surfaces_lag(model, ahead, pulled)
    model.accelerations(ahead, neutral, spin=True)
    moved = model.accelerations_after_no_time(pulled)
    return Traits(
        probe_speed=model.probe_speed,
        has_engine=model.has_engine,
        lags_by_step=bool(np.max(np.abs(moved - before)) < _NO_EFFECT),
        has_rudder=bool(np.max(np.abs(yawed - before)) > _NO_EFFECT),
        has_lag=has_lag,
    )


def _surfaces_lag(model: JsbsimModel, placement: Placement, controls: Controls) -> bool:
    """Return whether surfaces follow commands with a lag, by three placements without `spin`.

    Forces that depend on the rate of the angle of attack change too, but by much less each time.
    """
    found, deflected = [], []
    for _ in range(3):
        found.append(model.accelerations(placement, controls, spin=False))
        deflected.append(model.deflections())
    first, second = (float(np.max(np.abs(b - a))) for a, b in itertools.pairwise(found))
    moved = max(float(np.max(np.abs(b - a))) for a, b in itertools.pairwise(deflected))
    return moved > _NO_EFFECT or second > max(_NO_EFFECT, _CONVERGES * first)


def cruise_airspeed(measured: Airframe) -> float:
    """Return the airspeed of a lift coefficient of 0.4 at sea level, m/s."""
    loading = measured.mass * GRAVITY / measured.area
    return math.sqrt(2.0 * loading / (SEA_LEVEL_DENSITY * CRUISE_LIFT))


def lift_slope(model: JsbsimModel) -> float:
    """Return the slope of the lift coefficient near an angle of attack of 0, 1/rad."""
    low, high = (_lift(model, alpha) for alpha in (0.0, _INCIDENCE))
    area = float(model.node("metrics/Sw-sqft").get_double_value())
    return (high - low) / _INCIDENCE / area


def measured_airframe(model: JsbsimModel) -> Airframe:
    """Measure wing size, mass with fuel, lift slope and stall angle.

    The wind is sampled ahead of and behind the centre of gravity at the distance of the tail, or of
    half a chord without a tail. The stall angle has the largest lift with neutral controls.
    """
    size = {
        name: model.node(f"metrics/{key}").get_double_value()
        for name, key in (("area", "Sw-sqft"), ("span", "bw-ft"), ("tail", "lh-ft"))
    }
    chord = model.node("metrics/cbarw-ft").get_double_value()
    low, high = (_lift(model, alpha) for alpha in (0.0, _INCIDENCE))  # also initialises the fuel
    mass = model.node("inertia/mass-slugs").get_double_value()
    lifts = [_lift(model, alpha) for alpha in _ALPHAS]
    largest = int(np.argmax(lifts))
    return Airframe(
        span=size["span"] * FOOT,
        area=size["area"] * FOOT**2,
        arm=(size["tail"] or 0.5 * chord) * FOOT,
        mass=mass * POUND / FOOT,
        lift_slope=(high - low) / _INCIDENCE / size["area"],
        stall_angle=math.inf if largest == len(lifts) - 1 else float(_ALPHAS[largest]),
        contact_radius=_contact_radius(model),
    )


def _contact_radius(model: JsbsimModel) -> float:
    """Return the distance of the farthest contact point from the centre of gravity, m.

    JSBSim tells the heights of its contact points: their distances below the centre of gravity in
    three attitudes are those along the axes of the body.
    """
    points = range(int(model.node("gear/num-units").get_double_value()))
    heights = [
        model.find(f"gear/unit[{k}]/AGL-ft") or model.node(f"contact/unit[{k}]/AGL-ft")
        for k in points
    ]
    below = []
    for roll, pitch in ((0.0, 0.0), (0.0, _TILT), (_TILT, 0.0)):
        placement = Placement((model.probe_speed, 0.0, 0.0), STILL, roll, pitch, 0.0)
        model.place(placement, Controls(0.0, 0.0, 0.0, 0.0), spin=False)
        centre = model.node("position/h-agl-ft").get_double_value()
        below.append([centre - each.get_double_value() for each in heights])
    z, pitched, rolled = np.array(below).reshape(3, -1) * FOOT
    x = (z * math.cos(_TILT) - pitched) / math.sin(_TILT)
    y = (rolled - z * math.cos(_TILT)) / math.sin(_TILT)
    return float(np.max(np.sqrt(x * x + y * y + z * z), initial=0.0))


def _lift(model: JsbsimModel, alpha: float) -> float:
    """Return lift divided by dynamic pressure at an angle of attack, ft²."""
    speed = model.probe_speed
    velocity = (speed * math.cos(alpha), 0.0, speed * math.sin(alpha))
    neutral = Controls(0.0, 0.0, 0.0, 0.0)
    model.place(Placement(velocity, STILL, 0.0, alpha, 0.0), neutral, spin=False)
    # unlike its other forces, JSBSim's aerodynamic force has lift and drag positive
    force = model.node("forces/fwz-aero-lbs").get_double_value()
    return float(force) / float(model.node("aero/qbar-psf").get_double_value())
