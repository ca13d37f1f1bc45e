"""Warnings about a scenario before it flies."""

import pytest

from testbed.companion.scenario_warnings import scenario_warnings
from testbed.scenario import load_scenario

SAFE = (
    "controller.neighbour_timeout_s=1",
    "controller.safety={kind: barrier, separation_m: 3, margin_m: 1}",
)


def warned(*settings):
    """The keys that are warned of."""
    found = scenario_warnings(load_scenario("simulation-3", [*SAFE, *settings]))
    return [text.partition(":")[0].split(" is ")[0] for text in found]


@pytest.mark.parametrize(
    ("settings", "keys"),
    [
        ([], []),
        (["controller.neighbour_timeout_s=1.1"], ["controller.neighbour_timeout_s"]),
        (["controller.neighbour_timeout_s=null"], ["controller.neighbour_timeout_s"]),
        (["controller.leader_timeout_s=0.9"], ["controller.leader_timeout_s"]),
        (["controller.safety=null"], ["controller.safety"]),
    ],
)
def test_scenario_is_warned_of_what_costs_metres(settings, keys):
    assert warned(*settings) == keys


def test_timeout_of_unused_neighbours_is_no_warning():
    alone = "formation.neighbour_gains={}"
    assert warned(alone, "controller.neighbour_timeout_s=5") == []
