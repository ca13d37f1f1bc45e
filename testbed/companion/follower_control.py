"""Law, middle loop, extrapolation and limits of one follower of a scenario, without a world.

These are the compiled steps of a run, for one row of its records. What flies the aircraft, the
other followers and the radio are somewhere else.
"""

from __future__ import annotations

import math

import numpy as np

from testbed.airframes.metrics import read_wingspan
from testbed.core.call_list import run_steps
from testbed.core.compile import prepare, registered, registering
from testbed.core.errors import InputError
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    LINK,
    Airframe,
    Messages,
    Record,
    Records,
    allocate,
    join_names,
)
from testbed.flight.control import BuiltControl, Control, LawSurroundings
from testbed.flight.law_inputs import declared_faults, wind_estimates
from testbed.flight.law_reports import LawReports
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.fleet import FormationPlan, plan_formation
from testbed.scenario import Scenario

NO_MESSAGE = -1  # in LINK.number


def plan_without_jsbsim(scenario: Scenario) -> FormationPlan:
    """Read the files of all aircraft; of airframes the wingspan alone is known.

    Raises:
        ScenarioError, ParamError, AircraftError: see `plan_formation`.
    """
    unknown = math.nan
    return plan_formation(
        scenario,
        lambda folder: Airframe(read_wingspan(folder), unknown, unknown, unknown, unknown),
    )


class FollowerControl:
    """The control of one aircraft of a formation.

    Attributes:
        plan: of all aircraft.
        name: of the aircraft.
        row: among the N aircraft; 0 is the leader, which has no law.
        dt: between control steps, s.
        aircraft: (N,) of AIRCRAFT; `estimate` of the own row is read, `control` of it written.
        followers: (n,) of FOLLOWER; the own row is written.
        links: (n, N) of LINK; the own row has the messages of the others.
        built: control of the n followers before the first step.
    """

    def __init__(self, scenario: Scenario, name: str) -> None:
        """Build the control of an aircraft, and compile or load its machine code.

        Args:
            scenario: that is flown.
            name: of the aircraft.

        Raises:
            InputError: the scenario cannot be flown, or has no such aircraft.
        """
        self.plan = plan_without_jsbsim(scenario)
        self.name, names = name, self.plan.names
        if name not in names:
            raise InputError(f"--as {name}: no aircraft of the scenario; write {join_names(names)}")
        if self.plan.aircraft[names.index(name)].is_ideal:
            raise InputError(
                f"--as {name}: an ideal vehicle takes no attitudes (write vehicle: jsbsim)"
            )
        self.row = names.index(name)
        n = len(names)
        clock = build_clock(scenario)
        self.dt = clock.control / clock.base_rate_hz
        own = self.row - 1
        with registering():
            self.aircraft, self.followers = allocate(AIRCRAFT, n), allocate(FOLLOWER, n - 1)
            self.links = allocate(LINK, n - 1, n)
            for field in (*Messages._fields, "measured_s"):
                self.links[field] = np.nan
            self.links["number"] = NO_MESSAGE
            self.built: BuiltControl = build_control(
                self.plan, scenario.controller, clock, [(own,)] if self.row else []
            )
            self._steps = () if not self.row else self._control().steps(0)
            prepare(registered())
        used = self.built.neighbours["used"][own] if self.row else np.zeros(n, dtype=bool)
        self.used = tuple(m for m in np.flatnonzero(used).tolist() if m != self.row)

    def _control(self) -> Control:
        """Return what steps the own row."""
        built, names = self.built, self.plan.names
        outputs = built.outputs
        if outputs.sent_numbers:
            raise InputError(
                f"controller.law: it sends {outputs.sent_numbers} numbers of its own in each "
                "message, and FOLLOW_TARGET between companions has no place for them (write a law "
                "without `sent`)"
            )
        n = len(names)
        payloads = np.full((n - 1, n, 0), np.nan)
        return Control(
            built.groups,
            built.controllers,
            built.neighbours,
            self.plan.offsets,
            None,
            (self.aircraft, self.followers, self.links),
            LawSurroundings(
                wind_estimates(None, self.aircraft),
                declared_faults(None),
                payloads,
                LawReports(names[1:], outputs, np.full((n, 0), np.nan)),
            ),
            extrapolates=built.extrapolates,
        )

    @property
    def own(self) -> Record:
        """Record of AIRCRAFT of the own aircraft."""
        return self.aircraft[self.row]

    @property
    def inbox(self) -> Records:
        """(N,) of LINK: the newest message of each aircraft."""
        found: Records = self.links[self.row - 1]
        return found

    def step(self, now: float) -> None:
        """Step law and middle loop at a time, s: `estimate` and `inbox` become `control`.

        Raises:
            FlightError: a user's law failed.
        """
        run_steps(self._steps, now)
