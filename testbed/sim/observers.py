"""Pass samples to the observers of a run."""

from __future__ import annotations

from collections.abc import Sequence

from testbed.core.records import Observer, Sample
from testbed.core.samples import copy_sample


class Observers:
    """The observers of a run.

    A sample of the loop has views of the run's records, which the next ticks change. An observer
    that copies what it needs at once has an attribute `zero_copy` that is true; all others share
    one copy.
    """

    def __init__(self, observers: Sequence[Observer]) -> None:
        """Sort observers by whether they need a copy."""
        self._direct = [each for each in observers if getattr(each, "zero_copy", False)]
        self._others = [each for each in observers if each not in self._direct]

    def observe(self, sample: Sample) -> None:
        """Pass a sample to all observers."""
        for each in self._direct:
            each.observe(sample)
        if self._others:
            copied = copy_sample(sample)
            for each in self._others:
                each.observe(copied)
