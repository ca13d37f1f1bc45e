"""Limits of a stall's hysteresis act as in JSBSim alone.

Those of a compiled aircraft are in tests/compiled/contract/test_engine_powers.py.
"""

import jsbsim
import numpy as np
import pytest

from testbed.commissioning.airframe_import import copy_aircraft
from testbed.core.records import NedOrigin
from testbed.vehicle.environment import load_planet, set_environment
from testbed.vehicle.jsbsim_adapter import SHARED_FILES, load, load_executive
from testbed.vehicle.trim import Controls, Placement

ALPHAS_DEG = (18, 16, 12, 8, 4)
STALLED = (0.896, 0.828, 0.766, 0.722, 0.559)  # lift coefficients of JSBSim 1.3.3 alone
PROPERTY = "aero/stall-hyst-norm"


@pytest.fixture(scope="module")
def cessna(tmp_path_factory):
    folder = tmp_path_factory.mktemp("aircraft") / "c172p"
    folder.mkdir()
    copy_aircraft(SHARED_FILES / "aircraft" / "c172p" / "c172p.xml", folder, SHARED_FILES)
    return folder


def fall(fdm):
    """Return lift coefficients on the way down from an angle of attack of 22°."""
    for name, value in (("h-sl-ft", 5000.0), ("vt-fps", 120.0), ("gamma-deg", 0.0)):
        fdm[f"ic/{name}"] = value
    fdm["ic/alpha-deg"] = 22.0
    fdm.run_ic()
    fdm["fcs/elevator-cmd-norm"] = 0.0
    found, before = {}, 90.0
    for _ in range(240):
        fdm.run()
        alpha = fdm["aero/alpha-deg"]
        for wanted in ALPHAS_DEG:
            if before > wanted >= alpha:
                area = fdm["aero/qbar-psf"] * fdm["metrics/Sw-sqft"]
                found[wanted] = round(abs(fdm["forces/fwz-aero-lbs"]) / area, 3)
        before = alpha
    return tuple(found[each] for each in ALPHAS_DEG)


def test_lift_after_a_stall_is_that_of_jsbsim_alone(cessna):
    alone = jsbsim.FGFDMExec(str(SHARED_FILES), None)
    assert alone.load_model("c172p")
    assert fall(alone) == STALLED
    ours = load_executive(cessna)
    set_environment(ours)  # with other integrators, and J2
    assert fall(ours) == pytest.approx(STALLED, abs=0.01)


def test_a_planet_loaded_later_would_forget_the_limits(cessna):
    """A negative control."""
    reset = load_executive(cessna)
    load_planet(reset)
    set_environment(reset)
    assert fall(reset)[0] == pytest.approx(1.326, abs=0.01)


def test_a_placement_is_not_stalled_by_an_earlier_one(cessna):
    """Between the limits, 5° and 21°, the flow is attached after a stall elsewhere."""
    model = load(cessna, 200)
    stalled = model.node(PROPERTY).get_double_value
    states = []
    for alpha in (0.17, 0.45, 0.17):
        velocity = (60.0 * np.cos(alpha), 0.0, 60.0 * np.sin(alpha))
        level = Placement(velocity, (0.0, 0.0, 0.0), 0.0, alpha, 0.0)
        model.locate((0.0, 0.0, -1000.0), NedOrigin())
        model.place(level, Controls(0.0, 0.0, 0.0, 0.5), spin=False)
        states.append(stalled())
    assert states == [0.0, 1.0, 0.0]
