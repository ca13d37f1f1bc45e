"""Several kinds of vehicles together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from testbed.sim.steady import Steady
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

Record = TypeVar("Record", VehicleState, AirData, Surfaces, FbwaCommand)


class Mixed:
    """Several kinds together, each with its own rows among the N aircraft."""

    def __init__(self, parts: Sequence[tuple[Sequence[int], Vehicles]]) -> None:
        """Rows of all parts together are 0..N−1, each once."""
        self._parts = [(np.array(rows, dtype=np.intp), part) for rows, part in parts]
        self._state, self._estimate, self._told = (
            [_Own(rows) for rows, _ in self._parts] for _ in range(3)
        )
        order = np.argsort(np.concatenate([rows for rows, _ in self._parts]))
        self._order = None if (np.diff(order) == 1).all() else order

    @property
    def surfaces(self) -> Surfaces:
        """Of all."""
        return self._join([part.surfaces for _, part in self._parts])

    def read(self) -> VehicleState:
        """Of all."""
        return self._join([part.read() for _, part in self._parts])

    def air(self) -> AirData:
        """Of all."""
        return self._join([part.air() for _, part in self._parts])

    def lost(self, state: VehicleState) -> Truths:
        """Of all."""
        out = np.zeros(len(state.airspeed), dtype=bool)
        for (rows, part), own in zip(self._parts, self._state, strict=True):
            out[rows] = part.lost(own(state))
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

    def step(self, ticks: int) -> None:
        """All of them."""
        for _, part in self._parts:
            part.step(ticks)

    def _join(self, records: Sequence[Record]) -> Record:
        columns = (np.concatenate(each) for each in zip(*records, strict=True))
        order = self._order
        kind = type(records[0])
        return kind(*(each if order is None else each[order] for each in columns))


class _Own:
    """The rows of a record that are one part's, as a record that stays while the whole does."""

    def __init__(self, rows: NDArray[np.intp]) -> None:
        first, last = int(rows[0]), int(rows[-1]) + 1
        together = last - first == len(rows) and bool((np.diff(rows) == 1).all())
        self._rows, self._together = (slice(first, last) if together else rows), together
        self._whole: Any = None
        self._own: Any = None
        self._copies = Steady()

    def __call__(self, whole: Any) -> Any:  # noqa: ANN401 - any record of arrays
        if not self._together:
            return self._copies(choose(whole, self._rows))
        if whole is not self._whole:  # else what was looked at then shows what is there now
            self._whole, self._own = whole, choose(whole, self._rows)
        return self._own
