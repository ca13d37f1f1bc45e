"""What a formation law is to the rest of the testbed.

A law steps n followers at once, each from what it knows itself: its own estimate and the messages
it has received. It answers with the inputs of the extended unicycle, which the middle loop turns
into a fly-by-wire-A command, or with that command itself. What it remembers is a value that goes
in and comes out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, FbwaCommand, Flags, Inbox, UnicycleCommand, VehicleState


@dataclass(frozen=True, slots=True)
class Team:
    """What a law is told when it is built: the followers it steps, and what they are to do."""

    names: tuple[str, ...]  # n followers
    agents: NDArray[np.intp]  # (n,) their rows among the N aircraft; the leader's is 0
    offsets: Array  # υ (N, 3) m: forward, right, down in the leader's velocity frame; leader zero
    gains: Array  # (n, N, 3) β_i in column 0, β_ij behind it, per axis of NED
    speed_low: Array  # (n,) m/s, bounds of the ground speed
    speed_high: Array  # (n,) m/s
    speed_pole: Array  # (n,) 1/s, p of the speed model ṡ = p (u − s)
    pitch_limit: Array  # (n,) rad, of the fly-by-wire-A command
    roll_limit: Array  # (n,) rad
    trim_throttle: Array  # (n,) 0..1, for level flight at trim_airspeed
    trim_airspeed: Array  # (n,) m/s
    dt: float  # s, between two steps of the same follower
    silent_after: float  # s without news of the leader, after which not to reckon with it
    stale_after: float  # the same of a neighbour
    # The paper's law with the page's gains, for a law that changes it rather than replaces it.
    paper: Law | None = None


class Law(Protocol):
    """A formation law of n followers."""

    def start(self, own: VehicleState) -> Any:  # noqa: ANN401 - the law's own
        """The memory before the first step; own: the followers' first estimates (n)."""

    def step(
        self,
        now: float,
        own: VehicleState,
        inbox: Inbox,
        memory: Any,  # noqa: ANN401
    ) -> tuple[UnicycleCommand | FbwaCommand, Any]:
        """One control step at the time `now` (s) from what each agent knows; arrays (n, …)."""


class Diagnosis(NamedTuple):
    """What the followers' control was after, for the log; every array (n,)."""

    speed_desired: Array  # m/s; not a number where the law did not say
    speed_command: Array  # commanded airspeed, m/s
    course_desired: Array  # rad
    flight_path_angle_desired: Array  # rad
    guards: Flags
    saturations: Flags
