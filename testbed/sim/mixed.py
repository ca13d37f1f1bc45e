"""Several kinds of vehicles together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import is_
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from testbed.rows import READY_GATHER
from testbed.sim.vehicles import Vehicles, choose
from testbed.state import (
    AirData,
    AirFelt,
    Failing,
    FbwaCommand,
    Surfaces,
    Truths,
    UnicycleCommand,
    VehicleState,
)
from testbed.steady import Steady
from testbed.vehicle.legs import Leg, those_of

Record = TypeVar("Record", VehicleState, AirData, Surfaces, FbwaCommand)


class Mixed:
    """Several kinds together, each with its own rows among the N aircraft."""

    def __init__(self, parts: Sequence[tuple[Sequence[int], Vehicles]]) -> None:
        """Rows of all parts together are 0..N−1, each once."""
        self._parts = [(np.array(rows, dtype=np.intp), part) for rows, part in parts]
        self._rows = [tuple(rows) for rows, _ in parts]
        self._state, self._estimate, self._told = (
            [_Own(rows) for rows, _ in self._parts] for _ in range(3)
        )
        self._places = [_place(rows) for rows, _ in self._parts]
        self._read, self._air, self._surfaces = (_Whole(self._places) for _ in range(3))

    @property
    def surfaces(self) -> Surfaces:
        """Of all."""
        return self._surfaces([part.surfaces for _, part in self._parts])

    def read(self) -> VehicleState:
        """Of all."""
        return self._read([part.read() for _, part in self._parts])

    def air(self) -> AirData:
        """Of all."""
        return self._air([part.air() for _, part in self._parts])

    def lost(self, state: VehicleState) -> Truths:
        """Of all."""
        out = np.zeros(len(state.airspeed), dtype=bool)
        given = zip(self._places, self._parts, self._state, strict=True)
        for place, (_, part), own in given:
            out[place] = part.lost(own(state))
        return out

    def blow(self, felt: AirFelt) -> None:
        """To each its own."""
        for rows, part in self._parts:
            part.blow(choose(felt, rows))

    def steer(self, told: UnicycleCommand) -> None:
        """To each its own."""
        for rows, part in self._parts:
            part.steer(choose(told, rows))

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """To each its own."""
        given = zip(self._parts, self._estimate, self._told, strict=True)
        for (_, part), of_estimate, of_told in given:
            part.act(of_estimate(estimate), of_told(told))

    def fail(self, failing: Failing) -> None:
        """To each its own."""
        for rows, part in self._parts:
            part.fail(choose(failing, rows))

    def remove(self, rows: Truths) -> None:
        """To each its own."""
        for own, part in self._parts:
            part.remove(rows[own])

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """To each its own."""
        for rows, (_, part) in zip(self._rows, self._parts, strict=True):
            part.step(ticks, those_of(legs, rows))


class _Whole:
    """The records of all parts as one that stays.

    Where the parts have the first aircraft, the next ones and so on, records that stay are copied
    by one call: field by field they lie one behind the other.
    """

    def __init__(self, places: Sequence[Any]) -> None:
        self._places = places
        self._order = _order(places)
        self._whole: Any = None
        self._last: tuple[Any, ...] = (None,) * len(places)
        self._ready: Callable[[int], None] | None = None  # bound to the arrays of the last

    def __call__(self, records: Sequence[Record]) -> Record:
        same = all(map(is_, records, self._last))
        if same and self._ready is not None:
            self._ready(0)
        else:
            self._copy(records)
            if same and self._order is not None:
                arrays = [records[k][field] for field in self._fields for k in self._order]
                if all(each.flags.c_contiguous and each.dtype == float for each in arrays):
                    self._ready = READY_GATHER(arrays, self._octets)
        joined: Record = self._whole
        return joined

    def _copy(self, records: Sequence[Record]) -> None:
        if self._whole is None:
            n = sum(len(record[0]) for record in records)
            self._fields = range(len(records[0]))
            self._octets, self._whole = _blank(records[0], n)
        for place, record in zip(self._places, records, strict=True):
            for whole, part in zip(self._whole, record, strict=True):
                whole[place] = part
        self._ready, self._last = None, tuple(records)


def _order(places: Sequence[Any]) -> list[int] | None:
    """The parts by their places, if each of these is of neighbours."""
    if not all(isinstance(place, slice) for place in places):
        return None
    return sorted(range(len(places)), key=lambda k: int(places[k].start))


def _blank(like: Any, n: int) -> tuple[NDArray[np.uint8], Any]:  # noqa: ANN401 - of any arrays
    """A record of this kind with room for n aircraft, and its fields one behind the other."""
    shapes = [(n, *array.shape[1:]) for array in like]
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    numbers = np.empty(ends[-1])
    parts = np.split(numbers, ends[:-1])
    whole = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
    return numbers.view(np.uint8), type(like)(*whole)


class _Own:
    """The rows of a record that are one part's, as a record that stays while the whole does."""

    def __init__(self, rows: NDArray[np.intp]) -> None:
        self._rows = _place(rows)
        self._together = isinstance(self._rows, slice)
        self._whole: Any = None
        self._own: Any = None
        self._copies = Steady()

    def __call__(self, whole: Any) -> Any:  # noqa: ANN401 - any record of arrays
        if not self._together:
            return self._copies(choose(whole, self._rows))
        if whole is not self._whole:  # else what was looked at then shows what is there now
            self._whole, self._own = whole, choose(whole, self._rows)
        return self._own


def _place(rows: NDArray[np.intp]) -> Any:  # noqa: ANN401 - an index
    """Rows as a slice, if they are neighbours in order."""
    first, last = int(rows[0]), int(rows[-1]) + 1
    return slice(first, last) if np.array_equal(rows, np.arange(first, last)) else rows
