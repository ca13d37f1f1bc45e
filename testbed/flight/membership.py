"""Let each follower respond to declared failures of others, from the messages it has received.

An aircraft that has failed declares it in every later message. Each follower learns of it from the
first such message that it receives. A leader that fails stays the leader.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import bind_entry
from testbed.core.records import Array, BoolArray, Event, Inbox, Records
from testbed.core.velocity_frame import write_frames
from testbed.flight.faults import FaultManager
from testbed.formation.control_step import set_gains


class FormationMembership:
    """Failures, slots and graph by the messages of each of n followers.

    A follower excludes a failed neighbour from its graph. With slot reassignment, a failed follower
    leaves the formation: it flies as after a leader timeout. Once it is clear of its slot, the
    others take the first free slots, in the order of the fleet; a slot has its own offset and
    gains. Without slot reassignment, a failed follower flies on as before.

    Attributes:
        known: (n, N) failures that each follower has received.
        left: (n,) followers that have failed and left the formation.
    """

    def __init__(
        self,
        names: Sequence[str],
        offsets: Array,
        gains: Array,
        faults: FaultManager,
        clearance_m: float | None,
    ) -> None:
        """Start with every follower in its own slot.

        Args:
            names: N aircraft, the leader first.
            offsets: υ (N, 3) m of the slots.
            gains: (n, N, 3) β of the slots.
            faults: which of them are declared.
            clearance_m: distance from its slot at which a failed follower is clear of it; None:
                slots are not reassigned.
        """
        self._names, self._faults, self._clearance_m = names, faults, clearance_m
        self._offsets, self._gains = offsets, gains
        n = len(names) - 1
        self.known: BoolArray = np.zeros((n, n + 1), dtype=bool)
        self._clear: BoolArray = np.zeros_like(self.known)  # known to be clear of their slots
        self.left: BoolArray = np.zeros(n, dtype=bool)
        self._slots = np.tile(np.arange(n + 1), (n, 1))  # (n, N) of each aircraft, by follower
        if clearance_m is not None:
            self._frame = np.empty((1, 3, 3))  # of the leader's velocity
            self._write_frame = bind_entry(write_frames, like=(np.empty((1, 3)), self._frame))

    @property
    def slots(self) -> NDArray[np.intp]:
        """Rows (n,) of the slots that the followers hold."""
        own: NDArray[np.intp] = self._slots.diagonal(1).copy()
        return own

    @property
    def offsets(self) -> Array:
        """υ (N, 3) m of the slot that each aircraft holds."""
        return np.vstack([self._offsets[:1], self._offsets[self.slots]])

    def changes(
        self,
        now: float,
        rows: NDArray[np.intp],
        inbox: Inbox,
        measured_s: Array,
    ) -> Iterator[Event]:
        """Yield an event for each failure learnt and each response; update the slots.

        Args:
            now: s.
            rows: (m,) followers that step now.
            inbox: (n, N) newest messages.
            measured_s: (n, N) s, times of measurement of their contents.
        """
        known = self.known[rows] | self._faults.declared(measured_s[rows])
        known[np.arange(len(rows)), rows + 1] = known[:, 0] = False
        for at, m in np.argwhere(known & ~self.known[rows]).tolist():
            row = int(rows[at])
            self.known[row, m] = True
            neighbour = self._gains[self.slots[row] - 1, self._slots[row, m]].any()
            response = ": excluded" if neighbour and not self.left[row] else ""
            yield self._event(now, row, f"{self._names[m]} has failed{response}")
        if self._clearance_m is None:
            return
        failed = self._faults.declared(np.full(len(self._names), now))[rows + 1]
        for row in rows[failed & ~self.left[rows]].tolist():
            self.left[row] = True
            yield self._event(now, row, "leaves the formation")
        for row, m in np.argwhere(self.known & ~self._clear).tolist():
            if (
                row in rows
                and not self.left[row]
                and self._is_clear(row, m, inbox, measured_s[row])
            ):
                self._clear[row, m] = True
                before = self.slots[row]
                self._reassign(row)
                slot = self.slots[row]
                response = "" if slot == before else f", takes the slot of {self._names[slot]}"
                yield self._event(now, row, f"{self._names[m]} has left its slot{response}")

    def _event(self, now: float, row: int, text: str) -> Event:
        return Event(now, "warning", self._names[row + 1], text)

    def _is_clear(self, row: int, m: int, inbox: Inbox, measured_s: Array) -> bool:
        """Return whether an aircraft m was clear of its slot at its newest message."""
        velocity = inbox.velocity_ned[row, 0]
        leader = inbox.position_ned[row, 0] + velocity * (measured_s[m] - measured_s[0])
        offset = self._offsets[self._slots[row, m]]
        self._write_frame(np.ascontiguousarray(velocity[np.newaxis]), self._frame)
        slot = leader + self._frame[0] @ offset
        distance = float(np.linalg.norm(inbox.position_ned[row, m] - slot))
        return distance > (self._clearance_m or 0.0)

    def _reassign(self, row: int) -> None:
        """Assign the first free slots to the remaining aircraft, by one follower's messages."""
        slots = self._slots[row]
        occupied = set(slots[self.known[row] & ~self._clear[row]].tolist())
        free = [slot for slot in range(1, len(slots)) if slot not in occupied]
        remaining = [m for m in range(1, len(slots)) if not self.known[row, m]]
        slots[remaining] = free[: len(remaining)]

    def write_neighbours(self, neighbours: Records) -> None:
        """Write offsets, gains and exclusions (n, N) by the messages of each follower."""
        gains = np.empty((len(self.known), *self._gains.shape[1:]))
        for row, slots in enumerate(self._slots):
            neighbours["offset"][row] = self._offsets[slots]
            gains[row] = self._gains[slots[row + 1] - 1, slots]
            gains[row, self.known[row]] = 0.0
        set_gains(neighbours, gains)
        neighbours["excluded"] = self.known | self.left[:, np.newaxis]
