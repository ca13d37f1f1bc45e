"""The aerodynamic forces and moments of an aircraft's own functions."""

from __future__ import annotations

from testbed.vehicle.compiled.elements import XmlNode
from testbed.vehicle.compiled.functions import expression
from testbed.vehicle.compiled.source import StepSource

_AXES = ("DRAG", "SIDE", "LIFT", "ROLL", "PITCH", "YAW")
_SIZES = {"aero/bi2vel": "metrics/bw-ft", "aero/ci2vel": "metrics/cbarw-ft"}


def aerodynamics(root: XmlNode, source: StepSource) -> None:
    """Write the functions, and `force_aero` and `moment_aero`, lb and lb ft in B.

    Functions outside of axes come before the scales of this frame's airspeed, so they have those of
    the frame before.
    """
    aero = root.child("aerodynamics")
    for function in aero.all("function"):
        if function.attributes.get("type", "pre") != "pre":
            function.fail(f"has the type {function.attributes['type']}")
        name = function.attributes.get("name") or function.fail("has no name")
        source.write(name, expression(function, source), function)
    for name, size in _SIZES.items():
        span, scale = source.read(size, aero), source.carry(name)
        source.emit(f"{scale} = {span} / (2.0 * vt) if vt + vt != 0.0 else {scale}")
    sums = {axis: _axis(aero, axis, source) for axis in _AXES}
    for axis in aero.all("axis"):
        if axis.attributes.get("name") not in _AXES:
            axis.fail(f"of {axis.attributes.get('name')} is not translated")
    point = ", ".join(source.read(f"metrics/aero-rp-{each}-in", aero) for each in "xyz")
    source.emit(
        f"""
force_wind = (-{sums["DRAG"]}, {sums["SIDE"]}, -{sums["LIFT"]})
force_aero = rotate(wind_axes(alpha, beta), force_wind)
lever = arm(cg, ({point}))
moment_aero = add(({sums["ROLL"]}, {sums["PITCH"]}, {sums["YAW"]}), cross(lever, force_aero))
"""
    )


def _axis(aero: XmlNode, name: str, source: StepSource) -> str:
    """Write the functions of an axis; return the variable of their sum."""
    total = source.assign("0.0")
    for axis in (each for each in aero.all("axis") if each.attributes.get("name") == name):
        for function in axis.all("function"):
            value = source.assign(expression(function, source))
            if function.attributes.get("name"):
                source.write(function.attributes["name"], value, function)
            source.emit(f"{total} += {value}")
    return total
