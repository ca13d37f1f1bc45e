"""Made-up aircraft with JSBSim's elements, compiled and compared with JSBSim.

`python compiled_elements.py FOLDER` prints the differences as JSON. It runs the flight models as
Python, with NUMBA_DISABLE_JIT=1 in the environment: compiling each would take seconds.
"""

import json
import shutil
import sys
from pathlib import Path
from unittest import mock

from aircraft_copies import TWIN, changed
from places import ROOT

from testbed.compiled import CompiledAircraft
from testbed.compiled import compiled_aircraft as aircraft
from testbed.compiled.proof import compare
from testbed.core.compile import entry_of_source
from testbed.vehicle import jsbsim_adapter
from testbed.vehicle.environment import INTEGRATORS, JSBSIM_DEFAULT_INTEGRATORS
from testbed.vehicle.jsbsim_adapter import load

AIRCRAFT = ROOT / "aircraft"
RATE_HZ, STATES, FLIGHT_STEPS = 200, 12, 60


def value(number):
    return f"<value> {number} </value>"


def read(name):
    return f"<property> {name} </property>"


ALPHA, BETA, Q = read("aero/alpha-rad"), read("aero/beta-rad"), read("velocities/q-rad_sec")
SIZE = f"<abs>{ALPHA}</abs>"
TENFOLD = f"<product>{ALPHA}{value(10)}</product>"
ROWS = """<independentVar lookup="row"> aero/alpha-rad </independentVar>
<independentVar lookup="column"> aero/beta-rad </independentVar>"""


def grid(factor, attribute=""):
    return f"""<tableData{attribute}>
             -0.3       -0.1      0.05         0.4
        -0.5  {factor}   2         4            3.3
        -0.2  2          2.5      {5 * factor}  1
         0.1  1.1        0.3       0.7         {9 * factor}
         0.7  3         {factor}   4            1.5
    </tableData>"""


