"""The air of a run: all that moves it, put together, and what airframes feel of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.air.airframe import FELT, PLACE, points_body
from testbed.air.field import Field
from testbed.air.field_sample import FELT_IN_FIELD
from testbed.air.gusts import Gusts
from testbed.air.independent import TURBULENCE_AXES, Independent
from testbed.air.mean import MeanWind
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
        dt: s between two calls of `felt`.

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
        dt: float,
    ) -> None:
        """See the class."""
        self.mean, self.gusts, self.field = mean, gusts, field
        self._own, self._wakes = own, wakes
        self._dt, self._drift = dt, np.zeros(3)
        self._body = points_body(airframes)
        self._differs = gusts is not None or not mean.uniform
        self.steady = mean.steady and not (self._differs or field or own or wakes)
        everywhere = mean.steady and mean.uniform
        still = np.zeros((2, len(airframes), 3))
        self._mean = mean.velocity_ned(0.0, still[0, :, 0]) if everywhere else None
        self._no_rates, self._no_roll = still[1], still[0, :, 0].copy()

    def felt(self, now: float, motion: VehicleState) -> AirFelt:
        """What the air does to the airframes at a time, s; once per period, for it remembers."""
        mean = self._mean
        if mean is None:
            mean = self.mean.velocity_ned(now, -motion.position_ned[:, 2])
        ambient = wind = mean  # what blows in the large, and all that blows
        rates, roll = self._no_rates, self._no_roll
        carried = self.mean.displacement_ned(now)
        position, euler = motion.position_ned, motion.euler
        if self.field is not None:
            tables = self.field.tables
            wind, rates = FELT_IN_FIELD(tables, position, euler, self._body, carried, mean)
        if self._differs:
            points = PLACE(position, euler, self._body)
            blown, turns = FELT(self._difference(now, mean, points, carried), euler, self._body)
            ambient, wind, rates = ambient + blown, wind + blown, rates + turns
        if self._own is not None:
            through_air = motion.velocity_ned - mean
            airspeed = np.sqrt((through_air**2).sum(axis=1))
            height = -position[:, 2]
            draws, turns = self._own.step(height, airspeed)
            axes = TURBULENCE_AXES(height, through_air, euler)
            wind = wind + (axes @ draws[:, :, np.newaxis])[:, :, 0]
            rates = rates + turns
        if self._wakes is not None:
            washed, roll = self._wakes.step(
                position - self._drift,
                motion.velocity_ned - ambient,
                motion.acceleration_ned,
                euler,
            )
            # one drift for all trails: who feels them flies near to who sheds them
            if self._wakes.sheds.any():
                self._drift = self._drift + self._dt * ambient[self._wakes.sheds].mean(axis=0)
            wind = wind + washed
        return AirFelt(wind, rates, roll)

    def remove(self, rows: Truths) -> None:
        """Forget the trails of these aircraft (N,), which are lost; they shed and feel no more."""
        if self._wakes is not None:
            self._wakes.remove(rows)

    def gusts_inside(self, now: float, position_ned: Array) -> Truths | None:
        """Which gusts reach which aircraft at (N, 3) m: (G, N), or None without gusts."""
        if self.gusts is None:
            return None
        return self.gusts.inside(now, position_ned, self.mean.displacement_ned(now))

    def _difference(self, now: float, mean: Array, points: Array, carried: Array) -> Array:
        """What gusts and the wind's profile add to the mean (N, 5, 3) m/s at points."""
        sheared = self.mean.velocity_ned(now, -points[:, :, 2]) - mean[:, np.newaxis]
        if self.gusts is None:
            return sheared
        return sheared + self.gusts.velocity_ned(now, points, carried)
