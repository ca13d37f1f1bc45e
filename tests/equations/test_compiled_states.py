"""Compiled flight models against JSBSim, to the bit, from random states."""

import os
from pathlib import Path

import pytest

from testbed.vehicle.compiled import CompiledAircraft
from testbed.vehicle.compiled.proof import Comparison, compare
from testbed.vehicle.environment import INTEGRATORS, JSBSIM_DEFAULT_INTEGRATORS
from testbed.vehicle.jsbsim_adapter import load

AIRCRAFT = Path(__file__).parents[2] / "aircraft"
STATES = int(os.environ.get("TESTBED_STATES", "50"))
RATE_HZ = 200
CASES = [
    ("rascal110", INTEGRATORS),
    ("rascal110", JSBSIM_DEFAULT_INTEGRATORS),
    ("skywalker_x8", INTEGRATORS),
    ("skywalker_x8", JSBSIM_DEFAULT_INTEGRATORS),
]


def compiled(name, integrators=INTEGRATORS):
    folder = AIRCRAFT / name
    return CompiledAircraft(folder, load(folder, RATE_HZ, integrators), integrators)


@pytest.mark.parametrize(("name", "integrators"), CASES)
def test_random_states_equal_jsbsim(name, integrators):
    proof = compare(compiled(name, integrators), RATE_HZ, states=STATES)
    assert proof.unequal == ""
    assert proof.compared > 200 * STATES


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8"])
def test_a_minute_with_gusts_equals_jsbsim(name):
    """Controls and wind change at random, held for 4 steps."""
    comparison = Comparison(compiled(name), RATE_HZ)
    comparison.place(spin=True, calm=True)
    comparison.fly(60 * RATE_HZ)
    assert comparison.unequal == ""
