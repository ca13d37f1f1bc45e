"""The aerodynamic forces and moments of an aircraft's own functions."""

from __future__ import annotations

from functools import partial

from testbed.compiled.elements import XmlNode
from testbed.compiled.functions import expression
from testbed.compiled.source import StepSource, literal

STALL_HYSTERESIS = "aero/stall-hyst-norm"

# Sets of axes of a force, with the force in B by their sums.
_FORCES: dict[tuple[str, ...], str] = {
    ("DRAG", "SIDE", "LIFT"): "rotate(wind_axes(alpha, beta), (-{0}, {1}, -{2}))",
    ("AXIAL", "SIDE", "NORMAL"): "(-{0}, {1}, -{2})",
    ("X", "Y", "Z"): "({0}, {1}, {2})",
}
_LIFT, _LIFT_SQUARED = "forces/fwz-aero-lbs", "aero/cl-squared"
_MOMENTS = ("ROLL", "PITCH", "YAW")
_SIZES = {"aero/bi2vel": "metrics/bw-ft", "aero/ci2vel": "metrics/cbarw-ft"}


def aerodynamics(root: XmlNode, source: StepSource) -> None:
    """Write the functions, and `force_aero` and `moment_aero`, lb and lb ft in B.

    Functions outside of axes come before the scales of this frame's airspeed, so they have those of
    the frame before.
    """
    aero = root.child("aerodynamics")
    area = source.read("metrics/Sw-sqft", aero)
    uses_lift = reads_lift_squared(root)
    if uses_lift:  # with the lift of the frame before
        square, ratio = source.carry(_LIFT_SQUARED), f"{source.carry(_LIFT)} / ({area} * qbar)"
        source.emit(f"{square} = ({ratio}) * ({ratio}) if qbar > 1.0 else {square}")
    for function in aero.all("function"):
        source.attempt(function, partial(_function, function, source))
    for name, size in _SIZES.items():
        span, scale = source.read(size, aero), source.carry(name)
        source.emit(f"{scale} = {span} / (2.0 * vt) if vt + vt != 0.0 else {scale}")
    _stall_hysteresis(aero, source)
    source.provide("aero/qbar-area", f"{area} * qbar")
    forces = _force_axes(aero)
    sums = {axis: _axis(aero, axis, source) for axis in (*forces, *_MOMENTS)}
    force = _FORCES[forces].format(*(sums[axis] for axis in forces))
    point = ", ".join(source.read(f"metrics/aero-rp-{each}-in", aero) for each in "xyz")
    source.emit(
        f"""
force_aero = {force}
lever = arm(cg, ({point}))
moment_aero = add(({sums["ROLL"]}, {sums["PITCH"]}, {sums["YAW"]}), cross(lever, force_aero))
"""
    )
    if uses_lift:
        in_wind = "rotate_back(wind_axes(alpha, beta), force_aero)"
        source.emit(f"{source.variable(_LIFT)} = -{in_wind}[2]")


def _function(function: XmlNode, source: StepSource) -> None:
    """Write a function outside of axes."""
    if function.attributes.get("type", "pre") != "pre":
        function.fail(f"has the type {function.attributes['type']}")
    name = function.attributes.get("name") or function.fail("has no name")
    source.write(name, expression(function, source), function)


def _stall_hysteresis(aero: XmlNode, source: StepSource) -> None:
    """Write the state of a stall: 1 above an angle of attack, 0 below another, else unchanged."""
    limits = aero.find("hysteresis_limits")
    if limits is None:
        return
    factor = limits.factor("RAD")
    low, high = (limits.value(each) * factor for each in ("min", "max"))
    if low != 0.0 and high != 0.0:  # as JSBSim has it; otherwise they have no effect
        state = source.carry(STALL_HYSTERESIS)
        source.emit(
            f"{state} = 1.0 if alpha > {literal(high)} else "
            f"(0.0 if alpha < {literal(low)} else {state})"
        )


def reads_lift_squared(root: XmlNode) -> bool:
    """Return whether a file of the aircraft reads the square of the lift coefficient."""
    return any(each.word.removeprefix("-") == _LIFT_SQUARED for each in root.walk())


def _force_axes(aero: XmlNode) -> tuple[str, ...]:
    """Return the set of axes in which the aircraft has its forces."""
    for axes in _FORCES:
        others = [
            axis
            for axis in aero.all("axis")
            if axis.attributes.get("name", "").strip() not in (*axes, *_MOMENTS)
        ]
        if not others:
            names = [axis.attributes.get("name", "").strip() for axis in aero.all("axis")]
            for name, axis in zip(names, aero.all("axis"), strict=True):
                if names.count(name) > 1:
                    axis.fail(f"{name} occurs more than once")
            return axes
    return others[0].fail(f"{others[0].attributes.get('name')} with these others is not translated")


def _axis(aero: XmlNode, name: str, source: StepSource) -> str:
    """Write the functions of an axis; return the variable of their sum."""
    total = source.assign("0.0")
    axes = aero.all("axis")
    for axis in (each for each in axes if each.attributes.get("name", "").strip() == name):
        for function in axis.all("function"):
            source.attempt(function, partial(_add_function, total, function, source))
    return total


def _add_function(total: str, function: XmlNode, source: StepSource) -> None:
    value = source.assign(expression(function, source))
    if function.attributes.get("name"):
        source.write(function.attributes["name"], value, function)
    source.emit(f"{total} += {value}")
