"""Copy samples of a run into blocks, and view them as columns of many samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    ActuatorCommand,
    Array,
    BoolArray,
    Event,
    FbwaCommand,
    FormationState,
    Indices,
    LinkCounters,
    Records,
    RunInfo,
    Sample,
    UIntArray,
    VehicleState,
    air_data,
    allocate,
    fault_state,
    fields_of,
)

Columns = Mapping[str, NDArray[Any]]  # (K, ...) by source, the path from Sample
_BLOCK_AIRCRAFT_SAMPLES = 800


def block_samples(aircraft: int) -> int:
    """Return the samples of a full block."""
    return min(max(_BLOCK_AIRCRAFT_SAMPLES // aircraft, 10), 200)


class SampleRows(NamedTuple):
    """K consecutive samples as columns: views of a buffer."""

    ticks: NDArray[np.int64]  # (K,) of the base rate
    columns: Columns
    inexact: BoolArray  # (K,) whether estimates differ from the truth


class SampleBuffer:
    """A buffer for a block of samples of N aircraft; a sample after a full block starts the next.

    Args:
        aircraft: N.
        law_numbers: L, of a user's law.

    Attributes:
        earlier: the sample before the first one, of the flight as which this one begins; None:
            there is none.
    """

    def __init__(self, aircraft: int, law_numbers: int = 0) -> None:
        capacity = block_samples(aircraft)
        self.earlier: SampleRows | None = None
        self._ticks = np.zeros(capacity, np.int64)
        self._count = np.zeros(2, np.int64)  # samples of the block, and of all blocks
        self._inexact: BoolArray = np.zeros(capacity, dtype=bool)
        self._aircraft = allocate(AIRCRAFT, capacity, aircraft)
        self._followers = allocate(FOLLOWER, capacity, aircraft - 1)
        shape = capacity, aircraft - 1, aircraft
        age_s = np.empty(shape)
        counters = LinkCounters(np.empty(shape, np.uint32), np.empty(shape, np.uint32))
        self._links = age_s, *counters
        views = _view_aircraft(self._aircraft) | {
            "formation": fields_of(FormationState, self._followers, age_s=age_s),
            "links": counters,
        }
        self._columns = {
            f"{name}.{field}": array
            for name, values in views.items()
            for field, array in values._asdict().items()
        }
        self._columns["lost"] = self._aircraft["lost"]
        self._law = np.empty((capacity, aircraft - 1, law_numbers))
        if law_numbers:
            self._columns["law"] = one_or_all(self._law)

    @property
    def total(self) -> int:
        """Number of samples since the buffer was made."""
        return int(self._count[1])

    def bind(
        self, records: tuple[Records, Records, Records], law: Array, rate_hz: int, *, exact: bool
    ) -> Call:
        """Return the call that appends a sample of a flight.

        Args:
            records: AIRCRAFT (N,), FOLLOWER (n,) and LINK (n, N).
            law: (n, L) numbers of a user's law.
            rate_hz: of the ticks.
            exact: the estimates are the truth.
        """
        self._inexact[:] = not exact
        return Call(_append, *self._rows, *records, law, float(rate_hz), NOW)

    def full_call(self) -> Call:
        """Return the call that returns whether the block is full."""
        return Call(_is_full, self._count, len(self._ticks))

    @property
    def is_full(self) -> bool:
        """Whether the next sample starts another block."""
        return int(self._count[0]) == len(self._ticks)

    @property
    def _rows(self) -> tuple[Any, ...]:
        rows = self._ticks, self._count, self._aircraft, self._followers
        return *rows, *self._links, self._law

    def unused_arrays(self) -> Iterable[NDArray[Any]]:
        """Return the arrays of a new buffer, which are written before they are read."""
        return () if self.total else (each for each in self._rows if each is not self._count)

    def append(self, sample: Sample) -> None:
        """Copy a sample.

        Raises:
            ValueError: it has another number of aircraft, or a field of another shape or dtype.
        """
        row, size = int(self._count[0]) % len(self._ticks), len(sample.truth.airspeed)
        if size != self._aircraft.shape[1]:
            raise ValueError(
                f"the sample has {size} aircraft, the run has {self._aircraft.shape[1]}"
            )
        if sample.records is not None:
            append: Any = _append
            law = self._law[0] if sample.law is None else sample.law
            law = law.reshape(self._law.shape[1:])
            append(*self._rows, *sample.records, law, 1.0, float(sample.tick))
        else:
            self._copy(sample, row)
            self._ticks[row] = sample.tick
            self._count[:] = row + 1, self.total + 1
        self._inexact[row] = sample.estimate is not sample.truth

    def _copy(self, sample: Sample, row: int) -> None:
        for path, column in self._columns.items():
            _write(_getter(path)(sample), column[row], path)

    def copy_last(self) -> SampleRows | None:
        """Copy the last sample; None: there is none."""
        if not self.total:
            return None
        last = self.since(self.total - 1)
        columns = {source: column.copy() for source, column in last.columns.items()}
        return SampleRows(last.ticks.copy(), columns, last.inexact.copy())

    def since(self, taken: int) -> SampleRows:
        """Return the samples of the block after the first `taken` of all blocks.

        They are views, which last until the next block.
        """
        end, total = self._count.tolist()
        rows = slice(end - (total - taken), end)
        columns = {source: column[rows] for source, column in self._columns.items()}
        return SampleRows(self._ticks[rows], columns, self._inexact[rows])


class BlockObserver(ABC):
    """An observer that takes samples in blocks: of a flight, which shares a buffer, or one by one.

    A subclass calls `_begin_blocks` in `begin`, and takes what is left of a block at the end.
    """

    zero_copy = True  # holds no array of a sample
    ends_flight = False  # after a block: whether the run ends, as a bound is violated
    _buffer: SampleBuffer | None = None

    def share(self, buffer: SampleBuffer) -> None:
        """Take the samples that the buffer gets from now on; before `begin`."""
        self._buffer, self._taken = buffer, buffer.total

    @abstractmethod
    def add_events(self, events: Sequence[Event]) -> None:
        """Take the events since the last sample, which is in the buffer."""

    @abstractmethod
    def take_block(self) -> None:
        """Take the new samples of the buffer, which is full."""

    def observe(self, sample: Sample) -> None:
        """Copy a sample where no buffer is shared; take the block when it is full."""
        assert self._buffer is not None, "the run has begun"
        self._buffer.append(sample)
        self.add_events(sample.events)
        if self._buffer.is_full:
            self.take_block()

    def _begin_blocks(self, info: RunInfo) -> None:
        """Start with the next sample of a run."""
        sizes = len(info.names), len(info.law_numbers)
        self.share(SampleBuffer(*sizes) if self._buffer is None else self._buffer)

    @property
    def _new(self) -> SampleRows:
        """The samples that were not taken."""
        assert self._buffer is not None, "the run has begun"
        return self._buffer.since(self._taken)

    @property
    def _earlier(self) -> SampleRows | None:
        """See `SampleBuffer.earlier`."""
        assert self._buffer is not None, "the run has begun"
        return self._buffer.earlier

    def _take(self) -> SampleRows:
        new = self._new
        self._taken += len(new.ticks)
        return new


class LastSample(BlockObserver):
    """An observer for which a flight keeps a buffer, which has the last sample."""

    def add_events(self, events: Sequence[Event]) -> None:
        """Do nothing."""

    def take_block(self) -> None:
        """Do nothing: the buffer keeps the block until the next sample."""

    def begin(self, info: RunInfo) -> None:
        """Do nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing."""


_getter = cache(attrgetter)


def _write(array: NDArray[Any], target: NDArray[Any], name: str) -> None:
    """Copy one field of a sample.

    Raises:
        ValueError: it has another shape or dtype.
    """
    if array.shape != target.shape or array.dtype != target.dtype:
        raise ValueError(
            f"{name} of the sample is {array.dtype} {array.shape}, not "
            f"{target.dtype} {target.shape}"
        )
    target[...] = array


@entry
def _append(
    ticks: Indices,
    count: Indices,
    all_aircraft: Records,
    all_followers: Records,
    age_s: Array,
    sent: UIntArray,
    delivered: UIntArray,
    all_law: Array,
    aircraft: Records,
    followers: Records,
    links: Records,
    law: Array,
    rate_hz: float,
    now: float,
) -> None:
    """Copy one sample to the next row: numpy takes 20 times as long, field by field."""
    row = count[0] % len(ticks)
    ticks[row] = round(now * rate_hz)
    for i in range(len(aircraft)):
        all_aircraft[row, i] = aircraft[i]
    for i in range(len(followers)):
        all_followers[row, i] = followers[i]
        for k in range(law.shape[1]):
            all_law[row, i, k] = law[i, k]
        for m in range(len(aircraft)):
            link = links[i, m]
            age_s[row, i, m] = link.age_s
            sent[row, i, m], delivered[row, i, m] = link.sent, link.delivered
    count[0] = row + 1
    count[1] += 1


@entry
def _is_full(count: Indices, capacity: int) -> bool:
    """Return whether there are as many samples as there is space for."""
    return bool(count[0] >= capacity)


def _view_aircraft(aircraft: Records) -> dict[str, Any]:
    """View AIRCRAFT (...,) as the named tuples of a sample, by their names there."""
    return {
        "truth": fields_of(VehicleState, aircraft["truth"]),
        "estimate": fields_of(VehicleState, aircraft["estimate"]),
        "air": air_data(aircraft),
        "command": fields_of(FbwaCommand, aircraft["command"]),
        "surfaces": fields_of(ActuatorCommand, aircraft["surfaces"]),
    }


def one_or_all(law: Array) -> Array:
    """Return numbers (…, L) of a user's law, (…,) of one."""
    one: Array = law[..., 0] if law.shape[-1] == 1 else law
    return one


