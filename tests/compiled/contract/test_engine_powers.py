"""Aircraft with powers of literals in drag, moments, gains and filters: both engines fly the same.

LLVM replaces some of these powers by other functions, which differ in the last bit. The aircraft
has limits of a stall's hysteresis, and odd and large functions, too. Only in `make check-all`, as
compiling it takes seconds: its functions are compiled in test_compiled_literals.py, and its limits
are in test_compiled_elements.py. A sample of 2 s of one aircraft; 120 s of both with
TESTBED_ENGINES=1.
"""

import os
import re
import shutil

import numpy as np
import pytest
from cases import ALL
from run_flight import Collector
from test_engine import assert_equal
from test_engine_fallback import odd_and_large

import testbed
from testbed.compiled import CompiledAircraft
from testbed.compiled.proof import Comparison
from testbed.scenario import library, loads, set_duration
from testbed.vehicle.jsbsim_adapter import load

WHOLE = os.environ.get("TESTBED_ENGINES") == "1"
DURATION_S = 120.0 if WHOLE else 2.0
RATE_HZ = 200
pytestmark = pytest.mark.skipif(not (WHOLE or ALL), reason="run by make check-all")
EXPONENTS = (0.33333, 0.5, 2.0, 4.0, -1.0)  # the first four are those of JSBSim's collection
SPEED = "<quotient><p>velocities/vt-fps</p><v>70</v></quotient>"
FLOW = "<sum><abs><p>aero/alpha-rad</p></abs><v>0.3</v></sum>"


def powers(base):
    parts = "".join(f"<pow>{base}<v>{each}</v></pow>" for each in EXPONENTS)
    return f"<product><v>1e-3</v><sum>{parts}<pow><v>2</v>{base}</pow></sum></product>"


def term(axis, text):
    product = f"<product><p>aero/qbar-psf</p><v>0.1</v>{text}</product>"
    return f'<axis name="{axis}"><function name="aero/made-{axis}">{product}</function>'


STALLED = "aero/stall-hyst-norm"
LIMITS = (
    '<hysteresis_limits unit="DEG"> <min> 4 </min> <max> 9 </max> </hysteresis_limits>'
    f'<function name="made/stall"><product><v>0.3</v><p>{STALLED}</p></product></function>'
)
SYSTEM = f"""<system name="made"><channel name="made">
<fcs_function name="made/pow"><function>{powers(SPEED)}</function></fcs_function>
<lag_filter name="made/lag"><input> made/pow </input><c1> 7 </c1></lag_filter>
<pure_gain name="made/gain"><input> fcs/elevator-cmd-norm </input>
<gain> made/pow </gain></pure_gain>
</channel></system>"""
# The distance to a point by the haversine formula, as waypoint functions have it.
HALF = "<product><v>0.5</v><difference><p>position/{}-rad</p><v>0.01</v></difference></product>"
SQUARE = "<pow><sin>{}</sin><v>2</v></pow>"
WAYPOINT = (
    "<product><v>20925646</v><v>2</v><asin><pow><sum>"
    + SQUARE.format(HALF.format("lat-geod"))
    + f"<product><cos><p>position/lat-geod-rad</p></cos>{SQUARE.format(HALF.format('long-gc'))}"
    + "</product></sum><v>0.5</v></pow></asin></product>"
)


def make(folder, base, *, glider=False):
    """Copy an aircraft, with powers in drag, moments, a gain and a filter, with limits and more."""
    made = folder / f"{base}_pow"
    shutil.copytree(library() / "aircraft" / base, made)
    file = (made / f"{base}.xml").rename(made / f"{base}_pow.xml")
    text = file.read_text(encoding="utf-8")
    texts = {
        "DRAG": powers(SPEED),
        "ROLL": f"<product><p>aero/beta-rad</p>{powers(FLOW)}</product>",
        "PITCH": f"<product><p>aero/alpha-rad</p>{powers(FLOW)}<p>made/lag</p></product>",
        "YAW": f"<product><p>aero/beta-rad</p>{powers(SPEED)}<p>made/gain</p></product>",
    }
    for axis, each in texts.items():
        assert text.count(f'<axis name="{axis}">') == 1
        text = text.replace(f'<axis name="{axis}">', term(axis, each))
    way = f'<function name="guidance/wp-distance">{WAYPOINT}</function>'
    odd = (f'<function name="made/f{k}">{t}</function>' for k, t in enumerate(odd_and_large(8)))
    text = text.replace('<axis name="DRAG">', f'{LIMITS}{way}{"".join(odd)}<axis name="DRAG">', 1)
    assert text.count("<aerodynamics>") == 1
    text = text.replace("<aerodynamics>", f"{SYSTEM}<aerodynamics>")
    if glider:
        text, count = re.subn(r"<propulsion.*?</propulsion>", "", text, flags=re.DOTALL)
        assert count == 1
    file.write_text(text, encoding="utf-8")
    return made


@pytest.mark.parametrize("base", ["rascal110", "skywalker_x8"] if WHOLE else ["rascal110"])
def test_flights_with_powers_are_equal(tmp_path, base):
    kite, flown = make(tmp_path, base), {}
    of = "simulation-1" if base == "rascal110" else "experiment-1"
    for engine in ("compiled", "jsbsim"):
        text = f"extends: {of}\nscenario: {{engine: {engine}}}\nleader: {{aircraft: {kite}}}\n"
        collector = Collector()
        scenario = set_duration(loads(text), DURATION_S)
        run = testbed.run(scenario, write=False, observers=[collector])
        assert (run.metrics["engine"], run.outcome) == (engine, "completed")
        flown[engine] = collector.frames
    assert_equal(flown["compiled"], flown["jsbsim"])


@pytest.mark.parametrize("glider", [False, True])
def test_models_with_powers_are_equal(tmp_path, glider):
    """Each number after each step, with random controls and gusts.

    A glider without powers is compared in `test_compiled_elements`.
    """
    kite = make(tmp_path, "rascal110", glider=glider)
    comparison = Comparison(CompiledAircraft(kite, load(kite, RATE_HZ)), RATE_HZ)
    wanted = 50 * DURATION_S * RATE_HZ
    while comparison.compared < wanted and not comparison.unequal:  # one flight ends at 100 m
        comparison.place(spin=True, calm=True)
        comparison.fly(int(DURATION_S * RATE_HZ))
    assert comparison.unequal == ""
    assert "guidance/wp-distance" in comparison._aircraft.columns


def test_compiled_aircraft_stalls_as_in_jsbsim(tmp_path):
    """Gusts carry a Rascal with limits of a stall above them, between them and below them."""
    kite = make(tmp_path, "rascal110")
    comparison = Comparison(CompiledAircraft(kite, load(kite, RATE_HZ)), RATE_HZ)
    comparison.place(spin=True, calm=True)
    columns = [comparison._aircraft.columns[each] for each in (STALLED, "aero/alpha-rad")]
    seen = []
    for step in range(600):
        if step % 30 == 0:
            comparison.set("atmosphere/wind-down-fps", (0.0, -25.0, -4.0)[step // 30 % 3])
        comparison._step()
        comparison.check(f"{step} steps after the start")
        seen.append(comparison.row[columns].tolist())
    assert comparison.unequal == ""
    states, alphas = (np.array(each) for each in zip(*seen, strict=True))
    between = (alphas > np.radians(4.0)) & (alphas < np.radians(9.0))
    assert {0.0, 1.0} <= set(states[between])