FUNCTIONS = {
    **{each: f"<{each}>{SIZE}</{each}>" for each in ("log2", "ln", "log10", "sqrt")},
    **{each: f"<{each}>{ALPHA}</{each}>" for each in "sign sin cos tan atan exp abs".split()},
    **{each: f"<{each}>{TENFOLD}</{each}>" for each in "fraction integer floor ceil".split()},
    **{each: f"<{each}>{ALPHA}</{each}>" for each in ("toradians", "todegrees")},
    **{each: f"<{each}>{ALPHA}{BETA}</{each}>" for each in "lt le gt ge eq nq atan2".split()},
    **{each: f"<{each}>{ALPHA}{BETA}{Q}</{each}>" for each in "min max avg".split()},
    **{each: f"<{each}>{ALPHA}{BETA}{Q}</{each}>" for each in "sum difference product".split()},
    "asin": f"<asin><sin>{ALPHA}</sin></asin>",
    "acos": f"<acos><cos>{ALPHA}</cos></acos>",
    "pow": f"<pow>{SIZE}{BETA}</pow>",
    "quotient": f"<quotient>{ALPHA}{BETA}</quotient>",
    "pi": f"<product><pi/>{ALPHA}</product>",
    "fmod": f"<fmod>{TENFOLD}{value(1.3)}</fmod>",
    "mod": f"<mod>{TENFOLD}{value(3)}</mod>",
    "roundmultiple": f"<roundmultiple>{TENFOLD}{value(0.3)}</roundmultiple>",
    "round": f"<roundmultiple>{TENFOLD}</roundmultiple>",
    "and": f"<and><lt>{ALPHA}{BETA}</lt><gt>{ALPHA}{Q}</gt></and>",
    "or": f"<or><lt>{ALPHA}{BETA}</lt><gt>{ALPHA}{Q}</gt></or>",
    "not": f"<not><lt>{ALPHA}{BETA}</lt></not>",
    "ifthen": f"<ifthen><lt>{ALPHA}{BETA}</lt><sin>{ALPHA}</sin><cos>{BETA}</cos></ifthen>",
    "switch": f"<switch><abs>{TENFOLD}</abs>{''.join(map(value, range(40)))}</switch>",
    "interpolate1d": f"<interpolate1d>{ALPHA}{value(-0.5)}{value(1)}{value(-0.2)}{value(3)}"
    f"{value(0.1)}{Q}{value(0.7)}{value(-1)}</interpolate1d>",
    "table-2": f"<table>{ROWS}{grid(1.0)}</table>",
    "table-3": f'<table>{ROWS}<independentVar lookup="table"> velocities/q-rad_sec '
    "</independentVar>"
    + "".join(grid(k, f' breakPoint="{at}"') for k, at in ((1.0, -1.0), (1.7, 0.2), (0.3, 1.5)))
    + "</table>",
}
PROPERTIES = (
    *(f"velocities/{each}-fps" for each in "u v w v-north v-down h-dot ve vg vtrue".split()),
    *(f"velocities/{each}" for each in ("mach", "machU", "ve-kts", "vtrue-kts", "q-aero-rad_sec")),
    *(f"attitude/{each}" for each in ("phi-rad", "theta-deg", "psi-rad", "roll-rad")),
    *(f"position/{each}" for each in ("h-sl-ft", "geod-alt-ft", "lat-geod-rad", "long-gc-rad")),
    *(f"atmosphere/{each}" for each in ("T-R", "P-psf", "a-fps", "sigma", "theta", "delta")),
    *(f"aero/{each}" for each in ("alpha-deg", "beta-deg", "mag-beta-rad", "betadot-rad_sec")),
    *(f"aero/{each}" for each in ("qbarUW-psf", "qbarUV-psf", "alphadot-deg_sec")),
    *(f"propulsion/engine/{each}" for each in ("thrust-lbs", "advance-ratio")),
    *("propulsion/engine/prop-induced-velocity_fps", "aero/stall-hyst-norm"),
    *("position/h-agl-ft", "aero/h_b-cg-ft", "aero/h_b-mac-ft"),
    *("gear/gear-cmd-norm", "gear/gear-pos-norm", "gear/unit[1]/WOW"),
    *("flight-path/gamma-rad", "accelerations/udot-ft_sec2", "accelerations/qidot-rad_sec2"),
)
STICK = "<input> fcs/aileron-cmd-norm </input>"
LATE = "<input> -aero/alpha-rad </input>"  # which a frame writes after the components
SCALE = "<range> <min> -20 </min> <max> 10 </max> </range>"
LIMITS = "<clipto> <min> -0.6 </min> <max> 0.7 </max> </clipto>"
COMPONENTS = {
    "summer": f"{STICK}<input> -fcs/elevator-cmd-norm </input><bias> 0.03 </bias>",
    "pure_gain": f"{STICK}<gain> fcs/rudder-cmd-norm </gain>",
    "pure_gain-clipped": f"{STICK}<gain> -2.3 </gain>{LIMITS}",
    "scheduled_gain": f"{STICK}<table><independentVar> velocities/vt-fps </independentVar>"
    "<tableData>\n 30 1.2\n 60 0.7\n 90 0.1 </tableData></table><gain> 0.3 </gain>",
    "deadband": f"{STICK}<width> 0.3 </width><gain> 1.7 </gain>",
    "aerosurface_scale": f"{STICK}<domain> <min> -2 </min> <max> 1.3 </max> </domain>{SCALE}"
    "<gain> 0.01745 </gain>",
    "aerosurface_scale-off": f"{STICK}{SCALE}<zero_centered> false </zero_centered>",
    "switch": '<default value="0.2"/><test logic="AND" value="fcs/elevator-cmd-norm">\n'
    "fcs/aileron-cmd-norm gt 0.1\n fcs/throttle-cmd-norm le 0.8 </test>"
    '<test logic="OR" value="-fcs/rudder-cmd-norm">\n fcs/rudder-cmd-norm == 0\n'
    '<test logic="AND">\n fcs/rudder-cmd-norm &lt; fcs/aileron-cmd-norm\n'
    "velocities/vt-fps GE 60 </test></test>",
    "fcs_function": f"<function>{TENFOLD}</function>"
    '<clipto type="cyclic"> <min> -1.5 </min> <max> 2 </max> </clipto>',
    "switch-bare": '<test value="fcs/elevator-cmd-norm">\nfcs/aileron-cmd-norm gt 0.1 </test>',
    "summer-late": "<input> aero/h_b-mac-ft </input><input> position/h-agl-ft </input>"
    "<input> propulsion/engine/prop-induced-velocity_fps </input>",
    "pure_gain-flap": f"{STICK}<gain> 15 </gain><output> fcs/flap-pos-deg </output>",
    "summer-aliases": "<input> fcs/flap-pos-rad </input><input> fcs/elevator-pos-deg </input>"
    "<input> fcs/mag-elevator-pos-rad </input><input> fcs/pitch-trim-cmd-norm </input>"
    "<input> propulsion/engine[0]/thrust-coefficient </input>",
}
FILTERS = {
    "lag_filter": f"{STICK}<c1> 10 </c1>",
    "lag_filter-late": f"{LATE}<c1> 7 </c1>",
    "lead_lag_filter": f"{STICK}<c1> 2 </c1><c2> 3 </c2><c3> 1.5 </c3><c4> 4 </c4>",
    "second_order_filter": f"{LATE}<c1> 0.1 </c1><c2> 2 </c2><c3> 30 </c3><c4> 1 </c4>"
    "<c5> 5 </c5><c6> 30 </c6>",
    "washout_filter": f"{LATE}<c1> 3 </c1>",
    "integrator": f"{STICK}<c1> 3 </c1>",
    "kinematic": f"{STICK}<traverse>"
    "<setting> <position> -10 </position> <time> 0 </time> </setting>"
    "<setting> <position> 0 </position> <time> 0.2 </time> </setting>"
    "<setting> <position> 15 </position> <time> 0.5 </time> </setting></traverse>",
    "kinematic-gear": "<input> gear/gear-cmd-norm </input><traverse>"
    "<setting> <position> 0 </position> <time> 0 </time> </setting>"
    "<setting> <position> 1 </position> <time> 5 </time> </setting></traverse>"
    "<output> gear/gear-pos-norm </output>",
    "actuator-lag": f"{STICK}<lag> 20 </lag><rate_limit> 1.5 </rate_limit>{LIMITS}",
    "actuator-rate": f'{LATE}<rate_limit sense="incr"> 1.5 </rate_limit>'
    '<rate_limit sense="decr"> 0.7 </rate_limit>',
    "actuator-bias": f"{STICK}<deadband_width> 0.2 </deadband_width><bias> 0.02 </bias>",
    "actuator-hysteresis": f"{STICK}<hysteresis_width> 0.1 </hysteresis_width>",
}


