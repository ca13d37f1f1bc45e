"""JSBSim's flight-model files as one table: elements, files they name, properties they write.

The table has what JSBSim 1.3.3 reads from an aircraft and what stays within its flight model. What
is not in it is refused by `airframe_validation` before JSBSim reads the file.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import NamedTuple


class Text(Enum):
    """Meaning of the text of an element."""

    NONE = "none"  # its children only
    PROSE = "prose"  # JSBSim ignores it, with everything below it
    VALUE = "value"  # a number, a word, a table, or properties that are read
    POSITIVE = "greater than 0"
    NOT_NEGATIVE = "0 or more"
    WRITES = "writes"  # the name of a property that is set


class Name(Enum):
    """Meaning of the attribute `name` of an element."""

    WORD = ""  # for people, or one of JSBSim's words
    PROPERTY = "{}"  # the property with the element's value
    CONTROL = "fcs/{}"  # as PROPERTY; without a slash it is in fcs/
    REACTION = "external_reactions/{}"  # the group of the properties of a force or moment


class Element(NamedTuple):
    """A row of the table.

    Args:
        children: names of the elements that may be in it, separated by blanks; `name:row` is an
            element whose row has another name. One without a row has text only, a VALUE.
        attributes: names of its attributes beside `name` and `unit`, separated by blanks.
        text: meaning of its text.
        name: meaning of its attribute `name`.
        folders: where JSBSim looks for the file of its attribute `file`, and of which kind the
            file is; empty: there is no such attribute.
        kinds: root elements of that file; empty: the element's own name.
        not_translated: names of those children and attributes that `compiled` does not translate;
            None: it does not translate the element. JSBSim flies an aircraft that has one of them.
    """

    children: str = ""
    attributes: str = ""
    text: Text = Text.NONE
    name: Name = Name.WORD
    folders: tuple[str, ...] = ()
    kinds: str = ""
    not_translated: str | None = None


MAIN = "fdm_config"
ENGINES = (
    "electric_engine brushless_dc_motor piston_engine turbine_engine turboprop_engine rocket_engine"
)
THRUSTERS = "propeller nozzle rotor direct"

_HERE = (".",)
_PROPULSION = ("Engines", "engines", "Engine", "engine")  # JSBSim does not look beside the aircraft
_SYSTEMS = (".", "Systems", "systems")

_RANDOM = "random urandom"
_TEXT = "documentation description limitation note reference"
_OPERATIONS = (
    "sum difference product quotient pow sqrt toradians todegrees exp log2 ln log10 abs sign sin "
    "cos tan asin acos atan atan2 min max avg fraction integer floor ceil fmod roundmultiple mod "
    f"{_RANDOM} pi rotation_alpha_local rotation_beta_local rotation_gamma_local "
    "rotation_bf_to_wf rotation_wf_to_bf lt le gt ge eq nq and or not ifthen switch interpolate1d"
)
_ARGUMENTS = f"property p value v table t {_OPERATIONS} {_TEXT}"
_MODEL = f"property:set function {_TEXT}"
_FILTERS = "lag_filter lead_lag_filter washout_filter second_order_filter integrator"
_SENSORS = "sensor accelerometer gyro magnetometer"
_COMPONENTS = (
    f"{_FILTERS} {_SENSORS} summer deadband pure_gain scheduled_gain aerosurface_scale "
    "switch:selector "
    "kinematic fcs_function pid actuator linear_actuator angle waypoint_heading waypoint_distance "
    "distributor"
)
_COMPONENT = f"input init output clipto delay {_TEXT}"
_SENSOR = (
    f"{_COMPONENT} lag noise quantization drift_rate bias gain axis:sensed location orientation"
)
_ENGINE = f"{_MODEL} table location orient feed thruster"
_MOUNTING = "property function table location orient feed thruster"
_CELL = (
    f"location x_radius y_radius z_radius x_width y_width z_width radius width max_overpressure "
    f"valve_coefficient fullness heat blower_input {_TEXT}"
)
_WAYPOINT = f"{_COMPONENT} source_latitude source_longitude target_latitude target_longitude radius"

_ROWS = {
    # the aircraft, and texts for people
    MAIN: Element(
        "fileheader metrics mass_balance ground_reactions external_reactions buoyant_forces "
        f"propulsion system autopilot flight_control aerodynamics {_TEXT}",
        "version release",
        not_translated="external_reactions buoyant_forces",
    ),
    f"fileheader {_TEXT}": Element(text=Text.PROSE),
    # sizes and masses
    "metrics": Element(
        "wingarea wingspan chord wing_incidence htailarea htailarm vtailarea vtailarm location "
        f"{_MODEL}",
        folders=_HERE,
        not_translated="property function",
    ),
    "wingarea wingspan chord": Element(text=Text.POSITIVE, not_translated=""),
    "htailarea vtailarea": Element(text=Text.NOT_NEGATIVE, not_translated=""),
    "location drain_location direction": Element(f"x y z {_TEXT}", not_translated=""),
    "orient orientation": Element(f"roll pitch yaw {_TEXT}", not_translated=""),
    "mass_balance": Element(
        f"ixx iyy izz ixy ixz iyz emptywt location pointmass {_MODEL}",
        "negated_crossproduct_inertia",
        folders=_HERE,
        not_translated="property function",
    ),
    "emptywt ixx iyy izz": Element(text=Text.POSITIVE, not_translated=""),
    "pointmass": Element(
        f"weight location form ixx:own iyy:own izz:own ixy ixz iyz {_TEXT}", not_translated=""
    ),
    "own": Element(text=Text.NOT_NEGATIVE, not_translated=""),
    "weight": Element(text=Text.NOT_NEGATIVE, not_translated=""),
    "form": Element(f"radius length {_TEXT}", "shape", not_translated=""),
    "radius length": Element(text=Text.NOT_NEGATIVE, not_translated=""),
    # ground and other forces
    "ground_reactions": Element(
        f"contact {_MODEL}", folders=_HERE, not_translated="property function"
    ),
    "contact": Element(
        "location orientation static_friction dynamic_friction rolling_friction spring_coeff "
        "damping_coeff damping_coeff_rebound max_steer castered brake_group retractable "
        f"strut_force table {_TEXT}",
        "type",
        not_translated="strut_force table",
    ),
    "damping_coeff damping_coeff_rebound": Element(
        attributes="type", text=Text.VALUE, not_translated=""
    ),
    "strut_force": Element(f"function {_TEXT}"),
    "external_reactions": Element(f"force moment {_MODEL}", folders=_HERE),
    "force moment": Element(f"location direction function {_TEXT}", "frame", name=Name.REACTION),
    "buoyant_forces": Element(f"gas_cell {_MODEL}", folders=_HERE),
    "gas_cell": Element(f"ballonet {_CELL}", "type"),
    "ballonet": Element(_CELL, "type"),
    "heat blower_input": Element(f"function {_TEXT}"),
    # propulsion
    "propulsion": Element(
        f"engine tank dump-rate refuel-rate {_MODEL}",
        folders=_PROPULSION,
        not_translated="dump-rate refuel-rate property function",
    ),
    "dump-rate refuel-rate": Element(text=Text.NOT_NEGATIVE),
    "engine": Element(
        f"feed thruster location orient {ENGINES} {_TEXT}",
        folders=_PROPULSION,
        kinds=ENGINES,
        not_translated="",
    ),
    "thruster": Element(
        f"location orient sense p_factor {THRUSTERS} {_TEXT}",
        folders=_PROPULSION,
        kinds=THRUSTERS,
        not_translated="",
    ),
    "tank": Element(
        "location drain_location radius inertia_factor grain_config capacity contents density "
        f"temperature standpipe unusable-volume priority type {_TEXT}",
        "type number",
        not_translated="grain_config",
    ),
    "capacity density": Element(text=Text.POSITIVE, not_translated=""),
    "contents inertia_factor standpipe unusable-volume priority": Element(
        text=Text.NOT_NEGATIVE, not_translated=""
    ),
    "grain_config": Element(f"bore_diameter length {_TEXT}", "type"),
    "bore_diameter": Element(text=Text.NOT_NEGATIVE),
    # engines
    "electric_engine": Element(f"power {_ENGINE}", not_translated=_MOUNTING),
    "brushless_dc_motor": Element(
        f"maxvolts velocityconstant coilresistance noloadcurrent {_ENGINE}",
        not_translated=_MOUNTING,
    ),
    "maxvolts velocityconstant coilresistance": Element(text=Text.POSITIVE, not_translated=""),
    "power noloadcurrent": Element(text=Text.NOT_NEGATIVE, not_translated=""),
    "piston_engine": Element(
        "air-intake-impedance-factor boost-loss-factor boostmanual boostoverride bore bsfc "
        "compression-ratio cooling-factor cycles cylinder-head-mass cylinders displacement "
        "dynamic-fmep idlerpm injected man-press-lag maxhp maxmp maxrpm maxthrottle minmp "
        "minthrottle numboostspeeds oil-pressure-relief-valve-psi design-oil-temp-degK "
        "oil-pressure-rpm-max oil-viscosity-index ram-air-factor ratedaltitude1 ratedaltitude2 "
        "ratedaltitude3 ratedboost1 ratedboost2 ratedboost3 ratedpower1 ratedpower2 ratedpower3 "
        "ratedrpm1 ratedrpm2 ratedrpm3 sparkfaildrop starter-rpm starter-torque static-friction "
        "static-fmep stroke takeoffboost throttlepos volumetric-efficiency "
        "bsfc-lbs_hphr "
        f"{_ENGINE}"
    ),
    "turbine_engine": Element(
        "atsfc augmented augmethod bleed bypassratio disableWindmill idlefuelflow idlen1 idlen2 "
        "ignitionn1 ignitionn2 injected injection-time maxn1 maxn2 maxthrust maxtit milthrust "
        "n1spinup n1startrate n2spinup n2startrate InjN1increment InjN2increment "
        f"TSFC_correction tsfc {_ENGINE}"
    ),
    "turboprop_engine": Element(
        "betarangeend idlefuelflow idlen1 idlen2 ielumaxtorque ignitionn1 itt_delay maxn1 maxn2 "
        "maxpower maxstartingtime milthrust n1idle_max_delay psfc reversemaxpower "
        f"startern1 {_ENGINE}"
    ),
    "rocket_engine": Element(
        "builduptime isp maxthrottle minthrottle slfuelflowmax sloxiflowmax thrust_table "
        f"variation {_ENGINE}"
    ),
    "thrust_table": Element(f"tableData {_TEXT}", "type", name=Name.PROPERTY),
    "variation": Element(f"thrust total_isp {_TEXT}"),
    # thrusters
    "propeller": Element(
        "ixx diameter numblades gearratio minpitch maxpitch minrpm maxrpm constspeed reversepitch "
        f"ct_factor cp_factor p_factor sense table {_MODEL}",
        "version",
        not_translated="constspeed reversepitch sense property function",
    ),
    "diameter numblades gearratio": Element(text=Text.POSITIVE, not_translated=""),
    "nozzle": Element(f"area diam expr nzl_eff pe {_MODEL}"),
    "direct": Element(_MODEL),
    "rotor": Element(
        "ExternalRPM cantangle cgroundeffect chord:number controlmap diameter flappingmoment "
        "gearratio groundeffectexp groundeffectshift hingeoffset inflowlag liftcurveslope "
        "massmoment maxrpm minrpm nominalrpm numblades polarmoment shafttilt tailrotor "
        f"tiplossfactor twist xhub yhub zhub {_MODEL}"
    ),
    "tailrotor": Element(
        "cantangle chord:number diameter flappingmoment hingeoffset inflowlag liftcurveslope "
        f"massmoment nominalrpm numblades tiplossfactor twist xhub yhub zhub {_TEXT}"
    ),
    "massmoment": Element(attributes="Xunit", text=Text.VALUE),
    # controls
    "system autopilot flight_control": Element(
        f"channel {_MODEL}", "execrate", folders=_SYSTEMS, not_translated="function execrate"
    ),
    "channel": Element(
        f"{_COMPONENTS} {_TEXT}", "execute execrate", not_translated="execute execrate"
    ),
    "output": Element(text=Text.WRITES, not_translated=""),
    "delay": Element(attributes="type", text=Text.VALUE),
    "clipto": Element(f"min:limit max:limit {_TEXT}", "type", not_translated=""),
    "domain range": Element(f"min:limit max:limit {_TEXT}", not_translated=""),
    "alphalimits hysteresis_limits": Element(f"min:limit max:limit {_TEXT}", not_translated=""),
    _FILTERS: Element(
        f"c1 c2 c3 c4 c5 c6 trigger {_COMPONENT}",
        "type",
        name=Name.CONTROL,
        not_translated="trigger init delay",
    ),
    "summer": Element(f"bias {_COMPONENT}", "type", name=Name.CONTROL, not_translated="init delay"),
    "deadband": Element(
        f"width gain {_COMPONENT}", "type", name=Name.CONTROL, not_translated="init delay"
    ),
    "pure_gain scheduled_gain aerosurface_scale": Element(
        f"gain domain range zero_centered table {_COMPONENT}",
        "type",
        name=Name.CONTROL,
        not_translated="init delay",
    ),
    "selector": Element(
        f"default test {_COMPONENT}", "type", name=Name.CONTROL, not_translated="init delay"
    ),
    "default": Element(attributes="value", text=Text.VALUE, not_translated=""),
    "test": Element("test", "value logic", text=Text.VALUE, not_translated=""),
    "kinematic": Element(
        f"traverse noscale {_COMPONENT}",
        "type",
        name=Name.CONTROL,
        not_translated="init delay",
    ),
    "traverse": Element(f"setting {_TEXT}", not_translated=""),
    "setting": Element(f"position time {_TEXT}", not_translated=""),
    "fcs_function": Element(
        f"function {_COMPONENT}", "type", name=Name.CONTROL, not_translated="init delay"
    ),
    "pid": Element(f"kp ki kd pvdot trigger {_COMPONENT}", "type", name=Name.CONTROL),
    "ki": Element(attributes="type", text=Text.VALUE),
    "actuator": Element(
        f"lag rate_limit bias deadband_width hysteresis_width {_COMPONENT}",
        "type",
        name=Name.CONTROL,
        not_translated="init delay",
    ),
    "rate_limit": Element(attributes="sense", text=Text.VALUE, not_translated=""),
    "linear_actuator": Element(
        f"set:number reset versus bias module hysteresis lag rate gain {_COMPONENT}",
        "type",
        name=Name.CONTROL,
    ),
    _SENSORS: Element(_SENSOR, "type", name=Name.CONTROL),
    "noise": Element(attributes="variation distribution seed", text=Text.VALUE),
    "quantization": Element(f"bits min:limit max:limit {_TEXT}", name=Name.PROPERTY),
    "angle": Element(f"source_angle target_angle {_COMPONENT}", "type", name=Name.CONTROL),
    "waypoint_heading waypoint_distance": Element(_WAYPOINT, "type", name=Name.CONTROL),
    "distributor": Element(f"case {_COMPONENT}", "type", name=Name.CONTROL),
    "case": Element(f"test property:set {_TEXT}"),
    "set": Element(attributes="value persistent", text=Text.WRITES, not_translated="persistent"),
    # aerodynamics and functions
    "aerodynamics": Element(
        "axis alphalimits hysteresis_limits aero_ref_pt_shift_x aero_ref_pt_shift_y "
        f"aero_ref_pt_shift_z {_MODEL}",
        folders=_HERE,
        not_translated="aero_ref_pt_shift_x aero_ref_pt_shift_y aero_ref_pt_shift_z",
    ),
    "axis": Element(f"function {_TEXT}", "frame", not_translated="frame unit"),
    "aero_ref_pt_shift_x aero_ref_pt_shift_y aero_ref_pt_shift_z": Element(f"function {_TEXT}"),
    "function": Element(
        _ARGUMENTS, "type copyto", name=Name.PROPERTY, not_translated=f"copyto {_RANDOM}"
    ),
    _OPERATIONS: Element(_ARGUMENTS, not_translated=_RANDOM),
    _RANDOM: Element(attributes="seed mean stddev lower upper"),
    "table t": Element(
        f"independentVar tableData {_TEXT}",
        "type lookup",
        name=Name.PROPERTY,
        not_translated="",
    ),
    "independentVar": Element(attributes="lookup", text=Text.VALUE, not_translated=""),
    "tableData": Element(f"tableData {_TEXT}", "breakPoint", text=Text.VALUE, not_translated=""),
}

GRAMMAR = {name: row for names, row in _ROWS.items() for name in names.split()}

# JSBSim's own properties, by the first part of their names, and those that an aircraft may set. All
# other names are the aircraft's own and have no effect by themselves.
JSBSIM_PROPERTIES = frozenset(
    "accelerations aero atmosphere attitude buoyant_forces contact external_reactions fcs fdm "
    "flight-path forces gear ground ic inertia inertial metrics moments orbital position "
    "propulsion simulation systems velocities".split()
)
_SETTABLE = re.compile(
    r"(aero|buoyant_forces|contact|external_reactions|fcs|gear|metrics|propulsion|systems)(\[\d+\])?/"
    r"|inertia/pointmass-|attitude/sensor/"
)
_PART = r"[A-Za-z_#][\w.#-]*(\[(\d+|#)\])?"
_PROPERTY = re.compile(rf"/?{_PART}(/{_PART})*", re.ASCII)


def property_problem(name: str) -> str | None:
    """Return why an aircraft may not set a property, with what to write instead, or None."""
    name = "-".join(name.split())  # as JSBSim does
    if not _PROPERTY.fullmatch(name):
        return "is not the name of a property (write letters, digits, - and _, parted by /)"
    first = re.split(r"[/\[]", name.removeprefix("/"), maxsplit=1)[0]
    # a name that begins with / is not below /fdm/jsbsim, where JSBSim's own are
    own = first != "fdm" if name.startswith("/") else first not in JSBSIM_PROPERTIES
    if own or _SETTABLE.match(name):
        return None
    return (
        "is JSBSim's, and an aircraft may not set it (remove it, or write a name of your own, as "
        "in systems/NAME)"
    )


def row_of(element: Element, child: str) -> Element | None:
    """Return the row of an element in another one; None: it may not be there."""
    row = _CHILDREN[element].get(child)
    return None if row is None else GRAMMAR.get(row, _VALUE)


_VALUE = Element(text=Text.VALUE, not_translated="")
_CHILDREN = {
    element: {
        name: row or name for name, _, row in (e.partition(":") for e in element.children.split())
    }
    for element in (*GRAMMAR.values(), _VALUE)
}
