"""Events of a flight, and the observers that get them with its samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Self

import numpy as np

from testbed.core.records import BoolArray, Event, Observer, Sample
from testbed.core.samples import BlockObserver, SampleBuffer, copy_sample


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


class Observers:
    """The observers of a run.

    A sample of the loop has views of the run's records, which the next ticks change. An observer
    that copies what it needs at once has an attribute `zero_copy` that is true; all others share
    one copy. A `BlockObserver` takes blocks of samples from one buffer; one with an attribute
    `events_only` that is true gets samples with events alone.

    Attributes:
        buffer: of the observers that take blocks; None: there are none.
        of_samples: observers that take single samples.
    """

    def __init__(self, observers: Sequence[Observer], aircraft: int, law_numbers: int = 0) -> None:
        """Sort observers of N aircraft, and of L numbers of a user's law, by what they take."""
        self._of_blocks = [each for each in observers if isinstance(each, BlockObserver)]
        self._of_events = [each for each in observers if getattr(each, "events_only", False)]
        apart = [*self._of_blocks, *self._of_events]
        self.of_samples = [each for each in observers if each not in apart]
        self._direct = [each for each in self.of_samples if getattr(each, "zero_copy", False)]
        self._others = [each for each in self.of_samples if each not in self._direct]
        self.buffer: SampleBuffer | None = None
        if self._of_blocks:
            self.buffer = SampleBuffer(aircraft, law_numbers)
            for taker in self._of_blocks:
                taker.share(self.buffer)

    def take_block(self) -> bool:
        """Let observers take the block of the buffer, which is full; return whether one ends it."""
        for each in self._of_blocks:
            each.take_block()
        return any(each.ends_flight for each in self._of_blocks)

    def observe(self, sample: Sample) -> None:
        """Pass a sample to observers of samples, and its events to the others."""
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
