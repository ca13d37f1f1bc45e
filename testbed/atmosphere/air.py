"""The air of a run: mean wind, turbulence, gusts and wakes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.atmosphere.airframe_wind import make_local_wind, sample_ambient_wind
from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.atmosphere.gusts import make_gusts, write_active_gusts
from testbed.atmosphere.mean_wind import MeanWind
from testbed.atmosphere.turbulence_field import TurbulenceField, empty_grid
from testbed.atmosphere.wake import WakeModel
from testbed.core.call_list import NOW, Call, Step, run_steps
from testbed.core.compile import bind_entry
from testbed.core.records import Airframe, BoolArray, Records


class Atmosphere:
    """The air around N aircraft.

    Mean wind, turbulence field and gusts are sampled at five points of each airframe, so that
    their gradients act as angular rates of the air; turbulence of an aircraft's own has rates of
    its own. `bind` comes before `sample_wind` and `active_gusts`.

    Args:
        mean: the mean wind, which moves field, gusts and wakes.
        airframes: N.
        gusts: (G,) of GUST; None: none.
        field: turbulence that all aircraft share; None: none.
        dryden: turbulence of each aircraft's own; None: none.
        wakes: trailing vortices; None: none.

    Attributes:
        steady: the mean wind of the start is all there ever is, everywhere.
        is_random: there is turbulence.
        steps: of `sample_wind`, after `bind`.
    """

    def __init__(
        self,
        mean: MeanWind,
        airframes: Sequence[Airframe],
        *,
        gusts: Records | None = None,
        field: TurbulenceField | None = None,
        dryden: DrydenTurbulence | None = None,
        wakes: WakeModel | None = None,
    ) -> None:
        self.mean, self.gusts, self.field = mean, gusts, field
        self._dryden, self._wakes = dryden, wakes
        self._local_wind = make_local_wind(airframes)
        varies = gusts is not None or bool(field or dryden or wakes)
        self.is_random = bool(field or dryden)
        self.steady = mean.steady and mean.uniform and not varies

    def bind(self, aircraft: Records) -> None:
        """Bind to aircraft (N,) of AIRCRAFT, whose truth is read and whose wind is written."""
        self._aircraft, local = aircraft, self._local_wind
        wind = self.mean.rows, self.mean.profile
        gusts = make_gusts([], self.mean) if self.gusts is None else self.gusts
        grid = empty_grid() if self.field is None else self.field.grid
        ambient = Call(sample_ambient_wind, *wind, gusts, *grid, local, aircraft, NOW)
        self.steps: tuple[Step, ...] = (ambient,)
        if self.gusts is not None:
            self._write_active_gusts = bind_entry(
                write_active_gusts, gusts, *wind, aircraft, like=(0.0, self._no_gusts())
            )
        if self._dryden is not None:
            self.steps += (self._dryden.bind(aircraft, local),)
        if self._wakes is not None:
            self.steps += (self._wakes.bind(aircraft, local),)

    def sample_wind(self, now: float) -> None:
        """Write the wind at each aircraft at a time, s.

        Call it once per autopilot period: filters and trails advance by one step.
        """
        run_steps(self.steps, now)

    def remove(self, rows: BoolArray) -> None:
        """Remove aircraft (N,) that are lost: they neither shed wakes nor meet any."""
        if self._wakes is not None:
            self._wakes.remove(rows)

    def active_gusts(self, now: float) -> BoolArray:
        """Return which gusts, if there are any, reach which aircraft (G, N) at a time, s."""
        active = self._no_gusts()
        self._write_active_gusts(now, active)
        return active

    def _no_gusts(self) -> BoolArray:
        return np.zeros((len(self.gusts), len(self._aircraft)), dtype=bool)  # type: ignore[arg-type]
