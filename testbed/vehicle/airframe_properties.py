"""Properties of an airframe in the air, measured on its flight model."""

from __future__ import annotations

import math

import numpy as np

from testbed.core.frames import FOOT
from testbed.core.records import Airframe
from testbed.vehicle.jsbsim_model import POUND, JsbsimModel
from testbed.vehicle.trim import STILL, Controls, Placement

_INCIDENCE = 0.02  # rad, far from the stall
_ALPHAS = np.radians(np.arange(0.0, 45.1, 0.1))  # searched for the stall


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
    )


def _lift(model: JsbsimModel, alpha: float) -> float:
    """Return lift divided by dynamic pressure at an angle of attack, ft²."""
    speed = 20.0
    velocity = (speed * math.cos(alpha), 0.0, speed * math.sin(alpha))
    neutral = Controls(0.0, 0.0, 0.0, 0.0)
    model.place(Placement(velocity, STILL, 0.0, alpha, 0.0), neutral, spin=False)
    # unlike its other forces, JSBSim's aerodynamic force has lift and drag positive
    force = model.node("forces/fwz-aero-lbs").get_double_value()
    return float(force) / float(model.node("aero/qbar-psf").get_double_value())
