"""Compiled flight models against JSBSim, to the bit, from random states."""

import os
from pathlib import Path

import numpy as np
import pytest
from cases import ALL as EVERY_CASE
from cases import in_full
from compiled_elements import ALL, make, unequal
from places import ROOT

from testbed.compiled import CompiledAircraft, NotTranslated, proof
from testbed.compiled import model_limits as limits
from testbed.compiled.proof import Comparison, compare
from testbed.compiled.rows import write_air
from testbed.core import compile as compile_module
from testbed.core.compile import source_digest
from testbed.core.records import NedOrigin
from testbed.vehicle.environment import INTEGRATORS, JSBSIM_DEFAULT_INTEGRATORS
from testbed.vehicle.jsbsim_adapter import load
from testbed.vehicle.jsbsim_io import AIR_PROPERTIES, BATTERY_PROPERTIES, MOTION_PROPERTIES
from testbed.vehicle.trim import Controls, Placement

AIRCRAFT = ROOT / "aircraft"
STATES = int(os.environ.get("TESTBED_STATES", "50"))
RATE_HZ = 200
TROPOPAUSE_FT = 11_000 / 0.3048
CASES = [
    ("rascal110", INTEGRATORS),
    ("skywalker_x8", INTEGRATORS),
]
if STATES > 50 or EVERY_CASE:  # in `test_compiled_elements` the second of them runs as Python
    CASES += [(name, JSBSIM_DEFAULT_INTEGRATORS) for name in ("rascal110", "skywalker_x8")]


def compiled(name, integrators=INTEGRATORS):
    folder = AIRCRAFT / name
    return CompiledAircraft(folder, load(folder, RATE_HZ, integrators), integrators)


@pytest.mark.parametrize(("name", "integrators"), CASES)
def test_random_states_equal_jsbsim(name, integrators):
    found = compare(compiled(name, integrators), RATE_HZ, states=STATES)
    assert found.unequal == ""
    assert found.compared > 200 * STATES


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8"])
def test_a_minute_with_gusts_equals_jsbsim(name):
    """Controls and wind change at random, held for 4 steps."""
    comparison = Comparison(compiled(name), RATE_HZ)
    comparison.place(spin=True, calm=True)
    comparison.fly(60 * RATE_HZ)
    assert comparison.unequal == ""


@in_full
def test_made_up_elements_equal_jsbsim(tmp_path):
    """They are compiled here; `test_compiled_elements` runs them one by one as Python.

    `test_compiled_literals` compiles functions and components, without a flight model.
    """
    assert unequal(make(tmp_path, "made", ALL)) == ""


def test_rows_run_with_inputs_like_a_fleet():
    """The first step of a change has controls of its own; other rows keep their state."""
    found = compiled("skywalker_x8")
    comparison = Comparison(found, RATE_HZ)
    comparison.place(spin=True, calm=True)
    model, placed = comparison.model, comparison.row
    state = np.stack([placed, placed, placed])
    wind = np.tile([5.0, -3.0, 1.0, 0.1, -0.2, 0.05, 0.002], (3, 1))
    controls, first = np.tile([0.1, -0.2, 0.0, 0.6], (3, 1)), np.tile([0.2, -0.3, 0.0, 0.7], (3, 1))
    status, which = np.zeros(3, dtype=np.uint8), np.array([0, 2])
    changed = np.ones(2, dtype=bool)
    found.run_rows(
        state,
        wind,
        controls,
        first,
        changed,
        1.0 / RATE_HZ,
        np.array([4]),
        which,
        status,
    )
    for node, value in zip((*model.winds, *model.turns), wind[0], strict=True):
        node.set_double_value(value)
    for tick in range(4):
        for command, value in zip(model.controls, (controls if tick else first)[0], strict=True):
            command(value)
        model.fdm.run()
    comparison.row = state[0]
    comparison.check("4 steps after a change")
    assert comparison.unequal == ""
    assert (state[2] == state[0]).all()
    assert (state[1] == placed).all()
    air = np.zeros((3, 5))
    write_air(state, which, found.air_columns, air)
    names = (*AIR_PROPERTIES, *BATTERY_PROPERTIES)
    assert air[0].tolist() == [model.node(each).get_double_value() for each in names]


def test_air_above_the_tropopause_equals_jsbsim():
    comparison, heights = Comparison(compiled("rascal110"), RATE_HZ), []
    for _ in range(10):
        comparison.place(spin=True, high=True)
        comparison.run(2)
        heights.append(comparison.model.node("position/geod-alt-ft").get_double_value())
    assert comparison.unequal == ""
    assert min(heights) < TROPOPAUSE_FT < max(heights)


