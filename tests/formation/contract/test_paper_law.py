"""The law from plain numbers: that of a scenario with the defaults, and refusals."""

import numpy as np
import pytest

from testbed.core.errors import InputError
from testbed.formation.paper_law import make_paper_law
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.scenario import load_scenario

OFFSETS = [[-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0], [-5.0, -5.0, 4.0]]
GAINS = [[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0]]


def test_law_is_that_of_a_scenario_with_defaults():
    """Ideal vehicles have the paper's pole and no profile of an airframe."""
    default = "{k: 3, control_function: {example: 1, nu1: 50, nu2: 1, m: 0.5}}"
    changes = [f"formation.agents={{uav1: {default}, uav2: {default}, uav3: {default}}}"]
    changes += ["formation.barrier={example: 5, nu: 0.05}", "formation.speed_pole_per_s=0.64"]
    changes += ["controller.estimators.leader_angular_acceleration=none"]
    scenario = load_scenario("ideal-figure-eight", changes)
    built = build_control(resolve(scenario), scenario.controller, build_clock(scenario))
    law, expected = make_paper_law(OFFSETS, GAINS), built.controllers["law"]
    estimates = ("acceleration_blend", "difference_blend", "turn_rate_blend")
    for name in expected.dtype.names:
        if name not in (*estimates, "lost_leader_turn_rate"):
            np.testing.assert_array_equal(law.law[name], expected[name], err_msg=name)
    for name in built.neighbours.dtype.names:
        np.testing.assert_array_equal(law.neighbours[name], built.neighbours[name], err_msg=name)


@pytest.mark.parametrize(
    ("offsets", "gains", "keys", "said"),
    [
        ([[0.0, 0.0]], [[1.0, 0.0]], {}, r"write \(n, 3\) and \(n, n \+ 1\)"),
        (OFFSETS, GAINS[:2], {}, r"write \(n, 3\) and \(n, n \+ 1\)"),
        (OFFSETS, GAINS, {"k": 4.0}, "k 4 m/s is not below"),
    ],
)
def test_wrong_numbers_are_refused(offsets, gains, keys, said):
    with pytest.raises(InputError, match=said):
        make_paper_law(offsets, gains, **keys)
