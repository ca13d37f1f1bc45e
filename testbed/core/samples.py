"""Copy samples of a run into blocks, and view them as columns of many samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    ActuatorCommand,
    Array,
    FbwaCommand,
    FormationState,
    Indices,
    LinkCounters,
    Records,
    Sample,
    UIntArray,
    VehicleState,
    air_data,
    allocate,
    fault_state,
    fields_of,
)

Columns = Mapping[str, NDArray[Any]]  # (K, ...) by source, the path from Sample


class SampleBuffer:
    """A buffer for samples of N aircraft.

    Args:
        capacity: K samples.
        count: N.

    Attributes:
        capacity: K.
    """

    def __init__(self, capacity: int, count: int) -> None:
        """See the class."""
        self.capacity = capacity
        self._ticks, self._count = np.zeros(capacity, np.int64), np.zeros(1, np.int64)
        self._inexact: NDArray[np.bool_] = np.zeros(capacity, dtype=bool)
        self._aircraft = allocate(AIRCRAFT, capacity, count)
        self._followers = allocate(FOLLOWER, capacity, count - 1)
        shape = capacity, count - 1, count
        self._links: dict[str, NDArray[Any]] = {
            "age_s": np.empty(shape),
            "sent": np.empty(shape, np.uint32),
            "delivered": np.empty(shape, np.uint32),
        }

    def __len__(self) -> int:
        """Return the number of samples that are there."""
        return int(self._count[0])

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Ticks of the samples (k,)."""
        return self._ticks[: len(self)]

    @property
    def inexact(self) -> NDArray[np.bool_]:
        """Which samples (k,) have estimates that are not exact."""
        return self._inexact[: len(self)]

    def bind(self, records: tuple[Records, Records, Records], rate_hz: int, *, exact: bool) -> Call:
        """Return the call that appends a sample of a flight.

        Args:
            records: AIRCRAFT (N,), FOLLOWER (n,) and LINK (n, N).
            rate_hz: of the ticks.
            exact: the estimates are the truth.
        """
        self._inexact[:] = not exact
        return Call(_append, *self._rows, *records, float(rate_hz), NOW)

    def full_call(self) -> Call:
        """Return the call that returns whether the buffer is full."""
        return Call(_is_full, self._count, self.capacity)

    @property
    def _rows(self) -> tuple[Any, ...]:
        return self._ticks, self._count, self._aircraft, self._followers, *self._links.values()

    def unused_arrays(self) -> Iterable[NDArray[Any]]:
        """Return the arrays of an empty buffer, whose numbers are written before they are read."""
        return () if len(self) else (each for each in self._rows if each is not self._count)

    def append(self, sample: Sample) -> None:
        """Copy a sample.

        Raises:
            ValueError: it has another number of aircraft, or a field of another shape or dtype.
        """
        count, size = len(self), len(sample.truth.airspeed)
        if size != self._aircraft.shape[1]:
            raise ValueError(
                f"the sample has {size} aircraft, the run has {self._aircraft.shape[1]}"
            )
        if sample.records is not None:
            append: Any = _append
            append(*self._rows, *sample.records, 1.0, float(sample.tick))
        else:
            self._copy(sample, count)
            self._ticks[count] = sample.tick
            self._count += 1
        self._inexact[count] = sample.estimate is not sample.truth

    def _copy(self, sample: Sample, count: int) -> None:
        aircraft, formation = self._aircraft[count], sample.formation
        for name, targets in _view_aircraft(aircraft).items():
            for field, array in getattr(sample, name)._asdict().items():
                _write(array, getattr(targets, field), f"{name}.{field}")
        _write(sample.lost, aircraft["lost"], "lost")
        for name in formation._fields:
            known = name in self._links
            target = self._links[name][count] if known else self._followers[count][name]
            _write(getattr(formation, name), target, f"formation.{name}")
        for name, array in zip(LinkCounters._fields, sample.links, strict=True):
            _write(array, self._links[name][count], f"links.{name}")

    def columns(self) -> Columns:
        """Return the samples as columns: views, which last until the next `append`."""
        count = len(self)
        aircraft, followers = self._aircraft[:count], self._followers[:count]
        columns = {
            f"{name}.{field}": array
            for name, values in _view_aircraft(aircraft).items()
            for field, array in values._asdict().items()
        }
        columns["lost"] = aircraft["lost"]
        for field in FormationState._fields:
            known = field in (FOLLOWER.names or ())
            rows = followers[field] if known else self._links[field][:count]
            columns[f"formation.{field}"] = rows
        for field in LinkCounters._fields:
            columns[f"links.{field}"] = self._links[field][:count]
        return columns

    def clear(self) -> None:
        """Forget the samples."""
        self._count[0] = 0


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
    aircraft: Records,
    followers: Records,
    links: Records,
    rate_hz: float,
    now: float,
) -> None:
    """Copy one sample to the next row: numpy takes 20 times as long, field by field."""
    row = count[0]
    ticks[row] = round(now * rate_hz)
    for i in range(len(aircraft)):
        all_aircraft[row, i] = aircraft[i]
    for i in range(len(followers)):
        all_followers[row, i] = followers[i]
        for m in range(len(aircraft)):
            link = links[i, m]
            age_s[row, i, m] = link.age_s
            sent[row, i, m], delivered[row, i, m] = link.sent, link.delivered
    count[0] = row + 1


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


def make_sample(
    aircraft: Records, followers: Records, links: Records, *, exact: bool, faults: bool
) -> Sample:
    """View records as a sample of tick 0.

    Args:
        aircraft: (N,) of AIRCRAFT.
        followers: (n,) of FOLLOWER.
        links: (n, N) of LINK.
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
    return copied._replace(tick=sample.tick, time_s=sample.time_s, events=sample.events)
