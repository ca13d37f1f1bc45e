"""The aircraft of a scenario, whose airframes JSBSim measures."""

from __future__ import annotations

from testbed.plan.fleet import Fleet, FormationPlan, plan_formation, plan_single
from testbed.scenario import Scenario, SingleAircraft, find_aircraft
from testbed.vehicle.jsbsim_adapter import airframe, probe_airframes


def resolve(scenario: Scenario) -> FormationPlan:
    """Read the files of all aircraft of a scenario, and solve for the formation's gains.

    Raises:
        ScenarioError, ParamError, AircraftError: a folder has no valid aircraft, parameters or
            gains; or a follower has no position reference.
    """
    probe_airframes([find_aircraft(each.aircraft) for each in scenario.aircraft])
    return plan_formation(scenario, airframe)


def resolve_single(flight: SingleAircraft) -> Fleet:
    """Read the files of one aircraft that flies without a formation.

    Raises:
        ScenarioError, ParamError, AircraftError: see `resolve`.
    """
    return plan_single(flight, airframe)
