"""Build the faults of a scenario, and the formation's responses to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.scenario import Scenario
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.arguments import with_changes
from testbed.scenario.faults import AnyFault, GpsJump, GpsLost
from testbed.sensors.estimators import has_filter
from testbed.sim.build_control import (
    build_altitudes,
    build_gains,
    build_offsets,
    unreachable_agents,
)
from testbed.sim.faults import FaultManager, describe_fault
from testbed.sim.membership import FormationMembership
from testbed.vehicle.fleet import JsbsimFleet


def build_faults(
    scenario: Scenario, fleet: JsbsimFleet | None, rows: Sequence[int]
) -> FaultManager | None:
    """Build the faults of a scenario; None if it has none.

    Args:
        scenario: as resolved.
        fleet: JSBSim models.
        rows: of these among the aircraft.

    Raises:
        InputError: an aircraft has no part for its fault.
    """
    faults = [[_as_declared(one, each) for one in each.faults] for each in scenario.aircraft]
    if not any(faults):
        return None
    names = scenario.aircraft_names
    if fleet is not None:
        for model, row in enumerate(rows):
            fleet.check_faults(model, names[row], faults[row])
    aircraft = scenario.aircraft
    return FaultManager(
        names,
        faults,
        scenario.formation.on_failure.declared_after_s,
        lambda row, fault: _has_effect(fault, aircraft[row]),
    )


def build_membership(scenario: Scenario, faults: FaultManager | None) -> FormationMembership | None:
    """Build the responses to declared failures; None if there are none.

    Raises:
        InputError: the law does not support the response.
    """
    response = scenario.formation.on_failure.response
    if faults is None or response == "ignore":
        return None
    if response == "reassign-slots" and scenario.controller.law != "hbh23":
        raise InputError(
            "formation.on_failure.response: reassign-slots moves the paper's law to other slots, "
            f"and the law is {scenario.controller.law} (write drop, or law: hbh23)"
        )
    return FormationMembership(
        scenario.aircraft_names,
        build_offsets(scenario),
        build_gains(scenario),
        faults,
        scenario.formation.on_failure.clearance_m if response == "reassign-slots" else None,
    )


def _as_declared(fault: AnyFault, aircraft: Leader | Follower) -> AnyFault:
    """Return the fault; one without effect is not declared."""
    return fault if _has_effect(fault, aircraft) else with_changes(fault, declared=False)


def _has_effect(fault: AnyFault, aircraft: Leader | Follower) -> bool:
    return not isinstance(fault, GpsLost | GpsJump) or has_filter(aircraft.sensors)


def fault_warnings(scenario: Scenario) -> Iterator[Event]:
    """Warn of faults without effect, and of failures that leave others without a reference."""
    for each in scenario.aircraft:
        for fault in each.faults:
            if not _has_effect(fault, each):
                text = (
                    f"{describe_fault(fault)}: has no effect, because the estimate uses no GPS "
                    "(write sensors: pixhawk, for example)"
                )
                yield Event(0.0, "warning", each.name, text)
    yield from _reference_warnings(scenario)


def _reference_warnings(scenario: Scenario) -> Iterator[Event]:
    """Warn of followers without a position reference once a failed one is excluded."""
    if scenario.formation.on_failure.response == "ignore":
        return
    gains, names = build_gains(scenario), [each.name for each in scenario.fleet]
    holds_altitude = ~np.isnan(build_altitudes(scenario))
    for failed, follower in enumerate(scenario.fleet):
        if any(_as_declared(fault, follower).is_declared for fault in follower.faults):
            others = [i for i in range(len(names)) if i != failed]
            remaining = gains[np.ix_(others, [0, *(i + 1 for i in others)])]
            for i in unreachable_agents(remaining, holds_altitude[others]):
                text = (
                    f"without {names[failed]} it has no position reference: write a leader gain "
                    "for it, or response: ignore"
                )
                yield Event(0.0, "warning", names[others[i]], text)
