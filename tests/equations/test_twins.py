"""The compiled laws do what the readable ones say, on thousands of random states."""

import ast
import importlib
import itertools
from pathlib import Path

import numpy as np
import pytest
from formation_cases import PAPERS_MU, make_law, results, states, velocities

import testbed
from testbed.formation import law as numpy_law
from testbed.formation.barrier import Barrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.formation.flags import Guard, Saturation
from testbed.formation.geometry import true_slots
from testbed.frames import euler_rates

pytest.importorskip("numba")

from testbed.formation import geometry_twin  # noqa: E402
from testbed.formation import twin as formation_twin  # noqa: E402
from testbed.vehicle import twin as vehicle_twin  # noqa: E402

FUNCTIONS = [PAPERS_MU, example_1(2.5e5, 1.0, 0.8), EXAMPLE_2, EXAMPLE_3]
BARRIERS = [Barrier(4, 0.02), Barrier(5, 0.05), Barrier(6, 1.0), Barrier(7, 0.0)]
OPTIONS = list(itertools.product(FUNCTIONS, BARRIERS, [False, True], [False, True]))
AGENTS, STATES = 4, 12  # 64 combinations of options: some 3,000 states of agents
# The two take the same sums in other orders, so they differ by roundings of 1e-16, which (14)
# magnifies by 1/D, and example 5 by 1/(1 − tanh²), some 1e3 at 34 m/s.
TOLERANCE = 1e-11


def cases():
    rng = np.random.default_rng(40)
    for function, barrier, from_timestamp, as_printed in OPTIONS:
        for k in range(STATES):
            law = make_law(
                AGENTS,
                rng,
                mu=function,
                barrier=barrier,
                from_timestamp=from_timestamp,
                airspeed_error_as_printed=as_printed,
            )
            yield law, *states(AGENTS, rng, silence=0.15 if k % 3 == 0 else 0.0)


def test_the_formation_law():
    seen, deaf = {"guards": 0, "saturations": 0}, 0
    for law, own, inbox, memory in cases():
        ours = results(numpy_law.paper_step(law, 100.0, own, inbox, memory))
        theirs = results(formation_twin.paper_step(law, 100.0, own, inbox, memory))
        assert ours.keys() == theirs.keys()
        for name, array in ours.items():
            assert theirs[name].dtype == array.dtype, name
            np.testing.assert_array_equal(np.isnan(theirs[name]), np.isnan(array), err_msg=name)
            np.testing.assert_allclose(
                theirs[name], array, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name
            )
            kind = name.removeprefix("diagnosis.")
            if kind in seen:
                seen[kind] |= int(np.bitwise_or.reduce(array))
        deaf += int(np.isnan(inbox.stamp_s[:, 0]).sum())
    # the states reach every branch
    assert seen == {"guards": sum(Guard), "saturations": sum(Saturation)}
    assert deaf > 50


def test_true_slots_and_errors():
    rng = np.random.default_rng(41)
    for n in (1, 3, 40):
        position, offsets = rng.normal(0.0, 300.0, (2, n + 1, 3))
        velocity = velocities(rng, (n + 1,), 10.0, 35.0)
        ours = true_slots(position, velocity, offsets)
        theirs = geometry_twin.true_slots(position, velocity, offsets)
        for one, two in zip(ours, theirs, strict=True):
            assert two == pytest.approx(one, abs=1e-12)  # roundings of some 1e3 m


def test_euler_rates():
    rng = np.random.default_rng(42)
    euler, rates = rng.uniform(-1.4, 1.4, (500, 3)), rng.normal(0.0, 1.0, (500, 3))
    ours, theirs = euler_rates(euler, rates), vehicle_twin.euler_rates(euler, rates)
    assert theirs == pytest.approx(ours, rel=1e-13, abs=1e-14)


def test_no_twin_goes_without_such_a_test():
    """Two of them are compared where their rooms are tested."""
    found = set()
    for path in Path(testbed.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "twin_of":
                function, module = node.args
                assert hasattr(importlib.import_module(module.value), function.id)
                found.add(function.id)
    elsewhere = {"fbwa", "motion"}
    assert found == {"paper_step", "true_slots", "euler_rates"} | elsewhere