def channel(components):
    parts = (
        f'<{name.split("-")[0]} name="fcs/made-{name}">{text}</{name.split("-")[0]}>'
        for name, text in components.items()
    )
    return f'<channel name="made">{"".join(parts)}</channel></flight_control>'


def functions(texts):
    parts = (f'<function name="aero/made-{k}">{text}</function>' for k, text in texts.items())
    return "".join(parts) + '<axis name="DRAG">'


def axes(*names):
    others = zip(("DRAG", "SIDE", "LIFT"), names, strict=True)
    return [(f'<axis name="{one}">', f'<axis name="{other}">') for one, other in others]


def orient(roll, pitch, yaw):
    return f"""<orient unit="DEG"> <roll> {roll} </roll> <pitch> {pitch} </pitch>
<yaw> {yaw} </yaw> </orient>"""


FORWARD = '<orient unit="DEG"> <roll> 0 </roll> <pitch> 0 </pitch> <yaw> 0 </yaw> </orient>'
ELSEWHERE = '<location unit="IN"> <x> 7 </x> <y> 5 </y> <z> 3 </z> </location>'
BLADES = "<numblades> 2 </numblades>"
FIXED = """<minpitch> 30 </minpitch> <maxpitch> 30 </maxpitch>
<minrpm> 900 </minrpm> <maxrpm> 3000 </maxrpm> <p_factor> 5 </p_factor>"""
INCLINED = [
    (FORWARD, orient(10, -5, 7)),
    ("<x> 1 </x> <y> 0 </y> <z> 0 </z>", "<x> 1 </x> <y> 3 </y> <z> 0 </z>"),
    ("<feed> 0 </feed>", f"<feed> 0 </feed> {ELSEWHERE} {orient(3, 4, 5)}"),
    (BLADES, f"{BLADES} {FIXED}"),
]
STALL = """<alphalimits unit="DEG"> <min> -6 </min> <max> 9 </max> </alphalimits>
<hysteresis_limits unit="RAD"> <min> 0.1 </min> <max> 0.3 </max> </hysteresis_limits>"""
SLOPE = """<table><independentVar> velocities/vt-fps </independentVar><tableData>
30 1.2
60 0.7 </tableData></table>"""
# A system is the first to use names.
TABLES_FIRST = f"""<system name="made"><channel name="made"><fcs_function name="made/tables">
<function><sum>{SLOPE}{SLOPE}{FUNCTIONS["table-2"]}</sum></function>
</fcs_function></channel></system>"""
POINT_MASS = """<pointmass name="payload"> <weight unit="LBS"> 2 </weight>
<location unit="IN"> <x> 40 </x> <y> 3 </y> <z> 1 </z> </location> </pointmass></mass_balance>"""
# JSBSim runs all systems before all autopilots, and these before the flight control.
SYSTEMS = """</flight_control>
<autopilot name="made"> <property value="0.1"> made/gain </property> <channel name="made">
<pure_gain name="made/roll"> <input> fcs/left-aileron-pos-rad </input> <gain> made/gain </gain>
</pure_gain> </channel> </autopilot>
<system name="late"> <channel name="made"> <summer name="made/sum">
<input> fcs/left-aileron-pos-rad </input> <input> made/roll </input>
</summer> </channel> </system>"""
READS = {f"read-{number}": read(name) for number, name in enumerate(PROPERTIES)}
MADE = {
    "functions": [('<axis name="DRAG">', functions(FUNCTIONS | READS))],
    "components": [("</flight_control>", channel(COMPONENTS | FILTERS))],
    "propulsion": [
        ("<sense> 1 </sense>", "<sense> -1 </sense><p_factor> 5 </p_factor>"),
        ("<x> 1 </x> <y> 0 </y> <z> 0 </z>", "<x> 1 </x> <y> 2 </y> <z> 3 </z>"),
        ('<ixz unit="SLUG*FT2"> 0 </ixz>', '<ixz unit="SLUG*FT2"> 0.1 </ixz>'),
        ('<iyz unit="SLUG*FT2"> 0 </iyz>', '<iyz unit="SLUG*FT2"> 0.07 </iyz>'),
        ("</mass_balance>", POINT_MASS),
    ],
    "inclined_thruster": INCLINED,
    "inclined_thruster_with_p_factor": [
        *INCLINED,
        ("<sense> 1 </sense>", "<sense> -1 </sense><p_factor> 5 </p_factor>"),
    ],
    "stall_limits": [('<axis name="DRAG">', f'{STALL}<axis name="DRAG">')],
    "tables_first": [("</flight_control>", f"</flight_control>{TABLES_FIRST}")],
    "order_of_systems": [("</flight_control>", SYSTEMS)],
    "lift_squared": [
        ("<value> 0.04 </value>", f"<value> 0.04 </value>{read('aero/cl-squared')}"),
        ('<axis name="DRAG">', functions({"lift": read("aero/cl-squared")})),
    ],
    "body_axes": axes("X", "Y", "Z"),
    "normal_axes": axes("AXIAL", "SIDE", "NORMAL"),
}
# Nearly all of them, for the compiler; `test_compiled_literals` compiles the other functions.
OTHERS = {name: FUNCTIONS[name] for name in ("pi", "interpolate1d", "fmod", "asin", "and")}
ALL = [
    ('<axis name="DRAG">', functions(OTHERS | READS)),
    *MADE["components"],
    *MADE["propulsion"],
]
# Faults of a translator, in the source that it writes for an aircraft.
FAULTS = {
    "an integrator of another order": (
        "rascal110",
        "adams_bashforth_3(dt, velocity[2], velocity_1[2], velocity_2[2])",
        "adams_bashforth_2(dt, velocity[2], velocity_1[2])",
    ),
    "accelerations of another frame": ("rascal110", "vt, uvw_dot)", "vt, acceleration)"),
    "rates relative to the Earth": ("rascal110", "rates[2] * spin", "pqr[2] * spin"),
    "a dead band of the motor": (
        "skywalker_x8",
        "(current - 1.0)",
        "(max(current - 1.0, 0.0) + min(current + 1.0, 0.0))",
    ),
    "functions before their inputs": ("skywalker_x8", "(2.0 * vt)", "(2.0 * vt + 1e-14)"),
}


