"""When a companion commands its aircraft: a state machine without sockets and clocks.

The pilot engages it by the switch into GUIDED, and ends it by any other mode. It never arms. It
asks for one mode, that of leaving, once for each engagement, and only while GUIDED is still on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

from testbed.companion.checks import (
    REASONS,
    Case,
    Ending,
    EngagementLimits,
    Reason,
    find_reasons,
    fresh_mode,
)
from testbed.companion.flight_track import FlightTrack, largest
from testbed.companion.observation import HEARTBEAT, Observation
from testbed.mavlink.outgoing import Severity
from testbed.mavlink.vehicle_control import FlightMode

# A mode that is older may have been changed by the pilot's switch since: none is asked for by it.
FRESH_MODE_S = 0.3
# Later ArduPlane has left attitudes by itself, 3 s after the last one.
ASKING_S = 2.5
TEXT_EVERY_S = 2.0  # at most, of why it waits


class LeaveMode(IntEnum):
    """The mode that a companion asks for when it leaves, by ArduPlane's numbers."""

    RTL = 11  # returns to home or a rally point, at RTL_ALTITUDE
    LOITER = 12  # circles where it is, at its height


class EngagementState(Enum):
    """State of a companion; it commands in ENGAGED only."""

    WAITING = "waiting"  # something stands against engagement
    READY = "ready"  # the next switch into GUIDED engages it
    ENGAGED = "engaged"
    LEFT = "left"  # GUIDED is still on; the pilot must switch out of it first


class CompanionText(NamedTuple):
    """A STATUSTEXT for the ground station, and a line of the log."""

    severity: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Decision:
    """What a companion does after an observation.

    Attributes:
        state: from now on.
        command: whether commands are sent.
        change_mode: to ask the autopilot for, now; None: nothing is asked for.
        texts: to send and to log, in order.
        reasons: what stands against engagement, or has ended it, the first one first.
    """

    state: EngagementState
    command: bool
    change_mode: LeaveMode | None
    texts: tuple[CompanionText, ...]
    reasons: tuple[Reason, ...]


class Engagement:
    """Decide at each pass of a companion's loop whether it commands."""

    def __init__(self, limits: EngagementLimits, leave: LeaveMode = LeaveMode.LOITER) -> None:
        """Start disengaged, also where GUIDED is on already.

        Args:
            limits: of the flight.
            leave: mode that is asked for when it leaves.
        """
        self._limits, self._leave = limits, leave
        self._track = FlightTrack()
        self._state = EngagementState.WAITING
        self._reasons: tuple[Reason, ...] = ()
        self._sticks: tuple[float, ...] | None = None
        self._since: dict[Reason, float] = {}
        self._asks_until_s = -math.inf
        self._may_engage = False  # another mode than GUIDED was seen since it was last engaged
        self._reported: Reason | None = None
        self._reported_s = -math.inf
        self._compared = False

    def step(self, seen: Observation) -> Decision:
        """Take an observation, at each pass of the loop and at least every `pause_s`."""
        self._track.add(seen)
        before = self._state
        texts = self._engaged(seen) if before is EngagementState.ENGAGED else self._idle(seen)
        ask = self._ask_mode(seen)
        command = self._state is EngagementState.ENGAGED
        return Decision(self._state, command, ask, tuple(texts), self._reasons)

    @property
    def may_end(self) -> bool:
        """Whether the process may end: not engaged, and no mode is to be asked for."""
        return self._state is not EngagementState.ENGAGED and math.isinf(self._asks_until_s)

    def _case(self, seen: Observation) -> Case:
        return Case(self._limits, seen, self._track, self._sticks)

    def _engaged(self, seen: Observation) -> list[CompanionText]:
        """Leave, if a reason has lasted."""
        if self._sticks is None:
            self._sticks = seen.sticks_us
        found = find_reasons(self._case(seen), engaged=True)
        self._since = {each: self._since.get(each, seen.now_s) for each in found}
        lasting = {
            each: text
            for each, text in found.items()
            if seen.now_s - self._since[each] >= REASONS[each].lasts_s
        }
        self._reasons = tuple(lasting)
        if not lasting:
            return []
        self._state, self._sticks, self._may_engage = EngagementState.LEFT, None, False
        if all(REASONS[each].ending is Ending.ASKS_MODE for each in lasting):
            self._asks_until_s = seen.now_s + ASKING_S
        first = next(iter(lasting))
        severity = Severity.INFO if first is Reason.PILOT_MODE else Severity.ERROR
        return [CompanionText(severity, f"formation left: {lasting[first]}")]

    def _idle(self, seen: Observation) -> list[CompanionText]:
        """Wait, become ready, or engage by the pilot's switch."""
        case = self._case(seen)
        mode, found = fresh_mode(case), find_reasons(case, engaged=False)
        texts = self._heights(seen)
        if mode is None:  # what the pilot has switched meanwhile is not known
            self._may_engage = False
            self._state = EngagementState.WAITING
        elif mode != FlightMode.GUIDED:
            self._may_engage, self._asks_until_s = True, -math.inf
            texts += self._wait_or_be_ready(found)
        elif self._may_engage and not found:
            return [*texts, self._engage(seen)]
        elif self._state is EngagementState.LEFT:
            return texts  # with the reasons that it has left for
        else:
            why = next(iter(found.values())) if self._may_engage else "GUIDED was on already"
            self._state, self._may_engage = EngagementState.LEFT, False
            texts.append(CompanionText(Severity.WARNING, f"formation refused: {why}"))
        self._reasons = tuple(found)
        if self._state is EngagementState.WAITING:
            texts += self._waiting(seen.now_s, found)
        return texts

    def _wait_or_be_ready(self, found: dict[Reason, str]) -> list[CompanionText]:
        was, self._state = self._state, EngagementState.WAITING
        if found:
            return []
        self._state, self._reported = EngagementState.READY, None
        if was is EngagementState.READY:
            return []
        return [CompanionText(Severity.INFO, "formation ready: GUIDED engages it")]

    def _engage(self, seen: Observation) -> CompanionText:
        self._state, self._may_engage = EngagementState.ENGAGED, False
        self._sticks, self._reasons, self._since = seen.sticks_us, (), {}
        self._asks_until_s = -math.inf
        return CompanionText(Severity.INFO, "formation engaged")

    def _waiting(self, now_s: float, found: dict[Reason, str]) -> list[CompanionText]:
        """Report why it waits: each reason once, until another is the first."""
        first = next(iter(found), None)
        if (
            first in (None, Reason.STOPPING, self._reported)
            or now_s - self._reported_s < TEXT_EVERY_S
        ):
            return []
        self._reported, self._reported_s = first, now_s
        return [CompanionText(Severity.WARNING, f"formation waits: {found[first]}")]

    def _heights(self, seen: Observation) -> list[CompanionText]:
        """Report once that the heights of all aircraft were compared on the ground."""
        heights = self._track.heights_m
        if self._compared or not set(self._limits.used) <= heights.keys():
            return []
        self._compared = True
        name, apart = largest(heights)
        text = f"heights compared: {name} {-apart:+.1f} m"
        return [CompanionText(Severity.INFO, text)]

    def _ask_mode(self, seen: Observation) -> LeaveMode | None:
        """Return the mode of leaving, once, if GUIDED is on by a HEARTBEAT of just now."""
        pending = seen.now_s <= self._asks_until_s
        if pending and seen.age_s(HEARTBEAT) > FRESH_MODE_S:
            return None
        self._asks_until_s = -math.inf
        return self._leave if pending and seen.mode == FlightMode.GUIDED else None
