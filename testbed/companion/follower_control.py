"""Law, middle loop, extrapolation and limits of one follower of a scenario, without a world.

These are the compiled steps of a run, for one row of its records. What flies the aircraft, the
other followers and the radio are somewhere else.
"""

from __future__ import annotations

import math

import numpy as np

from testbed.airframes.metrics import read_wingspan
from testbed.core.call_list import NOW, Call, run_steps
from testbed.core.compile import prepare, registered, registering
from testbed.core.errors import InputError
from testbed.core.geodetic import local_frame
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    LINK,
    MESSAGE,
    Airframe,
    Messages,
    Record,
    Records,
    allocate,
    join_names,
)
from testbed.core.saved_state import SavedState
from testbed.flight.control import BuiltControl, Control, LawSurroundings
from testbed.flight.law_inputs import declared_faults, wind_estimates
from testbed.flight.law_reports import LawReports
from testbed.flight.own_state import (
    ATTITUDE_TARGET,
    IMU,
    OWN_STATE,
    VELOCITY,
    decode_own_states,
    encode_attitude_targets,
)
from testbed.flight.steps import write_messages
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
        rate_hz: of control steps.
        clock: of a run of the scenario.
        aircraft: (N,) of AIRCRAFT; `estimate` of the own row is read, `control` of it written.
        followers: (n,) of FOLLOWER; the own row is written.
        links: (n, N) of LINK; the own row has the messages of the others.
        acceleration: source of the own one, see `decode_own_states`.
        used: rows of the aircraft whose messages the law uses.
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
            raise InputError(
                f"--as {name}: no aircraft of the scenario (write one of {join_names(names)})"
            )
        if self.plan.aircraft[names.index(name)].is_ideal:
            raise InputError(
                f"--as {name}: an ideal vehicle takes no attitudes (write vehicle: jsbsim)"
            )
        self.row = names.index(name)
        imu = scenario.controller.companion.acceleration == "imu"
        self.acceleration = IMU if imu else VELOCITY
        n = len(names)
        self.clock = clock = build_clock(scenario)
        self.rate_hz = clock.base_rate_hz / clock.control
        own = self.row - 1
        with registering():
            self.aircraft, self.followers = allocate(AIRCRAFT, n), allocate(FOLLOWER, n - 1)
            self.links = allocate(LINK, n - 1, n)
            self.forget()
            self.built: BuiltControl = build_control(
                self.plan, scenario.controller, clock, [(own,)] if self.row else []
            )
            self._bind_messages()
            self._control = self._make_control() if self.row else None
            self._steps = () if self._control is None else self._control.steps(0)
            self._begin = SavedState(steps=self._steps, control=self._control)
            prepare(registered())
        self._decode(0.0)  # the first call from Python is slower than others
        used = self.built.neighbours["used"][own] if self.row else np.zeros(n, dtype=bool)
        self.used = tuple(m for m in np.flatnonzero(used).tolist() if m != self.row)

    def _bind_messages(self) -> None:
        """Bind what reads and writes the fields of MAVLink messages."""
        n, rows = len(self.aircraft), np.array([self.row], dtype=np.intp)
        frame = local_frame(self.plan.origin)
        self._own_states, before = allocate(OWN_STATE, n), allocate(OWN_STATE, n)
        self._messages, self._targets = allocate(MESSAGE, n), allocate(ATTITUDE_TARGET, n)
        unplanned, sent_s = np.full(n, np.nan), np.zeros(n)
        states = rows, self._own_states, before, frame, self.acceleration, self.aircraft
        self._decode = Call(decode_own_states, *states)
        self._write = Call(write_messages, self.aircraft, self._messages, unplanned, sent_s, NOW)
        self._encode = Call(encode_attitude_targets, rows, self.aircraft, self._targets)

    def _make_control(self) -> Control:
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
        self.reports = LawReports(names[1:], outputs, np.full((n, 0), np.nan))
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
                np.full((n - 1, n, 0), np.nan),
                self.reports,
            ),
            extrapolates=built.extrapolates,
        )

    @property
    def own(self) -> Record:
        """Record of AIRCRAFT of the own aircraft."""
        return self.aircraft[self.row]

    @property
    def inbox(self) -> Records:
        """(N,) of LINK: the newest message of each aircraft; of a leader without use."""
        found: Records = self.links[max(self.row - 1, 0)]
        return found

    def forget(self) -> None:
        """Forget all messages of others."""
        for field in (*Messages._fields, "measured_s"):
            self.links[field] = np.nan
        self.links["number"] = NO_MESSAGE

    def take_own_state(self, own_state: Records, ahead_s: float = 0.0) -> None:
        """Decode the own state into `estimate`.

        Args:
            own_state: (1,) of OWN_STATE.
            ahead_s: from its position to the time of its attitude, s; the position moves along the
                velocity.
        """
        self._own_states[self.row] = own_state[0]
        self._decode(0.0)
        if ahead_s:
            estimate = self.own["estimate"]
            estimate["position_ned"] += ahead_s * estimate["velocity_ned"]

    def message(self, now: float) -> Records:
        """Return what the aircraft broadcasts, (1,) of MESSAGE, at a time, s."""
        self._write(now)
        found: Records = self._messages[self.row : self.row + 1]
        return found

    def step(self, now: float) -> None:
        """Step law and middle loop at a time, s: `estimate` and `inbox` become `control`.

        Raises:
            FlightError: a user's law failed.
        """
        run_steps(self._steps, now)

    def target(self) -> Record:
        """Return `control` as an attitude target, a record of ATTITUDE_TARGET."""
        self._encode(0.0)
        return self._targets[self.row]

    def restart(self) -> None:
        """Let the law begin as before its first step; own state and messages stay."""
        kept = [(each, each.copy()) for each in (self.aircraft, self.links)]
        self._begin.restore()
        for array, now in kept:
            array[:] = now
