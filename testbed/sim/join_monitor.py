"""Report which followers have joined the formation: held their slots for some time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from math import sqrt

import numpy as np

from testbed.core.compile import Kernel, entry
from testbed.core.records import Event, Records, allocate
from testbed.metrics.accumulator import JOIN_HOLD_S, JOIN_RADIUS_M

# What is known of one follower.
JOIN = np.dtype(
    [
        ("since", "i8"),  # tick from which it has been in its slot; -1: it is not
        ("joined", "?"),  # it has held its slot for long enough
    ],
    align=True,
)


class JoinMonitor:
    """Report followers that join the formation, by the rule of the metrics.

    Args:
        names: of the n followers.
        base_rate_hz: of the ticks.
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
    """

    def __init__(
        self, names: Sequence[str], base_rate_hz: int, aircraft: Records, followers: Records
    ) -> None:
        """See the class."""
        self._names, self._rate_hz = names, base_rate_hz
        self._joins = allocate(JOIN, len(names))
        self._joins["since"] = -1
        hold_ticks = JOIN_HOLD_S * base_rate_hz
        self._find_joined = partial(find_joined, aircraft, followers, hold_ticks, self._joins)
        self._all_joined = not len(names)

    def changes(self, tick: int) -> Iterator[Event]:
        """Return an event for each follower that has held its slot for long enough, once in a run.

        Args:
            tick: of the base rate.
        """
        if self._all_joined:
            return
        before = self._joins["joined"].copy()
        if not self._find_joined(tick):
            return
        for i in np.flatnonzero(self._joins["joined"] & ~before).tolist():
            since = f"{self._joins['since'][i] / self._rate_hz:.1f} s"
            text = f"joined: within {JOIN_RADIUS_M:g} m of its slot since {since}"
            yield Event(tick / self._rate_hz, "info", self._names[i], text)
        self._all_joined = bool(self._joins["joined"].all())

    def kernels(self) -> list[Kernel]:
        """Return the compiled calls of `changes`, for `core.compile.prepare`."""
        return [partial(self._find_joined, 0)]


@entry
def find_joined(
    aircraft: Records, followers: Records, hold_ticks: float, joins: Records, tick: int
) -> bool:
    """Write which followers have joined; return whether one has at this tick.

    Args:
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
        hold_ticks: how long a follower has to stay in its slot.
        joins: (n,) of JOIN; written.
        tick: of the base rate.
    """
    new = False
    for i in range(len(followers)):
        x, y, z = followers[i].error_ned
        inside = sqrt(x * x + y * y + z * z) <= JOIN_RADIUS_M
        join = joins[i]
        if aircraft[0].lost or aircraft[i + 1].lost or not inside:
            join.since = -1
        else:
            if join.since < 0:
                join.since = tick
            if not join.joined and tick - join.since >= hold_ticks:
                join.joined = new = True
    return new
