"""What of a scenario is worth a warning before it flies on aircraft."""

from __future__ import annotations

from collections.abc import Iterator

from testbed.scenario import Scenario

# In a corner at 42° of bank a neighbour that falls silent moves a follower of Simulation 3 by 1.7 m
# with a timeout of 1 s, by 4 m with 2 s and by 13 m with 5 s.
LONGEST_NEIGHBOUR_S = 1.0


def scenario_warnings(scenario: Scenario) -> Iterator[str]:
    """Return warnings for the start of a companion, with what to write instead."""
    controller = scenario.controller
    neighbour_s = controller.neighbour_timeout_s
    if neighbour_s is None:
        neighbour_s = controller.leader_timeout_s
    uses = any(scenario.formation.neighbour_gains.values())
    if uses and neighbour_s > LONGEST_NEIGHBOUR_S:
        yield (
            f"controller.neighbour_timeout_s: an aircraft that falls silent is extrapolated for "
            f"{neighbour_s:g} s, in a turn by many metres (write controller.neighbour_timeout_s: "
            f"{LONGEST_NEIGHBOUR_S:g})"
        )
    age_s = controller.companion.flight.leader_age_s
    if controller.leader_timeout_s < age_s:
        yield (
            f"controller.leader_timeout_s is {controller.leader_timeout_s:g} s: the law flies "
            f"{controller.on_leader_timeout} before the companion leaves the formation, at "
            f"controller.companion.flight.leader_age_s of {age_s:g} s (write a lower age)"
        )
    if controller.safety is None:
        yield "controller.safety: nothing keeps aircraft apart (there is a filter for that)"
