"""What the air has to know of an aircraft, measured on its flight model."""

from __future__ import annotations

import math

import numpy as np

from testbed.frames import FOOT
from testbed.state import Airframe
from testbed.vehicle.jsbsim_model import POUND, JsbsimModel
from testbed.vehicle.trim import STILL, Controls, Placement

_INCIDENCE = 0.02  # rad, far from the stall
_STALLS = np.radians(np.arange(0.0, 45.1, 0.1))  # where the stall is looked for


def measured_airframe(model: JsbsimModel) -> Airframe:
    """The sizes of the wing, the mass as fuelled, and how the lift grows and where it ends.

    The air is felt as far ahead of and behind the centre of gravity as the tail is long, or half a
    chord where there is no tail. The stall is where the lift is largest with everything neutral.
    """
    size = {
        name: model.node(f"metrics/{key}").get_double_value()
        for name, key in (("area", "Sw-sqft"), ("span", "bw-ft"), ("tail", "lh-ft"))
    }
    chord = model.node("metrics/cbarw-ft").get_double_value()
    low, high = (_lift(model, alpha) for alpha in (0.0, _INCIDENCE))  # puts what is in the tanks
    mass = model.node("inertia/mass-slugs").get_double_value()
    lifts = [_lift(model, alpha) for alpha in _STALLS]
    most = int(np.argmax(lifts))
    return Airframe(
        span=size["span"] * FOOT,
        area=size["area"] * FOOT**2,
        arm=(size["tail"] or 0.5 * chord) * FOOT,
        mass=mass * POUND / FOOT,
        lift_slope=(high - low) / _INCIDENCE / size["area"],
        stall_angle=math.inf if most == len(lifts) - 1 else float(_STALLS[most]),
    )


def _lift(model: JsbsimModel, alpha: float) -> float:
    """Lift over dynamic pressure at an angle of attack, ft²."""
    speed = 20.0
    velocity = (speed * math.cos(alpha), 0.0, speed * math.sin(alpha))
    neutral = Controls(0.0, 0.0, 0.0, 0.0)
    model.place(Placement(velocity, STILL, 0.0, alpha, 0.0), neutral, spin=False)
    # for the aerodynamic force JSBSim counts drag and lift positive, unlike its other forces
    force = model.node("forces/fwz-aero-lbs").get_double_value()
    return float(force) / float(model.node("aero/qbar-psf").get_double_value())
