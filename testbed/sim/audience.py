"""Who watches a run, and what each is handed: the loop's own arrays, or a copy to keep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.state import Frame, Observer


class Audience:
    """The observers of a run.

    A frame of the loop has the loop's arrays, into which the next ticks are written. An observer
    that copies what it wants at once says so by an attribute `borrows` that is true; all others
    share a copy, which stays as it is.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        """In the order in which they look, those that borrow first."""
        self._borrowers = [each for each in observers if getattr(each, "borrows", False)]
        self._keepers = [each for each in observers if each not in self._borrowers]

    def observe(self, frame: Frame) -> None:
        """Show it to everyone."""
        for each in self._borrowers:
            each.observe(frame)
        if self._keepers:
            copy = kept(frame)
            for each in self._keepers:
                each.observe(copy)


def kept(frame: Frame) -> Frame:
    """A frame of its own arrays; where the estimate is the truth itself it is so there too."""
    truth = _copied(frame.truth)
    return frame._replace(
        truth=truth,
        estimate=truth if frame.estimate is frame.truth else _copied(frame.estimate),
        air=_copied(frame.air),
        command=_copied(frame.command),
        surfaces=_copied(frame.surfaces),
        formation=_copied(frame.formation),
        links=_copied(frame.links),
        lost=frame.lost.copy(),
        failing=None if frame.failing is None else _copied(frame.failing),
    )


def _copied(record: Any) -> Any:  # noqa: ANN401 - any record of arrays
    return type(record)(*(each.copy() for each in record))
