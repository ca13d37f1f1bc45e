"""Events of the separation filter: where it acts, and where what it relies on does not hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.flags import LimiterFlag, Saturation, flag_names
from testbed.core.records import Array, Event, Records, join_names

HOLD_S = 30.0  # a condition that was met within this time is not reported again
ROLLING_RADPS = 0.1  # roll rate of the leader from which a report names it
LIMITED, INSIDE, INFEASIBLE, AT_LIMIT = range(4)
_LIMITED = int(LimiterFlag.CLOSING_LIMITED)
_INSIDE = int(LimiterFlag.INSIDE_SEPARATION_MARGIN)
_INFEASIBLE = int(LimiterFlag.CLOSING_LIMITS_INFEASIBLE)
_SPEED = int(LimiterFlag.SPEED_DESIRED_CLAMPED | LimiterFlag.SPEED_COMMAND_CLIPPED)


class SeparationMonitor:
    """Report what the separation filters of n followers do.

    Args:
        names: of the N aircraft.
        aircraft: (N,) of AIRCRAFT.
        followers: (n,) of FOLLOWER.
        distance: (n,) m, separation plus margin.

    Attributes:
        call: after which `changes` is needed where it returns true.
    """

    def __init__(
        self, names: Sequence[str], aircraft: Records, followers: Records, distance: Array
    ) -> None:
        self._names, self._aircraft, self._followers = names, aircraft, followers
        self._distance = distance
        self._last_s = np.full((len(followers), AT_LIMIT + 1), -inf)
        self._new = np.zeros(self._last_s.shape, dtype=np.bool_)
        self.call = Call(find_conditions, followers, HOLD_S, self._last_s, self._new, NOW)

    def changes(self, now: float) -> Iterator[Event]:
        """Yield an event for each condition that is met anew.

        Args:
            now: s.
        """
        truth = self._aircraft["truth"]
        for i, kind in np.argwhere(self._new).tolist():
            away = np.linalg.norm(truth["position_ned"] - truth["position_ned"][i + 1], axis=1)
            away[i + 1] = inf
            nearest = int(np.argmin(away))
            level = "info" if kind == LIMITED else "warning"
            text = self._text(i, kind, f"{away[nearest]:.1f} m from {self._names[nearest]}")
            yield Event(now, level, self._names[i + 1], text)

    def _text(self, i: int, kind: int, where: str) -> str:
        follower = self._followers[i]
        if kind == LIMITED:
            return f"separation filter: closing is limited, {where}"
        if kind == INFEASIBLE:
            return f"separation filter: no velocity is within its bounds, {where}"
        if kind == AT_LIMIT:
            bits = zip(Saturation, flag_names(Saturation), strict=True)
            reached = [name for bit, name in bits if follower["saturations"] & bit]
            reached += ["speed"] if follower["limiter_flags"] & _SPEED else []
            return f"separation filter: limited while {join_names(reached)} is at a limit, {where}"
        rate = float(np.degrees(self._aircraft["truth"]["rates_body"][0, 0]))
        rolls = abs(rate) > np.degrees(ROLLING_RADPS)
        cause = f" while the leader rolls at {abs(rate):.0f} °/s" if rolls else ""
        return (
            f"separation filter: {where}, less than separation_m + margin_m, "
            f"{self._distance[i]:.4g} m{cause}: its velocity is not the desired one"
        )


@entry
def find_conditions(
    followers: Records, hold_s: float, last_s: Array, new: Array, now: float
) -> bool:
    """Write which conditions are met that have not been for a time; return whether one is.

    Args:
        followers: (n,) of FOLLOWER.
        hold_s: that time, s.
        last_s: (n, 4) s, times at which each was met; written.
        new: (n, 4); written.
        now: s.
    """
    found = False
    for i in range(len(followers)):
        flags, saturations = followers[i].limiter_flags, followers[i].saturations
        limited = flags & _LIMITED != 0
        met = (
            limited,
            flags & _INSIDE != 0,
            flags & _INFEASIBLE != 0,
            limited and (saturations != 0 or flags & _SPEED != 0),
        )
        for kind in range(len(met)):
            new[i, kind] = met[kind] and now - last_s[i, kind] > hold_s
            found = found or new[i, kind]
            if met[kind]:
                last_s[i, kind] = now
    return found
