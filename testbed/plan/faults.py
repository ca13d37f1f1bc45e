"""Build the faults of a scenario, and the formation's responses to them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.flight.faults import FaultManager, describe_fault
from testbed.flight.membership import FormationMembership
from testbed.plan.fleet import Fleet, FormationPlan, unreachable_agents
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.arguments import with_changes
from testbed.scenario.control import BUILT_IN, OnFailure
from testbed.scenario.faults import AnyFault, GpsJump, GpsLost
from testbed.scenario.set_keys import read_all
from testbed.sensors.estimators import has_filter
from testbed.vehicle.fleet import FlightModels


def build_faults(
    fleet: Fleet, models: FlightModels | None, response: OnFailure
) -> FaultManager | None:
    """Build the faults of a fleet; None if it has none.

    Args:
        fleet: the N aircraft.
        models: its JSBSim models.
        response: to failures; when they are declared.

    Raises:
        InputError: an aircraft has no part for its fault.
    """
    aircraft, names = [each.section for each in fleet.aircraft], fleet.names
    faults = [[_as_declared(one, each) for one in each.faults] for each in aircraft]
    if not any(faults):
        return None
    for one in (fault for each in aircraft for fault in each.faults):
        read_all(one)
    if models is not None:
        for model, row in enumerate(fleet.model_rows):
            models.check_faults(model, names[row], faults[row])
    return FaultManager(
        names,
        faults,
        response.declared_after_s,
        lambda row, fault: _has_effect(fault, aircraft[row]),
    )


def build_membership(
    fleet: FormationPlan, response: OnFailure, law: str, faults: FaultManager | None
) -> FormationMembership | None:
    """Build the responses to declared failures; None if there are none.

    Raises:
        InputError: the law does not support the response.
    """
    if faults is None or response.response == "ignore":
        return None
    reassigns = response.response == "reassign-slots"
    if reassigns and law != BUILT_IN:
        raise InputError(
            "formation.on_failure.response: reassign-slots moves the paper's law to other slots, "
            f"and the law is {law} (write drop, or law: hbh23)"
        )
    return FormationMembership(
        fleet.names,
        fleet.offsets,
        fleet.weights,
        faults,
        response.clearance_m if reassigns else None,
    )


def _as_declared(fault: AnyFault, aircraft: AircraftSection) -> AnyFault:
    """Return the fault; one without effect is not declared."""
    return fault if _has_effect(fault, aircraft) else with_changes(fault, declared=False)


def _has_effect(fault: AnyFault, aircraft: AircraftSection) -> bool:
    return not isinstance(fault, GpsLost | GpsJump) or has_filter(aircraft.sensors)


def fault_warnings(fleet: FormationPlan, response: OnFailure) -> Iterator[Event]:
    """Warn of faults without effect, and of failures that leave others without a reference."""
    for each in (aircraft.section for aircraft in fleet.aircraft):
        for fault in each.faults:
            if not _has_effect(fault, each):
                text = (
                    f"{describe_fault(fault)}: has no effect, because the estimate uses no GPS "
                    "(write sensors: pixhawk, for example)"
                )
                yield Event(0.0, "warning", each.name, text)
    if response.response != "ignore":
        yield from _reference_warnings(fleet)


def _reference_warnings(fleet: FormationPlan) -> Iterator[Event]:
    """Warn of followers without a position reference once a failed one is excluded."""
    names, holds_altitude = fleet.names[1:], ~np.isnan(fleet.altitudes)
    for failed, follower in enumerate(each.section for each in fleet.followers):
        if any(_as_declared(fault, follower).is_declared for fault in follower.faults):
            others = [i for i in range(len(names)) if i != failed]
            remaining = fleet.weights[np.ix_(others, [0, *(i + 1 for i in others)])]
            for i in unreachable_agents(remaining, holds_altitude[others]):
                text = (
                    f"without {names[failed]} it has no position reference: write a leader gain "
                    "for it, or response: ignore"
                )
                yield Event(0.0, "warning", names[others[i]], text)
