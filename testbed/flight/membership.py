"""Let each follower respond to declared failures of others, from the messages it has received.

An aircraft that has failed declares it in every later message. Each follower learns of it from the
first such message that it receives. A leader that fails stays the leader.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isnan, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from testbed.core.call_list import NOW, Call
from testbed.core.compile import bind_entry, entry, kernel
from testbed.core.records import LINK, Array, BoolArray, Event, Indices, Records, allocate
from testbed.core.velocity_frame import frame_angles, to_ned
from testbed.flight.faults import FaultManager, declares
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

    ADDRESSES = "_find_declared", "_is_clear_in"

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
        self._find_declared = faults.bind_declared()
        link = allocate(LINK, n, n + 1), 0, 0, offsets[0], 0.0
        self._is_clear_in = bind_entry(is_clear_in, like=link)

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
        rows: Indices,
        links: Records,
    ) -> Iterator[Event]:
        """Yield an event for each failure learnt and each response; update the slots.

        Args:
            now: s.
            rows: (m,) followers that step now.
            links: (n, N) of LINK, with the newest messages.
        """
        known = self.known[rows] | self._find_declared(links["measured_s"][rows])
        known[np.arange(len(rows)), rows + 1] = known[:, 0] = False
        for at, m in np.argwhere(known & ~self.known[rows]).tolist():
            row = int(rows[at])
            self.known[row, m] = True
            neighbour = self._gains[self.slots[row] - 1, self._slots[row, m]].any()
            response = ": excluded" if neighbour and not self.left[row] else ""
            yield self._event(now, row, f"{self._names[m]} has failed{response}")
        if self._clearance_m is None:
            return
        failed = self._find_declared(np.full((1, len(self._names)), now))[0, rows + 1]
        for row in rows[failed & ~self.left[rows]].tolist():
            self.left[row] = True
            yield self._event(now, row, "leaves the formation")
        for row, m in np.argwhere(self.known & ~self._clear).tolist():
            if row in rows and not self.left[row] and self._is_clear(row, m, links):
                self._clear[row, m] = True
                before = self.slots[row]
                self._reassign(row)
                slot = self.slots[row]
                response = "" if slot == before else f", takes the slot of {self._names[slot]}"
                yield self._event(now, row, f"{self._names[m]} has left its slot{response}")

    def _event(self, now: float, row: int, text: str) -> Event:
        return Event(now, "warning", self._names[row + 1], text)

    def bind(self, rows: Indices, links: Records) -> Call:
        """Return the call after which `changes` is needed where it returns true.

        Args:
            rows: (m,) followers that step together.
            links: (n, N) of LINK.
        """
        faults = self._faults.records, self._faults.declared_after_s
        clearance_m = nan if self._clearance_m is None else self._clearance_m
        slots = self._slots, self._offsets, clearance_m
        return Call(
            find_failures, rows, *faults, self.known, self._clear, self.left, *slots, links, NOW
        )

    def _is_clear(self, row: int, m: int, links: Records) -> bool:
        """Return whether an aircraft m was clear of its slot at its newest message."""
        slot = self._offsets[self._slots[row, m]]
        return self._is_clear_in(links, row, m, slot, self._clearance_m or 0.0)

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


@entry
def find_failures(
    rows: Indices,
    faults: Records,
    declared_after_s: float,
    known: BoolArray,
    clear: BoolArray,
    left: BoolArray,
    slots: Indices,
    offsets: Array,
    clearance_m: float,
    links: Records,
    now: float,
) -> bool:
    """Return whether a follower learns of a failure, leaves the formation, or finds a slot clear.

    Args:
        rows: (m,) of the followers that step now.
        faults: (K, 1) of FAULT.
        declared_after_s: see `FaultManager`.
        known: (n, N) failures that each follower has received.
        clear: (n, N) of these, aircraft that have been clear of their slots.
        left: (n,) followers that have left the formation.
        slots: (n, N) of each aircraft, by follower.
        offsets: (N, 3) m of the slots.
        clearance_m: see `FormationMembership`; NaN: slots are not reassigned.
        links: (n, N) of LINK.
        now: s.
    """
    for row in rows:
        for k in range(len(faults)):
            fault = faults[k, 0]
            m = fault.row
            if m == row + 1:
                leaves = not isnan(clearance_m) and not left[row]
                if leaves and declares(fault, declared_after_s, now):
                    return True
            elif m > 0 and not known[row, m]:
                if declares(fault, declared_after_s, links[row, m].measured_s):
                    return True
        if isnan(clearance_m) or left[row]:
            continue
        for m in range(known.shape[1]):
            if known[row, m] and not clear[row, m]:
                if is_clear(links, row, m, offsets[slots[row, m]], clearance_m):
                    return True
    return False


@kernel
def is_clear(links: Records, row: int, m: int, offset: Array, clearance_m: float) -> bool:
    """Return whether an aircraft was clear of its slot at its newest message.

    Args:
        links: (n, N) of LINK.
        row: of the follower that has received the message.
        m: the aircraft.
        offset: (3,) m of its slot.
        clearance_m: see `FormationMembership`.
    """
    leader, other = links[row, 0], links[row, m]
    x, y, z = leader.velocity_ned
    later_s = other.measured_s - leader.measured_s
    slot = to_ned(frame_angles(x, y, z), offset[0], offset[1], offset[2])
    square = 0.0
    for axis in range(3):
        at = leader.position_ned[axis] + leader.velocity_ned[axis] * later_s + slot[axis]
        square += (other.position_ned[axis] - at) ** 2
    return sqrt(square) > clearance_m


@entry
def is_clear_in(links: Records, row: int, m: int, offset: Array, clearance_m: float) -> bool:
    """Return whether an aircraft was clear of its slot; see `is_clear`."""
    return bool(is_clear(links, row, m, offset, clearance_m))
