"""Electric engines with propellers of fixed pitch."""

from __future__ import annotations

import math
from functools import partial

from testbed.compiled.elements import XmlNode
from testbed.compiled.functions import table_function
from testbed.compiled.source import StepSource, literal

_HP_WATTS, _HP_POWER = 745.7, 550.0  # W, ft lb/s
_DEFAULT_WATTS = 745.7
_NEWTON_METRES = 1.3558  # of a foot-pound, as JSBSim's motors have it


# Properties of an engine that files may read, beside its speed.
ENGINE_OUTPUTS = {
    "thrust-lbs": "thrust",
    "advance-ratio": "advance",
    "thrust-coefficient": "ct",
    "prop-induced-velocity_fps": "induced_velocity(inflow, thrust, rho, area)",
}


def engine_property(number: int, name: str) -> str:
    """Return a property of an engine, counted from 0."""
    return f"propulsion/engine{f'[{number}]' if number else ''}/{name}"


def throttle_property(number: int) -> str:
    """Return the throttle of an engine after the flight control."""
    return f"fcs/throttle-pos-norm{f'[{number}]' if number else ''}"


def propulsion(root: XmlNode, source: StepSource) -> None:
    """Write the engines, which add to `force` and `moment`, lb and lb ft in B."""
    parts = root.find("propulsion")
    engines = parts.all("engine") if parts else []
    for number, engine in enumerate(engines):
        source.attempt(engine, partial(_engine, engine, number, source))


def _engine(engine: XmlNode, number: int, source: StepSource) -> None:
    thruster = engine.child("thruster")
    # JSBSim applies a thruster's force at its own location, whatever that of the engine
    mounting = ("feed", "thruster", "location", "orient")
    kinds = [each for each in engine.children if each.tag not in mounting]
    propellers = thruster.all("propeller")
    if len(kinds) != 1 or len(propellers) != 1:
        engine.fail(f"has {len(kinds)} motors and {len(propellers)} propellers")
    motor, propeller = kinds[0], propellers[0]
    rpm = source.carry(engine_property(number, "propeller-rpm"))
    throttle = source.read(throttle_property(number), engine)
    emit = source.emit
    emit(f"# engine {number}: shaft power, ft lb/s")
    if motor.tag == "electric_engine":
        watts = motor.value("power", "WATTS", _DEFAULT_WATTS)
        gear = propeller.value("gearratio", default=1.0)
        emit(f"power = {literal(watts)} * {throttle} / {_HP_WATTS} * {_HP_POWER}")
        emit(f"if {rpm} * {literal(gear)} <= 0.1 and power < 0.0:")
        emit("    power = 0.0")
    elif motor.tag == "brushless_dc_motor":
        _brushless(motor, rpm, throttle, source)
    else:
        motor.fail("is not translated")
    _propeller(thruster, propeller, rpm, source)
    for name, value in ENGINE_OUTPUTS.items():
        source.provide(engine_property(number, name), value)


def _brushless(motor: XmlNode, rpm: str, throttle: str, source: StepSource) -> None:
    """Write a motor of constant Kv behind its resistance, with a current that turns nothing."""
    volts, kv, ohms, idle = (
        motor.value(each)
        for each in ("maxvolts", "velocityconstant", "coilresistance", "noloadcurrent")
    )
    torque = literal(60 / (2 * math.pi * _NEWTON_METRES))
    source.emit(
        f"current = ({literal(volts)} * {throttle} - {rpm} / {literal(kv)}) / {literal(ohms)}"
    )
    source.emit(f"torque = (current - {literal(idle)}) / {literal(kv)} * {torque}")
    turning = f"({rpm} if {rpm} > 0.0001 else 0.0001)"
    source.emit(f"power = ({literal(2 * math.pi)} * {turning} * torque) / 60.0")


