"""The air of a run: all that moves it, put together, and what airframes feel of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from testbed.air.airframe import points_body
from testbed.air.field import Field
from testbed.air.field_sample import no_field
from testbed.air.gusts import Gusts, make_gusts
from testbed.air.independent import Independent
from testbed.air.mean import MeanWind
from testbed.air.together import READY_BLOW
from testbed.air.wake import Wakes
from testbed.state import AirFelt, Airframe, Array, Truths, VehicleState


class Air:
    """The air round N aircraft.

    What differs from place to place is taken at five points of each airframe, so that its slopes
    turn the airframe; what is drawn for each aircraft brings turns of its own.

    Args:
        mean: the mean wind, which carries field, gusts and wakes.
        airframes: N.
        gusts: discrete gusts; None: none.
        field: turbulence that all aircraft share; None: none.
        own: turbulence of each aircraft's own; None: none.
        wakes: what aircraft do to one another; None: nothing.

    Attributes:
        steady: the mean wind of the start is all there ever is, everywhere.
    """

    def __init__(
        self,
        mean: MeanWind,
        airframes: Sequence[Airframe],
        *,
        gusts: Gusts | None = None,
        field: Field | None = None,
        own: Independent | None = None,
        wakes: Wakes | None = None,
    ) -> None:
        """See the class."""
        n = len(airframes)
        self.mean, self.gusts, self.field = mean, gusts, field
        self._own, self._wakes = own, wakes
        self._body = points_body(airframes)
        self._blown = gusts or make_gusts([], mean)
        alike = mean.uniform and gusts is None
        self.steady = mean.steady and alike and not (field or own or wakes)
        self._mean, self._ambient, self._carried = *np.empty((2, n, 3)), np.empty(3)
        self._felt = AirFelt(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n))
        self._motion: VehicleState | None = None

    def felt(self, now: float, motion: VehicleState) -> AirFelt:
        """What the air does to the airframes at a time, s; once per period, for it remembers.

        What is given is overwritten at the next call. A motion that is the same record each time,
        written anew, is cheapest.
        """
        if motion is not self._motion:
            self._bind(motion)
        self._blow(now)
        for add in self._added:
            add()
        return self._felt

    def _bind(self, motion: VehicleState) -> None:
        """Bind everything that is felt to the arrays of a motion."""
        self._motion = motion
        position, velocity, acceleration, euler = motion[:4]
        wind, rates, roll = self._felt
        mean, ambient = self._mean, self._ambient
        field = self.field.tables if self.field else no_field()
        written = mean, self._carried, ambient, wind, rates
        self._blow = READY_BLOW(
            self.mean, field, self._blown, position, euler, self._body, *written
        )
        self._added: list[Callable[[], None]] = []
        if self._own is not None:
            self._added.append(self._own.bind(position, velocity, euler, mean, wind, rates))
        if self._wakes is not None:
            given = position, velocity, acceleration, euler, ambient, wind, roll
            self._added.append(self._wakes.bind(*given))

    def remove(self, rows: Truths) -> None:
        """Forget the trails of these aircraft (N,), which are lost; they shed and feel no more."""
        if self._wakes is not None:
            self._wakes.remove(rows)

    def gusts_inside(self, now: float, position_ned: Array) -> Truths | None:
        """Which gusts reach which aircraft at (N, 3) m: (G, N), or None without gusts."""
        if self.gusts is None:
            return None
        return self.gusts.inside(now, position_ned, self.mean.displacement_ned(now))
