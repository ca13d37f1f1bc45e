"""Interface of a formation law.

A law steps n followers at once, each from its own estimate and the messages that it has received.
It returns the inputs of the extended unicycle, which the middle loop turns into a fly-by-wire-A
command, or that command itself. Its memory is an argument and a return value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import InputError
from testbed.core.field_docs import document_fields
from testbed.core.records import Array, FbwaCommand, Inbox, OwnState, UnicycleCommand

OLD_BOUNDS = (
    "is no bound of the ground speed here: in wind the bounds are those of the airspeed (write "
    "config.airspeed_min and airspeed_max, or ground_speed_bounds(config, own) for bounds of a "
    "speed over the ground)"
)


@document_fields
@dataclass(frozen=True, slots=True)
class FormationConfig:
    """The followers that a law steps, with slots, gains and limits."""

    names: tuple[str, ...]  # n followers
    agents: NDArray[np.intp]  # (n,) their rows among the N aircraft; the leader's is 0
    offsets: Array  # υ (N, 3) m: forward, right, down in the leader's velocity frame; leader zero
    gains: Array  # (n, N, 3) β_i in column 0, β_ij behind it, per axis of NED
    airspeed_min: Array  # (n,) m/s, lower bound of the airspeed
    airspeed_max: Array  # (n,) m/s, upper bound
    ground_speed_min: Array  # (n,) m/s, lower bound of the ground speed; 0: none
    ground_speed_max: Array  # (n,) m/s, upper bound; infinite: none
    speed_pole: Array  # (n,) 1/s, p of the speed model ṡ = p (u − s)
    pitch_limit: Array  # (n,) rad, of the fly-by-wire-A command
    roll_limit: Array  # (n,) rad
    trim_throttle: Array  # (n,) 0..1, for level flight at trim_airspeed
    trim_airspeed: Array  # (n,) m/s
    dt: float  # s, between two steps of the same follower
    leader_timeout_s: float  # s since the last message, after which the leader is not used
    neighbour_timeout_s: float  # s, the same for a neighbour
    hbh23: Law | None = None  # the built-in law with the scenario's gains, to extend or wrap

    @property
    def speed_min(self) -> Array:
        """(n,) m/s, `airspeed_min` in flights without wind; for laws of older releases.

        Raises:
            InputError: the bounds are not those of the ground speed.
        """
        return self._of_both("speed_min", self.airspeed_min)

    @property
    def speed_max(self) -> Array:
        """(n,) m/s, `airspeed_max`; see `speed_min`."""
        return self._of_both("speed_max", self.airspeed_max)

    def _of_both(self, name: str, bounds: Array) -> Array:
        if not self.bounds_ground_speed:
            raise InputError(f"config.{name} {OLD_BOUNDS}")
        return bounds

    @property
    def bounds_ground_speed(self) -> bool:
        """Whether the ground speed has bounds, as it has in flights without wind."""
        return bool(np.isfinite(self.ground_speed_max).all())


class Law(Protocol):
    """A formation law of n followers."""

    def start(self, own: OwnState) -> Any:  # noqa: ANN401 - the law's own
        """Return the memory before the first step, from the followers' first estimates (n)."""

    def step(
        self,
        now: float,
        own: OwnState,
        inbox: Inbox,
        memory: Any,  # noqa: ANN401
    ) -> tuple[UnicycleCommand | FbwaCommand[Array], Any]:
        """Compute a control step at the time `now` (s); return command (n) and memory."""
