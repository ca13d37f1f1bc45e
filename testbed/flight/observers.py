"""Events of a flight, and the observers that get them with its samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, Self

import numpy as np

from testbed.core.records import BoolArray, Event, Observer, Sample
from testbed.core.samples import SampleBuffer, copy_sample


class EventQueue:
    """Events since the last sample.

    Attributes:
        waiting: (1,) whether there are any.
    """

    def __init__(self, events: Iterable[Event]) -> None:
        """Begin with the events from before the flight."""
        self._events = list(events)
        self.waiting: BoolArray = np.array([bool(self._events)])

    def __iadd__(self, events: Iterable[Event]) -> Self:
        """Add events."""
        self._events += events
        self.waiting[0] = bool(self._events)
        return self

    def put_first(self, events: Iterable[Event]) -> None:
        """Add events before the others."""
        self._events[:0] = events
        self.waiting[0] = bool(self._events)

    def take(self) -> tuple[Event, ...]:
        """Return all events, and forget them."""
        events = tuple(self._events)
        self._events.clear()
        self.waiting[0] = False
        return events


class BlockObserver(Observer, Protocol):
    """An observer that takes samples in blocks, which compiled code fills."""

    takes_blocks: str  # what it makes of them

    def share(self, aircraft: int) -> SampleBuffer:
        """Return the buffer for samples of N aircraft, once, before `begin`."""

    def add_events(self, events: Sequence[Event]) -> None:
        """Take the events since the last sample, which is in the buffer."""

    def take_block(self) -> None:
        """Take all samples of the buffer, which is full, and empty it."""


def take_block(observer: BlockObserver) -> Callable[[float], None]:
    """Return the step that gives an observer its full block."""
    return lambda now: observer.take_block()


class Observers:
    """The observers of a run.

    A sample of the loop has views of the run's records, which the next ticks change. An observer
    that copies what it needs at once has an attribute `zero_copy` that is true; all others share
    one copy. One with an attribute `takes_blocks` is a `BlockObserver`; one with an attribute
    `events_only` that is true gets samples with events alone.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        """Sort observers by what they take."""
        self._of_events = [each for each in observers if getattr(each, "events_only", False)]
        of_samples = [each for each in observers if each not in self._of_events]
        self._direct = [each for each in of_samples if getattr(each, "zero_copy", False)]
        self._others = [each for each in of_samples if each not in self._direct]
        self._of_blocks: list[BlockObserver] = []

    @property
    def of_blocks(self) -> list[BlockObserver]:
        """Observers that can take blocks."""
        return [each for each in self._direct if getattr(each, "takes_blocks", "")]  # type: ignore[misc]

    @property
    def of_samples(self) -> list[Observer]:
        """Observers that take single samples."""
        return [*self._direct, *self._others]

    def divide(self, of_blocks: Sequence[BlockObserver]) -> None:
        """Give these observers blocks from now on."""
        self._of_blocks = list(of_blocks)
        self._direct = [each for each in self._direct if each not in of_blocks]

    def observe(self, sample: Sample) -> None:
        """Pass a sample to observers of samples, and its events to those of blocks."""
        if sample.events:
            for taker in self._of_blocks:
                taker.add_events(sample.events)
            for each in self._of_events:
                each.observe(sample)
        for each in self._direct:
            each.observe(sample)
        if self._others:
            copied = copy_sample(sample)
            for each in self._others:
                each.observe(copied)