def _propeller(thruster: XmlNode, propeller: XmlNode, rpm: str, source: StepSource) -> None:
    """Write thrust, torque and speed of a propeller of coefficients against V / (n D)."""
    pitches = [propeller.value(each, default=0.0) for each in ("minpitch", "maxpitch")]
    if pitches[0] != pitches[1]:
        propeller.fail("of variable pitch is not translated")
    x, y, z = thruster.child("location").vector("IN")
    diameter, ixx = propeller.value("diameter", "FT"), propeller.value("ixx", "SLUG*FT2")
    d4 = diameter * diameter * diameter * diameter
    sense = 1.0 if thruster.value("sense", default=1.0) >= 0.0 else -1.0
    # before version 1.1 of these files the gyroscopic moment had the other sign
    turn = -1.0 if propeller.attribute("version", 0.0) > 1.0 else 1.0
    tables = {}
    for each in propeller.all("table"):
        name = each.attributes.get("name", "")
        if name not in ("C_THRUST", "C_POWER"):
            each.fail(f"of {name} is not translated")
        tables[name] = table_function(each.child("tableData"), source)
    if len(tables) != 2:
        propeller.fail("has not two tables")
    ct, cp = (propeller.value(each, default=1.0) for each in ("ct_factor", "cp_factor"))
    d, two_pi = literal(diameter), literal(2.0 * math.pi)
    sense_text, ixx_text = literal(sense), literal(ixx)
    flow_at = "add(uvw_aero, cross(pqr, lever))"  # of the propeller, along the axes of the thruster
    axes = _axes(thruster.find("orient"))
    if axes is None:
        inflow = "uvw_aero[0] + (pqr[1] * lever[2] - pqr[2] * lever[1])"
        push, twist = "(thrust, 0.0, 0.0)", "(torque, 0.0, 0.0)"
        gyroscopic = "(0.0, rates[2] * spin, -(rates[1] * spin))"
    else:
        rows = [f"({', '.join(map(literal, each))})" for each in axes]
        flow_at = f"rotate(({', '.join(rows)}), {flow_at})"
        inflow = f"({flow_at})[0]"
        push, twist = f"scale(thrust, {rows[0]})", f"scale(torque, {rows[0]})"
        gyroscopic = f"cross(rates, scale(spin, {rows[0]}))"
    shift = ""
    if (factor := thruster.value("p_factor", default=0.0)) > 0.0001:
        point = f"({literal(x)}, {literal(y)}, {literal(z)})"
        shift = (
            f"across = {flow_at}\n"
            "through = inflow + induced_velocity(inflow, thrust, rho, area)\n"
            f"point = shift_thrust({point}, across, through, {literal(sense * factor)})\n"
            "lever = arm(cg, point)"
        )
    source.emit(
        f"""
area = {literal(0.25 * diameter * diameter * math.pi)}
lever = arm(cg, ({literal(x)}, {literal(y)}, {literal(z)}))
inflow = {inflow}
rps = {rpm} / 60.0
advance = inflow / ({d} * rps) if rps > 0.01 else inflow / {d}
slowest = 0.01 if rps < 0.01 else rps
cp = {tables["C_POWER"]("advance")} * {literal(cp)}
spare = power - cp * slowest * slowest * slowest * {literal(d4 * diameter)} * rho
ct = {tables["C_THRUST"]("advance")} * {literal(ct)}
thrust = ct * rps * rps * {literal(d4)} * rho
omega = rps * 2.0 * pi
torque = {literal(-sense)} * power / (omega if omega > 0.01 else 0.01)
spin = {ixx_text} * omega * {sense_text} * {literal(turn)}  # angular momentum, slug ft²/s
spare = spare / omega if omega > 0.01 else spare
{rpm} = (rps + ((spare / {ixx_text}) / {two_pi}) * dt) * 60.0
if {rpm} < 0.0:
    {rpm} = 0.0
{shift}
push = {push}
force = add(force, push)
moment_propeller = add(add({gyroscopic}, {twist}), cross(lever, push))
moment = add(moment, moment_propeller)
"""
    )


def _axes(orient: XmlNode | None) -> list[tuple[float, float, float]] | None:
    """Return the axes of a thruster (3 rows of 3) in B, or None where they are those of B."""
    if orient is None or not any(each.number for each in orient.children):
        return None
    roll, pitch, yaw = orient.vector("RAD", "roll", "pitch", "yaw")
    cr, cp, cy = math.cos(roll), math.cos(pitch), math.cos(yaw)
    sr, sp, sy = math.sin(roll), math.sin(pitch), math.sin(yaw)
    return [
        (cp * cy, cp * sy, -sp),
        (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
        (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
    ]