def test_start_above_the_atmosphere_is_refused():
    """JSBSim flies it, and the reason is in words."""
    found = compiled("rascal110")
    model = load(found.folder, RATE_HZ)
    found.watch(model)
    model.locate((0.0, 0.0, -21_000.0), NedOrigin())
    level = Placement((60.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    model.place(level, Controls(0.0, 0.0, 0.0, 1.0), spin=True)
    with pytest.raises(
        NotTranslated, match="starts above 20 km, where the compiled atmosphere ends"
    ):
        found.row_of(model)


def test_rows_end_where_the_model_ends():
    found = compiled("rascal110")
    comparison = Comparison(found, RATE_HZ)
    comparison.place(spin=True, calm=True)
    state = np.tile(comparison.row, (3, 1))
    state[1, [found.columns[f"position/eci-{axis}-ft"] for axis in "xyz"]] *= 1.004
    wind, status = np.zeros((3, 7)), np.zeros(3, dtype=np.uint8)
    wind[2, 0] = np.nan
    args = state, wind, np.zeros((3, 4)), np.zeros((3, 4)), np.array([True, False])
    for _ in range(2):
        before = state.copy()
        found.run_rows(*args, 1.0 / RATE_HZ, np.array([4]), np.arange(3), status)
    expected = [limits.FLYING, limits.ABOVE_ATMOSPHERE, limits.IMPLAUSIBLE]
    assert status.tolist() == expected
    assert (state[0] != before[0]).any()
    assert np.array_equal(state[1:], before[1:], equal_nan=True)


def test_the_proof_compares_every_number():
    """A number that differs by its last bit is found, whichever it is."""
    comparison = Comparison(compiled("skywalker_x8"), RATE_HZ)
    comparison.place(spin=True, calm=True)
    assert comparison.unequal == ""
    columns = [column for _, column, _ in comparison._nodes]
    placed = comparison.row
    for column in columns:
        comparison.row = placed.copy()
        comparison.row[column] = np.nextafter(comparison.row[column], np.inf)
        comparison.check("moved")
        assert "a difference of" in comparison.unequal, column
        comparison.unequal = ""
    comparison.row = placed
    for k, read in enumerate(list(comparison._motion)):
        number = read()
        comparison._motion[k] = lambda number=number: float(np.nextafter(number, np.inf))
        comparison.check("moved")
        assert comparison.unequal.startswith(f"{MOTION_PROPERTIES[k]} is "), k
        assert "np." not in comparison.unequal
        comparison._motion[k], comparison.unequal = read, ""


def test_a_proof_is_kept_for_what_it_depends_on(monkeypatch):
    """Aircraft, integrators and rate; what else does, each kept result depends on."""
    one, other = compiled("rascal110"), compiled("rascal110", JSBSIM_DEFAULT_INTEGRATORS)
    found = []
    monkeypatch.setattr(proof, "find_result", lambda kind, name, of, make: found.append(of))
    for aircraft, rate in ((one, 200), (one, 120), (other, 200)):
        proof.prove_aircraft(aircraft, rate)
    with monkeypatch.context() as changed:
        changed.setattr(proof, "folder_digest", lambda _: "of other files")
        proof.prove_aircraft(one, 200)
    with monkeypatch.context() as changed:
        changed.setattr(one, "source", f"{one.source} ")
        proof.prove_aircraft(one, 200)
    assert len(set(map(repr, found))) == len(found) == 5
    package = Path(proof.__file__).parents[1]
    assert source_digest(package)[:16] in compile_module.cache_folder().name


def test_vertical_attitudes_equal_jsbsim():
    """There the heading is 0, and the roll has it."""
    comparison, random = Comparison(compiled("rascal110"), RATE_HZ), np.random.default_rng(1)
    comparison.place(spin=True)
    model, vertical = comparison.model, 0
    for k in range(60):
        angles = random.uniform(-3.0, 3.0), (-1) ** k * 0.5 * np.pi, random.uniform(0.0, 6.0)
        model.place(
            Placement((30.0, 0.0, 0.0), (0.0, 0.0, 0.0), float(angles[0]), float(angles[1]), 0.0),
            Controls(0.0, 0.0, 0.0, 0.5),
            course=float(angles[2]),
            spin=False,
        )
        comparison.row = comparison._aircraft.row_of(model)
        comparison.check("placed")
        vertical += abs(model.node("attitude/theta-rad").get_double_value()) == 0.5 * np.pi
        comparison.run(2)
    assert comparison.unequal == ""
    assert vertical > 20
