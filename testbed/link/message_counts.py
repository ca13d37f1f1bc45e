"""What passed a link in one direction, by system and message."""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.link.frame_cutter import Frame, message_name
from testbed.network.link_statistics import BINS, QUANTILES, bin_of, outcome_name, quantile
from testbed.network.links import PacketOutcome

MAX_KINDS = 2000  # of systems and messages; further ones are counted together
OTHER = "other"  # bytes that are no frame, and frames beyond `MAX_KINDS`


class Durations:
    """Durations in bins; see `link_statistics`."""

    def __init__(self) -> None:
        self.count = 0
        self._bins = [0] * BINS
        self._least, self._most = float("inf"), 0.0

    def add(self, seconds: float) -> None:
        """Count a duration, s."""
        self.count += 1
        self._bins[bin_of(seconds)] += 1
        if seconds < self._least:
            self._least = seconds
        if seconds > self._most:
            self._most = seconds

    def summary(self) -> dict[str, float] | None:
        """Return quantiles and the longest, s; None: there was none."""
        if not self.count:
            return None
        bins = np.array(self._bins)
        found = {
            name: quantile(bins, part, self._least, self._most) for name, part in QUANTILES.items()
        }
        return {**found, "max": self._most}


class _Kind:
    """Messages of one kind of one system."""

    def __init__(self) -> None:
        self.offered = self.size_bytes = 0
        self.outcomes = [0] * len(PacketOutcome)
        self.delays = Durations()


class MessageCounts:
    """Count messages by system and id, and bytes that are none."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[int, int] | None, _Kind] = {}  # None: what is no frame

    def add(self, frames: tuple[Frame, ...], size_bytes: int, outcome: int, delay_s: float) -> None:
        """Count a packet.

        Args:
            frames: in it.
            size_bytes: of all of it.
            outcome: PacketOutcome.
            delay_s: of its first copy, if it is delivered.
        """
        for frame in frames:
            length = frame.end - frame.begin
            size_bytes -= length
            self._count((frame.system, frame.message), length, outcome, delay_s)
        if size_bytes or not frames:
            self._count(None, size_bytes, outcome, delay_s)

    def _count(
        self, key: tuple[int, int] | None, size_bytes: int, outcome: int, delay_s: float
    ) -> None:
        kind = self._kinds.get(key)
        if kind is None:
            if len(self._kinds) >= MAX_KINDS:
                key = None
            kind = self._kinds.setdefault(key, _Kind())
        kind.offered += 1
        kind.size_bytes += size_bytes
        kind.outcomes[outcome] += 1
        if outcome == PacketOutcome.DELIVERED:
            kind.delays.add(delay_s)

    def summary(self, seconds: float) -> list[dict[str, Any]]:
        """Return the counts, ready for JSON, by system and message.

        Args:
            seconds: for which the link has been open.
        """
        keys = sorted(self._kinds, key=lambda key: key or (256, 0))
        return [self._summary(key, self._kinds[key], seconds) for key in keys]

    @staticmethod
    def _summary(key: tuple[int, int] | None, kind: _Kind, seconds: float) -> dict[str, Any]:
        lost = {
            outcome_name(each): kind.outcomes[each]
            for each in PacketOutcome
            if each is not PacketOutcome.DELIVERED and kind.outcomes[each]
        }
        return {
            "system": key and key[0],
            "message": message_name(key[1]) if key else OTHER,
            "offered": kind.offered,
            "bytes": kind.size_bytes,
            "rate_hz": kind.offered / seconds if seconds > 0.0 else None,
            "delivered": kind.outcomes[PacketOutcome.DELIVERED],
            "lost": lost,
            "delay_s": kind.delays.summary(),
        }
