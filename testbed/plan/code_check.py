"""Build the laws and functions of a scenario's user without its flight."""

from __future__ import annotations

from testbed.core.compile import registering
from testbed.core.errors import InputError
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.scenario import Scenario, code_references


def code_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the laws and functions of the user's in a scenario, and of options."""
    names = [name for _, name in code_references(scenario)]
    return (*names, *scenario.controller.options) if names else ()


@registering()
def check_code(scenario: Scenario) -> None:
    """Build the control of a scenario, with the checks of laws and functions of the user's.

    Scenarios without such code are not built.

    Raises:
        InputError: a module, class or function does not exist, does not accept its options, or
            breaks a rule. The text begins with the key or the file of the code.
    """
    if not code_names(scenario):
        return
    try:
        fleet, clock = resolve(scenario), build_clock(scenario)
    except InputError:  # of the scenario, not of the code: its flight says so
        return
    build_control(fleet, scenario.controller, clock)