def make(folder, name, changes, base="rascal110"):
    """Copy an aircraft with changes of its files, each of a text that occurs once."""
    made = folder / name
    shutil.copytree(AIRCRAFT / base, made)
    (made / f"{base}.xml").rename(made / f"{name}.xml")
    files = list(made.rglob("*.xml"))
    for old, new in changes:
        (file,) = (each for each in files if old in each.read_text())
        text = file.read_text()
        assert text.count(old) == 1, old
        file.write_text(text.replace(old, new))
    return made


def unequal(folder, integrators=INTEGRATORS):
    found = CompiledAircraft(folder, load(folder, RATE_HZ, integrators), integrators)
    return compare(found, RATE_HZ, STATES, FLIGHT_STEPS).unequal


def unequal_with(fault):
    name, right, wrong = fault

    def build(function, source):
        assert right in source, right
        return entry_of_source(function, source.replace(right, wrong))

    with mock.patch.object(aircraft, "entry_of_source", build):
        return unequal(AIRCRAFT / name)


if __name__ == "__main__":
    elevons, rascal = AIRCRAFT / "skywalker_x8", AIRCRAFT / "rascal110"
    traits = jsbsim_adapter._find_traits(rascal)  # no change of MADE has others
    with mock.patch.object(jsbsim_adapter._find_traits, "_function", lambda _: traits):
        results = {
            name: unequal(make(Path(sys.argv[1]), name, changes)) for name, changes in MADE.items()
        }
    glider = (r"<propulsion.*?</propulsion>", "")
    results["glider"] = unequal(changed(rascal, Path(sys.argv[1]) / "glider", glider))
    results["twin"] = unequal(changed(rascal, Path(sys.argv[1]), TWIN))
    results["elevons"] = unequal(elevons, JSBSIM_DEFAULT_INTEGRATORS)
    print(json.dumps(results | {name: unequal_with(fault) for name, fault in FAULTS.items()}))
