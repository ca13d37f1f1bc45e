"""A chunk being put together: records in order, and where each begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.record.wire import Bytes, Times, message_indexes


class Pile:
    """Records one after the other, and the index of every channel."""

    def __init__(self) -> None:
        """Start with nothing."""
        self.parts: list[bytes | memoryview] = []
        self._size = 0
        self._rows: dict[str, list[int]] = {}
        self._singles: dict[int, list[tuple[int, int]]] = {}  # channel: time, offset
        self._indexes: list[tuple[int, int, bytes]] = []
        self._times: list[int] = []

    def row(self, kind: str, records: Bytes) -> None:
        """Add records (bytes,) that always come together in this order."""
        self._rows.setdefault(kind, []).append(self._size)
        self.parts.append(records.data)
        self._size += records.size

    def single(self, channel: int, time_ns: int, record: bytes) -> None:
        """Add one record."""
        self._singles.setdefault(channel, []).append((time_ns, self._size))
        self.parts.append(record)
        self._size += len(record)

    def index(
        self, kind: str, channels: NDArray[np.uint16], offsets: Times, time_ns: Times
    ) -> None:
        """Index the rows of a kind.

        Args:
            kind: As in `row`.
            channels: (M,) of the records of a row.
            offsets: (M,) of the records in a row.
            time_ns: (K,) of the rows.
        """
        starts = np.array(self._rows.get(kind, []), dtype=np.uint64)
        if not starts.size:
            return
        records = message_indexes(channels, time_ns, starts[None, :] + offsets[:, None])
        for channel, record in zip(channels.tolist(), records, strict=True):
            self._indexes.append((channel, starts.size, record.tobytes()))
        self._times += [int(time_ns.min()), int(time_ns.max())]

    def indexes(self) -> list[tuple[int, int, bytes]]:
        """For each channel: its number, how many messages, the message index record."""
        singles = []
        for channel, entries in sorted(self._singles.items()):
            stamps, offsets = np.array(entries, dtype=np.uint64).T
            record = message_indexes(np.array([channel], np.uint16), stamps, offsets[None])
            singles.append((channel, len(entries), record.tobytes()))
        return self._indexes + singles

    def span_ns(self) -> tuple[int, int]:
        """The earliest and the latest time."""
        times = self._times + [t for entries in self._singles.values() for t, _ in entries]
        return min(times), max(times)
