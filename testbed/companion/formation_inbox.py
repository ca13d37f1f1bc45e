"""Messages of the other aircraft: kept as they come, and read together when they are needed.

To read one costs as much as to read ten.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from testbed.companion.clock_offset import ClockOffset
from testbed.companion.follower_control import FollowerControl
from testbed.companion.formation_messages import FormationMessages, PeerMessage, write_link
from testbed.companion.observation import PeerObservation
from testbed.mavlink.codec import Message
from testbed.mavlink.follow_target import MS

MOST = 64  # messages that wait; of more the oldest are dropped


class _Waiting(NamedTuple):
    """A message that was not read yet."""

    message: Message
    received_s: float  # by the monotonic clock
    receipt_s: float | None  # s since boot, by a run in lockstep


class FormationInbox:
    """The newest messages of the others, in the links of a control and as observations."""

    def __init__(self, control: FollowerControl, messages: FormationMessages) -> None:
        """Begin without a message.

        Args:
            control: whose links are written.
            messages: reads them.
        """
        self._control, self._messages = control, messages
        self._names = control.plan.names
        self._waiting: list[_Waiting] = []
        self._peers: dict[int, PeerObservation] = {}
        self._offsets = {name: ClockOffset() for name in self._names}
        control.forget()

    def add(self, message: Message, received_s: float, receipt_s: float | None = None) -> None:
        """Keep a message of another aircraft; others are dropped.

        Args:
            message: that was received.
            received_s: when, s of the monotonic clock.
            receipt_s: time of receipt by a run in lockstep, s since boot; None: not given.
        """
        row = self._messages.sender(message)
        if row is not None and row != self._control.row:
            self._waiting.append(_Waiting(message, received_s, receipt_s))
            del self._waiting[:-MOST]

    def take(self, base_ms: int | None, boot_time: Callable[[float], float] | None) -> None:
        """Read the messages that wait; those that are not newer change nothing.

        Args:
            base_ms: GPS time at the own boot, ms since 1970; None: not known, and they wait on.
            boot_time: returns the time since boot of a time of the monotonic clock, s; None: a
                message comes when it is measured, as in lockstep.
        """
        if base_ms is None or not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        found = self._messages.read([each.message for each in waiting])
        for each, peer in zip(waiting, found, strict=True):
            if peer is None:
                continue
            stamp_s = (peer.timestamp_ms - base_ms) / MS
            boot_s = each.receipt_s
            if boot_s is None:
                boot_s = stamp_s if boot_time is None else boot_time(each.received_s)
            if write_link(self._control.inbox[peer.row], peer, base_ms, boot_s):
                self._peers[peer.row] = self._observe(peer, stamp_s, boot_s, each.received_s)

    def forget(self) -> None:
        """Forget all that was read: times count from another moment."""
        self._control.forget()
        self._peers.clear()
        self._offsets = {name: ClockOffset() for name in self._names}

    def observed(self, now_s: float) -> Mapping[str, PeerObservation]:
        """Return the aircraft that the law uses, by name, at a time of the monotonic clock, s."""
        return {
            self._names[m]: _with_age(self._peers[m], now_s)
            for m in self._control.used
            if m in self._peers
        }

    def _observe(
        self, peer: PeerMessage, stamp_s: float, boot_s: float, received_s: float
    ) -> PeerObservation:
        """Return what is known by a message; its age is the time of receipt until `observed`."""
        north, east, down = peer.content.position_ned[0].tolist()
        v_north, v_east, v_down = peer.content.velocity_ned[0].tolist()
        return PeerObservation(
            age_s=received_s,
            stamp_s=stamp_s,
            position_ned=(north, east, down),
            velocity_ned=(v_north, v_east, v_down),
            height_m=peer.height_m,
            digests=peer.digests,
            offset_s=self._offsets[self._names[peer.row]].add(stamp_s, boot_s),
        )


def _with_age(peer: PeerObservation, now_s: float) -> PeerObservation:
    return PeerObservation(
        age_s=now_s - peer.age_s,
        stamp_s=peer.stamp_s,
        position_ned=peer.position_ned,
        velocity_ned=peer.velocity_ned,
        height_m=peer.height_m,
        digests=peer.digests,
        offset_s=peer.offset_s,
    )