def make_sample(
    aircraft: Records,
    followers: Records,
    links: Records,
    law: Array | None = None,
    *,
    exact: bool,
    faults: bool,
) -> Sample:
    """View records as a sample of tick 0.

    Args:
        aircraft: (N,) of AIRCRAFT.
        followers: (n,) of FOLLOWER.
        links: (n, N) of LINK.
        law: (n, L) numbers of a user's law; None: none.
        exact: the estimate is the truth.
        faults: the scenario has faults.
    """
    views = _view_aircraft(aircraft)
    if exact:
        views["estimate"] = views["truth"]
    return Sample(
        tick=0,
        time_s=0.0,
        **views,
        formation=fields_of(FormationState, followers, age_s=links["age_s"]),
        links=fields_of(LinkCounters, links),
        lost=aircraft["lost"],
        faults=fault_state(aircraft["faults"]) if faults else None,
        law=None if law is None or not law.shape[1] else one_or_all(law),
        records=(aircraft, followers, links),
    )


def copy_sample(sample: Sample) -> Sample:
    """Copy a sample for an observer that keeps it."""
    if sample.records is None:
        return sample
    copied = make_sample(
        *(each.copy() for each in sample.records),
        exact=sample.estimate is sample.truth,
        faults=sample.faults is not None,
    )
    law = None if sample.law is None else sample.law.copy()
    return copied._replace(tick=sample.tick, time_s=sample.time_s, events=sample.events, law=law)
