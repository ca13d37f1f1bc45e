"""Frames waiting to be written, as rows of bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.record.messages import BOOL, DOUBLE, TOPICS, Column, Topic
from testbed.state import Array, Frame

# the records of a Frame in the order of the topics' columns, each with all its fields
_SOURCES = tuple(column.source for topic in TOPICS for column in topic.columns)


class Rows:
    """Frames as rows of bytes, one copy each.

    Args:
        frames: How many rows there is room for.
        aircraft: Number of aircraft, the leader included.
    """

    def __init__(self, *, frames: int, aircraft: int) -> None:
        """See the class."""

        def kind(column: Column, agents: int) -> tuple[str, str, tuple[int, int]]:
            components = aircraft if column.per_aircraft else len(column.names)
            flags = column.names[0].endswith("_bits")
            whole = "u1" if flags else "u4"  # state.Flags, state.Counts
            number = {DOUBLE: "f8", BOOL: "?"}.get(column.type, whole)  # state.Array, state.Truths
            return column.source, number, (agents, components)

        self._frames = frames
        self._row = np.dtype(
            [kind(c, aircraft - topic.followers_only) for topic in TOPICS for c in topic.columns]
        )
        self._rows: list[bytes] = []
        self.tick: list[int] = []

    def __len__(self) -> int:
        """How many frames wait."""
        return len(self.tick)

    @property
    def full(self) -> bool:
        """Whether there is no room for another frame."""
        return len(self) == self._frames

    def append(self, frame: Frame) -> None:
        """Copy a frame.

        Raises:
            TypeError: An array has not the type or the size it should have.
        """
        arrays: tuple[Any, ...] = (
            *frame.truth,
            *frame.air,
            *frame.surfaces,
            frame.lost,
            *frame.estimate,
            *frame.command,
            *frame.formation,
            *frame.links,
        )
        if not self._rows:
            self._check(arrays)
        self._rows.append(b"".join(arrays))
        self.tick.append(frame.tick)

    def clear(self) -> None:
        """Forget the frames."""
        self._rows.clear()
        self.tick.clear()

    def columns(self) -> np.ndarray[Any, np.dtype[np.void]]:
        """Everything (K,), by source arrays (K, agents, components)."""
        return np.frombuffer(b"".join(self._rows), dtype=self._row)

    def _check(self, arrays: tuple[Any, ...]) -> None:
        for source, array in zip(_SOURCES, arrays, strict=True):
            expected = self._row[source]
            if array.dtype != expected.base or array.size != np.prod(expected.shape):
                raise TypeError(f"{source}: {array.dtype}{array.shape} instead of {expected}")


def says_more(topic: Topic, columns: np.ndarray[Any, np.dtype[np.void]]) -> bool:
    """Whether any value of a topic differs from the one it has where nothing is written."""

    def differs(column: Column) -> bool:
        # by the bits, so that what is not a number equals itself
        same = _bits(columns[column.unwritten or column.source])
        return not np.array_equal(_bits(columns[column.source]), same)

    return any(differs(column) for column in topic.columns)


def all_delivered(columns: np.ndarray[Any, np.dtype[np.void]]) -> bool:
    """Whether every message sent so far arrives."""
    return np.array_equal(columns["links.sent"], columns["links.delivered"])


def _bits(values: Array) -> NDArray[np.uint64]:
    return values.view(np.uint64)
