"""Arrays of frames as rows of bytes: copied as they come, unpacked many at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import is_, itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.state import Frame

Columns = dict[str, NDArray[Any]]  # (K, ...) by source, the path from Frame

WHOLE = {  # what is not a float64 in a frame
    "formation.guards": "u1",
    "formation.saturations": "u1",
    "formation.place": "u4",
    "links.sent": "u4",
    "links.delivered": "u4",
    "lost": "?",
}


_FIRST, _LAST = map(Frame._fields.index, ("truth", "lost"))
_records = itemgetter(slice(_FIRST, _LAST + 1))  # all of a frame that has arrays


class Rows:
    """Some of the arrays of frames, and the ticks of these.

    Args:
        sources: of the arrays.
        take: gives them, in this order.
        room: for so many frames.

    Attributes:
        tick: (K) of the base rate.
        erring: those of the K frames whose estimates are not the truth.
    """

    def __init__(
        self, sources: Sequence[str], take: Callable[[Frame], Sequence[Any]], *, room: int
    ) -> None:
        """See the class."""
        self.tick: list[int] = []
        self.erring: list[int] = []
        self._sources, self._take, self._room = sources, take, room
        self._kind: np.dtype[Any] | None = None
        self._size = 0  # bytes of a row
        self._last: tuple[Any, ...] = (None,) * (_LAST + 1 - _FIRST)  # records
        self._ready: Callable[[int], None] | None = None  # bound to their arrays

    def append(self, frame: Frame) -> None:
        """Copy arrays of a frame, which are laid out as in all others.

        Raises:
            TypeError: An array of the first frame has not the type it should have.
            ValueError: The arrays are not as large as those of the first frame.
        """
        count, records = len(self.tick), _records(frame)
        same = all(map(is_, records, self._last))
        if same and self._ready is not None:
            self._ready(count * self._size)
        else:
            self._copy(frame, count * self._size, again=same)
            self._last = records
        if frame.estimate is not frame.truth:
            self.erring.append(count)
        self.tick.append(frame.tick)

    def _copy(self, frame: Frame, at: int, *, again: bool) -> None:
        arrays = self._take(frame)
        if self._kind is None:
            self._kind = _kind(self._sources, arrays)
            self._size = self._kind.itemsize
            self._octets = np.empty(self._room * self._size, np.uint8)
        if sum(each.nbytes for each in arrays) != self._size:
            raise ValueError("the arrays are not as large as those of the first frame")
        gather(arrays, self._octets, at)
        # a loop writes the next frame into the same arrays: who did so once does it again
        self._ready = READY_GATHER(arrays, self._octets) if again else None

    def columns(self) -> Columns:
        """The arrays of K frames, one at least, where they are kept: they last as long."""
        rows = self._octets.view(self._kind or object)[: len(self.tick)]
        return {source: rows[source] for source in self._sources}

    def clear(self) -> None:
        """Forget the frames."""
        self.tick.clear()
        self.erring.clear()


def gather(arrays: Sequence[NDArray[Any]], octets: NDArray[np.uint8], at: int) -> None:
    """Copy contiguous arrays one behind the other into octets from `at` on."""
    row = b"".join(each.data for each in arrays)
    octets.data[at : at + len(row)] = row


READY_GATHER = ready_of(gather, "testbed.rows_twin")


def _kind(sources: Sequence[str], arrays: Sequence[NDArray[Any]]) -> np.dtype[Any]:
    kind: list[tuple[str, Any, tuple[int, ...]]] = []
    for source, array in zip(sources, arrays, strict=True):
        expected = np.dtype(WHOLE.get(source, "f8"))
        if array.dtype != expected:
            raise TypeError(f"{source}: {array.dtype} instead of {expected}")
        kind.append((source, expected, array.shape))
    return np.dtype(kind)
